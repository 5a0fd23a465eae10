"""The kinematic chain of an arm: forward kinematics, its exact derivatives, frames along it.

A chain is a sequence of elementary motions (rotations about and translations along the axes of the
moving frame). Each is driven by one chain coordinate: the base frame, theta, d, a, alpha and beta
of every Denavit-Hartenberg row, small bends at the ends of chosen links, the tool. The derivative
of the end's pose by a coordinate is the screw of its axis, which the same pass yields (paper,
Section II.C; Hayati's beta ends each row). The arm's constant frames, before its first row and
after its last, lie between the coordinates of the base or the tool and the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import ArmError

Axis = Literal[0, 1, 2]

BASE = ("base.x", "base.y", "base.z", "base.rx", "base.ry", "base.rz")
TOOL = ("tool.x", "tool.y", "tool.z", "tool.rx", "tool.ry", "tool.rz")

#: Receives, before every motion, its number and the frame's axes (each (3, P)) and origin (3, P).
_Visitor = Callable[[int, list[Array], Array], None]

#: Number and random seed of the postures in which two arms are compared.
_POSTURES, _SEED = 300, 20080427
#: Largest distance of a calibrated arm from the arm as designed: mean over all postures, and angle.
_NEAR_M, _NEAR_RAD = 0.02, 0.1


def roll_pitch_yaw(R: Array) -> Array:
    """Return the roll, pitch and yaw (3,) [rad] of a rotation (3, 3), about fixed axes x, y, z.

    URDF and arm files hold orientations so. The angles reproduce R to the last digit. At a pitch
    of 90 degrees roll and yaw are not unique: roll then takes up whatever yaw was chosen.
    """
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    yaw = np.arctan2(R[1, 0], R[0, 0])
    about_x = Rotation.from_euler("xyz", [0.0, pitch, yaw]).as_matrix().T @ R
    roll = np.arctan2(about_x[2, 1] - about_x[1, 2], about_x[1, 1] + about_x[2, 2])
    return np.array([roll, pitch, yaw])


def placed(p: Array, rpy: Array) -> Array:
    """Return the pose (4, 4) of a frame at p (3,) with roll, pitch and yaw (3,) [rad]."""
    return homogeneous(Rotation.from_euler("xyz", rpy).as_matrix(), p)


@dataclass(frozen=True)
class Motion:
    """One elementary motion: along or about an axis of the moving frame."""

    coordinate: str  # name of the chain coordinate that drives it
    axis: Axis  # 0, 1, 2 for x, y, z of the moving frame
    turns: bool  # whether it rotates (else it translates)

    def frame_at(self, value: float) -> Array:
        """Return the motion by a value [m, rad] as a transform (4, 4)."""
        if self.turns:
            R = Rotation.from_euler("xyz"[self.axis], value).as_matrix()
            return homogeneous(R, np.zeros(3))
        return homogeneous(np.eye(3), value * np.eye(3)[self.axis])


@dataclass(frozen=True)
class EndPose:
    """Pose of the end of the chain and its derivative by every chain coordinate."""

    T: Array  # (P, 4, 4) pose in the frame the chain starts from [m]
    # (P, 6, m) velocity of the end point [m per unit] over angular velocity [rad per unit], both
    # along the axes of the starting frame; the angular part is a small rotation applied on the
    # left
    screws: Array


@dataclass(frozen=True)
class Frames:
    """Frames along the chain, each as a pose in the frame the chain starts from [m]."""

    # (n, P, 4, 4) end of every Denavit-Hartenberg row, its own motions done. The last one lacks
    # the constant frame of the end-effector.
    T_base_rows: Array
    # (n, P, 4, 4) frame in which every joint moves, just before it does: along or about its z axis
    T_base_joints: Array
    T_base_ee: Array  # (P, 4, 4) end of the chain


@dataclass(frozen=True)
class Chain:
    """The chain of an arm; build it with `Chain.of`."""

    arm: Arm  # the nominal arm
    motions: tuple[Motion, ...]  # elementary motions from the base to the end, one a coordinate
    nominal: Array  # (m,) coordinates at zero joint positions
    joint_columns: NDArray[np.intp]  # (n,) column of the coordinate that each joint position drives
    # column of a motion, and the constant frame (4, 4) that precedes it; the identity is omitted
    constants: dict[int, Array]
    _columns: dict[str, int] = field(repr=False)

    @classmethod
    def of(cls, arm: Arm, bends: tuple[int, ...] = ()) -> Chain:
        """Return the chain of an arm: base, Denavit-Hartenberg rows, tool.

        Args:
            bends: rows, from 1, whose links may bend: by the six small motions
                `bend_coordinates(row)` at the link's end, in the frame in which the next joint
                moves.

        Raises:
            ArmError: when no joint follows a link that may bend.
        """
        for row in bends:
            if not 1 <= row < arm.n:
                raise ArmError(
                    "no joint follows the link that is to bend",
                    where=arm.name,
                    value=row,
                    allowed=f"rows 1 to {arm.n - 1}",
                    remedy="use the tool's coordinates at the end of the chain",
                )
        drives = [f"{'d' if slides else 'theta'}_{k}" for k, slides in enumerate(arm.prismatic, 1)]
        motions = _free_frame(BASE)
        for row in range(1, arm.n + 1):
            for motion in _row_motions(row, arm.convention):
                if motion.coordinate == drives[row - 1] and row - 1 in bends:
                    motions += _free_frame(bend_coordinates(row - 1))
                motions += (motion,)
        motions += _free_frame(TOOL)
        columns = {motion.coordinate: k for k, motion in enumerate(motions)}
        nominal = np.zeros(len(motions))
        for name in ("theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad"):
            for row, value in enumerate(getattr(arm, name), start=1):
                nominal[columns[f"{name.rpartition('_')[0]}_{row}"]] = value
        joints = np.array([columns[drive] for drive in drives])
        fixed_frames = {len(BASE): arm.T_base_row1, len(motions) - len(TOOL): arm.T_row_n_ee}
        constants = {column: T for column, T in fixed_frames.items() if (np.eye(4) != T).any()}
        return cls(arm, motions, nominal, joints, constants, columns)

    @property
    def bends(self) -> tuple[int, ...]:
        """Return the rows, from 1, whose links may bend at their ends."""
        return tuple(
            row for row in range(1, self.arm.n) if bend_coordinates(row)[0] in self._columns
        )

    def has_coordinate(self, name: str) -> bool:
        """Return whether the chain has a coordinate of this name."""
        return name in self._columns

    def columns(self, names: tuple[str, ...]) -> NDArray[np.intp]:
        """Return the columns of the named chain coordinates (KeyError when there is none)."""
        return np.array([self._columns[name] for name in names], dtype=np.intp)

    def coordinates(self, q_rad: Array) -> Array:
        """Return the nominal chain coordinates (P, m) at joint positions (P, n)."""
        coordinates = np.empty((len(q_rad), len(self.nominal)))
        coordinates[:] = self.nominal
        coordinates[:, self.joint_columns] += q_rad
        return coordinates

    def forward(self, q_rad: Array) -> Array:
        """Return the nominal pose of the end, T_base_ee (P, 4, 4), at joint positions (P, n)."""
        return end_pose(self, self.coordinates(q_rad))

    def forward_with_screws(self, q_rad: Array) -> EndPose:
        """Return the nominal pose of the end and its screws at joint positions (P, n)."""
        return end_pose_with_screws(self, self.coordinates(q_rad))


def bend_coordinates(row: int) -> tuple[str, ...]:
    """Return the names of the six motions of a link's bend: along x, y, z, then about them."""
    return tuple(f"bend_{row}.{motion}" for motion in ("x", "y", "z", "rx", "ry", "rz"))


def end_pose(chain: Chain, coordinates: Array) -> Array:
    """Return the pose of the end (P, 4, 4) at chain coordinates (P, m)."""
    frame, origin = _walk(chain, coordinates, None)
    return _homogeneous(frame, origin)


def end_pose_with_screws(
    chain: Chain, coordinates: Array, columns: Sequence[int] | None = None
) -> EndPose:
    """Return the pose of the end and the screw of every coordinate at coordinates (P, m).

    Args:
        columns: the coordinates whose screws are computed; the others' are zero. None for all.
    """
    T, screws = end_pose_and_screws(chain, coordinates)
    return EndPose(T, screws(columns))


def end_pose_and_screws(
    chain: Chain, coordinates: Array
) -> tuple[Array, Callable[[Sequence[int] | None], Array]]:
    """Return the pose of the end (P, 4, 4), and a function that returns the screws (P, 6, m).

    The function takes `columns` of `end_pose_with_screws`: who needs them can be known only once
    the pose is.
    """
    m, count = len(chain.motions), len(coordinates)
    axes: list[Array] = []  # (3, P) axis of every motion, in the starting frame
    origins: list[Array] = []  # (3, P) a point of that axis

    def visit(k: int, frame: list[Array], origin: Array) -> None:
        axes.append(frame[chain.motions[k].axis])
        origins.append(origin)

    frame, end = _walk(chain, coordinates, visit)

    def screws_of(columns: Sequence[int] | None) -> Array:
        chosen = range(m) if columns is None else columns
        turning = [k for k in chosen if chain.motions[k].turns]
        screws = np.zeros((m, 6, count))
        if turning:
            axis = np.concatenate([axes[k] for k in turning]).reshape(len(turning), 3, count)
            start = np.concatenate([origins[k] for k in turning]).reshape(len(turning), 3, count)
            lever = end - start
            screws[turning, 3:] = axis
            for row, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):  # axis x lever
                screws[turning, row] = axis[:, j] * lever[:, k] - axis[:, k] * lever[:, j]
        for k in chosen:
            if not chain.motions[k].turns:
                screws[k, :3] = axes[k]
        return screws.transpose(2, 1, 0)

    return _homogeneous(frame, end), screws_of


def frames(chain: Chain, coordinates: Array) -> Frames:
    """Return the frames of rows and joints, and the end, at chain coordinates (P, m)."""
    arm = chain.arm
    T_base_rows, T_base_joints = np.empty((2, arm.n, len(coordinates), 4, 4))
    last_motions = tuple(
        _row_motions(row, arm.convention)[-1].coordinate for row in range(1, arm.n + 1)
    )
    # A row's frame is the one before the motion that follows its last.
    row_after = {int(column) + 1: row for row, column in enumerate(chain.columns(last_motions))}
    joint_at = {int(column): joint for joint, column in enumerate(chain.joint_columns)}

    def visit(k: int, frame: list[Array], origin: Array) -> None:
        if k in row_after:
            T_base_rows[row_after[k]] = _homogeneous(frame, origin)
        if k in joint_at:
            T_base_joints[joint_at[k]] = _homogeneous(frame, origin)

    frame, end = _walk(chain, coordinates, visit)
    if len(chain.motions) - len(TOOL) in chain.constants:  # passed before the visit of the last row
        T_base_rows[-1] = T_base_rows[-1] @ np.linalg.inv(arm.T_row_n_ee)
    return Frames(T_base_rows, T_base_joints, _homogeneous(frame, end))


def link_spans_m(arm: Arm) -> Array:
    """Return the vector of every link from its joint to its end, along the end's axes, (n, 3).

    A link ends in the frame in which the next joint moves; the last one at the end of the chain.
    """
    chain = Chain.of(arm)
    nominal = frames(chain, chain.nominal[None])
    starts = nominal.T_base_joints[:, 0]
    ends = np.concatenate([starts[1:], nominal.T_base_ee])
    spans: Array = np.einsum("kji,kj->ki", ends[:, :3, :3], ends[:, :3, 3] - starts[:, :3, 3])
    return spans


def long_links(arm: Arm) -> tuple[int, ...]:
    """Return the rows, from 1, of upper arm and forearm, in the order of the chain.

    They are the two longest links between the first and the last; a short arm has fewer.
    """
    lengths = np.linalg.norm(link_spans_m(arm), axis=1)
    inner = [row for row in range(2, arm.n) if lengths[row - 1] > 0.0]
    return tuple(sorted(sorted(inner, key=lambda row: -lengths[row - 1])[:2]))


def _walk(chain: Chain, coordinates: Array, visit: _Visitor | None) -> tuple[list[Array], Array]:
    """Return axes and origin of the end of the chain; `visit` gets the frame before every motion.

    The frame is kept as its three axes, each (3, P): a rotation then touches two of them.
    """
    count = len(coordinates)
    frame = [np.repeat(column[:, None], count, axis=1) for column in np.eye(3)]
    origin = np.zeros((3, count))
    values = np.ascontiguousarray(coordinates.T)
    moves = values.any(axis=1)
    # Most coordinates are the same in every pose: a single number then stands for all.
    same = moves & (values == values[:, :1]).all(axis=1)
    varies = np.flatnonzero(moves & ~same)
    first = values[:, 0] if count else np.zeros(len(values))
    amounts: list[float | Array] = list(first.tolist())
    cosines: list[float | Array] = list(np.cos(first).tolist())
    sines: list[float | Array] = list(np.sin(first).tolist())
    varying = values[varies]
    cosines_of_varying, sines_of_varying = np.cos(varying), np.sin(varying)
    for row, k in enumerate(varies.tolist()):
        amounts[k] = varying[row]
        cosines[k], sines[k] = cosines_of_varying[row], sines_of_varying[row]
    moving = np.asarray(moves).tolist()
    for k, motion in enumerate(chain.motions):
        if k in chain.constants:
            frame, origin = _composed(frame, origin, chain.constants[k])
        if visit is not None:
            visit(k, frame, origin)
        if not moving[k]:
            continue
        if motion.turns:
            u, v = (motion.axis + 1) % 3, (motion.axis + 2) % 3
            cos, sin = cosines[k], sines[k]
            frame[u], frame[v] = (
                cos * frame[u] + sin * frame[v],
                cos * frame[v] - sin * frame[u],
            )
        else:
            origin = origin + amounts[k] * frame[motion.axis]
    return frame, origin


def _composed(frame: list[Array], origin: Array, T: Array) -> tuple[list[Array], Array]:
    """Return a frame, given by its axes and origin, times a constant transform (4, 4)."""
    axes = np.concatenate(frame).reshape(3, -1)
    moved = (T[:3].T @ axes).reshape(4, 3, -1)
    return [*moved[:3]], origin + moved[3]


def _homogeneous(frame: list[Array], origin: Array) -> Array:
    """Return axes and origin, each (3, P), as transforms (P, 4, 4)."""
    T = np.zeros((origin.shape[1], 4, 4))
    for column, axis in enumerate([*frame, origin]):
        T[:, :3, column] = axis.T
    T[:, 3, 3] = 1.0
    return T


@cache
def _free_frame(names: tuple[str, ...]) -> tuple[Motion, ...]:
    """Return six motions of these names: along x, y, z, then about x, y, z."""
    axes: tuple[Axis, ...] = (0, 1, 2)
    moves = [(axis, turns) for turns in (False, True) for axis in axes]
    return tuple(Motion(name, *move) for name, move in zip(names, moves, strict=True))


@cache
def _row_motions(row: int, convention: str) -> tuple[Motion, ...]:
    """Return the motions of a Denavit-Hartenberg row, from 1, in the order of its convention."""
    theta, d = Motion(f"theta_{row}", 2, True), Motion(f"d_{row}", 2, False)
    a, alpha = Motion(f"a_{row}", 0, False), Motion(f"alpha_{row}", 0, True)
    beta = Motion(f"beta_{row}", 1, True)
    if convention == "modified":
        return (beta, alpha, a, theta, d)
    return (theta, d, a, alpha, beta)


def pose_distances(T: Array, T_other: Array) -> tuple[Array, Array]:
    """Return distances [m] and angles [rad] between poses (P, 4, 4), (P,) each."""
    off_m = np.linalg.norm(T[:, :3, 3] - T_other[:, :3, 3], axis=1)
    # The norm of the difference of two rotations is 2 sqrt(2) sin(angle / 2).
    apart = np.linalg.norm(T[:, :3, :3] - T_other[:, :3, :3], axis=(1, 2)) / np.sqrt(2.0)
    off_rad = 2.0 * np.arcsin(np.clip(apart / 2.0, 0.0, 1.0))
    return np.asarray(off_m), np.asarray(off_rad)


def mean_distance(first: Arm, other: Arm) -> tuple[float, float, float]:
    """Return the difference of the end poses of two arms with equally many joints.

    Over random postures: mean and largest distance [m], and largest angle [rad].
    """
    low, high = first.limits_rad.T
    q = np.random.default_rng(_SEED).uniform(low, high, (_POSTURES, first.n))
    off_m, off_rad = pose_distances(*(Chain.of(arm).forward(q) for arm in (first, other)))
    return float(off_m.mean()), float(off_m.max()), float(off_rad.max())


def refuse_another_robot(arm: Arm, other: Arm, where: str) -> None:
    """Refuse a model of a controller that is of another robot than its arm.

    Raises:
        ArmError: when joints, base or flange differ.
    """
    if (arm.n, arm.prismatic.tolist()) != (other.n, other.prismatic.tolist()):
        difference = f"{other.n} joints, and {arm.n} of {arm.name}, or others of them slide"
    else:
        mean_m, _, most_rad = mean_distance(arm, other)
        if mean_m <= _NEAR_M and most_rad <= _NEAR_RAD:
            return
        difference = (
            f"{1e3 * mean_m:.0f} mm in the mean of all postures, {most_rad:.2f} rad at most from "
            f"{arm.name}"
        )
    raise ArmError(
        f"the model of the controller, {other.name}, is of another robot, base or flange",
        where=where,
        value=difference,
        allowed=f"the same joints, base and flange, within {1e3 * _NEAR_M:g} mm and "
        f"{_NEAR_RAD:g} rad",
        remedy="name the description of this robot as its maker measured it",
    )


def carried_frames(chain: Chain, coordinates: Array) -> tuple[Array, Array]:
    """Return the frames that the joints carry along, (n, 4, 4), and the flange (4, 4), in the base.

    Joint k moves along or about the z axis of its frame. Small motions of base and tool are
    omitted: the base is where the chain starts, the flange where it ends.

    Args:
        coordinates: (m,) at zero joint positions.
    """
    rigid = coordinates.copy()
    rigid[chain.columns(BASE + TOOL)] = 0.0
    along = frames(chain, rigid[None])
    carried = along.T_base_joints[:, 0].copy()
    for joint, column in enumerate(chain.joint_columns):
        carried[joint] = carried[joint] @ chain.motions[column].frame_at(rigid[column])
    return carried, along.T_base_ee[0]


def moved_frames(chain: Chain, coordinates: Array, T_base_frames: Array) -> tuple[Array, Array]:
    """Return where calibration moves frames fixed to the links, (n, 4, 4), and the flange (4, 4).

    Args:
        coordinates: (m,) calibrated ones, at zero joint positions.
        T_base_frames: (n, 4, 4) frame k in the nominal arm, fixed to what joint k carries along;
            see `carried_frames`.
    """
    designed, _ = carried_frames(chain, chain.nominal)
    calibrated, T_base_flange = carried_frames(chain, coordinates)
    moved: Array = calibrated @ np.linalg.inv(designed) @ T_base_frames
    return moved, T_base_flange
