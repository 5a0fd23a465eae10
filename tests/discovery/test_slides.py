"""Joints that slide: a rail that is not straight, leads of a gantry that are off."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

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


@pytest.mark.slow
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


# A gantry with a wrist under a tracker, written down here: three reflectors on the tool.

GANTRY = """
name: gantry
rows:
- {prismatic: true, alpha_deg: -90, limits_m: [0, 4]}
- {theta_deg: -90, prismatic: true, alpha_deg: -90, limits_m: [0, 2]}
- {prismatic: true, limits_m: [0, 1]}
- {d_m: 0.3, alpha_deg: -90, limits_deg: [-180, 180]}
- {alpha_deg: 90, limits_deg: [-110, 110]}
- {d_m: 0.2, limits_deg: [-300, 300]}
"""
CAMPAIGN = """
schema: pa10cal-campaign/1
name: gantry
provenance: synthetic
robot: gantry
instrument: {kind: points, uncertainty_mm: 0.02}
tool:
  mass_kg: 2
  com_mm: [0, 0, 60]
  load_point_mm: [0, 0, 80]
  balls_mm: {T1: [100, 0, 100], T2: [-50, 87, 140], T3: [-50, -87, 100]}
gravity_m_s2: [0, 0, -9.81]
reference_temperature_C: 20
files: {poses: poses.csv}
holdout: {every: 5}
"""
_THETA_DEG, _ALPHA_DEG = [0, -90, 0, 0, 0, 0], [-90, -90, 0, -90, 90, 0]
_D_M = [0.0, 0.0, 0.0, 0.3, 0.0, 0.2]
_TARGETS_M = 1e-3 * np.array([[100, 0, 100], [-50, 87, 140], [-50, -87, 100]])


def gantry_seen_m(q, leads):
    """Targets (P, 3, 3) in the base frame, slides moved by (1 + leads) times their positions."""
    R, p_m = Rotation.identity(len(q)), np.zeros((len(q), 3))
    for joint in range(6):
        slides = joint < 3
        d_m = _D_M[joint] + (q[:, joint] * (1.0 + leads[joint]) if slides else 0.0)
        theta = np.radians(_THETA_DEG[joint]) + (0.0 if slides else q[:, joint])
        theta = np.broadcast_to(theta, len(q))
        p_m = p_m + R.apply(np.outer(np.broadcast_to(d_m, len(q)), [0.0, 0.0, 1.0]))
        R = R * Rotation.from_euler("z", theta[:, None])
        R = R * Rotation.from_euler("x", _ALPHA_DEG[joint], degrees=True)
    return p_m[:, None] + np.einsum("pij,tj->pti", R.as_matrix(), _TARGETS_M)


def gantry_off_by(leads_ppm, folder, moved_m=None, scale=1.0):
    """A campaign of 150 poses of a gantry with these errors of its leads.

    Places p_m (P, 3, 3) move by `moved_m(q, p_m)`; the instrument reads `scale` times all lengths.
    """
    rng = np.random.default_rng(11)
    low, high = np.array([[0.1, 0.1, 0.05, -3, -1.8, -3], [3.9, 1.9, 0.95, 3, 1.8, 3]])
    q = rng.uniform(low, high, (150, 6))
    p_m = gantry_seen_m(q, 1e-6 * np.array(leads_ppm))
    if moved_m is not None:
        p_m = p_m + moved_m(q, p_m)
    turned_mm = Rotation.from_euler("z", 0.4).apply(1e3 * p_m.reshape(-1, 3))
    p_mm = turned_mm + np.array([2e3, -500.0, 300.0])
    p_mm = scale * p_mm.reshape(-1, 9) + rng.normal(0.0, 0.02, (150, 9))
    columns = {"time_s": 30.0 * np.arange(150), "kind": "grid", "load_N": 0, "repeat": 1}
    columns["pose"] = [f"P{k:03d}" for k in range(150)]
    columns |= {f"q{k + 1}_mm": 1e3 * q[:, k] for k in range(3)}
    columns |= {f"q{k + 1}_deg": np.degrees(q[:, k]) for k in range(3, 6)}
    names = [f"T{target}_{axis}_mm" for target in (1, 2, 3) for axis in "xyz"]
    columns |= dict(zip(names, p_mm.T, strict=True))
    pd.DataFrame(columns).to_csv(folder / "poses.csv", index=False)
    (folder / "gantry.yaml").write_text(GANTRY)
    (folder / "campaign.yaml").write_text(CAMPAIGN)
    return pa10cal.read_campaign(folder)


@pytest.mark.slow
def test_equal_leads_are_as_likely_as_the_scale_of_the_instrument(tmp_path):
    campaign = gantry_off_by([60, 60, 60], tmp_path)
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    (name,) = found.effects
    assert (name.id, [other.id for other in name.alternatives]) == ("slide_scale", ["scale"])
    assert name.probability == pytest.approx(0.5, abs=0.02)
    assert name.parameters["s"].value == pytest.approx(60e-6, abs=4e-6)
    assert found.holdout.after.rms_mm < 1.1 * 0.02 * np.sqrt(3.0)
    # Under the other explanation the robot is smaller by as much: predictions hold both.
    found.model.save(tmp_path / "model.yaml")
    model = pa10cal.load_model(tmp_path / "model.yaml")
    q = np.array([[0.5, 0.3, 0.2, 0.0, 0.5, 0.0], [3.5, 1.8, 0.9, 0.0, 0.5, 0.0]])
    at, under_scale = (
        each.predict(q, frame="target_T1") for each in (model, model.otherwise.model)
    )
    apart_mm = 1e3 * np.linalg.norm((at.T - under_scale.T)[:, :3, 3], axis=1)
    assert apart_mm[1] == pytest.approx(60e-3 * np.linalg.norm(at.T[1, :3, 3]), rel=0.1)
    np.testing.assert_allclose(at.u_mm, np.hypot(at.u_parameters_mm, 0.703 * apart_mm), rtol=0.2)


@pytest.mark.slow
def test_a_lead_beside_a_scale_may_be_those_of_the_other_axes(tmp_path):
    """Of two wrong leads and one factor of all with the third lead, poses tell neither."""
    campaign = gantry_off_by([60, 0, 60], tmp_path)
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    (lead,) = (name for name in found.effects if name.id == "gear_ratio_error")
    assert lead.of == "joint 2"
    assert lead.probability == pytest.approx(0.5, abs=0.02)
    assert [other.of for other in lead.alternatives] == ["joint 1", "joint 3"]


@pytest.mark.slow
def test_leads_of_single_axes_are_told_axis_by_axis(tmp_path):
    campaign = gantry_off_by([80, -40, 120], tmp_path)
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    eps = {name.of: name.parameters["eps"].value for name in found.effects}
    assert eps == pytest.approx({"joint 1": 80e-6, "joint 2": -40e-6, "joint 3": 120e-6}, abs=6e-6)


@pytest.mark.slow
def test_an_uneven_lead_is_no_rail_that_is_not_straight(tmp_path):
    def stretched_m(q, p_m):  # by 0.4 mm along the first axis, more towards its end
        return 4e-4 * (q[:, :1, None] / 4.0) ** 2 * [0.0, 0.0, 1.0]

    campaign = gantry_off_by([0, 0, 0], tmp_path, stretched_m)
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    names = {(name.id, name.of): name for name in found.effects}
    assert set(names) == {("gear_ratio_error", "joint 1"), ("slide_positioning", "joint 1")}
    lead, rest = names["gear_ratio_error", "joint 1"], names["slide_positioning", "joint 1"]
    assert lead.parameters["eps"].value == pytest.approx(1e-4, abs=1e-5)
    # Over half a stroke h about its middle, u^2 h^2 has 2/3 h^2 of Legendre's second polynomial.
    shift_m = 4e-4 * (1.9 / 4.0) ** 2 * (2.0 / 3.0) / np.sqrt(5.0)
    assert rest.parameters["shift"].value == pytest.approx(shift_m, rel=0.1)


@pytest.mark.slow
def test_a_lead_is_told_beside_a_rail_that_sags(tmp_path):
    """Either alone leaves more than a smooth map over the instrument's frame does."""

    def sags_m(q, p_m):  # by 0.2 mm between supports 4 m apart; the carriage follows the slope
        along = [0.0, 0.0, 1.0]
        out = q[:, :1, None] / 4.0
        turn = 2e-4 * (1.0 - 2.0 * out) * [1.0, 0.0, 0.0]
        shift = -8e-4 * out * (1.0 - out) * [0.0, 1.0, 0.0]
        return shift + np.cross(turn, p_m - q[:, :1, None] * along)

    campaign = gantry_off_by([100, 0, 0], tmp_path, sags_m)
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    names = {(name.id, name.of) for name in found.effects}
    assert names == {("gear_ratio_error", "joint 1"), ("slide_error", "joint 1")}


@pytest.mark.slow
def test_with_its_scale_in_the_model_targets_are_as_far_apart_as_they_are(tmp_path):
    """Readings 0.2 % too long; the model's targets are not."""
    campaign = gantry_off_by([0, 0, 0], tmp_path, scale=1.002)
    given = CalibrationOptions(effects=(EffectOfPlace(id="scale", of="instrument"),))
    pairs = np.array([[0, 1], [1, 2], [2, 0]]).T

    def apart_m(targets_m):
        one, other = targets_m.reshape(3, 3)[pairs]
        return np.linalg.norm(one - other, axis=1)

    without, model = pa10cal.calibrate(campaign), pa10cal.calibrate(campaign, given)
    true_m = apart_m(_TARGETS_M)
    assert np.abs(apart_m(without.targets_m) / true_m - 1.002).max() < 1e-4
    assert np.abs(apart_m(model.targets_m) / true_m - 1.0).max() < 1e-4
    (scale,) = model.model.terms_of("effect")
    assert model.values_of(scale)[0] == pytest.approx(0.002, abs=1e-5)


# A SCARA under a tracker, two reflectors on its quill. Its links take up a scale of the instrument,
# as they are free to be longer; only the stroke of the quill shows it.

SCARA = """
name: own_scara
rows:
- {d_m: 0.32, a_m: 0.35, limits_deg: [-130, 130]}
- {a_m: 0.28, alpha_deg: 180, limits_deg: [-140, 140]}
- {d_m: 0.05, prismatic: true, limits_m: [0, 0.2]}
- {limits_deg: [-180, 180]}
"""


def scara_read_by(scale, folder):
    """A campaign of 140 poses of a SCARA, by an instrument that reads `scale` times all lengths."""
    rng = np.random.default_rng(11)
    low, high = np.array([[-1.4, -1.5, 0.0, -2.0], [1.4, 1.5, 0.2, 2.0]])
    q = rng.uniform(low, high, (140, 4))
    turned, out = q[:, 0] + q[:, 1], np.zeros((140, 2, 3))
    out[:, :, 0] = (0.3503 * np.cos(q[:, 0]) + 0.2796 * np.cos(turned))[:, None]
    out[:, :, 1] = (0.3503 * np.sin(q[:, 0]) + 0.2796 * np.sin(turned))[:, None]
    out[:, :, 2] = 0.27 - q[:, 2:3] - np.array([0.06, 0.09])
    for target, (x, y) in enumerate([(0.11, -0.02), (-0.07, -0.10)]):
        at = turned - q[:, 3]
        out[:, target, 0] += np.cos(at) * x - np.sin(at) * y
        out[:, target, 1] += np.sin(at) * x + np.cos(at) * y
    tilted_m = Rotation.from_euler("xyz", [0.02, -0.01, 0.7]).apply(out.reshape(-1, 3))
    p_mm = scale * 1e3 * (tilted_m + np.array([2.4, -0.7, -0.5])).reshape(140, 6)
    p_mm += rng.normal(0.0, 0.01, p_mm.shape)
    columns = {"time_s": 20.0 * np.arange(140), "kind": "grid", "load_N": 0, "repeat": 1}
    columns["pose"] = [f"P{k:03d}" for k in range(140)]
    columns |= {f"q{k + 1}_deg": np.degrees(q[:, k]) for k in (0, 1, 3)}
    columns["q3_mm"] = 1e3 * q[:, 2]
    columns |= dict(zip([f"T{k}_{axis}_mm" for k in (1, 2) for axis in "xyz"], p_mm.T, strict=True))
    pd.DataFrame(columns).to_csv(folder / "poses.csv", index=False)
    (folder / "own_scara.yaml").write_text(SCARA)
    stated = CAMPAIGN.replace("robot: gantry", "robot: own_scara").replace("0.02}", "0.01}")
    places = stated[stated.index("  balls_mm") : stated.index("gravity")]
    (folder / "campaign.yaml").write_text(stated.replace(places, ""))
    return pa10cal.read_campaign(folder)


@pytest.mark.slow
def test_a_scale_that_only_a_quill_shows_is_as_likely_as_the_lead_of_that(tmp_path):
    campaign = scara_read_by(1.0 + 2e-4, tmp_path)
    calibrated = pa10cal.calibrate(campaign)
    found = pa10cal.discover(campaign, calibrated)
    (name,) = found.effects
    likely = {(each.id, each.of): chance for each, chance in name.explanations.named}
    assert likely["scale", "instrument"] == pytest.approx(0.48, abs=0.03)
    assert likely["gear_ratio_error", "joint 3"] == pytest.approx(0.48, abs=0.03)
    assert "scale" not in {each.effect.id for each in found.not_testable}
    # What no pose shows, the height of base and flange, is where it was under either of them.
    for model in (found.model, found.model.otherwise.model):
        assert model.T_instr_base[2, 3] == pytest.approx(calibrated.T_instr_base[2, 3], abs=5e-4)
    q = np.array([[0.5, 0.3, 0.1, 0.0]])
    at, under = (
        each.predict(q, frame="target_T1") for each in (found.model, found.model.otherwise.model)
    )
    assert 1e3 * np.linalg.norm((at.T - under.T)[0, :3, 3]) < 0.5
    assert at.u_mm[0] < 0.5
