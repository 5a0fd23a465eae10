"""`evaluation/holdout.json` and `evaluation/transfer_<campaign>.json`: models on other poses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from pa10cal.results.record import (
    Column,
    CountColumn,
    FlagColumn,
    Key,
    LabelColumn,
    LoadKey,
    MeasuredRecord,
    Part,
    Table,
    Vector3,
    VectorColumn,
    filed,
    optional,
)

# Errors of a model over configurations, and configuration by configuration.


class Distances(Part):
    """Position errors over a set of configurations."""

    mean_mm: float = Field(description="mean position error, at the end-effector frame [mm]")
    peak_mm: float = Field(description="largest position error [mm]")
    rms_mm: float = Field(description="root mean square position error [mm]")


class Accuracy(Distances):
    """Errors over a set of configurations."""

    orientation_deg: float | None = Field(
        description="mean angle between predicted and measured orientation [deg]; null where the "
        "instrument measures no orientation"
    )
    configurations: int = Field(description="number of configurations")


def mean_and_peak(whole: Accuracy, trusted: Accuracy | None) -> str:
    """Return mean and largest error in words, those with readings flagged as wrong apart.

    Args:
        whole: over all configurations.
        trusted: without those that have such a reading; None where none has.
    """
    text = f"{whole.mean_mm:.3f}/{whole.peak_mm:.3f} mm"
    if trusted is None:
        return text
    count = whole.configurations - trusted.configurations
    return f"{trusted.mean_mm:.3f}/{trusted.peak_mm:.3f} mm; with {flagged(count)} {text}"


def flagged(count: int) -> str:
    """Return how many readings are flagged as wrong, repeats of a configuration averaged."""
    return f"{count} reading{'s' * (count > 1)} flagged as wrong"


class BeforeAfter(Part):
    """Errors of one set of configurations under two models."""

    before: Accuracy = Field(description="errors before")
    after: Accuracy = Field(description="errors after")


class ResidualRows(Table):
    """Residuals of configurations: predicted minus measured, along the base axes."""

    pose: LabelColumn = Field(description="label of the pose")
    load_N: Column = Field(description="load [N]")
    place_mm: VectorColumn = Field(description="predicted position in the base frame [mm]")
    position_mm: VectorColumn = Field(description="position residual along the base axes [mm]")
    rotation_deg: VectorColumn | None = Field(
        description="rotation residual, axis times angle, along the base axes [deg]; null where "
        "the instrument measures no orientation"
    )


class Estimate(Part):
    """A number with its standard uncertainty."""

    value: float = Field(description="value")
    std: float | None = Field(description="standard uncertainty; null where it is not known")


class EffectParameter(Part):
    """An estimated parameter of an effect."""

    value: float = Field(description="value, in `unit`")
    std: float = Field(description="standard uncertainty, in `unit`")
    unit: str = Field(description="unit of `value` and `std`")


class Parameter(Part):
    """An estimated parameter of a model."""

    value: float = Field(description="value, in `unit`")
    std: float | None = Field(
        description="standard uncertainty, in `unit`; the tolerance where the data do not identify "
        "the parameter, null where it has none"
    )
    unit: str = Field(description="unit of `value`, `std` and `tolerance`")
    tolerance: float | None = Field(
        description="manufacturing tolerance, in `unit`; null where there is none"
    )
    identifiable: bool = Field(description="whether the data identify it")


Status = Literal["converged", "not converged"]


class ToolTwist(Part):
    """The constant rotation of the tool that explains most of the orientation error."""

    rotation_deg: Vector3 = Field(description="axis times angle in the end-effector frame [deg]")
    angle_deg: float = Field(description="its angle [deg]")
    before_deg: float = Field(description="mean orientation error without it [deg]")
    after_deg: float = Field(description="mean orientation error with it taken off [deg]")


class HeldOutRows(Table):
    """Residuals of held-out configurations: predicted minus measured, along the base axes."""

    pose: LabelColumn = Field(description="label of the pose")
    load_N: Column = Field(description="load [N]")
    position_mm: VectorColumn = Field(description="position residual along the base axes [mm]")
    error_mm: Column = Field(description="position error [mm]")
    rotation_deg: VectorColumn | None = Field(
        description="rotation residual, axis times angle, along the base axes [deg]; null where "
        "the instrument measures no orientation"
    )
    extrapolated: FlagColumn | None = Field(
        description="whether a joint leaves the angles that the fit has seen; null where the model "
        "does not depend on that"
    )


class HeldOutModel(Accuracy):
    """One model on held-out configurations."""

    per_load: Mapping[LoadKey, Accuracy] = Field(description="errors at each load")
    per_point: Mapping[Annotated[str, Key("pose")], Accuracy] = Field(
        description="errors at each point; empty where there are very many"
    )
    tool_twist: ToolTwist | None = Field(
        description="rotation of the tool that the errors show; null without orientations"
    )
    inside: Accuracy | None = Field(
        description="errors inside the joint angles that the fit has seen; null where the model "
        "does not depend on that, or no configuration is"
    )
    outside: Accuracy | None = Field(description="errors outside them; null likewise")
    trusted: Accuracy | None = optional(
        "errors without configurations that have a suspected reading; not given where none has"
    )
    rows: HeldOutRows = Field(description="every held-out configuration")


_Models = Mapping[Annotated[str, Key("model")], HeldOutModel]


class PartOfCampaign(Part):
    """A part of a campaign in which instrument or base moved at once; it has its own base."""

    from_s: float = Field(alias="from", description="time of its first reading [s]")
    to_s: float = Field(alias="to", description="time of its last reading [s]")
    poses: int = Field(description="calibration poses, to which its base was fitted")
    held_out: int = Field(description="configurations held out")
    moved_by_mm: float | None = Field(
        description="how far positions moved from the part before, root mean square over all "
        "calibration poses [mm]; null of the first"
    )
    turned_by_mrad: float | None = Field(
        description="by how much the base turned then [mrad]; null of the first"
    )


@filed("pa10cal-holdout/1", "evaluation/holdout.json", by="evaluate")
class HoldoutRecord(MeasuredRecord):
    """`evaluation/holdout.json`."""

    calibration: str = Field(description="load case of the calibration judged")
    configurations: int = Field(description="held-out configurations")
    models: _Models = Field(
        description="errors by model: `uncalibrated`, `geometry` (without springs), `linear`, "
        "`cubic`, `extended` (with the effects that discovery named)"
    )
    parts: tuple[PartOfCampaign, ...] | None = optional(
        "parts before and after steps in time that the verdict tells; not given where it tells none"
    )
    by_parts: Mapping[Annotated[str, Key("model")], Accuracy] | None = optional(
        "errors by model with base and tool fitted anew, a base for every part"
    )
    note: str | None = optional("why there is no model in it")


@filed("pa10cal-transfer/1", "evaluation/transfer_<campaign>.json", by="transfer")
class TransferRecord(MeasuredRecord):
    """`evaluation/transfer_<campaign>.json`."""

    from_: str = Field(alias="from", description="campaign in which the models were calibrated")
    configurations: int = Field(description="held-out configurations of this campaign")
    models: _Models = Field(
        description="errors by model, base and tool fitted in this campaign: `uncalibrated`, "
        "`geometry`, `linear`, `extended`; a base for every one of `parts`"
    )
    parts: tuple[PartOfCampaign, ...] | None = optional(
        "parts before and after instrument or base moved at once, as the calibration poses show; "
        "not given where nothing moved"
    )
    one_base: Mapping[Annotated[str, Key("model")], Accuracy] | None = optional(
        "errors by model with one base for all parts"
    )


# `evaluation/iso9283.json`: pose accuracy and repeatability after ISO 9283.


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
        "x, y and z [deg]; null where the instrument measures no orientation"
    )


class AccuracyRows(Table):
    """Pose accuracy AP of configurations: mean attained less commanded pose."""

    pose: LabelColumn = Field(description="label of the pose")
    load_N: Column = Field(description="load [N]")
    AP_mm: Column = Field(description="AP_p: distance of the mean attained from the command [mm]")
    AP_xyz_mm: VectorColumn = Field(description="AP_x, AP_y, AP_z along the base's axes [mm]")
    AP_deg: VectorColumn | None = Field(
        description="AP_a, AP_b, AP_c: rotations about the base's x, y and z [deg]; null where the "
        "instrument measures no orientation"
    )


class PoseAccuracy(Part):
    """Pose accuracy when poses are commanded with one model."""

    AP_mean_mm: float = Field(description="mean of AP_p over configurations [mm]")
    AP_largest_mm: float = Field(description="largest AP_p [mm]")
    AP_mean_deg: float | None = Field(
        description="mean angle of the rotation from the command [deg]; null where the instrument "
        "measures no orientation"
    )
    AP_largest_deg: float | None = Field(description="largest such angle [deg]; null likewise")
    rows: AccuracyRows = Field(description="every configuration, in the order of `repeatability`")


@filed("pa10cal-iso9283/1", "evaluation/iso9283.json", by="evaluate")
class Iso9283Record(MeasuredRecord):
    """`evaluation/iso9283.json`."""

    calibration: str = Field(description="load case of the calibration judged")
    repeatability: RepeatabilityRows | None = optional(
        "repeatability of configurations; not given where `note` says why"
    )
    accuracy: Mapping[Annotated[str, Key("model")], PoseAccuracy] | None = optional(
        "accuracy by the model that commands: `uncalibrated`, `geometry`, `linear`, `cubic`, "
        "`extended`; not given where `note` says why"
    )
    note: str | None = optional("why there is neither in it")
