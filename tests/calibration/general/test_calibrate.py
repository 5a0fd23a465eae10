"""The general model: how many unknowns, which, how well."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calibrated import general
from made_up_model import case_of
from pa10cal.arm.statics import Payload
from pa10cal.calibration.general.as_model import fitted
from pa10cal.calibration.general.case import suspected_outliers
from pa10cal.calibration.options import GeneralOptions
from pa10cal.errors import CalibrationError, TooFewPosesError
from pa10cal.files.arms import load_arm
from pa10cal.fit.uncertain_weights import with_assumed_weights

KINDS = ("pose", "point", "points", "distance")
SIX_AXES = ("pa10_6ce", "ur10", "irb120")
PAYLOAD = Payload(0.0, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -9.81]))


@pytest.fixture(scope="module")
def calibrated(see):
    return cache(lambda robot, kind: general(robot, see(robot, kind)))


# Four parameters a turning joint, two a sliding one, and six for the frames are complete and
# minimal (Everett, Driels and Mooring, 1987); a target of its own needs no orientation, a distance
# none of the base's either.
@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(
    ("robot", "kind", "unknowns"),
    [
        *((robot, "pose", 30) for robot in SIX_AXES),
        *((robot, "point", 27) for robot in SIX_AXES),
        *((robot, "points", 33) for robot in SIX_AXES),
        *((robot, "distance", 24) for robot in SIX_AXES),
        ("iiwa14", "pose", 34),
        ("gx4_351s", "pose", 20),
    ],
)
def test_as_many_unknowns_as_arm_and_instrument_can_tell(calibrated, robot, kind, unknowns):
    found = calibrated(robot, kind)
    assert len(found.problem.parameters) == unknowns
    assert found.fit.identifiability.rank == unknowns


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("robot", ["pa10_6ce", "ur10", "iiwa14", "gx4_351s"])
def test_exact_data_are_explained_to_rounding(calibrated, robot, kind):
    found = calibrated(robot, kind)
    assert found.fit.converged
    assert np.abs(found.fit.residual).max() < 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_other_poses_are_predicted_as_well(calibrated, see, kind):
    model = fitted(calibrated("ur10", kind))
    assert model.deviations(see("ur10", kind, count=40)).distance_mm.max() < 1e-5


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_agree_with_differences(calibrated, kind):
    found = calibrated("ur10", kind)
    problem, x = found.problem, found.fit.x
    jacobian = problem.rows(x).jacobian
    for k, scale in enumerate(problem.scale):
        step = np.zeros(len(x))
        step[k] = 1e-3 * scale
        ahead, behind = (problem.rows(x + sign * step).residual for sign in (1.0, -1.0))
        difference = (ahead - behind) / (2e-3 * scale)
        assert jacobian[:, :, k] == pytest.approx(difference, abs=2e-8)


def test_what_is_left_out_says_what_others_say(calibrated):
    found = calibrated("ur10", "pose")
    names = {each.name for each in found.redundant}
    assert names == {
        "delta_a_6", "delta_alpha_6", "delta_d_1", "delta_d_6", "delta_theta_1", "delta_theta_6",
    }  # fmt: skip
    (first,) = (each for each in found.redundant if each.name == "delta_theta_1")
    assert first.replaced_by == {"base_rz": pytest.approx(1.0)}


def test_a_wrong_pose_is_listed_and_does_no_harm(see):
    observations = see("ur10", "point", count=120, noise_m=2e-5)
    good = general("ur10", observations)
    assert suspected_outliers(good.problem, good.fit) == ()
    p_instr_m = observations.measured.p_instr_m.copy()
    p_instr_m[17, 0, 1] += 3e-3
    spoilt = observations.with_measured(p_instr_m=p_instr_m)
    found = general("ur10", spoilt)
    (wrong,) = suspected_outliers(found.problem, found.fit)
    assert wrong.pose == "P0017"
    assert "mm" in wrong.why
    assert 0.0 < wrong.weight < 0.1
    plain = general("ur10", spoilt, general=GeneralOptions(robust=False))
    std = np.sqrt(np.diag(good.fit.covariance))
    # The base's motions start from elsewhere.
    arms = np.array([not p.name.startswith("base") for p in good.problem.parameters])
    robust, other = (np.abs((each.fit.x - good.fit.x) / std)[arms].max() for each in (found, plain))
    assert robust < 1.0
    assert other > 3.0


def test_scatter_beyond_the_stated_uncertainty_is_found(see):
    observations = see("ur10", "point", count=300, noise_m=1e-4)
    bold = observations.with_measured(cov_m2=observations.measured.cov_m2 / 100.0)
    assert general("ur10", bold).fit.scatter["position"] == pytest.approx(1e-4, rel=0.1)


@pytest.mark.parametrize(
    ("robot", "kind", "count", "payload", "springs", "says"),
    [
        ("irb120", "pose", 60, None, (2,), "torques are not known"),
        ("ur10", "pose", 60, PAYLOAD, (1, 2), "joint 1 is unloaded in all poses"),
        ("ur10", "point", 8, None, "auto", "fewer equations"),
    ],
)
def test_what_cannot_be_identified_is_refused(see, robot, kind, count, payload, springs, says):
    seen = see(robot, kind, count=count)
    with pytest.raises(CalibrationError, match=says):
        general(robot, seen, payload, general=GeneralOptions(springs=springs))


def test_weights_that_nobody_stated_need_no_equations(see):
    arm = with_assumed_weights(replace(load_arm("irb120"), mass_kg=None, com_m=None))
    found = general(arm, see("irb120", "point", count=9), PAYLOAD)
    assert found.problem.readings == 27
    assert found.fit.converged
    with pytest.raises(TooFewPosesError, match=r"24 readings, 27 unknowns.*at least 9 poses"):
        general(arm, see("irb120", "point", count=8), PAYLOAD)


def test_joints_are_rigid_where_poses_are_too_few_for_springs_alone(see):
    few = see("ur10", "point", count=9)
    found = general("ur10", few, PAYLOAD)
    assert found.springs == ()
    assert set(found.held_rigid) >= {2, 3}
    with pytest.raises(TooFewPosesError, match="27 readings, 29 unknowns"):
        general("ur10", few, PAYLOAD, general=GeneralOptions(springs=(2, 3)))
    assert general("ur10", see("ur10", "point", count=20), PAYLOAD).held_rigid == ()


def test_torques_of_the_masses_stand_for_logged_ones(see):
    found = general("ur10", see("ur10", "pose"), PAYLOAD)
    assert found.torques_from == "masses"
    assert set(found.springs) >= {2, 3}
    assert found.fit.at_bound.any()  # the arm that was seen is rigid


def test_nothing_seen_gives_no_row(see):
    observations = see("ur10", "points")
    found = observations.measured.compare(np.tile(np.eye(4), (60, 1, 1)), np.zeros(9))
    assert np.all(found.residual[::7, 3:6] == 0.0)
    assert np.all(found.by_end[::7, 3:6] == 0.0)


def test_axes_as_parallel_as_designed_are_left_so(see):
    found = general("ur10", see("ur10", "point", count=100, noise_m=5e-5))
    assert found.settled == {}
    assert len(found.fit.x) == 27
    found = general("ur10", see("ur10", "point", count=100, noise_m=5e-5, tilted=False))
    assert list(found.settled) == ["delta_beta_2", "delta_beta_3"]
    assert all(1e-6 < each.std < 1e-4 for each in found.settled.values())
    assert len(found.fit.x) == found.fit.identifiability.rank == 25


def test_an_unknown_beside_tilts_is_no_surer_than_in_the_fit(see):
    """A spring that ended at its bound while tilts were fitted has an uncertainty without them."""
    load = replace(PAYLOAD, mass_kg=2.0, com_m=np.array([0.0, 0.0, 0.1]))
    seen = see("ur10", "point", count=14, noise_m=1e-4, seed=2, tilted=False)
    found = general("ur10", seen, load)
    assert found.settled
    alone, beside = (np.diag(each) for each in (found.fit.covariance, found.covariance_of_each))
    assert np.all(beside >= alone)
    np.testing.assert_array_equal(beside == 0.0, found.fit.at_bound)
    # Nor is it so unsure as if nothing were known of usual departures, which the fit knows.
    assert np.sqrt(beside / np.where(found.fit.at_bound, 1.0, alone)).max() < 1.5


def test_readings_of_another_arm_are_refused(see):
    arm, observations = load_arm("ur10"), see("ur10", "point", count=80, noise_m=5e-5)
    q_rad = observations.states.q_rad.copy()
    q_rad[:, 2] *= -1.0  # a sign turned round
    wrong = replace(observations, states=replace(observations.states, q_rad=q_rad))
    with pytest.raises(CalibrationError, match="does not fit the readings"):
        case_of(arm, wrong)


def test_an_arm_is_refused_beside_an_instrument_worse_than_stated_with_both_causes(see):
    arm, observations = load_arm("ur10"), see("ur10", "point", count=80, noise_m=5e-5)
    measured = observations.measured
    noise_m = 0.04 * np.random.default_rng(5).standard_normal(measured.p_instr_m.shape)
    noisy = replace(measured, p_instr_m=measured.p_instr_m + noise_m)
    with pytest.raises(CalibrationError, match=r"does not fit .*if the instrument errs"):
        case_of(arm, replace(observations, measured=noisy))


def test_errors_that_last_make_the_base_less_certain_and_hardly_the_arm(see):
    poses = see("irb120", "points", count=150, tilted=False)
    rng, lasting = np.random.default_rng(3), np.zeros_like(poses.measured.p_instr_m)
    for k in range(1, len(poses)):
        lasting[k] = 0.97 * lasting[k - 1] + 5e-6 * rng.standard_normal(lasting[k].shape)
    p_instr_m = poses.measured.p_instr_m + lasting
    noisy = replace(poses, measured=replace(poses.measured, p_instr_m=p_instr_m))
    mixed = noisy.with_states(replace(noisy.states, time_s=rng.permutation(noisy.states.time_s)))
    unknown = noisy.with_states(replace(noisy.states, timed=np.zeros(len(noisy), dtype=bool)))
    found, of_mixed, untimed = (general("irb120", each) for each in (noisy, mixed, unknown))
    assert of_mixed.alike is None
    assert untimed.alike is None
    assert 20.0 < found.alike.rows_for_one < 150.0
    roles = found.problem.roles
    times = np.sqrt(np.diag(found.fit.covariance) / np.diag(of_mixed.fit.covariance))
    base = [k for k, name in enumerate(roles) if name == "base"]
    assert times[base[:3]].min() > 3.0
    links = found.problem.having("link")
    assert np.median(times[links]) < 2.0
    assert "poses tell as much as one" in str(found.alike)
