"""`calibration/<load>.json`: a calibration with the paper's model or with the general one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue

from pa10cal.results.evaluation import (
    Accuracy,
    BeforeAfter,
    Parameter,
    ResidualRows,
    Status,
    mean_and_peak,
)
from pa10cal.results.health import Health
from pa10cal.results.record import (
    FlagColumn,
    Key,
    LoadKey,
    Matrix3,
    MeasuredRecord,
    Numbers,
    ParameterKey,
    Part,
    PoseMatrix,
    Record,
    Shape,
    Vector3,
    filed,
    optional,
)

# What the campaigns of a group say of each other, in the results of a group.


class Difference(Part):
    """The one parameter that, if it alone differed between campaigns, explains most."""

    name: str = Field(description="the parameter")
    unit: str = Field(description="its unit")
    value: float = Field(description="this campaign less the others")
    std: float = Field(description="standard uncertainty of that")
    chi_square: float = Field(description="how much of the chi-square it explains")


class CampaignAlone(Part):
    """One campaign of a group, held against the others."""

    poses: int = Field(description="poses fitted")
    rms_mm: float = Field(description="remaining error of its poses in the fit of the group [mm]")
    alone_rms_mm: float = Field(description="the same with parameters of its own [mm]")
    chi_square: float = Field(description="of its shared parameters against those of the others")
    dof: float = Field(description="directions of shared parameters that both determine")
    p_value: float = Field(description="probability of that where nothing differs")
    contradicts: bool = Field(description="whether the arm was changed against the others")
    worst: Difference = Field(description="the parameter that explains most of the difference")


class SharedParameter(Part):
    """Where a parameter that all campaigns of a group share comes from."""

    unit: str = Field(description="its unit")
    std: float = Field(description="standard uncertainty by all campaigns together")
    std_alone: Mapping[Annotated[str, Key("campaign")], float] = Field(
        description="standard uncertainty by each campaign alone"
    )
    determined_by: tuple[str, ...] = Field(description="campaigns that determine it alone")


class GroupOfCampaigns(Part):
    """What the campaigns of a group say alone, linear about the fit of all."""

    campaigns: Mapping[Annotated[str, Key("campaign")], CampaignAlone] = Field(
        description="each campaign, held against the others"
    )
    parameters: Mapping[Annotated[str, Key("parameter")], SharedParameter] = Field(
        description="shared parameters, in the form in which they were solved"
    )


class ParameterAlone(Part):
    """A parameter of an effect, as one campaign alone has it."""

    value: float = Field(description="its value")
    std: float = Field(description="its standard uncertainty")


class JointErrorAlone(Part):
    """The error of a joint by its angle, as one campaign alone has it."""

    error_mrad: Numbers = Field(description="at 0, 1, 2, … deg of the turn [mrad]")
    visited: FlagColumn = Field(description="whether the campaign has poses there")


class CampaignsAgree(Part):
    """How well two campaigns agree on the error of a joint, over the angles both visited."""

    first: str = Field(description="one campaign")
    second: str = Field(description="the other")
    correlation: float | None = Field(description="of the two errors; null: too few angles")
    correlation95: tuple[float, float] | None = Field(description="its interval of 95 %")
    slope: float | None = Field(description="of the second by the first, both uncertain alike")
    slope95: tuple[float, float] | None = Field(description="its interval of 95 %")
    first_rms_mrad: float | None = Field(description="rms of the first, less its mean [mrad]")
    second_rms_mrad: float | None = Field(description="rms of the second, less its mean [mrad]")
    difference_rms_mrad: float | None = Field(description="rms of what they differ by [mrad]")
    share_of_turn: float = Field(description="part of the turn that both visited")


class EffectByCampaign(Part):
    """An effect that all campaigns of a group share, fitted to each of them alone."""

    id: str = Field(description="id of the effect")
    of: str = Field(description="where it sits")
    parameters: (
        Mapping[
            Annotated[str, Key("campaign")],
            Mapping[Annotated[str, Key("parameter")], ParameterAlone],
        ]
        | None
    ) = optional("its parameters; of an error by a joint's angle see `errors`")
    errors: Mapping[Annotated[str, Key("campaign")], JointErrorAlone] | None = optional(
        "of an error by a joint's angle"
    )
    agreement: tuple[CampaignsAgree, ...] = Field(
        description="how well every two campaigns agree on an error by a joint's angle"
    )


Square = Annotated[NDArray[np.float64], Shape("k", "k")]

_STATED = "stated uncertainty"


class CalibratedParameter(Parameter):
    """A parameter of a calibration."""

    at_bound: bool = Field(description="whether it is at the end of its physical range")
    settled: bool | None = optional(
        "true where it was not fitted: the start gives it better than the poses do"
    )


class Covariance(Part):
    """Covariance of parameters."""

    names: tuple[str, ...] = Field(
        description="names of the parameters, in the matrix's order; the general model has "
        "`windup_2`, the deflection at a reference torque, for `K_lin_2`"
    )
    matrix: Square = Field(description="covariance, in products of the parameters' units")


class Fit(Part):
    """How a fit ended, its parameters, and where the base frame is."""

    status: Status = Field(description="whether it converged")
    reason: str = Field(description="why it stopped")
    cost: float = Field(description="sum of squares at its end, as the estimator weighs it")
    iterations: int = Field(description="steps taken")
    parameters: Mapping[ParameterKey, CalibratedParameter] = Field(
        description="every parameter by name"
    )
    covariance: Covariance = Field(description="covariance of the parameters fitted")
    T_instr_base: PoseMatrix = Field(description="base frame in the instrument's frame [m]")
    fitted_model: Mapping[Annotated[str, Key("key")], JsonValue] = Field(
        description="the fitted model as `model.yaml` holds it (schema pa10cal-model/2), without "
        "its covariance"
    )


class LinearFit(Fit):
    """The fit of the paper's model with linear springs."""

    starts: int = Field(description="starts tried")
    starts_agreeing: int = Field(description="starts that ended in this minimum")
    after: Mapping[LoadKey, Accuracy] = Field(description="errors at each load")


class Spring(Part):
    """A linear joint spring of the general model."""

    joint: int = Field(description="joint, from 1")
    tau_ref_Nm: float = Field(description="torque at which its parameter is the windup [N m]")


class Solved(Part):
    """What restores a fit of the general model."""

    links: tuple[str, ...] = Field(description="link departures fitted")
    springs: tuple[Spring, ...] = Field(description="joint springs fitted")
    tool: tuple[str, ...] = Field(description="motions of the tool fitted")
    x: Numbers = Field(description="their values, in this order [rad, m]")
    places_m: Numbers = Field(description="places of the targets, one after the other [m]")
    R_ee_target: Matrix3 = Field(description="orientation of the target in the end-effector frame")


class GeneralFit(Fit):
    """A fit of the general model."""

    dof: int = Field(description="residual degrees of freedom")
    scatter: Mapping[Annotated[str, Key("kind")], float] = Field(
        description="standard deviation of residuals, of `position` [m] and `attitude` [rad]"
    )
    solved: Solved = Field(description="what restores the model")


class Observability(Part):
    """Observability indices of the identified directions (Sun and Hollerbach, 2008)."""

    O1: float = Field(
        description="geometric mean of the singular values over the root of the number of poses"
    )
    O2: float = Field(description="smallest singular value over the largest")
    O3: float = Field(description="smallest singular value")
    O4: float = Field(description="smallest singular value squared over the largest")
    O5: float = Field(description="reciprocal of the sum of reciprocals of the singular values")


class LoadErrors(BeforeAfter):
    """Errors at one load, of the nominal and of the calibrated model."""

    trusted: BeforeAfter | None = optional(
        "errors without suspected outliers; not given where there is none"
    )

    @property
    def text(self) -> str:
        """Return mean and largest error of the calibrated model, suspected outliers apart."""
        return mean_and_peak(self.after, None if self.trusted is None else self.trusted.after)


class PaperErrors(LoadErrors):
    """Errors at one load with the paper's model."""

    before_seed_frame: Accuracy = Field(
        description="of the nominal model with the base frame of the straight moves alone"
    )


class GeneralErrors(LoadErrors):
    """Errors at one load with the general model."""

    geometry: Accuracy = Field(description="of the calibrated model without springs")


@filed("pa10cal-calibration/1", "calibration/<load>.json", by="calibrate")
class CalibrationRecord(Fit, MeasuredRecord):
    """What `calibration/<load>.json` holds whatever the model."""

    robot: str = Field(description="name of the arm")
    load: str = Field(description="load case: `0N`, `22N`, ..., `combined` or `general`")
    model: str = Field(description="which model it is: `paper` or `general`")
    loads_fitted: tuple[float, ...] = Field(description="loads of the poses fitted [N]")
    starts: int = Field(description="starts tried")
    starts_agreeing: int = Field(description="starts that ended in this minimum")
    rank: int = Field(description="directions of parameter space that the data identify")
    unknowns: int = Field(description="parameters fitted, the base frame's too")
    condition: float = Field(description="condition number over the identified directions")
    singular_values: Numbers = Field(
        description="singular values of the Jacobian in scaled parameters, descending"
    )
    null_directions: tuple[Mapping[ParameterKey, float], ...] = Field(
        description="directions that are not identifiable, as weights of parameters"
    )
    observability: Observability = Field(description="observability indices")
    errors: Mapping[LoadKey, LoadErrors] = Field(description="errors at each load")
    residuals: ResidualRows = Field(description="residual of every calibration pose")
    health: Health = Field(description="whether the calibration is good")
    warnings: tuple[str, ...] = Field(description="what to know before the fit is trusted")
    seconds: float | None = Field(
        description="null: the time taken stands in the log, so that equal runs have equal results"
    )
    settings: Mapping[Annotated[str, Key("option")], JsonValue] = Field(
        description="section `calibration` of the settings it was run with"
    )

    @property
    def fits(self) -> Mapping[str, Fit]:
        """Return every fit that the file holds, by its key; the calibration itself has none."""
        return {"": self}

    @property
    def fits_by_model(self) -> Mapping[str, Fit]:
        """Return the fits by the names of their models in an evaluation, the calibration last."""
        return {"calibrated": self}

    @property
    def has_springs(self) -> bool:
        """Whether joints have springs in it; without any, linear and cubic fit are one."""
        return any(name.startswith("K_lin") for name in self.parameters)

    @property
    def noise_is(self) -> str:
        """Return what `health.noise_mm` is of, in words."""
        return "scatter of all repeats" if self.health.repeats else _STATED

    @property
    def torques_logged(self) -> bool:
        """Whether joint torques are those of the log; the paper's model takes no others."""
        return True

    @classmethod
    def kinds(cls) -> tuple[type[Record], ...]:
        """Return a type for each model."""
        return (
            (PaperCalibrationRecord, GeneralCalibrationRecord)
            if cls is CalibrationRecord
            else (cls,)
        )

    @classmethod
    def kind_of(cls, content: dict[str, Any]) -> type[Record]:
        """Return the type of the model named."""
        if cls is not CalibrationRecord:
            return cls
        return (
            GeneralCalibrationRecord
            if content.get("model") == "general"
            else PaperCalibrationRecord
        )


class SeedDifference(Part):
    """How far the base frame ended from its seed."""

    angle_deg: float = Field(description="angle between them [deg]")
    distance_mm: float = Field(description="distance of their origins [mm]")


class PaperCalibrationRecord(CalibrationRecord):
    """`calibration/<load>.json` of the paper's model."""

    model: Literal["paper"] = Field("paper", description="the paper's model")
    errors: Mapping[LoadKey, PaperErrors] = Field(description="errors at each load")
    inner_poses: tuple[str, ...] = Field(description="poses that the inner level is fitted to")
    seed_difference: SeedDifference = Field(description="base frame found, against its seed")
    linear: LinearFit = Field(description="the fit with linear springs")

    @property
    def fits(self) -> Mapping[str, Fit]:
        """Return the fit with cubic springs, and that with linear ones."""
        return {"": self, "linear": self.linear}

    @property
    def fits_by_model(self) -> Mapping[str, Fit]:
        """Return the fit with linear springs, then that with cubic ones."""
        return {"linear": self.linear, "cubic": self}


class Redundant(Part):
    """A parameter that others replace exactly, so it was not fitted."""

    name: str = Field(description="the parameter")
    replaced_by: Mapping[ParameterKey, float] = Field(
        description="parameters that do the same, with how much of each"
    )


class SuspectedOutlier(Part):
    """A pose far outside the scatter of the others."""

    row: int = Field(description="row among the calibration poses, from 0")
    pose: str = Field(description="label of the pose")
    load_N: float = Field(description="load [N]")
    distance: float = Field(description="distance in units of the scatter")
    weight: float = Field(description="weight that the fit gave it, from 0 to 1")
    why: str = Field(description="what is odd about it")


class Moved(Part):
    """Something that moved since a prior was fitted."""

    kind: str = Field(
        description="`joint_zero`, `stiffness`, `link` (another departure), or `effect`"
    )
    of: str = Field(description="where: a joint, a departure, an effect of a place")
    by: float | None = Field(
        description="by how much, of a stiffness the part of the windup; null where that is no one "
        "number"
    )
    std: float | None = Field(description="its standard uncertainty; likewise")
    unit: str = Field(description="unit of both")
    gain: float = Field(description="by how much it raised the evidence [nats]")


class PriorPart(Part):
    """The model that a calibration started from, and how far it still held."""

    campaign: str | None = Field(description="to which it was fitted; null where not known")
    moved: tuple[Moved, ...] = Field(description="what was found anew, the clearest first")
    factor: float = Field(
        description="factor of the variances of links and springs: 1 where they depart by no more "
        "than noise"
    )
    line: str = Field(description="the same in one sentence")


class GeneralCalibrationRecord(GeneralFit, CalibrationRecord):
    """`calibration/<load>.json` of the general model."""

    model: Literal["general"] = Field("general", description="the general model")
    errors: Mapping[LoadKey, GeneralErrors] = Field(description="errors at each load")
    redundant: tuple[Redundant, ...] = Field(description="parameters not fitted, being redundant")
    springs: tuple[int, ...] = Field(description="joints with a spring, from 1")
    torques_from: str = Field(
        description="where joint torques come from: `logged`, `masses` or `none`"
    )
    before_is: str = Field(description="what `before` is in the errors")
    geometry: GeneralFit = Field(
        description="the fit without springs; of a calibration from a prior that of base and tool "
        "alone"
    )
    nominal: GeneralFit = Field(description="the fit of base and tool alone, the arm nominal")
    suspected_outliers: tuple[SuspectedOutlier, ...] = Field(description="suspected outliers")
    prior: PriorPart | None = optional("the model it started from; not given where none was")
    group: GroupOfCampaigns | None = optional("of a group, what each campaign says alone")

    @property
    def fits(self) -> Mapping[str, Fit]:
        """Return the whole fit, that without springs, and that of the frames alone."""
        return {"": self, "geometry": self.geometry, "nominal": self.nominal}

    @property
    def fits_by_model(self) -> Mapping[str, Fit]:
        """Return the fit of the frames alone, that without springs, and the whole one."""
        own = bool(self.springs) and self.prior is None
        geometry = {"geometry": self.geometry} if own else {}
        return {"uncalibrated": self.nominal, **geometry, "linear": self}

    @property
    def noise_is(self) -> str:
        """Return what `health.noise_mm` is of, in words."""
        return _STATED

    @property
    def torques_logged(self) -> bool:
        """Whether joint torques are those of the log."""
        return self.torques_from == "logged"


# `seed/base_frame.json`: base frame, and targets where the instrument's own are not stated.


class StraightLine(Part):
    """A straight move as it was measured."""

    direction_instr: Vector3 = Field(description="its direction in the instrument's frame")
    direction_u_rad: float = Field(description="standard uncertainty of the direction [rad]")
    length_mm: float = Field(description="its length [mm]")
    bend_rms_mm: float = Field(description="root mean square distance from the line [mm]")
    points: int = Field(description="points measured along it")


@filed("pa10cal-base-frame/1", "seed/base_frame.json", by="seed")
class BaseFrameRecord(MeasuredRecord):
    """`seed/base_frame.json`."""

    method: Literal[
        "straight_lines",
        "rigid_fit_nominal",
        "hand_eye_poses",
        "hand_eye_points",
        "ranging",
        "nominal_arm",
    ] = Field(description="how the frame was found")
    R_instr_base: Matrix3 = Field(description="orientation of the base in the instrument's frame")
    origin_instr_m: Vector3 = Field(description="origin of the base in the instrument's frame [m]")
    T_instr_base: PoseMatrix = Field(description="both as a homogeneous matrix [m]")
    x_direction_u_rad: float | None = optional("standard uncertainty of the x axis [rad]")
    y_direction_u_rad: float | None = optional("standard uncertainty of the y axis [rad]")
    line_x: StraightLine | None = optional("the straight move along x")
    line_y: StraightLine | None = optional("the straight move along y")
    angle_between_lines_deg: float | None = optional("angle between the straight moves [deg]")
    attitude_scatter_rad: float | None = optional("root mean square orientation residual [rad]")
    T_ee_target: PoseMatrix | None = optional("the target in the end-effector frame [m]")
    T_ee_target_of: Mapping[Annotated[str, Key("campaign")], PoseMatrix] | None = optional(
        "of a group, the target of each campaign in the end-effector frame [m]"
    )
    p_ee_targets_m: Mapping[Annotated[str, Key("target")], Vector3] | None = optional(
        "places of the targets in the end-effector frame [m]"
    )
    p_base_point_m: Vector3 | None = optional("the instrument's fixed point in the base frame [m]")
    held_as_stated: tuple[str, ...] | None = optional(
        "what the data do not identify, held at its stated or starting value"
    )
    target_stated: bool | None = optional("whether the campaign states the places of its targets")
    origin_scatter_mm: float = Field(description="root mean square position residual [mm]")
    origin_poses: int = Field(description="poses that the origin stands on")
    origin_from: str = Field(description="which poses they are")
