"""What the tables of the page hold is what the records say."""

from functools import partial

import numpy as np
import pytest

from pa10cal.figures.campaign.residuals import tabulate_suspected_outliers
from pa10cal.figures.draw import draw_all, of_campaign
from pa10cal.figures.table import write_table
from pa10cal.reports.accuracy import accuracy, reductions_grid
from pa10cal.reports.blocks import Callout, Grid, Items, Paragraph
from pa10cal.reports.errors import errors_of
from pa10cal.reports.formatting import with_interval
from pa10cal.reports.measured import measurement_section
from pa10cal.reports.missing import missing, number_needed, poses_in_words
from pa10cal.reports.outcome import verdict
from pa10cal.reports.page import SECTIONS
from pa10cal.reports.parameters import parameters
from pa10cal.reports.render import images
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.reports.trust import trust

COMBINED, VERDICT = "calibration/combined.json", "discovery/verdict.json"
EXTENDED = "discovery/extended.json"


def lines(section, results):
    """Return the tables of a section of the page, a line a row."""
    needs = next(each.needs for each in SECTIONS if each.blocks is section)
    found = []
    for block in section(results, *([getattr(results, needs)] if needs else [])):
        found += [each for each in getattr(block, "blocks", (block,)) if isinstance(each, Grid)]
    return [each.caption for each in found] + [
        f"| {' | '.join(row)} |" for each in found for row in (each.header, *each.rows)
    ]


class TestParameters:
    def test_shows_units_of_the_workshop_and_what_was_left_out(self, sighted):
        case = sighted["pose"].general_calibration()
        found = lines(parameters, sighted["pose"])
        length, angle = case.parameters["delta_a_2"], case.parameters["delta_theta_3"]
        shown = with_interval(1e3 * length.value, 1e3 * length.std)
        assert any(line.startswith(f"| δa₂ | {shown} | mm |") for line in found)
        shown = with_interval(1e3 * angle.value, 1e3 * angle.std)
        assert any(line.startswith(f"| δθ₃ | {shown} | mrad |") for line in found)
        (same,) = (entry for entry in case.redundant if entry.name == "delta_a_6")
        assert same.replaced_by.keys() == {"tool_x"}
        assert "Omitted: redundant parameters" in found
        assert "| δa₆ | 1 × tool x |" in found

    def test_a_parameter_that_nothing_tells_has_no_uncertainty(self, sighted):
        found = lines(parameters, sighted["distance"])
        assert "| γ_x | – | mrad | – | not identifiable from these poses |" in found

    def test_a_spring_at_its_end_is_rigid(self, changed_from, sighted):
        def rigid(record):
            record["parameters"]["K_lin_2"].update(at_bound=True, std=0.0)

        found = lines(parameters, changed_from(sighted["pose"], COMBINED, rigid))
        assert "| K_lin_2 | rigid | kN m/rad | – | at the end of its physical range |" in found

    def test_what_campaigns_of_a_group_say_of_a_spring_is_of_its_windup(
        self, changed_from, sighted
    ):
        worst = {"name": "windup_4", "unit": "rad", "value": 3.05e-3, "std": 3.3e-4}
        campaign = {"poses": 5, "rms_mm": 0.1, "alone_rms_mm": 0.09, "chi_square": 3.0, "dof": 2.0}
        campaign |= {"p_value": 0.3, "contradicts": False, "worst": worst | {"chi_square": 1.0}}
        shared = {"unit": "rad", "std": 1.4e-4, "std_alone": {"a": 2e-4}, "determined_by": ["a"]}
        group = {"campaigns": {"a": campaign}, "parameters": {"windup_4": shared}}
        results = changed_from(sighted["pose"], COMBINED, lambda r: r.update(group=group))
        found = lines(parameters, results)
        assert "| windup 4 | mrad | 0.1400 | 0.2000 | a |" in found
        assert any("| windup 4: 3.05 ± 0.33 mrad |" in line for line in found)


class TestSuspectedOutliers:
    def test_lists_each_with_why_and_says_none(self, changed_from, sighted, tmp_path):
        entry = {"row": 6, "pose": "P007", "load_N": 0.0, "distance": 8.25, "weight": 0.4}
        entry["why"] = "position off by 1.452 mm, 5 times the scatter of one axis"
        source, none = (
            changed_from(
                sighted["pose"], COMBINED, lambda r, of=of: r.update(suspected_outliers=of)
            )
            for of in ([entry, entry], [])
        )
        assert "| no suspected outlier | P007 |  | no |" in lines(trust, source)
        assert "Suspected outliers, with their weight in the fit" in lines(trust, source)
        assert f"| P007 | 0 | 8.25 | 0.400 | {entry['why']} |" in lines(trust, source)
        table = tabulate_suspected_outliers(source)
        assert table.data.loc[0].tolist() == ["P007", 0.0, 8.25, 0.4, entry["why"]]
        assert f"2 of {source.general_calibration().health.poses.measured} poses" in table.notes[0]
        write_table(tabulate_suspected_outliers(none), "", tmp_path, "table")
        assert "| none | – | – | – | – |" in (tmp_path / "table.md").read_text("utf-8")


class TestAccuracy:
    def one(self, results, poses, model, load="all", part="all"):
        (each,) = (
            each
            for each in errors_of(results)
            if (each.poses, each.name, each.load, each.part) == (poses, model, load, part)
        )
        return each.accuracy

    def test_errors_of_all_loads_are_pooled(self, sighted):
        errors = sighted["points"].general_calibration().errors
        assert list(errors) == ["0N", "20N"]
        parts = [each.after for each in errors.values()]
        count = np.array([part.configurations for part in parts])
        pooled = self.one(sighted["points"], "fitted", "linear")
        rms = np.sqrt(count @ [part.rms_mm**2 for part in parts] / count.sum())
        assert pooled.rms_mm == pytest.approx(rms, rel=1e-5)
        assert pooled.peak_mm == pytest.approx(max(p.peak_mm for p in parts), rel=1e-5)
        assert pooled.configurations == count.sum()
        alone = self.one(sighted["points"], "fitted", "linear", load="20N")
        assert alone.mean_mm == errors["20N"].after.mean_mm

    def test_held_out_errors_are_those_of_the_record_and_no_model_is_listed_twice(self, sighted):
        for name, model in sighted["pose"].sound_held_out().models.items():
            found = self.one(sighted["pose"], "held out", name)
            assert (found.rms_mm, found.orientation_deg) == (model.rms_mm, model.orientation_deg)
        found = lines(accuracy, sighted["pose"])
        assert any(line.startswith("| held out | all | calibrated, linear") for line in found)
        models = sighted["points"].held_out.models
        assert models["extended"] == models["linear"]
        assert "extended" not in {each.name for each in errors_of(sighted["points"])}

    def test_says_what_was_done_with_held_out_poses_and_effects_that_there_are(
        self, sighted, learnt
    ):
        def about(results):
            return next(block.text for block in accuracy(results) if isinstance(block, Paragraph))

        assert learnt.verdict.effects
        assert not sighted["pose"].verdict.effects
        assert "fitted anew" in about(learnt)
        assert "fitted anew" not in about(sighted["pose"])
        assert "taken back where it makes them worse" in about(sighted["pose"])

    def test_what_is_extrapolated_stands_apart(self, learnt):
        extended = learnt.held_out.models["extended"]
        for part, errors in (("inside", extended.inside), ("extrapolated", extended.outside)):
            assert self.one(learnt, "held out", "extended", part=part).rms_mm == errors.rms_mm
        fitted = self.one(learnt, "fitted", "extended")
        assert fitted.rms_mm == learnt.verdict.gap.train.after.rms_mm
        shown = " ".join(lines(accuracy, learnt))
        assert "with the effects found, extrapolated" in shown
        assert "| held out | all | 0.040 | 0.0300 to 0.0500 | 45 |" in shown

    def test_an_attitude_not_seen_is_a_dash(self, sighted):
        assert {each.accuracy.orientation_deg for each in errors_of(sighted["distance"])} == {None}
        assert any(" | – | " in line for line in lines(accuracy, sighted["distance"]))


def test_the_uncertainty_of_a_distance_is_not_along_axes(sighted):
    for kind, along_axes in (("distance", False), ("points", True)):
        facts = dict(next(measurement_section(sighted[kind])).rows)
        assert ("along each axis" in facts["Instrument"]) == along_axes


class TestHealth:
    def test_is_that_of_the_record(self, results):
        case = results.paper_calibration()
        found = lines(trust, results)
        assert any(line.startswith("Basis of the grade of the calibration") for line in found)
        rank = f"| rank {case.health.rank} of {case.health.unknowns}, condition number"
        assert any(rank in line for line in found)
        for each in case.health.checks:
            passes = {True: "yes", False: "no", None: "–"}[each.passes]
            assert f"| {each.check} | {each.found} | {each.limit} | {passes} |" in found

    def test_results_of_an_earlier_version_hold_no_checks(self, changed_from, sighted):
        source = changed_from(
            sighted["pose"], COMBINED, lambda record: record["health"].pop("checks")
        )
        assert any("not in results of an earlier version" in line for line in lines(trust, source))

    def test_correlated_pairs_and_what_is_not_known(self, changed_from, sighted):
        def change(record):
            pair = {"parameters": ["delta_a_2", "delta_d_4"], "correlation": -0.9876}
            record["health"].update(correlated_pairs=[pair], noise_mm=None)
            record["health"]["poses"]["needed"] = None

        source = changed_from(sighted["pose"], COMBINED, change)
        assert "| δa₂ | δd₄ | -0.988 |" in lines(missing, source)
        ordered = len(source.general_calibration().health.poses.d_optimal_order)
        poses = source.general_calibration().health.poses
        assert number_needed(poses) == f"more than {ordered}"

    def test_poses_that_reach_an_uncertainty_may_be_more_than_are_ordered(self, sighted):
        poses = sighted["pose"].general_calibration().health.poses
        count = len(poses.d_optimal_order)
        more = {"needed": None, "measured": 6 * count, "u_needed_mm": 0.026}
        for u_model_mm, said in ((0.016, count), (0.03, 6 * count)):
            shown = poses.model_copy(update={**more, "u_model_mm": u_model_mm})
            assert f"which more than {said} well-chosen poses reach" in poses_in_words(shown)


class TestLimitsOfPredictions:
    def test_angles_modulo_a_turn_are_shown_between_the_limits_of_the_joint(
        self, changed_from, sighted
    ):
        def seen_about_zero(record):
            fitted = record["fitted_model"]
            fitted["arm"]["rows"][0]["limits_rad"] = np.radians([-130.0, 180.0]).tolist()
            turn = np.radians([[0.0, 63.6], [236.4, 360.0]]).tolist()
            fitted["seen"][0] = {"turns": True, "intervals": turn}
            fitted["seen"][1] = {"turns": True, "intervals": [[0.0, 2.0 * np.pi]]}

        found = lines(trust, changed_from(sighted["pose"], EXTENDED, seen_about_zero))
        assert "| 1 | -123.6 to 63.6 ° | -130.0 to 180.0 ° |" in found
        assert "| 2 | -360.0 to 360.0 ° | -360.0 to 360.0 ° |" in found

    def test_only_a_table_that_is_there_is_named(self, changed_from, sighted):
        def said(results):
            blocks = trust(results, results.general_calibration())
            return next(block for block in blocks if isinstance(block, Items)).texts[-1]

        none = changed_from(
            sighted["pose"], EXTENDED, lambda r: r["fitted_model"].update(seen=None)
        )
        assert said(none).startswith("Far from all poses of the fit")
        assert "table below" in said(sighted["pose"])

    def test_what_the_search_warns_of_stands_there_without_a_name_too(self, changed_from, named):
        def nameless(record):
            record.update(named=[], warnings=["an unidentified effect of joint 2 is missing"])

        source = changed_from(named, EXTENDED, nameless)
        texts = [b.text for b in trust(source, source.calibration) if isinstance(b, Callout)]
        assert "By the search for effects: an unidentified effect of joint 2 is missing." in texts


class TestVerdict:
    @pytest.fixture
    def changed(self, named, changed_from):
        return partial(changed_from, named, VERDICT)

    def test_evidence_of_the_effect_in_whose_place_another_stands_is_called_so(self, changed):
        other = {"id": "backlash", "of": "joint 2"}
        source = changed(lambda record: record["effects"][0].update(evidence_of=other))
        said = "| of backlash at joint 2, in whose place it stands: "
        assert any(said in line for line in lines(trust, source))

    def test_effects_that_cannot_be_shown_have_a_row_each(self, changed):
        places = [
            ("torque_gain", f"joint {k}", "the torques were not logged") for k in (1, 2, 3, 5)
        ]
        places += [("thermal_growth", "arm", "no temperature")]
        places += [("joint_compliance", "joint 1", "no load")]
        places += [("joint_compliance", "joint 2", "too small")]
        entries = [dict(zip(("id", "of", "why"), each, strict=True)) for each in places]
        found = lines(missing, changed(lambda record: record.update(not_testable=entries)))
        assert "| torque gain | joints 1 to 3, 5 | the torques were not logged |" in found
        assert "| thermal growth | arm | no temperature |" in found
        reasons = "joint 1: no load; joint 2: too small"
        assert f"| joint compliance | joints 1, 2 | {reasons} |" in found

    def test_a_map_is_summed_up(self, learnt):
        size = "24\u00a0values,\u00a0rms\u00a00.212\u00a0mrad"
        row = f"| joint error map | joint\u00a03 | {size} |"
        assert any(line.startswith(row) for line in lines(verdict, learnt))
        said = "0.300 mm without, 0.100 mm with it; better in 9 of 10 blocks, z 8.0"
        assert any(said in line for line in lines(trust, learnt))

    def test_many_values_are_summed_up_by_unit(self, changed):
        values = [("rate_x", 1e-5, "m/h"), ("rate_y", -1e-5, "m/h"), ("rate_z", 1e-5, "m/h")]
        values += [(f"wave_{k}_{axis}", 5e-5, "m") for k in (1, 2) for axis in "xyz"]

        def drifting(record):
            record["effects"][0]["parameters"] = {
                name: {"value": value, "std": 1e-6, "unit": unit} for name, value, unit in values
            }

        said = "3 values, rms 0.01 mm/h; 6 values, rms 0.05 mm".replace(" ", "\u00a0")
        said = said.replace(";\u00a0", "; ")
        assert any(f"| {said} |" in line for line in lines(verdict, changed(drifting)))

    def test_names_alternatives_and_what_has_no_name(self, changed):
        def doubtful(record):
            record["verdict"] = "unexplained"
            other = {"id": "backlash", "of": "joint 3"}
            record["effects"][0]["alternatives"] = [{**other, "probability": 0.31}]
            record["effects"][0]["set95"].append(other)
            place = {"of": "joint 4", "form": None, "shared_error_mm": 0.1}
            place["why"] = "a smooth function predicts it"
            record["unexplained"] = {**place, "all": [place]}
            record["gap"]["holdout"] = None

        source = changed(doubtful)
        found = lines(verdict, source)
        assert any("| backlash at joint 3 (0.31) |" in line for line in found)
        assert "| joint 4 | A smooth function predicts it. |" in found
        assert {row[0] for row in reductions_grid(source.verdict).rows} == {"fitted"}


@pytest.mark.slow
def test_the_page_shows_pictures_that_lie_among_the_results(results, tmp_path):
    draw_all(of_campaign(results), tmp_path, results.settings.figures)
    bundle = ResultsBundle(tmp_path)
    shown = {each.id: each for each in images(bundle.pictures, tmp_path, "accuracy")}
    assert set(shown) >= {"fig5_before_after", "gap_by_step"}
    assert shown["gap_by_step"].source.startswith("data:image/svg+xml;base64,")
    assert shown["gap_by_step"].caption.endswith("Synthetic data.")
    assert "cell-null" in shown["gap_by_step"].caption
    every = {name for name, of in bundle.pictures.captions.items() if of.section}
    assert every == {path.stem for path in (tmp_path / "figures").glob("*.svg")}
