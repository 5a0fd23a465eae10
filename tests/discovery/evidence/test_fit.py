"""The full fit: exact derivatives, columns that add up, targets found off their places."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_arm import TARGETS_M, Missing, at_joint, measure, scored
from pa10cal.discovery.evidence.fit import (
    EvidenceFit,
    covariance_of,
    fit,
    pose_rows,
    targets_off_m,
    torque_rows,
)
from pa10cal.discovery.evidence.noise_model import NO_SHARED_ERROR
from pa10cal.discovery.model_with_effects import (
    with_base_motion,
    with_targets_off,
    with_unknowns,
)
from pa10cal.fit.problem import possible_sizes
from pa10cal.fit.rows_about_fit import RowsAboutFit

#: What moves poses, what shows in torques by way of a spring, what the joint carries, what bends
#: with a shape of its own, what yields, what the instrument reads falsely.
EFFECTS = [
    ("transmission_error", "joint 2"),
    ("friction_torque", "joint 3"),
    ("torque_gain", "joint 4"),
    ("torque_map", "joint 2"),
    ("soft_windup", "joint 5"),
    ("joint_compliance", "joint 4"),
    ("scale", "instrument"),
]


def some_amount(effect):
    """Return an effect's parameters in about their plausible size."""
    x = effect.starts[-1].copy()
    x[: effect.linear] += effect.prior_factor @ np.linspace(0.4, 1.2, effect.linear)
    return x


def fit_at(measured, effects, amounts):
    """Return a fit as if it had ended with these amounts, its own parameters as in the start."""
    start = measured.start
    own = start.x[start.baseline_columns()]
    model = with_base_motion(measured.baseline, effects)
    x = np.concatenate([own[:-6], *amounts, own[-6:]])
    at, sizes = replace(start.at, model=model, x=x), (1,) * len(effects)
    return EvidenceFit(effects, at, True, 1, sizes, NO_SHARED_ERROR)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("names", [[name] for name in EFFECTS] + [EFFECTS], ids=str)
def test_rows_have_the_derivative_that_differences_show(null, names):
    effects = tuple(null.effect(*name) for name in names)
    there = fit_at(null, effects, [some_amount(effect) for effect in effects])
    model, x = there.model, there.x

    def rows(x):
        at = with_unknowns(there.at, x)
        pose = pose_rows(null.problem, at)
        return np.concatenate([pose, torque_rows(null.problem, at)], axis=1)

    exact = rows(x)[:, :, 1:]
    steps = 1e-2 * model.scale
    steps[-6:] = 1e-5
    asked = np.r_[0:30:7, len(x) - 6 - sum(len(e.parameters) for e in effects) : len(x)]
    for k in asked:
        ahead, behind = x.copy(), x.copy()
        ahead[k] += steps[k]
        behind[k] -= steps[k]
        differences = (rows(ahead)[:, :, 0] - rows(behind)[:, :, 0]) / (2.0 * steps[k])
        largest = np.abs(exact[:, :, k]).max()
        np.testing.assert_allclose(exact[:, :, k], differences, atol=2e-5 * largest + 1e-9)


def test_columns_of_effects_and_of_the_model_are_all_there_are(null):
    effects = tuple(null.effect(*name) for name in EFFECTS)
    amounts = [some_amount(effect) for effect in effects]
    there = fit_at(null, effects, amounts)
    every = np.arange(len(there.x))
    of_effects = np.concatenate([every[there.columns_of(effect)] for effect in effects])
    every = np.sort(np.concatenate([of_effects, there.baseline_columns()]))
    np.testing.assert_array_equal(every, np.arange(len(there.x)))
    names = [parameter.name for parameter in there.model.parameters]
    for effect, amount in zip(effects, amounts, strict=True):
        np.testing.assert_array_equal(there.at.values_of(effect), amount)
        assert names[there.columns_of(effect)] == [
            parameter.name for parameter in effect.parameters
        ]
    own = null.start
    np.testing.assert_array_equal(there.x[there.baseline_columns()], own.x[own.baseline_columns()])


def test_a_fit_comes_to_rest_where_nothing_leads_down(wave):
    effect = wave.effect("transmission_error", "joint 2")
    found = fit(wave.problem, (effect,), (1,), NO_SHARED_ERROR, wave.start)
    assert found.converged

    def cost(x):
        rows = wave.problem.pose.whitening(0.0)(
            wave.problem.pose.noise_whitened(pose_rows(wave.problem, with_unknowns(found.at, x)))
        )[:, 0]
        expected = x / possible_sizes(found.model)
        at = found.columns_of(effect)
        expected[at] = np.linalg.solve(effect.prior_factor, x[at])
        return float(rows @ rows + expected @ expected)

    least = cost(found.x)
    information = np.linalg.inv(covariance_of(wave.problem, found))
    rng = np.random.default_rng(1)
    for _ in range(10):
        step = 0.1 * rng.normal(size=len(found.x)) / np.sqrt(np.diag(information))
        assert cost(found.x + step) > least
        # and rises as the information says
        rise = step @ information @ step
        both = cost(found.x + step) + cost(found.x - step) - 2.0 * least
        assert both == pytest.approx(2.0 * rise, rel=0.02)


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("tau0_Nm", [1.0, 2.5, 5.0])
def test_an_effect_that_shapes_itself_is_fitted_from_its_best_start(tau0_Nm):
    def turn(states):
        return at_joint(5, -6e-4 * np.tanh(states.tau_Nm[:, 4] / tau0_Nm))

    made = measure(Missing(turn=turn))
    found = fit(made.problem, (made.effect("soft_windup", "joint 5"),), (1,), NO_SHARED_ERROR)
    amount, tau0 = found.at.values_of(found.effects[0])
    assert amount == pytest.approx(6e-4, rel=0.02)
    assert tau0 == pytest.approx(tau0_Nm, rel=0.05)


def test_expected_sizes_hold_back_what_the_data_do_not_tell(null):
    effect = null.effect("scale", "instrument")
    tight, wide = (fit(null.problem, (effect,), (size,), NO_SHARED_ERROR) for size in (0, 2))
    std = [
        np.sqrt(np.diag(covariance_of(null.problem, found)))[found.columns_of(effect)]
        for found in (tight, wide)
    ]
    plausible = np.diag(effect.prior_factor)
    assert (std[0] < 0.1 * plausible).all()
    assert (std[1] > std[0]).all()
    assert np.linalg.norm(tight.at.values_of(effect)) < np.linalg.norm(wide.at.values_of(effect))


#: The targets are turned about the end-effector's y axis and shifted along it, against what is
#: stated: what no parameter of the model's last row takes up.
TURN_RAD, SHIFT_M = 2e-4, 30e-6
OFF_M = np.cross([0.0, TURN_RAD, 0.0], TARGETS_M) + np.array([0.0, SHIFT_M, 0.0])


@pytest.fixture(scope="module")
def moved():
    return measure(Missing(targets_m=OFF_M), apparatus_m=50e-6)


class TestTargetsOffTheirPlaces:
    def test_poses_are_read_as_measured_off_by_as_much_as_the_targets(self, moved):
        poses, start = moved.problem.cells, moved.start
        T = start.model.predict(poses.states, start.at.x)
        places_m = targets_off_m(moved.problem, start)
        read = poses.measured.as_read(T, start.at.T_instr_base, places_m)
        change = np.linalg.inv(T) @ read
        turns = Rotation.from_matrix(change[:, :3, :3]).as_rotvec()
        np.testing.assert_allclose(turns[:, 1], TURN_RAD, rtol=0.05)
        np.testing.assert_allclose(change[:, 1, 3], SHIFT_M, rtol=0.2)
        measured = np.linalg.inv(start.at.T_instr_base) @ poses.measured.T_instr_target
        left = [np.linalg.norm((each - measured)[:, :3, 3], axis=1).mean() for each in (T, read)]
        assert left[1] < 0.5 * left[0]

    def test_the_gap_is_taken_with_them(self, moved):
        with_places = scored(moved.problem, moved.start).gap_on(moved.held_out)
        assert with_places.after.mean_mm < 1.3 * 0.0092
        setup = replace(moved.problem.setup, apparatus_m=1e-9)
        problem = replace(moved.problem, setup=setup)
        without = scored(problem, moved.start).gap_on(moved.held_out)
        assert without.after.mean_mm > 2.0 * with_places.after.mean_mm

    def test_places_further_off_than_an_apparatus_is_are_the_end_s(self, moved):
        poses, payload = moved.problem.cells, moved.problem.setup.payload
        fitted = replace(moved.start.at, payload=payload)
        off_m = targets_off_m(moved.problem, moved.start)
        on_apparatus = with_targets_off(fitted, off_m, 50e-6, poses)
        np.testing.assert_array_equal(on_apparatus.T_end_shown, np.eye(4))
        shown = with_targets_off(fitted, off_m, 2e-6, poses)
        measured = np.linalg.inv(fitted.T_instr_base) @ poses.measured.T_instr_target

        def predicted_m(frame):
            q, load_N = poses.states.q_rad, poses.states.load_N
            return shown.predict(q, frame=frame, load_N=load_N, extrapolate=True).T[:, :3, 3]

        tool, flange = (
            np.linalg.norm(predicted_m(frame) - measured[:, :3, 3], axis=1).mean()
            for frame in ("tool", "flange")
        )
        assert tool < 0.5 * flange
        of_record_m = shown.as_read(poses)[:, :3, 3]
        np.testing.assert_allclose(predicted_m("tool"), of_record_m, atol=2e-6)
        # What the model lacks is reckoned about the end that is shown.
        rows = [RowsAboutFit.of(each, poses) for each in (on_apparatus, shown)]
        left = [np.sum((each.to_mm * each.residual) ** 2) for each in rows]
        assert left[1] < 0.5**2 * left[0]

    def test_nothing_off_changes_nothing(self, moved):
        T = moved.start.model.predict(moved.problem.cells.states, moved.start.x)
        zero = np.zeros(moved.problem.cells.measured.by_apparatus.shape[2])
        same = moved.problem.cells.measured.as_read(T, moved.baseline.T_instr_base, zero)
        np.testing.assert_allclose(same, T, atol=1e-15)


def test_the_base_is_as_uncertain_as_readings_with_directions_leave_it(null):
    """A paper's calibration has no covariance of it: that is no reason to hold it."""
    start = null.start
    base = start.model.columns_of(start.model.terms[-1])
    assert np.diag(covariance_of(null.problem, start))[base].min() > 0.0
