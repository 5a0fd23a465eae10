"""Results of a shipped campaign, made by the stages themselves with little work each."""

from pathlib import Path

import pytest

from pa10cal.campaign.description import read_campaign
from pa10cal.figures.results import PictureSettings, Results
from pa10cal.figures.style import looks
from pa10cal.stages import calibrate, evaluate, ingest, montecarlo, seed

CAMPAIGN = Path(__file__).parents[2] / "data/raw/cell-null"
PLANES_MM = (300, 500, 700)
LITTLE_DRAWING = '{"cycles": 200, "positions": 20, "map_spacing_mm": 200}'
LITTLE_CALIBRATION = '{"starts": 1, "inner_subsets": 2}'


def _run(stage, *words):
    assert stage.main([str(word) for word in words]) == 0


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


@pytest.fixture
def project_looks():
    with looks():
        yield
