"""What the page draws of errors by joint angle and of the Monte Carlo is what the records say."""

import numpy as np
import pytest

from pa10cal.reports.outcome import errors_by_angle
from pa10cal.reports.pictures import campaigns_drawings, joint_map_drawings, plane_drawings
from pa10cal.results.calibration import CampaignsAgree, EffectByCampaign, JointErrorAlone


def values(trace):
    """Return what a trace has along y, nan where there is a gap."""
    return np.array([np.nan if value is None else value for value in trace.y], dtype=float)


class TestJointErrorMaps:
    def test_the_line_runs_through_the_knots_and_the_band_is_theirs(self, learnt):
        first, third = joint_map_drawings(learnt.verdict)
        assert (first.id, third.id) == ("joint-error-1", "joint-error-3")
        assert first.caption.startswith("Rms 0.212 mrad (43.7 arc seconds) over the turn")
        assert (
            "over the measured angles; 5 % of the turn measured; knots 15° apart." in third.caption
        )
        band, seen, unseen = third.figure.data
        angle = np.array(seen.x)
        line = np.where(np.isnan(values(seen)), values(unseen), values(seen))
        np.testing.assert_allclose(line, 0.3 * np.sin(3 * np.radians(angle)), atol=5e-3)
        effect = next(e for e in learnt.verdict.effects if e.of == "joint 3")
        at_knots = np.isin(angle, np.arange(0.0, 360.0, 15.0))
        knots = [1e3 * parameter.value for parameter in effect.parameters.values()]
        np.testing.assert_allclose(line[at_knots], knots, atol=1e-4)
        for k, std in ((4, 2e-5), (5, 3e-5)):
            ends = values(band)[np.isclose(band.x, 15.0 * k)]
            assert np.ptp(ends) == pytest.approx(2 * 1.96e3 * std, rel=5e-3)

    def test_angles_that_the_poses_fitted_have_not_seen_are_extrapolated(self, learnt):
        first, third = joint_map_drawings(learnt.verdict)
        _, known, guessed = third.figure.data
        inside = (np.array(known.x) > 10.2) & (np.array(known.x) < 27.8)
        np.testing.assert_array_equal(np.isfinite(values(known)), inside)
        np.testing.assert_array_equal(np.isfinite(values(guessed)), ~inside)
        assert guessed.line.dash == "dot"
        assert len(third.figure.layout.shapes) == 2
        assert np.isnan(values(first.figure.data[1])).all()
        assert "0 % of the turn measured" in first.caption

    def test_a_band_wider_than_the_map_is_within_the_axis(self, learnt):
        verdict = learnt.verdict.model_copy(update={"angles_seen": None})
        for drawing in joint_map_drawings(verdict):
            band = values(drawing.figure.data[0])
            assert np.nanmax(np.abs(band)) < drawing.figure.layout.yaxis.range[1]

    def test_a_map_judged_by_repeats_is_drawn_without_angles_seen(self, learnt):
        verdict = learnt.verdict.model_copy(update={"angles_seen": None})
        drawing = next(joint_map_drawings(verdict))
        assert np.isfinite(values(drawing.figure.data[1])).all()
        assert not drawing.figure.layout.shapes

    def test_maps_of_other_numbers_of_knots_share_an_axis(self, learnt):
        first, *others = learnt.verdict.effects
        fewer = dict(list(first.parameters.items())[:7])
        effects = (first.model_copy(update={"parameters": fewer}), *others)
        verdict = learnt.verdict.model_copy(update={"effects": effects})
        drawings = list(joint_map_drawings(verdict))
        assert len({len(drawing.figure.data[1].x) for drawing in drawings}) == 2
        assert len({tuple(drawing.figure.layout.yaxis.range) for drawing in drawings}) == 1

    def test_nothing_is_said_where_there_is_no_map(self, learnt, results):
        assert len(list(errors_by_angle(learnt))) == 2
        assert not list(errors_by_angle(results))


def test_campaigns_of_a_group_are_drawn_about_their_mean_where_they_have_poses(learnt):
    angle = np.arange(360)
    visited = {"a": angle < 200, "b": angle >= 100}
    errors = {
        name: JointErrorAlone(visited=there, error_mrad=np.full(360, 0.1 * k) + (angle > 150))
        for k, (name, there) in enumerate(visited.items())
    }
    agree = CampaignsAgree.model_construct(
        first="a", second="b", correlation=0.9, correlation95=(0.8, 0.95), share_of_turn=0.28
    )
    by_campaign = EffectByCampaign.model_construct(
        id="joint_error_map", of="joint 3", errors=errors, agreement=(agree,)
    )
    verdict = learnt.verdict.model_copy(update={"by_campaign": (by_campaign,)})
    (drawing,) = campaigns_drawings(verdict)
    assert drawing.caption == "Agreement: r 0.90 (0.80 to 0.95)."
    a, b = map(values, drawing.figure.data)
    for shown, there in ((a, visited["a"]), (b, visited["b"])):
        np.testing.assert_array_equal(np.isfinite(shown), there)
    np.testing.assert_allclose(a[100:200], b[100:200], atol=1e-3)
    assert drawing.title == "Joint error map at joint 3, campaign by campaign"


def test_campaigns_that_are_not_compared_say_why_and_each_pair_whose_it_is(learnt):
    never = np.zeros(360, dtype=bool)
    errors = {k: JointErrorAlone(visited=never, error_mrad=np.ones(360)) for k in "abc"}
    known, unknown = {"correlation": 0.9, "correlation95": (0.8, 0.95)}, {"correlation": None}
    pairs = (("a", "b", known, 1.0), ("a", "c", unknown, 1.0), ("b", "c", unknown, 0.0))
    agreement = tuple(
        CampaignsAgree.model_construct(first=first, second=second, share_of_turn=share, **r)
        for first, second, r, share in pairs
    )
    by_campaign = tuple(
        EffectByCampaign.model_construct(
            id="joint_error_map", of=of, errors=errors, agreement=agreement
        )
        for of in ("joint 10", "joint 2")
    )
    verdict = learnt.verdict.model_copy(update={"by_campaign": by_campaign})
    second, tenth = campaigns_drawings(verdict)
    assert [second.id[-7:], tenth.id[-8:]] == ["joint-2", "joint-10"]
    assert second.caption == (
        "Agreement: a and b r 0.90 (0.80 to 0.95), a and c r not known, 100 % of the turn seen by "
        "both, b and c seen at other angles."
    )
    assert second.figure.layout.yaxis.range == (-1.0, 1.0)


def test_the_map_of_a_plane_shows_every_point_in_colours_of_all_planes(results):
    planes = results.planes
    for plane, drawing in zip(planes, plane_drawings(planes), strict=True):
        (heat,) = drawing.figure.data
        np.testing.assert_allclose(np.stack([heat.x, heat.y], axis=1), plane.map.rows[:, :2])
        np.testing.assert_allclose(heat.z, plane.map.rows[:, 2], rtol=1e-3)
        every = np.concatenate([each.map.rows[:, 2] for each in planes])
        assert (heat.zmin, heat.zmax) == (every.min(), every.max())
        assert len(drawing.figure.layout.shapes) == 2
        assert f"Mean {plane.map.rows[:, 2].mean():.3f} mm." in drawing.caption


def test_a_plane_without_a_grid_point_in_reach_says_so(changed_from, results):
    source = changed_from(results, "montecarlo/z500.json", lambda r: r["map"].update(rows=[]))
    drawings = list(plane_drawings(source.planes))
    assert [bool(drawing.figure.data) for drawing in drawings] == [True, False, True]
    assert drawings[1].caption.startswith("No grid point in reach.")
