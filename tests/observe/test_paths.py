"""Rows along a path: stretches are held out, and what is printed says where held-out poses lie."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from by_commands import calibrated, evaluate
from mended import describe, simulated
from pa10cal.campaign.read import read_campaign
from pa10cal.observe.paths import HeldOutPlaces, along_a_path, spread_of, stretches_held_out
from pa10cal.reports.errors import headline
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.evaluation import BETWEEN, UNSEEN
from pa10cal.rules import ORDER

COUNT = 400


def path_deg():
    """Return joint positions along a path, those of neighbours half a degree apart."""
    t = np.linspace(0.0, 1.0, COUNT)[:, None]
    turns, at = np.array([0.9, 1.1, 1.3, 0.7, 1.7, 1.2]), np.arange(6.0)
    return np.array([40.0, 25.0, 30.0, 60.0, 50.0, 70.0]) * np.sin(2 * np.pi * turns * t + at)


@pytest.fixture(scope="module", name="folder")
def _folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("path") / "raw"
    plan = {"poses": COUNT, "commanded": path_deg().tolist(), "holdout_share": 0.0}
    return simulated(folder, "irb120", "pose", **plan)


def held_out_by(folder, tmp_path, rule, kinds=None):
    """Return a copy of the campaign, held out by a rule, or as the rows say."""
    copy = tmp_path / "raw"
    copy.mkdir()
    for file in folder.iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    table = pd.read_csv(copy / "poses.csv")
    if kinds is None:
        table = table.drop(columns="kind", errors="ignore")
        describe(copy, "holdout", rule)
    else:
        table["kind"] = kinds
    table.to_csv(copy / "poses.csv", index=False)
    return copy


def test_poses_that_follow_each_other_closely_are_a_path_and_others_are_not():
    path = np.radians(path_deg())
    assert along_a_path(path)
    assert not along_a_path(path[::8])
    assert not along_a_path(np.random.default_rng(0).permutation(path))
    assert not along_a_path(path[:1])
    twice = np.repeat(path[::8], 2, axis=0)  # one that is read again has not moved on
    assert not along_a_path(twice)


@pytest.mark.parametrize(("count", "held"), [(1500, 300), (400, 80), (101, 1), (120, 20)])
def test_as_many_are_held_out_in_stretches_the_last_one_at_the_end(count, held):
    away = stretches_held_out(count, held)
    assert len(away) == len(set(away)) == held
    assert away[-1] == count - 1 or held < 10
    runs = np.split(away, np.flatnonzero(np.diff(away) > 1) + 1)
    long = [run for run in runs if len(run) > 2]
    assert sum(map(len, long)) >= 0.85 * held or held < 10
    assert len(long) == 5 or held < 10


def test_every_fifth_row_of_a_path_becomes_stretches_and_it_is_said(folder, tmp_path):
    found = read_campaign(held_out_by(folder, tmp_path, {"every": 5}))
    assert len(found.held_out) == COUNT // 5
    assert any("held out in stretches" in note for note in found.notes)
    places = HeldOutPlaces.of(found.held_out, found.calibration)
    q = found.calibration.states.q_rad
    unseen = found.held_out.states.q_rad[places.unseen]
    away = np.linalg.norm(unseen[:, None] - q, axis=2).min(axis=1)
    assert away.min() > ORDER.neighbours * spread_of(q)
    assert places.unseen.sum() > 0.5 * len(found.held_out)
    assert places.between.sum() >= 8
    assert not (places.unseen & places.between).any()


@pytest.mark.parametrize(
    ("trusted", "counted"),
    [
        ([1, 1, 1], [1, 1, 0]),
        ([1, 0, 1], [1, 0, 0]),
        ([0, 0, 1], [1, 1, 0]),
        ([0, 0, 0], [1, 1, 0]),
    ],
)
def test_errors_are_of_unseen_poses_even_where_all_are_suspected(trusted, counted):
    unseen = np.array([True, True, False])
    found = HeldOutPlaces(unseen, ~unseen).counted(np.array(trusted, dtype=bool))
    assert found.tolist() == np.array(counted, dtype=bool).tolist()


def test_the_last_part_of_a_path_stays_what_was_stated(folder, tmp_path):
    found = read_campaign(held_out_by(folder, tmp_path, {"last_fraction": 0.2}))
    times = found.held_out.states.time_s
    assert times.min() > found.calibration.states.time_s.max()
    assert not any("in stretches" in note for note in found.notes)


def test_what_is_printed_says_where_held_out_poses_lie(folder, tmp_path, capsys):
    results = tmp_path / "results"
    calibrated_in(folder, tmp_path, results, {"every": 5})
    said = capsys.readouterr().out
    assert f"held out {UNSEEN} (" in said
    assert f"; {BETWEEN} (" in said
    case = json.loads((results / "calibration/combined.json").read_text("utf-8"))
    assert f"over held-out poses {UNSEEN}" in case["health"]["line"]
    before, after = headline(ResultsBundle(results))
    assert before.where == after.where == UNSEEN
    assert after.over.startswith(f"held-out poses {UNSEEN}; ")
    assert after.over.endswith(BETWEEN)
    model = json.loads((results / "evaluation/holdout.json").read_text("utf-8"))["models"]
    last = model["linear"]
    parts = [last["unseen"]["configurations"], last["between"]["configurations"]]
    assert sum(parts) == last["configurations"]
    assert after.accuracy.rms_mm == pytest.approx(last["unseen"]["rms_mm"])


def test_neighbours_that_the_rows_hold_out_are_used_and_called_so(folder, tmp_path, capsys):
    kinds = np.where(np.arange(COUNT) % 5 == 4, "holdout", "grid")
    results = tmp_path / "results"
    calibrated_in(folder, tmp_path, results, None, kinds)
    assert f"held out {BETWEEN} ({COUNT // 5})" in capsys.readouterr().out
    _, after = headline(ResultsBundle(results))
    assert after.over == f"held-out poses {BETWEEN}"


def calibrated_in(folder, tmp_path, results, rule, kinds=None):
    """Take the campaign to a calibration, and judge it."""
    held_out_by(folder, tmp_path, rule, kinds)
    calibrated(tmp_path)
    for name in ("calibration", "evaluation"):
        (results / name).mkdir(parents=True)
    (results / "calibration/combined.json").write_bytes((tmp_path / "combined.json").read_bytes())
    assert evaluate(tmp_path, results / "evaluation/holdout.json", extended=None) == 0
