"""The parts of the discovery's result files that pictures are drawn from."""

from __future__ import annotations

from typing import Any

from pa10cal.figures.records import Record, Vector

Numbers = tuple[float, ...]
#: Numbers of which some may not be known.
Column = tuple[float | None, ...]


class EffectName(Record):
    """An effect and where it sits."""

    id: str
    of: str

    @property
    def words(self) -> str:
        """Return it as readers see it: `transmission error, joint 2`."""
        return f"{self.id.replace('_', ' ')}, {self.of.replace('_', ' ')}"


class PureErrorTest(Record):
    """What is left against pure error."""

    F: float
    p_value: float


class Channel(Record):
    """Lack of fit of poses or torques."""

    shared: PureErrorTest | None


class Part(Record):
    """Position error over some cells or along one axis."""

    of: str
    rms_mm: float
    floor_mm: float


class JointArrival(Record):
    """Mean angle error of a joint that arrived from one side."""

    direction: int
    mean_rad: float
    std_rad: float | None


class Periodogram(Record):
    """What sines of a joint's angle explain of its error."""

    orders: Numbers
    explained_rad: Numbers
    marked: Numbers
    marked_rad: Numbers


class JointPart(Record):
    """Angle error of one joint."""

    joint: int
    rms_rad: float
    floor_rad: float
    arrivals: tuple[JointArrival, ...]
    periodogram: Periodogram | None


class TorquePart(Record):
    """Torque of one joint left over the weights."""

    joint: int
    rms_Nm: float
    noise_Nm: float


class Estimate(Record):
    """A number with its standard uncertainty."""

    value: float
    std: float | None


class Drift(Record):
    """Slope of the position error along one axis of the instrument."""

    axis: str
    by_time_mm_per_h: Estimate
    by_temperature_mm_per_K: Estimate | None


class CellJoint(Record):
    """One joint in every cell."""

    joint: int
    q_rad: Numbers
    arrival: Numbers
    error_rad: Numbers
    std_rad: Numbers
    torque_residual_Nm: Numbers | None


class Cells(Record):
    """Every cell of readings: one pose, load, direction and stretch of time."""

    time_s: Numbers
    temperature_C: Column
    joints: tuple[CellJoint, ...]


class LackOfFit(Record):
    """Where a fit and the data disagree."""

    pose: Channel
    by_load: tuple[Part, ...]
    by_axis: tuple[Part, ...]
    by_joint: tuple[JointPart, ...]
    by_torque: tuple[TorquePart, ...]
    drifts: tuple[Drift, ...]
    cells: Cells


class Errors(Record):
    """Errors over some configurations; of some steps of the search the position's alone."""

    mean_mm: float
    peak_mm: float
    rms_mm: float
    orientation_deg: float | None = None
    configurations: int | None = None


class Naming(Record):
    """Errors with the first few of the effects in the model."""

    effects: tuple[EffectName, ...]
    train: Errors
    holdout: Errors | None


class Configuration(Record):
    """Predicted minus measured position at one configuration, along the base axes.

    `extrapolated` says that a joint leaves the angles that the poses fitted have seen.
    """

    pose: str
    load_N: float
    place_mm: Vector
    before_mm: Vector
    after_mm: Vector
    extrapolated: bool = False


class Field(Record):
    """Every averaged configuration."""

    train: tuple[Configuration, ...]
    holdout: tuple[Configuration, ...] | None


class Shift(Record):
    """A parameter of the model before and after the effects joined it."""

    name: str
    unit: str
    before: float
    after: float
    std: float
    tolerance: float | None
    identifiable: bool


class Analysis(Record):
    """`discovery/analysis.json`."""

    before: LackOfFit
    after: LackOfFit
    naming: tuple[Naming, ...]
    parameter_shifts: tuple[Shift, ...]
    gap: Field
    noise_floor_mm: float

    @property
    def effects(self) -> tuple[EffectName, ...]:
        """Return the effects named, in the order found."""
        return self.naming[-1].effects


class EffectParameter(Record):
    """A parameter of an effect."""

    value: float
    std: float
    unit: str


class FoundEffect(EffectName):
    """An effect that was found."""

    parameters: dict[str, EffectParameter]
    alternatives: tuple[EffectName, ...]
    evidence: dict[str, Any]


class NotTestable(EffectName):
    """An effect that the data cannot show."""

    why: str


class Unexplained(Record):
    """Something without a name."""

    of: str | None
    why: str


class AllUnexplained(Unexplained):
    """Everything without a name, the largest first."""

    all: tuple[Unexplained, ...]


class Paired(Record):
    """Mean reduction of the error, poses being the unit."""

    mean_mm: float
    interval95_mm: tuple[float, float]
    poses: int


class PartGap(Record):
    """The gap over some poses, before and after."""

    before: Errors
    after: Errors


class LoadGap(PartGap):
    """The gap at a load, with how sure it is that it closes."""

    reduction: Paired


class SetGap(LoadGap):
    """The gap over all loads, load by load, and inside the angles seen in the fit and beyond."""

    per_load: dict[str, LoadGap]
    inside: PartGap | None = None
    extrapolated: PartGap | None = None


class Gaps(Record):
    """The gap on the poses fitted and on those held out."""

    noise_floor_mm: float
    train: SetGap
    holdout: SetGap | None


class AnglesSeen(Record):
    """Stretches of a joint's angle that the poses fitted have seen [rad; m of one that slides]."""

    turns: bool
    stretches: tuple[tuple[float, float], ...]


class Verdict(Record):
    """`discovery/verdict.json`.

    `angles_seen` is a joint's each; None where effects were judged by repeats of a pose.
    """

    verdict: str
    angles_seen: tuple[AnglesSeen, ...] | None = None
    effects: tuple[FoundEffect, ...]
    unexplained: AllUnexplained | None
    not_testable: tuple[NotTestable, ...]
    indistinguishable: tuple[tuple[EffectName, ...], ...]
    gap: Gaps
