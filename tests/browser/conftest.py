"""A browser, and a report of a campaign with an effect named."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from made_up_results import small_results, with_verdict
from pa10cal.commands.command_line import run_command

sys.path.insert(0, str(Path(__file__).parent))

from chromium import Browser


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """The browser; it fails with what to install where there is none."""
    found = Browser(tmp_path_factory.mktemp("chromium") / "profile")
    yield found
    found.close()


@pytest.fixture(scope="session")
def page(tmp_path_factory) -> Path:
    """The report of a campaign in which an effect was named."""
    results = with_verdict(small_results(tmp_path_factory.mktemp("report")), "named")
    out = results / "report.html"
    assert run_command("report", [str(results), "--out", str(out)]) == 0
    return out
