"""`evaluation/iso9283.json`: pose accuracy and repeatability after ISO 9283."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

from pydantic import Field

from pa10cal.results.record import (
    Column,
    CountColumn,
    FlagColumn,
    Key,
    LabelColumn,
    MeasuredRecord,
    Part,
    Table,
    VectorColumn,
    optional,
)


class RepeatabilityRows(Table):
    """Pose repeatability RP of configurations; it does not depend on a model."""

    kind: LabelColumn = Field(description="`grid`: used for the fit, or `holdout`: held out")
    pose: LabelColumn = Field(description="label of the pose")
    load_N: Column = Field(description="load [N]")
    repeats: CountColumn = Field(description="readings of it")
    one_direction: FlagColumn = Field(
        description="whether every joint arrived from the same side in all of them, as the "
        "standard has it"
    )
    RP_mm: Column = Field(
        description="RP_l: mean distance from the mean position, and three standard deviations [mm]"
    )
    RP_deg: VectorColumn | None = Field(
        description="RP_a, RP_b, RP_c: three standard deviations of the rotations about the base's "
        "x, y and z [deg]; null where the instrument measures no attitude"
    )


class AccuracyRows(Table):
    """Pose accuracy AP of configurations: mean attained less commanded pose."""

    pose: LabelColumn = Field(description="label of the pose")
    load_N: Column = Field(description="load [N]")
    AP_mm: Column = Field(description="AP_p: distance of the mean attained from the command [mm]")
    AP_xyz_mm: VectorColumn = Field(description="AP_x, AP_y, AP_z along the base's axes [mm]")
    AP_deg: VectorColumn | None = Field(
        description="AP_a, AP_b, AP_c: rotations about the base's x, y and z [deg]; null where the "
        "instrument measures no attitude"
    )


class PoseAccuracy(Part):
    """Pose accuracy when poses are commanded with one model."""

    AP_mean_mm: float = Field(description="mean of AP_p over configurations [mm]")
    AP_largest_mm: float = Field(description="largest AP_p [mm]")
    AP_mean_deg: float | None = Field(
        description="mean angle of the rotation from the command [deg]; null where the instrument "
        "measures no attitude"
    )
    AP_largest_deg: float | None = Field(description="largest such angle [deg]; null likewise")
    rows: AccuracyRows = Field(description="every configuration, in the order of `repeatability`")


class Iso9283Record(MeasuredRecord):
    """`evaluation/iso9283.json`."""

    SCHEMA: ClassVar[str] = "pa10cal-iso9283/1"
    FILE: ClassVar[str] = "evaluation/iso9283.json"
    COMMAND: ClassVar[str] = "evaluate"

    calibration: str = Field(description="load case of the calibration judged")
    repeatability: RepeatabilityRows | None = optional(
        "repeatability of configurations; not given where `note` says why"
    )
    accuracy: Mapping[Annotated[str, Key("model")], PoseAccuracy] | None = optional(
        "accuracy by the model that commands: `uncalibrated`, `geometry`, `linear`, `cubic`, "
        "`extended`; not given where `note` says why"
    )
    note: str | None = optional("why there is neither in it")
