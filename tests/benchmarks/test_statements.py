"""The table of statements: sixty of them, most of measured campaigns, each judged by its words."""

import re

from benchmarks.statements import judged, rows


def test_the_table_is_whole():
    table = rows()
    assert len(table) >= 60
    assert 2 * sum(row["data"] == "measured" for row in table) >= len(table)
    for row in table:
        assert set(row) == {"campaign", "data", "right", "wrong", "why"}
        assert row["data"] in ("measured", "simulated")
        re.compile(row["right"])
        re.compile(row["wrong"])
        assert row["right"] or row["wrong"]
    said = [(row["campaign"], row["right"], row["wrong"]) for row in table]
    assert len(set(said)) == len(said)


def test_a_statement_is_right_vague_or_wrong():
    row = {"right": "joint 4", "wrong": "suspect"}
    assert judged(row, "joint 4 was mastered") == "right"
    assert judged(row, "joint 4 is suspect") == "wrong"
    assert judged(row, "all is well") == "vague"
    assert judged({"right": "", "wrong": "suspect"}, "all is well") == "right"
