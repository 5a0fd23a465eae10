"""Results of a small campaign, to write reports of."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from built_once import built_once
from made_up_results import NAME, VERDICTS, small_results, with_verdict
from mended import write_simulated
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.table import write_pose_table


@pytest.fixture(scope="session")
def small(tmp_path_factory) -> Path:
    """Results of a campaign that is too small for a search; to be read only."""
    return built_once(tmp_path_factory, "small", small_results)


@pytest.fixture
def copied(small, tmp_path):
    """Copy the results, to be changed."""
    folder = tmp_path / "results" / NAME
    shutil.copytree(small, folder)
    return folder


@pytest.fixture(params=VERDICTS)
def judged(request, copied):
    """Results with a verdict in a word, and that word."""
    return with_verdict(copied, request.param), request.param


@pytest.fixture(scope="session")
def watched_poses(tmp_path_factory) -> Path:
    """Results of a small made-up campaign with targets on the base: the table of poses alone."""
    place = tmp_path_factory.mktemp("watched")
    asked = {
        "random_seed": 6,
        "robot": "irb120",
        "without_touches": {"instrument": "points", "poses": 120, "base_targets": 3},
        "disturbances": [{"id": "random_walk", "parameters": {"size_mm": 0.05, "turn_mrad": 0.01}}],
    }
    campaign = read_campaign(write_simulated(place / "watched", asked, "watched"))
    (place / "results/ingest").mkdir(parents=True)
    path = place / "results/ingest/poses.parquet"
    write_pose_table(path, campaign.observations, campaign.arm.prismatic, campaign.name)
    return place / "results"
