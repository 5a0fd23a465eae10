"""What the pictures of discovery show is what its records say."""

from functools import partial

import numpy as np
import pytest
from matplotlib.text import Text

from pa10cal.figures.campaign import by_joint, residuals
from pa10cal.figures.campaign.by_joint import highest_separable, names_of_orders
from pa10cal.figures.registry import NothingToShowError
from pa10cal.results.analysis import Periodogram

pytestmark = pytest.mark.usefixtures("project_looks")


def texts_of(figure):
    return [text.get_text() for text in figure.findobj(Text)]


@pytest.fixture
def changed(named, changed_from):
    """Copy the results with changes to both fits of the analysis, or to all of it."""

    def copy(of_fit=None, of_record=lambda record: None):
        def change(record):
            of_record(record)
            for fit in ("before", "after") if of_fit else ():
                of_fit(record[fit])

        return changed_from(named, "discovery/analysis.json", change)

    return copy


def test_discovery_names_what_the_spoiled_campaign_hides(named):
    (effect,) = named.verdict.effects
    assert (effect.id, effect.of) == ("transmission_error", "joint 2")
    amplitude = effect.parameters["A"]
    assert amplitude.value == pytest.approx(4e-4, abs=4 * amplitude.std)
    assert named.analysis.effects[0].words == "transmission error, joint 2"


class TestBreakdown:
    def test_shows_both_fits_beside_the_floor_and_the_joint_stands_out(self, named):
        found, axes = named.analysis, residuals.draw_where_breakdown(named).axes
        floor, before, after = (line.get_ydata() for line in axes[0].lines[:3])
        np.testing.assert_allclose(floor, [part.floor_mm for part in found.before.by_load])
        np.testing.assert_allclose(before, [part.rms_mm for part in found.before.by_load])
        np.testing.assert_allclose(after, [part.rms_mm for part in found.after.by_load])
        assert (before > 3 * floor).all()
        np.testing.assert_allclose(after, floor, rtol=0.3)
        floor, before, after = (line.get_ydata() for line in axes[2].lines[:3])
        assert np.argmax(before / floor) == 1
        assert (after / floor).max() < 1.5

    def test_says_how_it_compares_with_repeats(self, named, results):
        for source, said in (
            (named, f"{named.analysis.before.pure_error.F:.0f} before (p < 0.001)"),
            (results, "before (p = "),
        ):
            texts = texts_of(residuals.draw_where_breakdown(source))
            assert any(text.startswith("F, variance") and said in text for text in texts)

    def test_a_temperature_that_was_not_logged_has_no_slope(self, changed, named):
        def unlogged(fit):
            for drift in fit["drifts"]:
                drift["with_temperature_mm"] = None

        for source, bars in ((named, 4), (changed(unlogged), 2)):
            assert len(residuals.draw_where_breakdown(source).axes[4].containers) == bars

    def test_a_campaign_without_repeats_and_directions_says_so(self, changed):
        def once(fit):
            fit["pure_error"] = None
            for joint in fit["by_joint"]:
                joint["arrivals"] = []

        texts = texts_of(residuals.draw_where_breakdown(changed(once)))
        assert "no direction was logged" in texts
        assert any(text.startswith("No pose was repeated") for text in texts)


class TestTorque:
    def test_every_cell_is_drawn_by_its_direction(self, results):
        joint = results.analysis.before.by_joint[2]
        axes = by_joint.draw_where_torque(results).axes[2]
        drawn = {line.get_marker(): line.get_ydata() for line in axes.lines[:-1]}
        forward = np.sign(joint.arrival) > 0
        np.testing.assert_allclose(drawn["^"], np.array(joint.torque_residual_Nm)[forward])
        assert sum(map(len, drawn.values())) == len(joint.q_rad)

    def test_every_direction_has_a_legible_legend(self, changed, written_legibly):
        def first_had_not_moved(fit):
            for joint in fit["by_joint"]:
                joint["arrival"][0] = 0.0

        figure = by_joint.draw_where_torque(changed(first_had_not_moved))
        texts = written_legibly(figure, "Synthetic data.")
        assert {"arrived in + direction", "in − direction", "had not moved"} <= set(texts)

    @pytest.mark.parametrize(
        ("residual", "why"),
        [(None, "need logged torques, known weights and repeated"), (0.0, "none remain")],
    )
    def test_says_when_no_torques_were_logged_or_none_remain(self, changed, residual, why):
        def without(fit):
            for joint in fit["by_joint"]:
                left = joint["torque_residual_Nm"]
                joint["torque_residual_Nm"] = None if residual is None else [0.0] * len(left)
                joint["torque_noise_Nm"] = None if residual is None else 0.0

        with pytest.raises(NothingToShowError, match=why):
            by_joint.draw_where_torque(changed(without))


class TestGapByStep:
    def test_a_row_a_name_with_its_errors(self, named):
        found = named.analysis
        texts = texts_of(residuals.draw_gap_by_step(named))
        assert {"calibrated model", "+ transmission error\n   joint 2"} <= set(texts)
        for step in found.naming:
            for errors in (step.train, step.holdout):
                written = f"{errors.mean_mm:.3f} / {errors.rms_mm:.3f} / {errors.peak_mm:.3f}"
                assert written in texts
        assert found.naming[1].holdout.mean_mm < 0.3 * found.naming[0].holdout.mean_mm

    def test_one_row_where_nothing_was_named(self, results):
        axes = residuals.draw_gap_by_step(results).axes[0]
        assert [label.get_text() for label in axes.get_yticklabels()] == ["calibrated model"]

    def test_without_held_out_poses(self, changed):
        def none(record):
            for step in record["naming"]:
                step["holdout"] = None

        texts = texts_of(residuals.draw_gap_by_step(changed(of_record=none)))
        assert "poses fitted" in texts
        assert not any("held-out" in text for text in texts)


class TestJoints:
    def test_a_point_a_cell_and_the_marked_order_of_the_joint_stands_out(self, named):
        axes = by_joint.draw_where_joints(named).axes
        joint, before = named.analysis.before.by_joint[1], axes[1].lines[1]
        np.testing.assert_allclose(before.get_xdata(), np.degrees(joint.q_rad))
        np.testing.assert_allclose(before.get_ydata(), 1e6 * np.array(joint.error_rad))
        orders = axes[6:]
        marked = [each.lines[1].get_ydata() for each in orders]
        assert np.unravel_index(np.argmax(marked), (6, 4)) == (1, 3)
        names = [label.get_text() for label in orders[1].get_xticklabels()]
        assert names == ["1", "2", "N", "\n2N"]
        assert list(orders[1].lines[1].get_xdata()) == [1.0, 2.0, 50.0, 100.0]
        # Orders that the poses cannot separate are shaded and not drawn.
        shaded = orders[1].patches[0].get_extents().transformed(orders[1].transData.inverted())
        assert max(orders[1].lines[0].get_xdata()) <= shaded.x0 * (1.0 + 1e-9)
        assert shaded.x0 < 100.0  # 27 poses

    def test_without_a_gear_ratio_there_is_no_axis_of_it(self, changed):
        def ungeared(fit):
            for joint in fit["by_joint"]:
                if joint["periodogram"]:
                    for key in ("marked", "marked_rad"):
                        joint["periodogram"][key] = joint["periodogram"][key][:2]

        figure = by_joint.draw_where_joints(changed(ungeared))
        assert not any("gear" in text for text in texts_of(figure))
        axes = figure.axes[7]
        assert [label.get_text() for label in axes.get_xticklabels()] == ["1", "2"]
        assert axes.get_xlim()[1] <= 30.0

    @pytest.mark.slow_but_one_in(2)
    @pytest.mark.parametrize("still", [1, 6])
    def test_joints_that_hardly_turned_have_no_periodogram(self, changed, still):
        def stand(fit):
            for joint in fit["by_joint"][:still]:
                joint["periodogram"] = None

        texts = texts_of(by_joint.draw_where_joints(changed(stand)))
        assert texts.count("hardly\nturned") == still


def test_errors_of_a_joint_that_slides_are_lengths(results, changed_from):
    def slide(record):
        record["fitted_model"]["arm"]["rows"][2]["prismatic"] = True

    source = changed_from(results, "calibration/combined.json", slide)
    joint = source.analysis.before.by_joint[2]
    axes = by_joint.draw_where_joints(source).axes[2]
    assert axes.get_title(loc="left") == "joint 3 [µm]"
    np.testing.assert_allclose(axes.lines[1].get_xdata(), 1e3 * joint.q_rad)
    axes = by_joint.draw_where_torque(source).axes[2]
    assert axes.get_title(loc="left") == "joint 3 [N]"
    assert axes.get_xlim()[1] >= 1e3 * joint.q_rad.max()
    assert "3 [µm]" in texts_of(residuals.draw_where_breakdown(source))


@pytest.mark.parametrize(
    ("ratio", "names"),
    [
        (50.0, ["1", "2", "N", "\n2N"]),
        (1.5, ["1", "N", "2", "\n2N"]),
        (0.4, ["N", "\n2N", "1", "2"]),
        (0.5, ["N", "1, 2N", "2"]),
        (2.0, ["1", "2, N", "\n2N"]),
    ],
)
def test_orders_are_named_whatever_the_gear_ratio(ratio, names):
    marked = np.array(sorted({1.0, 2.0, ratio, 2.0 * ratio}))
    none = np.zeros(len(marked))
    found = Periodogram(orders=none, explained_rad=none, marked=marked, marked_rad=none)
    assert names_of_orders(found) == names


separable = partial(highest_separable, np.arange(0.5, 300.0, 0.5))


@pytest.mark.parametrize(("count", "turns"), [(21, 0.25), (101, 0.25), (101, 0.8)])
def test_two_different_angles_an_order_are_needed(count, turns):
    q_rad = 2.0 * np.pi * np.linspace(0.0, turns, count)
    cycles = turns * separable(q_rad)
    assert (count - 1) / 2 <= cycles < (count + 1) / 2
    again = np.concatenate([q_rad, q_rad + 1e-6, q_rad - 1e-6])
    assert separable(again) == pytest.approx(separable(q_rad), abs=4.0)
    assert separable(np.array([0.0, 3.0])) < 4.0
