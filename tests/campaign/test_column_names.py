"""What the name of a column says by itself."""

from __future__ import annotations

import pytest

from pa10cal.campaign.column_names import (
    coverage_of,
    said_by_unit,
    split_unit,
    stated_coverage,
    without_coverage,
)


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("Expanded uncertainty (k=3)", 3.0),
        ("U95% k=1.96", 1.96),
        ("U(95 %), k = 2,5", 2.5),
        ("erweiterte Unsicherheit", 2.0),
        ("x_U95", 2.0),
        ("u95x", 2.0),
        ("U(0.95)", 2.0),
        ("U99 z", 2.576),
        ("u (99.7 %)", 3.0),
        ("2σ x", 2.0),
        ("3-sigma y", 3.0),
        ("1 sigma", 1.0),
        ("U (k=0)", None),
        ("sigma x", None),
        ("u950", None),
        ("x", None),
    ],
)
def test_the_factor_that_a_name_states(name, factor):
    assert stated_coverage(name) == factor
    assert coverage_of(name) == (factor or 1.0)


def test_what_states_the_coverage_is_taken_from_a_name():
    assert without_coverage("X_U95 [mm]").split() == ["x", "u"]
    assert without_coverage("expanded_u_x").split() == ["u", "u", "x"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("x_min", ("x_min", "")),
        ("J1 min", ("J1 min", "")),
        ("time_min", ("time", "min")),
        ("elapsedTime_min", ("elapsedTime", "min")),
        ("t [min]", ("t", "min")),
        ("Time/s", ("Time", "s")),
        ("J1/deg", ("J1", "deg")),
        ("x_m/s", ("x_m/s", "")),
    ],
)
def test_a_least_value_is_no_minute_and_a_speed_no_length(name, expected):
    assert split_unit(name) == expected


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("J1 [Nm]", "torque"),
        ("J1_Nm", "torque"),
        ("x (N)", "force"),
        ("J1 [°C]", "no position"),
        ("J1 [deg/s]", "no position"),
        ("x m/s²", "no position"),
        ("x_c", ""),  # x of a camera
        ("J1 [deg]", ""),
        ("Time/s", ""),
    ],
)
def test_what_a_unit_says_of_its_column(name, kind):
    assert said_by_unit(name) == kind
