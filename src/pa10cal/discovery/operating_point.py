"""A model at some parameters: what it leaves of measured poses, and how that follows each one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.fit.fitted_model import FittedModel
from pa10cal.frame.pose_error import pose_error
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import Offsets
from pa10cal.terms.term import Parameter, Term

Array = NDArray[np.float64]

#: Standard deviation thought possible of the model's own parameters, in their scale: wide enough
#: to leave every direction that the data tell alone, and to settle those that they do not.
_POSSIBLE_SCALES = 30.0
_POSSIBLE_UNITS = {"windup": 3e-2, "cubic_share": 3.0, "base": 1.0}


def moved_base(T_instr_base: Array, small: Array) -> Array:
    """Return a base frame moved by the six small motions (6,) that a model's base term makes."""
    moved = np.eye(4)
    moved[:3, 3] = small[:3]
    moved[:3, :3] = Rotation.from_euler("XYZ", small[3:]).as_matrix()
    T: Array = T_instr_base @ moved
    return T


def possible_sizes(model: Model) -> Array:
    """Return the standard deviation thought possible for every parameter of a model, (k,)."""
    return np.array(
        [
            next(
                (size for start, size in _POSSIBLE_UNITS.items() if p.name.startswith(start)),
                _POSSIBLE_SCALES * p.scale,
            )
            for p in model.parameters
        ]
    )


def left(at: FittedModel, poses: Observations[Pose]) -> Array:
    """Return predicted less measured poses, (P, 6): position [m], chord of the attitude."""
    error = pose_error(
        at.T_instr_base @ at.model.predict(poses.states, at.x), poses.measured.T_instr_target
    )
    return np.concatenate([error.position_m, error.chord], axis=1)


def by_terms(
    at: FittedModel, poses: Observations[Pose], terms: Sequence[Term], points: Sequence[Array]
) -> list[Array]:
    """Return how `left` follows the parameters of terms, each (P, 6, k')."""
    error = pose_error(
        at.T_instr_base @ at.model.predict(poses.states, at.x), poses.measured.T_instr_target
    )
    R = at.T_instr_base[:3, :3]
    turn = error.by_rotation @ R
    found = []
    for columns in at.model.by_terms(poses.states, at.x, terms, points):
        turned = np.empty_like(columns)
        turned[:, :3] = R @ columns[:, :3]
        turned[:, 3:] = turn @ columns[:, 3:]
        found.append(turned)
    return found


def by_joints(at: FittedModel, poses: Observations[Pose], joints: Sequence[int]) -> Array:
    """Return how `left` follows the positions of joints, from 1: (P, 6, j)."""
    chain = at.model.chain
    driven = [chain.motions[chain.joint_columns[joint - 1]].coordinate for joint in joints]
    positions = Offsets(tuple(Parameter(name, "", 1.0) for name in driven), tuple(driven))
    return by_terms(at, poses, [positions], [np.zeros(len(joints))])[0]
