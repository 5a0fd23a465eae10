"""What the tables of health and of the general model hold is what the records say."""

import csv
import json

import numpy as np
import pytest

from pa10cal.figures.campaign import tables
from pa10cal.figures.results import MODELS
from pa10cal.figures.table import write_table
from pa10cal.reports.formatting import with_interval

COMBINED = "calibration/combined.json"


def rows_of(make, results, folder):
    """Write a table and return the rows of its CSV, and its Markdown."""
    write_table(make(results), results.footer, folder, "table")
    with (folder / "table.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file)), (folder / "table.md").read_text("utf-8")


class TestParameters:
    @pytest.mark.parametrize("kind", ["nothing", "pose", "points", "distance"])
    def test_holds_every_parameter_and_what_was_left_out(self, results, sighted, kind, tmp_path):
        source = results if kind == "nothing" else sighted[kind]
        case = source.general()
        rows, text = rows_of(tables.tabulate_parameters_general, source, tmp_path)
        kept = {row["parameter"]: row for row in rows if row["redundant"] == "false"}
        assert set(kept) == set(case.parameters)
        for name, parameter in case.parameters.items():
            assert float(kept[name]["value"]) == pytest.approx(parameter.value, rel=1e-7)
            assert kept[name]["unit"] == parameter.unit
            assert kept[name]["identifiable"] == str(parameter.identifiable).lower()
        redundant = {row["parameter"] for row in rows if row["redundant"] == "true"}
        assert redundant == {entry.name for entry in case.redundant}
        assert "Omitted: redundant parameters" in text

    def test_shows_units_of_the_workshop(self, sighted, tmp_path):
        case = sighted["pose"].general()
        _, text = rows_of(tables.tabulate_parameters_general, sighted["pose"], tmp_path)
        length, angle = case.parameters["delta_a_2"], case.parameters["delta_theta_3"]
        assert f"| δa₂ | {with_interval(1e3 * length.value, 1e3 * length.std)} | mm |" in text
        assert f"| δθ₃ | {with_interval(1e3 * angle.value, 1e3 * angle.std)} | mrad |" in text
        (same,) = (entry for entry in case.redundant if entry.name == "delta_a_6")
        assert same.replaced_by.keys() == {"tool_x"}
        assert "| δa₆ | 1 × tool x |" in text

    def test_a_parameter_that_nothing_tells_has_no_uncertainty(self, sighted, tmp_path):
        rows, text = rows_of(tables.tabulate_parameters_general, sighted["distance"], tmp_path)
        (turn,) = (row for row in rows if row["parameter"] == "gamma_x")
        assert (turn["std"], turn["identifiable"]) == ("", "false")
        assert "| γ_x | – | mrad | – | not identifiable from these poses |" in text
        assert "torques of the described masses" in text

    def test_a_spring_at_its_end_is_rigid(self, changed_from, sighted, tmp_path):
        def rigid(record):
            record["parameters"]["K_lin_2"].update(at_bound=True, std=0.0)

        _, text = rows_of(
            tables.tabulate_parameters_general,
            changed_from(sighted["pose"], COMBINED, rigid),
            tmp_path,
        )
        assert "| K_lin_2 | rigid | kN m/rad | – | at the end of its physical range |" in text


class TestDoubted:
    def test_lists_each_with_why(self, changed_from, sighted, tmp_path):
        entry = {
            "row": 6,
            "pose": "P007",
            "load_N": 0.0,
            "distance": 8.25,
            "weight": 0.4,
            "why": "position off by 1.452 mm, 5 times the scatter of one axis",
        }
        source = changed_from(
            sighted["pose"], COMBINED, lambda r: r.update(suspected_outliers=[entry])
        )
        (row,), text = rows_of(tables.tabulate_suspected_outliers, source, tmp_path)
        assert row["why"] == entry["why"]
        assert (row["pose"], float(row["distance"]), float(row["weight"])) == ("P007", 8.25, 0.4)
        assert f"1 of {source.general().health.poses.measured} poses" in text

    def test_none_doubted_is_said(self, changed_from, sighted, tmp_path):
        source = changed_from(sighted["pose"], COMBINED, lambda r: r.update(suspected_outliers=[]))
        rows, text = rows_of(tables.tabulate_suspected_outliers, source, tmp_path)
        assert not rows
        assert "| none | – | – | – | – |" in text


class TestAccuracy:
    def one(self, rows, poses, model, load="all", part="all"):
        (row,) = (
            row
            for row in rows
            if (row["poses"], row["model"], row["load"], row["part"]) == (poses, model, load, part)
        )
        return row

    def test_errors_of_all_loads_are_pooled(self, sighted, tmp_path):
        rows, _ = rows_of(tables.tabulate_accuracy_general, sighted["points"], tmp_path)
        errors = sighted["points"].general().errors
        assert list(errors) == ["0N", "20N"]
        parts = [each.after for each in errors.values()]
        count = np.array([part.configurations for part in parts])
        pooled = self.one(rows, "fitted", "linear")
        rms = np.sqrt(count @ [part.rms_mm**2 for part in parts] / count.sum())
        assert float(pooled["rms_mm"]) == pytest.approx(rms, rel=1e-5)
        assert float(pooled["peak_mm"]) == pytest.approx(max(p.peak_mm for p in parts), rel=1e-5)
        assert int(pooled["configurations"]) == count.sum()
        alone = self.one(rows, "fitted", "linear", load="20N")
        assert float(alone["mean_mm"]) == pytest.approx(errors["20N"].after.mean_mm, rel=1e-5)

    def test_held_out_errors_are_those_of_the_record(self, sighted, tmp_path):
        rows, text = rows_of(tables.tabulate_accuracy_general, sighted["pose"], tmp_path)
        for name, model in sighted["pose"].held_out().models.items():
            row = self.one(rows, "held out", name)
            assert float(row["rms_mm"]) == pytest.approx(model.rms_mm, rel=1e-5)
            assert float(row["orientation_deg"]) == pytest.approx(model.orientation_deg, rel=1e-5)
        assert "| held out | all | calibrated, linear springs |" in text

    def test_a_model_to_which_nothing_was_added_is_not_listed_twice(self, sighted, tmp_path):
        source = sighted["points"]
        record = json.loads((source.folder / "evaluation/holdout.json").read_text("utf-8"))
        assert record["models"]["extended"] == record["models"]["linear"]
        rows, text = rows_of(tables.tabulate_accuracy_general, source, tmp_path)
        assert "extended" not in {row["model"] for row in rows}
        assert "with the effects found" not in text

    def test_what_is_extrapolated_stands_apart(self, learnt, tmp_path):
        rows, text = rows_of(tables.tabulate_accuracy_general, learnt, tmp_path)
        extended = learnt.held_out().models["extended"]
        for part, errors in (("inside", extended.inside), ("extrapolated", extended.outside)):
            row = self.one(rows, "held out", "extended", part=part)
            assert float(row["rms_mm"]) == pytest.approx(errors.rms_mm, rel=1e-5)
        fitted = self.one(rows, "fitted", "extended")
        assert float(fitted["rms_mm"]) == learnt.verdict().gap.train.after.rms_mm
        assert "with the effects found, extrapolated" in text

    def test_an_attitude_not_seen_is_a_dash(self, sighted, tmp_path):
        rows, text = rows_of(tables.tabulate_accuracy_general, sighted["distance"], tmp_path)
        assert {row["orientation_deg"] for row in rows} == {""}
        assert "| – |" in text
        assert "across the line of sight are not measured" in text


class TestHealth:
    def test_the_general_model_stands_beside_the_papers(self, results, tmp_path):
        rows, text = rows_of(tables.tabulate_health_summary, results, tmp_path)
        paper, general = results.calibrations()
        for case in (paper, general):
            said = {row["quantity"]: row["value"] for row in rows if row["model"] == case.model}
            assert said["line"] == case.health.line
            assert said["rank"] == str(case.health.rank)
            assert float(said["train_rms_mm"]) == pytest.approx(case.health.train_rms_mm, rel=1e-5)
            assert f"of the {MODELS[case.model]} stands on" in text
            assert f"| rank {case.health.rank} of {case.health.unknowns}" in text

    def test_gives_every_pose_in_the_order_of_what_it_tells(self, sighted, tmp_path):
        rows, _ = rows_of(tables.tabulate_health_summary, sighted["points"], tmp_path)
        order = [row["value"] for row in rows if row["quantity"] == "d_optimal_order"]
        assert order == list(sighted["points"].general().health.poses.d_optimal_order)

    def test_correlated_pairs_and_what_is_not_known(self, changed_from, sighted, tmp_path):
        def change(record):
            pair = {"parameters": ["delta_a_2", "delta_d_4"], "correlation": -0.9876}
            record["health"].update(correlated_pairs=[pair], noise_mm=None)
            record["health"]["poses"]["needed"] = None

        source = changed_from(sighted["pose"], COMBINED, change)
        rows, text = rows_of(tables.tabulate_health_summary, source, tmp_path)
        assert "| δa₂ | δd₄ | -0.988 |" in text
        ordered = len(source.general().health.poses.d_optimal_order)
        assert f"more than {ordered} well-chosen poses" in text
        (noise,) = (row for row in rows if row["quantity"] == "noise_mm")
        assert noise["value"] == ""
