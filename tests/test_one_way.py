"""One way from raw files to a verdict: whoever walks it comes to the same bytes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from benchmarks.fuzz.corpus import CAMPAIGNS as SMALL

import pa10cal
from mended import write_simulated
from pa10cal.command_settings import ChainOptions
from pa10cal.commands.command_line import run_command
from pa10cal.discovery.verdict_records import extended_record, verdict_record
from pa10cal.results.codec import write
from pa10cal.settings_reading import parse_section
from pa10cal_lab.blind_trials import calibrated_by_stages, judged_by_stages
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions

#: None of them is the default: a way that loses one comes to other bytes.
SETTINGS = {
    "ingest": {"stray_touch_sigma": 7.0},
    "base_frame": {"min_length_mm": 40.0, "max_bend_mm": 6.0},
    "calibration": {
        "starts": 3,
        "random_seed": 5,
        "flexible_joints": [2, 3],
        "tolerances": {"a_m": 4e-4, "theta_rad": 8e-4},
        "apparatus_uncertainty_mm": 0.007,
    },
    "discovery": {
        "error_rate": 0.03,
        "suggestions": 3,
        "random_seed": 6,
        "load_uncertainty": 0.01,
        "mass_uncertainty": 0.2,
    },
}
#: One small campaign of each instrument.
CAMPAIGNS = {
    **SMALL,
    "points": SimulateOptions(
        robot="irb120",
        random_seed=2,
        without_touches=TrackerOptions(instrument="points", poses=130),
    ),
    "distance": SimulateOptions(
        robot="irb120",
        random_seed=3,
        without_touches=TrackerOptions(instrument="distance", poses=260),
    ),
}


def by_rules(raw: Path, place: Path) -> Path:
    """Run a folder: Snakemake's rules, a process a stage."""
    settings = place / "settings.yaml"
    settings.write_text(json.dumps(SETTINGS), encoding="utf-8")
    words = [str(raw), "--out", str(place / "ruled"), "--settings", str(settings), "--cores", "1"]
    assert run_command("run", words) == 0
    return place / "ruled" / raw.name


def by_fleet(raw: Path, place: Path) -> Path:
    """Take the campaign as one of many, in one process."""
    out = place / "fleet" / raw.name
    words = ["--campaign-dir", str(raw), "--results", str(out), "--settings", json.dumps(SETTINGS)]
    assert run_command("chain", words) == 0
    return out


def by_trial(raw: Path, place: Path) -> Path:
    """Judge it as a blind trial is judged."""
    options, out = parse_section(ChainOptions, SETTINGS, where="test"), place / "trial"
    judged_by_stages((raw,), out, calibrated_by_stages((raw,), out, options), options)
    return out


def by_python(raw: Path, place: Path) -> Path:
    """Call the functions of the package, in memory."""
    options, out = parse_section(ChainOptions, SETTINGS, where="test"), place / "python"
    campaign = pa10cal.read_campaign(raw, options.ingest)
    model = pa10cal.calibrate(campaign, options.calibration, base_frame=options.base_frame)
    found = pa10cal.discover(campaign, model, options.discovery, options.calibration)
    ahead = found.next_poses(options.discovery.suggestions, options.discovery.random_seed)
    record = verdict_record(found, campaign.description, ahead)
    (out / "discovery").mkdir(parents=True)
    write(record, out / "discovery/verdict.json")
    write(
        extended_record(found, record, campaign.description.robot, "combined"),
        out / "discovery/extended.json",
    )
    return out


@pytest.fixture
def raw(request, tmp_path):
    name = request.param
    return write_simulated(tmp_path / f"raw/made-{name}", CAMPAIGNS[name], f"made-{name}")


def bytes_of(results: Path) -> dict[str, bytes]:
    names = ("verdict.json", "extended.json")
    return {name: (results / "discovery" / name).read_bytes() for name in names}


@pytest.mark.slow
@pytest.mark.parametrize("raw", CAMPAIGNS, indirect=True)
def test_rules_fleets_trials_and_python_come_to_the_same_bytes(raw, tmp_path):
    wanted = bytes_of(by_fleet(raw, tmp_path))
    for way in (by_rules, by_trial, by_python):
        assert bytes_of(way(raw, tmp_path)) == wanted, way.__name__


@pytest.mark.parametrize("raw", ["points"], indirect=True)
def test_fleets_trials_and_python_come_to_the_same_bytes(raw, tmp_path):
    wanted = bytes_of(by_fleet(raw, tmp_path))
    for way in (by_trial, by_python):
        assert bytes_of(way(raw, tmp_path)) == wanted, way.__name__


@pytest.mark.parametrize("raw", ["points"], indirect=True)
def test_the_settings_matter(raw, tmp_path):
    """What the same bytes show is that settings arrive, not that they do nothing."""
    options = parse_section(ChainOptions, SETTINGS, where="test")
    campaign = pa10cal.read_campaign(raw, options.ingest)
    given = pa10cal.calibrate(campaign, options.calibration, base_frame=options.base_frame)
    usual = pa10cal.calibrate(campaign)
    assert not np.array_equal(given.covariance, usual.covariance)
