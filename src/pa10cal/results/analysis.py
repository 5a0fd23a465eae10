"""`discovery/analysis.json`: all that the figures of discovery show."""

from __future__ import annotations

from pydantic import Field

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

    chi_square: float = Field(description="weighted sum of squares")
    dof: float = Field(description="its degrees of freedom")
    pure_error_dof: float = Field(description="degrees of freedom of pure error")
    F: float = Field(description="ratio of the mean squares")
    p_value: float = Field(description="probability of a larger F without lack of fit")


class Channel(Part):
    """Lack of fit of poses or torques."""

    shared: PureErrorTest | None = Field(
        description="of what readings of a pose share; null without repeats"
    )
    unshared: PureErrorTest | None = Field(description="of what they do not; null likewise")
    shared_variance_of_a_reading: float = Field(
        description="variance shared by readings of a pose, in variances of a reading"
    )


class ErrorPart(Part):
    """Position error over some cells or along one axis."""

    of: str = Field(description="load, pose or axis")
    cells: int = Field(description="number of cells")
    rms_mm: float = Field(description="root mean square position error [mm]")
    floor_mm: float = Field(description="root mean square error that noise leaves [mm]")


class Arrival(Part):
    """Cells in which a joint arrived from one side."""

    direction: int = Field(description="-1: the angle fell, +1: it rose, 0: not known")
    cells: int = Field(description="number of cells")


class JointArrival(Arrival):
    """Mean angle error of a joint that arrived from one side."""

    mean_rad: float = Field(description="mean angle error [rad]")
    std_rad: float | None = Field(description="its standard error [rad]; null where not known")


class Periodogram(Part):
    """What sines of a joint's angle explain of its error."""

    orders: Column = Field(description="orders: periods a turn")
    explained_rad: Column = Field(description="root mean square explained by each [rad]")
    marked: Column = Field(description="orders at which drives err")
    marked_rad: Column = Field(description="root mean square explained by these [rad]")


class JointPart(Part):
    """Angle error of one joint."""

    joint: int = Field(description="joint, from 1")
    rms_rad: float = Field(description="root mean square angle error [rad]")
    floor_rad: float = Field(description="root mean square error that noise leaves [rad]")
    arrivals: tuple[JointArrival, ...] = Field(description="mean error by direction of arrival")
    periodogram: Periodogram | None = Field(
        description="sines of the angle; null where poses are too few"
    )


class TorqueArrival(Arrival):
    """Mean torque residual of a joint that arrived from one side."""

    mean_Nm: float = Field(description="mean torque residual [N m]")
    std_Nm: float | None = Field(description="its standard error [N m]; null where not known")


class TorquePart(Part):
    """Torque residual of one joint: logged minus static torque."""

    joint: int = Field(description="joint, from 1")
    rms_Nm: float = Field(description="root mean square residual [N m]")
    noise_Nm: float = Field(description="standard deviation of its noise [N m]")
    arrivals: tuple[TorqueArrival, ...] = Field(description="mean residual by direction of arrival")


class Drift(Part):
    """Slope of the position error along one axis of the instrument."""

    axis: str = Field(description="`x`, `y` or `z`")
    by_time_mm_per_h: Estimate | None = Field(
        description="slope against time [mm/h]; null where the cells have the same mean time"
    )
    by_temperature_mm_per_K: Estimate | None = Field(
        description="slope against temperature [mm/K]; null where it was not measured"
    )


class CellJoint(Part):
    """One joint in every cell."""

    joint: int = Field(description="joint, from 1")
    q_rad: Column = Field(description="joint angle [rad]")
    arrival: Column = Field(description="direction of arrival, from -1 to 1")
    error_rad: Column = Field(description="angle error [rad]")
    std_rad: Column = Field(description="its standard uncertainty [rad]")
    torque_residual_Nm: Column | None = Field(
        description="torque residual [N m]; null where torques were not logged"
    )


class Cells(Part):
    """Every cell of readings (one pose, load, direction and stretch of time), in columns."""

    pose: LabelColumn = Field(description="label of the pose")
    load_N: Column = Field(description="load [N]")
    readings: CountColumn = Field(description="number of readings")
    time_s: Column = Field(description="mean time [s]")
    temperature_C: GappyColumn = Field(description="mean temperature [deg C]; null where unknown")
    position_x_mm: Column = Field(description="position residual along x of the instrument [mm]")
    position_y_mm: Column = Field(description="position residual along y of the instrument [mm]")
    position_z_mm: Column = Field(description="position residual along z of the instrument [mm]")
    joints: tuple[CellJoint, ...] = Field(description="joint by joint")


class LackOfFit(Part):
    """Where a model and the data disagree."""

    pose: Channel = Field(description="lack of fit of the poses")
    torque: Channel | None = Field(
        description="lack of fit of the torques; null where they were not logged"
    )
    rms_mm: float = Field(description="root mean square position error [mm]")
    floor_mm: float = Field(description="root mean square error that noise leaves [mm]")
    by_load: tuple[ErrorPart, ...] = Field(description="error by load")
    by_axis: tuple[ErrorPart, ...] = Field(description="error along each axis of the instrument")
    by_joint: tuple[JointPart, ...] = Field(description="angle error of each joint")
    by_torque: tuple[TorquePart, ...] = Field(description="torque residual of each joint")
    drifts: tuple[Drift, ...] = Field(description="slope of the error along each axis")
    cells: Cells = Field(description="every cell, six digits; a sample where there are very many")


class NamingStep(Part):
    """Errors with the first few of the named effects in the model."""

    effects: tuple[EffectName, ...] = Field(description="effects in the model by then")
    train: Accuracy = Field(description="errors over the poses fitted")
    holdout: Accuracy | None = Field(description="errors over held-out poses; null without any")


class ParameterShift(Part):
    """A parameter of the calibrated model before and after the effects joined it."""

    name: str = Field(description="its name")
    unit: str = Field(description="its unit")
    before: float = Field(description="value without the effects")
    after: float = Field(description="value with them")
    std: float = Field(description="standard uncertainty with them")
    tolerance: float | None = Field(description="manufacturing tolerance; null where there is none")
    identifiable: bool = Field(description="whether the data identify it")


class GapRows(Table):
    """Residuals of configurations before and after, along the base axes."""

    pose: LabelColumn = Field(description="label of the pose")
    load_N: Column = Field(description="load [N]")
    place_mm: VectorColumn = Field(description="measured position in the base frame [mm]")
    before_mm: VectorColumn = Field(description="position residual before [mm]")
    after_mm: VectorColumn = Field(description="position residual after [mm]")
    extrapolated: FlagColumn | None = Field(
        description="whether a joint leaves the angles that maps have learnt from; null where "
        "effects were judged by repeats or no map was found"
    )


class GapField(Part):
    """Every averaged configuration."""

    train: GapRows = Field(description="poses fitted")
    holdout: GapRows | None = Field(description="held-out poses; null without any")


@filed("pa10cal-analysis/1", "discovery/analysis.json", by="discover")
class AnalysisRecord(MeasuredRecord):
    """`discovery/analysis.json`."""

    before: LackOfFit = Field(description="lack of fit of the calibrated model")
    after: LackOfFit = Field(description="lack of fit with the named effects")
    naming: tuple[NamingStep, ...] = Field(
        description="errors as the named effects join the model one by one"
    )
    parameter_shifts: tuple[ParameterShift, ...] = Field(
        description="parameters before and after the effects joined the model"
    )
    gap: GapField = Field(description="residuals before and after")
    noise_floor_mm: float = Field(
        description="mean position error of averaged poses that noise alone leaves [mm], as "
        "`gap.noise_floor_mm` of the verdict"
    )

    @property
    def effects(self) -> tuple[EffectName, ...]:
        """Return the effects named, in the order found."""
        return self.naming[-1].effects
