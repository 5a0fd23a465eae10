"""From files of seven families to a report in three commands and two edits at most."""

import pytest
from benchmarks.first_minutes import EDITS, FAMILIES, Minutes, minutes, table_of

from pa10cal.__main__ import main


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("name", ["kuka", "matlab"])
def test_what_is_proposed_needs_the_edits_that_only_the_owner_knows(tmp_path, capsys, name):
    files, robot = FAMILIES[name][1](tmp_path)
    assert main(["columns", *(str(tmp_path / each) for each in files), "--robot", robot]) == 0
    proposed = capsys.readouterr().out
    assert "60 rows can be used, 0 cannot" in proposed
    assert all(proposed.count(stands) == 1 for stands in EDITS)


@pytest.mark.slow
def test_a_program_and_a_list_of_points_come_to_a_report(tmp_path):
    assert minutes(tmp_path / "abb", "abb").right


def test_more_steps_than_wanted_are_not_right_and_the_table_has_a_row_each():
    few = Minutes("a", ("columns a", "run ."), ("provenance",), 20.0, 9.0, "good", "0.1 mm")
    many = Minutes("b", ("columns a", "run ."), ("a", "b", "c"), 20.0, 9.0, "good", "0.1 mm")
    refused = Minutes("c", ("columns a",), (), 2.0, 1.0, "no joint positions", "")
    assert [few.right, many.right, refused.right] == [True, False, False]
    table = table_of([few, many, refused])
    assert (
        "| a | 2: `pa10cal columns a`; `pa10cal run .` | 1: provenance | 20 | 9 | good |" in table
    )
    assert len(table.splitlines()) == 13
