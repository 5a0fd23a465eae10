"""`calibration/<load>.json`: a calibration with the paper's model or with the general one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue, model_validator
from pydantic_core import PydanticCustomError

from pa10cal.results import arrays, evaluation, record

# Whether a calibration is good: the `health` of its record.

#: How good a calibration is.
Grade = Literal["good", "few_poses", "incomplete", "suspect_input", "not_converged"]
#: Grades with which a model is exported and drawn without more ado.
UNRESERVED: frozenset[Grade] = frozenset({"good", "few_poses", "incomplete"})
#: Origins of weights that nobody stated, and from what they are assumed.
ASSUMED = {"assumed": "the lengths of the links", "total": "the mass of the whole arm"}
#: Kind of a finding that campaigns contradict each other, and no single cause explains most of it:
#: the model may lack an effect of what differs between them.
SEVERAL_CAUSES = "campaigns_differ"


class InputFinding(record.Part):
    """Something in the input that is probably wrong."""

    what: str  # what it is, one clause
    where: str  # column, joint, parameter, pose or file
    remedy: str  # what to do about it
    # root mean square position error that would remain if it were put right [mm]; null where that
    # was not tried
    would_leave_mm: float | None = None
    kind: str  # its kind in a word, such as `joint_sign`
    # effect of the vocabulary that it is as well as a slip of the log, where there is one
    effect: record.EffectName | None = record.optional()
    # number of the joint whose zero or sign is doubted, from 1; absent where that is of a single
    # campaign in a group
    joint: int | None = record.optional()
    # true where campaigns of a group contradict each other: effects found may explain that; absent
    # elsewhere
    between_campaigns: bool | None = record.optional()

    @property
    def place(self) -> str:
        """Return the joint that is doubted, or else where it is."""
        return self.where if self.joint is None else f"joint {self.joint}"

    @property
    def is_departure(self) -> bool:
        """Return whether it is a large departure from nominal: held-out poses may confirm it."""
        zero_off = self.kind == "joint_zero" and self.would_leave_mm is not None
        return zero_off or self.kind == "departure"

    def __str__(self) -> str:
        left = self.would_leave_mm
        then = "" if left is None else f" ({left:.3g} mm rms would remain)"
        return f"{self.where}: {self.what}; {self.remedy}{then}"


class RepeatScatter(record.Part):
    """What repeats scatter by, beside the stated uncertainty."""

    kind: str  # `position`, `attitude` or `distance`
    found: float  # scatter of one reading, one component [m or rad]
    stated: float  # its stated standard uncertainty [m or rad]
    pairs: int  # pairs of successive readings behind it

    @property
    def is_of_attitude(self) -> bool:
        """Return whether it is of orientations, in rad; else it is of positions or distances."""
        return self.kind.startswith("attitude")

    @property
    def ratio(self) -> float:
        """Return the scatter found over the one stated."""
        return self.found / self.stated


class CorrelatedPair(record.Part):
    """Two parameters that the poses can hardly separate."""

    parameters: tuple[str, str]  # names of the two parameters
    correlation: float  # their correlation, from -1 to 1


class ExpectedUncertainty(record.Part):
    """Standard uncertainty of a predicted position to be expected with so many poses."""

    poses: int  # number of poses
    u_optimal_mm: float  # with the best poses of those measured [mm]
    # with the first poses in the order measured [mm]; null where they do not determine the model
    u_measured_mm: float | None


class PosesNeeded(record.Part):
    """How many poses there are, and how many the uncertainty needs."""

    measured: int  # number of poses fitted
    # number of poses needed; null where those of `d_optimal_order` do not suffice, which all poses
    # may do where `measured` is more
    needed: int | None
    u_needed_mm: float  # standard uncertainty of a predicted position to reach [mm]
    # the same, where the settings ask for one; else the uncertainty to reach is one that adds
    # hardly anything to the remaining error
    wanted_mm: float | None = record.optional()
    # standard uncertainty of a predicted position now [mm]; null where not known
    u_model_mm: float | None
    d_optimal_order: tuple[str, ...]  # labels of the poses, the most informative first
    expected: tuple[ExpectedUncertainty, ...]  # uncertainty against the number of poses


class GradeCheck(record.Part):
    """One of the checks of a calibration, in words."""

    check: str  # what should hold
    found: str  # what was found
    limit: str  # up to which it holds; empty where there is no number
    # whether it holds; null where it could not be tested, or has no part in the grade
    passes: bool | None


class Health(record.Part):
    """What to look at before a calibration is trusted."""

    grade: Grade  # how good it is; the rule is in `docs/general.md`
    line: str  # the reason for it, in one sentence, with the remedy
    # what the grade rests on; empty in results of earlier versions
    checks: tuple[GradeCheck, ...] = ()
    converged: bool  # whether the fit converged
    reason: str  # why the fit stopped
    iterations: int  # steps of the fit
    at_bounds: tuple[str, ...]  # parameters at the end of their physical range
    rank: int  # directions of parameter space that the data identify
    unknowns: int  # parameters fitted
    condition: float  # condition number over the identified directions
    not_identifiable: tuple[str, ...]  # parameters that are not identifiable
    correlated_pairs: tuple[CorrelatedPair, ...]  # nearly inseparable pairs
    train_rms_mm: float  # root mean square position error over the poses fitted [mm]
    # the same over held-out poses [mm], without those that have a suspected reading; null where
    # none were measured
    held_out_rms_mm: float | None
    # root mean square position error of averaged poses that noise alone leaves [mm]: with the
    # paper's model what all repeats of a pose and load scatter by, from any direction of arrival;
    # with the general model the stated uncertainty; null where it is not known
    noise_mm: float | None
    # remaining error over the noise that repeats show, or else the stated noise; null where neither
    # is known
    error_over_noise: float | None
    # held-out error over the error that the fit promises there, where chance does not explain it;
    # else null
    held_out_over_expected: float | None
    # stated and found uncertainty; empty where too little is repeated
    repeats: tuple[RepeatScatter, ...]
    # what is probably wrong in the input; empty where nothing is
    findings: tuple[InputFinding, ...]
    # departures from nominal that no arm is built with and held-out poses confirm
    departures: tuple[InputFinding, ...] = ()
    poses: PosesNeeded  # how many poses there are and how many are needed
    # why suspected outliers are no wrong readings, but show what the model lacks
    outliers_show: str = Field("", exclude_if=lambda text: not text)

    @property
    def ending(self) -> str:
        """Return how the fit ended, in one sentence without a full stop.

        Not in how many steps: their number depends on the processor, see decision 42.
        """
        return f"{'converged' if self.converged else 'not converged'}: {self.reason}"


# What the campaigns of a group say of each other, in the results of a group.


class Difference(record.Part):
    """One cause that, if it alone differed between campaigns, explains so much."""

    name: str  # the parameter; `instrument_scale`, `instrument_range`, `tool_mass`
    unit: str  # its unit
    value: float  # this campaign less the others
    std: float  # standard uncertainty of that
    chi_square: float  # how much of the chi-square it explains
    # remaining error of all poses of the group with it [mm]
    left_mm: float | None = record.optional()


class CampaignAlone(record.Part):
    """One campaign of a group, held against the others."""

    poses: int  # poses fitted
    rms_mm: float  # remaining error of its poses in the fit of the group [mm]
    alone_rms_mm: float  # the same with parameters of its own [mm]
    chi_square: float  # of its shared parameters against those of the others
    dof: float  # directions of shared parameters that both determine
    p_value: float  # probability of that where nothing differs
    # whether chance does not explain that it differs from the others, and parameters of its own
    # remove a tenth of its squared error
    contradicts: bool
    worst: Difference  # the parameter that explains most of the difference
    # what the scale of its instrument explains alone, and what its range constant does where the
    # instrument has one, and where it stands is known
    instrument: tuple[Difference, ...] = ()
    # what a mass of its tool other than stated explains alone, where torques were calculated
    tool: Difference | None = record.optional()


class SharedParameter(record.Part):
    """Where a parameter that all campaigns of a group share comes from."""

    unit: str  # its unit
    std: float  # standard uncertainty by all campaigns together
    # standard uncertainty by each campaign alone
    std_alone: Mapping[record.CampaignKey, float]
    determined_by: tuple[str, ...]  # campaigns that determine it alone


class GroupOfCampaigns(record.Part):
    """What the campaigns of a group say alone, linear about the fit of all."""

    # each campaign, held against the others
    campaigns: Mapping[record.CampaignKey, CampaignAlone]
    # shared parameters, in the form in which they were solved
    parameters: Mapping[record.ParameterKey, SharedParameter]


class ParameterAlone(record.Part):
    """A parameter of an effect, as one campaign alone has it."""

    value: float  # its value
    std: float | None  # its standard uncertainty; null where it is at an end of its range


_ParametersAlone = Mapping[record.ParameterKey, ParameterAlone]


class JointErrorAlone(record.Part):
    """The error of a joint by its angle, as one campaign alone has it."""

    error_mrad: arrays.Numbers  # at 0, 1, 2, … deg of the turn [mrad]
    visited: arrays.FlagColumn  # whether the campaign has poses there


class CampaignsAgree(record.Part):
    """How well two campaigns agree on the error of a joint, over the angles both visited."""

    first: str  # one campaign
    second: str  # the other
    correlation: float | None  # of the two errors; null: too few angles
    correlation95: tuple[float, float] | None  # its interval of 95 %
    slope: float | None  # of the second by the first, both uncertain alike
    slope95: tuple[float, float] | None  # its interval of 95 %
    first_rms_mrad: float | None  # rms of the first, less its mean [mrad]
    second_rms_mrad: float | None  # rms of the second, less its mean [mrad]
    difference_rms_mrad: float | None  # rms of what they differ by [mrad]
    share_of_turn: float  # part of the turn that both visited

    @classmethod
    def unknown(cls, first: str, second: str, share_of_turn: float) -> Self:
        """Return that it is not known."""
        known = {"first": first, "second": second, "share_of_turn": share_of_turn}
        return cls(**{name: known.get(name) for name in cls.model_fields})


class EffectByCampaign(record.Part):
    """An effect that all campaigns of a group share, fitted to each of them alone."""

    id: str  # id of the effect
    of: str  # where it sits
    # its parameters; of an error by a joint's angle see `errors`
    parameters: Mapping[record.CampaignKey, _ParametersAlone] | None = record.optional()
    # of an error by a joint's angle
    errors: Mapping[record.CampaignKey, JointErrorAlone] | None = record.optional()
    # how well every two campaigns agree on an error by a joint's angle
    agreement: tuple[CampaignsAgree, ...]


Square = Annotated[NDArray[np.float64], arrays.Shape("k", "k")]


class CalibratedParameter(evaluation.Parameter):
    """A parameter of a calibration."""

    at_bound: bool  # whether it is at the end of its physical range
    # true where it was not fitted: the start gives it better than the poses do
    settled: bool | None = record.optional()


class Covariance(record.Part):
    """Covariance of parameters."""

    # names of the parameters, in the matrix's order; the general model has `windup_2`, the
    # deflection at a reference torque, for `K_lin_2`
    names: tuple[str, ...]
    matrix: Square  # covariance, in products of the parameters' units

    @model_validator(mode="after")
    def _as_large_as_names(self) -> Self:
        count = len(self.names)
        if self.matrix.shape != (count, count):
            allowed = f"{count} rows and columns, as many as names"
            raise PydanticCustomError("covariance", "{allowed}", {"allowed": allowed})
        return self


class Fit(record.Part):
    """How a fit ended, its parameters, and where the base frame is."""

    status: evaluation.Status  # whether it converged
    reason: str  # why it stopped
    cost: float  # sum of squares at its end, as the estimator weighs it
    iterations: int  # steps taken
    parameters: Mapping[record.ParameterKey, CalibratedParameter]  # every parameter by name
    covariance: Covariance  # covariance of the parameters fitted
    T_instr_base: arrays.PoseMatrix  # base frame in the instrument's frame [m]
    # the fitted model as `model.yaml` holds it (schema pa10cal-model/2), without its covariance
    fitted_model: Mapping[Annotated[str, record.Key("key")], JsonValue]


class LinearFit(Fit):
    """The fit of the paper's model with linear springs."""

    starts: int  # starts tried
    starts_agreeing: int  # starts that ended in this minimum
    after: Mapping[record.LoadKey, evaluation.Accuracy]  # errors at each load


class LoadErrors(evaluation.BeforeAfter):
    """Errors at one load, of the nominal and of the calibrated model."""

    # errors without suspected outliers; not given where there is none
    trusted: evaluation.BeforeAfter | None = record.optional()
    # with the paper's model: of the nominal arm with the base frame of the straight moves alone
    before_seed_frame: evaluation.Accuracy | None = record.optional()
    # with the general model: of the calibrated arm without springs
    geometry: evaluation.Accuracy | None = record.optional()

    @property
    def text(self) -> str:
        """Return mean and largest error of the calibrated model, suspected outliers apart."""
        return evaluation.mean_and_peak(
            self.after, None if self.trusted is None else self.trusted.after
        )


@record.filed("pa10cal-calibration/1", "calibration/<load>.json", by="calibrate")
class CalibrationRecord(Fit, record.MeasuredRecord):
    """What `calibration/<load>.json` holds whatever the model."""

    robot: str  # name of the arm
    load: str  # load case: `0N`, `22N`, ..., `combined` or `general`
    model: str  # which model it is: `paper` or `general`
    loads_fitted: tuple[float, ...]  # loads of the poses fitted [N]
    starts: int  # starts tried
    starts_agreeing: int  # starts that ended in this minimum
    rank: int  # directions of parameter space that the data identify
    unknowns: int  # parameters fitted, the base frame's too
    condition: float  # condition number over the identified directions
    # singular values of the Jacobian in scaled parameters, descending
    singular_values: arrays.Numbers
    # directions that are not identifiable, as weights of parameters
    null_directions: tuple[Mapping[record.ParameterKey, float], ...]
    errors: Mapping[record.LoadKey, LoadErrors]  # errors at each load
    residuals: evaluation.ResidualRows  # residual of every calibration pose
    health: Health  # whether the calibration is good
    warnings: tuple[str, ...]  # what to know before the fit is trusted
    # of all loads: each load that has too few poses for a fit of its own, and why
    loads_left_out: Mapping[record.LoadKey, str] | None = record.optional()
    # null: the time taken stands in the log, so that equal runs have equal results
    seconds: float | None
    # section `calibration` of the settings it was run with
    settings: Mapping[Annotated[str, record.Key("option")], JsonValue]

    @property
    def fits(self) -> Mapping[str, Fit]:
        """Return every fit that the file holds, by its key; the calibration itself has none."""
        return {"": self, **{name: part for name, part in self if isinstance(part, Fit)}}

    @property
    def fits_by_model(self) -> Mapping[str, Fit]:
        """Return the fits by the names of their models in an evaluation, the calibration last."""
        return {"calibrated": self}

    @property
    def has_springs(self) -> bool:
        """Whether joints have springs in it; without any, linear and cubic fit are one."""
        return any(name.startswith("K_lin") for name in self.parameters)

    @property
    def weights_from(self) -> str:
        """Return where the weights of the links come from: `stated`, `logged`, or as `ASSUMED`."""
        arm: Any = self.fitted_model["arm"]
        return str(arm.get("weights", {}).get("from", "stated"))

    @property
    def torques_logged(self) -> bool:
        """Whether joint torques are those of the log; the paper's model takes no others."""
        return True

    @classmethod
    def kinds(cls) -> tuple[type[record.Record], ...]:
        """Return a type for each model."""
        both = PaperCalibrationRecord, GeneralCalibrationRecord
        return both if cls is CalibrationRecord else (cls,)

    @classmethod
    def kind_of(cls, content: dict[str, Any]) -> type[record.Record]:
        """Return the type of the model named."""
        return cls.kinds()[-1 if content.get("model") == "general" else 0]


class PaperCalibrationRecord(CalibrationRecord):
    """`calibration/<load>.json` of the paper's model."""

    model: Literal["paper"] = "paper"  # the paper's model
    inner_poses: tuple[str, ...]  # poses that the inner level is fitted to
    linear: LinearFit  # the fit with linear springs

    @property
    def fits_by_model(self) -> Mapping[str, Fit]:
        """Return the fit with linear springs, then that with cubic ones."""
        return {"linear": self.linear, "cubic": self}


class Redundant(record.Part):
    """A parameter that others replace exactly, so it was not fitted."""

    name: str  # the parameter
    # parameters that do the same, with how much of each
    replaced_by: Mapping[record.ParameterKey, float]


class SuspectedOutlier(record.Part):
    """A pose far outside the scatter of the others."""

    row: int  # row among the calibration poses, from 0
    pose: str  # label of the pose
    load_N: float  # load [N]
    distance: float  # distance in units of the scatter
    weight: float  # weight that the fit gave it, from 0 to 1
    why: str  # what is odd about it


class Moved(record.Part):
    """Something that moved since a prior was fitted."""

    kind: str  # `joint_zero`, `stiffness`, `link` (another departure), or `effect`
    of: str  # where: a joint, a departure, an effect of a place
    # by how much, of a stiffness the part of the windup; null where that is no one number
    by: float | None
    std: float | None  # its standard uncertainty; likewise
    unit: str  # unit of both
    gain: float  # by how much it raised the evidence [nats]


class PriorPart(record.Part):
    """The model that a calibration started from, and how far it still held."""

    campaign: str | None  # to which it was fitted; null where not known
    moved: tuple[Moved, ...]  # what was found anew, the clearest first
    # factor of the variances of links and springs: 1 where they depart by no more than noise
    factor: float
    line: str  # the same in one sentence


class GeneralCalibrationRecord(CalibrationRecord):
    """`calibration/<load>.json` of the general model."""

    model: Literal["general"] = "general"  # the general model
    redundant: tuple[Redundant, ...]  # parameters not fitted, being redundant
    springs: tuple[int, ...]  # joints with a spring, from 1
    torques_from: str  # where joint torques come from: `logged`, `masses` or `none`
    # the fit without springs; of a calibration from a prior that of base and tool alone
    geometry: Fit
    nominal: Fit  # the fit of base and tool alone, the arm nominal
    suspected_outliers: tuple[SuspectedOutlier, ...]  # suspected outliers
    # the model it started from; not given where none was
    prior: PriorPart | None = record.optional()
    group: GroupOfCampaigns | None = record.optional()  # of a group, what each campaign says alone

    @property
    def fits_by_model(self) -> Mapping[str, Fit]:
        """Return the fit of the frames alone, that without springs, and the whole one."""
        own = bool(self.springs) and self.prior is None
        geometry = {"geometry": self.geometry} if own else {}
        return {"uncalibrated": self.nominal, **geometry, "linear": self}

    @property
    def torques_logged(self) -> bool:
        """Whether joint torques are those of the log."""
        return self.torques_from == "logged"


# `seed/base_frame.json`: base frame, and targets where the instrument's own are not stated.


class StraightLine(record.Part):
    """A straight move as it was measured."""

    direction_instr: arrays.Vector3  # its direction in the instrument's frame
    direction_u_rad: float  # standard uncertainty of the direction [rad]
    length_mm: float  # its length [mm]
    bend_rms_mm: float  # root mean square distance from the line [mm]
    points: int  # points measured along it


@record.filed("pa10cal-base-frame/1", "seed/base_frame.json", by="seed")
class BaseFrameRecord(record.MeasuredRecord):
    """`seed/base_frame.json`."""

    # how the frame was found
    method: Literal[
        "straight_lines",
        "rigid_fit_nominal",
        "hand_eye_poses",
        "hand_eye_points",
        "ranging",
        "nominal_arm",
    ]
    R_instr_base: arrays.Matrix3  # orientation of the base in the instrument's frame
    origin_instr_m: arrays.Vector3  # origin of the base in the instrument's frame [m]
    T_instr_base: arrays.PoseMatrix  # both as a homogeneous matrix [m]
    x_direction_u_rad: float | None = record.optional()  # standard uncertainty of the x axis [rad]
    y_direction_u_rad: float | None = record.optional()  # standard uncertainty of the y axis [rad]
    line_x: StraightLine | None = record.optional()  # the straight move along x
    line_y: StraightLine | None = record.optional()  # the straight move along y
    # angle between the straight moves [deg]
    angle_between_lines_deg: float | None = record.optional()
    attitude_scatter_rad: float | None = (
        record.optional()
    )  # root mean square orientation residual [rad]
    # the target in the end-effector frame [m]
    T_ee_target: arrays.PoseMatrix | None = record.optional()
    # of a group, the target of each campaign in the end-effector frame [m]
    T_ee_target_of: Mapping[record.CampaignKey, arrays.PoseMatrix] | None = record.optional()
    # places of the targets in the end-effector frame [m]
    p_ee_targets_m: Mapping[Annotated[str, record.Key("target")], arrays.Vector3] | None = (
        record.optional()
    )
    # the instrument's fixed point in the base frame [m]
    p_base_point_m: arrays.Vector3 | None = record.optional()
    # what the data do not identify, held at its stated or starting value
    held_as_stated: tuple[str, ...] | None = record.optional()
    # whether the campaign states the places of its targets
    target_stated: bool | None = record.optional()
    origin_scatter_mm: float  # root mean square position residual [mm]
    origin_poses: int  # poses that the origin stands on
    origin_from: str  # which poses they are
