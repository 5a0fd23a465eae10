"""The search on campaigns of the virtual cell: who judges, and easy cases of every instrument."""

import pytest

from pa10cal.calibration.campaign import calibrated
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.read import read_campaign
from pa10cal.cell.campaign import simulate_campaign
from pa10cal.cell.options import SimulateOptions
from pa10cal.cell.write import write_campaign
from pa10cal.discovery.discover import discover
from pa10cal.discovery.evidence.discover import VerdictByRepeats
from pa10cal.discovery.options import DiscoveryOptions
from pa10cal.discovery.records import discovery_records
from pa10cal.discovery.setup import setup_of
from pa10cal.files.arms import load_arm
from pa10cal.results.discovery import VerdictKeys
from pa10cal.settings_reading import parse_section

ECCENTRIC = {
    "id": "encoder_eccentricity",
    "of": "joint 3",
    "parameters": {"A": 6e-4, "phi": 1.0},
}
WAVE = {
    "id": "transmission_error",
    "of": "joint 2",
    "parameters": {"A": 5e-4, "phi": 0.5},
}
BACKLASH = {"id": "backlash", "of": "joint 1", "parameters": {"b": 3e-4}}
MANY = {"poses": 240}
REPEATED = {"poses": 80, "repeat_every": 1}


@pytest.fixture
def campaign(tmp_path):
    def measured(instrument, *hidden, **plan):
        raw = {
            "random_seed": 1,
            "robot": "ur10",
            "hidden_effects": list(hidden),
            "without_touches": {
                "instrument": instrument,
                "departs": "rows",
                "position_mm": 0.02,
                **plan,
            },
        }
        options = parse_section(SimulateOptions, raw, where="test")
        made = simulate_campaign("c", load_arm("ur10"), options)
        write_campaign(made, tmp_path / "raw", tmp_path / "truth.json")
        return read_campaign(tmp_path / "raw")

    return measured


def searched(found):
    """Return the verdict on a campaign."""
    model = calibrated(found.description, found.arm, found.observations)
    setup = setup_of(found.description, found.arm, CalibrationOptions(), DiscoveryOptions())
    return discover(found.observations, model, setup)


def names(verdict):
    return [(effect.id, effect.of) for effect in verdict.effects]


@pytest.mark.parametrize("hidden", [ECCENTRIC, WAVE, BACKLASH], ids=lambda each: each["id"])
@pytest.mark.parametrize("instrument", ["points", "distance"])
def test_a_large_effect_is_named_whatever_the_instrument(campaign, instrument, hidden):
    verdict = searched(campaign(instrument, hidden, **MANY))
    assert verdict.verdict == "named"
    assert names(verdict) == [(hidden["id"], hidden["of"])]
    (effect,) = verdict.effects
    name, true = next(iter(hidden["parameters"].items()))
    found = effect.parameters[name]
    assert abs(found.value - true) < max(4.0 * found.std, 0.05 * true)
    assert verdict.holdout.after.mean_mm < 0.5 * verdict.holdout.before.mean_mm
    assert verdict.train.after.mean_mm < 1.2 * verdict.noise_floor_mm


@pytest.mark.parametrize("instrument", ["points", "distance"])
def test_where_nothing_is_hidden_nothing_is_named(campaign, instrument):
    verdict = searched(campaign(instrument, **MANY))
    assert (verdict.verdict, names(verdict)) == ("none", [])


@pytest.mark.parametrize("instrument", ["points", "distance", "pose"])
def test_where_poses_are_repeated_repeats_are_the_judge(campaign, instrument):
    read = campaign(instrument, ECCENTRIC, **REPEATED)
    verdict = searched(read)
    assert isinstance(verdict, VerdictByRepeats)
    assert verdict.prepared.arrivals_from_order
    assert verdict.prepared.torques == "masses"
    assert verdict.problem.torque is None
    assert names(verdict) == [(ECCENTRIC["id"], ECCENTRIC["of"])]
    assert all(
        entry.why == "the torques were not logged"
        for entry in verdict.not_testable
        if entry.effect.id == "friction_torque"
    )
    records = discovery_records(verdict, verdict.next_poses(3), read.description, "combined", 1.0)
    assert isinstance(records.verdict, VerdictKeys)
    assert len(records.analysis.gap.train) == 60


def test_one_target_is_enough(campaign):
    verdict = searched(campaign("points", ECCENTRIC, targets=1, **MANY))
    assert names(verdict) == [(ECCENTRIC["id"], ECCENTRIC["of"])]
