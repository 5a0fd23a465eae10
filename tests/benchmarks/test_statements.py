"""The table of statements: sixty of them, most of measured campaigns, each judged by its words."""

import re
from pathlib import Path

import benchmarks.statements
from benchmarks.statements import judged, rows


def test_the_table_is_whole():
    table = rows()
    assert len(table) >= 60
    assert sum(row["data"] == "measured" for row in table) >= 30
    for row in table:
        assert set(row) == {"campaign", "data", "logs", "right", "wrong", "why"}
        assert row["data"] in ("measured", "simulated")
        re.compile(row["right"])
        re.compile(row["wrong"])
        assert row["right"] or row["wrong"]
    said = [(row["campaign"], row["logs"], row["right"], row["wrong"]) for row in table]
    assert len(set(said)) == len(said)


def test_every_input_has_a_statement_and_its_logs():
    inputs = Path(benchmarks.statements.__file__).with_name("inputs")
    table = rows()
    for folder in inputs.iterdir():
        of_it = [row for row in table if row["campaign"] == folder.name]
        assert of_it or not folder.is_dir()
        assert all((folder / log).is_file() for row in of_it for log in row["logs"].split())


def test_a_statement_is_right_vague_or_wrong():
    row = {"right": "joint 4", "wrong": "suspect"}
    assert judged(row, "joint 4 was mastered") == "right"
    assert judged(row, "joint 4 is suspect") == "wrong"
    assert judged(row, "all is well") == "vague"
    assert judged(row, "joint 4 was mastered; internal fault: KeyError") == "wrong"
    assert judged({"right": "", "wrong": "suspect"}, "all is well") == "right"
