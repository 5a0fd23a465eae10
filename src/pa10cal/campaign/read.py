"""The folder of a campaign read to single readings, held-out poses marked as it states them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from pa10cal.arm.description import Arm
from pa10cal.campaign.bounds import refuse_impossible_tool
from pa10cal.campaign.description import (
    DESCRIPTION_FILE,
    CampaignDescription,
    nominal_arm,
    read_description,
)
from pa10cal.campaign.held_out import with_held_out
from pa10cal.campaign.joint_positions import label_warnings, places_of
from pa10cal.campaign.raw_rows import Quarantined
from pa10cal.campaign.screens import (
    HELD,
    OFF_MODEL,
    OFF_REPEATS,
    OTHER_COMMAND,
    OUT_OF_REACH,
    STAND_DISAGREES,
)
from pa10cal.campaign.table import arm_of
from pa10cal.campaign.target_labels import EXCHANGED, NOT_RIGID
from pa10cal.campaign.touched import read_touched
from pa10cal.campaign.tracked import read_tracked
from pa10cal.errors import RawDataError
from pa10cal.files.controller import controller_notes, controller_warnings
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import with_time_validity
from pa10cal.options import IngestOptions
from pa10cal.results.calibration import InputFinding

LINES = ("line_x", "line_y")
#: Reasons of readings that are wrong. Rows quarantined for other reasons are merely missing.
_WRONG = (OFF_REPEATS, STAND_DISAGREES, OFF_MODEL, NOT_RIGID, OUT_OF_REACH, OTHER_COMMAND)


@dataclass(frozen=True)
class Campaign:
    """A measurement campaign as it was read."""

    folder: Path
    description: CampaignDescription  # the content of campaign.yaml
    arm: Arm  # the nominal arm that it names
    observations: Observations  # single readings of all kinds, in order of time
    quarantined: tuple[Quarantined, ...]  # rows that are not used, each with file, line and reason
    notes: tuple[str, ...]  # what the user should know, one clause each
    warnings: tuple[str, ...]  # what the user should correct first, one sentence each

    @property
    def name(self) -> str:
        """Return its name."""
        return self.description.name

    @cached_property
    def wrong_rows(self) -> tuple[InputFinding, ...]:
        """Return the configurations that were quarantined because they are wrong."""
        return wrong_rows(self.quarantined)

    @cached_property
    def calibration(self) -> Observations:
        """Return single readings of the poses to calibrate with, ordered by pose and load."""
        return self.observations.of_kind("grid")

    @cached_property
    def held_out(self) -> Observations:
        """Return single readings of the poses held out, ordered by pose and load."""
        return self.observations.of_kind("holdout")

    @cached_property
    def lines(self) -> tuple[Observations, Observations]:
        """Return single readings of the straight moves along the base's x and y axes."""
        line_x, line_y = (self.observations.of_kind(kind) for kind in LINES)
        return line_x, line_y

    @property
    def summary(self) -> str:
        """Return in one line what was read."""
        spreads_mm = repeatability_mm(self.calibration).items()
        repeatability = ", ".join(f"{spread:.3f} mm at {load:g} N" for load, spread in spreads_mm)
        parts = [
            f"{len(self.observations)} configurations",
            *self.observations.measured.counts,
            f"{len(self.quarantined)} rows quarantined",
            f"repeatability {repeatability or 'unknown'}",
            *self.notes,
        ]
        return f"{self.name}: {'; '.join(parts)}"

    def __repr__(self) -> str:
        return f"<Campaign {self.summary}>"

    def _repr_html_(self) -> str:
        """Return a table for notebooks: kinds of poses, instrument, arm, and what is not used."""

        def count(readings: Observations) -> str:
            return f"{len(readings)} readings of {len(set(readings.pose))} poses"

        rows = {
            "robot": self.arm.title,
            "instrument": self.description.instrument.kind,
            "calibration": count(self.calibration),
            "held out": count(self.held_out),
            "straight moves": " and ".join(map(count, self.lines)),
            "quarantined": f"{len(self.quarantined)} rows",
            "notes": "; ".join(self.notes) or "none",
        }
        return pd.Series(rows, name=self.name).to_frame().to_html()


def read_campaign(
    folder: Path | str, options: IngestOptions | None = None, *, arms: Path | str | None = None
) -> Campaign:
    """Read a measurement campaign: its raw files to single readings, held-out poses marked.

    Args:
        folder: the campaign's folder, with `campaign.yaml` and the raw files that it names.
        options: how to ingest; None for the defaults.
        arms: folder of arm descriptions; None for `arms` beside the campaign's folder.

    Raises:
        RawDataError: when the description or a file, or too much of it, cannot be used, when there
            is no `grid` row, or when the arm has prismatic joints and its log gives degrees.
        SettingsError: when a key of the description does not fit.
    """
    folder = Path(folder)
    description = read_description(folder)
    _refuse_group(description, folder)
    arm = nominal_arm(description, folder, None if arms is None else Path(arms))
    refuse_impossible_tool(description.tool.mass_kg, arm, str(folder / DESCRIPTION_FILE))
    instrument, options = description.instrument.type, options or IngestOptions()
    if instrument.from_touches:
        _refuse_prismatic(arm, folder)
    read = read_touched if instrument.from_touches else read_tracked
    ingested = read(description, arm, folder, options)
    every, tolerance = ingested.observations, description.repeat_tolerance_deg
    places = places_of(every, arm.prismatic, tolerance)
    every, holdout_notes, warnings = with_held_out(
        every, description.holdout, f"{folder / DESCRIPTION_FILE}: holdout", places
    )
    warnings = (*ingested.warnings, *warnings, *label_warnings(every, places))
    recorded = ingested.timed and description.time_recorded
    every, time_notes = with_time_validity(every, arm.prismatic, recorded=recorded)
    kinds = set(every.kind)
    if "grid" not in kinds:
        raise RawDataError(
            "there is no usable grid row to calibrate with",
            where=str(folder),
            value=", ".join(sorted(kinds)),
            allowed="rows of kind grid",
            remedy="; ".join((*ingested.warnings, "check the column kind")),
        )
    arm_notes = (*arm.remarks, *controller_notes(arm.controller, arm))
    commanded = description.joints == "commanded"
    warnings = (*warnings, *controller_warnings(arm.controller, commanded=commanded))
    # Of an instrument that touches nothing lines are worth a word where there are some.
    lines = instrument.uses_lines and (every.measured.from_touches or kinds & {*LINES})
    useful = (*(LINES if lines else ()), "holdout")
    missing = [f"no {kind} rows" for kind in useful if kind not in kinds]
    return Campaign(
        folder,
        description,
        arm_of(description, folder, every, arm),
        every,
        tuple(sorted(ingested.quarantined)),
        (*ingested.notes, *holdout_notes, *arm_notes, *time_notes, *missing),
        warnings,
    )


def _refuse_group(description: CampaignDescription, folder: Path) -> None:
    """Refuse the folder of a group, which has no raw files of its own."""
    if description.campaigns:
        raise RawDataError(
            "the folder is of a group, which has no raw files of its own",
            where=str(folder / DESCRIPTION_FILE),
            value=", ".join(campaign.name for campaign in description.campaigns),
            allowed="the folder of one campaign",
            remedy="give the folders of its campaigns to read_group, or to pa10cal join",
        )


def _refuse_prismatic(arm: Arm, folder: Path) -> None:
    """Refuse an arm with prismatic joints where a resolver log gives positions in degrees."""
    if arm.prismatic.any():
        raise RawDataError(
            "the arm has prismatic joints",
            where=f"{folder / DESCRIPTION_FILE}: robot",
            value=arm.name,
            allowed="revolute joints, as the resolver log gives positions in degrees",
            remedy="give the poses in files.poses, with a column in millimetres for each of them",
        )


def repeatability_mm(single: Observations) -> dict[float, float]:
    """Return, for each load with repeats, the mean standard deviation of repeats in one pose.

    The deviation is of the distance from the mean of the repeats (paper, Section III): of the
    end-effector, of each target, or of the measured distance.
    """
    places_mm = 1e3 * single.measured.places_m
    targets, axes = places_mm.shape[1:]
    table = pd.DataFrame(places_mm.reshape(-1, axes)).assign(
        load_N=np.repeat(single.states.load_N, targets),
        pose=np.repeat(single.pose, targets),
        target=np.tile(np.arange(targets), len(single)),
    )
    groups = table.dropna(subset=[0]).groupby(["load_N", "pose", "target"])
    spread_mm = np.sqrt(groups.var()[groups.size() > 1].sum(axis=1))
    return {float(load): float(mm) for load, mm in spread_mm.groupby(level=0).mean().items()}


def wrong_rows(rows: Iterable[Quarantined]) -> tuple[InputFinding, ...]:
    """Return the configurations that were quarantined because they are wrong, each once."""
    findings: dict[tuple[str, str], InputFinding] = {}
    for row in sorted(rows):
        where = f"{row.file}: {row.place or f'line {row.line}'}"
        if row.reason.startswith(EXCHANGED):
            labels = row.reason.removeprefix(EXCHANGED).removeprefix(": ") or row.value
            kind, what = "target_label", f"the labels of {labels} seem exchanged there"
            remedy = "correct the labels of this configuration"
        elif row.reason == HELD:
            kind, what = "outlier", row.reason
            remedy = "measure it again, and write a row only when the instrument has a new reading"
        elif row.reason in _WRONG:
            kind, what = "outlier", row.reason
            remedy = "check the raw reading; measure it again or exclude it"
        else:
            continue
        what = f"{what}; its rows are quarantined"
        finding = InputFinding(
            kind=kind, where=where, what=what, remedy=remedy, would_leave_mm=None
        )
        findings.setdefault((where, kind), finding)
    return tuple(findings.values())
