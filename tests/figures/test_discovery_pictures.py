"""What the pictures and the table of discovery show is what its records say."""

import csv
from functools import partial

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from pa10cal.figures.campaign import by_joint, tables, where
from pa10cal.figures.registry import NothingToShowError
from pa10cal.figures.table import write_table

pytestmark = pytest.mark.usefixtures("project_looks")


def texts_of(figure):
    return [text.get_text() for text in figure.findobj(Text)]


@pytest.fixture
def changed(named, changed_from):
    """Copy the results with changes to the JSON of one of them."""
    return partial(changed_from, named)


def test_discovery_names_what_the_spoiled_campaign_hides(named):
    (effect,) = named.verdict().effects
    assert (effect.id, effect.of) == ("transmission_error", "joint 2")
    amplitude = effect.parameters["A"]
    assert amplitude.value == pytest.approx(4e-4, abs=4 * amplitude.std)
    assert named.analysis().effects[0].words == "transmission error, joint 2"


class TestBreakdown:
    def test_shows_both_fits_beside_the_floor(self, named):
        found = named.analysis()
        by_load = where.draw_where_breakdown(named).axes[0]
        floor, before, after = (line.get_ydata() for line in by_load.lines[:3])
        np.testing.assert_allclose(floor, [part.floor_mm for part in found.before.by_load])
        np.testing.assert_allclose(before, [part.rms_mm for part in found.before.by_load])
        np.testing.assert_allclose(after, [part.rms_mm for part in found.after.by_load])
        assert (before > 3 * floor).all()
        np.testing.assert_allclose(after, floor, rtol=0.3)

    def test_the_joint_stands_out(self, named):
        by_joint = where.draw_where_breakdown(named).axes[2]
        floor, before, after = (line.get_ydata() for line in by_joint.lines[:3])
        assert np.argmax(before / floor) == 1
        assert (after / floor).max() < 1.5

    def test_says_how_it_compares_with_repeats(self, named, results):
        (said,) = (
            t for t in texts_of(where.draw_where_breakdown(named)) if t.startswith("F, variance")
        )
        assert f"{named.analysis().before.pose.shared.F:.0f} before (p < 0.001)" in said
        (said,) = (
            t for t in texts_of(where.draw_where_breakdown(results)) if t.startswith("F, variance")
        )
        assert "< 0.001" not in said

    def test_a_temperature_that_was_not_logged_has_no_slope(self, changed, named):
        def unlogged(record):
            for fit in ("before", "after"):
                temperature = record[fit]["cells"]["temperature_C"]
                record[fit]["cells"]["temperature_C"] = [None] * len(temperature)
                for drift in record[fit]["drifts"]:
                    drift["by_temperature_mm_per_K"] = None

        def errorbars(results):
            return len(where.draw_where_breakdown(results).axes[4].containers)

        assert errorbars(named) == 4
        assert errorbars(changed("discovery/analysis.json", unlogged)) == 2

    def test_a_campaign_without_repeats_and_directions_says_so(self, changed):
        def once(record):
            for fit in ("before", "after"):
                record[fit]["pose"]["shared"] = None
                for joint in record[fit]["by_joint"]:
                    joint["arrivals"] = []

        texts = texts_of(where.draw_where_breakdown(changed("discovery/analysis.json", once)))
        assert "no direction was logged" in texts
        assert any(text.startswith("No pose was repeated") for text in texts)


class TestTorque:
    def test_every_cell_is_drawn_by_its_direction(self, results):
        joint = results.analysis().before.cells.joints[2]
        axes = by_joint.draw_where_torque(results).axes[2]
        drawn = {line.get_marker(): line.get_ydata() for line in axes.lines[:-1]}
        forward = np.sign(joint.arrival) > 0
        np.testing.assert_allclose(drawn["^"], np.array(joint.torque_residual_Nm)[forward])
        assert sum(map(len, drawn.values())) == len(joint.q_rad)

    def test_says_when_there_are_no_torques(self, changed):
        def unlogged(record):
            for fit in ("before", "after"):
                record[fit]["by_torque"] = []
                for joint in record[fit]["cells"]["joints"]:
                    joint["torque_residual_Nm"] = None

        with pytest.raises(NothingToShowError, match="no torques were logged, or the weights are"):
            by_joint.draw_where_torque(changed("discovery/analysis.json", unlogged))

    def test_a_calculated_log_has_nothing_to_show(self, changed):
        def none_left(record):
            for fit in ("before", "after"):
                for joint in record[fit]["cells"]["joints"]:
                    joint["torque_residual_Nm"] = [0.0] * len(joint["torque_residual_Nm"])
                for part in record[fit]["by_torque"]:
                    part["noise_Nm"] = 0.0

        with pytest.raises(NothingToShowError, match="none remain"):
            by_joint.draw_where_torque(changed("discovery/analysis.json", none_left))


class TestGapByStep:
    def test_a_row_a_name_with_its_errors(self, named):
        found = named.analysis()
        texts = texts_of(where.draw_gap_by_step(named))
        assert {"calibrated model", "+ transmission error\n   joint 2"} <= set(texts)
        for step in found.naming:
            for errors in (step.train, step.holdout):
                written = f"{errors.mean_mm:.3f} / {errors.rms_mm:.3f} / {errors.peak_mm:.3f}"
                assert written in texts
        assert found.naming[1].holdout.mean_mm < 0.3 * found.naming[0].holdout.mean_mm

    def test_one_row_where_nothing_was_named(self, results):
        assert any(
            "No effect was named" in text for text in texts_of(where.draw_gap_by_step(results))
        )

    def test_without_held_out_poses(self, changed):
        def none(record):
            for step in record["naming"]:
                step["holdout"] = None

        texts = texts_of(where.draw_gap_by_step(changed("discovery/analysis.json", none)))
        assert "poses fitted" in texts
        assert not any("held-out" in text for text in texts)


class TestGapOfHeldOut:
    def test_those_that_extrapolate_are_apart(self, changed):
        def beyond(record):
            for k, row in enumerate(record["gap"]["holdout"]):
                row["extrapolated"] = k < 5

        source = changed("discovery/analysis.json", beyond)
        rows = source.analysis().gap.holdout
        error = np.linalg.norm(rows.after_mm[:5], axis=1)
        said = f"{np.sqrt(np.mean(error**2)):.3f} mm in 5 of {len(rows)}"
        drawn = where.draw_gap_by_step(source)
        (line,) = (text for text in drawn.findobj(Text) if said in text.get_text())
        FigureCanvasAgg(drawn).draw()
        assert line.get_window_extent().x1 < drawn.bbox.x1

    def test_where_all_extrapolate_it_is_said(self, changed):
        def beyond(record):
            for row in record["gap"]["holdout"]:
                row["extrapolated"] = True

        texts = texts_of(where.draw_gap_by_step(changed("discovery/analysis.json", beyond)))
        assert any("mm; all poses are extrapolated." in text for text in texts)
        assert not any("nan" in text for text in texts)


class TestVerdictTable:
    def rows(self, results, folder):
        write_table(tables.tabulate_verdict(results), results.footer, folder, "verdict")
        with (folder / "verdict.csv").open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    def test_holds_effects_evidence_and_gap(self, named, tmp_path):
        rows = self.rows(named, tmp_path)
        assert rows[0]["value"] == "named"
        (amplitude,) = (row for row in rows if row["quantity"] == "A")
        assert (amplitude["effect"], amplitude["of"]) == ("transmission_error", "joint 2")
        assert float(amplitude["value"]) == pytest.approx(4e-4, rel=0.05)
        assert amplitude["unit"] == "rad"
        assert {row["kind"] for row in rows} >= {"effect", "evidence", "not_testable", "gap"}
        (mean,) = (
            row
            for row in rows
            if (row["of"], row["quantity"], row["remark"]) == ("held out", "after_mean_mm", "all")
        )
        assert float(mean["value"]) == pytest.approx(
            named.verdict().gap.holdout.after.mean_mm, rel=1e-5
        )
        page = (tmp_path / "verdict.html").read_text("utf-8")
        assert "Synthetic data." in page
        assert "Named: every effect found is distinguishable from all others." in page

    def test_effects_that_cannot_be_shown_have_a_row_each(self, changed, tmp_path):
        def many(record):
            why = "the torques were not logged"
            record["not_testable"] = [
                {"id": "torque_gain", "of": f"joint {k}", "why": why} for k in (1, 2, 3, 5)
            ] + [
                {"id": "thermal_growth", "of": "arm", "why": "no temperature"},
                {"id": "joint_compliance", "of": "joint 1", "why": "no load"},
                {"id": "joint_compliance", "of": "joint 2", "why": "too small"},
            ]

        rows = self.rows(changed("discovery/verdict.json", many), tmp_path)
        assert sum(row["kind"] == "not_testable" for row in rows) == 7
        text = (tmp_path / "verdict.md").read_text("utf-8")
        assert "| torque gain | joints 1 to 3, 5 | the torques were not logged |" in text
        assert "| thermal growth | arm | no temperature |" in text
        reasons = "joint 1: no load; joint 2: too small"
        assert f"| joint compliance | joints 1, 2 | {reasons} |" in text

    def test_a_map_is_summed_up_and_whole_in_the_csv(self, learnt, tmp_path):
        rows = self.rows(learnt, tmp_path)
        knots = [row for row in rows if row["of"] == "joint 3" and row["kind"] == "effect"]
        assert [row["quantity"] for row in knots] == [f"knot_{k:02d}" for k in range(24)]
        (beyond,) = (
            row
            for row in rows
            if (row["of"], row["quantity"], row["remark"])
            == ("held out", "after_rms_mm", "extrapolated")
        )
        assert float(beyond["value"]) == 0.077
        text = (tmp_path / "verdict.md").read_text("utf-8")
        assert "blocks of poses held out of the fit" in text
        assert "| held out, extrapolated | all |" in text
        assert (
            "| joint error map | joint\u00a03 | 24\u00a0values,\u00a0rms\u00a00.212\u00a0mrad |"
            in text
        )
        assert "0.300 mm without, 0.100 mm with it; better in 9 of 10 blocks, z 8.0" in text

    @pytest.mark.parametrize("kind", ["points", "distance"])
    def test_says_why_effects_were_not_sought_and_what_would_do(self, sighted, kind, tmp_path):
        found = sighted[kind].verdict()
        first, *rows = self.rows(sighted[kind], tmp_path)
        assert (first["value"], first["remark"]) == ("not_sought", f"{found.why}; {found.remedy}")
        assert {row["kind"] for row in rows} == {"gap"}
        text = (tmp_path / "verdict.md").read_text("utf-8")
        assert f"| {found.why} | {found.remedy} |" in text
        assert "| poses | load | mean | rms | peak |" in text
        assert "| held out | all |" in text
        assert "reduction" not in text
        assert "The noise is that of the instrument's stated uncertainty" in text

    def test_says_when_nothing_was_named(self, results, tmp_path):
        rows = self.rows(results, tmp_path)
        assert rows[0]["value"] == "none"
        assert not any(row["kind"] == "effect" for row in rows)
        assert "| none | – | – | – | – |" in (tmp_path / "verdict.md").read_text("utf-8")

    def test_names_alternatives_and_what_has_no_name(self, changed, tmp_path):
        def doubtful(record):
            record["verdict"] = "unexplained"
            record["effects"][0]["alternatives"] = [{"id": "backlash", "of": "joint 3"}]
            place = {"of": "joint 4", "form": None, "shared_error_mm": 0.1}
            place["why"] = "a smooth function predicts it"
            record["unexplained"] = {**place, "all": [place]}
            record["gap"]["holdout"] = None

        rows = self.rows(changed("discovery/verdict.json", doubtful), tmp_path)
        assert any(row["remark"] == "alternatives: backlash of joint 3" for row in rows)
        (place,) = (row for row in rows if row["kind"] == "unexplained")
        assert (place["of"], place["remark"]) == ("joint 4", "a smooth function predicts it")
        assert not any(row["of"] == "held out" for row in rows)
