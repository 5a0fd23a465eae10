"""Newton's search for joint positions that bring a frame of a fitted model to wanted poses.

All poses are searched at once from starts that are given (`fit.inverse_search` finds them), with
steps damped in proportion to the square of the difference (Sugihara 2011). Positions are those of
the m axes that the controller counts, see `arm.coupling`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.fit.forward import Forward, pose_difference
from pa10cal.fit.loads import blocks
from pa10cal.rules import COMMANDS

#: A search ends at steps or differences below `_DONE` [m, rad]. A step gains if it leaves less than
#: `_GAIN` of the difference; below `_SETTLED` one without a gain is allowed (computing).
_DONE, _SETTLED, _GAIN = 1e-12, 1e-10, 0.7
#: Longest step [rad], divisor in place of a step of zero, least and largest damping (computing).
_LARGEST_STEP_RAD, _NO_STEP, _LEAST_DAMPING, _MOST_DAMPING = 0.35, 1e-300, 1e-15, 1e-2
#: Steps, and steps without a gain, at most: with the derivative of the geometry alone, which is off
#: by some per cent and takes six steps for ten digits; and with the exact one, which is tried on
#: differences below `_CLOSE` (computing).
_BY_GEOMETRY, _EXACT, _CLOSE = (30, 4), (40, 6), 1e-2
#: Joint positions beyond a limit by less count as within [rad, m] (computing).
_AT_LIMIT = 1e-9
_TURN = 2.0 * np.pi


def reached(arm: Arm, off_m: Array, off_rad: Array) -> Mask:
    """Return which differences (N,) of position and orientation count as none."""
    near_rad = COMMANDS.reached if len(arm.axes_slide) >= 6 else COMMANDS.near_rad
    return np.asarray((off_m < COMMANDS.reached) & (off_rad < near_rad))


def within_limits(q: Array, low: Array, high: Array) -> Mask:
    """Return which positions (R, m) are within limits (m,), rounding allowed for."""
    return np.asarray(((q >= low - _AT_LIMIT) & (q <= high + _AT_LIMIT)).all(axis=1))


class NewtonSearch:
    """The search, from given starts, for positions that bring one frame to N poses T (N, 4, 4).

    Rows are numbers of poses; positions of R rows are (R, m). Differences of poses are of position
    [m] and orientation [rad].
    """

    def __init__(self, forward: Forward, T: Array, given: PoseStates) -> None:
        arm = forward.whole.arm
        self._forward, self._T, self._given, self._arm = forward, T, given, arm
        self._low, self._high = arm.axis_limits_rad.T
        self._slides, self._coupling = arm.axes_slide, arm.coupling
        self._turns = arm.coupling.turns(arm.prismatic)
        # An arm of fewer than six joints reaches the position first.
        of_attitude = 1.0 if len(self._slides) >= 6 else COMMANDS.attitude_share
        self._weight = np.repeat([1.0 / arm.reach_m, of_attitude], 3)

    def newton(self, rows: Index, starts: Array) -> tuple[Array, Mask]:
        """Search for the poses of some rows from starts (R, m).

        Returns:
            The best joint positions on the way (R, m), and whether they reach the pose (R,).
        """
        found, done = starts.copy(), np.zeros(len(rows), dtype=bool)
        for block in blocks(len(rows)):
            found[block], done[block] = self._newton(rows[block], starts[block])
        return found, done

    def turned_near(self, q: Array, reference: Array) -> Array:
        """Return joint positions (R, m) moved by whole turns as near to others as limits allow."""
        near = np.array(q, dtype=float)
        turning = np.flatnonzero(self._turns.any(axis=1))
        # A turn of one joint may move axes that are coupled to it, those before it in the order
        # too: the second round brings them near again.
        for k in (*turning, *turning):
            near += np.rint((reference - near)[:, k, None] / _TURN) * self._turns[k]
        for k in turning:
            near -= _turns_beyond(near[:, k, None] - self._high[k]) * self._turns[k]
            near += _turns_beyond(self._low[k] - near[:, k, None]) * self._turns[k]
        return near

    def _within(self, q: Array) -> Mask:
        """Return which joint positions (R, m) are within the limits."""
        return within_limits(q, self._low, self._high)

    def _off(self, q: Array, rows: Index) -> Array:
        """Return the differences (R, 6) of poses at joint positions (R, m) from those wanted."""
        return pose_difference(self._forward.T_base_frame(self._states(q, rows)), self._T[rows])

    def _newton(self, rows: Index, starts: Array) -> tuple[Array, Mask]:
        """Search as `newton` does, all rows at once."""
        found, size, done = self._descend(rows, starts, exact=False)
        # Near a singularity the error of the derivative by geometry is too large.
        hard = np.flatnonzero((size > _SETTLED) & (size < _CLOSE))
        if len(hard) and len(self._slides) >= 6:
            found[hard], _, done[hard] = self._descend(rows[hard], found[hard], exact=True)
        return found, done

    def _descend(self, rows: Index, starts: Array, *, exact: bool) -> tuple[Array, Array, Mask]:
        """Return the best positions on the way, their weighted difference, whether they reach it.

        Args:
            exact: whether the derivative includes how the terms change with the joints.
        """
        most_steps, patience = _EXACT if exact else _BY_GEOMETRY
        q, best = starts.copy(), np.full(len(rows), np.inf)
        found, done = starts.copy(), np.zeros(len(rows), dtype=bool)
        steps_without_gain, active = np.zeros(len(rows), dtype=int), np.arange(len(rows))
        for _ in range(most_steps):
            T, J = self._forward.by_joints(self._states(q[active], rows[active]), terms=exact)
            off = pose_difference(T, self._T[rows[active]])
            size = np.linalg.norm(off * self._weight, axis=1)
            better = size < best[active]
            gained = size < _GAIN * best[active]
            steps_without_gain[active] = np.where(gained, 0, steps_without_gain[active] + 1)
            kept = active[better]
            found[kept], best[kept] = q[kept], size[better]
            off_m, off_rad = np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)
            done[kept] = reached(self._arm, off_m, off_rad)[better]
            step = self._step(self._coupling.by_axes(J), off)
            ended = (np.abs(step).max(axis=1) < _DONE) | (size < _DONE)
            # Below `_SETTLED` the rounding of the pose is what is left: steps gain no more.
            at_rounding = best[active] < _SETTLED
            ended |= steps_without_gain[active] > np.where(at_rounding, 1, patience)
            q[active] += step
            active = active[~ended]
            if not len(active):
                break
        return found, best, done

    def _states(self, q: Array, rows: Index) -> PoseStates:
        """Return the states of some rows at joint positions (R, m)."""
        q = self._coupling.to_joints(q)
        return self._forward.states(replace(self._given.take(rows), q_rad=q))

    def _step(self, J: Array, off: Array) -> Array:
        """Return damped Newton steps (R, m), by J (R, 6, m) and differences (R, 6)."""
        lever = np.where(self._slides, self._arm.reach_m, 1.0)
        J = J * self._weight[:, None] * lever
        e = off * self._weight
        damping = np.minimum(np.einsum("pi,pi->p", e, e), _MOST_DAMPING)[:, None, None]
        J_transposed = np.swapaxes(J, 1, 2)
        if J.shape[2] > 6:
            normal = J @ J_transposed + (damping + _LEAST_DAMPING) * np.eye(6)
            step = (J_transposed @ np.linalg.solve(normal, e[..., None]))[..., 0]
        else:
            normal = J_transposed @ J + (damping + _LEAST_DAMPING) * np.eye(J.shape[2])
            step = np.linalg.solve(normal, J_transposed @ e[..., None])[..., 0]
        largest = np.abs(step).max(axis=1, keepdims=True)
        step *= np.minimum(1.0, _LARGEST_STEP_RAD / np.maximum(largest, _NO_STEP))
        return np.asarray(step * lever)


def _turns_beyond(beyond_rad: Array) -> Array:
    """Return by how many whole turns to bring back what is so far beyond a limit; 0 if within."""
    return np.asarray(np.ceil(np.maximum(beyond_rad, 0.0) / _TURN))
