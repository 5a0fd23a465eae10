"""Configurations to measure next, as a table that a robot programme reads."""

import csv
import io

import numpy as np
import pytest

from pa10cal.results.discovery import SuggestedPose
from pa10cal.results.plan import suggestion_table


def pose(q_rad, load_N, arrive_from, nats, *serves):
    keys = {"load_N": load_N, "arrive_from": arrive_from, "separation_nats": nats}
    return SuggestedPose(q_deg=np.degrees(q_rad), q_rad=q_rad, **keys, for_=serves)


SUGGESTIONS = (
    pose(np.array([0.1, -0.5]), 44.0, np.array([-1.0, 1.0]), 12.3456, "a of b", "c or d"),
    pose(np.array([np.pi, 0.0]), 0.0, np.array([1.0, 1.0]), 30.0, "a of b"),
)


def test_the_table_reads_back():
    rows = list(csv.DictReader(io.StringIO(suggestion_table(SUGGESTIONS, 2, with_sides=True))))
    assert [row["order"] for row in rows] == ["1", "2"]
    assert float(rows[1]["q1_deg"]) == 180.0
    assert float(rows[0]["q2_deg"]) == pytest.approx(np.degrees(-0.5), abs=1e-4)
    assert float(rows[0]["load_N"]) == 44.0
    assert int(rows[0]["arrive1_from"]) == -1
    assert rows[0]["for"] == "a of b; c or d"

    assert SUGGESTIONS[1].model_dump(mode="json")["for"] == ["a of b"]


def test_columns_of_sides_are_there_where_they_are_wanted():
    header, *rows = suggestion_table(SUGGESTIONS, 2, with_sides=False).splitlines()
    assert (header, len(rows)) == ("order,q1_deg,q2_deg,load_N,for", 2)
    (line,) = suggestion_table((), 6, with_sides=True).splitlines()
    assert line.startswith("order,q1_deg,q2_deg")
    assert "arrive6_from" in line
