"""Points along curves: a link apart, each the first, and how they end."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import least_squares, minimize_scalar
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from made_up_curves import Counting, chord_error, gentle_spline, scan, tight_spline
from pa10cal.errors import CurveError
from pa10cal_curve import points as module
from pa10cal_curve.curve import (
    Curve,
    circle,
    helix,
    line,
    polyline,
    serpenoid,
    spline_through,
    uniform_bounds,
)
from pa10cal_curve.points import (
    NONE,
    Ending,
    arc_length_m,
    equal_links,
    farthest_m,
    first_crossing,
    lay_points,
    parameters_at,
)


@pytest.mark.parametrize(
    ("curve", "link_m"),
    [
        (line(1.0), 1e-3),
        (circle(0.5), 3.1e-3),
        (circle(0.5), 0.95),
        (helix(0.1, 0.05, 10.0), 6e-3),
        (serpenoid(2.0, 3.0, 1.4), 2e-3),
        (gentle_spline(np.random.default_rng(1)), 1e-3),
        (tight_spline(np.random.default_rng(2)), 0.01),
        (polyline(np.random.default_rng(3).normal(size=(40, 3))), 0.05),
    ],
)
def test_links_are_of_their_length_and_end_on_the_curve(curve, link_m):
    points = lay_points(curve, link_m)
    assert chord_error(points) <= 1e-12
    np.testing.assert_allclose(points.p_m, curve.at(points.t), atol=1e-12)
    assert (np.diff(points.t) > 0.0).all()


@given(seed=st.integers(0, 2**32 - 1), link_m=st.floats(0.05, 1.5))
@examples(25)
def test_every_point_is_the_first_of_a_dense_scan(seed, link_m):
    curve = tight_spline(np.random.default_rng(seed))
    points = lay_points(curve, link_m, most=15)
    assert chord_error(points) <= 1e-12
    for low, high in zip(points.t[:-1], points.t[1:], strict=True):
        seen = scan(curve, low, link_m, 3001)
        assert seen is None or high <= seen * (1 + 1e-14)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), part=st.floats(0.02, 0.5))
@examples(25)
def test_points_found_together_are_those_found_one_by_one(seed, part):
    curve = tight_spline(np.random.default_rng(seed))
    link_m = part * curve.bounds.length_m[-1] / 20.0
    together = lay_points(curve, link_m)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "points_ahead", lambda *_: NONE)
        singly = lay_points(curve, link_m)
    assert together.n == singly.n
    np.testing.assert_allclose(together.p_m, singly.p_m, atol=1e-9)


def test_points_are_found_together_where_the_curve_bends_gently():
    curve = Counting(gentle_spline(np.random.default_rng(4)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "first_crossing", lambda *_: None)
        assert lay_points(curve, 1e-3).n > 900


def test_the_cost_is_linear_in_the_number_of_links():
    """In places of the curve asked for, besides those of any call; `make bench` measures time."""
    curve = gentle_spline(np.random.default_rng(5))
    counts = np.array([10.0, 100.0, 1000.0, 10_000.0, 100_000.0])
    places = []
    for n in counts:
        counting = Counting(curve)
        assert lay_points(counting, 1.0 / n).n >= n
        places.append(counting.places)
    growth = least_squares(
        lambda x: np.log(x[0] ** 2 + x[1] ** 2 * counts ** x[2]) - np.log(places), [5.0, 2.0, 1.0]
    )
    assert 0.95 <= growth.x[2] <= 1.05
    assert places[-1] < 6 * counts[-1]


@given(kappa_l=st.floats(0.01, 1.95), radius_m=st.floats(0.01, 100.0))
@examples(40)
def test_on_a_circle_every_link_turns_by_the_angle_of_its_chord(kappa_l, radius_m):
    points = lay_points(circle(radius_m, 6.0), kappa_l * radius_m, most=40)
    np.testing.assert_allclose(np.diff(points.t), 2.0 * np.arcsin(kappa_l / 2.0), rtol=1e-10)


@given(seed=st.integers(0, 2**32 - 1), link_m=st.floats(0.05, 0.8))
@examples(25)
def test_a_rigid_motion_of_the_curve_moves_the_points_with_it(seed, link_m):
    random = np.random.default_rng(seed)
    points_m = random.normal(size=(6, 3))
    turn, shift_m = Rotation.random(rng=random), random.normal(size=3)
    still = lay_points(spline_through(points_m), link_m, most=8)
    moved = lay_points(spline_through(turn.apply(points_m) + shift_m), link_m, most=8)
    assert still.n == moved.n
    np.testing.assert_allclose(moved.p_m, turn.apply(still.p_m) + shift_m, atol=1e-8)


@pytest.mark.parametrize(
    ("curve", "link_m", "most", "n", "ending", "left_m", "gap_m"),
    [
        (line(1.0), 0.1, None, 10, Ending.EXACT, 0.0, 0.0),
        (line(1.0), 0.3, None, 3, Ending.USED_UP, 0.1, 0.1),
        (line(1.0), 0.3, 2, 2, Ending.COMPLETE, 0.4, 0.4),
        (circle(1.0), 2.1, None, 0, Ending.INSIDE, 2 * np.pi, 0.0),
        (circle(1.0), 1.0, None, 6, Ending.EXACT, 0.0, 0.0),
        (circle(1.0), 1.9, None, 2, Ending.USED_UP, 2 * np.pi - 4 * np.arcsin(0.95), None),
        (helix(1.0, 0.01, 20.0), 2.5, None, 0, Ending.INSIDE, 40 * np.pi, 0.2),
    ],
)
def test_how_the_points_end(curve, link_m, most, n, ending, left_m, gap_m):
    points = lay_points(curve, link_m, most)
    assert points.n == n
    assert points.ending is ending
    assert points.left_m == pytest.approx(left_m, rel=1e-5, abs=1e-9)
    if gap_m is not None:
        assert points.gap_m == pytest.approx(gap_m, abs=1e-9)


def test_points_of_a_polyline_are_on_it_beside_its_corners():
    corners_m = np.array([[0.0, 0, 0], [0.35, 0, 0], [0.5, 0.1, 0.2], [0.6, 0.4, 0.3], [1, 1, 1]])
    for link_m in 0.05 + 0.01 * np.random.default_rng(1).uniform(size=50):
        points = lay_points(polyline(corners_m), link_m)
        begin, along = corners_m[:-1], np.diff(corners_m, axis=0)
        part = ((points.p_m[:, None] - begin) * along).sum(axis=2) / (along**2).sum(axis=1)
        near = begin + part.clip(0.0, 1.0)[..., None] * along
        off_m = np.linalg.norm(points.p_m[:, None] - near, axis=2).min(axis=1)
        assert off_m.max() < 1e-15


def test_a_touch_is_said_to_be_one():
    points = lay_points(circle(1.0, 2.5 * np.pi), 2.0)
    assert points.touches[0]
    assert chord_error(points) <= 1e-12


@pytest.mark.parametrize(
    ("link_m", "most", "message"),
    [
        (0.0, None, r"link_m: the length of a link is not positive \(got 0.0\)"),
        (-1.0, None, "not positive"),
        (np.nan, None, "not positive"),
        (1.5, None, r"link_m: the link is longer than the curve \(got 1.5\); .* 1 m"),
        (1e-9, None, "the links are too many"),
    ],
)
def test_lengths_that_give_no_links_are_refused(link_m, most, message):
    with pytest.raises(CurveError, match=message):
        lay_points(line(1.0), link_m, most)


def test_so_many_links_are_laid_where_a_number_is_asked_for():
    assert lay_points(line(1.0), 1e-9, most=5).n == 5


@pytest.mark.parametrize(
    ("curve", "n"),
    [
        (line(1.0), 1),
        (line(1.0), 7),
        (circle(1.0), 6),
        (circle(1.0, 3.0), 1),
        (helix(0.1, 0.05, 5.0), 100),
        (serpenoid(2.0, 2.0, 1.1), 23),
        (gentle_spline(np.random.default_rng(6)), 300),
    ],
)
def test_equal_links_end_exactly_where_the_curve_ends(curve, n):
    points = equal_links(curve, n)
    assert points.n == n
    assert points.ending is Ending.EXACT
    assert chord_error(points) <= 1e-12
    end_m = curve.at(np.array([curve.bounds.end]))[0]
    np.testing.assert_allclose(points.p_m[-1], end_m, atol=1e-11)
    if n == 6:
        assert points.link_m == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize(
    ("n", "message"),
    [(0, "links: there is no link"), (1, "no 1 equal links end where the curve ends")],
)
def test_numbers_of_links_that_cannot_end_there_are_refused(n, message):
    with pytest.raises(CurveError, match=message):
        equal_links(circle(1.0, 5.0), n)


# The first point at a distance, where curves come near it, touch it and come back.


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
@examples(80)
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
@examples(40)
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


@pytest.mark.parametrize("link_m", [0.9, 0.1, 1e-3])
def test_a_circle_is_as_far_from_its_links_as_their_sagitta(link_m):
    circle_m = circle(1.0, 5.0)
    sagitta_m = 1.0 - np.sqrt(1.0 - link_m**2 / 4.0)
    assert farthest_m(circle_m, lay_points(circle_m, link_m)) == pytest.approx(sagitta_m, abs=1e-15)


def test_a_polyline_is_farthest_from_its_links_where_it_bends():
    bent = polyline(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]))
    points = lay_points(bent, 0.3, 4)  # the fourth link goes from (0.9, 0, 0) past the corner
    x, y, _ = points.p_m[4] - points.p_m[3]
    assert farthest_m(bent, points) == pytest.approx(0.1 * y / np.hypot(x, y), rel=1e-9)
    assert farthest_m(bent, lay_points(bent, 0.3, 3)) < 1e-15


@given(seed=st.integers(0, 2**32 - 1), link_m=st.floats(0.05, 1.0))
@examples(20)
def test_no_place_is_farther_from_its_link_than_stated(seed, link_m):
    curve = tight_spline(np.random.default_rng(seed))
    points = lay_points(curve, link_m, most=12)
    assume(points.n)
    seen = 0.0
    for k, u in enumerate(points.directions):
        away = curve.at(np.linspace(points.t[k], points.t[k + 1], 2001)) - points.p_m[k]
        beside = np.clip(away @ u, 0.0, link_m)[:, None] * u
        seen = max(seen, np.linalg.norm(away - beside, axis=1).max())
    assert farthest_m(curve, points) == pytest.approx(seen, rel=0.02)


@pytest.mark.parametrize(
    "curve",
    [
        circle(0.5, 5.0),
        tight_spline(np.random.default_rng(2)),
        polyline(np.random.default_rng(3).normal(size=(9, 3))),
    ],
)
def test_parameters_of_arc_lengths(curve):
    start, end = curve.bounds.start, curve.bounds.end
    whole_m = arc_length_m(curve, start, end)
    asked_m = whole_m * np.array([0.0, 1e-6, 0.2, 0.5, 0.93, 1.0, 1.2])
    t = parameters_at(curve, asked_m)
    found_m = [arc_length_m(curve, start, at) if at > start else 0.0 for at in t]
    np.testing.assert_allclose(found_m, asked_m.clip(max=whole_m), rtol=1e-6, atol=1e-9)
    assert t[0] == start
    assert t[-1] == end


@given(seed=st.integers(0, 2**32 - 1))
@examples(15)
def test_links_that_begin_where_another_ended_go_on_as_the_others(seed):
    curve = tight_spline(np.random.default_rng(seed))
    points = lay_points(curve, 0.2, most=12)
    later = lay_points(curve, 0.2, most=9, start=points.t[3])
    np.testing.assert_allclose(later.p_m, points.p_m[3:], atol=1e-9)


def test_a_bound_that_the_curve_breaks_is_refused():
    true = helix(0.3, 0.2, 2.0)
    false = Curve(true.place, true.velocity, uniform_bounds(0.0, true.bounds.end, 0.0, 0.03))
    with pytest.raises(CurveError, match=r"t = .*faster than its bound says \(got 0.30"):
        lay_points(false, 0.05)
