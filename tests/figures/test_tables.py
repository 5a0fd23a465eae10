"""Tables: complete, with the paper's conclusions recomputed, and readable in every format."""

import csv
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd
import pytest

from made_up_results import elsewhere
from pa10cal.command_settings import PictureOptions
from pa10cal.figures import published
from pa10cal.figures.campaign import paper_against_ours
from pa10cal.figures.registry import NothingToShowError
from pa10cal.figures.table import ResultTable, figures, frame_of, write_table
from pa10cal.reports.blocks import grid
from pa10cal.reports.formatting import parameter_with_interval, sentence, sized, with_half_width
from pa10cal.results.evaluation import EffectParameter


@pytest.fixture(scope="module")
def compared(results):
    return against(results)


def against(results):
    """Return the rows of the table beside the paper."""
    return paper_against_ours.tabulate_paper_against_ours(results).data.to_dict("records")


def update(changes, record):
    record.update(changes)


def one(rows, quantity, condition, remark=""):
    found = [
        row
        for row in rows
        if (row["quantity"], row["condition"]) == (quantity, condition) and remark in row["remark"]
    ]
    assert len(found) == 1, (quantity, condition, remark)
    return found[0]


#: What the paper states, at 0, 22 and 44 N.
LOADS, MODELS = ("0 N", "22 N", "44 N"), ("uncalibrated", "linear", "cubic")
STATED = {
    "mean position error before calibration": ("0.58", "1.02", "1.80"),
    "peak position error before calibration": ("1.22", "1.50", "2.45"),
    "mean orientation error before calibration": ("1.2", "1.2", "1.1"),
    "standard deviation within one configuration": ("≤ 0.014", "≤ 0.024", "≤ 0.023"),
    "mean position error after calibration": ("0.32", "0.28", "0.33"),
    "peak position error after calibration": ("0.66", "0.58", "0.71"),
    "mean orientation error after calibration": ("0.05", "0.04", "0.03"),
    "mean position error, held out": ("1.77", "0.55", "0.56"),
    "peak position error, held out": ("4", "0.92", "1.04"),
    "mean orientation error, held out": ("2.4", "1.2", "1.2"),
}
SINGLE = {
    ("Monte Carlo mean position error", "z = 500 mm"): "0.197",
    ("Monte Carlo standard deviation", "z = 500 mm"): "0.096",
    ("Monte Carlo mean, difference of a parallel plane", "z = 300 mm"): "< 0.001",
    ("Monte Carlo mean, difference of a parallel plane", "z = 700 mm"): "< 0.001",
    ("K_lin", "joint 2"): "1.98e4",
    ("K_lin", "joint 3"): "1.27e4",
    ("K_lin", "joint 5"): "2.56e3",
    ("K_cub", "joint 2"): "3.35e7",
    ("K_cub", "joint 3"): "1.46e7",
    ("K_cub", "joint 5"): "3.83e7",
    ("uncertainty of the coordinate measuring machine", "one measured centre"): "0.0121",
    ("sag of the apparatus under its own weight", "largest"): "0.030",
    ("deflection by the touch of the probe", "largest"): "< 0.001",
}
#: What the paper concludes, and what its own values give: other percentages than it says.
CONCLUDED = {
    "mean error after calibration less the Monte Carlo mean": ("< 0.1", "0.12", "0.08", "0.13"),
    "reduction of the mean position error": ("50 to 80", "45", "73", "82"),
}


class TestPaperAgainstOurs:
    def test_every_figure_of_the_paper_has_its_row_with_its_place_and_ours(self, compared):
        for quantity, values in STATED.items():
            places = MODELS if "held out" in quantity else LOADS
            remarks = ("this load alone", "all loads") if "after" in quantity else ("",)
            for at, value in zip(places, values, strict=True):
                for remark in remarks:
                    assert one(compared, quantity, at, remark)["paper"] == value
        for key, value in SINGLE.items():
            assert one(compared, *key)["paper"] == value
        assert all(row["source"] and row["ours"] for row in compared)

    def test_conclusions_are_recomputed_from_the_papers_own_figures(self, compared):
        for quantity, (paper, *recomputed) in CONCLUDED.items():
            for at, value in zip(LOADS, recomputed, strict=True):
                row = one(compared, quantity, at)
                assert (row["paper"], row["recomputed"]) == (paper, value)
        for model, value in (("linear", "77"), ("cubic", "74")):
            row = one(compared, "reduction of the peak position error, held out", model)
            assert (row["paper"], row["recomputed"]) == ("≥ 75", value)

    def test_ours_are_those_of_the_records(self, compared, results):
        alone = results.load_cases()["44N"].errors["44N"]
        together = results.paper_calibration()
        plane = results.planes_of_settings()[1]
        name, less = "mean position error after calibration", alone.after.mean_mm - plane.mean_mm
        fell = published.reduction_percent(alone.before.mean_mm, alone.after.mean_mm)
        for quantity, remark, value, within in (
            (name, "this load alone", alone.after.mean_mm, {"rel": 5e-3}),
            (name, "all loads", together.errors["44N"].after.mean_mm, {"rel": 5e-3}),
            ("reduction of the mean position error", "", fell, {"abs": 0.5}),
            (
                "mean error after calibration less the Monte Carlo mean",
                "below the Monte Carlo mean",
                less,
                {"abs": 5e-3},
            ),
        ):
            row = one(compared, quantity, "44 N", remark)
            assert float(row["ours"]) == pytest.approx(value, **within)
        row = one(compared, "K_lin", "joint 2")
        value, std = row["ours"].strip("()e4").split(" ± ")
        parameter = together.parameters["K_lin_2"]
        assert float(value) * 1e4 == pytest.approx(parameter.value, abs=5)
        assert float(std.split(")")[0]) * 1e4 == pytest.approx(parameter.std, abs=5)
        assert one(compared, "unknowns", "all loads together")["ours"].startswith("36, of which 34")
        name = "uncertainty of the coordinate measuring machine"
        assert one(compared, name, "one measured centre")["ours"] == "0.0121"
        for quantity in (
            "sag of the apparatus under its own weight",
            "deflection by the touch of the probe",
        ):
            assert one(compared, quantity, "largest")["ours"] == "not measured"

    def test_remarks_say_what_to_bear_in_mind(self, compared):
        remark = one(compared, "Monte Carlo mean position error", "z = 500 mm")["remark"]
        assert re.search("systematic.*times less", remark)
        remark = one(compared, "mean orientation error, held out", "uncalibrated")["remark"]
        assert re.search("constant tool twist.*% of it", remark)

    def test_rows_stay_when_a_load_a_plane_and_the_held_out_points_are_missing(
        self, results, changed_from, compared
    ):
        def without_44_N(record):
            record["loads_fitted"].remove(44.0)
            del record["errors"]["44N"]

        part = changed_from(results, "calibration/combined.json", without_44_N)
        part = changed_from(part, "evaluation/holdout.json", lambda r: r.update(models={}))
        settings = PictureOptions.model_validate({"montecarlo": {"planes_mm": [300]}})
        rows = against(replace(part, settings=settings))
        keys = [(row["quantity"], row["condition"]) for row in rows]
        assert keys == [(row["quantity"], row["condition"]) for row in compared]
        assert one(rows, "peak position error, held out", "cubic")["ours"] == "not measured"
        assert one(rows, "Monte Carlo standard deviation", "z = 500 mm")["ours"] == "not computed"
        for row in rows:
            if row["condition"] == "44 N" and "standard deviation" not in row["quantity"]:
                assert row["ours"] == "not measured", row
        row = one(rows, "standard deviation within one configuration", "44 N")
        assert row["remark"] == "this load was not measured"

    def test_a_plane_that_differs_more_than_the_papers_is_said_not_to_reproduce(
        self, results, changed_from
    ):
        source = results
        for plane_mm, changes in {
            500: {"mean_mm": 0.198, "rejected_positions": 7},
            300: {"mean_mm": 0.1985},
            700: {"mean_mm": 0.193, "rejected_positions": 91},
        }.items():
            changes["half_width95_positions_mm"] = 0.002
            source = changed_from(source, f"montecarlo/z{plane_mm}.json", partial(update, changes))
        rows, name = against(source), "Monte Carlo mean, difference of a parallel plane"
        assert "reproduce" not in one(rows, name, "z = 300 mm")["remark"]
        remark = one(rows, name, "z = 700 mm")["remark"]
        assert remark.startswith("does not reproduce: the ring of positions is cut")
        assert "91 positions" in remark

    def test_a_difference_of_planes_within_its_interval_is_no_contradiction(
        self, results, changed_from
    ):
        change = partial(update, {"mean_mm": 0.3, "half_width95_positions_mm": 0.02})
        name = "Monte Carlo mean, difference of a parallel plane"
        for other_mm, says in ((0.31, False), (0.34, True)):
            source = changed_from(results, "montecarlo/z*.json", change)
            other = partial(update, {"mean_mm": other_mm})
            source = changed_from(source, "montecarlo/z700.json", other)
            remark = one(against(source), name, "z = 700 mm")["remark"]
            assert ("does not reproduce" in remark) == says

    @pytest.mark.parametrize(("mean_mm", "says"), [(1.0, True), (1e-6, False)])
    def test_only_a_smaller_scatter_of_repeats_is_so_many_times_less(
        self, results, changed_from, mean_mm, says
    ):
        change = partial(update, {"mean_mm": mean_mm})
        rows = against(changed_from(results, "montecarlo/z500.json", change))
        remark = one(rows, "Monte Carlo mean position error", "z = 500 mm")["remark"]
        assert "repeats scatter by" in remark
        assert ("times less" in remark) == says

    def test_repeats_that_do_not_scatter_are_not_infinitely_better(self, results):
        scatter = pd.DataFrame({"largest": 0.0, "mean": 0.0, "largest_per_axis": 0.0}, ["0N"])
        (first, *_) = paper_against_ours._monte_carlo_rows(results, scatter)
        assert first.remark.endswith("repeats scatter by 0.00 mm on average")

    def test_is_made_of_the_papers_arm_only(self, results):
        with pytest.raises(NothingToShowError, match="not the paper's"):
            against(elsewhere(results, robot="other"))

    def test_the_evaluated_calibration_is_named(self, results, changed_from):
        change = partial(update, {"calibration": "22N"})
        rows = against(changed_from(results, "evaluation/holdout.json", change))
        left = results.paper_calibration("22N").errors["22N"].after.orientation_deg
        remark = one(rows, "mean orientation error, held out", "cubic")["remark"]
        said = remark.partition("calibration (22N) leaves ")[2].split()[0]
        assert float(said) == pytest.approx(left, rel=5e-3)

    def test_notes_say_when_uncertainties_do_not_cover_what_the_model_lacks(
        self, results, changed_from
    ):
        def worse(record):
            record["health"].update(grade="incomplete")

        source = changed_from(results, "calibration/combined.json", worse)
        for make in (
            paper_against_ours.tabulate_paper_against_ours,
            paper_against_ours.tabulate_table1_parameters,
        ):
            lacking = make(source).notes
            assert set(make(results).notes) < set(lacking)
            assert lacking[-1].endswith("± does not cover the effect that it lacks.")


class TestTableOne:
    def test_holds_every_parameter_of_every_calibration(self, results):
        rows = paper_against_ours.tabulate_table1_parameters(results).data.to_dict("records")
        assert len(rows) == 4 * 30
        combined = {row["parameter"]: row for row in rows if row["calibration"] == "combined"}
        assert set(combined) == {*published.DEPARTURES} | {
            f"{kind}_{joint}" for kind in ("K_lin", "K_cub") for joint in (2, 3, 5)
        }
        for name, row in combined.items():
            assert float(row["paper"]) == published.parameter(name, "text_e7")
        unknown = {name for name, row in combined.items() if not row["identifiable"]}
        assert unknown == {"delta_d_1", "delta_theta_1"}

    def test_is_laid_out_as_in_the_paper(self, results):
        first_part, *alone = paper_against_ours.tabulate_table1_parameters(results).shown
        together = frame_of(first_part.header, first_part.rows)
        assert together["joint"].tolist() == list("123456")
        assert together.shape[1] == 1 + 2 * 7
        assert [grid.caption for grid in alone] == ["0 N alone", "22 N alone", "44 N alone"]
        first = together.iloc[0]
        assert first["δd [mm]"] == "0.000 †"
        assert first["K_lin [kN m/rad]"] == "∞"
        assert first["δβ [mrad]"] == "n/a"
        assert together.iloc[1, 2] == "-0.46"

    @pytest.mark.parametrize(("reading", "value"), [("text_e7", "38.3"), ("table_e8", "384")])
    def test_shows_the_chosen_reading_of_the_papers_cubic_stiffness(self, results, reading, value):
        settings = PictureOptions.model_validate({"kcub_reading": reading})
        table = paper_against_ours.tabulate_table1_parameters(replace(results, settings=settings))
        assert table.shown[0].rows[4][-1] == value
        assert any(reading[-2:] in note.replace("1e", "e") for note in table.notes)

    def test_an_arm_without_springs_has_its_table(self, results, changed_from):
        def without_springs(record):
            parameters = record["parameters"].items()
            record["parameters"] = {n: p for n, p in parameters if not n.startswith("K_")}

        rigid = changed_from(results, "calibration/*.json", without_springs)
        table = paper_against_ours.tabulate_table1_parameters(rigid)
        assert len(table.data) == 4 * 24
        assert all(row[-1] == "∞" for part in table.shown[1:] for row in part.rows)
        assert one(against(rigid), "K_lin", "joint 2")["ours"] == "not estimated"

    def test_a_stiffness_of_zero_at_its_bound_has_its_row(self, results, changed_from):
        def at_zero(record):
            changes = {"value": 0.0, "std": 0.0, "at_bound": True, "identifiable": False}
            record["parameters"]["K_cub_2"].update(changes)

        row = one(
            against(changed_from(results, "calibration/combined.json", at_zero)), "K_cub", "joint 2"
        )
        assert row["ours"] == "(0.000 ± 0.000)e0"
        assert row["remark"].endswith("at its bound; not identifiable from the poses")

    def test_an_uncertainty_that_is_not_known_is_not_zero(self, results, changed_from):
        def unknown(record):
            record["parameters"]["K_lin_2"]["std"] = None

        source = changed_from(results, "calibration/combined.json", unknown)
        row = one(against(source), "K_lin", "joint 2")
        assert "±" not in row["ours"] + row["remark"]
        table = paper_against_ours.tabulate_table1_parameters(source).shown[0]
        cells = frame_of(table.header, table.rows)["K_lin [kN m/rad]"]
        assert "±" not in cells[1]
        assert "±" in cells[2]

    def test_leaves_the_paper_out_for_another_arm(self, results):
        table = paper_against_ours.tabulate_table1_parameters(elsewhere(results, robot="other"))
        assert "paper" not in table.shown[0].header
        assert not any("paper" in note for note in table.notes)

    def test_the_papers_own_is_complete(self):
        """Its orientation error before calibration is what its joint zeros turn the tool by."""
        assert len(published.DEPARTURES) == 24
        assert len(published.K_LIN) == len(published.K_CUB["text_e7"]) == 3
        turn = published.DEPARTURES["delta_theta_4"] + published.DEPARTURES["delta_theta_6"]
        assert turn == pytest.approx(21.1e-3)
        for joint, value in published.K_CUB["text_e7"].items():
            assert published.K_CUB["table_e8"][joint] == pytest.approx(10 * value, rel=0.003)
        assert published.parameter("K_cub_5", "table_e8") == 3.84e8
        for name in ("K_lin_1", "delta_d_2", "base_p_cmm_x", "gamma_z"):
            assert published.parameter(name, "text_e7") is None


def test_csv_and_markdown_hold_the_same_cells(tmp_path):
    rows = [("1 < 2", "x | y"), ("ü, é", '"quoted"')]
    data = frame_of(("a", "b"), rows)
    table = ResultTable("T", data, (grid("", ("a", "b"), rows),), ("a note",))
    write_table(table, "from here", tmp_path, "t")
    with (tmp_path / "t.csv").open(encoding="utf-8", newline="") as file:
        assert [tuple(row) for row in csv.reader(file)] == [("a", "b"), *rows]
    markdown = (tmp_path / "t.md").read_text("utf-8")
    assert "| 1 < 2 | x \\| y |" in markdown
    assert "from here" in markdown


def test_rows_have_as_many_cells_as_the_header():
    with pytest.raises(ValueError, match="2 columns passed, passed data had 1"):
        frame_of(("a", "b"), [("1",)])


def test_no_rows_are_said_to_be_none(tmp_path):
    write_table(ResultTable("T", frame_of(("a", "b"), [])), "", tmp_path, "t")
    assert "| none | – |" in (tmp_path / "t.md").read_text("utf-8")


def test_numbers_are_written_with_the_figures_they_have(tmp_path):
    data = frame_of(("x", "y", "z"), [(figures(1.23456789e-7, 4), True, figures(None, 4))])
    write_table(ResultTable("T", data), "", tmp_path, "t")
    assert (tmp_path / "t.csv").read_text("utf-8") == "x,y,z\n1.235e-07,true,\n"


def test_nothing_is_left_when_one_format_fails(tmp_path, monkeypatch):
    write = Path.write_text

    def fail_at_markdown(path, text, **options):
        if path.suffix == ".md":
            raise OSError("disk full")
        return write(path, text, **options)

    data = frame_of(("a",), [("1",)])
    monkeypatch.setattr(Path, "write_text", fail_at_markdown)
    with pytest.raises(OSError, match="disk full"):
        write_table(ResultTable("T", data), "footer", tmp_path, "t")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("value", "half", "written"),
    [
        (0.54933, 0.049, "0.549 ± 0.049"),
        (4.3839, 0.018, "4.384 ± 0.018"),
        (0.00039437, 1.7e-5, "(3.94 ± 0.17)e-4"),
        (5e-5, 2e-4, "(0.5 ± 2.0)e-4"),
        (123456.0, 2300.0, "(1.235 ± 0.023)e5"),
        (12.3, 0.0, "12.3 ± 0"),
        (9.996, 0.0996, "10.00 ± 0.10"),
    ],
)
def test_a_value_has_the_digits_of_its_interval(value, half, written):
    assert with_half_width(value, half) == written


def test_a_stiffness_has_the_interval_of_its_compliance():
    assert parameter_with_interval("K_lin_2", 7.0, 22.0 / 1.96) == "above 1.7"
    assert parameter_with_interval("K_lin_2", 20.0, 5.0 / 1.96) == "20, 16 to 27"
    assert parameter_with_interval("K", 20.0, 1.0 / 1.96) == "20.0 ± 1.0"
    assert parameter_with_interval("delta_a_2", 7.0, 22.0 / 1.96) == "7 ± 22"
    # Without an exponent, however stiff.
    assert parameter_with_interval("K", 150.0, 15.0) == "150, 130 to 190"
    assert parameter_with_interval("K", 1.2e3, 2e2) == "1200, 900 to 1800"
    assert parameter_with_interval("K", 1.2e3, 2e3) == "above 280"


@pytest.mark.parametrize(
    ("value", "std", "written"),
    [(1e-4, 1e-5, "(0.100 ± 0.020) mm"), (1e-4, 0.0, "0.1 mm"), (0.2, 0.01, "(200 ± 20) mm")],
)
def test_a_unit_stands_behind_a_value_and_its_interval(value, std, written):
    shown = sized("A", EffectParameter(value=value, std=std, unit="m"))
    assert shown.replace("\u00a0", " ") == written


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("what remains.", "What remains."),
        ("two sessions?", "Two sessions?"),
        ("q2_deg counts the other way", "q2_deg counts the other way."),
        ("", ""),
    ],
)
def test_a_sentence_begins_and_ends_as_one(text, written):
    assert sentence(text) == written
