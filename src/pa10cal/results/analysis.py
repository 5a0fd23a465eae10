"""`discovery/analysis.json`: all that the figures of discovery show."""

from __future__ import annotations

from pa10cal.results import arrays, record
from pa10cal.results.evaluation import Accuracy, Estimate


class PureErrorTest(record.Part):
    """Lack of fit against pure error."""

    chi_square: float  # weighted sum of squares
    dof: float  # its degrees of freedom
    pure_error_dof: float  # degrees of freedom of pure error
    F: float  # ratio of the mean squares
    p_value: float  # probability of a larger F without lack of fit


class ErrorPart(record.Part):
    """Position error over some cells or along one axis."""

    of: str  # load or axis
    rms_mm: float  # root mean square position error [mm]
    floor_mm: float  # root mean square error that noise leaves [mm]


class Arrival(record.Part):
    """Mean angle error of a joint that arrived from one side."""

    direction: int  # -1: the angle fell, +1: it rose
    mean_rad: float  # mean angle error [rad]
    std_rad: float | None  # its standard error [rad]; null where not known


class Periodogram(record.Part):
    """What sines of a joint's angle explain of its error."""

    orders: arrays.Column  # orders: periods a turn
    explained_rad: arrays.Column  # root mean square explained by each [rad]
    marked: arrays.Column  # orders at which drives err
    marked_rad: arrays.Column  # root mean square explained by these [rad]


class JointPart(record.Part):
    """Angle error of one joint, and cell by cell: readings of a pose that have been averaged."""

    joint: int  # joint, from 1
    rms_rad: float  # root mean square angle error [rad]
    floor_rad: float  # root mean square error that noise leaves [rad]
    arrivals: tuple[Arrival, ...]  # mean error by direction of arrival
    periodogram: Periodogram | None  # sines of the angle; null where poses are too few
    # of every cell, six digits; of a sample where there are very many
    q_rad: arrays.Column  # joint angle [rad]
    arrival: arrays.Column  # direction of arrival, from -1 to 1
    error_rad: arrays.Column  # angle error [rad]
    std_rad: arrays.Column  # its standard uncertainty [rad]
    # logged minus static torque [N m]; null where torques were not logged or no pose is repeated
    torque_residual_Nm: arrays.Column | None
    torque_noise_Nm: float | None  # standard deviation of its noise [N m]; null likewise


class Drift(record.Part):
    """Position error along one axis of the instrument, from one end of a range to the other."""

    axis: str  # `x`, `y` or `z`
    # over the time of the campaign [mm]; null where the cells have the same mean time
    with_time_mm: Estimate | None
    # over the range of temperature [mm]; null where it was not measured
    with_temperature_mm: Estimate | None


class LackOfFit(record.Part):
    """Where a model and the data disagree."""

    # what readings of a pose share, against pure error; null without repeats
    pure_error: PureErrorTest | None
    by_load: tuple[ErrorPart, ...]  # error by load
    by_axis: tuple[ErrorPart, ...]  # error along each axis of the instrument
    by_joint: tuple[JointPart, ...]  # angle error, and torque residual, of each joint
    drifts: tuple[Drift, ...]  # drift of the error along each axis


class NamingStep(record.Part):
    """Errors with the first few of the named effects in the model."""

    effects: tuple[record.EffectName, ...]  # effects in the model by then
    train: Accuracy  # errors over the poses fitted
    holdout: Accuracy | None  # errors over held-out poses; null without any


class GapRows(record.Table):
    """Residuals of configurations before and after, along the base axes."""

    pose: arrays.LabelColumn  # label of the pose
    load_N: arrays.Column  # load [N]
    place_mm: arrays.VectorColumn  # measured position in the base frame [mm]
    before_mm: arrays.VectorColumn  # position residual before [mm]
    after_mm: arrays.VectorColumn  # position residual after [mm]
    # whether a joint leaves the angles that maps have learnt from; null where effects were judged
    # by repeats or no map was found
    extrapolated: arrays.FlagColumn | None


class GapField(record.Part):
    """Every averaged configuration."""

    train: GapRows  # poses fitted
    holdout: GapRows | None  # held-out poses; null without any


@record.filed("pa10cal-analysis/1", "discovery/analysis.json", by="discover")
class AnalysisRecord(record.MeasuredRecord):
    """`discovery/analysis.json`."""

    before: LackOfFit  # lack of fit of the calibrated model
    after: LackOfFit  # lack of fit with the named effects
    naming: tuple[NamingStep, ...]  # errors as the named effects join the model one by one
    gap: GapField  # residuals before and after

    @property
    def effects(self) -> tuple[record.EffectName, ...]:
        """Return the effects named, in the order found."""
        return self.naming[-1].effects
