"""Rows of a survey: derivatives against differences, products against dense rows."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.sparse import csr_array

import pa10cal
from made_up_survey import observe
from mended import write_simulated
from pa10cal.discovery.blocked_cv import block_rows
from pa10cal.discovery.blocked_cv.block_rows import BlockedRows, ShapedEffect, weighted_rows
from pa10cal.discovery.blocked_cv.effect_set import Columns
from pa10cal.discovery.blocked_cv.family import below_detection_limit, computable_shapes, family
from pa10cal.discovery.blocked_cv.linear_fit import made_finer
from pa10cal.discovery.blocked_cv.normal_equations import (
    BlockEquations,
    in_map_bases,
    normal_equations_of,
)
from pa10cal.discovery.blocked_cv.search import Search
from pa10cal.discovery.blocked_cv.survey import Survey, consecutive_blocks
from pa10cal.discovery.jacobians import by_joints, by_terms
from pa10cal.discovery.model_with_effects import with_base_motion
from pa10cal.discovery.nuisances import AttitudeLag, Jump, Wander
from pa10cal.discovery.pose_scatter import unweighted
from pa10cal.discovery.preparation import Prepared, why_few_angles
from pa10cal.discovery.rules import BLOCKS
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.periodic_spline import b_splines_by_knots, harmonics_at_knots, spline_columns
from pa10cal.terms.effects.joint import TorqueGain
from pa10cal.terms.effects.joint_error_map import FadingPrior, JointErrorMap
from pa10cal_lab.cell.trials import draw_trials


@pytest.fixture(scope="module")
def few():
    """The least survey there is."""
    return observe(poses=100, held_out=0).survey


@pytest.fixture(scope="module")
def rows(few):
    wanted = {("encoder_eccentricity", "joint 2"), ("backlash", "joint 3")}
    shaped = [
        each for each in computable_shapes(few)[0] if (each.effect.id, each.effect.of) in wanted
    ]
    return BlockedRows(few, unweighted(few.poses.measured), tuple(shaped), 36)


def test_left_follows_parameters_as_differences_show(few):
    effect = JointErrorMap("joint 3", 24, FadingPrior(1e-4, 4.0))
    model = with_base_motion(few.baseline, (effect,))
    x = np.concatenate([few.baseline.x, np.linspace(-1e-4, 1e-4, 24), np.full(6, 1e-4)])
    at = FittedModel(model, x, few.baseline.T_instr_base)
    stops = np.cumsum([0, *(len(term.parameters) for term in model.terms)])
    points = [x[first:last] for first, last in pairwise(stops)]
    exact = np.concatenate(by_terms(at, few.poses, model.terms, points), axis=2)
    scale = model.scale
    for k in range(0, len(x), 5):
        step = np.zeros(len(x))
        step[k] = 1e-2 * scale[k]
        ends = [replace(at, x=x + sign * step).compared(few.poses).residual for sign in (1, -1)]
        difference = (ends[0] - ends[1]) / (2.0 * step[k])
        np.testing.assert_allclose(exact[:, :, k], difference, atol=2e-6, rtol=2e-5)


def test_sparse_columns_of_a_map_are_those_of_the_term(few):
    effect = JointErrorMap("joint 4", 36)
    at = FittedModel(
        with_base_motion(few.baseline),
        np.append(few.baseline.x, np.zeros(6)),
        few.baseline.T_instr_base,
    )
    dense = by_terms(at, few.poses, [effect], [np.zeros(36)])[0].reshape(-1, 36)
    screws = by_joints(at, few.poses, [4])
    splines = spline_columns(screws, few.poses.states.q_rad[:, [3]], [36])
    assert splines.nnz == 4 * len(dense)
    np.testing.assert_allclose(splines @ b_splines_by_knots(36), dense, atol=1e-12)


@pytest.fixture
def block_by_block(monkeypatch):
    """Rows of so many poses that only those of one block are held at a time."""
    monkeypatch.setattr(block_rows, "COMPUTING", replace(block_rows.COMPUTING, most_kept=0))


def test_products_of_many_poses_are_those_of_dense_rows(rows, block_by_block):
    test_products_are_those_of_dense_rows(replace(rows))


def test_rows_about_what_other_rows_worked_out_are_as_if_worked_out_anew(few, rows):
    lagging, eccentric = rows.shaped
    other = replace(rows, weights=replace(rows.weights, weight=np.full(len(few.poses), 0.5)))
    known = rows.few_linearised
    for shaped in ((lagging, eccentric), (eccentric,), (eccentric, lagging)):
        anew = replace(other, shaped=shaped).design(3)
        found = replace(other, shaped=shaped, known=known).design(3)
        assert known.only(shaped).shaped == shaped
        np.testing.assert_array_equal(found.dense, anew.dense)
        np.testing.assert_array_equal(found.data, anew.data)
    assert known.only((ShapedEffect(TorqueGain("joint 2")),)) is None


def test_what_was_worked_out_of_other_poses_is_not_taken(few, rows):
    later = replace(few, poses=few.poses.take(np.arange(len(few.poses))[::-1]))
    anew = replace(rows, survey=later).design(3)
    found = replace(rows, survey=later, known=rows.few_linearised).design(3)
    np.testing.assert_array_equal(found.dense, anew.dense)


def test_products_are_those_of_dense_rows(rows):
    found = rows.normal_equations()
    for b in (0, 9):
        block = rows.design(b)
        maps = block.maps([rows.knots] * len(rows.joints)).toarray()
        turned = maps.reshape(len(maps), len(rows.joints), -1) @ rows.basis
        every = np.concatenate([block.dense, turned.reshape(len(maps), -1)], axis=1)
        rounding = 1e-11 * np.abs(found.gram[b]).max()
        np.testing.assert_allclose(found.gram[b], every.T @ every, rtol=1e-9, atol=rounding)
        np.testing.assert_allclose(found.projection[b], every.T @ block.data, rtol=1e-8, atol=1e-6)
        place = np.arange(len(every)) % 6 < 3
        np.testing.assert_allclose(
            found.of_positions.gram[b], every[place].T @ every[place], rtol=1e-9, atol=rounding
        )
        assert found.squares[b] == pytest.approx(block.data @ block.data)


def test_products_in_terms_of_other_parameters_are_those_of_turned_columns():
    rng = np.random.default_rng(3)
    dense, first, second = (rng.standard_normal((50, n)) for n in (3, 8, 5))
    bases = [rng.standard_normal((8, 6)), rng.standard_normal((5, 5))]
    data = rng.standard_normal(50)
    said = normal_equations_of(data, dense, csr_array(np.hstack([first, second])))
    found = in_map_bases(said, 3, bases)
    turned = np.hstack([dense, first @ bases[0], second @ bases[1]])
    np.testing.assert_allclose(found.gram, turned.T @ turned, atol=1e-10)
    np.testing.assert_allclose(found.projection, turned.T @ data, atol=1e-10)
    assert found.squares == pytest.approx(data @ data)


def test_only_rows_that_are_all_zero_are_left_out():
    """Of rows whose dense columns are zero, maps and data say what they say, few rows or many."""
    rng = np.random.default_rng(3)
    data, dense, splines = (rng.standard_normal(shape) for shape in (90, (90, 3), (90, 8)))
    dense[:60], splines[:20], data[:20] = 0.0, 0.0, 0.0
    every = np.hstack([dense, splines, data[:, None]])
    found = normal_equations_of(data, dense, csr_array(splines))
    np.testing.assert_allclose(found.products, every.T @ every, atol=1e-12)
    found = normal_equations_of(data, dense[:, :0], csr_array(splines))
    np.testing.assert_allclose(found.products, every[:, 3:].T @ every[:, 3:], atol=1e-12)


def test_other_unknowns_of_maps_keep_what_was_integrated_out():
    found = in_map_bases(Gaussian(np.eye(9), log_det=5.0), 0, [np.ones((8, 2))])
    assert found.log_det == 5.0
    with pytest.raises(AssertionError):
        BlockEquations.empty(1, 2).put(0, found)


def test_a_b_spline_that_is_no_column_has_to_be_zero():
    by_angle, q_rad = np.ones((5, 3, 1)), np.linspace(0.0, 1.0, 5)[:, None]
    with pytest.raises(AssertionError):
        spline_columns(by_angle, q_rad, [12], [np.arange(2)])


def test_left_of_is_the_data_less_what_the_columns_say(rows):
    rng = np.random.default_rng(4)
    found = rows.normal_equations()
    x = 1e-2 * rng.standard_normal((len(found.projection[0]), 2))
    here = np.flatnonzero(rows.survey.block == 3)
    whitened = rows.weights.whiteners(here) @ rows.block_residual(3, x)
    for k in range(2):
        squares = float(np.sum(whitened[:, :, k] ** 2))
        said = found.squares[3] - 2.0 * found.projection[3] @ x[:, k]
        assert squares == pytest.approx(said + x[:, k] @ found.gram[3] @ x[:, k], rel=1e-9)


def test_columns_stand_where_rows_say(rows):
    lagging, eccentric = rows.columns_of_effects()
    assert [each.effect.id for each in rows.shaped] == ["backlash", "encoder_eccentricity"]
    own = len(rows.baseline_columns)
    assert (lagging.tolist(), eccentric.tolist()) == ([own], [own + 1, own + 2])
    assert rows.columns_of_map(1)[0] == own + 3
    assert rows.columns_of_map(6)[-1] + 1 == len(rows.normal_equations().projection[0])
    assert rows.basis.shape == (36, 35)
    np.testing.assert_allclose(
        np.linalg.solve(b_splines_by_knots(36), rows.basis),
        harmonics_at_knots(36)[:, 1:],
        atol=1e-12,
    )


def test_the_family_has_every_map_in_every_form_and_says_what_it_lacks(few):
    shaped, unknown = computable_shapes(few)
    assert all(isinstance(each, ShapedEffect) for each in shaped)
    assert {entry.why for entry in unknown} == {"the torques were not logged"}
    rows = BlockedRows(few, unweighted(few.poses.measured), shaped, 144)
    found = family(rows, rows.normal_equations())
    maps = [each for each in found.shown if each.is_map]
    assert len(maps) == 6 * 9
    assert {each.effect.of for each in maps} == {f"joint {joint}" for joint in range(1, 7)}
    assert ("joint_compliance", "joint 1") in {(e.effect.id, e.effect.of) for e in found.hidden}
    of_place = [each for each in found.shown if each.effect.id == "place_map"]
    assert sorted(len(each.index) for each in of_place) == [2] * 9 + [57]
    whole = next(each for each in of_place if len(each.index) == 57)
    assert all(set(each.index) <= set(whole.index) for each in of_place)


def at_angles(survey, joint, angles):
    """Return a survey whose poses have a joint at so few angles around the turn, in turn."""
    poses = survey.poses
    q_rad = poses.states.q_rad.copy()
    q_rad[:, joint - 1] = 2.0 * np.pi * (np.arange(len(poses)) % angles) / angles
    return replace(survey, poses=poses.with_states(replace(poses.states, q_rad=q_rad)))


def test_no_map_is_sought_of_a_joint_that_a_grid_has_at_few_angles(few):
    survey = at_angles(few, 3, 4)
    rows = BlockedRows(survey, unweighted(survey.poses.measured), (), 144)
    found = family(rows, rows.normal_equations())
    states = survey.poses.states
    off_rad = 2.0 * np.pi * (np.arange(len(states.q_rad)) % 3 - 1)  # whole turns, and jitter
    off_rad = off_rad + np.random.default_rng(0).uniform(-5e-4, 5e-4, len(off_rad))
    turned = replace(states, q_rad=states.q_rad + off_rad[:, None] * (np.arange(6) == 2))
    assert why_few_angles(JointErrorMap("joint 3"), turned) == found.hidden[0].why
    assert {each.effect.of for each in found.shown} == {f"joint {k}" for k in (1, 2, 4, 5, 6)}
    (hidden,) = found.hidden
    assert hidden.effect == JointErrorMap("joint 3")
    assert hidden.why == "the joint took 4 angles, too few to show what it does between them"


def test_a_map_has_no_more_knots_than_the_angles_of_a_grid_show(few):
    fine = ShapedEffect(JointErrorMap("joint 3", 144, FadingPrior(1e-4, 25.0)))
    for survey, knots in ((few, 216), (at_angles(few, 3, 40), 144)):
        rows = BlockedRows(survey, unweighted(survey.poses.measured), (), 144)
        assert made_finer(rows, fine, 216).effect.knots == knots
    coarse = ShapedEffect(JointErrorMap("joint 3", 72, FadingPrior(1e-4, 10.0)))
    assert made_finer(rows, coarse, 216) is coarse


def test_a_gain_of_logged_torques_is_taken_up_by_the_springs_that_take_the_log(few):
    friction_Nm = 0.5 * np.sign(np.sin(17.0 * np.arange(len(few.poses))))[:, None]
    log_Nm = few.poses.states.tau_Nm + friction_Nm
    poses = replace(few.poses, states=replace(few.poses.states, tau_Nm=log_Nm))
    logged, masses = (
        Survey.of(Prepared(poses, None, few.baseline, few.setup, torques, False)).poses.states
        for torques in ("logged", "masses")
    )
    gain = TorqueGain("joint 2")
    np.testing.assert_array_equal(gain.per_unit(logged), logged.tau_Nm[:, 1])
    assert np.median(np.abs(gain.per_unit(masses) - masses.tau_Nm[:, 1])) > 0.4


def test_an_effect_below_its_detection_limit_is_listed_and_sought_all_the_same(few):
    shaped, _ = computable_shapes(few)
    rows = BlockedRows(few, unweighted(few.poses.measured), shaped, 36)
    weights = replace(rows.weights, weight=np.full(len(few.poses), 2e-3))
    name, found = ("backlash", "joint 3"), []
    for each in (rows, replace(rows, weights=weights)):
        products = each.normal_equations()
        known = family(each, products)
        search = Search(
            products, Columns(each.baseline_columns, each.baseline_sizes), known.shown, 0.0, 0.05
        )
        below = below_detection_limit(known, search.is_surely_found)
        assert name in {candidate.name for candidate in known.shown}
        found.append((known.gains[name], name in {(e.effect.id, e.effect.of) for e in below}))
    (large, shown), (small, missed) = found
    assert small == pytest.approx(2e-3 * large, rel=1e-3)
    assert large > 87.0 > small
    assert (shown, missed) == (False, True)


@pytest.mark.slow
def test_distances_too_few_for_maps_of_all_joints_are_weighed_by_their_noise(tmp_path):
    (trial,) = draw_trials("null", 1, 5, "distance")
    campaign = pa10cal.read_campaign(write_simulated(tmp_path / "raw", trial.settings))
    judged = pa10cal.discover(campaign, pa10cal.calibrate(campaign)).scorer.survey
    found = weighted_rows(judged, computable_shapes(judged)[0], 72)
    noise_mm = 1e3 / np.median(found.weights.whitener)
    assert noise_mm == pytest.approx(trial.settings.without_touches.position_mm, rel=0.25)


def test_fitted_amounts_are_those_of_each_nuisance_in_the_order_of_their_columns(few):
    time_s = few.poses.states.time_s
    wander = Wander(time_s, (Jump(time_s[50], time_s[49], time_s[51], 1e-4, 1.0),))
    survey = replace(few, wander=wander, lag=AttitudeLag((4, 5)))
    amounts = np.arange(1.0, survey.nuisance_count + 1.0)
    fitted = survey.with_amounts(amounts)
    np.testing.assert_array_equal(fitted.wander.amounts, amounts[:6])
    np.testing.assert_array_equal(fitted.lag.amounts, amounts[6:])
    assert fitted.change is None
    assert few.with_amounts(amounts[:0]).nuisances == ()
    with pytest.raises(AssertionError):
        survey.with_amounts(amounts[1:])


@pytest.mark.parametrize("poses_each", [1, 7, 15, 19, 25])
def test_blocks_are_alike_however_few_poses_each_campaign_has(few, poses_each):
    poses = few.poses
    campaign = np.arange(len(poses)) // poses_each
    grouped = replace(poses, states=replace(poses.states, campaign=campaign))
    held = np.bincount(consecutive_blocks(grouped), minlength=BLOCKS.blocks)
    assert held.min() >= BLOCKS.least_poses - 2
    assert np.ptp(held) <= 2


def test_poses_of_another_region_are_in_blocks_of_others(few):
    poses, rng = few.poses, np.random.default_rng(1)
    count, last = len(poses), np.arange(len(poses) - 8, len(poses))

    def blocks_at(q_rad):
        return consecutive_blocks(replace(poses, states=replace(poses.states, q_rad=q_rad)))

    q_rad = rng.uniform(-1.0, 1.0, poses.states.q_rad.shape)
    in_order = np.arange(count) * BLOCKS.blocks // count
    np.testing.assert_array_equal(blocks_at(q_rad), in_order)
    one_by_one = q_rad.copy()
    one_by_one[:, 1] = np.sort(one_by_one[:, 1])  # the first block is as far apart as the last one
    np.testing.assert_array_equal(blocks_at(one_by_one), in_order)
    in_steps = q_rad.copy()
    in_steps[:, 1] = np.arange(count) * 5 // count  # a step fills two blocks
    np.testing.assert_array_equal(blocks_at(in_steps), in_order)
    q_rad[last, 1] = 1.5  # as poses that a verdict asked for
    found = blocks_at(q_rad)
    others = np.arange(last[0])
    np.testing.assert_array_equal(found[others], others * BLOCKS.blocks // len(others))
    assert len(np.unique(found[last])) == len(last)
    assert np.ptp(np.bincount(found)) <= 1


def test_no_block_is_left_with_few_poses_where_those_apart_are_dealt(few):
    poses, rng = few.poses, np.random.default_rng(1)
    count = len(poses)
    q_rad = rng.uniform(-1.0, 1.0, poses.states.q_rad.shape)
    for campaign, apart in (
        (np.zeros(count, np.intp), np.arange(count) >= count - 10),
        (np.arange(count) // 19, np.arange(count) % 19 == 18),
    ):
        elsewhere = q_rad.copy()
        elsewhere[apart, 1] = 1.5
        states = replace(poses.states, q_rad=elsewhere, campaign=campaign)
        held = np.bincount(consecutive_blocks(replace(poses, states=states)), minlength=10)
        assert np.ptp(held) <= 2
