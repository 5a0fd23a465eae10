"""What no base and no targets get below is never above what a fit leaves."""

from __future__ import annotations

import numpy as np
import pytest

from made_up_sightings import sighted
from pa10cal.arm.chain import Chain
from pa10cal.files.arms import load_arm
from pa10cal.frame.hand_eye import hand_eye_from_points, hand_eye_from_poses, ranging
from pa10cal.frame.target_problem import distance_misfit_bound_m, target_misfit_bound_m
from pa10cal.rules import FRAMES


@pytest.mark.parametrize("changed", ["nothing", "sign", "coupling", "order"])
def test_what_is_left_at_least_is_less_than_what_a_fit_leaves(tmp_path, changed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    q = raw.q.copy()
    if changed == "sign":
        q[:, 4] *= -1.0
    elif changed == "coupling":
        q[:, 2] += q[:, 1]
    elif changed == "order":
        q[:, [3, 5]] = q[:, [5, 3]]
    T = Chain.of(load_arm("ur10")).forward(q)
    poses = hand_eye_from_poses(T, raw.T_instr_target)
    places_m, R = raw.T_instr_target[:, None, :3, 3], raw.T_instr_target[:, :3, :3]
    of_poses = target_misfit_bound_m(T, places_m, R)
    assert 0.0 <= of_poses <= np.hypot(poses.scatter_m, FRAMES.lever_m * poses.scatter_rad)
    points = target_misfit_bound_m(T, raw.p_instr_m)
    assert 0.0 <= points <= hand_eye_from_points(T, raw.p_instr_m).scatter_m + 1e-6
    distances = distance_misfit_bound_m(T, raw.d_m)
    assert 0.0 <= distances <= ranging(T, raw.d_m).scatter_m + 1e-6
    if changed != "nothing":  # and it tells
        assert min(of_poses, points, distances) > 0.01
