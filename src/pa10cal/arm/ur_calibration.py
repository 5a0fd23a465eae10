"""The calibration of a Universal Robots arm, in the two forms of its maker: read and written.

The controller keeps deviations of Denavit-Hartenberg rows from the model's (`calibration.conf`).
The driver for ROS 2 reads the origin of each of six joints, which turn about z, in the frame that
the joint before carries along. In both forms the frame of the last joint is the flange.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from pa10cal.arm.chain import (
    Chain,
    carried_frames,
    end_pose,
    frames,
    mean_distance,
    moved_frames,
    placed,
    roll_pitch_yaw,
)
from pa10cal.arm.description import Arm, with_hayati_rows
from pa10cal.arm.dh_rows import DHRows, neat, rows_of_table, rows_through
from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import ArmError, one_line

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
ORIGIN = ("x", "y", "z", "roll", "pitch", "yaw")
#: Columns of a table of rows, in the order of `UrLayout.table`.
COLUMNS = ("theta", "d", "a", "alpha")
_QUARTER = np.pi / 2.0
#: Largest deviation of nominal axes from the layout [m, rad]: numbers of a URDF may be rounded.
_SAME = 1e-5
#: Largest deviation of a calibrated arm from its model [m, rad].
_NEAR = 0.02
#: Axes closer to parallel than this have no definite common normal [rad].
_PARALLEL_RAD = 1e-10
#: Largest error of forward kinematics of a controller's rows [m, rad], and at how many random
#: joint positions, of which seed, it is verified.
_HELD = 1e-8
_CHECKS, _SEED = 200, 20080427


@dataclass(frozen=True)
class UrLayout:
    """The nominal lengths of a Universal Robots arm, in its controller's base."""

    yaw: float  # turn of the controller's base about z of the arm's own base [rad]
    # lengths of its Denavit-Hartenberg rows [m]
    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float

    @property
    def T_base_controller(self) -> Array:
        """Return the controller's base in the arm's own (4, 4)."""
        return placed(np.zeros(3), np.array([0.0, 0.0, self.yaw]))

    @property
    def table(self) -> Array:
        """Return theta [rad], d [m], a [m] and alpha [rad] of its rows (6, 4)."""
        d = (self.d1, 0.0, 0.0, self.d4, self.d5, self.d6)
        a = (0.0, self.a2, self.a3, 0.0, 0.0, 0.0)
        alpha = (_QUARTER, 0.0, 0.0, _QUARTER, -_QUARTER, 0.0)
        return np.column_stack([np.zeros(6), d, a, alpha])

    @property
    def frames(self) -> Array:
        """Return the frames that its joints carry along, (6, 4, 4), in the arm's own base."""
        steps = [  # place and roll of each frame in the one before
            ((0.0, 0.0, self.d1), 0.0),
            ((0.0, 0.0, 0.0), _QUARTER),
            ((self.a2, 0.0, 0.0), 0.0),
            ((self.a3, 0.0, self.d4), 0.0),
            ((0.0, -self.d5, 0.0), _QUARTER),
            ((0.0, self.d6, 0.0), -_QUARTER),
        ]
        origins = [placed(np.array(at), np.array([roll, 0.0, 0.0])) for at, roll in steps]
        return np.array([*accumulate([self.T_base_controller, *origins], np.matmul)][1:])


def ur_layout(arm: Arm) -> UrLayout | None:
    """Return the nominal layout of an arm; None where it is another maker's."""
    near = _nearest_layout(Chain.of(arm))
    return None if near is None or near.off > _SAME else near.layout


class _NearLayout(NamedTuple):
    """A layout that an arm is near to."""

    layout: UrLayout
    off: float  # largest deviation of the arm's axes and flange from it [m, rad]


def _nearest_layout(chain: Chain) -> _NearLayout | None:
    """Return the layout that a nominal arm has or is near to; None where there is none."""
    arm = chain.arm
    if arm.n != 6 or arm.prismatic.any():
        return None
    carried, T_base_flange = carried_frames(chain, chain.nominal)
    h, p = carried[:, :3, 2], carried[:, :3, 3]
    nearest = None
    for yaw in (0.0, np.pi):
        base = placed(np.zeros(3), np.array([0.0, 0.0, yaw]))
        axes, points = h @ base[:3, :3], p @ base[:3, :3]
        T_flange = base.T @ T_base_flange
        # Heights and lengths along x, from the points that the axes pass through; d14 is d1 + d4.
        d1, d14 = points[1, 2], -T_flange[1, 3]
        a2, a3 = points[2, 0], points[3, 0] - points[2, 0]
        d5, d6 = d1 - T_flange[2, 3], 0.0
        if np.linalg.norm(np.cross(axes[4], axes[5])) > 0.5:
            d6 = float((T_flange[:3, 3] - points[4]) @ axes[5])
        layout = UrLayout(yaw, *map(float, (d1, a2, a3, d14 - d6, d5, d6)))
        T_base_frames = layout.frames
        tilt = T_base_frames[:, :3, 2] - carried[:, :3, 2]
        offset = np.cross(T_base_frames[:, :3, 3] - carried[:, :3, 3], carried[:, :3, 2])
        of_flange = T_base_frames[-1] - T_base_flange
        off = max(float(np.abs(difference).max()) for difference in (tilt, offset, of_flange))
        if off < _SAME:
            return _NearLayout(layout, off)
        if off < _NEAR and (nearest is None or off < nearest.off):
            nearest = _NearLayout(layout, off)
    return nearest


def ur_kinematics(chain: Chain, coordinates: Array, *comments: str) -> str | None:
    """Return the calibration file of the driver; None where the arm has another layout.

    The file cannot hold a flange that is offset from or tilted against the last joint's axis (a,
    alpha, beta): see `flange_off_m`.

    Args:
        coordinates: (m,) calibrated ones, at zero joint positions.
        comments: lines of the file's head.
    """
    near = _nearest_layout(chain)
    if near is None:
        return None
    layout = near.layout
    T_base_frames = layout.frames if near.off < _SAME else _on_axes(chain, layout.frames)
    moved, T_base_flange = moved_frames(chain, coordinates, T_base_frames)
    along_m = float((np.linalg.inv(moved[-1]) @ T_base_flange)[2, 3])
    moved[-1, :3, 3] += along_m * moved[-1, :3, 2]
    # The first origin is relative to the controller's base.
    before = np.concatenate([layout.T_base_controller[None], moved[:-1]])
    lines = [f"# {one_line(line)}".rstrip() for line in comments] + ["kinematics:"]
    for name, T in zip(LINKS, np.linalg.inv(before) @ moved, strict=True):
        lines.append(f"  {name}:")
        values = (*T[:3, 3], *roll_pitch_yaw(T[:3, :3]))
        lines += [f"    {key}: {float(value)!r}" for key, value in zip(ORIGIN, values, strict=True)]
    digest = hashlib.sha256("\n".join(lines).encode()).hexdigest()
    return "\n".join([*lines, f"  hash: calib_{int(digest[:15], 16)}"]) + "\n"


def _on_axes(chain: Chain, near: Array) -> Array:
    """Return the frames (6, 4, 4) moved so that z of each lies on the nominal axis of its joint.

    The last one is the flange, moved likewise.
    """
    carried, T_base_flange = carried_frames(chain, chain.nominal)
    on_axes = []
    for frame, of_joint in zip([*near[:-1], T_base_flange], carried, strict=True):
        z, p = of_joint[:3, 2], of_joint[:3, 3]
        x = frame[:3, 0] - z * (z @ frame[:3, 0])
        x /= np.linalg.norm(x)
        origin = p + z * (z @ (frame[:3, 3] - p))
        on_axes.append(homogeneous(np.column_stack([x, np.cross(z, x), z]), origin))
    return np.array(on_axes)


def flange_off_m(chain: Chain, coordinates: Array) -> float:
    """Return how far calibration (m,) moves the flange across the axis of the last joint.

    The coordinates (m,) are calibrated ones, at zero joint positions.
    """
    across_m = []
    for at in (chain.nominal, coordinates):
        carried, T_base_flange = carried_frames(chain, at)
        across_m.append((np.linalg.inv(carried[-1]) @ T_base_flange)[:2, 3])
    return float(np.linalg.norm(across_m[1] - across_m[0]))


def ur_deltas(chain: Chain, coordinates: Array, designed: UrLayout) -> Array | None:
    """Return the controller's deviations (6, 4) of Denavit-Hartenberg rows from those of a model.

    Columns are those of `UrLayout.table`. Between axes that are nearly parallel the rows have
    lengths of hundreds of metres, which cancel.

    Args:
        coordinates: (m,) calibrated ones, at zero joint positions.
        designed: the layout of the model.

    Returns:
        The deviations, or None where no such rows have the calibrated arm's forward kinematics:
        where its first axis is not z of the base, or its flange deviates by more than a row can.
    """
    carried, T_base_flange = carried_frames(chain, coordinates)
    T_controller_base = designed.T_base_controller.T
    carried, T_flange = T_controller_base @ carried, T_controller_base @ T_base_flange
    rows = rows_through(carried[:, :3, 3], carried[:, :3, 2], T_flange, _PARALLEL_RAD)
    table = rows.parameters[:, :4].copy()
    # What of the constant end frame the last row can hold: d, a and alpha.
    T_row_flange = rows.T_row_n_ee
    table[5, 2:] = T_row_flange[0, 3], np.arctan2(T_row_flange[2, 1], T_row_flange[2, 2])
    table[5, 1] += T_row_flange[2, 3]
    q = np.random.default_rng(_SEED).uniform(-np.pi, np.pi, (_CHECKS, 6))
    at_q = np.tile(coordinates, (_CHECKS, 1))
    at_q[:, chain.joint_columns] += q
    expected = T_controller_base @ end_pose(chain, at_q)
    off = np.abs(_forward(table, q) - expected).max()
    if not off < _HELD:
        return None
    deltas: Array = table - designed.table
    deltas[:, [0, 3]] = (deltas[:, [0, 3]] + np.pi) % (2.0 * np.pi) - np.pi
    return deltas


def ur_deltas_text(deltas: Array, *comments: str) -> str:
    """Return deviations (6, 4) as the text of the controller's `calibration.conf`."""
    lines = [f"# {one_line(line)}".rstrip() for line in comments] + ["[mounting]"]
    for name, values in zip(COLUMNS, deltas.T, strict=True):
        numbers = ", ".join(repr(float(value)) for value in values)
        lines.append(f"delta_{name} = [ {numbers}]")
    return "\n".join(lines) + "\n"


def _forward(table: Array, q: Array) -> Array:
    """Return forward kinematics (N, 4, 4) of standard rows (n, 4) at joint positions (N, n)."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for (theta, d, a, alpha), angle in zip(table, q.T, strict=True):
        turn = np.tile(np.eye(4), (len(q), 1, 1))
        cos, sin = np.cos(theta + angle), np.sin(theta + angle)
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = cos, -sin, sin, cos
        T = T @ turn @ placed(np.array([a, 0.0, d]), np.array([alpha, 0.0, 0.0]))
    return T


def arm_of_ur_rows(table: Array, name: str, designed: Arm | None, where: str) -> Arm:
    """Return the arm of calibrated Denavit-Hartenberg rows (6, 4), as `UrLayout.table`.

    Args:
        table: theta [rad], d [m], a [m] and alpha [rad] of each.
        name: of the arm.
        designed: the nominal arm, whose base, limits, gears and masses are taken over.
        where: the file, for messages.

    Raises:
        ArmError: when the nominal arm is no Universal Robots arm, or of another model.
    """
    base = _base_of(designed, where)
    rows = rows_of_table(np.column_stack([table, np.zeros(6)]), "standard", base, np.eye(4))
    return _arm(rows, name, designed, where)


def arm_of_ur_origins(origins: Array, name: str, designed: Arm | None, where: str) -> Arm:
    """Return the arm of the driver's origins (6, 4, 4) of its joints; see `arm_of_ur_rows`."""
    base = _base_of(designed, where)
    at = np.array([*accumulate([base, *origins], np.matmul)][1:])
    return _arm(rows_through(at[:, :3, 3], at[:, :3, 2], at[-1]), name, designed, where)


def _base_of(designed: Arm | None, where: str) -> Array:
    """Return the controller's base in the arm's own (4, 4); refuse an arm of another maker."""
    if designed is None:
        return np.eye(4)
    if (layout := ur_layout(designed)) is None:
        raise ArmError(
            "the arm as designed has not the layout of Universal Robots",
            where=where,
            value=designed.name,
            allowed="the model whose calibration this is, such as ur10",
            remedy="name it with --robot",
        )
    return layout.T_base_controller


def _arm(rows: DHRows, name: str, designed: Arm | None, where: str) -> Arm:
    """Return the calibrated arm of rows; refuse rows that are far from the nominal arm."""
    taken_over: dict[str, Any] = {
        "limits_rad": np.tile([-2.0 * np.pi, 2.0 * np.pi], (6, 1)),
        "gear_ratio": np.full(6, np.nan),
        "torque_limit_Nm": np.full(6, np.nan),
        "mass_kg": None,
        "com_m": None,
    }
    title = "Universal Robots"
    if designed is not None:
        taken_over = {key: getattr(designed, key) for key in taken_over}
        title = designed.title
        if designed.com_m is not None:  # the same centres, in the frames of the new rows
            chain = Chain.of(designed)
            T_base_designed = frames(chain, chain.nominal[None]).T_base_rows[:, 0]
            T = np.linalg.inv(rows.T_base_rows) @ T_base_designed
            com_m = np.einsum("kij,kj->ki", T[:, :3, :3], designed.com_m) + T[:, :3, 3]
            taken_over["com_m"] = neat(com_m)
    arm = with_hayati_rows(
        Arm(
            name=name,
            title=f"{title}, calibrated by its maker",
            prismatic=np.zeros(6, dtype=bool),
            **rows.arm_fields,
            **taken_over,
        )
    )
    if designed is not None:
        off_m = mean_distance(designed, arm)[0]
        if off_m > _NEAR:
            raise ArmError(
                "the calibration is of another model",
                where=where,
                value=f"the flange is {1e3 * off_m:.0f} mm off that of {designed.name}, in the "
                "mean of all postures",
                allowed=f"at most {1e3 * _NEAR:g} mm; calibrated arms are a few off",
                remedy="name the model that it is with --robot",
            )
    return arm
