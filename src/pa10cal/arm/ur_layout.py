"""Kinematics of an arm of Universal Robots in the form that their driver for ROS 2 reads.

The driver takes the origin of each of six joints, all of which turn about z, in the frame that the
joint before carries along. The frame of the last joint is the flange.
"""

from __future__ import annotations

import hashlib

import numpy as np

from pa10cal.arm.attitude import placed, roll_pitch_yaw
from pa10cal.arm.chain import Chain
from pa10cal.arm.joint_frames import carried_frames, moved_frames
from pa10cal.arrays import Array

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
#: How far an arm may be from the layout as designed [m, rad].
_SAME = 1e-5
_QUARTER = np.pi / 2.0


def ur_kinematics(chain: Chain, coordinates: Array, *comments: str) -> str | None:
    """Return the calibration file of the driver; None where the arm has another layout.

    What the last row departs by across its joint's axis (a, alpha, beta) has no place in it; see
    `flange_off_m`.

    Args:
        chain: the chain of the arm.
        coordinates: (m,) calibrated coordinates at zero joint positions.
        comments: lines that stand first.
    """
    T_base_frames = _frames_as_designed(chain)
    if T_base_frames is None:
        return None
    moved, T_base_flange = moved_frames(chain, coordinates, T_base_frames)
    along_m = float((np.linalg.inv(moved[-1]) @ T_base_flange)[2, 3])
    moved[-1, :3, 3] += along_m * moved[-1, :3, 2]
    # The driver counts from the frame that the first joint stands on, turned with its own base.
    before = np.concatenate([_turned_base(T_base_frames)[None], moved[:-1]])
    lines = [f"# {line}".rstrip() for line in comments] + ["kinematics:"]
    for name, T in zip(LINKS, np.linalg.inv(before) @ moved, strict=True):
        lines.append(f"  {name}:")
        values = (*T[:3, 3], *roll_pitch_yaw(T[:3, :3]))
        keys = ("x", "y", "z", "roll", "pitch", "yaw")
        lines += [f"    {key}: {float(value)!r}" for key, value in zip(keys, values, strict=True)]
    digest = hashlib.sha256("\n".join(lines).encode()).hexdigest()
    return "\n".join([*lines, f"  hash: calib_{int(digest[:15], 16)}"]) + "\n"


def flange_off_m(chain: Chain, coordinates: Array) -> float:
    """Return how far the flange is from where the last joint's axis, as designed, would have it.

    Args:
        chain: the chain of the arm.
        coordinates: (m,) calibrated coordinates at zero joint positions.
    """
    ends = []
    for at in (chain.nominal, coordinates):
        carried, T_base_flange = carried_frames(chain, at)
        ends.append(np.linalg.inv(carried[-1]) @ T_base_flange)
    return float(np.linalg.norm(ends[1][:2, 3] - ends[0][:2, 3]))


def _turned_base(T_base_frames: Array) -> Array:
    """Return the base that the first joint stands on, about z in line with its frame."""
    T = np.eye(4)
    T[:3, :3] = T_base_frames[0, :3, :3]
    return T


def _frames_as_designed(chain: Chain) -> Array | None:
    """Return the driver's frames (6, 4, 4) of the arm as designed; None for another layout."""
    arm = chain.arm
    if arm.n != 6 or arm.prismatic.any():
        return None
    carried, T_base_flange = carried_frames(chain, chain.nominal)
    h, p = carried[:, :3, 2], carried[:, :3, 3]
    for yaw in (0.0, np.pi):
        base = placed(np.zeros(3), np.array([0.0, 0.0, yaw]))
        axes, points = h @ base[:3, :3], p @ base[:3, :3]
        T_flange = base.T @ T_base_flange
        # Heights and lengths along x, from places that the axes go through.
        d1, d14 = points[1, 2], -T_flange[1, 3]
        a2, a3 = points[2, 0], points[3, 0] - points[2, 0]
        d5, d6 = d1 - T_flange[2, 3], _d6(axes, points, T_flange)
        origins = (
            placed(np.array([0.0, 0.0, d1]), np.zeros(3)),
            placed(np.zeros(3), np.array([_QUARTER, 0.0, 0.0])),
            placed(np.array([a2, 0.0, 0.0]), np.zeros(3)),
            placed(np.array([a3, 0.0, d14 - d6]), np.zeros(3)),
            placed(np.array([0.0, -d5, 0.0]), np.array([_QUARTER, 0.0, 0.0])),
            placed(np.array([0.0, d6, 0.0]), np.array([-_QUARTER, 0.0, 0.0])),
        )
        found, T = [], base
        for origin in origins:
            T = T @ origin
            found.append(T)
        if _agree(np.array(found), carried, T_base_flange):
            return np.array(found)
    return None


def _d6(axes: Array, points: Array, T_flange: Array) -> float:
    """Return how far the flange is beyond the fifth axis, along the sixth."""
    across = np.cross(axes[4], axes[5])
    return float((T_flange[:3, 3] - points[4]) @ axes[5]) if np.linalg.norm(across) > 0.5 else 0.0


def _agree(found: Array, carried: Array, T_base_flange: Array) -> bool:
    """Return whether axes and flange of a layout are those of an arm."""
    along = found[:, :3, 2] - carried[:, :3, 2]
    beside = np.cross(found[:, :3, 3] - carried[:, :3, 3], carried[:, :3, 2])
    return bool(
        max(np.abs(along).max(), np.abs(beside).max(), np.abs(found[-1] - T_base_flange).max())
        < _SAME
    )
