import csv
import io

import pytest

from pa10cal.fleet.campaigns import HEADER, Listed, fleet_csv, fleet_record
from pa10cal.reports.page import fleet_page_text
from pa10cal.results.codec import write
from pa10cal.results.fleet import ChainRecord

GOOD = {
    "status": "done",
    "robot": "irb120",
    "provenance": "Synthetic data",
    "grade": "good",
    "line": "as the noise explains",
    "verdict": "none",
    "notes": (),
    "before_mm": 1.0,
    "after_mm": 0.1,
    "over": "held-out poses",
}


@pytest.fixture
def fleet(tmp_path):
    """Make a fleet of arms a, b, …, each of one campaign that came to this."""

    def make(*became):
        listed = []
        for letter, changes in zip("abcdefgh", became, strict=False):
            name = f"c-{letter}"
            (tmp_path / name).mkdir()
            write(ChainRecord(campaign=name, **changes), tmp_path / name / "chain.json")
            listed.append(Listed(name, letter))
        return fleet_record(listed, tmp_path)

    return make


def test_arms_that_need_attention_come_first(fleet):
    found = fleet(
        GOOD,
        GOOD
        | {"verdict": "unexplained", "grade": "incomplete", "notes": ("unexplained: joint 2",)},
        GOOD | {"grade": "suspect_input", "line": "joint 3 is turned"},
        {"status": "refused", "stage": "ingest", "message": "no rows"},
        GOOD | {"verdict": "check_the_log", "notes": ("the log: P1",)},
        {"status": "fault", "stage": "discover", "message": "internal fault"},
    )
    assert [(each.arm, each.attention) for each in found.arms] == [
        ("d", "no_result"),
        ("f", "no_result"),
        ("c", "input"),
        ("e", "input"),
        ("b", "incomplete"),
        ("a", "none"),
    ]
    assert found.arms[0].why == "ingest: no rows"
    assert found.counts == {
        "fault": 1,
        "good": 2,
        "incomplete": 1,
        "refused": 1,
        "suspect_input": 1,
    }


def test_the_table_has_a_row_a_campaign_and_runs_nothing(fleet):
    found = fleet(
        GOOD | {"notes": ("=1+1",)}, {"status": "refused", "stage": "seed", "message": "-x"}
    )
    rows = list(csv.DictReader(io.StringIO(fleet_csv(found))))
    assert tuple(rows[0]) == HEADER
    assert [row["campaign"] for row in rows] == ["c-a", "c-b"]
    assert rows[0]["effects_and_faults"] == "'=1+1"
    assert (rows[0]["after_mm"], rows[1]["after_mm"]) == ("0.1000", "")
    assert rows[1]["attention"] == "no_result"


def test_the_page_shows_what_is_there_and_says_that_it_is_synthetic(fleet):
    found = fleet(GOOD, {"status": "refused", "stage": "ingest", "message": "<b>no rows</b>"})
    text = fleet_page_text(found)
    assert "Synthetic data" in text
    assert "&lt;b&gt;no rows&lt;/b&gt;" in text
    assert "<b>no rows</b>" not in text
    assert "1.000 → 0.100 mm" in text


def test_a_fleet_without_any_result_has_a_page(fleet):
    text = fleet_page_text(fleet({"status": "refused", "stage": "ingest", "message": "no rows"}))
    assert "Errors before and after" not in text
    assert "Synthetic" not in text
