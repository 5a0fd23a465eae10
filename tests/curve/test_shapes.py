"""Curves given by formulas."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from pa10cal.curve.curve import circle, helix, line, serpenoid, uniform_bounds
from pa10cal.errors import CurveError

SHAPES = {
    "line": line(2.0),
    "circle": circle(0.4, 5.0),
    "helix": helix(0.3, -0.2, 2.5, 0.4),
    "serpenoid": serpenoid(3.0, 2.0, 1.3, -0.6),
    "winding serpenoid": serpenoid(3.0, 2.0, 4.0, 0.2),
}


@pytest.mark.parametrize("name", SHAPES)
def test_the_velocity_is_the_derivative_and_within_bounds(name):
    curve = SHAPES[name]
    bounds = curve.bounds
    t = np.linspace(bounds.start, bounds.end, 4001)
    r, v = curve.with_velocity(t)
    np.testing.assert_array_equal(r, curve.at(t))
    slope = (r[2:] - r[:-2]) / (t[2:] - t[:-2])[:, None]
    np.testing.assert_allclose(v[1:-1], slope, atol=2e-4)
    speed = np.linalg.norm(v, axis=1)
    assert (speed <= bounds.fastest.max()).all()
    assert (speed >= bounds.slowest.min()).all()
    change = np.linalg.norm(np.diff(v, axis=0), axis=1) / np.diff(t)
    assert (change <= bounds.acceleration.max() * (1 + 1e-9) + 1e-9).all()


@given(
    waves=st.floats(0.1, 5), amplitude=st.floats(0.05, 6), phase=st.floats(-7, 7), t=st.floats(0, 2)
)
@settings(max_examples=60, deadline=None)
def test_the_serpenoid_is_the_integral_of_its_heading(waves, amplitude, phase, t):
    curve = serpenoid(2.0, waves, amplitude, phase)

    def heading(s):
        return amplitude * np.cos(np.pi * waves * s + phase)

    # Over parts of the length: of a length of 1e-307 the quadrature warns of rounding.
    exact = {"epsabs": 1e-13, "epsrel": 1e-13, "limit": 200}
    x = t * quad(lambda part: np.cos(heading(part * t)), 0, 1, **exact)[0]
    y = t * quad(lambda part: np.sin(heading(part * t)), 0, 1, **exact)[0]
    np.testing.assert_allclose(curve.at(np.array([t])), [[x, y, 0.0]], atol=1e-11)


def test_a_circle_is_a_flat_helix_from_the_x_axis_on():
    np.testing.assert_allclose(
        circle(2.0).at(np.array([0.0, np.pi / 2])), [[2, 0, 0], [0, 2, 0]], atol=1e-15
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: line(0.0), r"length_m: .*\(got 0.0\)"),
        (lambda: circle(-1.0), "radius_m"),
        (lambda: helix(1.0, np.nan, 3.0), "pitch_m: .* not finite"),
        (lambda: helix(1.0, 0.1, 0.0), "turns"),
        (lambda: helix(1.0, 0.1, 1.0, np.inf), "phase_rad"),
        (lambda: serpenoid(1.0, 2.0, 0.0), "amplitude_rad"),
    ],
)
def test_measures_that_make_no_shape_are_refused(make, message):
    with pytest.raises(CurveError, match=message):
        make()


def test_a_callable_needs_a_bound_of_its_speed_only():
    bounds = uniform_bounds(0.0, 1.0, 0.0, fastest=2.3)
    assert bounds.length_m[-1] == pytest.approx(2.3)
    assert np.isinf(bounds.turning_between(np.array([0.2, 0.3])))
    assert np.isinf(bounds.curvature_between(np.array([0.2, 0.3])))
    assert np.isfinite(uniform_bounds(0.0, 1.0, 1.0, 2.3, 2.0).curvature).all()
