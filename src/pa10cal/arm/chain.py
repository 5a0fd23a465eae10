"""The chain: forward kinematics and, for every chain coordinate, the screw it moves the end by.

A chain is a row of elementary motions (rotations about and translations along the axes of the
moving frame). Each is driven by one chain coordinate: the base frame, theta, d, a, alpha and beta
of every Denavit-Hartenberg row, small bends at the ends of chosen links, the tool. The derivative
of the end's pose by a coordinate is the screw of its axis, exact and at no extra cost (paper,
Section II.C; Hayati's beta ends each row). The constant frames of the arm, before its first row and
after its last, stand next to the rows, so that the small motions of base and tool lie outside.
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

# Orientations as roll, pitch and yaw about fixed axes x, y and z, as URDF and arm files hold them.


def roll_pitch_yaw(R: Array) -> Array:
    """Return angles (3,) [rad] that give a rotation (3, 3) back to the last digit.

    At a pitch of 90 degrees roll and yaw are not unique; any yaw will do there, because roll is
    the rotation that remains after pitch and yaw.
    """
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    yaw = np.arctan2(R[1, 0], R[0, 0])
    about_x = Rotation.from_euler("xyz", [0.0, pitch, yaw]).as_matrix().T @ R
    roll = np.arctan2(about_x[2, 1] - about_x[1, 2], about_x[1, 1] + about_x[2, 2])
    return np.array([roll, pitch, yaw])


def placed(p: Array, rpy: Array) -> Array:
    """Return the pose (4, 4) of a frame at p (3,) with roll, pitch and yaw (3,) [rad]."""
    return homogeneous(Rotation.from_euler("xyz", rpy).as_matrix(), p)


Axis = Literal[0, 1, 2]

BASE = ("base.x", "base.y", "base.z", "base.rx", "base.ry", "base.rz")
TOOL = ("tool.x", "tool.y", "tool.z", "tool.rx", "tool.ry", "tool.rz")

#: Called before every motion with its number, the frame's axes (each (3, P)) and origin (3, P).
_Note = Callable[[int, list[Array], Array], None]


@dataclass(frozen=True)
class Motion:
    """One elementary motion: along or about an axis of the moving frame."""

    coordinate: str  # name of the chain coordinate that drives it
    axis: Axis  # 0, 1, 2 for x, y, z of the moving frame
    turns: bool  # whether it rotates (else it translates)

    def frame_at(self, value: float) -> Array:
        """Return the frame (4, 4) so far along or about its axis [m, rad]."""
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
        """Lay out the chain of an arm: base, Denavit-Hartenberg rows, tool.

        The link of a row in `bends`, from 1, may bend: by six small motions `bend_coordinates(row)`
        at its end, in the frame in which the next joint moves.

        Raises:
            ArmError: when a row is named whose link no joint follows.
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
        placed = {len(BASE): arm.T_base_row1, len(motions) - len(TOOL): arm.T_row_n_ee}
        constants = {column: T for column, T in placed.items() if (np.eye(4) != T).any()}
        return cls(arm, motions, nominal, joints, constants, columns)

    @property
    def bends(self) -> tuple[int, ...]:
        """Return the rows, from 1, whose links may bend at their ends."""
        return tuple(
            row for row in range(1, self.arm.n) if bend_coordinates(row)[0] in self._columns
        )

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
    """Return the six coordinates of the bend at the end of a row's link: x, y, z, then about."""
    return tuple(f"bend_{row}.{motion}" for motion in ("x", "y", "z", "rx", "ry", "rz"))


def end_pose(chain: Chain, coordinates: Array) -> Array:
    """Return the pose of the end (P, 4, 4) at chain coordinates (P, m)."""
    frame, origin = _walk(chain, coordinates, None)
    return _homogeneous(frame, origin)


def end_pose_with_screws(
    chain: Chain, coordinates: Array, columns: Sequence[int] | None = None
) -> EndPose:
    """Return the pose of the end and the screw of every coordinate at coordinates (P, m).

    Columns are the coordinates whose screws are needed, all others are zero; None for all.
    """
    T, screws = end_pose_and_screws(chain, coordinates)
    return EndPose(T, screws(columns))


def end_pose_and_screws(
    chain: Chain, coordinates: Array
) -> tuple[Array, Callable[[Sequence[int] | None], Array]]:
    """Return the pose of the end (P, 4, 4), and what gives the screws (P, 6, m) if they are wanted.

    Its argument is `columns` of `end_pose_with_screws`.
    """
    m, count = len(chain.motions), len(coordinates)
    axes: list[Array] = [coordinates] * m
    origins: list[Array] = [coordinates] * m

    def note(k: int, frame: list[Array], origin: Array) -> None:
        axes[k], origins[k] = frame[chain.motions[k].axis], origin

    frame, end = _walk(chain, coordinates, note)

    def screws_of(columns: Sequence[int] | None) -> Array:
        chosen = range(m) if columns is None else columns
        turning = [k for k in chosen if chain.motions[k].turns]
        screws = np.zeros((m, 6, count))
        if turning:
            axis = np.concatenate([axes[k] for k in turning]).reshape(len(turning), 3, count)
            start = np.concatenate([origins[k] for k in turning]).reshape(len(turning), 3, count)
            arm = end - start
            screws[turning, 3:] = axis
            for row, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
                screws[turning, row] = axis[:, j] * arm[:, k] - axis[:, k] * arm[:, j]
        for k in chosen:
            if not chain.motions[k].turns:
                screws[k, :3] = axes[k]
        return screws.transpose(2, 1, 0)

    return _homogeneous(frame, end), screws_of


def frames(chain: Chain, coordinates: Array) -> Frames:
    """Return the frames of rows and joints, and the end, at chain coordinates (P, m)."""
    arm = chain.arm
    T_base_rows, T_base_joints = np.empty((2, arm.n, len(coordinates), 4, 4))
    lasts = (_row_motions(row, arm.convention)[-1].coordinate for row in range(1, arm.n + 1))
    ends = {int(column) + 1: row for row, column in enumerate(chain.columns(tuple(lasts)))}
    joints = {int(column): row for row, column in enumerate(chain.joint_columns)}

    def note(k: int, frame: list[Array], origin: Array) -> None:
        if k in ends:
            T_base_rows[ends[k]] = _homogeneous(frame, origin)
        if k in joints:
            T_base_joints[joints[k]] = _homogeneous(frame, origin)

    frame, end = _walk(chain, coordinates, note)
    if len(chain.motions) - len(TOOL) in chain.constants:
        T_base_rows[-1] = T_base_rows[-1] @ np.linalg.inv(arm.T_row_n_ee)
    return Frames(T_base_rows, T_base_joints, _homogeneous(frame, end))


def link_spans_m(arm: Arm) -> Array:
    """Return how far every link reaches, (n, 3): from its joint to its end, along that end's axes.

    A link ends in the frame in which the next joint moves; the last one at the end of the chain.
    """
    chain = Chain.of(arm)
    found = frames(chain, chain.nominal[None])
    starts = found.T_base_joints[:, 0]
    ends = np.concatenate([starts[1:], found.T_base_ee])
    reach = ends[:, :3, 3] - starts[:, :3, 3]
    spans: Array = np.einsum("kji,kj->ki", ends[:, :3, :3], reach)
    return spans


def long_links(arm: Arm) -> tuple[int, ...]:
    """Return the rows, from 1, of upper arm and forearm, in the order of the chain.

    Of the links after the first and before the last they are the two longest; a short arm has
    fewer.
    """
    lengths = np.linalg.norm(link_spans_m(arm), axis=1)
    inner = [row for row in range(2, arm.n) if lengths[row - 1] > 0.0]
    return tuple(sorted(sorted(inner, key=lambda row: -lengths[row - 1])[:2]))


def _walk(chain: Chain, coordinates: Array, note: _Note | None) -> tuple[list[Array], Array]:
    """Compute the end frame of the chain, calling `note` with the frame before every motion.

    The frame is kept as its three axes, each (3, P): a rotation then touches two of them.
    """
    count = len(coordinates)
    frame = [np.repeat(column[:, None], count, axis=1) for column in np.eye(3)]
    origin = np.zeros((3, count))
    values = np.ascontiguousarray(coordinates.T)
    moves = values.any(axis=1)
    # Most coordinates are the same in every pose: their sine is computed once.
    same = moves & (values == values[:, :1]).all(axis=1)
    varies = np.flatnonzero(moves & ~same)
    first = values[:, 0] if count else np.zeros(len(values))
    amounts: list[float | Array] = list(first.tolist())
    cosines: list[float | Array] = list(np.cos(first).tolist())
    sines: list[float | Array] = list(np.sin(first).tolist())
    varying = values[varies]
    for k, *of_k in zip(varies.tolist(), varying, np.cos(varying), np.sin(varying), strict=True):
        amounts[k], cosines[k], sines[k] = of_k
    moving = np.asarray(moves).tolist()
    for k, motion in enumerate(chain.motions):
        if k in chain.constants:
            frame, origin = _placed(frame, origin, chain.constants[k])
        if note is not None:
            note(k, frame, origin)
        if not moving[k]:
            continue
        if motion.turns:
            one, other = (motion.axis + 1) % 3, (motion.axis + 2) % 3
            cos, sin = cosines[k], sines[k]
            frame[one], frame[other] = (
                cos * frame[one] + sin * frame[other],
                cos * frame[other] - sin * frame[one],
            )
        else:
            origin = origin + amounts[k] * frame[motion.axis]
    return frame, origin


def _placed(frame: list[Array], origin: Array, T: Array) -> tuple[list[Array], Array]:
    """Compose a frame, given by its axes and origin, with a constant one."""
    axes = np.concatenate(frame).reshape(3, -1)
    moved = (T[:3].T @ axes).reshape(4, 3, -1)
    return [*moved[:3]], origin + moved[3]


def _homogeneous(frame: list[Array], origin: Array) -> Array:
    T = np.zeros((origin.shape[1], 4, 4))
    for column, axis in enumerate([*frame, origin]):
        T[:, :3, column] = axis.T
    T[:, 3, 3] = 1.0
    return T


@cache
def _free_frame(names: tuple[str, ...]) -> tuple[Motion, ...]:
    """Six motions x, y, z, then about x, y, z."""
    axes: tuple[Axis, ...] = (0, 1, 2, 0, 1, 2)
    return tuple(
        Motion(name, axis, k >= 3) for k, (name, axis) in enumerate(zip(names, axes, strict=True))
    )


@cache
def _row_motions(row: int, convention: str) -> tuple[Motion, ...]:
    theta, d = Motion(f"theta_{row}", 2, True), Motion(f"d_{row}", 2, False)
    a, alpha = Motion(f"a_{row}", 0, False), Motion(f"alpha_{row}", 0, True)
    beta = Motion(f"beta_{row}", 1, True)
    if convention == "modified":
        return (beta, alpha, a, theta, d)
    return (theta, d, a, alpha, beta)


# Frames that the joints of an arm carry along, and how they move when the arm is calibrated.


#: Postures in which two arms are compared.
_POSTURES, _SEED = 300, 20080427


def mean_distance(first: Arm, other: Arm) -> tuple[float, float, float]:
    """Return the difference of the end poses of two arms with equally many joints.

    Over random postures: mean and largest distance [m], and largest angle [rad].
    """
    low, high = first.limits_rad.T
    q = np.random.default_rng(_SEED).uniform(low, high, (_POSTURES, first.n))
    one, two = (Chain.of(arm).forward(q) for arm in (first, other))
    off_m = np.linalg.norm(one[:, :3, 3] - two[:, :3, 3], axis=1)
    # Twice the sine of half the angle between two orientations, over the square root of two.
    apart = np.linalg.norm(one[:, :3, :3] - two[:, :3, :3], axis=(1, 2)) / np.sqrt(2.0)
    off_rad = 2.0 * np.arcsin(np.clip(apart / 2.0, 0.0, 1.0))
    return float(off_m.mean()), float(off_m.max()), float(off_rad.max())


def carried_frames(chain: Chain, coordinates: Array) -> tuple[Array, Array]:
    """Return the frames that the joints carry along, (n, 4, 4), and the flange (4, 4), in the base.

    Joint k moves along or about the z axis of its frame. Small motions of base and tool are
    omitted: the base is where the chain starts, the flange where it ends. Its coordinates (m,) are
    those at zero joint positions.
    """
    at = coordinates.copy()
    at[chain.columns(BASE + TOOL)] = 0.0
    found = frames(chain, at[None])
    carried = found.T_base_joints[:, 0].copy()
    for joint, column in enumerate(chain.joint_columns):
        carried[joint] = carried[joint] @ chain.motions[column].frame_at(at[column])
    return carried, found.T_base_ee[0]


def moved_frames(chain: Chain, coordinates: Array, T_base_frames: Array) -> tuple[Array, Array]:
    """Return other frames fixed to the links, as calibration moves them, and the flange (4, 4).

    Frame k of `T_base_frames` (n, 4, 4) is fixed, by its pose in the nominal arm, to the frame that
    joint k carries along; see `carried_frames`.
    """
    designed, _ = carried_frames(chain, chain.nominal)
    calibrated, T_base_flange = carried_frames(chain, coordinates)
    moved: Array = calibrated @ np.linalg.inv(designed) @ T_base_frames
    return moved, T_base_flange
