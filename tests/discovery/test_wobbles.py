"""The axis of a joint wobbles in its bearings: what is hidden is found, given and saved."""

import numpy as np
import pytest

import pa10cal
from mended import write_simulated
from pa10cal.calibration.options import CalibrationOptions, EffectOfPlace
from pa10cal_lab.cell.effects.effect import Site
from pa10cal_lab.cell.effects.structure import SimulatedAxisWobble
from pa10cal_lab.cell.options import SimulateOptions

NOISE_MM = 0.03
JOINT = 2


def hidden_tilts(rings):
    """What of the line through two rings is no geometry, by the parameters of the effect, (6,)."""
    apart_m = rings["apart_m"]
    slope = {
        axis: (np.array(rings[f"upper_{axis}"]) - rings[f"lower_{axis}"]) / apart_m for axis in "xy"
    }
    about_x, about_y = -slope["y"], slope["x"]
    # Of the first wave the part that runs against the joint.
    back = 0.5 * np.array([about_x[0] - about_y[1], about_x[1] + about_y[0]])
    return np.concatenate([back, about_x[2:4], about_y[2:4]])


def simulated(folder, effect, parameters, *, joint=JOINT, **plan):
    """Return a campaign of an arm under a tracker that hides an effect at a joint."""
    hidden = [{"id": effect, "of": f"joint {joint}", "parameters": parameters}]
    usual = {"instrument": "pose", "poses": 200, "position_mm": NOISE_MM, "hardening": False}
    plan = {**usual, **plan}
    options = SimulateOptions.model_validate(
        {"robot": "ur10", "random_seed": 4, "hidden_effects": hidden, "without_touches": plan}
    )
    return pa10cal.read_campaign(write_simulated(folder / "raw", options))


@pytest.fixture(scope="module")
def wobbling(tmp_path_factory):
    """Return a campaign of an arm of which an axis wobbles, and by how much."""
    rings = SimulatedAxisWobble.at_size(Site(f"joint {JOINT}"), 6.0, np.random.default_rng(5))
    campaign = simulated(tmp_path_factory.mktemp("wobble"), "axis_wobble", rings)
    return campaign, hidden_tilts(rings)


@pytest.mark.slow
def test_it_is_the_only_name(wobbling):
    campaign, _ = wobbling
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    assert [(each.id, each.of) for each in found.effects] == [("axis_wobble", f"joint {JOINT}")]


@pytest.mark.slow
def test_it_is_named_where_repeats_judge(tmp_path):
    """Before maps and couplings of other joints, which follow it in few poses."""
    rings = SimulatedAxisWobble.at_size(Site("joint 5"), 8.0, np.random.default_rng(5))
    campaign = simulated(tmp_path, "axis_wobble", rings, joint=5, poses=50, repeats=3)
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    assert [(each.id, each.of) for each in found.effects] == [("axis_wobble", "joint 5")]


@pytest.mark.slow
@pytest.mark.parametrize("plan", [{}, {"poses": 50, "repeats": 3}], ids=["once", "repeated"])
def test_a_soft_bearing_is_no_wobble(tmp_path, plan):
    """Softer about one axis than about another, under a moment that is much the same everywhere."""
    soft = {"soft": 3e-5, "stiff": 5e-6, "phi": 0.7}
    campaign = simulated(tmp_path, "soft_bearing", soft, joint=3, **plan)
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    assert found.verdict != "none"
    assert "axis_wobble" not in {each.id for each in found.effects}


@pytest.mark.slow
def test_an_axis_that_tilts_is_no_link_that_bends_where_weights_are_stated(tmp_path):
    """As stiff about one line across it as about another."""
    soft = {"soft": 3e-5, "stiff": 3e-5, "phi": 0.0}
    campaign = simulated(tmp_path, "soft_bearing", soft, joint=4)
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    (tilt,) = found.effects
    assert (tilt.id, tilt.of) == ("lateral_compliance", "joint 4")
    assert tilt.probability > 0.9
    for each in tilt.parameters.values():
        assert 0.6 < each.value / 3e-5 < 1.2  # less, as it is expected to be small


@pytest.mark.slow
def test_given_its_size_comes_back_and_held_out_poses_gain(wobbling, tmp_path):
    campaign, wanted = wobbling
    given = CalibrationOptions(effects=(EffectOfPlace(id="axis_wobble", of=f"joint {JOINT}"),))
    without, model = pa10cal.calibrate(campaign), pa10cal.calibrate(campaign, given)
    (term,) = model.model.terms_of("effect")
    columns = model.model.columns_of(term)
    u = np.sqrt(np.diag(model.covariance)[columns])
    off = model.x[columns] - wanted
    assert np.all(np.abs(off) < 4.0 * u)
    assert np.linalg.norm(off) < 0.2 * np.linalg.norm(wanted)
    rest = campaign.observations.of_kind("holdout")
    errors_mm = [
        float(np.sqrt(np.mean(each.deviations(each.as_modelled(rest)).distance_mm ** 2)))
        for each in (without, model)
    ]
    assert errors_mm[1] < 0.6 * errors_mm[0]
    model.save(tmp_path / "model.yaml")
    again, q_rad = pa10cal.load_model(tmp_path / "model.yaml"), rest.states.q_rad
    np.testing.assert_allclose(again.predict(q_rad).T, model.predict(q_rad).T, atol=1e-12)
