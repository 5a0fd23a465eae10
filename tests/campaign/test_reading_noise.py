"""Noise of readings along the axes of their instrument, as they show it."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_poses import states_of
from pa10cal.arm.chain import Chain
from pa10cal.arrays import homogeneous
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.reading_noise import (
    Uncertainty,
    Unstated,
    distances,
    with_noise_shown,
)
from pa10cal.files.arms import load_arm
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import Points
from pa10cal.observe.pose import Pose
from pa10cal.observe.quantities import RawColumns, StatedByCampaign

ARM = load_arm("ur10")
CHAIN = Chain.of(ARM)
STATES = states_of(ARM, seed=11, poses=120)
#: Of a camera, about: across and in depth [m], tilts and the turn about its line of sight [rad].
CAMERA = np.array([2e-4, 2e-4, 2e-3, 2e-3, 2e-3, 4e-4])
ALIKE = np.array([2e-4, 2e-4, 2e-4, 2e-4, 2e-4, 2e-4])
BOTH = Unstated(places=True, turns=True)


def rms(sizes):
    return float(np.sqrt(np.mean(sizes**2)))


def truth(away_m=2.5):
    """Return exact poses of a tool in the frame of an instrument."""
    T_instr_base = homogeneous(
        Rotation.from_rotvec([0.3, 2.0, 0.4]).as_matrix(), np.array([0.2, 0.1, away_m])
    )
    T_ee_tool = homogeneous(
        Rotation.from_rotvec([0.2, -0.1, 1.0]).as_matrix(), np.array([0.05, 0.02, 0.1])
    )
    return T_instr_base @ CHAIN.forward(STATES.q_rad) @ T_ee_tool


def off(T, sigma, seed=1):
    """Return poses with errors along the axes of the frame in which they were measured."""
    errors = np.random.default_rng(seed).standard_normal((len(T), 6)) * sigma
    turn = Rotation.from_rotvec(errors[:, 3:]).as_matrix()
    return homogeneous(turn @ T[:, :3, :3], T[:, :3, 3] + errors[:, :3])


def poses(T, u, *, inverse=False):
    """Return readings of poses as the raw columns of a file give them."""
    quaternion = Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True)
    values = np.concatenate([1e3 * T[:, :3, 3], quaternion], axis=1)
    stated = StatedByCampaign(u, {}, inverse_poses=inverse)
    columns = RawColumns((("x_mm", "y_mm", "z_mm"),), ("qw", "qx", "qy", "qz"))
    return Pose.from_raw(columns, values, np.full(values.shape, np.nan), stated)


def readings_of(measured, states=STATES):
    return Observations.single(np.array([f"p{k}" for k in range(len(states))]), states, measured)


def shown(measured, u, unstated=BOTH, by_joints=0.0):
    every = readings_of(measured)
    b = every.measured.stated_covariance.shape[1]
    by_joints = np.broadcast_to(by_joints * np.eye(b), (len(every), b, b))
    return with_noise_shown(every, unstated, Uncertainty(u, u / 0.1), CHAIN, None, by_joints)


def sizes_of(measured):
    return np.sqrt(np.diagonal(measured.stated_covariance, axis1=1, axis2=2)).mean(axis=0)


def test_a_camera_is_less_certain_in_depth_and_in_two_of_its_turns():
    found = shown(poses(off(truth(), CAMERA), rms(CAMERA[:3])), rms(CAMERA[:3]))
    sizes = sizes_of(found.readings.measured)
    np.testing.assert_allclose(sizes, CAMERA, rtol=0.3)
    assert rms(sizes[:3]) == pytest.approx(rms(CAMERA[:3]))  # as stated, on the whole
    assert [note.split()[0] for note in found.notes] == ["positions", "orientations,"]


def test_targets_of_a_camera_are_less_certain_in_depth():
    T = truth()
    places_m = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.05]])
    p_m = np.einsum("pij,bj->pbi", T[:, :3, :3], places_m) + T[:, None, :3, 3]
    p_m += np.random.default_rng(2).standard_normal(p_m.shape) * CAMERA[:3]
    u = rms(CAMERA[:3])
    cov_m2 = np.tile(u**2 * np.eye(3), (*p_m.shape[:2], 1, 1))
    p_m[::7, 1] = cov_m2[::7, 1] = np.nan  # not seen
    found = shown(Points(("A", "B", "C"), p_m, cov_m2, None), u, Unstated(places=True, turns=False))
    sizes = np.sqrt(np.diagonal(found.readings.measured.cov_m2[1], axis1=1, axis2=2))
    np.testing.assert_allclose(sizes, np.tile(CAMERA[:3], (3, 1)), rtol=0.3)
    assert np.isnan(found.readings.measured.cov_m2[0, 1]).all()


@pytest.mark.parametrize(("power", "words"), [(1, "with the distance"), (2, "with its square")])
def test_noise_grows_with_the_distance(power, words):
    T = truth(away_m=1.4)
    away = np.linalg.norm(T[:, :3, 3], axis=1)
    growth = (away / rms(away**power) ** (1 / power)) ** power
    noise = ALIKE * np.concatenate([np.tile(growth[:, None], 3), np.ones((len(T), 3))], axis=1)
    found = shown(poses(off(T, noise, seed=3), 2e-4), 2e-4, Unstated(places=True, turns=False))
    sizes = np.sqrt(np.diagonal(found.readings.measured.cov, axis1=1, axis2=2))[:, 0]
    np.testing.assert_allclose(sizes / sizes.mean(), growth / growth.mean(), rtol=2e-3)
    assert words in found.notes[0]


def test_a_target_at_the_origin_of_the_frame_is_not_infinitely_certain():
    T = truth(away_m=1.4)
    T[0, :3, 3] = 0.0
    away_m = distances(poses(T, 2e-4))
    assert away_m[0] == pytest.approx(0.1 * np.median(away_m))


def test_axes_that_hardly_differ_are_as_stated():
    measured = poses(off(truth(), ALIKE), 2e-4)
    found = shown(measured, 2e-4, Unstated(places=True, turns=False))
    assert found.readings.measured is measured
    assert found.notes == []


def test_what_is_far_beyond_the_statement_may_be_the_arms_and_is_told_alone():
    found = shown(poses(off(truth(), CAMERA), 2e-4), 2e-4, Unstated(places=True, turns=False))
    np.testing.assert_allclose(sizes_of(found.readings.measured)[:3], 2e-4)
    (note,) = found.notes
    assert "more than stated" in note
    assert "of x, y and z of every target" in note


def test_orientations_of_unstated_uncertainty_are_as_good_as_they_scatter():
    measured = poses(off(truth(), ALIKE), 2e-4)  # 2 mrad are assumed
    found = shown(measured, 2e-4)
    np.testing.assert_allclose(sizes_of(found.readings.measured), ALIKE, rtol=0.2)
    assert found.notes == [found.notes[0]]
    assert "as they scatter, 0.2 mrad" in found.notes[0]


def test_orientations_that_scatter_more_than_was_assumed_keep_that():
    worse = np.array([2e-4, 2e-4, 2e-4, 8e-3, 8e-3, 8e-3])
    measured = poses(off(truth(), worse), 2e-4)
    assert shown(measured, 2e-4).readings.measured is measured


def test_what_is_stated_stays():
    measured = poses(off(truth(), CAMERA), 1e-3)
    found = shown(measured, 1e-3, Unstated(places=False, turns=False))
    assert found.readings.measured is measured


def test_exact_readings_are_not_infinitely_certain():
    found = shown(poses(truth(), 1e-4), 1e-4)
    sizes = sizes_of(found.readings.measured)
    np.testing.assert_allclose(sizes, [1e-4] * 3 + [1e-5] * 3)


def test_few_poses_and_those_of_another_arm_show_nothing():
    T = off(truth(), CAMERA)
    few = readings_of(poses(T, 1e-3)).take(np.arange(20))
    stated = Uncertainty(1e-3, 1e-2)
    nothing = np.zeros((len(T), 6, 6))
    assert with_noise_shown(few, BOTH, stated, CHAIN, None, nothing).readings is few
    rng = np.random.default_rng(4)
    elsewhere = readings_of(poses(T[rng.permutation(len(T))], 1e-5))
    found = with_noise_shown(elsewhere, BOTH, Uncertainty(1e-5, 1e-4), CHAIN, None, nothing)
    assert found.readings is elsewhere


def test_errors_of_joints_are_not_the_instruments():
    joints = np.full(6, 4e-4)
    T = off(off(truth(), ALIKE), joints, seed=6)
    found = shown(poses(T, 2e-4), 2e-4, by_joints=1.6e-7)
    sizes = sizes_of(found.readings.measured)
    np.testing.assert_allclose(sizes[3:], ALIKE[3:], rtol=0.35)


# A camera on the tool: the pose of what it sees is measured, and inverted.


def test_the_covariance_of_inverse_poses_is_that_of_errors_before_inverting():
    T_target_instr = np.linalg.inv(truth()[:1])
    draws = np.linalg.inv(off(np.tile(T_target_instr, (40_000, 1, 1)), CAMERA))
    exact = np.linalg.inv(T_target_instr)
    left = draws[:, :3, :3] @ exact[:, :3, :3].swapaxes(1, 2)
    errors = np.concatenate(
        [draws[:, :3, 3] - exact[:, :3, 3], Rotation.from_matrix(left).as_rotvec()], axis=1
    )
    measured = poses(exact, 1e-3, inverse=True)
    measured = measured.with_noise_along_axes(CAMERA[None, :3], CAMERA[3:])
    sizes = np.sqrt(np.diagonal(measured.cov[0]))
    np.testing.assert_allclose(
        np.cov(errors.T) / np.outer(sizes, sizes),
        measured.cov[0] / np.outer(sizes, sizes),
        atol=0.03,
    )


def test_stated_uncertainties_of_inverse_poses_are_along_the_targets_axes():
    T = truth()
    quaternion = Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True)
    values = np.concatenate([1e3 * T[:, :3, 3], quaternion], axis=1)
    u = np.tile([0.2, 0.3, 2.0, 1e-4, 1e-4, 1e-4, 1e-4], (len(T), 1))
    columns = RawColumns((("x_mm", "y_mm", "z_mm"),), ("qw", "qx", "qy", "qz"))
    stated = StatedByCampaign(1e-3, {}, inverse_poses=True)
    measured = Pose.from_raw(columns, values, u, stated)
    to_axes = measured.along_noise_axes()
    along = to_axes @ measured.cov @ to_axes.swapaxes(1, 2)
    np.testing.assert_allclose(
        along[:, :3, :3], np.tile(np.diag([4e-8, 9e-8, 4e-6]), (len(T), 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(along[:, :3, 3:], 0.0, atol=1e-12)


def test_a_camera_on_the_tool_shows_its_noise_along_its_own_axes():
    T = np.linalg.inv(off(np.linalg.inv(truth()), CAMERA))
    u = rms(CAMERA[:3])
    found = shown(poses(T, u, inverse=True), u)
    measured = found.readings.measured
    to_axes = measured.along_noise_axes()
    along = to_axes @ measured.cov @ to_axes.swapaxes(1, 2)
    sizes = np.sqrt(np.diagonal(along, axis1=1, axis2=2))
    np.testing.assert_allclose(sizes, np.tile(CAMERA, (len(T), 1)), rtol=0.4)
    assert "of the target (rotation.inverse: pose)" in found.notes[0]
    assert measured.inverse


def test_the_axes_of_a_camera_stay_its_own_when_poses_are_turned():
    measured = poses(truth(), 1e-3, inverse=True)
    measured = measured.with_noise_along_axes(CAMERA[None, :3], CAMERA[3:])
    turned = measured.turned(Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix())
    to_axes = turned.along_noise_axes()
    along = to_axes @ turned.cov @ to_axes.swapaxes(1, 2)
    np.testing.assert_allclose(along, np.tile(np.diag(CAMERA**2), (len(along), 1, 1)), atol=1e-12)


@pytest.mark.parametrize("inverse", [False, True])
def test_what_repeats_share_their_mean_has_too(inverse):
    stated = StatedByCampaign(1e-4, {}, inverse_poses=inverse)
    measured = poses(truth()[[0, 0, 0, 0]], 1e-4, inverse=inverse)
    shared = np.tile(np.diag([1e-8] * 6), (4, 1, 1))
    uncertain = measured.with_end_uncertain(shared, measured.places_m)
    of_joints = uncertain.cov[0] - measured.cov[0]
    (mean,) = uncertain.averaged(np.zeros(4, dtype=int)).cov
    np.testing.assert_allclose(mean, measured.cov[0] / 4.0 + of_joints, rtol=1e-9, atol=1e-20)
    at_rest = uncertain.averaged_at_rest(np.zeros(4, dtype=int))
    np.testing.assert_allclose(at_rest.cov[0], uncertain.cov[0], rtol=1e-9, atol=1e-20)
    again = Pose.from_columns(uncertain.to_columns(), stated)
    np.testing.assert_allclose(again.cov, uncertain.cov, rtol=1e-9, atol=1e-20)
    np.testing.assert_allclose(again.motion_cov, shared, rtol=1e-9)
    assert again.inverse == inverse


def test_what_a_campaign_shows_is_told_once():
    example = Path(__file__).parents[2] / "examples" / "ur10-pose"
    notes = read_campaign(example).notes
    assert [note.split()[0] for note in notes].count("orientations,") == 1
    assert len(notes) == len(set(notes))
