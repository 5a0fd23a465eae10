"""Effects that are given and that no search tries: axes that tilt under load, lines of gears."""

from dataclasses import replace

import numpy as np
import pytest

import pa10cal
from mended import write_simulated
from pa10cal.calibration.campaign import calibrated_record
from pa10cal.calibration.load_case import LoadCase
from pa10cal.calibration.options import CalibrationOptions, EffectOfPlace
from pa10cal.commands.models import open_target
from pa10cal.discovery.given_record import record_with_effects
from pa10cal.errors import CalibrationError
from pa10cal.options import DiscoveryOptions
from pa10cal.results.calibration import InputFinding
from pa10cal_lab.cell.options import HiddenEffectOptions, SimulateOptions, TrackerOptions

#: Tilts of joint 3 [rad/(N m)].
TILTS = {"C_x": 4e-6, "C_y": 8e-6}


@pytest.fixture(scope="module")
def tilting(tmp_path_factory):
    """Return a campaign of an arm whose third joint tilts."""
    hidden = HiddenEffectOptions(id="lateral_compliance", of="joint 3", parameters=TILTS)
    options = SimulateOptions(
        robot="ur10",
        random_seed=3,
        hidden_effects=(hidden,),
        without_touches=TrackerOptions(instrument="pose", poses=400),
    )
    return pa10cal.read_campaign(write_simulated(tmp_path_factory.mktemp("given") / "raw", options))


def _rms_mm(model, poses):
    """Return the error of positions, by the places that are measured."""
    left = model.deviations(model.as_modelled(poses)).distance_mm
    return float(np.sqrt(np.mean(left**2)))


def given(of: str) -> CalibrationOptions:
    return CalibrationOptions(effects=(EffectOfPlace(id="lateral_compliance", of=of),))


@pytest.mark.slow
def test_tilts_of_a_joint_are_found_where_they_are_given(tilting, tmp_path):
    without = pa10cal.calibrate(tilting)
    model = pa10cal.calibrate(tilting, given("joint 3"))
    values = model.parameters.set_index(["term", "of", "parameter"])
    for name, true in TILTS.items():
        found = values.loc["lateral_compliance", "joint 3", name]
        assert abs(found["value"] - true) < 4.0 * found["std"]
        assert found["std"] < 0.3 * true
    rest = tilting.observations.of_kind("holdout")
    errors = [_rms_mm(each, rest) for each in (without, model)]
    assert errors[1] < errors[0]
    model.save(tmp_path / "model.yaml")
    again = pa10cal.load_model(tmp_path / "model.yaml")
    q_rad = rest.states.q_rad
    assert again.model.chain.bends == model.model.chain.bends
    np.testing.assert_allclose(again.predict(q_rad).T, model.predict(q_rad).T, atol=1e-12)


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("of", ["joint 1", "joint 7", "base"])
def test_a_joint_that_cannot_tilt_is_refused(tilting, of):
    with pytest.raises(CalibrationError, match=f"no lateral_compliance of {of}") as refused:
        pa10cal.calibrate(tilting, given(of))
    assert refused.value.allowed == ", ".join(f"joint {k}" for k in range(2, 7))


@pytest.fixture(scope="module")
def geared(tmp_path_factory):
    """Return a campaign of an arm whose third gear errs 70.5 times a turn."""
    line = {"A": 2e-4, "phi": 0.3, "k": 70.5}
    options = SimulateOptions(
        robot="ur10",
        random_seed=4,
        hidden_effects=(HiddenEffectOptions(id="gear_line", of="joint 3", parameters=line),),
        without_touches=TrackerOptions(instrument="pose", poses=200),
    )
    return pa10cal.read_campaign(
        write_simulated(tmp_path_factory.mktemp("geared") / "raw", options)
    )


def of_gear(of: str) -> CalibrationOptions:
    return CalibrationOptions(effects=(EffectOfPlace(id="gear_line", of=of),))


def test_the_cycles_of_a_gear_are_found_where_its_joint_is_given(geared):
    model = pa10cal.calibrate(geared, of_gear("joint 3"))
    values = model.parameters.set_index(["term", "of", "parameter"])
    amount, cycles = (values.loc["gear_line", "joint 3", name] for name in ("A", "k"))
    assert amount["value"] == pytest.approx(2e-4, rel=0.1)
    assert abs(cycles["value"] - 70.5) < 4.0 * cycles["std"] < 0.2


def test_an_effect_that_is_listed_twice_is_there_once(geared):
    twice = CalibrationOptions(effects=2 * of_gear("joint 3").effects)
    model = pa10cal.calibrate(geared, twice)
    assert model.grade != "not_converged"
    assert [term.of for term in model.model.terms_of("effect")] == ["joint 3"]


def test_findings_about_the_input_are_not_lost_where_effects_are_given(geared):
    finding = InputFinding(
        what="is logged twice", where="joint 2", remedy="check it", kind="joint_order"
    )
    case = LoadCase(geared.description, geared.arm, geared.observations, findings=(finding,))
    without = calibrated_record(case)
    found = record_with_effects(of_gear("joint 3").effects, without, case, DiscoveryOptions())
    assert found.health.findings == without.health.findings == (finding,)
    assert found.health.grade == "suspect_input"
    assert set(without.warnings) - set(found.warnings) == {without.health.line}


def test_a_joint_whose_gear_shows_no_line_is_refused(geared):
    with pytest.raises(CalibrationError, match="no number of cycles") as refused:
        pa10cal.calibrate(geared, of_gear("joint 2"))
    assert "joint 3" in refused.value.allowed


@pytest.fixture(scope="module")
def eccentric(tmp_path_factory):
    """Return campaigns with three targets, each of an arm with an eccentric encoder."""

    def once(robot: str, joint: str) -> pa10cal.Campaign:
        hidden = HiddenEffectOptions(
            id="encoder_eccentricity", of=joint, parameters={"A": 1e-3, "phi": 0.5}
        )
        options = SimulateOptions(
            robot=robot,
            random_seed=6,
            hidden_effects=(hidden,),
            without_touches=TrackerOptions(instrument="points", poses=150),
        )
        folder = tmp_path_factory.mktemp(robot) / "raw"
        return pa10cal.read_campaign(write_simulated(folder, options))

    return {"ur10": once("ur10", "joint 3"), "gx4_351s": once("gx4_351s", "joint 2")}


def with_effect(campaign, kind, of, **options):
    case = LoadCase(campaign.description, campaign.arm, campaign.observations)
    case = replace(case, options=CalibrationOptions(**options))
    effects = (EffectOfPlace(id=kind, of=of),)
    return record_with_effects(effects, calibrated_record(case), case, DiscoveryOptions())


@pytest.mark.parametrize(("robot", "of"), [("ur10", "joint 3"), ("gx4_351s", "joint 2")])
def test_a_right_effect_converges_and_places_of_targets_are_told(eccentric, robot, of):
    record = with_effect(eccentric[robot], "encoder_eccentricity", of)
    assert record.health.grade == "good", record.health.line
    assert record.iterations == record.health.iterations > 0
    omitted = {each.name for each in record.redundant}
    assert not omitted & record.parameters.keys()
    told = {name for name in record.parameters if name.startswith("target_")}
    assert len(told | {name for name in omitted if name.startswith("target_")}) == 9
    assert all(0.0 < record.parameters[name].std < 1e-4 for name in told)


@pytest.fixture(scope="module")
def unstated(tmp_path_factory):
    """Return a campaign of a SCARA whose second joint tilts; nobody states where targets are."""
    hidden = HiddenEffectOptions(
        id="lateral_compliance", of="joint 2", parameters={"C_x": 1e-4, "C_y": 1e-4}
    )
    options = SimulateOptions(
        robot="gx4_351s",
        random_seed=6,
        hidden_effects=(hidden,),
        without_touches=TrackerOptions(instrument="points", poses=140, loads_N=(0.0, 20.0, 50.0)),
    )
    folder = tmp_path_factory.mktemp("unstated") / "raw"
    campaign = pa10cal.read_campaign(write_simulated(folder, options))
    stated_m = campaign.observations.measured.p_ee_stated_m
    observations = campaign.observations.with_measured(p_ee_stated_m=None)
    return replace(campaign, observations=observations), stated_m


def test_a_height_that_no_geometry_shows_is_found_by_what_tilts_under_loads(unstated):
    campaign, stated_m = unstated
    without = pa10cal.calibrate(campaign)
    assert without.fitted_to.open_targets == ("target_T3_z",)
    assert abs(without.targets_m[-1] - stated_m[2, 2]) > 0.05
    assert np.diag(without.covariance)[-1] == 0.0
    assert list(open_target(without, "flange")) == []
    (line,) = open_target(without, "target_T1")
    assert "is held where the search started" in line
    tilted = CalibrationOptions(effects=(EffectOfPlace(id="lateral_compliance", of="joint 2"),))
    model = pa10cal.calibrate(campaign, tilted)
    height_u_m = np.sqrt(np.diag(model.covariance)[-1])
    assert 1e-4 < height_u_m < 0.03
    assert abs(model.targets_m[-1] - stated_m[2, 2]) < 3.0 * height_u_m
    # The base is as uncertain as the height is; in its own frame the instrument sees neither.
    (line,) = open_target(model, "target_T1")
    assert f"is known to {1e3 * height_u_m:.2g} mm" in line
    q_rad = campaign.observations.states.q_rad
    assert np.median(model.predict(q_rad, frame="target_T3").u_mm) < 0.1 * 1e3 * height_u_m


def test_an_effect_that_is_not_there_explains_no_more_than_the_stated_noise(eccentric):
    health = with_effect(eccentric["ur10"], "gear_ratio_error", "joint 4").health
    assert health.noise_mm == pytest.approx(0.05 * np.sqrt(3.0), rel=0.01)
    assert health.grade == "incomplete", health.line
    assert "times the stated noise" in health.line


def test_a_fit_ends_after_so_many_steps_as_are_allowed(eccentric):
    record = with_effect(eccentric["ur10"], "encoder_eccentricity", "joint 3", max_iterations=2)
    assert record.health.grade == "not_converged"
    assert "2 steps were not enough; raise calibration.max_iterations" in record.health.line
