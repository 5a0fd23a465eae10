"""A fitted model: everything that a user takes away from a calibration, and what it predicts."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pa10cal.arm.chain import (
    BASE,
    TOOL,
    Chain,
    EndPose,
    end_pose,
    end_pose_with_screws,
    long_links,
)
from pa10cal.arm.description import Arm
from pa10cal.arm.state import PoseStates
from pa10cal.arm.statics import Payload
from pa10cal.errors import ModelError
from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.fit.loads import statics_of, with_torques
from pa10cal.fit.prediction import FallBack as FallBack
from pa10cal.fit.prediction import FittedTo as FittedTo
from pa10cal.fit.prediction import Prediction as Prediction
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Deviations
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import Offsets
from pa10cal.terms.term import Report, Term, falsifies_log, yields

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
M = TypeVar("M", bound=Instrument)

FLANGE, TOOL_FRAME, TARGET = "flange", "tool", "target_"


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A chain with terms and the values of their parameters; enough by itself to predict.

    Attributes:
        model: the nominal chain, and the terms that move it off nominal. The base frame is apart.
        x: (k,) the terms' parameters.
        T_instr_base: (4, 4) robot base in the instrument's frame [m].
        R_ee_target: (3, 3) attitude of the target in the end of the chain, for an instrument that
            measures attitudes; the target's place there is the term of the tool.
        targets_m: (t,) places of further targets in the flange, x, y, z of each.
        targets_off_m: (a,) by how much the places of an apparatus' targets are off those stated,
            which moves poses measured through them; empty where that is not known.
        target_names: (t / 3,) their names.
        covariance: (k + 6, k + 6) of x and of six small motions of the base (the chain's `BASE`),
            or None where it is not known. Arm and base are kept together, since what they share,
            such as the zero of joint 1 and the yaw of the base, is uncertain in each and not in
            where the robot is.
        payload: what the arm carried, which springs and bending links need; None where not known.
        fitted_to: what it was fitted to, or None.
        seen: joint positions seen by the fit, or None.
        falls_back: where its effects do not hold, and what is predicted there; None where they hold
            everywhere.
    """

    model: Model
    x: Array
    T_instr_base: Array
    R_ee_target: Array = field(default_factory=lambda: np.eye(3))
    targets_m: Array = field(default_factory=lambda: np.zeros(0))
    target_names: tuple[str, ...] = ()
    targets_off_m: Array = field(default_factory=lambda: np.zeros(0))
    covariance: Array | None = None
    payload: Payload | None = None
    fitted_to: FittedTo | None = None
    seen: AnglesSeen | None = None
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

    def rigid_part(self) -> tuple[Chain, Array]:
        """Return the chain, and its coordinates (m,) at zero joints, unloaded, at the flange."""
        zeros, zero = np.zeros((1, self.arm.n)), np.zeros(1)
        unloaded = PoseStates(zeros, zeros, zeros, zero, zero, zero)
        constant = [term for term in self.model.terms if isinstance(term, Offsets)]
        x = np.concatenate([np.zeros(0), *(self.values_of(term) for term in constant)])
        chain = self.model.chain
        at = Model(chain, tuple(constant)).chain_coordinates(unloaded, x)[0]
        at[chain.columns(TOOL)] = 0.0
        return chain, at

    def deviations(self, observations: Observations) -> Deviations:
        """Compare predictions with observations whose states hold what the terms need."""
        measured = observations.measured.turned(self.R_ee_target)
        found = measured.deviations(self.as_read(observations), self.T_instr_base, self.targets_m)
        if self.falls_back is None:
            return found
        outside = ~self.falls_back.within.inside(observations.states.q_rad)
        return found.with_others(outside, self.falls_back.model.deviations(observations))

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
        temperature_C: float | None = None,
        time_s: float | None = None,
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
            temperature_C: temperature; None for the mean of the fit.
            time_s: time on the campaign's clock; None for the middle of the fit.

        Raises:
            ModelError: when q is of another arm, the frame is unknown, or the model has springs and
                the masses that load them are not known.
        """
        states = self.states(q, load_N, arrival, temperature_C, time_s)
        physical, x, columns = self._physical
        at = physical.chain_coordinates(states, x)
        if not self._on_tool(frame):
            at[:, physical.chain.columns(TOOL)] = 0.0
        if self.covariance is None:
            T, u_mm = end_pose(physical.chain, at), np.full(len(states), np.nan)
        else:
            end = end_pose_with_screws(physical.chain, at)
            T, u_mm = end.T, self._uncertainty_mm(states, frame, end, columns)
        inside = (
            np.ones(len(states), dtype=bool)
            if self.seen is None
            else self.seen.inside(states.q_rad)
        )
        found = Prediction(T @ self._T_end_frame(frame), u_mm, inside)
        if self.falls_back is None:
            return found
        without = self.falls_back.model
        given = {"temperature_C": temperature_C, "time_s": time_s}
        away = without.predict(q, frame=frame, load_N=load_N, arrival=arrival, **given)
        T = np.linalg.inv(self.T_instr_base) @ without.T_instr_base @ away.T
        return found.with_others(~self.falls_back.within.inside(states.q_rad), T)

    def jacobian(self, q: ArrayLike, *, frame: str = FLANGE, load_N: ArrayLike = 0.0) -> Array:
        """Return how a frame moves with the joints, (N, 6, n), at positions as for `predict`.

        Velocity of its origin [m] over angular velocity [rad], along base axes, a unit of each
        joint. How the terms themselves change with the joints (some parts in a thousand; a few in
        a hundred for a strong transmission error) is omitted.
        """
        states = self.states(q, load_N, 0.0, None, None)
        physical, x, _ = self._physical
        at = physical.chain_coordinates(states, x)
        if not self._on_tool(frame):
            at[:, physical.chain.columns(TOOL)] = 0.0
        end = end_pose_with_screws(physical.chain, at)
        arm_m = (end.T[:, :3, :3] @ self._T_end_frame(frame)[:3, 3])[:, :, None]
        screws = end.screws[:, :, physical.chain.joint_columns]
        moved: Array = screws.copy()
        moved[:, :3] += np.cross(screws[:, 3:], arm_m, axis=1)
        return moved

    def states(
        self,
        q: ArrayLike,
        load_N: ArrayLike = 0.0,
        arrival: ArrayLike = 0.0,
        temperature_C: float | None = None,
        time_s: float | None = None,
    ) -> PoseStates:
        """Return the states in which poses are predicted, with what their weights do.

        Raises:
            ModelError: see `predict`.
        """
        positions = np.atleast_2d(np.asarray(q, dtype=float))
        n, count = self.arm.n, len(positions)
        if positions.ndim != 2 or positions.shape[1] != n:
            raise ModelError(
                f"joint positions of {positions.shape[-1]} joints",
                where="q",
                value=positions.shape,
                allowed=f"(N, {n}) for {self.arm.name}",
                remedy="give one column a joint, in radians (metres for a joint that slides)",
            )
        fitted = self.fitted_to
        if temperature_C is None:
            temperature_C = np.nan if fitted is None else fitted.temperature_C
        if time_s is None:
            time_s = 0.0 if fitted is None else 0.5 * sum(fitted.time_s)
        states = PoseStates(
            q_rad=positions,
            tau_Nm=np.full((count, n), np.nan),
            arrival=np.broadcast_to(np.asarray(arrival, dtype=float), (count, n)),
            load_N=np.broadcast_to(np.asarray(load_N, dtype=float), (count,)),
            temperature_C=np.full(count, temperature_C),
            time_s=np.full(count, time_s),
        )
        states, source = with_torques(self.model, self.x, states, self.payload)
        physical, x, _ = self._physical
        if source == "none" or self.payload is None:
            self._refuse_springs()
            return replace(states, tau_Nm=np.zeros((count, n)))
        # Terms that bend need the static loads; those of the nominal arm come first.
        rigid = Model(physical.chain, ())
        for model, values in ((rigid, np.zeros(0)), (physical, x)):
            loads = statics_of(model, values, states, self.payload).static_loads
            states = replace(states, static_loads=loads)
        return states

    @cached_property
    def _physical(self) -> tuple[Model, Array, NDArray[np.intp]]:
        """Return the terms that move the robot, their parameters, and the places of these in x."""
        moving = [
            term for term in self.model.terms if term.of != "instrument" and not falsifies_log(term)
        ]
        columns = [np.arange(len(self.x))[self.model.columns_of(term)] for term in moving]
        chosen = np.concatenate([np.zeros(0, dtype=np.intp), *columns])
        return Model(self.model.chain, tuple(moving)), self.x[chosen], chosen

    def _refuse_springs(self) -> None:
        """Refuse to predict springs whose torques are not known."""
        springs = [term for term in self._physical[0].terms if yields(term)]
        if springs:
            raise ModelError(
                "the weights that load the arm are not known",
                where=f"{springs[0].id} of {springs[0].of}",
                allowed="an arm with mass_kg and com_m, and a payload",
                remedy="describe the masses and calibrate again",
            )

    def _on_tool(self, frame: str) -> bool:
        """Return whether a frame follows the end of the chain, tool included, not the flange."""
        if frame not in self.frames:
            raise ModelError(
                "unknown frame",
                where="frame",
                value=frame,
                allowed=", ".join(self.frames),
                remedy="correct the name",
            )
        return frame != FLANGE and not self.target_names

    def _T_end_frame(self, frame: str) -> Array:
        """Return a frame in the end of the chain, (4, 4)."""
        T = np.eye(4)
        if self._on_tool(frame):
            T[:3, :3] = self.R_ee_target
        elif frame != FLANGE:
            name = frame.removeprefix(TARGET)
            row = self.target_names.index(name) if frame != TOOL_FRAME else 0
            T[:3, 3] = self.targets_m.reshape(-1, 3)[row]
        return T

    def _uncertainty_mm(
        self, states: PoseStates, frame: str, end: EndPose, columns: NDArray[np.intp]
    ) -> Array:
        """Return the standard uncertainty of the position of a frame, (N,)."""
        physical, x, _ = self._physical
        assert self.covariance is not None
        on_tool = self._on_tool(frame)
        arm_m = (end.T[:, :3, :3] @ self._T_end_frame(frame)[:3, 3])[:, :, None]
        by_x = physical.jacobian_at(states, x, end, without=() if on_tool else TOOL)
        by_base = end.screws[:, :, physical.chain.columns(BASE)]
        by_all = np.concatenate([by_x, by_base], axis=2)
        moved = by_all[:, :3] + np.cross(by_all[:, 3:], arm_m, axis=1)
        chosen = np.concatenate([columns, len(self.x) + np.arange(6)])
        covariance = self.covariance[np.ix_(chosen, chosen)]
        variance = np.einsum("pik,kl,pil->p", moved, covariance, moved, optimize=True)
        uncertainty: Array = 1e3 * np.sqrt(np.maximum(variance, 0.0))
        return uncertainty
