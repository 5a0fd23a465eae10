from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from made_up_poses import at_rest, measured_poses
from pa10cal.calibration.accuracy import summarise
from pa10cal.calibration.load_case import load_cases, rows_of_load
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.two_level_fit import calibrate, random_starts, solve, tolerance_rows
from pa10cal.calibration.two_level_problem import TwoLevel, rows_of
from pa10cal.errors import CalibrationError
from pa10cal.fit.problem import identify, unidentified_directions
from pa10cal.frame.point_fits import fit_rigid_weighted, pose_by_source
from pa10cal.observe.observations import average_repeats
from pa10cal.options import Tolerances
from pa10cal.terms.joint_spring import baseline
from pa10cal.terms.model import Model
from pa10cal.terms.term import TermParameter

QUICK, ONE_START = (CalibrationOptions(starts=count) for count in (2, 1))


@pytest.fixture(scope="module")
def calibrated(model, observe):
    return calibrate(model, observe(noise=1.0), CalibrationOptions())


def known(calibration):
    names = [parameter.name for parameter in calibration.level.model.parameters]
    return np.array([name not in calibration.not_identifiable for name in names])


def scores_of(found, truth):
    """How far identified parameters are from the truth, in standard uncertainties."""
    std = np.sqrt(np.diag(found.covariance[:-6, :-6]))
    return ((found.solution.x - truth) / std)[known(found)]


def test_recovers_the_truth_of_exact_poses(model, truth, observe):
    found = calibrate(model, observe(noise=0.0), QUICK)
    assert found.converged
    error = (found.solution.x - truth) / model.scale
    assert np.abs(error[known(found)]).max() < 1e-7


def test_rank_is_34_of_36_and_the_open_directions_have_names(calibrated):
    # contract: delta_theta_1 goes with base yaw, delta_d_1 with base height
    assert calibrated.identifiability.rank == 34
    assert len(calibrated.identifiability.singular_values) == 36
    assert calibrated.not_identifiable == {"delta_theta_1", "delta_d_1"}
    parameters = calibrated.level.one_level(calibrated.T_instr_base).parameters
    directions = unidentified_directions(calibrated.identifiability, parameters)
    pairs = set(map(frozenset, directions))
    assert pairs == {frozenset({"delta_theta_1", "base_rz"}), frozenset({"delta_d_1", "base_z"})}


def test_one_attitude_leaves_two_more_directions_open(model, observe, states, T_instr_base):
    # contract: tool orientation fixed gives rank 32
    chain = model.chain
    rng = np.random.default_rng(8)
    target = chain.forward(np.array([[0.3, 0.35, 1.4, 0.2, -0.5, 0.4]]))[0]
    q = []
    for _ in range(27):
        place = target[:3, 3] + rng.uniform(-0.15, 0.15, 3)

        def miss(joints, place=place):
            T = chain.forward(joints[None])[0]
            return np.r_[T[:3, 3] - place, (T[:3, :3] - target[:3, :3]).ravel()]

        q.append(least_squares(miss, [0.3, 0.35, 1.4, 0.2, -0.5, 0.4], xtol=1e-15).x)
    fixed = replace(states, q_rad=np.repeat(q, 3, axis=0))
    links = Model(chain, model.terms[:1])  # of the 36, the springs' 6 are told in any case
    for chosen, rank in ((states, 28), (fixed, 26)):
        exact = observe().with_states(chosen)
        observations = exact.with_measured(
            T_instr_target=T_instr_base @ chain.forward(chosen.q_rad)
        )
        level = TwoLevel(links, observations, np.arange(81)).one_level(T_instr_base)
        jacobian = level.rows(np.zeros(30)).jacobian.reshape(-1, 30)
        assert identify(jacobian, level.model.scale).rank == rank


def test_one_level_agrees_with_two_levels_over_all_poses(model, observe, T_instr_base):
    options = QUICK.model_copy(update={"inner_poses": "all"})
    two = calibrate(model, observe(noise=1.0), options)
    whole = two.level.one_level(T_instr_base)
    start = np.append(two.solution.x, np.zeros(6)) / whole.scale
    start += np.random.default_rng(0).normal(size=len(start))

    def residuals(z):
        rows = whole.rows(z * whole.scale).residual.ravel()
        return np.concatenate([rows, two.terms @ (z * whole.scale)[:-6]])

    def jacobian(z):
        rows = whole.rows(z * whole.scale).jacobian.reshape(-1, len(z))
        return np.vstack([rows, np.pad(two.terms, ((0, 0), (0, 6)))]) * whole.scale

    z = least_squares(residuals, start, jacobian, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    for _ in range(5):  # the last digits, which a cost does not show
        z = z - np.linalg.lstsq(jacobian(z), residuals(z), rcond=None)[0]
    x = (z * whole.scale)[:-6]
    difference = np.abs(x - two.solution.x) / np.maximum(np.abs(two.solution.x), model.scale)
    assert difference[known(two)].max() < 1e-8


def test_inner_subset_moves_the_answer_by_less_than_its_uncertainty(calibrated):
    level, x, rng = calibrated.level, calibrated.solution.x, np.random.default_rng(20080427)
    report, labels = level.model.report(x), np.unique(level.observations.pose)
    found = []
    for _ in range(5):
        poses = tuple(rng.choice(labels, 8, replace=False))
        other = replace(level, inner_rows=rows_of(level.observations, poses))
        terms = tolerance_rows(other, x, CalibrationOptions())
        found.append(other.model.report(solve(other, x, terms, 200).x).values)
    covariance = report.jacobian @ calibrated.covariance[:-6, :-6] @ report.jacobian.T
    mask = np.array([p.name not in calibrated.not_identifiable for p in report.parameters])
    std = np.std(found, axis=0, ddof=1)
    assert (std[mask] < 2 * np.sqrt(np.diag(covariance))[mask]).all()
    assert (std[mask] > 0).all()


@pytest.mark.slow
def test_intervals_hold_what_they_promise(model, truth, observe):
    found = [calibrate(model, observe(noise=1.0, seed=seed), ONE_START) for seed in range(40)]
    scores = [scores_of(each, truth) for each in found]
    inside = np.mean(np.abs(scores) < 1.96)
    assert 0.92 < inside < 0.98  # 40 x 28 correlated scores about 0.95
    assert 0.9 < np.std(scores) < 1.1


@pytest.mark.slow
def test_an_error_of_the_apparatus_is_in_the_intervals(model, truth, observe):
    """The same wrong ball places in all poses: the repeats cannot show it, the interval must.

    The balls' noise is the instrument's and larger along its z, so how a pose answers to a wrong
    place depends on the tool's orientation.
    """
    balls = np.array([[0.095, 0, 0.31], [-0.05, 0.08, 0.31], [-0.05, -0.08, 0.312]])
    T = observe(noise=0.1).measured.T_instr_target
    centres = balls @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
    covariances = np.tile(np.diag([1.0, 1.0, 4.0]) * 1e-10, (len(T), 3, 1, 1))
    u_m, scores = 2e-5, []
    for seed in range(30):
        wrong = balls + u_m * np.random.default_rng(seed).standard_normal((3, 3))
        T = fit_rigid_weighted(wrong, centres, covariances).T
        answers = pose_by_source(T, centres, covariances)
        measured = observe(noise=0.1, seed=seed)
        measured = measured.with_measured(T_instr_target=T, by_apparatus=answers)
        found = calibrate(model, measured, ONE_START, u_apparatus_m=u_m)
        scores.append(scores_of(found, truth))
    assert 0.8 < np.std(scores) < 1.2
    without = calibrate(model, measured, ONE_START).covariance[:-6, :-6]
    assert (np.diag(found.covariance[:-6, :-6] - without)[known(found)] > 0).all()


@pytest.mark.slow
def test_noise_of_the_torques_is_in_the_intervals(model, truth, states, T_instr_base):
    """Repeats of exact poses whose logged torques are noisy: only the readings can show it."""
    exact, scores = states.take(np.repeat(np.arange(81), 4)), []
    for seed in range(30):
        noise_Nm = np.random.default_rng(seed).normal(scale=0.2, size=(324, 6))
        readings = measured_poses(
            pose=np.repeat([f"P{k:02d}" for k in range(1, 28)], 12),
            states=replace(exact, tau_Nm=exact.tau_Nm + noise_Nm),
            T_instr_ee=T_instr_base @ model.predict(exact, truth),
            cov=np.zeros((324, 6, 6)),
        )
        found = calibrate(model, average_repeats(readings), ONE_START, readings)
        scores.append(scores_of(found, truth))
    assert 0.8 < np.std(scores) < 1.2


@pytest.mark.parametrize(
    ("acts_on", "mean_mm", "share"),
    [("residual", (0.02, 0.3), (0.8, 1.0)), ("cost", (1.0, np.inf), (0.0, 0.1))],
)
def test_epsilon_as_printed_pulls_towards_nominal(model, truth, observe, acts_on, mean_mm, share):
    """The two readings of epsilon = 1.6e-4 differ, and both bend what the data tell."""
    observations = observe(noise=0.0)
    options = QUICK.model_copy(update={"tolerance_terms": "all", "epsilon_acts_on": acts_on})
    found = calibrate(model, observations, options)
    left_mm = summarise(found.model(None).deviations(observations)).mean_mm
    departed, true = (np.linalg.norm((x / model.scale)[:24]) for x in (found.solution.x, truth))
    assert mean_mm[0] < left_mm < mean_mm[1]
    assert share[0] < departed / true < share[1]


def test_tolerance_terms_leave_identified_parameters_alone(model, observe):
    """A thousand times the weight changes nothing but what the data leave open."""
    observations = observe(noise=1.0)
    light = calibrate(model, observations, QUICK)
    heavy = calibrate(model, observations, QUICK.model_copy(update={"epsilon": 0.16}))
    assert np.abs((light.solution.x - heavy.solution.x) / model.scale).max() < 1e-6
    names = [parameter.name for parameter in model.parameters]
    for name in light.not_identifiable:
        assert abs(light.solution.x[names.index(name)]) < 1e-10


def test_linear_springs_fit_worse_and_have_no_cubic_part(pa10, observe):
    linear = baseline(pa10, (2, 3, 5), Tolerances(), cubic=False)
    found = calibrate(linear, observe(noise=0.0), QUICK)
    assert found.solution.cost > 1e-9  # the cubic spring leaves 1e-20 there
    reported = linear.report(found.solution.x)
    names = [parameter.name for parameter in reported.parameters]
    assert reported.values[names.index("K_cub_3")] == 0.0


def test_negative_stiffness_ends_at_the_bound(model, truth, observe, states, T_instr_base):
    """Data of a softening spring: K_cub is put on zero and said to be there."""
    names = [parameter.name for parameter in model.parameters]
    linear = truth.copy()
    linear[names.index("cubic_share_3")] = 0.0
    torque = states.tau_Nm[:, 2]
    softer = 4e-9 * torque**3  # on top of a linear spring, growing faster than the torque
    moved = replace(states, q_rad=states.q_rad - softer[:, None] * np.eye(6)[2])
    observations = observe().with_measured(
        T_instr_target=T_instr_base @ model.predict(moved, linear)
    )
    found = calibrate(model, observations, QUICK)
    held = [n for n, at_end in zip(names, found.solution.at_bound, strict=True) if at_end]
    assert "cubic_share_3" in held
    assert found.solution.x[names.index("cubic_share_3")] == 0.0


def test_the_shape_of_a_spring_that_does_not_yield_is_open_and_blurs_no_length(
    model, truth, observe
):
    """Its cubic share, free without bounds, made the zero of joint 2 uncertain by 0.7 mrad."""
    names = [parameter.name for parameter in model.parameters]
    windups = [names.index(f"windup_{joint}") for joint in (2, 3, 5)]
    rigid = truth.copy()
    rigid[windups] = 1e-7
    found = [calibrate(model, observe(1.0, seed, rigid), ONE_START) for seed in (1, 2)]
    for each in found:
        open_names = each.not_identifiable
        assert {f"cubic_share_{joint}" for joint in (2, 3, 5)} <= open_names
        assert open_names <= {name for name in names if name.startswith(("cubic", "windup"))} | {
            "delta_theta_1",
            "delta_d_1",
        }
        std = np.sqrt(np.diag(each.covariance))[names.index("delta_theta_2")]
        assert 1e-5 < std < 2e-4
    links = np.array([name.startswith("delta") for name in names])
    scores = np.concatenate([scores_of(each, rigid)[links[known(each)]] for each in found])
    assert np.abs(scores).max() < 4.0
    assert 0.7 < np.sqrt(np.mean(scores**2)) < 1.4


def test_reference_torque_does_not_change_the_answer(pa10, model, observe, calibrated):
    other = baseline(
        pa10, (2, 3, 5), Tolerances(), tau_ref_Nm=np.array([1.0, 90.0, 60.0, 1.0, 8.0, 1.0])
    )
    found = calibrate(other, observe(noise=1.0), QUICK)
    here, there = model.report(calibrated.solution.x), other.report(found.solution.x)
    free = [p.name not in calibrated.not_identifiable for p in here.parameters]
    np.testing.assert_allclose(there.values[free], here.values[free], rtol=1e-6)


def test_nested_finite_differences_give_the_same_answer(model, observe):
    """The paper's way: both levels by finite differences, no derivative of ours."""
    observations = observe(noise=1.0)
    options = QUICK.model_copy(update={"inner_poses": "all"})
    exact = calibrate(model, observations, options)
    terms = tolerance_rows(exact.level, exact.solution.x, options)

    def rows(z):
        x = z * model.scale
        return np.concatenate([exact.level.rows(x).residual.ravel(), terms @ x])

    start = exact.solution.x / model.scale + np.random.default_rng(0).normal(size=30)
    tight = {"xtol": 1e-13, "ftol": 1e-13, "gtol": 1e-13}
    found = least_squares(rows, start, jac="3-point", x_scale="jac", **tight)
    difference = (found.x - exact.solution.x / model.scale)[known(exact)]
    std = np.sqrt(np.diag(exact.covariance[:-6, :-6])) / model.scale
    assert np.abs(difference / std[known(exact)]).max() < 1e-3


def test_solver_reports_that_it_did_not_arrive(model, observe):
    level = TwoLevel(model, observe(noise=1.0), np.arange(24))
    stopped = solve(level, random_starts(model, 1, 0)[0], np.zeros((0, 30)), max_iterations=2)
    assert not stopped.converged


def test_too_few_poses_are_refused(model, observe):
    with pytest.raises(CalibrationError, match=r"5 poses with .*, 36 unknowns.*at least 6 poses"):
        calibrate(model, observe().take(slice(0, 5)), QUICK)


def test_springs_without_torques_are_refused(model, observe, states):
    unlogged = states.tau_Nm.copy()
    unlogged[3:5, 2] = np.nan
    observations = replace(observe(), states=replace(states, tau_Nm=unlogged))
    with pytest.raises(CalibrationError, match=r"tau3_Nm: joint 3 has a spring, .* 2 of 81 poses"):
        calibrate(model, observations, QUICK)


def test_a_rigid_arm_needs_no_torques(pa10, observe, states):
    rigid = baseline(pa10, (), Tolerances())
    unlogged = replace(states, tau_Nm=np.full_like(states.tau_Nm, np.nan))
    found = calibrate(rigid, replace(observe(), states=unlogged), QUICK)
    assert found.converged
    assert len(found.level.model.parameters) == 24


def test_load_cases_are_the_loads_by_rising_load_and_all_together():
    loads_N = np.array([100.0, 0.0, 22.5, 0.0])
    states = at_rest(np.zeros((4, 6)), load_N=loads_N)
    assert load_cases(states) == ("0N", "22.5N", "100N", "combined")
    assert rows_of_load(states, "0N").tolist() == [False, True, False, True]
    with pytest.raises(CalibrationError, match=r"33N.*0N, 22.5N, 100N, combined"):
        rows_of_load(states, "33N")


def test_loads_of_one_name_are_one_load_case():
    loads_N = np.array([0.0, -0.0, 44.482216, 44.482221])
    states = at_rest(np.zeros((4, 6)), load_N=loads_N)
    assert load_cases(states) == ("0N", "44.4822N", "combined")
    assert rows_of_load(states, "0N").tolist() == [True, True, False, False]
    assert rows_of_load(states, "44.4822N").tolist() == [False, False, True, True]


def test_load_cases_of_a_group_are_those_of_every_campaign():
    loads_N, campaign = np.array([0.0, 44.0, 0.0, 22.0]), np.array([0, 0, 1, 1])
    states = at_rest(np.zeros((4, 6)), load_N=loads_N, campaign=campaign)
    assert load_cases(states) == ("0N", "combined")
    assert rows_of_load(states, "0N").tolist() == [True, False, True, False]
    with pytest.raises(CalibrationError, match="no grid pose with this load in some campaigns"):
        rows_of_load(states, "44N")


def test_null_directions_of_a_made_up_matrix():
    jacobian = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
    found = identify(jacobian, np.ones(3))
    assert found.rank == 2
    (direction,) = unidentified_directions(found, tuple(TermParameter(n, "m", 1.0) for n in "abc"))
    assert direction == pytest.approx(dict(zip(direction, (1.0, -1.0), strict=True)))
    assert set(direction) == {"a", "b"}
