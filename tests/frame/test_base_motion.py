"""Motion of fixed targets: recovered with its uncertainty, none where none is, knocks told."""

import numpy as np
import pytest

from pa10cal.frame.base_motion import common_motion
from pa10cal.frame.point_fits import by_small_motion

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


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("targets", [1, 3, 5])
def test_a_walk_is_recovered_with_its_uncertainty(targets):
    turn_rad = 10e-6 if targets > 2 else 0.0
    t, p, u, motion = readings(np.random.default_rng(targets), 600, targets, turn_rad=turn_rad)
    found = common_motion(t, p, u)
    assert found.form == "walk"
    assert found.turns == (targets > 2)
    error = found.motion - motion
    assert np.sqrt(np.mean(error[:, :3] ** 2)) < 0.2 * np.sqrt(np.mean(motion[:, :3] ** 2))
    assert np.sqrt(np.mean(error[:, :3] ** 2)) < U_M / np.sqrt(targets)
    assert 0.8 < np.sqrt(np.mean(normalised(found, motion) ** 2)) < 1.25
    assert found.noise == pytest.approx(1.0, abs=0.15)
    assert not found.knocked


def test_motions_of_each_configuration_are_taken_one_by_one():
    t, p, u, motion = readings(np.random.default_rng(1), 400, 4, 0.0, 0.0, white_m=30e-6)
    found = common_motion(t, p, u)
    assert found.form == "each"
    shift = slice(0, 3)
    assert np.std((found.motion - motion)[:, shift]) < 1.2 * U_M / np.sqrt(4)


def test_rows_without_enough_targets_follow_their_neighbours():
    t, p, u, motion = readings(np.random.default_rng(2))
    p[100:110] = np.nan
    p[200:260, 1:] = np.nan
    found = common_motion(t, p, u)
    sure = np.sqrt(np.trace(found.cov[:, :3, :3], axis1=1, axis2=2))
    assert sure[105] > 1.5 * np.median(sure)
    assert np.abs(normalised(found, motion)).max() < 6.0


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("targets", [3, 4])
def test_a_knocked_target_is_told_and_left_out_of_its_shorter_stretch(targets):
    rng = np.random.default_rng(7)
    t, p, u, motion = readings(rng, 600, targets)
    across = np.cross(p[0, 1] - p[0, 0], p[0, 2] - p[0, 0])
    shift = np.cross(across / np.linalg.norm(across), p[0, 1] - p[0, 0])
    shift *= 60e-6 / np.linalg.norm(shift)
    shift += 0.5 * 60e-6 * (p[0, 0] - p[0, 1]) / np.linalg.norm(p[0, 0] - p[0, 1])
    p[450:, 0] += shift
    found = common_motion(t, p, u)
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
    (knock,) = common_motion(t, p, u).knocked
    assert knock.targets == (0, 1)
    assert knock.row == 120


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("off_m", [[0.0, 0.0, 5e-3], [3e-4, 0.0, 0.0], [-0.395, -0.016, 0.077]])
def test_one_wrong_reading_is_left_out_alone(off_m):
    t, p, u, motion = readings(np.random.default_rng(4))
    p[300, 1] += off_m
    found = common_motion(t, p, u)
    assert found.wrong[300].tolist() == [False, True, False]
    assert found.used[300].tolist() == [True, False, True]
    assert not found.knocked
    assert np.abs(found.motion - motion)[295:305, :3].max() < 3.0 * U_M


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("white_m", [0.0, 30e-6])
def test_another_target_read_a_few_times_changes_nothing_else(white_m):
    """Of three targets one is exchanged for another, 396 mm off, as measured campaigns have it."""
    t, p, u, motion = readings(np.random.default_rng(8), 500, 3, white_m=white_m)
    clean = common_motion(t, p, u)
    rows = [21, 50, 135, 399, 400]
    p[rows, 2] = p[rows, 0] + np.array([0.3, -0.25, 0.07])
    found = common_motion(t, p, u)
    assert np.flatnonzero(found.wrong[:, 2]).tolist() == rows
    assert found.wrong.sum() == clean.wrong.sum() + len(rows)
    assert found.form == clean.form
    others = np.setdiff1d(np.arange(500), rows)
    np.testing.assert_allclose(found.motion[others], clean.motion[others], atol=0.3 * U_M)
    np.testing.assert_allclose(found.cov[others], clean.cov[others], atol=(0.3 * U_M) ** 2)
    assert np.sqrt(np.mean(normalised(found, motion) ** 2)) < 1.3


def test_an_instrument_that_jumps_for_one_reading_is_followed():
    t, p, u, _ = readings(np.random.default_rng(9), 300, 4, 0.0, 0.0, white_m=20e-6)
    p[120] += [8e-4, 0.0, -5e-4]
    found = common_motion(t, p, u)
    assert not found.wrong[120].any()
    shift = found.motion[120, :3] - found.motion[:120, :3].mean(axis=0)
    np.testing.assert_allclose(shift, [8e-4, 0.0, -5e-4], atol=1e-4)


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("targets", [2, 3, 4])
def test_what_is_within_the_stated_uncertainty_is_no_fault(targets):
    """Readings that agree ten times better than stated, and a target that moves by half of it."""
    t, p, u, _ = readings(np.random.default_rng(10), 400, targets)
    stated = 10.0 * u
    along = (p[0, 1] - p[0, 0]) / np.linalg.norm(p[0, 1] - p[0, 0])
    p[250:, 1] += 0.4 * stated[0, 0, 0] * along
    p[60, 0] += 0.9 * stated[0, 0]
    found = common_motion(t, p, stated)
    assert not found.knocked
    assert not found.wrong.any()
    assert found.used.all()
    assert common_motion(t, p, u).knocked


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("targets", [1, 2])
def test_where_no_turn_shows_it_is_as_uncertain_as_it_is_large(targets):
    ratios = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        t, p, u, motion = readings(rng, 400, targets, walk_m=50e-6, turn_rad=20e-6)
        if targets == 1:  # one that turns where it stands, which moves what it reads
            moved = np.cross(motion[:, None, 3:], p.mean(axis=0))
            p = p.mean(axis=0) + moved + U_M * rng.standard_normal(p.shape)
        found = common_motion(t, p, u)
        assert not found.turns
        assert found.form == "walk"
        assert not found.motion[:, 3:].any()
        turn = found.cov[:, 3:, 3:]
        np.testing.assert_allclose(turn, turn[0, 0, 0] * np.eye(3)[None].repeat(400, 0))
        ratios.append(np.sqrt(turn[0, 0, 0] / np.mean(motion[:, 3:] ** 2)))
    assert 0.5 < np.median(ratios) < 2.0


@pytest.mark.slow_but_one_in(9)
@pytest.mark.parametrize("targets", [1, 2, 3, 5])
@pytest.mark.parametrize("size", [1.0, 20.0])
@pytest.mark.parametrize("tails", [None, 3.0])
def test_targets_that_show_noise_alone_are_as_good_as_none(targets, size, tails):
    for seed in range(2):
        rng = np.random.default_rng([seed, targets])
        places = rng.uniform(-0.5, 0.5, (targets, 3)) + np.array([0.0, 0.0, 2.5])
        shape = (200, targets, 3)
        noise = rng.standard_normal(shape) if tails is None else rng.standard_t(tails, shape)
        found = common_motion(np.arange(200.0), places + size * U_M * noise, np.full(shape, U_M))
        assert found.form == "still"
        assert not found.motion.any()
        assert not found.cov.any()
        assert tails or not found.knocked


def test_a_turn_that_half_of_the_configurations_do_not_show_is_left_out():
    t, p, u, _ = readings(np.random.default_rng(11), 400, 3)
    p[:220, 2] = np.nan
    found = common_motion(t, p, u)
    assert not found.turns
    p[:, 1] = np.nan
    assert not common_motion(t, p, u).used[:, 1].any()


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("case", ["whole", "one_left", "gap", "one_by_one", "two"])
def test_covariance_never_exceeds_what_leaving_the_motion_out_costs(case):
    white_m = 30e-6 if case == "one_by_one" else 0.0
    t, p, u, motion = readings(np.random.default_rng(12), 400, 3, white_m=white_m)
    if case == "one_left":
        p[150:340, :2] = np.nan
    if case == "gap":
        p[100:250] = np.nan
    if case == "one_by_one":
        p[::3, 1:] = np.nan
    if case == "two":
        p = p[:, :2]
        u = u[:, :2]
    found = common_motion(t, p, u)
    d = 6 if found.turns else 3
    # What single configurations show, by the places that the targets have in the mean.
    whole = np.isfinite(p).all(axis=(1, 2))
    places = np.nanmean(p, axis=0)
    modes = by_small_motion(places - places.mean(axis=0)).reshape(-1, 6)[:, :d]
    off = (p[whole] - places).reshape(int(whole.sum()), -1)
    shown = off @ np.linalg.pinv(modes).T
    spread = np.cov(shown.T)
    root = np.linalg.inv(np.linalg.cholesky(spread))
    parts = np.linalg.eigvalsh(root @ found.cov[:, :d, :d] @ root.T)
    assert parts.max() < 1.1
    assert np.sqrt(np.mean(normalised(found, motion) ** 2)) < 1.4


@pytest.mark.parametrize("targets", [2, 4])
@pytest.mark.parametrize("times", [1, 2])
def test_a_target_of_which_no_reading_is_right_changes_nothing_else(targets, times):
    t, p, u, _ = readings(np.random.default_rng(13), 100, targets + 1)
    others = common_motion(t, p[:, :targets], u[:, :targets])
    p[times:, targets] = np.nan
    p[0, targets] += 5e-3
    found = common_motion(t, p, u)
    assert found.form == others.form
    assert not found.used[1:, targets].any()
    np.testing.assert_allclose(found.motion[1:], others.motion[1:], atol=2.0 * U_M)


def test_targets_in_line_show_shifts_alone():
    rng = np.random.default_rng(5)
    t, p, u, _ = readings(rng, 200, 3, 0.0, 0.0)
    p = p[:1, :1] + np.array([0.0, 0.4, 1.0])[:, None] * [1.0, 0.2, 0.1]
    p = p + U_M * rng.standard_normal((200, 3, 3))
    assert not common_motion(t, p, u).turns
