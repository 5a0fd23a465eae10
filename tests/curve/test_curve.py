"""Curves given by formulas and through points, and the bounds they state of themselves."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from drawn_examples import examples
from made_up_curves import tight_spline
from pa10cal.errors import CurveError
from pa10cal_curve.curve import (
    circle,
    helix,
    line,
    polyline,
    serpenoid,
    spline_through,
    uniform_bounds,
)
from pa10cal_curve.points import arc_length_m

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
@examples(60)
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
        (lambda: line(1e300), r"length_m: .*; allowed: 1e-50 to 1e\+50"),
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


@pytest.mark.parametrize(
    "bounds",
    [
        (1.0, 0.0, 0.0, 1.0),
        (0.0, np.nan, 0.0, 1.0),
        (0.0, 1.0, 2.0, 1.0),
        (0.0, 1.0, -1.0, 1.0),
        (0.0, 1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0, 1.0, -1.0),
    ],
)
def test_bounds_that_cannot_hold_are_refused(bounds):
    with pytest.raises(CurveError, match="the bounds of the curve cannot all hold"):
        uniform_bounds(*bounds)


# Splines and polylines, and the bounds they state of themselves.


SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


@given(seed=st.integers(0, 2**32 - 1))
@examples(60)
def test_no_place_of_a_spline_breaks_its_bounds(seed):
    curve = tight_spline(np.random.default_rng(seed))
    bounds = curve.bounds
    t = np.linspace(bounds.start, bounds.end, 3001)[:-1]
    cell = bounds.cells(t)
    _, v = curve.with_velocity(t)
    a = curve.place(t, nu=2)
    speed, change = np.linalg.norm(v, axis=1), np.linalg.norm(a, axis=1)
    assert (speed >= bounds.slowest[cell]).all()
    assert (speed <= bounds.fastest[cell]).all()
    assert (change <= bounds.acceleration[cell]).all()
    turning = np.linalg.norm(np.cross(v, a), axis=1) / speed**2
    assert (turning <= bounds.turning[cell] * (1 + 1e-9)).all()
    assert (turning / speed <= bounds.curvature[cell] * (1 + 1e-9)).all()


@given(seed=st.integers(0, 2**32 - 1))
@examples(20)
def test_length_and_turning_between_places_are_no_more_than_stated(seed):
    random = np.random.default_rng(seed)
    curve = tight_spline(random)
    bounds = curve.bounds
    t = np.sort(random.uniform(bounds.start, bounds.end, 12))
    stated = bounds.turning_between(t)
    for k, (low, high) in enumerate(itertools.pairwise(t)):
        _, v = curve.with_velocity(np.linspace(low, high, 2001))
        u = v / np.linalg.norm(v, axis=1)[:, None]
        assert np.linalg.norm(np.diff(u, axis=0), axis=1).sum() <= stated[k] * (1 + 1e-9) + 1e-9
    lengths = np.diff(bounds.length_to(t))
    found = [arc_length_m(curve, low, high) for low, high in itertools.pairwise(t)]
    assert (np.array(found) <= lengths * (1 + 1e-12)).all()


def test_bounds_of_a_gentle_spline_are_tight():
    t = np.linspace(0.0, 3.0, 12)
    bounds = spline_through(np.stack([np.cos(t), np.sin(t), 0.2 * t], axis=1)).bounds
    assert bounds.length_m[-1] < 1.01 * 3.0 * np.hypot(1.0, 0.2)
    assert np.median(bounds.curvature) < 1.05 / 1.04


def test_the_arc_length_is_that_of_a_quadrature():
    curve = tight_spline(np.random.default_rng(3))
    knots = curve.place.x

    def speed(t):
        return float(np.linalg.norm(curve.with_velocity(np.array([t]))[1]))

    expected = sum(
        quad(speed, low, high, epsabs=1e-12, limit=500)[0]
        for low, high in itertools.pairwise(knots)
    )
    assert arc_length_m(curve, knots[0], knots[-1]) == pytest.approx(expected, rel=1e-6)


def test_a_polyline_is_straight_with_kinks():
    curve = polyline(SQUARE)
    bounds = curve.bounds
    assert bounds.end == pytest.approx(3.0)
    assert bounds.length_m[-1] == pytest.approx(3.0, rel=1e-8)
    assert not bounds.acceleration.any()
    assert sorted(bounds.kinks_rad[bounds.kinks_rad > 1e-6]) == pytest.approx([np.pi / 2] * 2)
    t = np.array([0.25, 0.75, 1.5, 2.5])
    np.testing.assert_allclose(bounds.turning_between(t), [0, np.pi / 2, np.pi / 2], atol=1e-9)
    np.testing.assert_array_equal(bounds.curvature_between(t), [0, np.inf, np.inf])
    np.testing.assert_allclose(curve.at(np.array([1.5])), [[1.0, 0.5, 0.0]], atol=1e-15)


def test_two_points_are_a_straight_spline():
    curve = spline_through(SQUARE[:2])
    np.testing.assert_allclose(curve.at(np.array([0.25])), [[0.25, 0.0, 0.0]], atol=1e-15)
    assert curve.bounds.curvature.max() < 1e-12


def test_a_closed_spline_returns_without_a_kink():
    curve = spline_through(SQUARE, closed=True)
    ends, v = curve.with_velocity(np.array([curve.bounds.start, curve.bounds.end]))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-15)
    np.testing.assert_allclose(v[0], v[1], atol=1e-12)


@pytest.mark.parametrize("off_m", [0.0, 1e-15])
def test_a_closed_spline_whose_last_point_repeats_the_first_is_refused(off_m):
    with pytest.raises(CurveError, match="point 5: the last point of a closed curve repeats"):
        spline_through(np.vstack([SQUARE, SQUARE[:1] + off_m]), closed=True)


def test_a_spline_that_strays_from_its_points_is_refused():
    """Three points at rest before a long gap: it went 60 m away from a square of one metre."""
    at_rest = SQUARE[2] + 1e-3 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0]])
    points = np.vstack([SQUARE[:2], at_rest, SQUARE[3:]])
    with pytest.raises(CurveError, match=r"points 6 and 7: the spline strays .* m of spline along"):
        spline_through(points)
    assert polyline(points).bounds.length_m[-1] < 3.1


@pytest.mark.parametrize("make", [spline_through, polyline])
@pytest.mark.parametrize(
    ("points", "message"),
    [
        (SQUARE[:1], r"points: there are too few points .*\(got \(1, 3\)\); allowed: two points"),
        (SQUARE[:, :2], "each x, y, z"),
        (np.vstack([SQUARE, [0, np.nan, 0]]), "point 5: a point is not finite"),
        (np.vstack([SQUARE, SQUARE[-1:], SQUARE]), "point 5: a point repeats the one before"),
        # Apart by rounding alone: a spline through them was 7.7e14 m long, or ended in a fault.
        (np.insert(SQUARE, 2, [1, 1e-16, 0], axis=0), r"point 3: .*more than 9.1e-13 m apart"),
        (np.insert(SQUARE, 2, [1 + 2e-16, 0, 0], axis=0), "point 3: a point repeats the one"),
        (1e-300 * SQUARE, "point 2: a point repeats the one before"),
        (1e300 * SQUARE, "point 2: a point is not finite, or too far away"),
    ],
)
def test_points_that_are_no_curve_are_refused(make, points, message):
    with pytest.raises(CurveError, match=message):
        make(points)
