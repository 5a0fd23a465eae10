"""Many campaigns of many arms: what became of each, and of the fleet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from pa10cal.results.record import CampaignRecord, Key, Part, Record, filed, optional

#: What became of a campaign.
ChainStatus = Literal["done", "refused", "fault"]
#: Why an arm needs attention, the most urgent first.
Attention = Literal["no_result", "input", "moved", "incomplete", "none"]


@filed("pa10cal-chain/1", "chain.json", by="chain")
class ChainRecord(CampaignRecord):
    """What became of one campaign of many: done, or where it ended and why."""

    status: ChainStatus = Field(
        description="`done`; `refused` where a stage refused its input; `fault` where one failed"
    )
    stage: str | None = optional("the stage that refused or failed")
    message: str | None = optional("what it said")
    robot: str | None = optional("the arm's description")
    provenance: str | None = optional("where its data come from, in its own words")
    grade: str | None = optional("of the calibration")
    line: str | None = optional("the sentence of the grade")
    verdict: str | None = optional("of the search for missing effects")
    notes: tuple[str, ...] | None = optional("effects, faults and what is unexplained, a line each")
    before_mm: float | None = optional("mean position error of the uncalibrated arm [mm]")
    after_mm: float | None = optional("mean position error of the final model [mm]")
    over: str | None = optional("poses that both are of: `held-out poses` or `fitted poses`")


class FleetCampaign(Part):
    """One campaign of the fleet."""

    arm: str = Field(description="which arm it measured")
    campaign: str = Field(description="name of its folder")
    measured: str | None = optional("when it was measured, as the table of campaigns says")
    became: ChainRecord = Field(description="its `chain.json`")
    agrees: bool | None = optional("whether its model agrees with the arm's campaign before it")
    moved: str | None = optional(
        "which parameters moved since the arm's campaign before it, and by how much its model "
        "differs"
    )


class FleetArm(Part):
    """One arm: how it stands after its last campaign."""

    arm: str = Field(description="which arm")
    campaigns: int = Field(description="campaigns of it")
    last: str = Field(description="the last of them")
    attention: Attention = Field(
        description="`no_result`: the last campaign gave none; `input`: its grade or verdict says "
        "that something in the data is wrong, or the fit did not converge; `moved`: its model "
        "differs from the one before by more than chance; `incomplete`: an effect is missing "
        "that has no single name; or `none`"
    )
    why: str = Field(description="the reason, in a sentence")


@filed("pa10cal-fleet/1", "fleet/fleet.json", by="fleet_summary")
class FleetRecord(Record):
    """A fleet: every campaign, and every arm with those first that need attention."""

    counts: Mapping[Annotated[str, Key("word")], int] = Field(
        description="campaigns by what became of them: their grade, `refused` or `fault`"
    )
    arms: tuple[FleetArm, ...] = Field(description="every arm, those first that need attention")
    campaigns: tuple[FleetCampaign, ...] = Field(description="every campaign, in the table's order")

    @property
    def judged(self) -> list[FleetCampaign]:
        """Return the last campaign of every arm of which errors are known, most accurate first."""
        last = {each.last for each in self.arms}
        known = [
            (each.became.after_mm, each.campaign, each)
            for each in self.campaigns
            if each.campaign in last
            and each.became.before_mm is not None
            and each.became.after_mm is not None
        ]
        return [each for *_, each in sorted(known, key=lambda row: row[:2])]


# `measured/measured.json`: the campaigns of real robots that are at hand, in one table.

#: Models of the table, each with what the one before lacks.
MeasuredModel = Literal["nominal", "geometry", "springs", "effects"]


class HeldOutError(Part):
    """Position error over held-out poses."""

    mean_mm: float = Field(description="mean [mm]")
    rms_mm: float = Field(description="root mean square [mm]")


ErrorsByModel = Mapping[Annotated[MeasuredModel, Key("model")], HeldOutError]


class Carried(Part):
    """A model of another campaign in this one, where base and tool alone are fitted."""

    source: str = Field(description="campaign that the model is of")
    message: str | None = optional("why it was not carried over")
    errors: ErrorsByModel = Field(description="errors by model; empty where it was not")


class MeasuredRobot(Part):
    """One campaign of a real robot, or several of one as a group."""

    campaign: str = Field(description="name of its folder, or of the group")
    members: tuple[str, ...] | None = optional("campaigns of the group")
    robot: str | None = optional("what the arm is called")
    instrument: str | None = optional("what measured it")
    status: ChainStatus = Field(description="what became of it, as in `chain.json`")
    message: str | None = optional("stage and message, where it was refused or failed")
    poses: int | None = optional("configurations fitted and held out")
    held_out: int | None = optional("configurations held out")
    grade: str | None = optional("of the calibration")
    verdict: str | None = optional("of the search for missing effects")
    names: tuple[str, ...] = Field(description="effects named, each with its alternatives")
    faults: tuple[str, ...] = Field(description="faults of the log, kind and place")
    errors: ErrorsByModel = Field(
        description="held-out errors by model: `nominal`, base and tool fitted; `geometry`; "
        "`springs` too; `effects` too. One that does not apply is absent"
    )
    carried: tuple[Carried, ...] = Field(description="models of other campaigns in this one")
    published: str | None = optional(
        "what the owner or somebody else reports of these data, with its source"
    )


@filed("pa10cal-measured-robots/1", "measured/measured.json", by="measured")
class MeasuredRobotsRecord(Record):
    """`measured/measured.json`."""

    robots: tuple[MeasuredRobot, ...] = Field(description="every campaign and group at hand")


# `pictures.json`: which pictures and tables were drawn, and why the others were not.


class Caption(Part):
    """What pages say of a picture."""

    title: str = Field(description="what it is called")
    text: str = Field(description="what to see in it")
    section: str = Field(description="section of a campaign's page that shows it")


@filed("pa10cal-pictures/1", "pictures.json", by="figures")
class PicturesRecord(Record):
    """`pictures.json` of a campaign or study."""

    campaign: str | None = optional("name of the campaign, where they are of one")
    drawn: tuple[str, ...] = Field(description="names of the pictures and tables drawn")
    omitted: Mapping[Annotated[str, Key("name")], str] = Field(
        description="why each of the others was not drawn"
    )
    captions: Mapping[Annotated[str, Key("name")], Caption] | None = optional(
        "what pages say of each picture and table drawn"
    )
