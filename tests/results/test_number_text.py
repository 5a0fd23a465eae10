"""Numbers as messages write them."""

import numpy as np
import pytest

from pa10cal.results.number_text import duration_text, plain_number, with_half_width_95


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (2012.4, 8.0, "2012 ± 8"),
        (12.96, 0.42, "13.0 ± 0.4"),
        (12.96, 0.96, "13 ± 1"),
        (1234.0, 123.0, "1230 ± 120"),
        (0.15, 0.149, "0.15 ± 0.15"),
        (1.4, 1.45, "1.4 ± 1.4"),
        (-0.004, 0.3, "0.0 ± 0.3"),
        (-13.0, 700.0, "0 ± 700"),
        (5.0, np.inf, "5 ± inf"),
        (5.0, 0.0, "5 ± 0"),
    ],
)
def test_a_value_has_the_digits_of_its_interval(value, half, text):
    assert with_half_width_95(value, half / 1.96) == text


def test_a_sign_is_shown_where_it_is_asked_for():
    assert with_half_width_95(20.13, 0.1 / 1.96, sign="+") == "+20.13 ± 0.10"
    assert with_half_width_95(-0.01, 0.4 / 1.96, sign="+") == "+0.0 ± 0.4"


@pytest.mark.parametrize(
    ("value", "text"),
    [(1000.05, "1000"), (12.75, "12.8"), (10.0, "10"), (-0.0, "0"), (0.3648, "0.365")],
)
def test_masses_have_no_exponent(value, text):
    assert plain_number(value) == text


@pytest.mark.parametrize(
    ("time_s", "text"),
    [(0.0, "0 s"), (5.0, "5 s"), (90.0, "1.5 min"), (5400.0, "90 min"), (7199.0, "2 h")],
)
def test_durations_are_in_the_unit_that_suits_them(time_s, text):
    assert duration_text(time_s) == text
