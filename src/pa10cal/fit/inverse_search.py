"""Newton's search for the joint positions that bring a frame of a fitted model to wanted poses.

The model with all its terms is searched, all poses at once, with steps damped in proportion to the
square of the difference (Sugihara 2011). Where the branches of the arm as designed are known in
closed form, the search starts from the nearest, and from the seed that the user gave; else from the
pose before, and at last from postures drawn within the joint limits. Positions are those of the m
axes that the controller counts, see `arm.coupling`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.branches import branches_of
from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.forward import Forward, pose_difference, states_at
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
#: Added to the squared distance of positions beyond limits, and beyond reach or not found, so that
#: they come last (computing).
_OUTSIDE, _AWAY = 1e4, 1e6
#: Joint positions beyond a limit by less count as within [rad, m] (computing).
_AT_LIMIT = 1e-9
#: Postures drawn where nothing better is known, and more before a pose counts as out of reach;
#: first and largest block of rows that are searched at once along a path (computing).
_DRAWN, _DRAWN_MORE, _FIRST_BLOCK, _LARGEST_BLOCK = 48, 192, 4, 512
_TURN = 2.0 * np.pi


def reached(arm: Arm, off_m: Array, off_rad: Array) -> Mask:
    """Return which differences (N,) of position and orientation count as none."""
    near_rad = COMMANDS.reached if len(arm.axes_slide) >= 6 else COMMANDS.near_rad
    return np.asarray((off_m < COMMANDS.reached) & (off_rad < near_rad))


def within_limits(q: Array, low: Array, high: Array) -> Mask:
    """Return which positions (R, m) are within limits (m,), rounding allowed for."""
    return np.asarray(((q >= low - _AT_LIMIT) & (q <= high + _AT_LIMIT)).all(axis=1))


def middle_of_range(model: Fitted) -> Array:
    """Return the middle (m,) of the joint positions seen by the fit, or of the limits."""
    arm, seen = model.arm, model.seen
    middle: Array = arm.coupling.to_joints(arm.axis_limits_rad.mean(axis=1))
    if seen is not None:
        for joint, stretches in enumerate(seen.intervals):
            if len(stretches):
                middle[joint] = 0.5 * (stretches[0, 0] + stretches[-1, 1])
    return np.clip(arm.coupling.to_axes(middle), *arm.axis_limits_rad.T)


@dataclass(frozen=True, eq=False)
class _Branches:
    """The B branches of the arm as designed for N poses."""

    q: Array  # (N, B, m) joint positions
    out_of_reach: Mask  # (N, B) whether the branch does not come to the pose


class InverseSearch:
    """The search for the joint positions that bring one frame to N poses T (N, 4, 4).

    Rows are numbers of poses; positions of R rows are (R, m). Differences of poses are of position
    [m] and orientation [rad].

    Attributes:
        branches: what gives all branches of the arm as designed; None where that is not known.
    """

    def __init__(self, forward: Forward, T: Array, given: PoseStates) -> None:
        arm = forward.whole.arm
        self._forward, self._T, self._given, self._arm = forward, T, given, arm
        self._low, self._high = arm.axis_limits_rad.T
        self._slides, self._coupling = arm.axes_slide, arm.coupling
        self._turns = arm.coupling.turns(arm.prismatic)
        self._full_turn = (self._high - self._low >= _TURN) & ~self._slides
        # An arm of fewer than six joints reaches the position first.
        of_attitude = 1.0 if len(self._slides) >= 6 else COMMANDS.attitude_share
        self._weight = np.repeat([1.0 / arm.reach_m, of_attitude], 3)
        self.branches = branches_of(arm) if len(self._slides) == arm.n else None

    def on_branches(self, seeds: Array, requested: Mask) -> tuple[Array, Mask]:
        """Search from the seeds, and from the branches as designed nearest to seed or row before.

        Args:
            seeds: (N, m) joint positions, nan where there is none.
            requested: (N,) for which rows the user named a branch by a seed.

        Returns:
            Joint positions (N, m), and which are on another branch than the nearest.
        """
        branches = self._branches_as_designed()
        starts, order, other = self._by_nearness(branches, seeds)
        other[:1] &= requested[:1]
        every = np.arange(len(starts))
        q, done = self.newton(every, starts[every, order[:, 0]])
        within = within_limits(q, self._low, self._high)
        accepted = done & within
        # Near reach or limits a branch of the arm as designed may be none of the calibrated one:
        # on the branch that the user named, positions that nearly reach the pose are kept.
        missed = np.flatnonzero(~done & within & requested & ~other)
        if len(missed):
            T = self._forward.T_base_frame(self._states(q[missed], missed))
            off = pose_difference(T, self._T[missed])
            accepted[missed] = np.abs(off).max(axis=1) < COMMANDS.kept
        for rank in range(1, starts.shape[1]):
            rows = np.flatnonzero(~accepted & ~branches.out_of_reach[every, order[:, rank]])
            if not len(rows):
                continue
            q_next, done_next = self.newton(rows, starts[rows, order[rows, rank]])
            within = within_limits(q_next, self._low, self._high)
            better = done_next & (within | ~done[rows])
            kept = rows[better]
            q[kept], done[kept], accepted[kept] = q_next[better], True, within[better]
            other[kept] = True
        rows = np.flatnonzero(requested & np.isfinite(seeds).all(axis=1))
        if len(rows):
            found, better = self._from_seeds(rows, seeds[rows], q[rows], done[rows], accepted[rows])
            swung = self._jumps(found, seeds[rows]) & (other[rows] | ~accepted[rows])
            kept = rows[better]
            q[kept], other[kept] = found[better], swung[better]
        return q, other

    def _from_seeds(
        self, rows: Index, seeds: Array, q: Array, done: Mask, accepted: Mask
    ) -> tuple[Array, Mask]:
        """Search from the seeds themselves, and compare with positions that branches led to.

        Near a singularity branches of the arm as designed are far from those of the calibrated
        arm, and the search from them may end far from a seed that reaches the pose.

        Args:
            rows: R poses.
            seeds: (R, m) their seeds.
            q: (R, m) what branches led to, done if it reaches the pose, accepted if it is kept.

        Returns:
            Joint positions (R, m), and which of them are to be taken in place of q.
        """
        found, reaches = self.newton(rows, seeds)
        found = self.turned_near(found, seeds)
        within = within_limits(found, self._low, self._high)
        nearer = np.linalg.norm(found - seeds, axis=1) < np.linalg.norm(q - seeds, axis=1)
        nearer |= ~done & ~self._jumps(found, seeds)
        return found, reaches & np.where(accepted, within & nearer, within | ~done)

    def _branches_as_designed(self) -> _Branches:
        """Return all branches of the arm as designed that bring the calibrated frame near T."""
        assert self.branches is not None
        # The flange in the frame, as it is in the middle of the positions seen.
        whole = self._forward.whole
        at = states_at(whole, self._coupling.to_joints(middle_of_range(whole)[None]))
        T_base_frame, T_base_end = (
            forward.T_base_frame(forward.states(at))[0]
            for forward in (self._forward, Forward.of(whole))
        )
        T_base_flange = self._T @ np.linalg.inv(T_base_frame) @ T_base_end
        q, out_of_reach = [], []
        for rows in blocks(len(T_base_flange)):
            joints = self.branches(T_base_flange[rows])
            ends_m = Chain.of(self._arm).forward(joints.reshape(-1, self._arm.n))[:, :3, 3]
            wanted_m = np.repeat(T_base_flange[rows, :3, 3], joints.shape[1], axis=0)
            off_m = np.linalg.norm(ends_m - wanted_m, axis=1).reshape(joints.shape[:2])
            q.append(self._coupling.to_axes(joints))
            out_of_reach.append(np.asarray(off_m >= COMMANDS.nearly_m))
        return _Branches(np.concatenate(q), np.concatenate(out_of_reach))

    def _by_nearness(self, branches: _Branches, seeds: Array) -> tuple[Array, Index, Mask]:
        """Order the branches of each row by their distance from its seed or the row before.

        Returns:
            Branches (N, B, m), each moved by whole turns near to that reference; their order
            (N, B), those beyond limits or reach last; and whether the first is not the nearest.
        """
        near = np.empty_like(branches.q)
        order = np.empty(near.shape[:2], dtype=np.intp)
        other = np.zeros(len(near), dtype=bool)
        seeded = np.asarray(np.isfinite(seeds).all(axis=1))
        reference = seeds[0]
        for row, out_of_reach in enumerate(branches.out_of_reach):
            reference = seeds[row] if seeded[row] else reference
            near[row] = self.turned_near(branches.q[row], reference)
            square = ((near[row] - reference) ** 2).sum(axis=1)
            outside = ~within_limits(near[row], self._low, self._high)
            order[row] = np.argsort(square + _OUTSIDE * outside + _AWAY * out_of_reach)
            first = order[row, 0]
            other[row] = first != np.argmin(square)
            if not out_of_reach[first]:
                reference = near[row, first]
        return near, order, other

    def along(self, seeds: Array, requested: Mask) -> tuple[Array, Mask]:
        """Search from the seed, or from the row before, in blocks that grow on a smooth path.

        A row jumps where it is further than `COMMANDS.jump_rad` from its reference, which is its
        seed or else the row before. There, and where the search fails, the nearest of what drawn
        postures lead to is taken. Of ten rows of which the fourth jumps, the three before it are
        kept, and the next block begins with the fourth: it jumps again, now as the first of its
        block, and is searched from drawn postures.

        Args:
            seeds: (N, m) joint positions, nan where there is none.
            requested: (N,) for which rows the user named a branch by a seed.

        Returns:
            Joint positions (N, m), and which jump from their reference. The first row does not
            where its seed is none of the user's.
        """
        q, other = seeds.copy(), np.zeros(len(seeds), dtype=bool)
        previous, row, size = seeds[:1], 0, _FIRST_BLOCK
        while row < len(q):
            rows = np.arange(row, min(row + size, len(q)))
            seeded = np.isfinite(seeds[rows]).all(axis=1, keepdims=True)
            starts = np.where(seeded, seeds[rows], previous)
            found, done = self.newton(rows, starts)
            found = self.turned_near(found, starts)
            done &= within_limits(found, self._low, self._high)
            before = np.vstack([previous, found[:-1]])
            jumps = self._jumps(found, np.where(seeded, seeds[rows], before))
            # How many rows come before the first that failed or jumped.
            kept = int(np.argmax(np.append(~done | jumps, True)))
            if kept == 0:
                found[0], kept = self._from_drawn(rows[0], starts[0], found[0]), 1
                other[row] = self._jumps(found[:1], starts[:1])[0]
            q[rows[:kept]] = found[:kept]
            previous = found[kept - 1 : kept]
            size = min(2 * size, _LARGEST_BLOCK) if kept == len(rows) else kept
            row += kept
        other[:1] &= requested[:1]
        return q, other

    def _jumps(self, q: Array, reference: Array) -> Mask:
        """Return which joint positions (R, m) are too far from others to be on one path."""
        return np.asarray(np.abs(q - reference).max(axis=1) > COMMANDS.jump_rad)

    def newton(self, rows: Index, starts: Array) -> tuple[Array, Mask]:
        """Search for the poses of some rows from starts (R, m).

        Returns:
            The best joint positions on the way (R, m), and whether they reach the pose (R,).
        """
        found, done = starts.copy(), np.zeros(len(rows), dtype=bool)
        for block in blocks(len(rows)):
            found[block], done[block] = self._newton(rows[block], starts[block])
        return found, done

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

    def _from_drawn(self, row: int, reference: Array, otherwise: Array) -> Array:
        """Return the positions nearest to a reference that searches from drawn postures find.

        Where those within a turn about the reference find none, others anywhere within the limits
        are tried.
        """
        generator = np.random.default_rng(0)
        middle = np.clip(reference, self._low, self._high)
        low = np.where(self._full_turn, np.maximum(self._low, middle - np.pi), self._low)
        high = np.where(self._full_turn, np.minimum(self._high, middle + np.pi), self._high)
        starts = np.vstack([reference, generator.uniform(low, high, (_DRAWN, len(low)))])
        found, done = self.newton(np.full(len(starts), row), starts)
        found = self.turned_near(found, reference)
        if not (done & within_limits(found, self._low, self._high)).any():
            starts = generator.uniform(self._low, self._high, (_DRAWN_MORE, len(low)))
            more, more_done = self.newton(np.full(len(starts), row), starts)
            found = np.vstack([found, self.turned_near(more, reference)])
            done = np.append(done, more_done)
        if not done.any():
            return otherwise
        square = ((found - reference) ** 2).sum(axis=1)
        outside = ~within_limits(found, self._low, self._high)
        return np.asarray(found[np.argmin(square + _OUTSIDE * outside + _AWAY * ~done)])


def _turns_beyond(beyond_rad: Array) -> Array:
    """Return by how many whole turns to bring back what is so far beyond a limit; 0 if within."""
    return np.asarray(np.ceil(np.maximum(beyond_rad, 0.0) / _TURN))
