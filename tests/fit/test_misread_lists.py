"""Warnings about lists that look misread; what they say of whole lists is tested with commands."""

from types import SimpleNamespace

import pytest

from pa10cal.files.arms import load_arm
from pa10cal.fit import misread_lists


@pytest.mark.parametrize(
    ("robot", "columns"), [("gx4_351s", "q1_deg, q2_deg, q4_deg"), ("ur10", "q1_deg … q6_deg")]
)
def test_only_columns_in_degrees_are_said_to_be_radians(robot, columns):
    assert misread_lists._turning_columns(SimpleNamespace(arm=load_arm(robot))) == columns
