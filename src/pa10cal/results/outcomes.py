"""Outcomes in short: of a campaign, of a fleet, of measured robots; and the pictures drawn."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pa10cal.results.calibration import Grade
from pa10cal.results.discovery import Verdict
from pa10cal.results.record import CampaignRecord, Key, Part, Record, filed, optional

#: What became of a campaign.
ChainStatus = Literal["done", "refused", "fault", "ended"]
#: Why an arm needs attention. The order of these words is the order of urgency, by which arms are
#: sorted.
Attention = Literal["no_result", "input", "moved", "incomplete", "none"]


@filed("pa10cal-chain/1", "chain.json", by="chain")
class ChainRecord(CampaignRecord):
    """What became of a campaign in its chain of stages: done, or where it ended and why."""

    # `done`; `refused` where a stage refused its input; `fault` where one failed; `ended` where the
    # machine ended it, such as by a signal or for want of memory: a next run begins it anew
    status: ChainStatus
    stage: str | None = optional()  # the stage that refused, failed or was ended
    message: str | None = optional()  # what it said
    robot: str | None = optional()  # the arm's description
    provenance: str | None = optional()  # where its data come from, in its own words
    grade: Grade | None = optional()  # of the calibration
    line: str | None = optional()  # the sentence of the grade
    verdict: Verdict | None = optional()  # of the search for missing effects
    # effects, faults and what is unexplained, a line each
    notes: tuple[str, ...] | None = optional()
    before_mm: float | None = optional()  # mean position error of the uncalibrated arm [mm]
    after_mm: float | None = optional()  # mean position error of the final model [mm]
    # poses that both are of: `held-out poses` or `fitted poses`; of a path, where they lie as well
    over: str | None = optional()


class FleetCampaign(Part):
    """One campaign of the fleet."""

    arm: str  # which arm it measured
    campaign: str  # name of its folder
    measured: str | None = optional()  # when it was measured, as the table of campaigns says
    became: ChainRecord  # its `chain.json`
    # whether its model agrees with that of the arm's last campaign before it of which nothing is
    # suspected
    agrees: bool | None = optional()
    # which parameters moved since that campaign, and by how much its model differs; or why they
    # could not be compared
    moved: str | None = optional()


class FleetArm(Part):
    """One arm: how it stands after its last campaign."""

    arm: str  # which arm
    campaigns: int  # campaigns of it
    last: str  # the last of them
    # `no_result`: the last campaign gave none; `input`: its grade or verdict says that something in
    # the data is wrong, or the fit did not converge; `moved`: its model differs from the one before
    # by more than chance, or a part of the arm moved since; `incomplete`: an effect is missing that
    # has no single name, or the grade is that and nothing was named; or `none`
    attention: Attention
    why: str  # the reason, in a sentence


@filed("pa10cal-fleet/1", "fleet/fleet.json", by="fleet_summary")
class FleetRecord(Record):
    """A fleet: every campaign, and every arm with those first that need attention."""

    # campaigns by what became of them: their grade, `refused`, `fault` or `ended`
    counts: Mapping[Annotated[str, Key("word")], int]
    arms: tuple[FleetArm, ...]  # every arm, those first that need attention
    campaigns: tuple[FleetCampaign, ...]  # every campaign, in the table's order

    @property
    def last_by_accuracy(self) -> list[FleetCampaign]:
        """Return the last campaign of every arm of which errors are known, most accurate first.

        Errors of held-out and of fitted poses (`over`) are ranked together.
        """
        last = {each.last for each in self.arms}
        known = [
            each
            for each in self.campaigns
            if each.campaign in last and None not in (each.became.before_mm, each.became.after_mm)
        ]
        return sorted(known, key=lambda each: (each.became.after_mm or 0.0, each.campaign))


#: Models of the table, each with what the one before lacks.
MeasuredModel = Literal["nominal", "geometry", "springs", "effects"]


class HeldOutError(Part):
    """Position error over held-out poses."""

    mean_mm: float  # mean [mm]
    rms_mm: float  # root mean square [mm]


ErrorsByModel = Mapping[Annotated[MeasuredModel, Key("model")], HeldOutError]


class Carried(Part):
    """A model of another campaign in this one, where base and tool alone are fitted."""

    source: str  # campaign that the model is of
    message: str | None = optional()  # why it was not carried over
    errors: ErrorsByModel  # errors by model; empty where it was not


class MeasuredRobot(Part):
    """One campaign of a real robot, or several of one as a group."""

    campaign: str  # name of its folder, or of the group
    members: tuple[str, ...] | None = optional()  # campaigns of the group
    robot: str | None = optional()  # what the arm is called
    instrument: str | None = optional()  # what measured it
    status: ChainStatus  # what became of it, as in `chain.json`
    message: str | None = optional()  # stage and message, where it was refused or failed
    poses: int | None = optional()  # number of configurations, held-out ones included
    held_out: int | None = optional()  # number of held-out configurations
    grade: Grade | None = optional()  # of the calibration
    verdict: Verdict | None = optional()  # of the search for missing effects
    names: tuple[str, ...]  # effects named, each with its alternatives
    faults: tuple[str, ...]  # faults of the log, kind and place
    # held-out errors by model: `nominal`, base and tool fitted; `geometry`; `springs` too;
    # `effects` too. One that does not apply is absent
    errors: ErrorsByModel
    carried: tuple[Carried, ...]  # models of other campaigns in this one
    # what the owner or somebody else reports of these data, with its source
    published: str | None = optional()


@filed("pa10cal-measured-robots/1", "measured/measured.json", by="measured")
class MeasuredRobotsRecord(Record):
    """Campaigns of real robots at hand, with their errors by model."""

    robots: tuple[MeasuredRobot, ...]  # every campaign and group at hand


class Caption(Part):
    """What pages say of a picture."""

    title: str  # what it is called
    text: str  # what to see in it
    section: str  # section of a campaign's page that shows it


@filed("pa10cal-pictures/1", "pictures.json", by="figures")
class PicturesRecord(Record):
    """Pictures and tables of a campaign or study: which were drawn, and why others were not."""

    campaign: str | None = optional()  # name of the campaign, where they are of one
    drawn: tuple[str, ...]  # names of the pictures and tables drawn
    omitted: Mapping[Annotated[str, Key("name")], str]  # why each of the others was not drawn
    # what pages say of each picture and table drawn
    captions: Mapping[Annotated[str, Key("name")], Caption] | None = optional()
