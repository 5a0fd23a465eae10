"""Configurations to measure next, as records and as a table."""

import csv
import io
import json
from types import SimpleNamespace

import numpy as np
import pytest
from pa10cal.stages.suggestion_record import (
    separation_records,
    suggestion_records,
    suggestion_table,
)

from pa10cal.discovery.suggest import Suggestion

SUGGESTIONS = (
    Suggestion(np.array([0.1, -0.5]), 44.0, np.array([1.0, -1.0]), 12.3456, ("a of b", "c or d")),
    Suggestion(np.array([np.pi, 0.0]), 0.0, np.array([-1.0, -1.0]), 30.0, ("a of b",)),
)


def test_records_are_plain_numbers_in_both_units():
    records = json.loads(json.dumps(suggestion_records(SUGGESTIONS), allow_nan=False))
    assert [record["load_N"] for record in records] == [44.0, 0.0]
    for record, suggestion in zip(records, SUGGESTIONS, strict=True):
        assert record["q_rad"] == suggestion.q_rad.tolist()
        assert np.radians(record["q_deg"]) == pytest.approx(suggestion.q_rad)
        assert record["for"] == list(suggestion.for_effects)


def test_a_joint_that_moves_up_comes_from_below():
    assert suggestion_records(SUGGESTIONS)[0]["arrive_from"] == [-1.0, 1.0]


def test_the_table_reads_back():
    rows = list(csv.DictReader(io.StringIO(suggestion_table(SUGGESTIONS, 2))))
    assert [row["order"] for row in rows] == ["1", "2"]
    assert float(rows[1]["q1_deg"]) == 180.0
    assert float(rows[0]["q2_deg"]) == pytest.approx(np.degrees(-0.5), abs=1e-4)
    assert float(rows[0]["load_N"]) == 44.0
    assert int(rows[0]["arrive1_from"]) == -1
    assert rows[0]["for"] == "a of b; c or d"


def test_without_suggestions_the_table_is_its_header():
    lines = suggestion_table((), 6).splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("order,q1_deg,q2_deg")


def test_separations_say_whether_poses_can_help():
    separation = SimpleNamespace(
        label="a of b", before_nats=0.1, after_nats=0.1, possible_nats=0.4, can_be_split=False
    )
    assert separation_records([separation]) == [
        {
            "pair": "a of b",
            "before_nats": 0.1,
            "after_nats": 0.1,
            "possible_nats": 0.4,
            "can_be_split": False,
        }
    ]
