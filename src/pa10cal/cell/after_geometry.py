"""What an effect leaves in the readings once the whole geometry is fitted to them again.

Worked out from the truth, for the scoring alone: the readings without noise, with the effect and
without it, less all small motions of the base, of every joint's frame and of the tool.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.cell.campaign import Campaign
from pa10cal.cell.options import TrackerOptions

#: Motions that are less than this part of the largest one, once the others are taken out, are those
#: that the others make already.
_REDUNDANT = 1e-9


@dataclass(frozen=True)
class AfterGeometry:
    """What each effect of a campaign leaves, beside the noise."""

    # how far each moves the readings after the geometry is fitted again, root mean square of
    # positions
    moved_mm: tuple[float, ...]
    apart_mm: tuple[float, ...]  # the same once the sizes of the other effects are fitted, too
    noise_mm: float  # what noise moves positions by, likewise, averaged over repeats


def after_geometry(made: Campaign, without: Sequence[Campaign]) -> AfterGeometry:
    """Return what the effects of a campaign leave.

    Args:
        made: the campaign of a tracker.
        without: it without one of its effects each, in their order.
    """
    plan = made.settings.without_touches
    if plan is None:
        raise ValueError("touched balls are not refitted here")
    readings = _Readings(made, plan)
    basis = readings.geometry()
    moved = [readings.difference(each) for each in without]
    left = [_less(each, basis) for each in moved]
    apart = [
        _less(each, _basis(np.column_stack([basis, *left[:k], *left[k + 1 :]])))
        for k, each in enumerate(left)
    ]
    return AfterGeometry(
        tuple(map(readings.position_mm, left)),
        tuple(map(readings.position_mm, apart)),
        readings.noise_mm(),
    )


class _Readings:
    """Readings of every calibration pose once, in the base's frame, in units of their noise."""

    def __init__(self, made: Campaign, plan: TrackerOptions) -> None:
        schedule = made.truth.schedule
        self._made, self._plan = made, plan
        self._rows = np.flatnonzero((schedule.kind == "grid") & (schedule.repeat == 1))
        self._turns = plan.instrument == "pose"
        self._p_m, self._R = self._read(made)

    def difference(self, other: Campaign) -> Array:
        """Return by how much readings differ from those of a twin, one long vector."""
        p_m, R = self._read(other)
        turned = Rotation.from_matrix(self._R @ R.transpose(0, 2, 1)).as_rotvec()
        return self._stacked((self._p_m - p_m)[..., None], turned[..., None])[:, 0]

    def geometry(self) -> Array:
        """Return an orthonormal basis of what small motions of all frames do to the readings."""
        columns = [
            self._stacked(*moved)
            for T in self._frames()
            for moved in (self._turned_about(T), self._shifted_along(T))
        ]
        return _basis(np.concatenate(columns, axis=1))

    def position_mm(self, difference: Array) -> float:
        """Return the root mean square of the positions of a difference."""
        p_mm = difference[: self._p_m.size] * self._plan.position_mm
        return float(np.sqrt(3.0 * np.mean(p_mm**2)))

    def noise_mm(self) -> float:
        """Return the noise of the instrument, and of links about their motors."""
        links_mm2 = 0.0
        slides = self._made.truth.robot.mechanism.slides
        off_mm = 1e3 * np.hypot(self._plan.unseen_rad, self._plan.resolver_rad)
        for slide, T in zip(slides, self._frames()[1:], strict=True):
            moved, _ = self._shifted_along(T) if slide else self._turned_about(T)
            along_z = moved[..., 2]
            links_mm2 += float(np.mean(np.sum((off_mm * along_z) ** 2, axis=-1)))
        noise_mm2 = 3.0 * self._plan.position_mm**2 + links_mm2
        return float(np.sqrt(noise_mm2 / self._plan.repeats))

    def _read(self, made: Campaign) -> tuple[Array, Array]:
        """Return positions (P, B, 3) [m] and attitudes (P, 3, 3), as read without noise."""
        truth, robot = made.truth, made.truth.robot
        T = truth.rest.T_base_ee[self._rows]
        on_tool_m = robot.T_ee_target[None, :3, 3] if self._turns else robot.targets.p_ee_m
        along_m = on_tool_m + truth.tool_shift_m[self._rows, None]
        p_m = np.einsum("pij,pbj->pbi", T[:, :3, :3], along_m) + T[:, None, :3, 3]
        R, t_m = robot.T_instr_base[:3, :3], robot.T_instr_base[:3, 3]
        return (truth.as_read(p_m @ R.T + t_m) - t_m) @ R, T[:, :3, :3]

    def _frames(self) -> list[Array]:
        """Return frames that geometry moves, (P, 4, 4): the base and what each joint carries."""
        truth = self._made.truth
        joints = truth.robot.mechanism.T_base_joints(truth.rest.q[self._rows])
        return [np.broadcast_to(np.eye(4), (len(self._rows), 4, 4)), *joints]

    def _turned_about(self, T: Array) -> tuple[Array, Array]:
        """Return what turns about a frame's axes do: (P, B, 3, 3) positions, (P, 3, 3) turns."""
        axes = T[:, :3, :3]
        lever_m = self._p_m - T[:, None, :3, 3]
        return np.cross(axes[:, None], lever_m[..., None], axisa=2, axisb=2, axisc=2), axes

    def _shifted_along(self, T: Array) -> tuple[Array, Array]:
        """Return what shifts along a frame's axes do, likewise."""
        axes = T[:, :3, :3]
        moved = np.broadcast_to(axes[:, None], (*self._p_m.shape, 3))
        return moved, np.zeros_like(axes)

    def _stacked(self, moved_m: Array, turned: Array) -> Array:
        """Return positions (P, B, 3, k) and turns (P, 3, k) as columns in units of their noise."""
        count = moved_m.shape[-1]
        rows = [1e3 / self._plan.position_mm * moved_m.reshape(-1, count)]
        if self._turns:
            rows.append(turned.reshape(-1, count) / self._plan.attitude_rad)
        return np.concatenate(rows)


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis of the span of some columns of any scale."""
    length = np.linalg.norm(columns, axis=0)
    kept = columns[:, length > 0.0] / length[length > 0.0]
    left, size, _ = np.linalg.svd(kept, full_matrices=False)
    return left[:, size > _REDUNDANT * size.max(initial=0.0)]


def _less(difference: Array, basis: Array) -> Array:
    """Return a difference without its part in the span of a basis."""
    left: Array = difference - basis @ (basis.T @ difference)
    return left
