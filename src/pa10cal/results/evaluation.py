"""`evaluation/holdout.json` and `evaluation/transfer_<campaign>.json`: models on other poses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from pa10cal.results import arrays, record


class Distances(record.Part):
    """Position errors over a set of configurations."""

    mean_mm: float  # mean position error, at the end-effector frame [mm]
    peak_mm: float  # largest position error [mm]
    rms_mm: float  # root mean square position error [mm]


class Accuracy(Distances):
    """Errors over a set of configurations."""

    # mean angle between predicted and measured orientation [deg]; null where the instrument
    # measures no orientation
    orientation_deg: float | None
    configurations: int  # number of configurations


#: Where held-out poses of a path lie, in words.
UNSEEN, BETWEEN = "at unseen stretches", "between measured places"


class PartAccuracy(Accuracy):
    """Errors over a part of the configurations."""

    # errors without configurations that have a suspected reading; not given where none has
    trusted: Accuracy | None = record.optional()


def mean_and_peak(whole: Accuracy, trusted: Accuracy | None) -> str:
    """Return mean and largest error in words: whole, and without readings far from the model."""
    text = f"{whole.mean_mm:.3f}/{whole.peak_mm:.3f} mm"
    if trusted is None:
        return text
    count = whole.configurations - trusted.configurations
    less = f"{trusted.mean_mm:.3f}/{trusted.peak_mm:.3f} mm"
    return f"{text}; without {flagged(count)} {less}"


def flagged(count: int) -> str:
    """Return how many readings are far from the model, repeats of a configuration averaged."""
    return f"{count} reading{'s' * (count > 1)} far from the model"


class BeforeAfter(record.Part):
    """Errors of one set of configurations under two models."""

    before: Accuracy  # errors before
    after: Accuracy  # errors after


class ResidualRows(record.Table):
    """Residuals of configurations: predicted minus measured, along the base axes."""

    pose: arrays.LabelColumn  # label of the pose
    load_N: arrays.Column  # load [N]
    place_mm: arrays.VectorColumn  # predicted position in the base frame [mm]
    position_mm: arrays.VectorColumn  # position residual along the base axes [mm]
    # rotation residual, axis times angle, along the base axes [deg]; null where the instrument
    # measures no orientation
    rotation_deg: arrays.VectorColumn | None


class Estimate(record.Part):
    """A number with its standard uncertainty."""

    value: float  # value
    std: float | None  # standard uncertainty; null where it is not known


class EffectParameter(record.Part):
    """An estimated parameter of an effect."""

    value: float  # value, in `unit`
    std: float  # standard uncertainty, in `unit`
    unit: str  # unit of `value` and `std`


class Parameter(record.Part):
    """An estimated parameter of a model."""

    value: float  # value, in `unit`
    # standard uncertainty, in `unit`; the tolerance where the data do not identify the parameter,
    # null where it has none
    std: float | None
    unit: str  # unit of `value`, `std` and `tolerance`
    tolerance: float | None  # manufacturing tolerance, in `unit`; null where there is none
    identifiable: bool  # whether the data identify it


Status = Literal["converged", "not converged"]


class ToolTwist(record.Part):
    """The constant rotation of the tool that explains most of the orientation error."""

    rotation_deg: arrays.Vector3  # axis times angle in the end-effector frame [deg]
    angle_deg: float  # its angle [deg]
    before_deg: float  # mean orientation error without it [deg]
    after_deg: float  # mean orientation error with it taken off [deg]


class HeldOutRows(record.Table):
    """Residuals of held-out configurations: predicted minus measured, along the base axes."""

    pose: arrays.LabelColumn  # label of the pose
    load_N: arrays.Column  # load [N]
    position_mm: arrays.VectorColumn  # position residual along the base axes [mm]
    error_mm: arrays.Column  # position error [mm]
    # rotation residual, axis times angle, along the base axes [deg]; null where the instrument
    # measures no orientation
    rotation_deg: arrays.VectorColumn | None
    # whether a joint leaves the angles that the fit has seen; null where the model does not depend
    # on that
    extrapolated: arrays.FlagColumn | None


class HeldOutModel(PartAccuracy):
    """One model on held-out configurations."""

    per_load: Mapping[record.LoadKey, Accuracy]  # errors at each load
    # errors at each point; empty where there are very many
    per_point: Mapping[Annotated[str, record.Key("pose")], Accuracy]
    # rotation of the tool that the errors show; null without orientations
    tool_twist: ToolTwist | None
    # errors inside the joint angles that the fit has seen; null where the model does not depend on
    # that, or no configuration is
    inside: Accuracy | None
    outside: Accuracy | None  # errors outside them; null likewise
    # errors at stretches of a path where no pose was fitted; not given where poses are well apart
    unseen: PartAccuracy | None = record.optional()
    # errors beside poses of the fit, nearer than 3 % of the spread; not given where none is
    between: PartAccuracy | None = record.optional()
    # errors with the torques of the weights, as predictions have them; not given where the model
    # was not fitted to logged torques
    by_weights: Accuracy | None = record.optional()
    rows: HeldOutRows  # every held-out configuration

    @property
    def by_place(self) -> dict[str, PartAccuracy]:
        """Return errors by where the poses lie, in words, the first for a headline.

        Of poses well apart all errors, without a word.
        """
        parts = {UNSEEN: self.unseen, BETWEEN: self.between}
        return {words: part for words, part in parts.items() if part is not None} or {"": self}


_Models = Mapping[record.ModelKey, HeldOutModel]


class PartOfCampaign(record.Part):
    """A part of a campaign in which instrument or base moved suddenly; it has its own base."""

    from_s: float = Field(alias="from")  # time of its first reading [s]
    to_s: float = Field(alias="to")  # time of its last reading [s]
    poses: int  # calibration poses, to which its base was fitted
    held_out: int  # configurations held out
    # how far positions moved from the part before, root mean square over all calibration poses
    # [mm]; null of the first
    moved_by_mm: float | None
    turned_by_mrad: float | None  # by how much the base turned then [mrad]; null of the first


@record.filed("pa10cal-holdout/1", "evaluation/holdout.json", by="evaluate")
class HoldoutRecord(record.MeasuredRecord):
    """`evaluation/holdout.json`."""

    calibration: str  # load case of the calibration judged
    configurations: int  # held-out configurations
    # errors by model: `uncalibrated`, `geometry` (without springs), `linear`, `cubic`, `extended`
    # (with the effects that discovery named)
    models: _Models
    # parts before and after steps in time that the verdict tells; not given where it tells none
    parts: tuple[PartOfCampaign, ...] | None = record.optional()
    # errors by model with base and tool fitted anew, a base for every part
    by_parts: Mapping[record.ModelKey, Accuracy] | None = record.optional()
    note: str | None = record.optional()  # why there is no model in it


@record.filed("pa10cal-transfer/1", "evaluation/transfer_<campaign>.json", by="transfer")
class TransferRecord(record.MeasuredRecord):
    """`evaluation/transfer_<campaign>.json`."""

    from_: str = Field(alias="from")  # campaign in which the models were calibrated
    configurations: int  # held-out configurations of this campaign
    # errors by model, base and tool fitted in this campaign: `uncalibrated`, `geometry`, `linear`,
    # `extended`; a base for every one of `parts`
    models: _Models
    # parts before and after instrument or base moved suddenly, as the calibration poses show; not
    # given where nothing moved
    parts: tuple[PartOfCampaign, ...] | None = record.optional()
    # errors by model with one base for all parts
    one_base: Mapping[record.ModelKey, Accuracy] | None = record.optional()
    # which models are worse here than the nominal arm, one sentence; not given where none is
    worse: str | None = record.optional()


# `evaluation/iso9283.json`: pose accuracy and repeatability after ISO 9283.


class RepeatabilityRows(record.Table):
    """Pose repeatability RP of configurations; it does not depend on a model."""

    kind: arrays.LabelColumn  # `grid`: used for the fit, or `holdout`: held out
    pose: arrays.LabelColumn  # label of the pose
    load_N: arrays.Column  # load [N]
    # readings of it; those before and after a sudden motion of base or instrument, as the verdict
    # has it, have rows of their own
    repeats: arrays.CountColumn
    # whether every joint that moved arrived from the same side in all of them, as the standard has
    # it: by the log, or by the order of the poses; null where neither tells it of all
    # configurations, the first reading of each aside
    one_direction: arrays.FlagColumn | None
    # RP_l: mean distance from the mean position, and three standard deviations [mm]; of several
    # targets of the mean of those seen in all repeats, whose noise is less than that of one
    RP_mm: arrays.Column
    # RP_a, RP_b, RP_c: three standard deviations of the rotations about the base's x, y and z
    # [deg]; null where the instrument measures no orientation
    RP_deg: arrays.VectorColumn | None


class AccuracyRows(record.Table):
    """Pose accuracy AP of configurations: mean attained less commanded pose."""

    pose: arrays.LabelColumn  # label of the pose
    load_N: arrays.Column  # load [N]
    AP_mm: arrays.Column  # AP_p: distance of the mean attained from the command [mm]
    AP_xyz_mm: arrays.VectorColumn  # AP_x, AP_y, AP_z along the base's axes [mm]
    # AP_a, AP_b, AP_c: rotations about the base's x, y and z [deg]; null where the instrument
    # measures no orientation
    AP_deg: arrays.VectorColumn | None


class PoseAccuracy(record.Part):
    """Pose accuracy when poses are commanded with one model."""

    AP_mean_mm: float  # mean of AP_p over configurations [mm]
    AP_largest_mm: float  # largest AP_p [mm]
    # mean angle of the rotation from the command [deg]; null where the instrument measures no
    # orientation
    AP_mean_deg: float | None
    AP_largest_deg: float | None  # largest such angle [deg]; null likewise
    rows: AccuracyRows  # every configuration, in the order of `repeatability`


@record.filed("pa10cal-iso9283/1", "evaluation/iso9283.json", by="evaluate")
class Iso9283Record(record.MeasuredRecord):
    """`evaluation/iso9283.json`."""

    calibration: str  # load case of the calibration judged
    # repeatability of configurations; not given where `note` says why
    repeatability: RepeatabilityRows | None = record.optional()
    # accuracy by the model that commands: `uncalibrated`, `geometry`, `linear`, `cubic`,
    # `extended`; not given where `note` says why
    accuracy: Mapping[record.ModelKey, PoseAccuracy] | None = record.optional()
    note: str | None = record.optional()  # why there is neither in it
