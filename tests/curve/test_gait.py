"""Shapes that move: continuous, and within what was allowed."""

import numpy as np
import pytest

from pa10cal.errors import CurveError
from pa10cal_curve.angles import first_axes
from pa10cal_curve.curve import helix, serpenoid, spline_through
from pa10cal_curve.gait import follow, laid
from pa10cal_curve.options import CurveOptions
from pa10cal_curve.points import arc_length_m
from pa10cal_curve.roll import RollMap, smallest_move

LINK_M, LINKS, PERIOD_S = 0.1, 10, 2.0


def wriggling(phase):
    t = np.linspace(0.0, 1.0, 9)
    return spline_through(
        np.stack([1.5 * t, 0.2 * np.sin(6 * t + phase), 0.2 * np.sin(9 * t + phase)], axis=1)
    )


def phases(time_s):
    return 2.0 * np.pi * time_s / PERIOD_S


def options(moves="wave", move_rad=0.0, **chosen):
    shape = {"shape": "helix", "radius_m": 0.2, "pitch_m": 0.4, "turns": 1.5}
    gait = {"moves": moves, "period_s": PERIOD_S, "seconds": 1, "move_deg": np.degrees(move_rad)}
    known = {"link_m": LINK_M, "links": LINKS, "curve": shape, "gait": gait}
    return CurveOptions(**known, **chosen)


def wriggle(frames, **chosen):
    time_s = np.linspace(0.0, PERIOD_S, frames + 1)
    return follow(list(map(wriggling, phases(time_s))), time_s, options(**chosen))


def within(limit_rad):
    most = np.degrees(limit_rad)
    return {"a_deg": (-most, most), "b_deg": (-most, most)}


@pytest.mark.slow
@pytest.mark.parametrize("move_rad", [0.0, 0.2])
def test_angles_over_time_are_continuous(move_rad):
    """Half the time between shapes, half the moves."""
    coarse, fine = (wriggle(frames, move_rad=move_rad * 10.0 / frames) for frames in (20, 80))
    assert fine.move_rad.max() < 0.35 * coarse.move_rad.max()
    np.testing.assert_array_equal(
        fine.move_rad,
        np.abs(np.diff(fine.turns_rad, axis=0)).max(axis=(1, 2)),
    )


@pytest.mark.slow
def test_the_roll_is_the_best_that_may_be_reached():
    free, still = wriggle(30, move_rad=1.0), wriggle(30)
    for shape, points in enumerate(free.points):
        best = smallest_move(RollMap.of(points.directions))
        reached = np.abs(free.turns_rad[shape]).max()
        assert reached == pytest.approx(best.level_rad, abs=1e-7)
    assert still.move_rad.max() < free.move_rad.max()


def test_limits_are_kept_all_along_or_refused_with_the_time():
    limit = 0.9 * np.abs(wriggle(20).turns_rad[:, 1]).max() + 0.1
    kept = wriggle(20, move_rad=0.05, limits=within(limit))
    assert np.abs(kept.turns_rad).max() <= limit + 1e-9
    with pytest.raises(CurveError, match=r"^time 0 s, joint \d+: no roll keeps"):
        wriggle(20, limits=within(0.1))


def test_a_serpenoid_stays_flat_at_the_roll_given():
    time_s = np.linspace(0.0, PERIOD_S, 25)
    curves = [serpenoid(1.3, 1.5, 0.8, phase) for phase in phases(time_s)]
    gait = follow(curves, time_s, options(roll="given"))
    a_rad, b_rad = np.swapaxes(gait.turns_rad, 0, 1)
    np.testing.assert_allclose(b_rad, 0.0, atol=1e-12)
    assert gait.move_rad.max() < 0.3  # z stays where it is when the first bend changes sides
    np.testing.assert_allclose(a_rad[0], a_rad[-1], atol=1e-9)
    np.testing.assert_allclose([points.p_m[0] for points in gait.points], 0.0, atol=1e-15)


def test_a_rolling_helix_bends_every_joint_to_all_sides_in_turn():
    time_s = np.linspace(0.0, 2.0 * PERIOD_S, 81)
    gait = follow([helix(0.2, 0.4, 1.5)] * 81, time_s, options("roll"))
    a_rad, b_rad = np.swapaxes(gait.turns_rad, 0, 1)
    bend = RollMap.of(gait.points[0].directions).bend_rad
    np.testing.assert_allclose(bend, bend[0], atol=1e-9)
    assert a_rad.max(axis=0) == pytest.approx(bend, rel=0.02)
    assert b_rad.min(axis=0) == pytest.approx(-bend, rel=0.02)
    np.testing.assert_allclose(a_rad[40], a_rad[0], atol=1e-9)
    np.testing.assert_allclose(a_rad[20], -a_rad[0], atol=1e-9)
    np.testing.assert_allclose(np.diff(gait.roll_rad), np.pi / 20)
    expected = first_axes(gait.points[0].directions, gait.roll_rad[7])
    np.testing.assert_allclose(gait.joints[7].axes[0], expected, atol=1e-12)


def test_links_that_do_not_fit_are_refused_with_the_time():
    time_s = np.array([0.0, 1.0])
    curves = [serpenoid(1.3, 1.5, 0.8), serpenoid(0.9, 1.5, 0.8)]
    with pytest.raises(
        CurveError, match=r"time 1 s, links: the links do not fit .*; allowed: 8 at"
    ):
        follow(curves, time_s, options())


PATH = [[0.0, 0.0, 0.0], [0.5, 0.1, 0.0], [0.9, 0.5, 0.2], [1.2, 0.4, 0.6], [1.9, 0.2, 0.5]]
ALONG = {"moves": "along", "speed_m_s": 0.2, "seconds": 4.0, "shapes": 33}


def test_links_follow_a_path_at_the_speed_asked_for():
    """Each place that the first link has left is where the others pass, as of a snake."""
    path = spline_through(np.array(PATH))
    known = CurveOptions(link_m=LINK_M, links=LINKS, gait=ALONG)
    record, tables = laid(path, known)
    points = tables["points"]
    p_m = np.stack([points[f"{axis}_m"] for axis in "xyz"], axis=1).reshape(33, LINKS + 1, 3)
    t = points["t"].reshape(33, LINKS + 1)
    gone_m = [0.0, *(arc_length_m(path, t[0, 0], begun) for begun in t[1:, 0])]
    np.testing.assert_allclose(gone_m, 0.2 * np.linspace(0.0, 4.0, 33), atol=1e-6)
    np.testing.assert_allclose(path.at(t.ravel()), p_m.reshape(-1, 3), atol=1e-12)
    assert record.shapes[-1].ending == "complete"
    assert record.largest_move_deg < 15.0
    # Two steps of 0.025 m are half a link: halving them about halves the moves.
    fine, _ = laid(
        path, known.model_copy(update={"gait": known.gait.model_copy(update={"shapes": 65})})
    )
    assert fine.largest_move_deg < 0.6 * record.largest_move_deg


def test_a_path_that_ends_before_the_links_have_gone_along_it_is_refused():
    path = spline_through(np.array(PATH))
    with pytest.raises(
        CurveError, match=r"^time 10 s, links: the links do not fit .*allowed: \d at"
    ):
        laid(
            path,
            CurveOptions(link_m=LINK_M, links=LINKS, gait={**ALONG, "seconds": 10.0, "shapes": 2}),
        )
