"""The gap is paired over poses, and each load has its own."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import ttest_rel

from made_up_poses import at_rest, measured_poses
from pa10cal.discovery.gap import PairedErrors, fallen_back, gap, trusted

POSES, LOADS_N = 12, (0.0, 44.0)

FLOOR_MM = 0.004


def made(poses=POSES, loads_N=LOADS_N):
    """Return poses at the origin, and two models that miss them by known distances."""
    rng = np.random.default_rng(4)
    count = poses * len(loads_N)
    pose = np.repeat([f"P{k:02d}" for k in range(poses)], len(loads_N))
    measured = measured_poses(
        pose=pose,
        states=at_rest(np.zeros((count, 6)), load_N=np.tile(loads_N, poses)),
        T_instr_ee=np.tile(np.eye(4), (count, 1, 1)),
        cov=np.tile(np.eye(6), (count, 1, 1)),
    )
    off_mm = rng.uniform(0.2, 0.4, count), rng.uniform(0.0, 0.1, count)
    models = []
    for each in off_mm:
        T = np.tile(np.eye(4), (count, 1, 1))
        T[:, 0, 3] = 1e-3 * each
        models.append(T)
    return measured, models, off_mm


def compared(measured, before, after, T_moved=None) -> PairedErrors:
    """Return the gap of two models that say where the end is."""

    def model(T):
        return SimpleNamespace(
            as_read=lambda _: T, T_instr_base=np.eye(4), targets_read_m=lambda _: np.zeros(0)
        )

    return gap(measured, model(before), model(after), FLOOR_MM, T_moved=T_moved)


def test_the_reduction_has_the_interval_of_a_paired_t_test():
    measured, models, (before, after) = made()
    found = compared(measured, *models)
    by_pose = [each.reshape(POSES, -1).mean(axis=1) for each in (before, after)]
    expected = ttest_rel(*by_pose).confidence_interval(0.95)
    assert found.reduction.poses == POSES
    assert found.reduction.mean_mm == pytest.approx((before - after).mean())
    assert found.reduction.interval95_mm == pytest.approx((expected.low, expected.high))


def test_errors_are_those_of_each_model_over_all_and_by_load():
    measured, models, (before, after) = made()
    found = compared(measured, *models)
    for accuracy, off_mm in ((found.before, before), (found.after, after)):
        assert accuracy.mean_mm == pytest.approx(off_mm.mean())
        assert accuracy.peak_mm == pytest.approx(off_mm.max())
        assert accuracy.rms_mm == pytest.approx(np.sqrt((off_mm**2).mean()))
    by_load = found.record().per_load
    assert set(by_load) == {f"{load:g}N" for load in LOADS_N}
    for load in LOADS_N:
        rows, there = measured.states.load_N == load, by_load[f"{load:g}N"]
        assert there.before.mean_mm == pytest.approx(before[rows].mean())
        assert there.after.mean_mm == pytest.approx(after[rows].mean())
        (low_mm, high_mm), mean_mm = there.reduction.interval95_mm, there.reduction.mean_mm
        assert mean_mm == pytest.approx((before - after)[rows].mean())
        assert low_mm < mean_mm < high_mm


def test_loads_of_one_name_are_one():
    measured, models, _ = made(loads_N=(44.0, 44.00001))
    (of_load,) = compared(measured, *models).record().per_load.values()
    assert of_load.before == compared(measured, *models).before


def test_loads_of_a_pose_are_no_further_poses():
    measured, models, _ = made()
    twice = np.repeat(np.arange(len(measured)), 2)
    again = compared(measured.take(twice), *(T[twice] for T in models))
    once = compared(measured, *models)
    assert again.reduction.interval95_mm == pytest.approx(once.reduction.interval95_mm)


def test_one_pose_has_no_interval():
    measured, models, (before, after) = made(poses=1)
    found = compared(measured, *models).reduction
    assert found.interval95_mm == (found.mean_mm, found.mean_mm)
    assert found.mean_mm == pytest.approx((before - after).mean())
    assert found.poses == 1


def test_motion_that_no_model_holds_is_in_no_number_but_its_own():
    measured, models, off_mm = made()
    moved = np.tile(np.eye(4), (len(measured), 1, 1))
    moved[:, 1, 3] = 0.5e-3
    plain, found = compared(measured, *models), compared(measured, *models, T_moved=moved)
    assert (found.before, found.after) == (plain.before, plain.after)
    still = found.without_motion
    for left, at_mm in zip((still.found_before, still.found_after), off_mm, strict=True):
        np.testing.assert_allclose(left.distance_mm, np.hypot(at_mm, 0.5))
    assert still.after.mean_mm == pytest.approx(np.hypot(off_mm[1], 0.5).mean())
    assert plain.without_motion is None
    suspected = np.arange(len(measured)) < 6
    rest = trusted(found, suspected)
    assert len(rest.without_motion.found_before.distance_mm) == len(measured) - 6
    fallen = fallen_back(found, suspected)
    np.testing.assert_allclose(fallen.found_after.distance_mm[:6], off_mm[0][:6])
    assert fallen.without_motion is found.without_motion
    with_rivals = replace(plain, with_rivals=plain.found_after)
    assert with_rivals.with_nuisances_of(found).with_rivals is plain.found_after
    assert with_rivals.with_nuisances_of(found).without_motion is found.without_motion
    assert len(trusted(with_rivals, suspected).with_rivals.distance_mm) == len(measured) - 6


def test_noise_of_a_mean_has_the_root_mean_square_of_vectors_as_long():
    measured, models, _ = made()
    found = compared(measured, *models)
    vectors = np.random.default_rng(0).standard_normal((200_000, 3))
    lengths = np.linalg.norm(vectors, axis=1)
    ratio = np.sqrt(np.mean(lengths**2)) / lengths.mean()
    assert found.noise_rms_mm == pytest.approx(FLOOR_MM * ratio, rel=3e-3)
