"""Lengths in another unit are refused by the unit's name."""

from __future__ import annotations

import pytest

from pa10cal.campaign.screens import refuse_wrong_length_unit
from pa10cal.errors import RawDataError


@pytest.mark.parametrize("scale", [None, 0.3, 1.0, 4.0])
def test_a_scale_near_one_passes(scale):
    refuse_wrong_length_unit(scale, "positions", "poses.csv: x_mm")


@pytest.mark.parametrize(
    ("scale", "message"),
    [
        (1020.0, r"poses.csv: d_mm: the distances look like metres .*one measured millimetre is"),
        (24.0, "look like inches"),
        (9.5, "look like centimetres"),
        (1.1e-3, "look like micrometres"),
        (100.0, "do not fit the joint motion.*check the unit"),
    ],
)
def test_another_unit_is_named(scale, message):
    with pytest.raises(RawDataError, match=message):
        refuse_wrong_length_unit(scale, "distances", "poses.csv: d_mm")
