"""A simulated drive whose sensor errs: the map of its joint bears the name of the cause."""

from dataclasses import replace

import numpy as np
import pytest

import pa10cal
from mended import write_simulated
from pa10cal.discovery.blocked_cv import band_likelihood, by_blocks, map_causes
from pa10cal.discovery.blocked_cv.bands import in_bands
from pa10cal.discovery.blocked_cv.block_rows import ShapedEffect, weighted_rows
from pa10cal.discovery.blocked_cv.linear_fit import linear_fit
from pa10cal.discovery.refitted_verdict import with_findings
from pa10cal.discovery.verdict_records import verdict_keys, verdict_record
from pa10cal.fit.model_reading import model_from_plain
from pa10cal.fit.model_writing import model_to_plain
from pa10cal.stages.discover import verdict_lines
from pa10cal.terms.effects.joint_error_map import FadingPrior, JointErrorMap
from pa10cal_lab.cell.effects.effect import Site
from pa10cal_lab.cell.effects.joint import SimulatedSensorError as CellSensorError

POSES, JOINT = 900, 3


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    rng = np.random.default_rng(5)
    wide = np.where(np.arange(6) == JOINT - 1, 350.0, 160.0)
    commanded = rng.uniform(-wide, wide, (POSES, 6)).round(4).tolist()
    drawn = CellSensorError.at_size(Site(f"joint {JOINT}"), 1.0, rng)
    drawn |= {"ratio": 101.0, "cogs": [4, 10, 20], "ripple": [5e-5] * 3, "ripple_phi": [0.1] * 3}
    raw = {
        "random_seed": 5,
        "robot": "ur10",
        "hidden_effects": [{"id": "sensor_error", "of": f"joint {JOINT}", "parameters": drawn}],
        "without_touches": {"poses": POSES, "commanded": commanded, "position_mm": 0.02},
    }
    return pa10cal.read_campaign(write_simulated(tmp_path_factory.mktemp("raw") / "drive", raw))


@pytest.fixture(scope="module")
def found(campaign):
    return pa10cal.discover(campaign, pa10cal.calibrate(campaign))


@pytest.mark.slow
def test_a_sensor_that_errs_is_named(found):
    (finding,) = found.effects
    assert (finding.id, finding.of, finding.alternatives) == ("sensor_error", "joint 3", ())
    (cause,) = found.scorer.causes.values()
    assert cause.cause == "sensor"
    assert cause.ripple.interval95[0] > 0.3
    assert cause.agreement.correlation > 0.9
    assert cause.agreement.slope == pytest.approx(1.0, abs=0.2)
    held_out = with_findings(found, found.findings)
    assert held_out.model.x == pytest.approx(found.model.x, abs=2e-5)


@pytest.mark.slow
def test_it_is_told_and_written(found, campaign):
    keys = verdict_keys(found)
    witness = keys.effects[0].witness
    assert witness.ripple.orders == (4, 10, 20)
    assert witness.ripple.profile_nats.max() == 0.0
    assert "its motor followed" in " ".join(verdict_lines(keys))
    assert verdict_record(found, campaign.description).effects[0].witness == witness
    back = model_from_plain(model_to_plain(found.model), where="model.yaml")
    assert back.model.terms == found.model.model.terms


@pytest.mark.slow
def test_without_agreement_it_is_the_sensor_or_the_gear(found, monkeypatch):
    monkeypatch.setattr(map_causes, "agreement", lambda _: None)
    (finding,) = by_blocks.with_causes(found).effects
    assert (finding.id, [each.id for each in finding.alternatives]) == (
        "sensor_error",
        ["gear_error"],
    )


@pytest.fixture
def as_map(found, monkeypatch):
    """The verdict before its map had a name, of a joint whose motor shows no ripple."""
    effect = found.effects[0].effect
    said = JointErrorMap("joint 3", effect.knots, effect.spectrum)
    monkeypatch.setattr(map_causes, "witnesses", lambda *_: (None,) * 6)
    return by_blocks._with_maps_named(found, {effect: map_causes.NamedMap(said, ())})


@pytest.mark.slow
def test_fine_waves_that_turns_agree_on_are_a_sensor_or_a_gear(as_map):
    (finding,) = by_blocks.with_causes(as_map).effects
    assert finding.id == "sensor_error"
    assert [each.id for each in finding.alternatives] == ["gear_error"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value"),
    [("agreement", lambda _: None), ("MAPS", replace(map_causes.MAPS, fine_knots=1000))],
)
def test_without_agreement_or_fine_waves_a_map_stays_a_map(as_map, monkeypatch, name, value):
    monkeypatch.setattr(map_causes, name, value)
    (finding,) = by_blocks.with_causes(as_map).effects
    assert (finding.id, finding.alternatives) == ("joint_error_map", ())


@pytest.mark.slow
def test_a_map_as_fine_as_waves_gets_a_band_where_left_out_poses_say_so(found, monkeypatch):
    effect = replace(found.effects[0].effect, knots=216, spectrum=FadingPrior(3e-4, 60.0))
    members = (ShapedEffect(effect),)
    rows = weighted_rows(found.scorer.survey, (), 144)
    rough = linear_fit(rows, members)
    banded = in_bands(rows, rough)
    (member,) = banded.fit.members
    assert (member.effect.knots, member.effect.spectrum) == (360, banded.estimates.bands[0])
    before, after = (banded.of_time.sum(axis=0) + banded.of_angles.sum(axis=0)).tolist()
    assert after < before
    keys = verdict_keys(replace(found, scorer=replace(found.scorer, bands=banded)))
    (of_joint,) = keys.bands.maps
    assert (of_joint.of, keys.bands.shared) == ("joint 3", True)
    assert 0.0 < of_joint.log_std["level_rad"] < 0.5
    assert keys.bands.of_angles.after < keys.bands.of_angles.before
    assert 0.92 < keys.scatter.inside95_train < 0.98
    assert len(keys.scatter.joints) == 6
    assert set(keys.scatter.kinds) == {"position", "attitude"}
    smooth = ShapedEffect(replace(effect, knots=72))
    assert in_bands(rows, replace(rough, members=(smooth,))) is None
    hasty = replace(band_likelihood.COMPUTING, band_steps=1)
    monkeypatch.setattr(band_likelihood, "COMPUTING", hasty)
    assert in_bands(rows, rough) is None  # its search has not settled


def test_a_joint_without_a_drive_has_no_cause_and_its_map_stays_a_map():
    of_follower = JointErrorMap("joint 4", map_causes.MAPS.fine_knots, FadingPrior(1e-4, 6.0))
    assert map_causes.named_by_cause((of_follower,), {}) == {}


def test_residuals_of_zero_have_finite_weights():
    rng = np.random.default_rng(0)
    jacobian = rng.normal(0.0, 1e4, (50, 6, 6))
    zero, seen = np.zeros((50, 6)), np.ones((50, 6), dtype=bool)
    residual_rad, weight = map_causes._joint_residuals(jacobian, zero, seen)
    assert not residual_rad.any()
    assert np.isfinite(weight).all()


def test_torques_that_lack_in_some_poses_are_those_of_their_campaign():
    torque_Nm = np.array([10.0, 30.0, np.nan, 5.0, 7.0, np.nan, np.nan])
    campaign = np.array([0, 0, 0, 1, 1, 1, 2])
    filled = map_causes._varying_torque(torque_Nm, 100.0, campaign)
    np.testing.assert_array_equal(filled, [10.0, 30.0, 20.0, 5.0, 7.0, 6.0, 0.0])
    steady = map_causes._varying_torque(np.where(torque_Nm > 0.0, 5.0, np.nan), 100.0, campaign)
    assert np.isnan(steady).all()
