"""Joint positions that bring a frame of a fitted model to wanted poses: where the search starts.

Where the branches of the arm as designed are known in closed form, Newton's search
(`fit.newton_search`) starts from the nearest, and from the seed that the user gave (`on_branches`);
else from the pose before, and at last from postures drawn within the joint limits (`along`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arm.branches import branches_of
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.forward import Forward, states_at
from pa10cal.fit.loads import blocks
from pa10cal.fit.newton_search import NewtonSearch
from pa10cal.rules import COMMANDS

#: Added to the squared distance of positions beyond limits, and beyond reach or not found, so that
#: they come last (computing).
_OUTSIDE, _AWAY = 1e4, 1e6
#: Postures drawn where nothing better is known, and more before a pose counts as out of reach;
#: first and largest block of rows that are searched at once along a path (computing).
_DRAWN, _DRAWN_MORE, _FIRST_BLOCK, _LARGEST_BLOCK = 48, 192, 4, 512


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


class InverseSearch(NewtonSearch):
    """The search for the joint positions that bring one frame to N poses T (N, 4, 4).

    Attributes:
        branches: what gives all branches of the arm as designed; None where that is not known.
    """

    def __init__(self, forward: Forward, T: Array, given: PoseStates) -> None:
        super().__init__(forward, T, given)
        arm = self._arm
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
        within = self._within(q)
        accepted = done & within
        # Near reach or limits a branch of the arm as designed may be none of the calibrated one:
        # on the branch that the user named, positions that nearly reach the pose are kept.
        missed = np.flatnonzero(~done & within & requested & ~other)
        if len(missed):
            accepted[missed] = np.abs(self._off(q[missed], missed)).max(axis=1) < COMMANDS.kept
        # The next branches in the order of their distance, for the rows that none before served.
        for rank in range(1, starts.shape[1]):
            rows = np.flatnonzero(~accepted & ~branches.out_of_reach[every, order[:, rank]])
            if not len(rows):
                continue
            q_next, done_next = self.newton(rows, starts[rows, order[rows, rank]])
            within = self._within(q_next)
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
        within = self._within(found)
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
            outside = ~self._within(near[row])
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
            done &= self._within(found)
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

    def _from_drawn(self, row: int, reference: Array, otherwise: Array) -> Array:
        """Return the positions nearest to a reference that searches from drawn postures find.

        Where those within a turn about the reference find none, others anywhere within the limits
        are tried.
        """
        generator = np.random.default_rng(0)
        middle = np.clip(reference, self._low, self._high)
        # Of a joint that may turn once around, the turn about the reference.
        full_turn = (self._high - self._low >= 2.0 * np.pi) & ~self._slides
        low = np.where(full_turn, np.maximum(self._low, middle - np.pi), self._low)
        high = np.where(full_turn, np.minimum(self._high, middle + np.pi), self._high)
        starts = np.vstack([reference, generator.uniform(low, high, (_DRAWN, len(low)))])
        found, done = self.newton(np.full(len(starts), row), starts)
        found = self.turned_near(found, reference)
        if not (done & self._within(found)).any():
            starts = generator.uniform(self._low, self._high, (_DRAWN_MORE, len(low)))
            more, more_done = self.newton(np.full(len(starts), row), starts)
            found = np.vstack([found, self.turned_near(more, reference)])
            done = np.append(done, more_done)
        if not done.any():
            return otherwise
        square = ((found - reference) ** 2).sum(axis=1)
        outside = ~self._within(found)
        return np.asarray(found[np.argmin(square + _OUTSIDE * outside + _AWAY * ~done)])
