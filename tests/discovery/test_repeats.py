"""The scatter of repeats is laid to its sources, and nothing else enters it."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import measured_poses
from pa10cal.arm.statics import PoseStates
from pa10cal.discovery.repeats import noise_of_repeats, repeated, same_circumstances
from pa10cal.discovery.rules import NOISE
from pa10cal.errors import DiscoveryError

POSES, LOADS_N, REPEATS = 40, (0.0, 44.0), 8
JOINT_RAD, INSTRUMENT, TORQUE_NM = np.array([8e-6, 5e-6]), 1.5, np.array([0.05, 0.2])


def readings_of(poses=POSES, repeats=REPEATS, seed=1):
    """Return readings one right after the other, deviations that are noise alone, and screws."""
    rng = np.random.default_rng(seed)
    axes = np.meshgrid(np.arange(poses), LOADS_N, np.arange(repeats), indexing="ij")
    pose, load_N, repeat = (axis.ravel() for axis in axes)
    count = len(pose)
    side = np.where(repeat < (repeats + 1) // 2, 1.0, -1.0)
    root = rng.normal(0.0, 2e-6, (count, 6, 6))
    cov_ee = root @ root.transpose(0, 2, 1) + 1e-12 * np.eye(6)
    screws = rng.uniform(-0.8, 0.8, (poses, 6, 2))[pose]
    states = PoseStates(
        q_rad=np.zeros((count, 2)),
        tau_Nm=TORQUE_NM * rng.standard_normal((count, 2)) + pose[:, None],
        arrival=np.stack([side, -side], axis=1),
        load_N=load_N,
        temperature_C=np.full(count, np.nan),
        time_s=np.arange(count, dtype=float),
    )
    deviation = np.einsum("pij,pj->pi", screws, JOINT_RAD * rng.standard_normal((count, 2)))
    deviation += INSTRUMENT * np.einsum(
        "pij,pj->pi", np.linalg.cholesky(cov_ee), rng.standard_normal((count, 6))
    )
    readings = measured_poses(
        pose=np.array([f"P{k:02d}" for k in pose]),
        states=states,
        T_instr_ee=np.tile(np.eye(4), (count, 1, 1)),
        cov=cov_ee,
    )
    return readings, deviation, screws


@pytest.fixture(scope="module")
def made():
    return readings_of()


def test_scatter_is_laid_to_joints_and_instrument(made):
    readings, deviation, screws = made
    found = noise_of_repeats(readings, deviation, screws)
    np.testing.assert_allclose(found.joint_rad, JOINT_RAD, rtol=0.1)
    assert found.instrument == pytest.approx(INSTRUMENT, rel=0.05)
    np.testing.assert_allclose(found.torque_Nm, TORQUE_NM, rtol=0.1)
    # Two directions a pose and load, of four readings each.
    assert found.differences == POSES * len(LOADS_N) * 2 * 3
    expected = np.einsum("pik,k,pjk->pij", screws, JOINT_RAD**2, screws)
    expected += INSTRUMENT**2 * readings.measured.cov
    traces = np.trace(found.cov, axis1=1, axis2=2), np.trace(expected, axis1=1, axis2=2)
    np.testing.assert_allclose(*traces, rtol=0.1)


def test_what_poses_loads_and_directions_do_is_no_noise(made):
    readings, deviation, screws = made
    _, place = np.unique(same_circumstances(readings), return_inverse=True)
    offsets = np.random.default_rng(2).normal(0.0, 1e-3, (place.max() + 1, 6))[place]
    there = noise_of_repeats(readings, deviation + offsets, screws)
    alone = noise_of_repeats(readings, deviation, screws)
    np.testing.assert_allclose(there.joint_rad, alone.joint_rad, rtol=1e-6)
    assert there.instrument == pytest.approx(alone.instrument, rel=1e-6)


def test_a_slow_drift_is_no_noise(made):
    readings, deviation, screws = made
    # A hundred times the noise over the whole campaign: as much as the noise within 6 readings.
    drift = 3e-4 * np.linspace(0.0, 1.0, len(readings))[:, None] * np.ones(6)
    found = noise_of_repeats(readings, deviation + drift, screws)
    np.testing.assert_allclose(found.joint_rad, JOINT_RAD, rtol=0.1)
    assert found.instrument == pytest.approx(INSTRUMENT, rel=0.05)


def test_the_order_of_the_rows_does_not_matter(made):
    readings, deviation, screws = made
    order = np.random.default_rng(3).permutation(len(readings))
    mixed = noise_of_repeats(readings.take(order), deviation[order], screws[order])
    ordered = noise_of_repeats(readings, deviation, screws)
    np.testing.assert_allclose(mixed.cov, ordered.cov[order], rtol=1e-9)
    np.testing.assert_allclose(mixed.torque_Nm, ordered.torque_Nm)


def test_circumstances_are_pose_load_and_direction(made):
    readings = made[0]
    code = same_circumstances(readings)
    assert sorted(np.bincount(code)) == [4] * (POSES * len(LOADS_N) * 2)
    states = readings.states
    for values in (readings.pose, states.load_N, states.arrival[:, 0]):
        for number in range(0, code.max() + 1, 7):
            assert len(set(values[code == number])) == 1


def test_torques_that_were_not_logged_have_no_noise_to_tell(made):
    readings, deviation, screws = made
    states = replace(readings.states, tau_Nm=np.full_like(readings.states.tau_Nm, np.nan))
    found = noise_of_repeats(replace(readings, states=states), deviation, screws)
    assert np.isnan(found.torque_Nm).all()
    assert np.isfinite(found.cov).all()


def test_a_torque_that_is_missing_in_one_reading_leaves_the_noise_of_all(made):
    readings, deviation, screws = made
    tau_Nm = readings.states.tau_Nm.copy()
    tau_Nm[5, 1] = np.nan
    missing = readings.with_states(replace(readings.states, tau_Nm=tau_Nm))
    found = noise_of_repeats(missing, deviation, screws)
    np.testing.assert_allclose(found.torque_Nm, TORQUE_NM, rtol=0.1)
    # A joint that always reads zero still counts as uncertain as the other.
    tau_Nm[:, 0] = 0.0
    quiet = readings.with_states(replace(readings.states, tau_Nm=tau_Nm))
    torque_Nm = noise_of_repeats(quiet, deviation, screws).torque_Nm
    assert torque_Nm[0] == torque_Nm[1] > 0.0


def test_a_target_that_one_of_two_readings_missed_does_not_stand_for_a_direction(made):
    readings, deviation, screws = readings_of(repeats=4)
    sides = np.random.default_rng(4).choice([-1.0, 1.0], (len(readings), 2))
    sides[:, 1] = np.arange(len(readings)) % 97  # no side comes twice: the direction is fitted
    shuffled = readings.with_states(replace(readings.states, arrival=sides))
    seen = np.ones(deviation.shape, dtype=bool)
    seen[1::4, 3:] = False

    class Partly(type(readings.measured)):
        components_seen = seen

    def partly(value):
        measured = Partly(**vars(readings.measured))
        hidden = np.where(seen, deviation, value)
        return noise_of_repeats(replace(shuffled, measured=measured), hidden, screws)

    np.testing.assert_allclose(partly(0.0).cov, partly(1.0).cov)


def test_readings_of_different_targets_are_no_repeats():
    """An instrument that aims at one target after the other sees another in each row."""
    readings, deviation, _ = readings_of(repeats=2)
    assert repeated(readings) == len(readings) // 2
    seen = np.ones(deviation.shape, dtype=bool)
    seen[::2, :3] = False
    seen[1::2, 3:] = False

    class Partly(type(readings.measured)):
        components_seen = seen

    measured = Partly(**vars(readings.measured))
    assert repeated(replace(readings, measured=measured)) == 0


def test_targets_that_are_seen_in_turn_repeat_those_seen_before():
    readings, deviation, screws = readings_of()  # four readings a side, by turns of two targets
    seen = np.ones(deviation.shape, dtype=bool)
    seen[::2, :3] = False
    seen[1::2, 3:] = False

    class Partly(type(readings.measured)):
        components_seen = seen

    in_turn = replace(readings, measured=Partly(**vars(readings.measured)))
    assert repeated(in_turn) == len(readings) // 2
    found = noise_of_repeats(in_turn, np.where(seen, deviation, np.nan), screws)
    assert found.differences == len(readings) // 2
    np.testing.assert_allclose(found.joint_rad, JOINT_RAD, rtol=0.2)
    assert found.origin == f"{found.differences} {found.pairs_are}"
    assert "mrad" not in found.origin


def test_too_few_repeats_are_refused():
    readings, deviation, screws = readings_of(poses=NOISE.least_differences // 2, repeats=3)
    enough = noise_of_repeats(readings, deviation, screws)
    assert enough.differences == NOISE.least_differences
    fewer = slice(1, None)  # leaves one pair without its first reading
    with pytest.raises(DiscoveryError, match="too few repeats") as refused:
        noise_of_repeats(readings.take(fewer), deviation[fewer], screws[fewer])
    assert refused.value.value.startswith(f"{NOISE.least_differences - 1} pairs")
    assert refused.value.allowed == f"at least {NOISE.least_differences}"
    assert refused.value.remedy == "measure poses repeatedly"


def test_where_no_side_comes_twice_repeats_from_any_side_are_compared():
    readings, deviation, screws = readings_of(repeats=4)
    sides = np.random.default_rng(4).choice([-1.0, 1.0], (len(readings), 2))
    sides[:, 1] = np.arange(len(readings)) % 97  # hardly ever the same
    shuffled = readings.with_states(replace(readings.states, arrival=sides))
    steady = noise_of_repeats(readings, deviation, screws)
    lost_rad = 40.0 * JOINT_RAD * np.array([1.0, 0.02])
    lost = np.einsum("pij,pj->pi", screws, lost_rad * sides)
    found = noise_of_repeats(shuffled, deviation + lost, screws)
    assert found.differences > 2 * NOISE.least_differences
    np.testing.assert_allclose(found.joint_rad, steady.joint_rad, rtol=0.3)
    assert found.instrument == pytest.approx(steady.instrument, rel=0.2)
