"""What pictures of health and of the general model show is what the records say."""

import json

import numpy as np
import pytest

from pa10cal.figures.campaign import joint_maps
from pa10cal.figures.registry import NothingToShowError

pytestmark = pytest.mark.usefixtures("project_looks")
COMBINED = "calibration/combined.json"
HOLDOUT = "evaluation/holdout.json"


class TestJointErrorMaps:
    def test_the_line_runs_through_the_knots_and_the_band_is_theirs(self, learnt):
        figure = joint_maps.draw_joint_error_maps(learnt)
        first, third = figure.axes[1], figure.axes[0]
        assert first.get_title(loc="left").startswith("joint 1: rms 0.212 mrad over the turn")
        assert third.get_title(loc="left").startswith("joint 3: ")
        assert "over the measured angles; 5 % of the turn measured" in third.get_title(loc="left")
        seen, unseen = (line.get_ydata() for line in third.lines[:2])
        angle = third.lines[0].get_xdata()
        line = np.where(np.isnan(seen), unseen, seen)
        np.testing.assert_allclose(line, 0.3 * np.sin(3 * np.radians(angle)), atol=5e-3)
        effect = next(e for e in learnt.verdict().effects if e.of == "joint 3")
        at_knots = np.isin(angle, np.arange(0.0, 360.0, 15.0))
        values = [1e3 * parameter.value for parameter in effect.parameters.values()]
        np.testing.assert_allclose(line[at_knots], values, atol=1e-12)
        band = np.vstack([c.get_paths()[k].vertices for c in third.collections[1:3]
                          for k in range(len(c.get_paths()))])  # fmt: skip
        for k, std in ((4, 2e-5), (5, 3e-5)):
            ends = band[np.isclose(band[:, 0], 15.0 * k), 1]
            assert np.ptp(ends) == pytest.approx(2 * 1.96e3 * std)

    def test_angles_that_the_poses_fitted_have_not_seen_are_extrapolated(self, learnt):
        figure = joint_maps.draw_joint_error_maps(learnt)
        known, guessed = figure.axes[0].lines[:2]
        angle = known.get_xdata()
        inside = (angle > 10.2) & (angle < 27.8)
        np.testing.assert_array_equal(np.isfinite(known.get_ydata()), inside)
        np.testing.assert_array_equal(np.isfinite(guessed.get_ydata()), ~inside)
        assert guessed.get_linestyle() == ":"
        assert np.isnan(figure.axes[1].lines[0].get_ydata()).all()
        assert "0 % of the turn measured" in figure.axes[1].get_title(loc="left")

    def test_a_map_judged_by_repeats_is_drawn_without_angles_seen(self, changed_from, learnt):
        source = changed_from(learnt, "discovery/verdict.json", lambda r: r.pop("angles_seen"))
        known = joint_maps.draw_joint_error_maps(source).axes[0].lines[0]
        assert np.isfinite(known.get_ydata()).all()

    def test_says_when_there_is_no_map(self, changed_from, learnt):
        source = changed_from(learnt, "discovery/verdict.json", lambda r: r.update(effects=[]))
        with pytest.raises(NothingToShowError, match="no error that depends on a joint's angle"):
            joint_maps.draw_joint_error_maps(source)


def test_the_held_out_poses_of_the_fixture_are_told_apart(learnt):
    rows = json.loads((learnt.folder / HOLDOUT).read_text("utf-8"))["models"]["extended"]["rows"]
    assert {row["extrapolated"] for row in rows} == {True, False}
