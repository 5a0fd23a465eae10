from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import ObservedTargets
from pa10cal.frame.rigid_fit import fit_rigid
from pa10cal.terms.model import Model

BALLS_M = np.array([[0.095, 0.0, 0.31], [-0.05, 0.08, 0.31], [-0.05, -0.08, 0.312]])
STEP_M = 1e-6


def motion_in_ee(T_from, T_to):
    """Small motion from one pose to another, along the axes of the first, (..., 6)."""
    back = np.swapaxes(T_from[..., :3, :3], -1, -2)
    shift = np.einsum("...ij,...j->...i", back, T_to[..., :3, 3] - T_from[..., :3, 3])
    turn = Rotation.from_matrix((back @ T_to[..., :3, :3]).reshape(-1, 3, 3)).as_rotvec()
    return np.concatenate([shift, turn.reshape(shift.shape)], axis=-1)


@pytest.mark.parametrize(
    ("name", "x", "matrix"),
    [
        ("cmm_scale", [1e-4, -2e-4, 3e-4], np.diag([1e-4, -2e-4, 3e-4])),
        ("cmm_squareness", [2e-4], 2e-4 * np.outer([1, 0, 0], [0, 1, 0])),
    ],
)
def test_predicts_the_pose_that_a_false_instrument_reads(name, x, matrix, at, arm, states):
    """The instrument stands at the base here, and reads p + matrix p."""
    T_true = Chain.of(arm).forward(states.q_rad)
    p_m = np.einsum("pij,bj->pbi", T_true[:, :3, :3], BALLS_M) + T_true[:, None, :3, 3]
    nudges = STEP_M * np.eye(9).reshape(9, 1, 3, 3)
    nudged = fit_rigid(BALLS_M, p_m + nudges).T
    by_targets = np.moveaxis(motion_in_ee(T_true, nudged), 0, -1) / STEP_M
    seen = ObservedTargets(p_instr_targets_m=p_m, pose_by_targets=by_targets)
    model = Model(Chain.of(arm), (at(name, "instrument"),))
    predicted = model.predict(replace(states, seen=seen), np.array(x))
    read = fit_rigid(BALLS_M, p_m + p_m @ matrix.T).T
    moved = motion_in_ee(T_true, read)
    assert np.abs(moved).max() > 1e-5
    np.testing.assert_allclose(motion_in_ee(T_true, predicted), moved, atol=2e-7)
