"""A fitted model as data, what it was fitted to, and the predictions that it returns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from html import escape
from itertools import product
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pa10cal.arm.chain import TOOL, Chain, bend_coordinates, long_links
from pa10cal.arm.controller_poses import Angles, controller_columns
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.fit.loads import with_torques
from pa10cal.fit.problem import DEPARTURES, hardly_known, usual_departures
from pa10cal.fit.validity import AngleCoverage, Discrepancy
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations, reading_checksums
from pa10cal.observe.quantities import Comparison, Deviations
from pa10cal.results.calibration import UNRESERVED, Health, InputFinding
from pa10cal.results.record import CampaignIdentity, EffectName, Part
from pa10cal.terms.model import Model
from pa10cal.terms.term import Report, Term, TermParameter
from pa10cal.terms.wrapped import OfCampaign, of_campaign, of_one_campaign

if TYPE_CHECKING:
    import pandas as pd

M = TypeVar("M", bound=Instrument)

#: What a calibrated model lacks where the zero of a joint moved during its campaign.
OF_NO_ONE_STATE = (
    "the calibrated model takes readings before and after a step in the zero of a joint as those "
    "of one arm, and is of neither; the extended model is of the arm since the last step"
)

FLANGE, TOOL_FRAME, TARGET = "flange", "tool", "target_"


class FittedTo(Part):
    """What a model was fitted to."""

    campaign: str  # name of the campaign, or of the group of campaigns
    provenance: str  # where its data come from, in the campaign's own words
    calibration: str  # load case: `combined`, `general`, or a load such as `44N`
    instrument: str  # kind of the instrument
    poses: int  # poses fitted
    # mean temperature of those whose temperature was logged; None where none was
    temperature_C: float | None
    time_s: tuple[float, float]  # (2,) first and last of their times
    # of the calibration: `good`, `few_poses`, `incomplete`, `suspect_input` or `not_converged`;
    # empty where not known
    grade: str = ""
    health: str = ""  # the reason, and what to do, in one sentence
    # external loads of the poses, each once; empty where not known
    loads_N: tuple[float, ...] = ()
    # standard deviation of these temperatures; None where none was logged
    temperature_std_C: float | None = Field(None, exclude_if=lambda std_C: std_C is None)
    # (n,) root mean square uncertainty of the joint positions, as stated or by rounding [rad, m];
    # None where it was neither
    u_q_rad: tuple[float, ...] | None = Field(None, exclude_if=lambda u: u is None)
    # what is probably wrong in the input
    suspicions: tuple[InputFinding, ...] = Field((), exclude_if=lambda found: not found)
    # why its suspected outliers show that the model lacks something
    outliers_show: str = Field("", exclude_if=lambda text: not text)
    # coordinates of targets that neither the geometry of the arm shows nor anybody states
    open_targets: tuple[str, ...] = Field((), exclude_if=lambda names: not names)
    # checksums of its readings, one for each load, of a group of each campaign; empty where not
    # known
    readings: tuple[str, ...] = Field((), exclude_if=lambda sums: not sums)
    # checksums of the readings of the model that was its prior, and of the priors of that; empty
    # where it had none
    readings_of_prior: tuple[str, ...] = Field((), exclude_if=lambda sums: not sums)

    @classmethod
    def of(
        cls,
        poses: Observations,
        load: str,
        health: Health,
        campaign: CampaignIdentity,
        prior: FittedTo | None = None,
        open_targets: tuple[str, ...] = (),
    ) -> FittedTo:
        """Return the description of a fit by its poses, its load case and its health.

        Args:
            prior: the description of the model that was its prior; None without one.
            open_targets: coordinates of targets, see the attribute.
        """
        states = poses.states
        logged_C = states.temperature_C[np.isfinite(states.temperature_C)]
        u_q_rad = None
        if poses.log is not None and (u := poses.log.q_u_stated).any():
            u_q_rad = tuple(np.sqrt(np.mean(u**2, axis=0)).tolist())
        return cls(
            campaign=campaign.name,
            provenance=campaign.provenance,
            calibration=load,
            instrument=" and ".join(poses.measured.kinds),
            poses=len(poses),
            temperature_C=float(logged_C.mean()) if len(logged_C) else None,
            temperature_std_C=float(logged_C.std()) if len(logged_C) else None,
            time_s=(float(states.time_s.min()), float(states.time_s.max())),
            u_q_rad=u_q_rad,
            grade=health.grade,
            health=health.line,
            suspicions=health.findings,
            outliers_show=health.outliers_show,
            open_targets=open_targets,
            loads_N=tuple(map(float, np.unique(states.load_N))),
            readings=reading_checksums(poses),
            readings_of_prior=() if prior is None else prior.all_readings,
        )

    @property
    def all_readings(self) -> tuple[str, ...]:
        """Return the checksums of all readings that it rests on, those of its priors included."""
        return tuple(dict.fromkeys((*self.readings, *self.readings_of_prior)))

    def confirmed(
        self,
        *,
        departures: bool = True,
        campaigns: bool = False,
        effects: Collection[EffectName] = (),
        steps: bool = False,
    ) -> FittedTo:
        """Return it with what effects confirm or explain; it is incomplete if that is all.

        Args:
            departures: whether held-out poses confirm departures with the effects.
            campaigns: whether campaigns of a group do not contradict each other with them.
            effects: those found, which are what looked like a fault of the log.
            steps: whether the other model is of the arm since a step in the zero of a joint.
        """
        if steps and self.grade in UNRESERVED:
            return self.model_copy(update={"grade": "incomplete", "health": OF_NO_ONE_STATE})
        confirmed = [each for each in self.suspicions if departures and each.is_departure]
        explained = [each for each in self.suspicions if campaigns and each.between_campaigns]
        found = [each for each in self.suspicions if each.effect in effects]
        if self.grade != "suspect_input" or not self.suspicions:
            return self
        if len(confirmed) + len(explained) + len(found) < len(self.suspicions):
            return self
        health = "the calibrated model lacks the effects found"
        if explained:
            health = (
                "the calibrated model lacks what the verdict has, with which the campaigns agree"
            )
        if confirmed:
            first, *others = confirmed
            more = f", and {len(others)} more" if others else ""
            health += (
                f"; {first.where}: {first.what}{more}, as held-out poses confirm with these effects"
            )
        names = (f"{each.effect.id} of {each.effect.of}" for each in found if each.effect)
        health += "".join(f"; what looked like a fault of the log is {name}" for name in names)
        return self.model_copy(update={"grade": "incomplete", "health": health, "suspicions": ()})

    def is_confirmed_as(self, other: FittedTo | None) -> bool:
        """Return whether another is this with what it suspects confirmed or explained."""
        suspected = tuple(each.effect for each in self.suspicions if each.effect)
        ways = product((False, True), (False, True), ((), suspected))
        confirmed = [self.confirmed(departures=d, campaigns=c, effects=e) for d, c, e in ways]
        return other in (*confirmed, self.confirmed(steps=True))


@dataclass(frozen=True, eq=False)
class Prediction:
    """Poses of a frame of the robot as a fitted model predicts them, N of them."""

    T: Array  # (N, 4, 4) the frame in the robot's base frame [m]
    # (N,) standard uncertainty of its position relative to the fitted base: by the parameters, by
    # the discrepancy of the model, and by directions of arrival and temperatures that are not
    # given, if the model has lost motion or thermal growth; nan where it has no covariance
    u_mm: Array
    # (N,) the same without the discrepancy: what the noise of the measurement causes
    u_parameters_mm: Array
    # (N,) whether the pose is near poses of the fit, in all joint positions covered by it
    inside: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.T)

    def _repr_html_(self) -> str:
        """Return the positions as a notebook shows them."""
        positions = dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * self.T[:, :3, 3].T, strict=True))
        return _table({**positions, "u_mm": self.u_mm, "inside": self.inside})

    def with_others(
        self, rows: NDArray[np.bool_], T: Array, inside: NDArray[np.bool_]
    ) -> Prediction:
        """Return the prediction with other frames T (N, 4, 4) in some of the poses.

        The distance between both becomes part of the uncertainty.

        Args:
            rows: (N,) which poses get the other frames.
            inside: (N,) replaces `inside` in all poses.
        """
        moved_mm = 1e3 * np.linalg.norm(T[:, :3, 3] - self.T[:, :3, 3], axis=1)
        moved_mm[~rows] = 0.0
        return Prediction(
            np.where(rows[:, None, None], T, self.T),
            np.hypot(self.u_mm, moved_mm),
            np.hypot(self.u_parameters_mm, moved_mm),
            inside,
        )


@dataclass(frozen=True, eq=False)
class FallBack:
    """The model that replaces a model outside the joint positions for which its effects hold."""

    within: AngleCoverage  # joint positions for which they hold
    # the model without them, of the same arm and measured by the same instrument
    model: Fitted
    why: str = ""  # what held-out poses show, one sentence; empty where not known


@dataclass(frozen=True)
class Otherwise:
    """The model under another explanation of the same readings, as an error of the instrument."""

    model: Fitted  # of the same arm and measured by the same instrument
    probability: float  # that the other explanation is right


#: Result for a target: reached; reached by joint positions beyond their limits; not reached; or
#: reached where motion in some direction takes large motions of the joints.
Status = Literal["ok", "outside_limits", "unreachable", "near_singular"]


def unknown_controller() -> ModelError:
    """Return the refusal of Cartesian targets where the controller's own model is not known."""
    return ModelError(
        "it is not known what the controller computes with: it corrects an arm that its maker "
        "measured, and targets for the nominal arm would correct the robot twice",
        where="controller.compensation in campaign.yaml",
        value="on",
        allowed="joint positions; or the controller's own model, as controller.model in "
        "campaign.yaml, --controller, or in Python controller",
        remedy="command joint positions, name that model (of a UR: pa10cal import_arm "
        "calibration.conf), or switch the compensation off and name the nominal arm",
    )


@dataclass(frozen=True, eq=False)
class Compensation:
    """Joint positions that bring a frame of the robot to N poses, by its model."""

    # (N, m) positions to command [rad, m]; for an unreachable pose those that come nearest
    q: Array
    status: NDArray[np.str_]  # (N,) one of `Status`
    # (N,) `nearest` to the seed or to the row before, or an `other` branch, far from it: where all
    # branches are known, one that is not the nearest; else joints that jump by more than 0.3 rad
    branch: NDArray[np.str_]
    error_mm: Array  # (N,) distance of the model's position at q from the wanted one
    error_deg: Array  # (N,) angle between the model's orientation at q and the wanted one
    u_mm: Array  # (N,) standard uncertainty of the position, as of a prediction
    u_parameters_mm: Array  # (N,) the same without the discrepancy of the model
    inside: NDArray[np.bool_]  # (N,) whether the pose is near poses of the fit
    # (N, 4, 4) poses [m] to send, in the robot's base frame, to a controller with the TCP below: on
    # the same branch, it then commands q. They hold for the arm that the controller computes with,
    # the nominal one unless stated; nan where that is not known
    T_send: Array
    T_flange_tcp: Array  # (4, 4) TCP that the controller holds, in its flange [m]

    def __len__(self) -> int:
        return len(self.q)

    @classmethod
    def joined(cls, parts: Sequence[Compensation]) -> Compensation:
        """Return the rows of one or more parts, which have the same TCP, one after the other."""
        names = [column.name for column in fields(cls) if column.name != "T_flange_tcp"]
        rows = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return replace(parts[0], **rows)

    def cartesian(self, angles: Angles = "quaternion") -> dict[str, Array]:
        """Return the poses to send in the form of a controller.

        Args:
            angles: `ABC` of KUKA [deg], `quaternion` (scalar first), `rpy` [deg], or
                `rotation_vector` [rad].

        Returns:
            `send_x_mm`, `send_y_mm`, `send_z_mm` and the orientation's columns, (N,) each, as
            `pa10cal compensate --write cartesian` writes them.

        Raises:
            ArmError: when there are no such angles.
            ModelError: when it is not known what the controller computes with.
        """
        if np.isnan(self.T_send).any():
            raise unknown_controller()
        return {
            f"send_{name}": values
            for name, values in controller_columns(self.T_send, angles).items()
        }

    def _repr_html_(self) -> str:
        """Return the joint positions [rad, m] as a notebook shows them."""
        joints = {f"q{joint}": values for joint, values in enumerate(self.q.T, start=1)}
        shown = {"status": self.status, "error_mm": self.error_mm, "u_mm": self.u_mm}
        return _table({**joints, **shown, "inside": self.inside, "branch": self.branch})


def _table(columns: dict[str, NDArray[Any]]) -> str:
    import pandas as pd  # late: a prediction needs none

    html: str = pd.DataFrame(columns).to_html(max_rows=20)
    return html


@dataclass(frozen=True, eq=False, repr=False)
class Fitted:
    """A chain with terms and the values of their parameters, and what they were fitted to."""

    model: Model  # the nominal chain and the terms that move it off nominal, but for the base
    x: Array  # (k,) the terms' parameters
    T_instr_base: Array  # (4, 4) robot base in the instrument's frame [m]
    # (3, 3) orientation of the target in the end of the chain, for an instrument that measures
    # orientations; the target's position there is a term of the tool
    R_ee_target: Array = field(default_factory=lambda: np.eye(3))
    # (3, 3) orientation of the target of each campaign of a group in that of the first, by name
    R_first_target_of: Mapping[str, Array] = field(default_factory=dict)
    # (t,) positions of further targets in the flange, x, y, z of each
    targets_m: Array = field(default_factory=lambda: np.zeros(0))
    target_names: tuple[str, ...] = ()  # (t / 3,) their names
    # (a,) deviations of an apparatus' targets from their stated positions, which move the poses
    # measured by them; empty where not known
    targets_off_m: Array = field(default_factory=lambda: np.zeros(0))
    # (4, 4) the end that these targets show in the end of the chain [m], where they are further off
    # than places on an apparatus are: then it is the arm's end that is elsewhere
    T_end_shown: Array = field(default_factory=lambda: np.eye(4))
    # (k + 6 + t, k + 6 + t) of x, of six small motions of the base (the chain's `BASE`) and of the
    # targets' coordinates; None where not known. The joint covariance is needed since parameters of
    # arm, base and targets, such as the zero of joint 1 and the yaw of the base, are correlated:
    # each is uncertain, the robot's pose is not.
    covariance: Array | None = None
    # what the arm carried, which loads springs and bending links; None where not known
    payload: Payload | None = None
    fitted_to: FittedTo | None = None
    seen: AngleCoverage | None = None  # joint positions that the fit covers
    # error beyond the covariance, by the distance from the poses of the fit; None where not known
    discrepancy: Discrepancy | None = None
    # what is predicted where its effects do not hold; None where they hold everywhere
    falls_back: FallBack | None = None
    # what would be predicted if readings have another explanation; None where none is likely
    otherwise: Otherwise | None = None

    def __post_init__(self) -> None:
        count = len(self.model.parameters)
        if len(self.x) != count:
            raise ModelError(
                f"{len(self.x)} values for {count} parameters",
                where="model",
                allowed="one value for each parameter of the terms",
                remedy="write the model again",
            )

    @property
    def grade(self) -> str:
        """Return the grade of its calibration; empty where not known."""
        return "" if self.fitted_to is None else self.fitted_to.grade

    @property
    def arm(self) -> Arm:
        """Return the nominal arm."""
        return self.model.chain.arm

    @property
    def parameters(self) -> pd.DataFrame:
        """Return a table of the reported parameters: term, place, name, value, std and unit."""
        import pandas as pd  # late: a prediction needs none

        rows = [
            (term.id, term.of, parameter.name, value, std, parameter.unit)
            for term, parameter, value, std in self.every_reported()
        ]
        return pd.DataFrame(rows, columns=["term", "of", "parameter", "value", "std", "unit"])

    def reported(self, term: Term) -> tuple[Report, Array]:
        """Return one term as reported, and the standard uncertainties, nan where not known.

        Raises:
            ValueError: when it has no such term.
        """
        columns = self.model.columns_of(term)
        report = term.report(self.x[columns])
        if self.covariance is None:
            return report, np.full(len(report.values), np.nan)
        of_report = report.covariance(self.covariance[columns, columns], self.model.u_scale)
        return report, np.sqrt(np.maximum(np.diag(of_report), 0.0))

    def every_reported(self) -> Iterator[tuple[Term, TermParameter, float, float]]:
        """Yield the reported parameters of all terms: term, parameter, value, uncertainty."""
        for term in self.model.terms:
            report, std = self.reported(term)
            for parameter, value, sigma in zip(report.parameters, report.values, std, strict=True):
                yield term, parameter, float(value), float(sigma)

    def __repr__(self) -> str:
        """Return arm, campaign, grade, terms and frames, a line each."""
        fitted, grade = self.fitted_to, "no grade"
        if fitted is not None and fitted.grade:
            grade = f"grade: {fitted.grade}: {fitted.health}"
        counts = Counter(term.id for term in self.model.terms)
        terms = ", ".join(id if count == 1 else f"{count} {id}" for id, count in counts.items())
        return "\n".join(
            (
                f"<{type(self).__name__} of {self.arm.title}",
                "not fitted" if fitted is None else f"fitted to {fitted.campaign}",
                grade,
                f"{len(self.x)} parameters of {terms or 'no term'}: see .parameters",
                f"frames: {', '.join(self.frames)}>",
            )
        )

    def _repr_html_(self) -> str:
        """Return the model as a notebook shows it."""
        fitted = self.fitted_to
        about = (
            ""
            if fitted is None
            else f", fitted to {fitted.campaign}: {fitted.grade}: {fitted.health}"
        )
        return f"<p>{escape(self.arm.title + about)}</p>{self.parameters.to_html(index=False)}"

    @property
    def tools(self) -> dict[str, OfCampaign]:
        """Return the tools of the campaigns of a group that measured poses, by name of frame."""
        return {
            of_campaign(TOOL_FRAME, term.name): term
            for term in self.model.terms
            if of_one_campaign(term) and set(term.coordinates) <= set(TOOL)
        }

    @property
    def frames(self) -> tuple[str, ...]:
        """Return the frames that it can predict."""
        targets = (f"{TARGET}{name}" for name in self.target_names)
        return (FLANGE, TOOL_FRAME, *self.tools, *targets)

    def with_bends(self, rows: Iterable[int] = ()) -> Self:
        """Return the same model on a chain in which more links may bend, as effects need.

        They are the long links, the carriages of prismatic joints and those of further rows, from
        1. Where weights are stated, all links: effects of tilting axes are sought there.
        """
        bends = {*long_links(self.arm), *self.model.chain.bends, *rows}
        bends |= {*(np.flatnonzero(self.arm.prismatic[:-1]) + 1).tolist()}
        if weights_known(self.arm).origin == "stated":
            bends |= {*range(1, self.arm.n)}
        chain = Chain.of(self.arm, bends=tuple(sorted(bends)))
        return replace(self, model=Model(chain, self.model.terms))

    def bending_as(self, terms: Iterable[Term]) -> Self:
        """Return the same model on a chain in which the links that terms bend may bend too."""
        used = {name for term in terms for name in term.coordinates}
        rows = range(1, self.arm.n)
        return self.with_bends(row for row in rows if not used.isdisjoint(bend_coordinates(row)))

    def as_modelled(self, observations: Observations[M]) -> Observations[M]:
        """Return observations in the form that the model predicts.

        Orientations are those of the end-effector in place of the target's; torques that were not
        logged are computed by the masses described, at the posture of the model.
        """
        states, _ = with_torques(self.model, self.x, observations.states, self.payload)
        return observations.turned(self.R_ee_target).with_states(states)

    def rigid_part(self, *, tool: bool = False) -> tuple[Chain, Array]:
        """Return the chain and its coordinates (m,) at zero joint positions, unloaded.

        Args:
            tool: whether the coordinates of the tool are those of the model; else they are zero,
                and the chain ends at the flange.
        """
        zeros, zero = np.zeros((1, self.arm.n)), np.zeros(1)
        unloaded = PoseStates(zeros, zeros, zeros, zero, zero, zero)
        constant = [term for term in self.model.terms if term.constant]
        x, chain = self.x[self.model.parameter_indices(*constant)], self.model.chain
        at = Model(chain, tuple(constant)).chain_coordinates(unloaded, x)[0]
        if not tool:
            at[chain.columns(TOOL)] = 0.0
        return chain, at

    def deviations(self, observations: Observations) -> Deviations:
        """Compare predictions with observations whose states hold what the terms need."""
        measured = observations.measured.turned(self.R_ee_target)
        T_base_ee = self.as_read(observations)
        deviations = measured.deviations(
            T_base_ee, self.T_instr_base, self.targets_read_m(observations.states)
        )
        if self.falls_back is None:
            return deviations
        outside = ~self.falls_back.within.inside(observations.states.q_rad)
        return deviations.replaced_where(outside, self.falls_back.model.deviations(observations))

    def compared(self, observations: Observations) -> Comparison:
        """Compare predictions with `as_modelled` poses, component by component."""
        T_instr_ee = self.T_instr_base @ self.model.predict(observations.states, self.x)
        return observations.measured.compare(T_instr_ee, self.targets_read_m(observations.states))

    def targets_read_m(self, states: PoseStates) -> Array:
        """Return the targets' coordinates in the end-effector frame, (t,), as the model has them.

        (P, t) where the instrument reads their pattern distorted.
        """
        if not len(self.targets_m):
            return self.targets_m
        return self.targets_m + self.model.distortion_m(states, self.x)

    def as_read(self, observations: Observations) -> Array:
        """Return the end of the chain as the instrument is expected to read it, (P, 4, 4) [m]."""
        T_base_ee = self.model.predict(observations.states, self.x)
        if not len(self.targets_off_m):
            return T_base_ee
        return observations.measured.as_read(T_base_ee, self.T_instr_base, self.targets_off_m)

    def nominal(self) -> Self:
        """Return the nominal arm at the same base: it has no grade, and no uncertainty."""
        rigid = Model(self.model.chain, ())
        of_fit = ("covariance", "fitted_to", "discrepancy", "falls_back", "otherwise")
        none: dict[str, Any] = dict.fromkeys(of_fit)
        return replace(self, model=rigid, x=np.zeros(0), **none)

    def only(self, *terms: Term) -> Self:
        """Return the model with only these of its terms, their values and their covariance."""
        at, covariance = self.model.parameter_indices(*terms), self.covariance
        if covariance is not None:
            kept = np.append(at, np.arange(len(self.x), len(covariance)))
            covariance = covariance[np.ix_(kept, kept)]
        model = Model(self.model.chain, terms)
        return replace(self, model=model, x=self.x[at], covariance=covariance)

    def values_of(self, term: Term) -> Array:
        """Return the parameters of one of its terms (ValueError where it has no such term)."""
        return self.x[self.model.columns_of(term)]

    def inside(self, q: Array) -> NDArray[np.bool_]:
        """Return which joint positions (N, n) are near poses of the fit, (N,).

        For a model without a discrepancy: which are covered by the fit, or all if that is unknown.
        """
        if self.discrepancy is not None:
            return self.discrepancy.near(q)
        return np.ones(len(q), dtype=bool) if self.seen is None else self.seen.inside(q)


def departures_hardly_known(model: Fitted) -> Array:
    """Return rows (r, k) of a prior of a model's departures along what its fit hardly determined.

    Links and zeros are as accurate as each other; none without a covariance. See `hardly_known`.
    """
    k = len(model.x)
    if model.covariance is None or len(model.covariance) < k:
        return np.zeros((0, k))
    covariance = model.covariance[:k, :k]
    groups = [model.model.having(*roles) for roles in DEPARTURES]
    usual = usual_departures(model.x, covariance, model.model.scale, groups)
    return hardly_known(covariance, usual)


def predicting_model(model: Fitted) -> Fitted:
    """Return the model that predicts: where effects hold nowhere, what a model falls back to.

    The file of a model has no covariance of the other one. That of the same parameters, fitted
    together with the effects, stands for it: it is the larger one.
    """
    if model.falls_back is None or not model.falls_back.within.nowhere:
        return model
    away = model.falls_back.model
    covariance = _covariance_of(model, away) if away.covariance is None else away.covariance
    return replace(away, covariance=covariance, fitted_to=model.fitted_to)


def _covariance_of(model: Fitted, other: Fitted) -> Array | None:
    """Return a model's covariance of the parameters of another one, of the base and the targets.

    None where it is not known of all.
    """
    index = {parameter.name: k for k, parameter in enumerate(model.model.parameters)}
    names = [parameter.name for parameter in other.model.parameters]
    if model.covariance is None or not index.keys() >= set(names):
        return None
    at = [*(index[name] for name in names), *range(len(model.x), len(model.covariance))]
    return np.asarray(model.covariance[np.ix_(at, at)])
