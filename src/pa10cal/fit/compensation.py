"""The inverse of a fitted model: joint positions that bring a frame where it should be.

A search starts on a branch of the arm as designed and goes down to rounding on the model with all
its terms: damped Newton steps (Sugihara 2011), all poses at once. Where no closed form gives the
branches, a pose starts from the one before, and else from postures drawn within the joint limits.
Positions are those of the m axes that the controller counts, see `arm.coupling`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pa10cal.arm.branches import branches_of
from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.fit.fitted import Compensation, Fitted
from pa10cal.fit.forward import (
    Forward,
    T_base_away,
    T_flange_frame,
    pose_difference,
    predicted,
    states_at,
)
from pa10cal.fit.loads import blocks
from pa10cal.rules import COMMANDS

#: A search ends at steps or differences of this [m, rad], and below the second at no gain, which
#: leaves less than the third of a difference (computing).
_DONE, _SETTLED, _GAIN = 1e-12, 1e-10, 0.7
#: Its longest step [rad], and one that is none; its least and largest damping (computing).
_LARGEST_STEP_RAD, _NO_STEP, _LEAST_DAMPING, _MOST_DAMPING = 0.35, 1e-300, 1e-15, 1e-2
#: What places beyond limits, and those beyond reach or not found, come after all others by
#: (computing).
_OUTSIDE, _AWAY = 1e4, 1e6
#: Joint positions beyond a limit by less are at it [rad, m] (computing).
_AT_LIMIT = 1e-9
#: Postures from which a pose is searched where nothing better is known; and rows that are searched
#: at once (computing).
_DRAWN, _FIRST_BLOCK, _LARGEST_BLOCK = 48, 4, 512
_TURN = 2.0 * np.pi


#: A search goes down at most so many steps, and so many without a gain of a third: by the geometry
#: alone, whose derivative is off by some parts in a hundred and takes six steps for ten digits, and
#: exactly, for what is then within so much [m, rad] (computing).
_BY_GEOMETRY, _EXACT, _CLOSE = (30, 4), (40, 6), 1e-2


def compensate(
    model: Fitted,
    T: Array,
    frame: str,
    given: PoseStates,
    seed: ArrayLike | None = None,
    T_flange_tcp: ArrayLike | None = None,
    controller: Arm | None = None,
) -> Compensation:
    """Find the joint positions that bring a frame to poses; see `FittedModel.compensate`.

    Args:
        T: (N, 4, 4) poses of the frame in the base frame [m].
        given: what they are besides; joint positions in it do not matter.
        seed: (N, m) or (m,) joint positions, nan where there are none.
        T_flange_tcp: (4, 4) TCP that the controller holds; None for the frame as the model has it.
        controller: the arm that the controller computes with; None for that of the model.

    Raises:
        ModelError: when a matrix is not a valid pose, the frame is unknown, or a seed is of another
            arm.
    """
    _refuse_no_pose(T)
    if T_flange_tcp is None:
        tcp = T_flange_frame(model, frame)
    else:
        tcp = np.asarray(T_flange_tcp, dtype=float)
        _refuse_no_pose(tcp[None], "T_flange_tcp")
    q, other = np.zeros((0, len(model.arm.axes_slide))), np.zeros(0, dtype=bool)
    if len(T):
        q, other = _searched(model, T, frame, given, seed)
    branch = np.where(other, "other", "nearest")
    computes = model.arm.controller_arm if controller is None else controller
    # A prediction takes some kilobytes a pose; these take what a block does, however many poses.
    return Compensation.joined(
        [
            _judged(model, T[rows], frame, given.take(rows), q[rows], branch[rows], tcp, computes)
            for rows in blocks(len(T))
        ]
    )


def _judged(
    model: Fitted,
    T: Array,
    frame: str,
    given: PoseStates,
    q: Array,
    branch: NDArray[np.str_],
    tcp: Array,
    computes: Arm | None,
) -> Compensation:
    """Return joint positions that were found, how near they come to T (N, 4, 4), their status."""
    forward, arm = Forward.of(model, frame), model.arm
    joints = arm.coupling.to_joints(q)
    given = replace(given, q_rad=joints)
    found = predicted(model, given, frame)
    off = pose_difference(found.T, T)
    off_m, off_rad = np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)
    low, high = arm.axis_limits_rad.T
    status = np.full(len(T), "ok", dtype="U14")
    lever = np.where(arm.axes_slide, arm.reach_m, 1.0)
    J = arm.coupling.by_axes(forward.by_joints(forward.states(given), terms=False)[1])
    sizes = np.linalg.svd(J * lever / np.repeat([arm.reach_m, 1.0], 3)[:, None])[1]
    status[sizes[:, -1] < COMMANDS.singular] = "near_singular"
    beyond = ((q < low - _AT_LIMIT) | (q > high + _AT_LIMIT)).any(axis=1)
    status[beyond] = "outside_limits"
    near = _reached(arm, off_m, off_rad)
    if model.falls_back is not None:
        # Between what holds inside and outside there is a step, part of the uncertainty.
        near |= (1e3 * off_m < found.u_parameters_mm) & (off_rad < COMMANDS.near_rad)
    status[~near] = "unreachable"
    off_mm, off_deg = 1e3 * off_m, np.degrees(off_rad)
    # The controller works out the flange from the pose and its TCP, and the joints from the flange
    # of the arm that it computes with: with both taken the same way back it comes to q.
    T_send = np.full((len(T), 4, 4), np.nan)
    if computes is not None:
        T_send = Chain.of(computes).forward(joints) @ tcp
    promised = found.u_mm, found.u_parameters_mm, found.inside
    return Compensation(q, status, branch, off_mm, off_deg, *promised, T_send, tcp)


def _searched(
    model: Fitted, T: Array, frame: str, given: PoseStates, seed: ArrayLike | None
) -> tuple[Array, NDArray[np.bool_]]:
    """Return joint positions (N, m), and which are on another branch than the nearest.

    Where the model falls back, they are those of what it falls back to.
    """
    seeds, asked = _seeds(model, len(T), seed)
    search = _InverseSearch(Forward.of(model, frame), T, given)
    if search.branches is None:
        q, other = search.along(seeds)
    else:
        q, other = search.on_branches(seeds, asked)
    if model.falls_back is None:
        return q, other
    away = model.falls_back
    outside = np.flatnonzero(~away.within.inside(model.arm.coupling.to_joints(q)))
    if len(outside):
        T_away = np.linalg.inv(T_base_away(away, model)) @ T[outside]
        q[outside], again = _searched(away.model, T_away, frame, given.take(outside), q[outside])
        other[outside] |= again
    return q, other


def _refuse_no_pose(T: Array, name: str = "T") -> None:
    right = T.ndim == 3 and T.shape[1:] == (4, 4)
    if right:
        R = T[:, :3, :3]
        turned = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
        handed = np.einsum("pi,pi->p", np.cross(R[:, :, 0], R[:, :, 1]), R[:, :, 2])
        wrong = ~np.isfinite(T).all(axis=(1, 2)) | ~(handed > 0.0)
        wrong |= ~(turned < COMMANDS.of_rotation)
        wrong |= ~(np.abs(T[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1) < COMMANDS.of_rotation)
    if not right or wrong.any():
        raise ModelError(
            "not a pose",
            where=name if not right else f"{name}[{int(np.argmax(wrong))}]",
            value=T.shape if not right else T[int(np.argmax(wrong))].tolist(),
            allowed="(N, 4, 4), a rotation and a position in metres each, the last row 0, 0, 0, 1",
            remedy="check the orientation: columns are the frame's axes, of length one, the "
            "position beside them; a matrix that is transposed has it in the last row",
        )


def _seeds(model: Fitted, count: int, seed: ArrayLike | None) -> tuple[Array, NDArray[np.bool_]]:
    """Return seeds (N, m), nan where there is none, and for which rows a branch was asked for.

    The first row always has a seed. A row without one follows the row before.
    """
    n = len(model.arm.axes_slide)
    given = np.full(n, np.nan) if seed is None else np.asarray(seed, dtype=float)
    if given.shape not in ((n,), (count, n)):
        raise ModelError(
            "seeds of another arm or of other poses",
            where="seed",
            value=given.shape,
            allowed=f"({n},) or ({count}, {n}) for {model.arm.name}",
            remedy="give one column a joint, in radians (metres for a joint that slides)",
        )
    seeds = given.copy() if given.ndim == 2 else np.full((count, n), np.nan)
    if given.ndim == 1:
        seeds[0] = given
    asked = np.logical_or.accumulate(np.isfinite(seeds).all(axis=1))
    if not asked[0]:
        seeds[0] = _middle(model)
    return seeds, asked


def _reached(arm: Arm, off_m: Array, off_rad: Array) -> NDArray[np.bool_]:
    """Return which differences (N,) of position and orientation count as none."""
    near_rad = COMMANDS.reached if len(arm.axes_slide) >= 6 else COMMANDS.near_rad
    return np.asarray((off_m < COMMANDS.reached) & (off_rad < near_rad))


def _middle(model: Fitted) -> Array:
    """Return the middle of the joint positions that the fit has seen, else of the limits."""
    arm, seen = model.arm, model.seen
    middle: Array = arm.coupling.to_joints(arm.axis_limits_rad.mean(axis=1))
    if seen is not None:
        for joint, stretches in enumerate(seen.intervals):
            if len(stretches):
                middle[joint] = 0.5 * (stretches[0, 0] + stretches[-1, 1])
    return np.clip(arm.coupling.to_axes(middle), *arm.axis_limits_rad.T)


class _InverseSearch:
    """Searches for N poses of one frame.

    Attributes:
        branches: what gives all branches of the arm as designed; None where that is not known.
    """

    def __init__(self, forward: Forward, T: Array, given: PoseStates) -> None:
        arm = forward.whole.arm
        self._forward, self._T, self._given = forward, T, given
        self._arm, self._low, self._high = arm, *arm.axis_limits_rad.T
        self._slides, self._coupling = arm.axes_slide, arm.coupling
        self._turns = arm.coupling.turns(arm.prismatic)
        self._wide = (self._high - self._low >= _TURN) & ~self._slides
        # An arm of fewer than six joints reaches the position first.
        of_attitude = 1.0 if len(self._slides) >= 6 else COMMANDS.attitude_share
        self._weight = np.repeat([1.0 / arm.reach_m, of_attitude], 3)
        self.branches = branches_of(arm) if len(self._slides) == arm.n else None

    def on_branches(
        self, seeds: Array, asked: NDArray[np.bool_]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Search from the branches of the arm as designed, nearest to seed or row before.

        Returns:
            Joint positions (N, m), and which are on another branch than the nearest.
        """
        assert self.branches is not None
        # The flange in the frame, as it is in the middle of the positions seen.
        whole = self._forward.whole
        at = states_at(whole, self._coupling.to_joints(_middle(whole)[None]))
        T_base_frame, T_base_end = (
            forward.T_base_frame(forward.states(at))[0]
            for forward in (self._forward, Forward.of(whole))
        )
        T_base_flange = self._T @ np.linalg.inv(T_base_frame) @ T_base_end
        of_blocks = [self._branches_of(T_base_flange[rows]) for rows in blocks(len(seeds))]
        found, beside = (np.concatenate(part) for part in zip(*of_blocks, strict=True))
        starts, order, other = self._nearest(found, beside, seeds)
        other[:1] &= asked[:1]
        rows = np.arange(len(starts))
        q, done = self.newton(rows, starts)
        # Near reach or limits a branch of the arm as designed may be none of the calibrated one.
        inside = self._inside(q)
        good = done & inside
        short = np.flatnonzero(~done & inside & asked & ~other)
        if len(short):
            states = self._states(q[short], short)
            off = pose_difference(self._forward.T_base_frame(states), self._T[short])
            good[short] = np.abs(off).max(axis=1) < COMMANDS.kept
        for rank in range(1, found.shape[1]):
            rows = np.flatnonzero(~good & ~beside[np.arange(len(q)), order[:, rank]])
            if len(rows):
                again, right = self.newton(rows, found[rows, order[rows, rank]])
                inside = self._inside(again)
                better = right & (inside | ~done[rows])
                kept = rows[better]
                q[kept], done[kept], good[kept] = again[better], True, inside[better]
                other[kept] = True
        return q, other

    def _branches_of(self, T_base_flange: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return all branches (N, B, m) of the arm as designed, and which are out of reach."""
        assert self.branches is not None
        found = self.branches(T_base_flange)
        ends = Chain.of(self._arm).forward(found.reshape(-1, self._arm.n))[:, :3, 3]
        wanted = np.repeat(T_base_flange[:, :3, 3], found.shape[1], axis=0)
        off_m = np.linalg.norm(ends - wanted, axis=1).reshape(found.shape[:2])
        return self._coupling.to_axes(found), np.asarray(off_m >= COMMANDS.nearly_m)

    def along(self, seeds: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Search from the seed, or from the row before, in blocks that grow on a smooth path.

        Returns:
            Joint positions (N, m), and for which a jump was needed.
        """
        q, row, size, last = seeds.copy(), 0, _FIRST_BLOCK, seeds[:0]
        other = np.zeros(len(q), dtype=bool)
        while row < len(q):
            rows = np.arange(row, min(row + size, len(q)))
            none = ~np.asarray(np.isfinite(seeds[rows]).all(axis=1))
            starts = np.where(none[:, None], last if len(last) else seeds[:1], seeds[rows])
            found, done = self.newton(rows, starts)
            found = self._turned_near(found, starts)
            done &= self._inside(found)
            before = np.vstack([starts[:1], found[:-1]])
            jumps = none & (np.abs(found - before).max(axis=1) > COMMANDS.jump_rad)
            jumps[:1] = False
            right = int(np.argmax(np.append(~done | jumps, True)))
            if right == 0:
                found[0], right = self._from_drawn(rows[0], starts[0], found[0]), 1
                done[0] = True
                other[row] = np.abs(found[0] - starts[0]).max() > COMMANDS.jump_rad
            q[rows[:right]] = found[:right]
            last = found[right - 1 : right]
            size = min(2 * size, _LARGEST_BLOCK) if right == len(rows) else max(right, 1)
            row += right
        return q, other

    def newton(self, rows: NDArray[np.intp], starts: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Go down to the poses of some rows from starts (R, m).

        Returns:
            Joint positions (R, m), the best on the way, and whether they reach the pose.
        """
        found, done = starts.copy(), np.zeros(len(rows), dtype=bool)
        for part in blocks(len(rows)):
            found[part], done[part] = self._newton(rows[part], starts[part])
        return found, done

    def _newton(self, rows: NDArray[np.intp], starts: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Go down as `newton` does, all rows at once."""
        found, best, done = self._descend(rows, starts, exact=False)
        # Near a singularity what the geometry leaves out of the derivative is too much.
        hard = np.flatnonzero((best > _SETTLED) & (best < _CLOSE))
        if len(hard) and len(self._slides) >= 6:
            found[hard], _, done[hard] = self._descend(rows[hard], found[hard], exact=True)
        return found, done

    def _descend(
        self, rows: NDArray[np.intp], starts: Array, *, exact: bool
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the best positions on the way, how far they are off, whether they reach it.

        Exactly, the derivative holds how the terms change with the joints.
        """
        steps, patience = _EXACT if exact else _BY_GEOMETRY
        q, best = starts.copy(), np.full(len(rows), np.inf)
        found, done = starts.copy(), np.zeros(len(rows), dtype=bool)
        slow, open_ = np.zeros(len(rows), dtype=int), np.arange(len(rows))
        for _ in range(steps):
            states = self._states(q[open_], rows[open_])
            T, J = self._forward.by_joints(states, terms=exact)
            off = pose_difference(T, self._T[rows[open_]])
            size = np.linalg.norm(off * self._weight, axis=1)
            better = size < best[open_]
            slow[open_] = np.where(size < _GAIN * best[open_], 0, slow[open_] + 1)
            kept = open_[better]
            found[kept], best[kept] = q[kept], size[better]
            off_m, off_rad = (np.linalg.norm(part, axis=1) for part in (off[:, :3], off[:, 3:]))
            done[kept] = _reached(self._arm, off_m, off_rad)[better]
            step = self._step(self._coupling.by_axes(J), off)
            ended = (np.abs(step).max(axis=1) < _DONE) | (size < _DONE)
            ended |= slow[open_] > np.where(best[open_] < _SETTLED, 1, patience)
            q[open_] += step
            open_ = open_[~ended]
            if not len(open_):
                break
        return found, best, done

    def _states(self, q: Array, rows: NDArray[np.intp]) -> PoseStates:
        """Return the states of some rows at joint positions (R, m)."""
        q = self._coupling.to_joints(q)
        return self._forward.states(replace(self._given.take(rows), q_rad=q))

    def _step(self, J: Array, off: Array) -> Array:
        """Return damped Newton steps (R, m): the damping fades with the square of what is left."""
        lever = np.where(self._slides, self._arm.reach_m, 1.0)
        J = J * self._weight[:, None] * lever
        e = off * self._weight
        damping = np.minimum(np.einsum("pi,pi->p", e, e), _MOST_DAMPING)[:, None, None]
        by_pose = np.swapaxes(J, 1, 2) @ e[..., None]
        if J.shape[2] > 6:
            inner = J @ np.swapaxes(J, 1, 2) + (damping + _LEAST_DAMPING) * np.eye(6)
            step = (np.swapaxes(J, 1, 2) @ np.linalg.solve(inner, e[..., None]))[..., 0]
        else:
            inner = np.swapaxes(J, 1, 2) @ J + (damping + _LEAST_DAMPING) * np.eye(J.shape[2])
            step = np.linalg.solve(inner, by_pose)[..., 0]
        largest = np.abs(step).max(axis=1, keepdims=True)
        step *= np.minimum(1.0, _LARGEST_STEP_RAD / np.maximum(largest, _NO_STEP))
        return np.asarray(step * lever)

    def _nearest(
        self, found: Array, beside: NDArray[np.bool_], seeds: Array
    ) -> tuple[Array, NDArray[np.intp], NDArray[np.bool_]]:
        """Return the branch to begin with (N, m), the order of all (N, B), whether one is nearer.

        The nearest to seed or row before comes first, but for those beyond limits or reach.
        """
        starts = np.empty_like(seeds)
        order = np.empty(found.shape[:2], dtype=np.intp)
        other = np.zeros(len(found), dtype=bool)
        seeded = np.asarray(np.isfinite(seeds).all(axis=1))
        reference = seeds[0]
        for row in range(len(seeds)):
            reference = seeds[row] if seeded[row] else reference
            near = self._turned_near(found[row], reference)
            far = ((near - reference) ** 2).sum(axis=1)
            order[row] = np.argsort(far + _OUTSIDE * ~self._inside(near) + _AWAY * beside[row])
            other[row] = order[row, 0] != np.argmin(far)
            starts[row] = near[order[row, 0]]
            found[row] = near
            if not beside[row, order[row, 0]]:
                reference = starts[row]
        return starts, order, other

    def _turned_near(self, q: Array, reference: Array) -> Array:
        """Return joint positions (R, m) whole turns off, as near to others as limits allow."""
        # A turn of one joint is one of its axis, and may move others that are coupled to it.
        near = np.array(q, dtype=float)
        turning = np.flatnonzero(self._turns.any(axis=1))
        for k in (*turning, *turning):
            near += np.rint((reference - near)[:, k, None] / _TURN) * self._turns[k]
        for k in turning:
            near -= (near[:, k, None] > self._high[k]) * self._turns[k]
            near += (near[:, k, None] < self._low[k]) * self._turns[k]
        return near

    def _inside(self, q: Array) -> NDArray[np.bool_]:
        return np.asarray(
            ((q >= self._low - _AT_LIMIT) & (q <= self._high + _AT_LIMIT)).all(axis=1)
        )

    def _from_drawn(self, row: int, reference: Array, otherwise: Array) -> Array:
        """Return the nearest of what is found from postures drawn within the limits, or else."""
        generator = np.random.default_rng(0)
        low, high = self._low, self._high
        low = np.where(self._wide, np.maximum(low, reference - np.pi), low)
        high = np.where(self._wide, np.minimum(high, reference + np.pi), high)
        starts = np.vstack([reference, generator.uniform(low, high, (_DRAWN, len(low)))])
        found, done = self.newton(np.full(len(starts), row), starts)
        found = self._turned_near(found, reference)
        if not done.any():
            return otherwise
        far: Array = (
            ((found - reference) ** 2).sum(axis=1) + _OUTSIDE * ~self._inside(found) + _AWAY * ~done
        )
        return np.asarray(found[np.argmin(far)])
