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
#: Neither of two axes slides.
TURN = [False, False]


def test_the_table_reads_back():
    rows = list(csv.DictReader(io.StringIO(suggestion_table(SUGGESTIONS, TURN, with_sides=True))))
    assert [row["order"] for row in rows] == ["1", "2"]
    assert float(rows[1]["q1_deg"]) == 180.0
    assert float(rows[0]["q2_deg"]) == pytest.approx(np.degrees(-0.5), abs=1e-4)
    assert float(rows[0]["load_N"]) == 44.0
    assert int(rows[0]["arrive1_from"]) == -1
    assert rows[0]["for"] == "a of b; c or d"

    assert SUGGESTIONS[1].model_dump(mode="json")["for"] == ["a of b"]


def test_columns_of_sides_are_there_where_they_are_wanted():
    header, *rows = suggestion_table(SUGGESTIONS, TURN, with_sides=False).splitlines()
    assert (header, len(rows)) == ("order,q1_deg,q2_deg,load_N,for", 2)
    (line,) = suggestion_table((), [False] * 6, with_sides=True).splitlines()
    assert line.startswith("order,q1_deg,q2_deg")
    assert "arrive6_from" in line


def test_an_axis_that_slides_is_in_millimetres():
    on_rail = SuggestedPose(q_deg=[1500.0, 10.0], q_rad=[1.5, 0.17], load_N=0.0, for_=("a of b",))
    table = suggestion_table([on_rail], [True, False], with_sides=False)
    assert table.splitlines() == ["order,q1_mm,q2_deg,load_N,for", "1,1500.0000,10.0000,0,a of b"]
