"""Motion of fixed targets: recovered with its uncertainty, none where none is, knocks told."""

import numpy as np
import pytest

from pa10cal.frame.base_motion import base_motion

U_M = 5e-6


def readings(rng, count=600, targets=3, walk_m=50e-6, turn_rad=10e-6, white_m=0.0):
    """Targets some metres away that move together, and their true motion about their middle."""
    places = rng.uniform(-0.5, 0.5, (targets, 3)) + np.array([0.0, 0.0, 2.5])
    end = np.array([walk_m] * 3 + [turn_rad] * 3)
    motion = np.cumsum(rng.standard_normal((count, 6)), axis=0) / np.sqrt(count) * end
    motion[:, :3] += white_m * rng.standard_normal((count, 3))
    p_m = places + motion[:, None, :3]
    p_m += np.cross(motion[:, None, 3:], places - places.mean(axis=0))
    p_m += U_M * rng.standard_normal(p_m.shape)
    motion -= motion.mean(axis=0)
    return 30.0 * np.arange(count), p_m, np.full(p_m.shape, U_M), motion


def normalised(found, motion):
    """Errors over their standard uncertainties, of the components that show."""
    d = 6 if found.turns else 3
    error = (found.motion - motion)[:, :d]
    return error / np.sqrt(np.diagonal(found.cov, axis1=1, axis2=2)[:, :d])


@pytest.mark.parametrize("targets", [1, 3, 5])
def test_a_walk_is_recovered_with_its_uncertainty(targets):
    turn_rad = 10e-6 if targets > 2 else 0.0
    t, p, u, motion = readings(np.random.default_rng(targets), 600, targets, turn_rad=turn_rad)
    found = base_motion(t, p, u)
    assert found.form == "walk"
    assert found.turns == (targets > 2)
    error = found.motion - motion
    assert np.sqrt(np.mean(error[:, :3] ** 2)) < 0.2 * np.sqrt(np.mean(motion[:, :3] ** 2))
    assert np.sqrt(np.mean(error[:, :3] ** 2)) < U_M / np.sqrt(targets)
    assert 0.8 < np.sqrt(np.mean(normalised(found, motion) ** 2)) < 1.25
    assert found.noise == pytest.approx(1.0, abs=0.15)
    assert not found.knocked


@pytest.mark.parametrize("targets", [1, 2, 3, 4])
def test_nothing_moves_where_nothing_moved(targets):
    for seed in range(5):
        t, p, u, _ = readings(np.random.default_rng(seed), 300, targets, 0.0, 0.0)
        found = base_motion(t, p, u)
        assert found.form == "still"
        assert not found.motion.any()
        assert not found.cov.any()
        assert not found.knocked


def test_motions_of_each_configuration_are_taken_one_by_one():
    t, p, u, motion = readings(np.random.default_rng(1), 400, 4, 0.0, 0.0, white_m=30e-6)
    found = base_motion(t, p, u)
    assert found.form == "each"
    shift = slice(0, 3)
    assert np.std((found.motion - motion)[:, shift]) < 1.2 * U_M / np.sqrt(4)


def test_rows_without_enough_targets_follow_their_neighbours():
    t, p, u, motion = readings(np.random.default_rng(2))
    p[100:110] = np.nan
    p[200:260, 1:] = np.nan
    found = base_motion(t, p, u)
    sure = np.sqrt(np.trace(found.cov[:, :3, :3], axis1=1, axis2=2))
    assert sure[105] > 1.5 * np.median(sure)
    assert np.abs(normalised(found, motion)).max() < 6.0


@pytest.mark.parametrize("targets", [3, 4])
def test_a_knocked_target_is_told_and_left_out_of_its_shorter_stretch(targets):
    rng = np.random.default_rng(7)
    t, p, u, motion = readings(rng, 600, targets)
    across = np.cross(p[0, 1] - p[0, 0], p[0, 2] - p[0, 0])
    shift = np.cross(across / np.linalg.norm(across), p[0, 1] - p[0, 0])
    shift *= 60e-6 / np.linalg.norm(shift)
    shift += 0.5 * 60e-6 * (p[0, 0] - p[0, 1]) / np.linalg.norm(p[0, 0] - p[0, 1])
    p[450:, 0] += shift
    found = base_motion(t, p, u)
    (knock,) = found.knocked
    assert knock.targets == (0,)
    assert abs(knock.row - 450) <= 2
    assert knock.shift_m == pytest.approx(np.linalg.norm(shift), rel=0.2)
    assert not found.used[knock.row :, 0].any()
    assert found.used[: knock.row - 2, 0].mean() > 0.95
    assert np.sqrt(np.mean(normalised(found, motion) ** 2)) < 1.3


def test_of_two_targets_it_is_not_known_which_was_knocked():
    t, p, u, _ = readings(np.random.default_rng(3), 300, 2, 0.0, 0.0)
    along = (p[0, 1] - p[0, 0]) / np.linalg.norm(p[0, 1] - p[0, 0])
    p[120:, 1] += 1e-4 * along
    (knock,) = base_motion(t, p, u).knocked
    assert knock.targets == (0, 1)
    assert knock.row == 120


def test_one_wrong_reading_leaves_its_neighbours_alone():
    t, p, u, motion = readings(np.random.default_rng(4))
    p[300, 1] += 5e-3
    found = base_motion(t, p, u)
    assert not found.used[300].any()
    assert not found.knocked
    assert np.abs(found.motion - motion)[295:305, :3].max() < 3.0 * U_M


def test_targets_in_line_show_shifts_alone():
    rng = np.random.default_rng(5)
    t, p, u, _ = readings(rng, 200, 3, 0.0, 0.0)
    p = p[:1, :1] + np.array([0.0, 0.4, 1.0])[:, None] * [1.0, 0.2, 0.1]
    p = p + U_M * rng.standard_normal((200, 3, 3))
    assert not base_motion(t, p, u).turns
