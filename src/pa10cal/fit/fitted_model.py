"""A fitted model: everything that a user takes away from a calibration, and what it predicts."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pa10cal.arm.chain import TOOL, Chain, end_pose, long_links
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.fit.forward import FLANGE, TARGET, TOOL_FRAME, Forward, conditions, predicted
from pa10cal.fit.loads import with_torques
from pa10cal.fit.prediction import Compensation, FallBack, FittedTo, Prediction
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Comparison, Deviations
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import is_constant
from pa10cal.terms.term import Report, Term

if TYPE_CHECKING:
    import pandas as pd

M = TypeVar("M", bound=Instrument)


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A chain with terms and the values of their parameters; enough by itself to predict."""

    # the nominal chain, and the terms that move it off nominal. The base frame is apart.
    model: Model
    x: Array  # (k,) the terms' parameters
    T_instr_base: Array  # (4, 4) robot base in the instrument's frame [m]
    # (3, 3) attitude of the target in the end of the chain, for an instrument that measures
    # attitudes; the target's place there is the term of the tool
    R_ee_target: Array = field(default_factory=lambda: np.eye(3))
    # (t,) places of further targets in the flange, x, y, z of each
    targets_m: Array = field(default_factory=lambda: np.zeros(0))
    target_names: tuple[str, ...] = ()  # (t / 3,) their names
    # (a,) by how much the places of an apparatus' targets are off those stated, which moves poses
    # measured through them; empty where that is not known
    targets_off_m: Array = field(default_factory=lambda: np.zeros(0))
    # (k + 6, k + 6) of x and of six small motions of the base (the chain's `BASE`), or None where
    # it is not known. Arm and base are kept together, since what they share, such as the zero of
    # joint 1 and the yaw of the base, is uncertain in each and not in where the robot is.
    covariance: Array | None = None
    # what the arm carried, which springs and bending links need; None where not known
    payload: Payload | None = None
    fitted_to: FittedTo | None = None  # what it was fitted to, or None
    seen: AnglesSeen | None = None  # joint positions seen by the fit, or None
    # where its effects do not hold, and what is predicted there; None where they hold everywhere
    falls_back: FallBack | None = None

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
        """Return how good its calibration is, in a word; empty where that is not known."""
        return "" if self.fitted_to is None else self.fitted_to.grade

    @property
    def arm(self) -> Arm:
        """Return the nominal arm."""
        return self.model.chain.arm

    def save(self, path: str | Path) -> None:
        """Write the model as `model.yaml`, its covariance beside it, whole or not at all.

        Raises:
            OutputError: when it cannot be written there.
        """
        from pa10cal.fit.model_file import save_model  # late: it imports this module

        save_model(self, Path(path))

    @property
    def parameters(self) -> pd.DataFrame:
        """Return the parameters as readers know them: term, place, name, value, std and unit."""
        import pandas as pd  # late: a prediction needs none

        rows = []
        for term in self.model.terms:
            report, std = self.reported(term)
            rows += [
                (term.id, term.of, parameter.name, value, sigma, parameter.unit)
                for parameter, value, sigma in zip(
                    report.parameters, report.values, std, strict=True
                )
            ]
        return pd.DataFrame(rows, columns=["term", "of", "parameter", "value", "std", "unit"])

    def reported(self, term: Term) -> tuple[Report, Array]:
        """Return what readers know of one of its terms, and standard uncertainties (nan: unknown).

        Raises:
            ValueError: when it has no such term.
        """
        columns = self.model.columns_of(term)
        report = term.report(self.x[columns])
        if self.covariance is None:
            return report, np.full(len(report.values), np.nan)
        own = report.jacobian @ self.covariance[columns, columns] @ report.jacobian.T
        return report, np.sqrt(np.maximum(np.diag(own), 0.0))

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
    def frames(self) -> tuple[str, ...]:
        """Return the frames that it can predict."""
        return (FLANGE, TOOL_FRAME, *(f"{TARGET}{name}" for name in self.target_names))

    def with_bends(self) -> FittedModel:
        """Return the same model on a chain whose long links may bend, as some effects do."""
        chain = Chain.of(self.arm, bends=long_links(self.arm))
        return replace(self, model=Model(chain, self.model.terms))

    def as_modelled(self, observations: Observations[M]) -> Observations[M]:
        """Return measured poses as the model predicts them.

        Attitudes are those of the end-effector in place of the target's; torques that were not
        logged are those of the masses described, at the posture modelled.
        """
        states, _ = with_torques(self.model, self.x, observations.states, self.payload)
        return observations.turned(self.R_ee_target).with_states(states)

    def rigid_part(self, *, tool: bool = False) -> tuple[Chain, Array]:
        """Return the chain, and its coordinates (m,) at zero joints, unloaded, at the flange.

        Args:
            tool: with the tool, at the chain's end.
        """
        zeros, zero = np.zeros((1, self.arm.n)), np.zeros(1)
        unloaded = PoseStates(zeros, zeros, zeros, zero, zero, zero)
        constant = [term for term in self.model.terms if is_constant(term)]
        x = np.concatenate([np.zeros(0), *(self.values_of(term) for term in constant)])
        chain = self.model.chain
        at = Model(chain, tuple(constant)).chain_coordinates(unloaded, x)[0]
        if not tool:
            at[chain.columns(TOOL)] = 0.0
        return chain, at

    def T_flange_frame(self, frame: str) -> Array:
        """Return where a frame is in the flange, unloaded, (4, 4) [m].

        Raises:
            ModelError: when the frame is unknown.
        """
        forward = Forward.of(self, frame)
        chain, at_flange = self.rigid_part()
        _, at_end = self.rigid_part(tool=forward.on_tool)
        T_base_flange, T_base_end = end_pose(chain, np.stack([at_flange, at_end]))
        T: Array = np.linalg.inv(T_base_flange) @ T_base_end @ forward.T_end_frame
        return T

    def deviations(self, observations: Observations) -> Deviations:
        """Compare predictions with observations whose states hold what the terms need."""
        measured = observations.measured.turned(self.R_ee_target)
        found = measured.deviations(self.as_read(observations), self.T_instr_base, self.targets_m)
        if self.falls_back is None:
            return found
        outside = ~self.falls_back.within.inside(observations.states.q_rad)
        return found.with_others(outside, self.falls_back.model.deviations(observations))

    def compared(self, observations: Observations) -> Comparison:
        """Compare predictions with `as_modelled` poses, component by component."""
        T_instr_ee = self.T_instr_base @ self.model.predict(observations.states, self.x)
        return observations.measured.compare(T_instr_ee, self.targets_m)

    def as_read(self, observations: Observations) -> Array:
        """Return the end of the chain as the instrument is expected to read it, (P, 4, 4) [m]."""
        T_base_ee = self.model.predict(observations.states, self.x)
        if not len(self.targets_off_m):
            return T_base_ee
        off_m = self.targets_off_m
        return observations.measured.as_read(T_base_ee, self.T_instr_base, off_m)

    def nominal(self) -> FittedModel:
        """Return the arm as it was designed, at the same base."""
        rigid = Model(self.model.chain, ())
        return replace(self, model=rigid, x=np.zeros(0), covariance=None, falls_back=None)

    def values_of(self, term: Term) -> Array:
        """Return the parameters of one of its terms (ValueError where it has no such term)."""
        return self.x[self.model.columns_of(term)]

    def predict(
        self,
        q: ArrayLike,
        *,
        frame: str = FLANGE,
        load_N: ArrayLike = 0.0,
        arrival: ArrayLike = 0.0,
        temperature_C: ArrayLike | None = None,
        time_s: ArrayLike | None = None,
        extrapolate: bool = False,
    ) -> Prediction:
        """Predict where a frame of the robot is.

        Torques are those of the weights described. What an instrument reads falsely, and what a
        torque log shows falsely, moves no robot and plays no part.

        Args:
            q: (N, n) or (n,) motor-side joint positions [rad; m for a prismatic joint].
            frame: `flange`, the last frame of the nominal arm; `tool`, the target of a pose
                instrument, else the first target with the flange's attitude; `target_<name>`.
            load_N: external load, one for all poses or (N,).
            arrival: direction in which each joint arrives, -1, 0 or 1; one for all or (N, n).
            temperature_C: temperature, one or (N,); None for the mean of the fit.
            time_s: time on the campaign's clock, one or (N,); None for the middle of the fit.
            extrapolate: predict also for loads heavier than any that the fit has seen.

        Raises:
            ModelError: when q is of another arm, the frame is unknown, a load is heavier than those
                of the fit, or the model has springs and the masses that load them are not known.
        """
        positions = self._positions(q)
        given = conditions(
            self,
            len(positions),
            load_N,
            arrival,
            temperature_C,
            time_s,
            extrapolate=extrapolate,
        )
        return predicted(self, positions, frame, given)

    def compensate(
        self,
        T: ArrayLike,
        *,
        frame: str = FLANGE,
        seed: ArrayLike | None = None,
        load_N: ArrayLike = 0.0,
        arrival: ArrayLike = 0.0,
        temperature_C: ArrayLike | None = None,
        time_s: ArrayLike | None = None,
        extrapolate: bool = False,
    ) -> Compensation:
        """Find the joint positions to command so that a frame of the robot comes to poses.

        Args:
            T: (N, 4, 4) or (4, 4) poses wanted of the frame, in the robot's base frame [m].
            seed: (N, n) or (n,) joint positions; of all branches the nearest within the joint
                limits is taken. A row of nan, and every row but the first where (n,) is given, has
                the nearest to the row before; without any the first row has the nearest to the
                middle of the angles that the fit has seen.
            frame, load_N, arrival, temperature_C, time_s, extrapolate: see `predict`.

        Raises:
            ModelError: when a pose is none, or see `predict`.
        """
        from pa10cal.fit.compensation import compensate  # late: it imports this module

        wanted = np.asarray(T, dtype=float)
        wanted = wanted[None] if wanted.ndim == 2 else wanted
        given = conditions(
            self, len(wanted), load_N, arrival, temperature_C, time_s, extrapolate=extrapolate
        )
        return compensate(self, wanted, frame, given, seed)

    def jacobian(self, q: ArrayLike, *, frame: str = FLANGE, load_N: ArrayLike = 0.0) -> Array:
        """Return how a frame moves with the joints, (N, 6, n), at positions as for `predict`.

        Velocity of its origin [m] over angular velocity [rad], along base axes, a unit of each
        joint. Exact: springs and effects, which change with angles and weights, are in it.
        """
        forward, positions = Forward.of(self, frame), self._positions(q)
        given = conditions(self, len(positions), load_N)
        states = forward.states(positions, given)
        return forward.by_joints(states, given, terms=True)[1]

    def inside(self, q: Array) -> NDArray[np.bool_]:
        """Return whether all joint angles of positions (N, n) were seen by the fit, (N,)."""
        return np.ones(len(q), dtype=bool) if self.seen is None else self.seen.inside(q)

    def states(self, q: ArrayLike, load_N: ArrayLike = 0.0) -> PoseStates:
        """Return the states in which poses are predicted, with what their weights do.

        Raises:
            ModelError: see `predict`.
        """
        positions = self._positions(q)
        return Forward.of(self).states(positions, conditions(self, len(positions), load_N))

    def _positions(self, q: ArrayLike) -> Array:
        """Return joint positions (N, n).

        Raises:
            ModelError: when they are of an arm with other joints, or are no numbers.
        """
        positions = np.atleast_2d(np.asarray(q, dtype=float))
        n = self.arm.n
        if positions.ndim != 2 or positions.shape[1] != n or not np.isfinite(positions).all():
            raise ModelError(
                f"joint positions of {positions.shape[-1]} joints"
                if positions.shape[-1] != n
                else "joint positions that are no finite numbers",
                where="q",
                value=positions.shape,
                allowed=f"(N, {n}) for {self.arm.name}",
                remedy="give one column a joint, in radians (metres for a joint that slides)",
            )
        return positions
