"""Frames that the joints of an arm carry along, and how they move when the arm is calibrated."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import BASE, TOOL, Chain, frames
from pa10cal.arrays import Array


def carried_frames(chain: Chain, coordinates: Array) -> tuple[Array, Array]:
    """Return the frames that the joints carry along, (n, 4, 4), and the flange (4, 4), in the base.

    Joint k moves along or about the z axis of its frame. Small motions of base and tool are
    omitted: the base is where the chain starts, the flange where it ends.

    Args:
        chain: the chain.
        coordinates: (m,) its coordinates at zero joint positions.
    """
    at = coordinates.copy()
    at[chain.columns(BASE + TOOL)] = 0.0
    found = frames(chain, at[None])
    carried = found.T_base_joints[:, 0].copy()
    for joint, column in enumerate(chain.joint_columns):
        own = np.eye(4)
        if chain.motions[column].turns:
            own[:3, :3] = Rotation.from_euler("z", at[column]).as_matrix()
        else:
            own[2, 3] = at[column]
        carried[joint] = carried[joint] @ own
    return carried, found.T_base_ee[0]


def moved_frames(chain: Chain, coordinates: Array, T_base_frames: Array) -> tuple[Array, Array]:
    """Return other frames that the joints carry along, moved from nominal, and the flange.

    Args:
        chain: the chain.
        coordinates: (m,) its coordinates at zero joint positions.
        T_base_frames: (n, 4, 4) a frame that each joint carries along, as designed, in the base.

    Returns:
        (n, 4, 4): so placed that their joints' axes, in their own axes, are as they were; (4, 4).
    """
    designed, _ = carried_frames(chain, chain.nominal)
    calibrated, T_base_flange = carried_frames(chain, coordinates)
    moved: Array = calibrated @ np.linalg.inv(designed) @ T_base_frames
    return moved, T_base_flange
