"""A fitted model as users have it: it predicts poses, compensates joint positions, and is saved."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.fit.compensation import compensate, numbers
from pa10cal.fit.fitted import FLANGE, Compensation, Fitted, Prediction
from pa10cal.fit.forward import Forward, T_flange_frame, predicted, states_at
from pa10cal.fit.loads import BLOCK
from pa10cal.fit.model_writing import save_model


@dataclass(frozen=True, eq=False, repr=False)
class FittedModel(Fitted):
    """A chain with terms and the values of their parameters: all that predictions need."""

    def save(self, path: str | Path) -> None:
        """Write the model as `model.yaml`, its covariance beside it, whole or not at all.

        Raises:
            OutputError: when it cannot be written there.
        """
        save_model(self, Path(path))

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

        Torques are those of the weights described, or of those that the fit found beside them. A
        load that was found to be stated wrongly is, under the number stated, what it was found to
        be; others are what they are called. What an instrument reads falsely, and what a torque log
        shows falsely, moves no robot and plays no part.

        Args:
            q: (N, m) or (m,) joint positions, as the controller counts them [rad; m if prismatic].
            frame: `flange`, the last frame of the nominal arm; `tool`, the target of a pose
                instrument, else the first target with the flange's orientation; `target_<name>`. Of
                a group also `tool@<campaign>` and `target_<name>@<campaign>`.
            load_N: external load, one for all poses or (N,).
            arrival: direction in which each joint arrives, -1 or 1, one for all or (N, m); 0 where
                it is not known, whose lost motion is then part of `u_mm`.
            temperature_C: temperature, one or (N,); None or nan where it is not known: the mean of
                the fit is taken, and the spread of its temperatures is then part of `u_mm`.
            time_s: time on the campaign's clock, one or (N,), for a base that moves with time; None
                or nan where none is meant: the base is then where `T_instr_base` has it.
            extrapolate: predict also for loads heavier than any that the fit has seen.

        Raises:
            ModelError: when q is of another arm, the frame is unknown, a load is heavier than those
                of the fit, or the model has springs and the masses that load them are not known.
        """
        of_pose = load_N, arrival, temperature_C, time_s
        states = states_at(self, self._joints_at(q), *of_pose, extrapolate=extrapolate)
        return predicted(self, states, frame)

    def predict_in_blocks(
        self,
        q: ArrayLike,
        *,
        frame: str = FLANGE,
        load_N: ArrayLike = 0.0,
        arrival: ArrayLike = 0.0,
        temperature_C: ArrayLike | None = None,
        time_s: ArrayLike | None = None,
        extrapolate: bool = False,
        rows: int = BLOCK,
    ) -> Iterator[tuple[slice, Prediction]]:
        """Yield predictions of so many rows at a time, each with its slice of q; see `predict`.

        A prediction takes some kilobytes a pose; these take what a block does, however many poses.

        Raises:
            ModelError: see `predict`, before anything is predicted.
        """
        of_pose = load_N, arrival, temperature_C, time_s
        given = states_at(self, self._joints_at(q), *of_pose, extrapolate=extrapolate)
        for first in range(0, len(given), rows):
            block = slice(first, first + rows)
            yield block, predicted(self, given.take(block), frame)

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
        T_flange_tcp: ArrayLike | None = None,
        controller: Arm | None = None,
    ) -> Compensation:
        """Find the joint positions to command so that a frame of the robot comes to poses.

        `T_send`, and `cartesian(angles)` of what is returned, have the poses to send to a
        controller that takes no joint positions.

        Args:
            T: (N, 4, 4) or (4, 4) poses wanted of the frame, in the robot's base frame [m].
            seed: (N, m) or (m,) joint positions; of all branches the nearest within the joint
                limits is taken (of those found, where they have no closed form). A row of nan, and
                every row but the first where (m,) is given, has the nearest to the row before;
                without any the first row has the nearest to the middle of the angles that the fit
                has seen.
            frame, load_N, arrival, temperature_C, time_s, extrapolate: see `predict`.
            T_flange_tcp: (4, 4) TCP that the controller holds, in its flange [m]; None for the
                frame as the model has it (none for the flange).
            controller: arm that the controller computes with, as `load_arm` gives it; None for what
                the campaign states, else the nominal arm.

        Raises:
            ModelError: when a pose is none, a seed of another arm, or see `predict`.
            ArmError: when the controller computes with another robot.
        """
        wanted = np.atleast_1d(numbers(T, "T"))
        wanted = wanted[None] if wanted.ndim == 2 else wanted
        nowhere = np.zeros((len(wanted), self.arm.n))
        of_pose = load_N, arrival, temperature_C, time_s
        given = states_at(self, nowhere, *of_pose, extrapolate=extrapolate)
        return compensate(self, wanted, frame, given, seed, T_flange_tcp, controller)

    def jacobian(self, q: ArrayLike, *, frame: str = FLANGE, load_N: ArrayLike = 0.0) -> Array:
        """Return how a frame moves with the joints, (N, 6, m), at positions as for `predict`.

        Velocity of its origin [m] over angular velocity [rad], along base axes, a unit of each
        joint. Exact: springs and effects, which change with angles and weights, are in it.
        """
        forward, given = Forward.of(self, frame), states_at(self, self._joints_at(q), load_N)
        by_joints = forward.by_joints(forward.states(given), terms=True)[1]
        return self.arm.coupling.by_axes(by_joints)

    def states(self, q: ArrayLike, load_N: ArrayLike = 0.0) -> PoseStates:
        """Return the states in which poses are predicted, with what their weights do.

        Raises:
            ModelError: see `predict`.
        """
        return Forward.of(self).states(states_at(self, self._joints_at(q), load_N))

    def T_flange_frame(self, frame: str) -> Array:
        """Return where a frame is in the flange, unloaded, (4, 4) [m].

        Raises:
            ModelError: when the frame is unknown.
        """
        return T_flange_frame(self, frame)

    def _joints_at(self, q: ArrayLike) -> Array:
        """Return joint positions (N, n) from those that the controller counts; refuse others."""
        positions, count = np.atleast_2d(numbers(q, "q")), len(self.arm.axes_slide)
        if positions.ndim != 2:
            what = f"joint positions of {positions.ndim} dimensions"
        elif positions.shape[1] != count:
            what = f"joint positions of {positions.shape[1]} joints"
        elif not np.isfinite(positions).all():
            what = "joint positions that are no finite numbers"
        else:
            return self.arm.coupling.to_joints(positions)
        raise ModelError(
            what,
            where="q",
            value=positions.shape,
            allowed=f"(N, {count}) for {self.arm.name}",
            remedy="give one column a joint, in radians (metres for a joint that slides)",
        )
