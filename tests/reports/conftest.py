"""Results of a small campaign, to write reports of."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from built_once import built_once
from made_up_results import NAME, VERDICTS, small_results, with_verdict


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
