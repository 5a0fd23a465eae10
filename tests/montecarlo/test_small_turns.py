"""Sine and versine of small angles against extended precision."""

import numpy as np
import pytest

from pa10cal.montecarlo.small_turns import LibraryTurns, SeriesTurns, turns_of

NORMALS = np.concatenate([np.linspace(-8, 8, 1601), [1e-9, -1e-9]])


def filled(turns):
    sine, versine = np.empty_like(NORMALS), np.empty_like(NORMALS)
    turns.fill(NORMALS, sine, versine)
    return turns.sine_scale * sine, turns.versine_scale * versine


@pytest.mark.parametrize("sigma_rad", [1e-6, np.radians(0.011), 2.5e-4, 1e-2, 0.3])
def test_exact_to_the_last_picometre_of_a_metre(sigma_rad):
    angle = sigma_rad * NORMALS.astype(np.longdouble)
    sine, versine = filled(turns_of(sigma_rad, most_added=1))
    np.testing.assert_allclose(sine, np.sin(angle), rtol=1e-14, atol=3e-16)
    np.testing.assert_allclose(versine, 2 * np.sin(angle / 2) ** 2, rtol=1e-13, atol=1e-12)


def test_series_only_where_it_is_exact():
    assert isinstance(turns_of(np.radians(0.011), most_added=2), SeriesTurns)
    assert isinstance(turns_of(np.radians(0.02), most_added=1), LibraryTurns)
    assert isinstance(turns_of(2.5e-4, most_added=1), SeriesTurns)
    assert isinstance(turns_of(2.5e-4, most_added=3), LibraryTurns)


def test_both_ways_agree():
    for series, library in zip(filled(SeriesTurns(1e-4)), filled(LibraryTurns(1e-4)), strict=True):
        np.testing.assert_allclose(series, library, rtol=1e-13, atol=2e-14)
