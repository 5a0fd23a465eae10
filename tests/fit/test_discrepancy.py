"""What a model lacks: the promised uncertainty against errors at poses that were not fitted."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mended import write_simulated
from pa10cal.fit.discrepancy import discrepancy_of
from pa10cal.fit.model_reading import load_model, model_from_plain
from pa10cal.fit.model_writing import model_to_plain, save_model
from pa10cal.fit.repeatability import repeatability_mm
from pa10cal.fit.rows_about_fit import RowsAboutFit
from pa10cal.fit.validity import Discrepancy
from pa10cal.interface import calibrate, read_campaign
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.observations import average_repeats
from pa10cal.terms.effects.arrivals import AlongMove
from pa10cal.terms.field import embedded
from pa10cal.terms.model import Model
from pa10cal_lab.cell.options import HiddenEffectOptions, SimulateOptions, TrackerOptions

SOME = Discrepancy(
    q=np.array([[0.0, 0.2], [1.0, 0.3]]),
    lever_m=np.array([0.8, 1.0]),
    turns=np.array([True, False]),
    distance_m=np.array([0.1, 0.3]),
    error_mm=np.array([0.05, 0.2]),
    near_m=0.15,
)


@given(st.floats(-3.0, 3.0), st.floats(-0.5, 0.5))
def test_distances_are_chords_of_joints_that_turn_and_strokes_of_those_that_slide(angle, stroke):
    apart = embedded(np.array([[0.0, 0.0], [angle, stroke]]), SOME.lever_m, SOME.turns)
    expected = np.hypot(2.0 * 0.8 * np.sin(angle / 2.0), stroke)
    assert np.linalg.norm(apart[1] - apart[0]) == pytest.approx(expected, abs=1e-12)


def test_errors_never_fall_with_distance_and_go_on_in_proportion():
    q = np.array([[0.0, 0.2], [0.0, 0.3], [0.0, 0.5], [0.0, 0.8], [0.0, -0.7]])
    found = SOME.error_at_mm(q)
    assert found[:3] == pytest.approx([0.05, 0.05, 0.2])
    assert found[3] == pytest.approx(0.4)  # twice as far as was judged
    assert np.all(np.diff(found[[0, 2, 3, 4]]) > 0.0)
    assert SOME.near(q).tolist() == [True, True, False, False, False]


@given(st.floats(0.05, 2.0), st.floats(-3.0, 3.0), st.integers(-1, 1), st.floats(-1.5, 2.5))
def test_a_pose_is_near_only_if_each_joint_is_about_in_its_range(span, first, turn, at):
    swept = np.linspace(first, first + span, 30)
    turned = np.linspace(0.2, 0.3, 30)
    near = replace(
        SOME, q=np.column_stack([swept, turned]), lever_m=np.array([1e-3, 1.0]), near_m=1.0
    )
    q = np.array([[first + at * span + 2.0 * np.pi * turn, 0.25]])
    beyond = span * max(-at, at - 1.0, 0.0)
    margin = max(0.1 * span, np.radians(2.5))
    if abs(beyond - margin) > 1e-9:
        assert near.near(q).item() == (beyond < margin)


def simulated(tmp_path, hidden, **plan):
    settings = SimulateOptions(
        robot="irb120",
        random_seed=11,
        without_touches=TrackerOptions(instrument="points", flexible_joints=(), **plan),
        hidden_effects=hidden,
    )
    return read_campaign(write_simulated(tmp_path / "robot", settings))


def ratio_and_share(campaign, model):
    """Return rms error over rms promised, and the share of errors within 1.96 times it."""
    held_out = campaign.observations.of_kind("holdout")
    error_mm = model.deviations(model.as_modelled(held_out)).distance_mm
    promised = model.predict(held_out.states.q_rad, frame="tool")
    noise_mm = 1e3 * np.sqrt(np.trace(held_out.measured.stated_covariance[0][:3, :3]))
    total_mm = np.hypot(promised.u_mm, noise_mm)
    rms = [float(np.sqrt(np.mean(each**2))) for each in (error_mm, total_mm)]
    return rms[0] / rms[1], float(np.mean(error_mm <= 1.96 * total_mm)), promised


LARGE = (
    HiddenEffectOptions(
        id="encoder_eccentricity", of="joint 2", parameters={"A": 8e-4, "phi": 0.4}
    ),
    HiddenEffectOptions(id="encoder_ellipticity", of="joint 3", parameters={"A": 8e-4, "phi": 1.4}),
)


def test_what_a_model_lacks_is_promised(tmp_path):
    campaign = simulated(tmp_path, LARGE, poses=180, holdout_share=0.33)
    model = calibrate(campaign)
    ratio, share, promised = ratio_and_share(campaign, model)
    assert 0.7 < ratio < 1.3
    assert share >= 0.9
    assert np.sqrt(np.mean(promised.u_parameters_mm**2)) < 0.5 * np.sqrt(np.mean(promised.u_mm**2))
    assert promised.inside.mean() > 0.85


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """Return a campaign that hides nothing, and its calibrated model."""
    campaign = simulated(tmp_path_factory.mktemp("complete"), (), poses=180, holdout_share=0.33)
    return campaign, calibrate(campaign)


def test_a_few_gross_errors_are_no_property_of_the_model(complete):
    campaign, clean = complete
    every = campaign.observations
    p_instr_m = every.measured.p_instr_m.copy()
    wrong = np.flatnonzero(every.kind == "grid")[[5, 60, 100]]
    p_instr_m[wrong, 0] += np.array([6e-3, -4e-3, 8e-3])[:, None]
    off = replace(every, measured=replace(every.measured, p_instr_m=p_instr_m))
    spoiled = calibrate(replace(campaign, observations=off))
    q_rad = every.of_kind("holdout").states.q_rad
    u_mm = [float(np.mean(model.predict(q_rad, frame="tool").u_mm)) for model in (spoiled, clean)]
    assert u_mm[0] == pytest.approx(u_mm[1], rel=0.25)


@pytest.mark.parametrize(
    ("ratio", "rows"), [(0.0, slice(None)), (3.0, slice(None)), (9.0, slice(3, 4))]
)
def test_poses_that_nothing_was_chosen_by_raise_the_promise_where_they_exceed_it(
    complete, ratio, rows
):
    campaign, model = complete
    fitted, apart = (
        model.as_modelled(average_repeats(campaign.observations.of_kind(kind)))
        for kind in ("grid", "holdout")
    )
    error_mm = np.sqrt(np.mean(model.deviations(apart).distance_mm ** 2))
    p_instr_m = apart.measured.p_instr_m.copy()
    off_m = ratio * 1e-3 * error_mm / np.sqrt(3.0)
    p_instr_m[rows] += np.random.default_rng(1).normal(0.0, off_m, p_instr_m[rows].shape)
    worse = replace(apart, measured=replace(apart.measured, p_instr_m=p_instr_m))
    without, found = discrepancy_of(model, fitted), discrepancy_of(model, fitted, kept_apart=worse)
    more_mm2 = found.error_mm**2 - without.error_mm**2
    if ratio != 3.0:  # chance, or a gross error
        np.testing.assert_array_equal(more_mm2, 0.0)
        return
    np.testing.assert_allclose(more_mm2, ratio**2 * error_mm**2, rtol=0.25)


@pytest.mark.parametrize(
    ("arm_mm", "gross", "least", "most"),
    [(0.0, False, 0.0, 0.0), (0.0, True, 0.0, 0.01), (0.06, False, 0.05, 0.07)],
)
def test_repeats_show_how_far_off_a_single_approach_is(complete, arm_mm, gross, least, most):
    campaign, model = complete
    grid = average_repeats(campaign.observations.of_kind("grid"))
    twice = grid.take(np.repeat(np.arange(len(grid)), 2))
    rng, p_instr_m = np.random.default_rng(1), twice.measured.p_instr_m.copy()
    u_m = np.sqrt(np.diagonal(twice.measured.stated_covariance, axis1=1, axis2=2))
    p_instr_m += rng.normal(0.0, u_m).reshape(p_instr_m.shape)  # of the instrument
    p_instr_m += rng.normal(0.0, 1e-3 * arm_mm / np.sqrt(3.0), (len(twice), 1, 3))
    p_instr_m[7] += 5e-3 * gross
    readings = replace(twice, measured=replace(twice.measured, p_instr_m=p_instr_m))
    poses, readings = model.as_modelled(grid), model.as_modelled(readings)
    assert repeatability_mm(model, poses) == 0.0  # nothing is repeated
    assert least <= repeatability_mm(model, readings) <= most
    found = discrepancy_of(model, poses, readings=readings)
    at_poses = replace(found, error_mm=np.zeros_like(found.error_mm))
    np.testing.assert_allclose(
        at_poses.error_at_mm(poses.states.q_rad), repeatability_mm(model, readings)
    )


def test_what_is_left_to_the_log_may_be_the_way_an_arm_arrives(complete):
    campaign, model = complete
    poses = with_arrivals(campaign.observations.of_kind("grid"))[0]
    poses = model.as_modelled(average_repeats(poses))
    along = AlongMove("arm", tuple(range(1, 7)))
    chain, terms = model.model.chain, (*model.model.terms, along)
    x = np.append(model.x, 4e-4)
    late = replace(model, model=Model(chain, terms), x=x, covariance=None)
    q_rad, off_rad = poses.states.q_rad, 4e-4 * poses.states.move_share
    places_m = [model.predict(q).T[:, :3, 3] for q in (q_rad, q_rad + off_rad)]
    off_mm = 1e3 * np.linalg.norm(places_m[1] - places_m[0], axis=1)
    np.testing.assert_array_equal(late.predict(q_rad).T, model.predict(q_rad).T)
    found = discrepancy_of(late, poses)
    assert found.repeatability_mm == pytest.approx(np.sqrt(np.mean(off_mm**2)), rel=0.01)
    assert discrepancy_of(model, poses).repeatability_mm == 0.0


def test_of_a_complete_model_little_is_lacking(complete):
    ratio, _, promised = ratio_and_share(*complete)
    assert 0.7 < ratio < 1.3
    assert np.sqrt(np.mean(promised.u_mm**2)) < 0.05


def test_it_is_saved_with_the_model(tmp_path):
    campaign = simulated(tmp_path, LARGE, poses=60, holdout_share=0.1)
    model = calibrate(campaign)
    save_model(model, tmp_path / "model.yaml")
    back = load_model(tmp_path / "model.yaml")
    q = campaign.observations.states.q_rad
    np.testing.assert_allclose(back.predict(q).u_mm, model.predict(q).u_mm, rtol=1e-12)
    np.testing.assert_array_equal(back.inside(q), model.inside(q))
    plain = model_to_plain(model)
    for key, value in (("error_mm", [-1.0]), ("distance_m", [np.nan]), ("turns", [True])):
        spoilt = {**plain, "discrepancy": {**plain["discrepancy"], key: value}}
        with pytest.raises(Exception, match="cannot be built"):
            model_from_plain(spoilt, where="model.yaml")
    old = model_from_plain({**plain, "discrepancy": None}, where="model.yaml").predict(q)
    np.testing.assert_array_equal(old.u_mm, old.u_parameters_mm)


def test_a_model_that_is_off_where_it_was_fitted_promises_no_less(tmp_path):
    campaign = simulated(tmp_path, (), poses=120)
    model = calibrate(campaign)
    poses = model.as_modelled(average_repeats(campaign.observations.of_kind("grid")))
    x = model.x.copy()
    x[[each.name == "delta_a_2" for each in model.model.parameters]] += 2e-4
    off = replace(model, x=x)
    found, found_off = (discrepancy_of(each, poses) for each in (model, off))
    np.testing.assert_array_equal(found.error_mm, model.discrepancy.error_mm)
    error_mm = off.deviations(poses).distance_mm
    noise_mm = model.deviations(poses).distance_mm
    beyond_mm = np.sqrt(np.mean(error_mm**2) - np.mean(noise_mm**2))
    assert beyond_mm > 0.05
    # a part of it is one of base and targets, which predictions do not hold
    assert found_off.error_mm.min() > 0.5 * beyond_mm


def rows_of(noise_mm):
    """Return rows of poses of which components (P, 3) have so much noise, and nothing else."""
    count, none = noise_mm.shape, np.zeros(0)
    weights, columns = np.ones(count), np.zeros((*count, 0))
    return RowsAboutFit(
        data=np.zeros(count), residual=np.zeros(count), weight=weights, columns=columns,
        sizes=none, parameter_index=none.astype(int), of_field=none.astype(bool), to_mm=weights,
        noise_mm2=noise_mm**2, of_parameters=1.0, components_factor=1.0, trust=np.ones(count[0]),
        before=Gaussian.none(0),
    )  # fmt: skip


@pytest.mark.parametrize("lack_mm", [0.0, 0.05])
def test_what_is_lacking_is_judged_where_noise_is_small(lack_mm):
    """As in depth and across a camera, or by a probe and a camera together."""
    noise_mm = np.full((200, 3), 0.03)
    noise_mm[:, 2] = noise_mm[::2] = 2.0
    rng = np.random.default_rng(3)
    error_mm = noise_mm * rng.normal(size=noise_mm.shape)
    error_mm += lack_mm * rng.normal(size=noise_mm.shape)
    rows = rows_of(noise_mm)
    square_mm2 = error_mm**2 - noise_mm**2
    found = rows.of_poses(square_mm2, rows.certainty(square_mm2))
    mean_mm2 = np.average(found.mm2, weights=found.certainty)
    assert np.sqrt(max(mean_mm2, 0.0)) == pytest.approx(np.sqrt(3.0) * lack_mm, abs=0.02)


def test_components_count_alike_where_noise_is_equal_or_the_noisy_ones_surely_show_more():
    square_mm2 = np.random.default_rng(0).normal(size=(50, 3))
    np.testing.assert_array_equal(rows_of(np.ones((50, 3))).certainty(square_mm2), 1.0)
    noise_mm = np.tile([0.1, 0.1, 1.0], (50, 1))
    in_depth_mm2 = np.tile([0.0, 0.0, 1.5], (50, 1))
    np.testing.assert_array_equal(rows_of(noise_mm).certainty(in_depth_mm2), 1.0)
    assert (rows_of(noise_mm).certainty(0.1 * in_depth_mm2)[:, 2] < 0.1).all()
