"""Where model and data disagree is found where it was put, and nowhere where nothing was put."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_arm import ARM, TARGETS_M, Missing, harmonic, measure, scored
from pa10cal.arm.chain import Chain
from pa10cal.arrays import rms
from pa10cal.discovery.evidence.channel_tests import channel_tests, evidence_lack_of_fit
from pa10cal.discovery.evidence.fit import fit
from pa10cal.discovery.evidence.noise_model import NO_SHARED_ERROR
from pa10cal.discovery.evidence.problem import prepare
from pa10cal.discovery.evidence.search import evidence_about
from pa10cal.discovery.finding import name_of
from pa10cal.discovery.gap import errors_by_name
from pa10cal.discovery.lack_of_fit import drift, mean, periodogram
from pa10cal.discovery.repeats import same_circumstances
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.instrument import group_means
from pa10cal.observe.observations import average_repeats
from pa10cal.observe.points import Points
from pa10cal.options import Tolerances
from pa10cal.terms.effects.joint import FrictionTorque, TransmissionError
from pa10cal.terms.joint_spring import baseline
from pa10cal.terms.model import Model

#: What `wave` and `rubbing` hide, and how large it is here.
HARMONIC, AMPLITUDE_RAD = TransmissionError("joint 2", 100.0), 3e-4
FRICTION, FRICTION_NM = FrictionTorque("joint 3", 100.0), 3.0


@pytest.fixture
def nothing(null):
    """What is left where nothing is missing."""
    return evidence_lack_of_fit(null.problem, null.start)


@pytest.fixture(scope="module")
def wavy():
    """Many poses of a joint 2 that has a periodic error."""
    return measure(Missing(turn=harmonic(2, 100.0, AMPLITUDE_RAD, 1.0)), poses=100)


@pytest.fixture(scope="module")
def left(wavy):
    """What is left of it without the effect."""
    return evidence_lack_of_fit(wavy.problem, wavy.start)


@pytest.fixture
def friction(rubbing):
    """What is left where joint 3 holds part of its load by friction."""
    return evidence_lack_of_fit(rubbing.problem, rubbing.start)


def test_pure_error_is_all_there_is_where_nothing_is_missing(null, nothing):
    (pure_error, _), (of_torques, _) = channel_tests(null.problem, null.start)
    assert pure_error == nothing.pure_error
    for test in (pure_error, of_torques):
        assert pytest.approx(1.0, abs=0.25) == test.F
        assert test.p_value > 0.001
    for part in (*nothing.by_load, *nothing.by_axis):
        assert part.rms_mm == pytest.approx(part.floor_mm, rel=0.2)
    for part in nothing.by_joint:
        assert part.rms_rad == pytest.approx(part.floor_rad, rel=0.2)
        assert rms(part.torque_residual_Nm) == pytest.approx(part.torque_noise_Nm, rel=0.3)


def test_the_floor_is_what_the_noise_of_the_cells_leaves(null, nothing):
    readings = null.problem.readings
    left_m, group = null.start.at.compared(readings).residual[:, :3], same_circumstances(readings)
    scatter_m = left_m - group_means(left_m, group)[group]
    variance_m2 = np.sum(scatter_m**2) / (len(readings) - group.max() - 1)
    # Two readings a cell: one a direction of arrival.
    floor_mm = np.sqrt(sum(part.floor_mm**2 for part in nothing.by_axis))
    assert floor_mm == pytest.approx(1e3 * np.sqrt(variance_m2 / 2.0), rel=0.15)


def test_what_poses_share_stands_out_where_something_is_missing(wavy, left):
    (pure_error, shared), (of_torques, _) = channel_tests(wavy.problem, wavy.start)
    assert pure_error == left.pure_error
    assert pure_error.F > 20.0
    assert pure_error.p_value < 1e-9
    assert shared > 1.0
    assert pytest.approx(1.0, abs=0.25) == of_torques.F


def by_points(measured, hidden, shared_m, noise_m=5e-6):
    """Return the problem of three targets, a share of whose readings is hidden, and its fit."""
    rng, readings, at = np.random.default_rng(7), measured.readings, measured.baseline
    T = at.T_instr_base @ at.model.predict(readings.states, at.x)
    p_m = T[:, None, :3, 3] + TARGETS_M @ T[:, :3, :3].transpose(0, 2, 1)
    labels, pose = np.unique(readings.pose, return_inverse=True)
    p_m += shared_m * rng.normal(size=(len(labels), 3, 3))[pose]
    p_m += noise_m * rng.normal(size=p_m.shape)
    p_m[rng.uniform(size=p_m.shape[:2]) < hidden] = np.nan
    cov_m2 = np.where(np.isfinite(p_m)[..., None], noise_m**2 * np.eye(3), np.nan)
    points = Points(("T1", "T2", "T3"), p_m, cov_m2, None)
    at = replace(at, targets_m=TARGETS_M.ravel())
    problem = prepare(replace(readings, measured=points), at, measured.setup)
    return problem, fit(problem, (), (), NO_SHARED_ERROR)


@pytest.mark.parametrize("hidden", [0.0, 0.2, 0.5])
def test_targets_that_were_hidden_are_no_evidence(null, hidden):
    problem, start = by_points(null, hidden, 0.0)
    test = channel_tests(problem, start)[0].pure_error
    assert pytest.approx(1.0, abs=0.15) == test.F
    assert test.p_value > 0.01
    # Three targets of four repeats: pairs in which neither was hidden.
    pairs = len(problem.readings) / 2 * 9 * (1.0 - hidden) ** 2
    assert test.pure_error_dof == pytest.approx(pairs, rel=0.1)
    assert test.dof < problem.cells.measured.components_seen.sum()


def test_what_poses_share_is_as_large_where_targets_were_hidden(null):
    of_all, of_some = (by_points(null, hidden, 1e-5) for hidden in (0.0, 0.3))
    tested = [channel_tests(*each)[0].shared_variance for each in (of_all, of_some)]
    likeliest = [evidence_about(*each, ()).score(()).variances.pose for each in (of_all, of_some)]
    assert tested[1] == pytest.approx(tested[0], rel=0.15)
    assert likeliest[1] == pytest.approx(likeliest[0], rel=0.15)


def test_projection_finds_the_joint_and_the_periodogram_its_order(left):
    excess = [part.rms_rad / part.floor_rad for part in left.by_joint]
    assert np.argmax(excess) == 1
    found = left.by_joint[1].periodogram
    assert found.marked.tolist() == [1.0, 2.0, 50.0, 100.0]
    assert np.argmax(found.marked_rad) == 3
    assert found.orders[np.argmax(found.explained_rad)] == pytest.approx(100.0, abs=1.0)
    # A sine of amplitude A has a root mean square of A / sqrt(2), less what the model absorbed.
    assert found.marked_rad[3] == pytest.approx(AMPLITUDE_RAD / np.sqrt(2.0), rel=0.2)


def test_parts_add_up_to_the_whole(left):
    assert [part.of for part in left.by_load] == ["0 N", "44 N"]
    by_load = np.mean([part.rms_mm**2 for part in left.by_load])  # as many cells at each load
    assert sum(part.rms_mm**2 for part in left.by_axis) == pytest.approx(by_load)


def test_friction_shows_as_torque_by_direction(friction):
    for part in friction.by_joint:
        by_side = {s: part.torque_residual_Nm[part.arrival == s].mean() for s in (-1, 1)}
        if part.joint == 3:
            assert by_side[1] == pytest.approx(FRICTION_NM, rel=0.1)
            assert by_side[-1] == pytest.approx(-FRICTION_NM, rel=0.1)
            assert rms(part.torque_residual_Nm) > 20.0 * part.torque_noise_Nm
        else:
            assert abs(by_side[1] - by_side[-1]) < 0.1 * FRICTION_NM


def test_friction_winds_the_spring_by_direction(friction):
    (part,) = (part for part in friction.by_joint if part.joint == 3)
    backward, forward = part.arrivals
    std_rad = np.hypot(forward.std_rad, backward.std_rad)
    assert abs(forward.mean_rad - backward.mean_rad) > 5.0 * std_rad


def test_what_the_effect_explains_is_gone_with_it(wavy):
    with_it = fit(wavy.problem, (HARMONIC,), (1,), NO_SHARED_ERROR, wavy.start)
    after = evidence_lack_of_fit(wavy.problem, with_it)
    assert pytest.approx(1.0, abs=0.25) == after.pure_error.F
    assert after.by_joint[1].rms_rad == pytest.approx(after.by_joint[1].floor_rad, rel=0.2)


def test_unlogged_torques_and_temperatures_are_not_made_up(null):
    states = replace(null.readings.states, tau_Nm=np.full((len(null.readings), 6), np.nan))
    readings, rigid = null.readings.with_states(states), baseline(ARM, (), Tolerances())
    model = Model(Chain.of(ARM, bends=tuple(range(1, ARM.n))), rigid.terms)
    start = FittedModel(model, np.zeros(len(model.parameters)), null.baseline.T_instr_base)
    problem = prepare(readings, start, null.setup)
    part = evidence_lack_of_fit(problem, fit(problem, (), (), NO_SHARED_ERROR))
    for joint in part.by_joint:
        assert joint.torque_residual_Nm is joint.torque_noise_Nm is None
    assert all(each.with_temperature_mm is None for each in part.drifts)


def test_the_record_holds_finite_numbers_cell_by_cell(left):
    record = left.model_dump()

    def numbers(node):
        if isinstance(node, dict):
            for value in node.values():
                yield from numbers(value)
        elif isinstance(node, list):
            for value in node:
                yield from numbers(value)
        elif isinstance(node, float):
            yield node

    assert np.isfinite(list(numbers(record))).all()
    assert record["pure_error"]["F"] == left.pure_error.F


def test_errors_fall_name_by_name_from_the_baseline_to_the_extended_model(wave):
    problem, start = wave.problem, wave.start
    extended = fit(problem, (FRICTION, HARMONIC), (1, 1), NO_SHARED_ERROR, start)
    scorer = scored(problem, extended)
    train = scorer.gap_on(average_repeats(problem.readings))
    found = errors_by_name(train, None, extended.effects, scorer.model_with)
    # What takes most away joins first.
    assert list(found.fitted_without) == [HARMONIC, FRICTION]
    none, one, both = found.steps
    assert (none.train, both.train) == (train.before, train.after)
    assert one.effects == (name_of(HARMONIC),)
    assert one.train.rms_mm < 0.3 * none.train.rms_mm
    assert none.holdout is None


def test_without_effects_there_is_the_baseline_alone(wave):
    scorer = scored(wave.problem, wave.start)
    train = scorer.gap_on(average_repeats(wave.problem.readings))
    (step,) = errors_by_name(train, train, (), scorer.model_with).steps
    assert step.effects == ()
    assert step.holdout == train.before


class TestPeriodogram:
    q_rad = np.random.default_rng(7).uniform(-0.6, 0.6, 60)

    @pytest.mark.parametrize("order", [50.0, 100.0])
    def test_explains_a_sine_of_its_order_and_no_offset(self, order):
        error = 2.0 + np.sin(order * self.q_rad + 0.3)
        found = periodogram(self.q_rad, error, np.ones(60), 50.0)
        at = found.marked.tolist().index(order)
        assert found.marked_rad[at] == pytest.approx(error.std(), rel=1e-6)
        assert found.orders[np.argmax(found.explained_rad)] == pytest.approx(order, abs=0.5)

    def test_without_a_gear_ratio_orders_go_as_high_and_none_of_its_own_is_marked(self):
        error = np.sin(90.0 * self.q_rad)
        found = periodogram(self.q_rad, error, np.ones(60), np.nan)
        assert found.marked.tolist() == [1.0, 2.0]
        assert found.orders[np.argmax(found.explained_rad)] == pytest.approx(90.0, abs=0.5)

    def test_cells_without_weight_do_not_count(self):
        error = np.sin(50.0 * self.q_rad)
        error[:10] += 30.0
        weight = np.where(np.arange(60) < 10, 1e-12, 1.0)
        found = periodogram(self.q_rad, error, weight, 50.0)
        assert np.argmax(found.marked_rad) == 2

    def test_an_error_that_is_zero_holds_no_order(self):
        found = periodogram(self.q_rad, np.zeros(60), np.ones(60), 50.0)
        assert not found.explained_rad.any()

    def test_a_joint_that_hardly_turned_has_none(self):
        assert periodogram(0.01 * self.q_rad, self.q_rad, np.ones(60), 50.0) is None


class TestClustered:
    pose = np.repeat([f"P{k}" for k in range(200)], 5)

    def test_the_uncertainty_counts_poses(self):
        rng = np.random.default_rng(3)
        of_pose = np.repeat(rng.normal(0.0, 1.0, 200), 5)
        found = mean(of_pose, np.ones(1000), self.pose)
        assert found.std == pytest.approx(1.0 / np.sqrt(200), rel=0.15)

    def test_the_drift_is_that_of_a_line_far_from_zero(self):
        by = np.random.default_rng(3).uniform(1e5, 1e5 + 10.0, 1000)
        found = drift(by, 3.0 - 0.5 * by, np.ones(1000), self.pose)
        assert found.value == pytest.approx(-0.5 * np.ptp(by))
        assert found.std == pytest.approx(0.0, abs=1e-6)

    def test_one_pose_tells_no_uncertainty(self):
        assert mean(np.arange(5.0), np.ones(5), self.pose[:5]).std is None
