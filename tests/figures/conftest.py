"""Results of a shipped campaign, made by the stages themselves with little work each."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from pa10cal.campaign.description import read_campaign
from pa10cal.figures.results import PictureSettings, Results
from pa10cal.figures.style import looks
from pa10cal.stages import calibrate, discover, evaluate, ingest, montecarlo, seed

CAMPAIGN = Path(__file__).parents[2] / "data/raw/cell-null"
PLANES_MM = (300, 500, 700)
LITTLE_DRAWING = '{"cycles": 200, "positions": 20, "map_spacing_mm": 200}'
LITTLE_CALIBRATION = '{"starts": 1, "inner_subsets": 2}'


#: Kinematic error of joint 2 that the spoiled campaign hides.
AMPLITUDE_RAD, PHASE_RAD, ORDER = 4e-4, 0.7, 100.0


def _run(stage, *words):
    assert stage.main([str(word) for word in words]) == 0


def _discover(place):
    given = ("--poses", place / "ingest/poses.parquet")
    given += ("--calibration", place / "calibration/combined.json")
    out = {name: place / f"discovery/{name}.json" for name in ("verdict", "analysis", "extended")}
    out["suggested"] = place / "discovery/suggested_poses.csv"
    words = [word for name, path in out.items() for word in (f"--{name}", path)]
    _run(discover, "--campaign-dir", CAMPAIGN, *given, *words)


@pytest.fixture(scope="session")
def folder(tmp_path_factory) -> Path:
    """The results folder of a campaign, as the workflow lays it out; to be read only."""
    place = tmp_path_factory.mktemp("results") / "cell-null"
    poses, base_frame = place / "ingest/poses.parquet", place / "seed/base_frame.json"
    raw = ("--campaign-dir", CAMPAIGN)
    _run(ingest, *raw, "--out", poses, "--quarantine", place / "ingest/quarantine.csv")
    _run(seed, *raw, "--poses", poses, "--out", base_frame)
    for load in ("0N", "22N", "44N", "combined"):
        out = place / f"calibration/{load}.json"
        given = ("--poses", poses, "--base-frame", base_frame, "--load", load)
        _run(calibrate, *raw, *given, "--settings", LITTLE_CALIBRATION, "--out", out)
    given = ("--poses", poses, "--calibration", place / "calibration/combined.json")
    _run(evaluate, *raw, *given, "--out", place / "evaluation/holdout.json")
    _discover(place)
    for plane in PLANES_MM:
        words = ("--campaign", "cell-null", "--robot", "pa10_6ce", "--plane-mm", plane)
        out = place / f"montecarlo/z{plane}.json"
        _run(montecarlo, *words, "--settings", LITTLE_DRAWING, "--out", out)
    return place


@pytest.fixture(scope="session")
def results(folder) -> Results:
    campaign = read_campaign(CAMPAIGN)
    return Results(
        folder=folder,
        campaign=campaign.name,
        provenance=campaign.provenance,
        robot=campaign.robot,
        instrument_uncertainty_mm=campaign.instrument.uncertainty_mm,
        settings=PictureSettings.model_validate({"montecarlo": {"planes_mm": PLANES_MM}}),
    )


@pytest.fixture(scope="session")
def named(results, tmp_path_factory) -> Results:
    """The same campaign with a kinematic error in joint 2, which discovery names."""
    place = tmp_path_factory.mktemp("named") / "cell-null"
    shutil.copytree(results.folder, place)
    path = place / "ingest/poses.parquet"
    table = pq.read_table(path)
    q_rad = table["q2_rad"].to_numpy()
    logged = q_rad - AMPLITUDE_RAD * np.sin(ORDER * q_rad + PHASE_RAD)
    column = table.schema.get_field_index("q2_rad")
    pq.write_table(table.set_column(column, "q2_rad", [logged]), path)
    given = ("--poses", path, "--base-frame", place / "seed/base_frame.json", "--load", "combined")
    out = place / "calibration/combined.json"
    words = ("--settings", LITTLE_CALIBRATION, "--out", out)
    _run(calibrate, "--campaign-dir", CAMPAIGN, *given, *words)
    _discover(place)
    return replace(results, folder=place)


@pytest.fixture
def project_looks():
    with looks():
        yield
