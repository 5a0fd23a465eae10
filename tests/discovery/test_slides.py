"""An arm on a rail that is not straight: what is hidden is found, given and saved."""

import numpy as np
import pytest

import pa10cal
from mended import write_simulated
from pa10cal.calibration.options import CalibrationOptions, EffectOfPlace
from pa10cal.files.arms import load_arm
from pa10cal_lab.cell.effects.effect import Site
from pa10cal_lab.cell.effects.slide import SimulatedSlideError
from pa10cal_lab.cell.individual import draw_unstated, put_on_slide
from pa10cal_lab.cell.options import SimulateOptions, SlideOptions

STROKE_M = 2.0
NOISE_MM = 0.03


@pytest.fixture(scope="module", params=[True, False], ids=["not straight", "straight"])
def on_rail(request, tmp_path_factory):
    """Return a campaign of an arm on a rail, its folder and whether the rail is not straight."""
    rng = np.random.default_rng(4)
    own, tool_kg = draw_unstated(load_arm("irb120"), rng)
    own = put_on_slide(own, SlideOptions(kind="rail", stroke_m=STROKE_M), rng)
    error = SimulatedSlideError.at_size(Site("joint 1", stroke_m=(0.0, STROKE_M)), 1.0, rng)
    hidden = [{"id": "slide_error", "of": "joint 1", "parameters": error}]
    plan = {
        "instrument": "points",
        "poses": 200,
        "tool_mass_kg": tool_kg,
        "position_mm": NOISE_MM,
        "unstated": own.model_dump(),
    }
    options = SimulateOptions.model_validate(
        {
            "robot": "irb120",
            "random_seed": 4,
            "hidden_effects": hidden if request.param else [],
            "without_touches": plan,
        }
    )
    raw = tmp_path_factory.mktemp("rail") / "raw"
    return pa10cal.read_campaign(write_simulated(raw, options)), request.param


@pytest.mark.slow
def test_a_rail_is_named_where_it_is_not_straight_and_only_there(on_rail):
    campaign, hidden = on_rail
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    names = [(each.id, each.of) for each in found.effects]
    assert names == ([("slide_error", "joint 1")] if hidden else [])


@pytest.mark.slow_but_one_in(2)
def test_given_it_leaves_the_noise_and_comes_back_from_a_file(on_rail, tmp_path):
    campaign, hidden = on_rail
    if not hidden:
        pytest.skip("nothing to find")
    given = CalibrationOptions(effects=(EffectOfPlace(id="slide_error", of="joint 1"),))
    without, model = pa10cal.calibrate(campaign), pa10cal.calibrate(campaign, given)
    rest = campaign.observations.of_kind("holdout")
    errors_mm = [
        float(np.sqrt(np.mean(each.deviations(each.as_modelled(rest)).distance_mm ** 2)))
        for each in (without, model)
    ]
    assert errors_mm[1] < min(3.0 * NOISE_MM, 0.3 * errors_mm[0])
    model.save(tmp_path / "model.yaml")
    again, q_rad = pa10cal.load_model(tmp_path / "model.yaml"), rest.states.q_rad
    np.testing.assert_allclose(again.predict(q_rad).T, model.predict(q_rad).T, atol=1e-12)
