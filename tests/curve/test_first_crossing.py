"""The first point at a distance, where curves come near it, touch it and come back."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from made_up_curves import scan, tight_spline
from pa10cal.curve.curve import Curve, circle, polyline, spline_through, uniform_bounds
from pa10cal.curve.points import first_crossing

SPLINES = 1500


def start_of(curve, part=0.0):
    t = curve.bounds.start + part * (curve.bounds.end - curve.bounds.start)
    return t, curve.at(np.array([t]))[0]


def distance(curve, t, p_m):
    return float(np.linalg.norm(curve.at(np.array([t]))[0] - p_m))


@pytest.mark.slow
def test_never_behind_the_first_of_a_dense_scan():
    """Ten thousand of them are scanned by `make bench`."""
    random = np.random.default_rng(20080427)
    missed, found_none = 0, 0
    for _ in range(SPLINES):
        curve = tight_spline(random)
        t, p_m = start_of(curve, random.uniform(0.0, 0.7))
        link_m = random.uniform(0.2, 3.0)
        found = first_crossing(curve, t, p_m, link_m)
        seen = scan(curve, t, link_m, 2001)
        if found is None:
            assert seen is None
            found_none += 1
            continue
        assert distance(curve, found.t, p_m) == pytest.approx(link_m, rel=1e-12)
        np.testing.assert_allclose(found.p_m, curve.at(np.array([found.t]))[0], atol=1e-13)
        assert seen is None or found.t <= seen * (1 + 1e-14)
        missed += seen is None
    assert 50 < found_none < SPLINES / 2  # both kinds are tried
    assert missed < SPLINES / 100  # the scan itself may miss a short excursion


@given(seed=st.integers(0, 2**32 - 1), gap=st.sampled_from([1e-3, 1e-6, 1e-8, 1e-10, 1e-11]))
@settings(max_examples=80, deadline=None)
def test_a_bend_that_just_reaches_is_found_and_one_that_just_does_not_is_passed(seed, gap):
    curve = tight_spline(np.random.default_rng(seed))
    t, p_m = start_of(curve)
    at = np.linspace(t, curve.bounds.end, 4001)
    away = np.linalg.norm(curve.at(at) - p_m, axis=1)
    tops = np.flatnonzero((away[1:-1] > away[:-2]) & (away[1:-1] >= away[2:])) + 1
    tops = [k for k in tops if away[k] > away[:k].max() and away[k] > 0.1]
    assume(tops)
    k = tops[0]
    top = minimize_scalar(
        lambda s: -distance(curve, s, p_m),
        bounds=(at[k - 1], at[k + 1]),
        method="bounded",
        options={"xatol": 1e-12},
    )
    reaching = first_crossing(curve, t, p_m, -top.fun * (1.0 - gap))
    assert reaching is not None
    assert reaching.t <= top.x + 1e-9
    assert not reaching.touches
    passing = first_crossing(curve, t, p_m, -top.fun * (1.0 + gap))
    assert passing is None or passing.t > top.x
    touching = first_crossing(curve, t, p_m, -top.fun)
    assert touching is not None
    assert touching.touches
    assert touching.t == pytest.approx(top.x, abs=1e-4)


def test_a_circle_is_touched_across_and_never_left_beyond():
    curve = circle(1.0)
    t, p_m = start_of(curve)
    across = first_crossing(curve, t, p_m, 2.0)
    assert across.touches
    assert across.t == pytest.approx(np.pi, abs=1e-6)
    assert first_crossing(curve, t, p_m, 2.0 + 1e-9) is None
    before = first_crossing(curve, t, p_m, 2.0 - 1e-9)
    assert not before.touches
    assert before.t == pytest.approx(2.0 * np.arcsin(1.0 - 5e-10), rel=1e-9)


def test_a_corner_can_be_touched():
    curve = polyline(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0.5, 0.5, 0]]))
    t, p_m = start_of(curve)
    found = first_crossing(curve, t, p_m, np.sqrt(2.0))
    assert found.touches
    np.testing.assert_allclose(found.p_m, [1, 1, 0], atol=1e-12)
    assert first_crossing(curve, t, p_m, 1.4143) is None


def test_a_fold_back_on_itself_is_no_obstacle():
    curve = polyline(np.array([[0.0, 0, 0], [0.9, 0, 0], [0.1, 0, 0], [3.0, 0, 0]]))
    found = first_crossing(curve, *start_of(curve), 1.0)
    assert found.t == pytest.approx(0.9 + 0.8 + 0.9)


def test_a_cusp_is_passed():
    """Where the velocity vanishes no curvature is bounded."""
    curve = Curve(
        lambda t: np.stack([t**3, t**2, 0 * t], axis=1),
        lambda t: np.stack([3 * t**2, 2 * t, 0 * t], axis=1),
        uniform_bounds(-1.0, 1.0, 0.0, fastest=np.sqrt(13.0), acceleration=np.sqrt(40.0)),
    )
    t, p_m = start_of(curve)
    found = first_crossing(curve, t, p_m, 1.2)
    assert scan(curve, t, 1.2, 100001) == pytest.approx(found.t, abs=3e-5)


@given(link_m=st.floats(0.05, 1.9), part=st.floats(0.0, 0.5))
@settings(max_examples=40, deadline=None)
def test_a_bound_of_the_speed_alone_finds_the_same(link_m, part):
    known = circle(1.0)
    bare = Curve(known.place, known.velocity, uniform_bounds(0.0, 2.0 * np.pi, 0.0, fastest=1.7))
    t, p_m = start_of(known, part)
    found, slowly = first_crossing(known, t, p_m, link_m), first_crossing(bare, t, p_m, link_m)
    assert slowly.t == pytest.approx(found.t, rel=1e-12)
    assert distance(bare, slowly.t, p_m) == pytest.approx(link_m, rel=1e-12)


def test_the_end_of_the_curve_counts():
    curve = spline_through(np.array([[0.0, 0, 0], [0.5, 0.2, 0], [1, 0, 0]]))
    t, p_m = start_of(curve)
    assert first_crossing(curve, t, p_m, 1.0).t == pytest.approx(curve.bounds.end, rel=1e-9)
    assert first_crossing(curve, curve.bounds.end, np.array([1.0, 0, 0]), 0.1) is None
