"""The list of effects is that of the classes."""

import pytest

from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.files.arms import arm_names
from pa10cal.terms.effects.effect import every_effect


@pytest.mark.parametrize("robot", arm_names())
def test_every_effect_that_an_arm_can_have_is_listed_once(robot, capsys):
    assert run_command("effects", ["--robot", robot]) == 0
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert {len(row) for row in rows} == {6}
    assert all(all(cell.strip() for cell in row) for row in rows)
    listed = [row[0].strip("`") for row in rows[2:]]
    named = [kind.id for kind in every_effect() if not kind.generic]
    assert listed == sorted(listed)
    assert set(listed) <= set(named)
    assert robot != "pa10_6ce" or listed == named


def test_places_formula_and_size_stand_beside_the_name(capsys):
    run_command("effects", [])
    (row,) = (line for line in capsys.readouterr().out.splitlines() if "`backlash`" in line)
    assert "| joint 1, 2, 3, 4, 5, 6 | `theta_1 += b s_1` | b > 0 [rad] | 0.0003 rad |" in row


def test_an_unknown_arm_is_refused(capsys):
    assert run_command("effects", ["--robot", "ur99"]) == REFUSED
    assert "ur99" in capsys.readouterr().err
