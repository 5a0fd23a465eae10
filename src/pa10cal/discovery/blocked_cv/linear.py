"""Rows of many poses, linear about one model: what is left, and how it follows each parameter.

Maps of joint errors are kept as what turning the joint does and four B-splines of its angle: each
pose touches four of a map's many columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from pa10cal.calibration.pose_error import pose_error
from pa10cal.campaign.observations import PoseObservations
from pa10cal.terms.effects.joint_error_map import b_splines
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import Offsets
from pa10cal.terms.term import Parameter, Term

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """Where a model is linearised.

    Attributes:
        model: chain and terms.
        x: (k,) its parameters.
        T_instr_base: (4, 4) base frame, before what the model's own terms move it by.
    """

    model: Model
    x: Array
    T_instr_base: Array


def left(at: Place, poses: PoseObservations) -> Array:
    """Return predicted less measured poses, (P, 6): position [m], chord of the attitude."""
    error = pose_error(at.T_instr_base @ at.model.predict(poses.states, at.x), poses.T_instr_ee)
    return np.concatenate([error.position_m, error.chord], axis=1)


def by_terms(
    at: Place, poses: PoseObservations, terms: Sequence[Term], points: Sequence[Array]
) -> list[Array]:
    """Return how `left` follows the parameters of terms, each (P, 6, k')."""
    error = pose_error(at.T_instr_base @ at.model.predict(poses.states, at.x), poses.T_instr_ee)
    R = at.T_instr_base[:3, :3]
    turn = error.by_rotation @ R
    found = []
    for columns in at.model.by_terms(poses.states, at.x, terms, points):
        turned = np.empty_like(columns)
        turned[:, :3] = R @ columns[:, :3]
        turned[:, 3:] = turn @ columns[:, 3:]
        found.append(turned)
    return found


def by_joints(at: Place, poses: PoseObservations, joints: Sequence[int]) -> Array:
    """Return how `left` follows the positions of joints, from 1: (P, 6, j)."""
    chain = at.model.chain
    driven = [chain.motions[chain.joint_columns[joint - 1]].coordinate for joint in joints]
    positions = Offsets(tuple(Parameter(name, "", 1.0) for name in driven), tuple(driven))
    return by_terms(at, poses, [positions], [np.zeros(len(joints))])[0]


def map_columns(screws: Array, q_rad: Array, knots: Sequence[int]) -> csr_array:
    """Return how rows follow the B-splines of every joint's map, sparse.

    Args:
        screws: (P, 6, j) how rows follow the joints' angles.
        q_rad: (P, j) these angles.
        knots: K1, K2, … of the maps.

    Returns:
        (6 P, K1 + K2 + …), the rows pose by pose.
    """
    count, rows, joints = screws.shape
    if not joints:
        return csr_array((count * rows, 0))
    splines = [b_splines(each, q_rad[:, j]) for j, each in enumerate(knots)]
    first = np.cumsum([0, *knots])
    values = np.stack([each.data.reshape(count, 4) for each in splines], axis=1)
    columns = np.stack(
        [each.indices.reshape(count, 4) + first[j] for j, each in enumerate(splines)], axis=1
    )
    data = screws[:, :, :, None] * values[:, None]
    indices = np.broadcast_to(columns[:, None], data.shape)
    starts = np.arange(count * rows + 1) * 4 * joints
    return csr_array((data.ravel(), indices.ravel(), starts), shape=(count * rows, first[-1]))
