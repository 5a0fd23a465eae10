"""What has no name, predicted: where it is there, and only there."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from mended import write_simulated
from pa10cal.discovery import tuning
from pa10cal.discovery.field import by_joint, field_of, with_field
from pa10cal.discovery.nameless import with_terms
from pa10cal.fit.discrepancy import discrepancy_of
from pa10cal.fit.model_reading import load_model
from pa10cal.fit.model_writing import save_model
from pa10cal.interface import calibrate, read_campaign
from pa10cal.terms.effects.joint import Backlash, EncoderEccentricity, GearRatioError
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.structure import ToolSag
from pa10cal.terms.field import Field, Nameless
from pa10cal.terms.model import Model
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions

NOISE_MM = 0.02


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """An arm under a tracker, nothing hidden: its model, poses fitted and held out."""
    settings = SimulateOptions(
        robot="irb120",
        random_seed=5,
        without_touches=TrackerOptions(
            instrument="points", flexible_joints=(), poses=240, holdout_share=0.25
        ),
    )
    campaign = read_campaign(write_simulated(tmp_path_factory.mktemp("field") / "robot", settings))
    model = calibrate(campaign)
    poses = [model.as_modelled(campaign.observations.of_kind(kind)) for kind in ("grid", "holdout")]
    return model, *poses


def moved(model, poses, size_m, seed=0, rough=False):
    """Return poses as the model has them, moved by what no name describes, with noise."""
    q, rng = poses.states.q_rad, np.random.default_rng(seed)
    along = [np.sin(q[:, 0] + q[:, 1]), np.cos(q[:, 1] - 0.7 * q[:, 2]), np.sin(q[:, 0]) * q[:, 2]]
    if rough:  # it jumps where a joint passes an angle
        along = [np.sign(each) for each in (q[:, 0] + q[:, 1], q[:, 1] - 0.3, q[:, 0] * q[:, 2])]
    T_instr_ee = model.T_instr_base @ model.model.predict(poses.states, model.x)
    ideal = poses.measured.ideal(T_instr_ee, model.targets_m)
    noise = 1e-3 * NOISE_MM * rng.standard_normal(ideal.p_instr_m.shape)
    by_m = size_m * np.stack(along, axis=1)[:, None, :] + noise
    p_instr_m = np.where(np.isnan(poses.measured.p_instr_m), np.nan, ideal.p_instr_m + by_m)
    return replace(poses, measured=replace(poses.measured, p_instr_m=p_instr_m))


def rms_mm(model, poses):
    return float(np.sqrt(np.mean(model.deviations(poses).distance_mm ** 2)))


@pytest.fixture(scope="module")
def predicted(measured):
    """The model with a field, the poses that it learnt from, and others."""
    model, fitted, away = measured
    fitted, away = moved(model, fitted, 2e-4), moved(model, away, 2e-4, seed=1)
    return with_field(model, field_of(model, fitted)), fitted, away


def test_a_smooth_error_without_a_name_is_predicted_at_other_poses(measured, predicted):
    model, _, away = measured[0], *predicted[1:]
    noise_mm = np.sqrt(3.0) * NOISE_MM
    before = rms_mm(model, away) ** 2 - noise_mm**2
    after = rms_mm(predicted[0], away) ** 2 - noise_mm**2
    assert after < 0.1 * before


def test_an_error_that_jumps_is_left_to_a_rough_displacement(measured, monkeypatch):
    model, fitted, away = measured
    fitted, away = (moved(model, each, 2e-4, seed=2, rough=True) for each in (fitted, away))
    found = field_of(model, fitted)
    assert [term.kernel for term in found.terms] == ["exponential"]
    never = replace(tuning.FIELD, rough_length=1e-6)  # poses say nothing of each other
    monkeypatch.setattr("pa10cal.discovery.field.FIELD", never)
    smooth = field_of(model, fitted)
    assert [term.kernel for term in smooth.terms] == ["squared exponential"]
    rough_mm, smooth_mm = (rms_mm(with_field(model, each), away) for each in (found, smooth))
    assert rough_mm < smooth_mm < rms_mm(model, away)


@pytest.mark.slow_but_one_in(6)
@pytest.mark.parametrize("seed", range(6))
def test_of_noise_alone_there_is_no_field(measured, seed):
    model, fitted, _ = measured
    assert field_of(model, moved(model, fitted, 0.0, seed)) is None


def test_of_few_poses_there_is_none(predicted, measured):
    assert field_of(measured[0], predicted[1].take(np.arange(39))) is None


def test_beside_a_fine_map_there_is_none(predicted, measured):
    model = measured[0]

    def with_map(knots):
        terms = (*model.model.terms, JointErrorMap("joint 2", knots=knots))
        x = np.concatenate([model.x, np.zeros(knots)])
        return replace(model, model=Model(model.model.chain, terms), x=x, covariance=None)

    assert field_of(with_map(120), predicted[1]) is None
    assert field_of(with_map(12), predicted[1]) is not None


def test_what_it_promises_is_met(predicted):
    model, fitted, away = predicted
    known = replace(model, discrepancy=discrepancy_of(model, fitted))
    promised = known.predict(away.states.q_rad, frame="tool")
    total_mm = np.hypot(promised.u_mm, np.sqrt(3.0) * NOISE_MM)
    error_mm = known.deviations(away).distance_mm
    assert 0.7 < np.sqrt(np.mean(error_mm**2) / np.mean(total_mm**2)) < 1.3
    assert np.mean(error_mm <= 1.96 * total_mm) > 0.9


def test_where_nothing_was_measured_it_is_uncertain(measured, predicted):
    model, fitted, _ = predicted
    far, near = np.array([[2.8, -1.7, 1.2, 2.5, -2.0, -3.0]]), fitted.states.q_rad

    def beyond_mm(q):
        with_it, without = (each.predict(q).u_parameters_mm for each in (model, measured[0]))
        return np.sqrt(with_it**2 - without**2)

    assert beyond_mm(far)[0] > 2.0 * np.median(beyond_mm(near))


def test_it_is_saved_with_the_model_under_a_key_of_its_own(predicted, tmp_path):
    model, fitted, _ = predicted
    save_model(model, tmp_path / "model.yaml")
    plain = yaml.safe_load((tmp_path / "model.yaml").read_text())
    assert plain["field"]["id"] == "field"
    assert "field" not in [term["id"] for term in plain["terms"]]
    back, q = load_model(tmp_path / "model.yaml"), fitted.states.q_rad
    for name in ("T", "u_mm"):
        one, other = (getattr(each.predict(q), name) for each in (back, model))
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    T = model.predict(q[:5]).T
    np.testing.assert_allclose(model.compensate(T, seed=q[:5]).q, q[:5], atol=1e-7)


def test_the_part_of_a_joint_is_what_goes_with_it(measured):
    model, fitted, _ = measured
    q = fitted.states.q_rad
    places, lever_m = tuple(map(tuple, q[:7].tolist())), (1e-9, 0.6, *(1e-9,) * 4)
    alone = Field(places, lever_m, (True,) * 6, length_m=0.5, size_m=2e-4)
    at = with_terms(model, [alone])
    assert by_joint(model, at, fitted.states).tolist() == [0.0] * 6
    at = replace(at, x=np.append(model.x, 1e-4 * np.random.default_rng(0).standard_normal(21)))
    parts = by_joint(model, at, fitted.states)
    np.testing.assert_allclose(parts, np.eye(6)[1], atol=1e-9)


# What effects do together.

HIDDEN = (GearRatioError("joint 2"), EncoderEccentricity("joint 3", 1.0), Backlash("joint 5"))
OTHERS = (GearRatioError("joint 1"), EncoderEccentricity("joint 5", 1.0), Backlash("joint 2"))


@pytest.fixture(scope="module")
def together(measured):
    """The model with effects beside it, the poses that they were learnt from, and others."""
    model, fitted, away = measured
    hidden = with_terms(model, [Nameless(HIDDEN, (1e-3, 3e-4, 3e-4, 3e-4))])
    hidden = replace(hidden, x=np.append(model.x, [4e-4, 5e-4, -3e-4, 2e-4]))
    fitted, away = moved(hidden, fitted, 0.0), moved(hidden, away, 0.0, seed=1)
    found = field_of(model, fitted, (*HIDDEN, *OTHERS))
    return found, with_field(model, found), fitted, away


@pytest.mark.slow
def test_effects_are_predicted_together_as_far_as_the_noise_lets_them(measured, together):
    found, model, _, away = together
    assert [term.id for term in found.terms] == ["nameless"]
    assert found.by_joint.sum() == pytest.approx(1.0)
    noise_mm = np.sqrt(3.0) * NOISE_MM
    assert rms_mm(measured[0], away) > 5.0 * noise_mm
    assert rms_mm(model, away) < 1.3 * noise_mm
    without = with_field(measured[0], field_of(measured[0], together[2]))
    assert rms_mm(without, away) > 1.5 * noise_mm


def test_the_model_beside_which_they_stand_stays_as_it_is(measured, together):
    model, by_names = together[1], measured[0]
    np.testing.assert_array_equal(model.x[: len(by_names.x)], by_names.x)
    np.testing.assert_array_equal(model.T_instr_base, by_names.T_instr_base)
    np.testing.assert_array_equal(model.targets_m, by_names.targets_m)


def test_what_no_reading_shows_makes_no_prediction_less_certain(tmp_path):
    """Heights of base and targets of a SCARA are one: terms without a name leave both open."""
    plan = TrackerOptions(instrument="points", flexible_joints=(), poses=120, targets=3)
    settings = SimulateOptions(robot="gx4_351s", random_seed=5, without_touches=plan)
    campaign = read_campaign(write_simulated(tmp_path / "robot", settings))
    model = calibrate(campaign)
    hidden = with_terms(model, [Nameless(HIDDEN[:1], (1e-3,))])
    hidden = replace(hidden, x=np.append(model.x, 4e-4))
    poses = moved(hidden, model.as_modelled(campaign.observations.of_kind("grid")), 0.0)
    effects = (HIDDEN[0], EncoderEccentricity("joint 1", 1.0), ToolSag("tool"))
    found = field_of(model, poses, effects)
    assert [term.id for term in found.terms] == ["nameless"]
    every = with_field(model, found)
    without, beside = (
        each.predict(poses.states.q_rad, frame="tool").u_parameters_mm for each in (model, every)
    )
    assert np.all(beside < 5.0 * without)


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("seed", range(3))
def test_of_noise_alone_no_effects_are_beside_the_model(measured, seed):
    model, fitted, _ = measured
    assert field_of(model, moved(model, fitted, 0.0, seed), (*HIDDEN, *OTHERS)) is None


@pytest.mark.slow
def test_a_smooth_error_that_no_effect_makes_is_left_to_the_displacement(measured, predicted):
    *_, last = field_of(measured[0], predicted[1], (*HIDDEN, *OTHERS)).terms
    assert last.id == "field"


def test_they_are_saved_with_the_model_and_compensated(together, tmp_path):
    _, model, fitted, away = together
    model = replace(model, discrepancy=discrepancy_of(model, fitted))
    save_model(model, tmp_path / "model.yaml")
    back, q = load_model(tmp_path / "model.yaml"), away.states.q_rad
    for name in ("T", "u_mm"):
        one, other = (getattr(each.predict(q), name) for each in (back, model))
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    T = back.predict(q[:5]).T
    np.testing.assert_allclose(back.compensate(T, seed=q[:5]).q, q[:5], atol=1e-7)
