"""`discovery/analysis.json`: all that the figures of discovery show."""

from __future__ import annotations

from pa10cal.results.evaluation import Accuracy, Estimate
from pa10cal.results.record import (
    Column,
    CountColumn,
    EffectName,
    FlagColumn,
    GappyColumn,
    LabelColumn,
    MeasuredRecord,
    Part,
    Table,
    VectorColumn,
    filed,
)


class PureErrorTest(Part):
    """Lack of fit against pure error."""

    chi_square: float  # weighted sum of squares
    dof: float  # its degrees of freedom
    pure_error_dof: float  # degrees of freedom of pure error
    F: float  # ratio of the mean squares
    p_value: float  # probability of a larger F without lack of fit


class Channel(Part):
    """Lack of fit of poses or torques."""

    shared: PureErrorTest | None  # of what readings of a pose share; null without repeats
    unshared: PureErrorTest | None  # of what they do not; null likewise
    # variance shared by readings of a pose, in variances of a reading
    shared_variance_of_a_reading: float


class ErrorPart(Part):
    """Position error over some cells or along one axis."""

    of: str  # load, pose or axis
    cells: int  # number of cells
    rms_mm: float  # root mean square position error [mm]
    floor_mm: float  # root mean square error that noise leaves [mm]


class Arrival(Part):
    """Cells in which a joint arrived from one side."""

    direction: int  # -1: the angle fell, +1: it rose, 0: not known
    cells: int  # number of cells


class JointArrival(Arrival):
    """Mean angle error of a joint that arrived from one side."""

    mean_rad: float  # mean angle error [rad]
    std_rad: float | None  # its standard error [rad]; null where not known


class Periodogram(Part):
    """What sines of a joint's angle explain of its error."""

    orders: Column  # orders: periods a turn
    explained_rad: Column  # root mean square explained by each [rad]
    marked: Column  # orders at which drives err
    marked_rad: Column  # root mean square explained by these [rad]


class JointPart(Part):
    """Angle error of one joint."""

    joint: int  # joint, from 1
    rms_rad: float  # root mean square angle error [rad]
    floor_rad: float  # root mean square error that noise leaves [rad]
    arrivals: tuple[JointArrival, ...]  # mean error by direction of arrival
    periodogram: Periodogram | None  # sines of the angle; null where poses are too few


class TorqueArrival(Arrival):
    """Mean torque residual of a joint that arrived from one side."""

    mean_Nm: float  # mean torque residual [N m]
    std_Nm: float | None  # its standard error [N m]; null where not known


class TorquePart(Part):
    """Torque residual of one joint: logged minus static torque."""

    joint: int  # joint, from 1
    rms_Nm: float  # root mean square residual [N m]
    noise_Nm: float  # standard deviation of its noise [N m]
    arrivals: tuple[TorqueArrival, ...]  # mean residual by direction of arrival


class Drift(Part):
    """Slope of the position error along one axis of the instrument."""

    axis: str  # `x`, `y` or `z`
    # slope against time [mm/h]; null where the cells have the same mean time
    by_time_mm_per_h: Estimate | None
    # slope against temperature [mm/K]; null where it was not measured
    by_temperature_mm_per_K: Estimate | None


class CellJoint(Part):
    """One joint in every cell."""

    joint: int  # joint, from 1
    q_rad: Column  # joint angle [rad]
    arrival: Column  # direction of arrival, from -1 to 1
    error_rad: Column  # angle error [rad]
    std_rad: Column  # its standard uncertainty [rad]
    torque_residual_Nm: Column | None  # torque residual [N m]; null where torques were not logged


class Cells(Part):
    """Every cell of readings (one pose, load, direction and stretch of time), in columns."""

    pose: LabelColumn  # label of the pose
    load_N: Column  # load [N]
    readings: CountColumn  # number of readings
    time_s: Column  # mean time [s]
    temperature_C: GappyColumn  # mean temperature [deg C]; null where unknown
    position_x_mm: Column  # position residual along x of the instrument [mm]
    position_y_mm: Column  # position residual along y of the instrument [mm]
    position_z_mm: Column  # position residual along z of the instrument [mm]
    joints: tuple[CellJoint, ...]  # joint by joint


class LackOfFit(Part):
    """Where a model and the data disagree."""

    pose: Channel  # lack of fit of the poses
    torque: Channel | None  # lack of fit of the torques; null where they were not logged
    rms_mm: float  # root mean square position error [mm]
    floor_mm: float  # root mean square error that noise leaves [mm]
    by_load: tuple[ErrorPart, ...]  # error by load
    by_axis: tuple[ErrorPart, ...]  # error along each axis of the instrument
    by_joint: tuple[JointPart, ...]  # angle error of each joint
    by_torque: tuple[TorquePart, ...]  # torque residual of each joint
    drifts: tuple[Drift, ...]  # slope of the error along each axis
    cells: Cells  # every cell, six digits; a sample where there are very many


class NamingStep(Part):
    """Errors with the first few of the named effects in the model."""

    effects: tuple[EffectName, ...]  # effects in the model by then
    train: Accuracy  # errors over the poses fitted
    holdout: Accuracy | None  # errors over held-out poses; null without any


class ParameterShift(Part):
    """A parameter of the calibrated model before and after the effects joined it."""

    name: str  # its name
    unit: str  # its unit
    before: float  # value without the effects
    after: float  # value with them
    std: float  # standard uncertainty with them
    tolerance: float | None  # manufacturing tolerance; null where there is none
    identifiable: bool  # whether the data identify it


class GapRows(Table):
    """Residuals of configurations before and after, along the base axes."""

    pose: LabelColumn  # label of the pose
    load_N: Column  # load [N]
    place_mm: VectorColumn  # measured position in the base frame [mm]
    before_mm: VectorColumn  # position residual before [mm]
    after_mm: VectorColumn  # position residual after [mm]
    # whether a joint leaves the angles that maps have learnt from; null where effects were judged
    # by repeats or no map was found
    extrapolated: FlagColumn | None


class GapField(Part):
    """Every averaged configuration."""

    train: GapRows  # poses fitted
    holdout: GapRows | None  # held-out poses; null without any


@filed("pa10cal-analysis/1", "discovery/analysis.json", by="discover")
class AnalysisRecord(MeasuredRecord):
    """`discovery/analysis.json`."""

    before: LackOfFit  # lack of fit of the calibrated model
    after: LackOfFit  # lack of fit with the named effects
    naming: tuple[NamingStep, ...]  # errors as the named effects join the model one by one
    # parameters before and after the effects joined the model
    parameter_shifts: tuple[ParameterShift, ...]
    gap: GapField  # residuals before and after
    # mean position error of averaged poses that noise alone leaves [mm], as `gap.noise_floor_mm` of
    # the verdict
    noise_floor_mm: float

    @property
    def effects(self) -> tuple[EffectName, ...]:
        """Return the effects named, in the order found."""
        return self.naming[-1].effects
