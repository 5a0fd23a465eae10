"""Results are read whole, or refused with what is wrong and what to do."""

import json
import shutil

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawn_examples import examples
from made_up_results import elsewhere
from pa10cal.errors import Pa10calError, RawDataError, RecordError
from pa10cal.figures.campaign.paper_against_ours import tabulate_paper_against_ours
from pa10cal.figures.campaign.paper_figures import (
    PLACE_MM,
    draw_fig5_before_after,
    places,
    scatter_by_load,
)
from pa10cal.figures.draw import of_campaign
from pa10cal.figures.published import is_of_papers_arm
from pa10cal.reports.errors import better_general, headline
from pa10cal.results.analysis import AnalysisRecord
from pa10cal.results.calibration import BaseFrameRecord
from pa10cal.results.discovery import VerdictRecord


@pytest.fixture
def spoiled(results, tmp_path):
    """A copy of the results, to spoil."""
    shutil.copytree(results.folder, tmp_path / "copy")
    return elsewhere(results, tmp_path / "copy")


def change(path, **changes):
    content = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps({**content, **changes}), encoding="utf-8")


def test_loads_are_those_that_the_combined_calibration_was_fitted_to(spoiled):
    (spoiled.folder / "calibration/7N.json").write_text("stale", encoding="utf-8")
    cases = spoiled.load_cases()
    assert list(cases) == ["0N", "22N", "44N"]
    assert cases["22N"].load == "22N"


def test_a_load_that_was_left_out_is_not_missing(spoiled):
    path = spoiled.folder / "calibration/combined.json"
    change(path, loads_left_out={"22N": "fewer equations than unknowns"})
    (spoiled.folder / "calibration/22N.json").unlink()
    assert list(spoiled.load_cases()) == ["0N", "44N"]
    figure = draw_fig5_before_after(spoiled)
    assert [text.get_text() for text in figure.axes[-1].get_xticklabels()] == [
        "0 N",
        "22 N",
        "44 N",
    ]
    rows = tabulate_paper_against_ours(spoiled).data.to_dict("records")
    ours = [row["ours"] for row in rows if "at this load alone" in row["remark"]]
    assert [value == "not computed" for value in ours] == 3 * [False, True, False]
    fell = [row["ours"] for row in rows if row["quantity"].startswith("reduction of the mean")]
    assert [value == "not computed" for value in fell] == [False, True, False]


def test_the_general_model_stands_beside_the_papers_or_alone(results, sighted):
    assert [results.paper_calibration().model, results.general_calibration().model] == [
        "paper",
        "general",
    ]
    assert results.general_calibration().load == "general"
    assert sighted["pose"].general_calibration().model == "general"
    assert sighted["pose"].general_calibration().load == "combined"


def test_planes_are_those_of_the_settings_and_poses_come_in_order_of_time(results):
    assert [plane.plane_mm for plane in results.planes_of_settings()] == [300, 500, 700]
    poses = places(results)
    assert len(poses) == 952
    assert list(poses["kind"].iloc[[0, 11, 22, -1]]) == ["line_x", "line_y", "grid", "holdout"]


@pytest.mark.parametrize(
    ("name", "read", "stage"),
    [
        ("calibration/combined.json", lambda r: r.paper_calibration(), "calibrate"),
        ("calibration/general.json", lambda r: r.general_calibration(), "calibrate"),
        ("calibration/22N.json", lambda r: r.load_cases(), "calibrate"),
        ("evaluation/holdout.json", lambda r: r.sound_held_out(), "evaluate"),
        ("seed/base_frame.json", lambda r: r.read(BaseFrameRecord), "seed"),
        ("montecarlo/z500.json", lambda r: r.planes_of_settings(), "montecarlo"),
        ("discovery/analysis.json", lambda r: r.sound_record(AnalysisRecord), "discover"),
        ("discovery/verdict.json", lambda r: r.sound_record(VerdictRecord), "discover"),
        ("ingest/poses.parquet", places, "ingest"),
    ],
)
class TestRefuses:
    def test_what_is_missing_broken_of_another_schema_or_campaign(self, spoiled, name, read, stage):
        def refused(results, match):
            with pytest.raises(Pa10calError, match=match):
                read(elsewhere(results))  # read anew

        path = spoiled.folder / name
        stranger = elsewhere(spoiled, name="cell-z")
        refused(stranger, r"another campaign \(got 'cell-null'\).*cell-z")
        if path.suffix == ".json":
            change(path, schema="other/1")
        else:
            table = pq.read_table(path)
            pq.write_table(table.replace_schema_metadata({"schema": "other/1"}), path)
        refused(spoiled, r"other/1'.*pa10cal-")
        path.write_text("{", encoding="utf-8")
        again = rf"run (pa10cal {stage}|the {stage} stage) again"
        refused(spoiled, rf"{name}: .*cannot be read.*{again}")
        path.unlink()
        refused(spoiled, rf"{name}: .*missing.*run pa10cal {stage} first")


def test_names_the_key_or_the_column_that_is_missing(spoiled):
    change(spoiled.folder / "evaluation/holdout.json", models={"linear": {"mean_mm": 1}})
    with pytest.raises(RecordError, match=r"the record lacks models\.linear\.peak_mm"):
        spoiled.sound_held_out()
    path = spoiled.folder / "ingest/poses.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["ee_z_mm"]), path)
    with pytest.raises(RecordError, match=r"has no column.*ee_z_mm"):
        places(spoiled)


def test_an_array_is_no_result_and_a_table_of_something_else_no_table_of_poses(spoiled):
    (spoiled.folder / "seed/base_frame.json").write_text("[]", encoding="utf-8")
    with pytest.raises(RecordError, match=r"not a record of this kind.*schema pa10cal-base-frame"):
        spoiled.read(BaseFrameRecord)
    pq.write_table(pa.table({"a": [1]}), spoiled.folder / "ingest/poses.parquet")
    with pytest.raises(RawDataError, match="cannot be read"):
        places(spoiled)


@pytest.mark.parametrize(
    ("provenance", "footer"),
    [
        ("virtual cell, by others", "Synthetic data. Provenance: virtual cell, by others."),
        ("Synthetic: by a cell; more.", "Synthetic data. Provenance: Synthetic: by a cell; more."),
        ("SIMULATED arm", "Synthetic data. Provenance: SIMULATED arm."),
        ("measured in hall 3, 2008", "Provenance: measured in hall 3, 2008."),
        ("our arm, no simulated rows", "Provenance: our arm, no simulated rows."),
        ("syntheticarm works, hall 3", "Provenance: syntheticarm works, hall 3."),
    ],
)
def test_footer_gives_the_provenance_and_says_when_data_are_synthetic(results, provenance, footer):
    assert (
        of_campaign(elsewhere(results, provenance=provenance)).footer
        == f"Campaign cell-null. {footer}"
    )


def test_a_long_provenance_is_cut_after_a_sentence(results):
    first = f"Measured by C. Lang et al. in {'a hall, ' * 30}2021."
    second = f"Angles are {'the commanded ones, ' * 8}not read back."
    footer = of_campaign(elsewhere(results, provenance=f"{first} {second} {second}")).footer
    assert footer == f"Campaign cell-null. Provenance: {first} More in its campaign.yaml."
    assert of_campaign(elsewhere(results, provenance=f"{first} Short.")).footer.endswith(
        f"{first} Short."
    )


def test_figures_of_another_arm_are_not_compared_with_the_papers(results):
    assert is_of_papers_arm(results)
    assert not is_of_papers_arm(elsewhere(results, robot="other"))


# The scatter of repeats, against numpy's own variance.


def poses(p_mm, loads, kind="grid"):
    """Poses of shape (loads, configurations, repeats, 3), in any order of loads."""
    count, configurations, repeats = p_mm.shape[:3]
    each = configurations * repeats
    labels = np.tile(np.repeat([f"P{k}" for k in range(configurations)], repeats), count)
    table = pd.DataFrame(p_mm.reshape(-1, 3), columns=list(PLACE_MM))
    return table.assign(
        kind=kind,
        pose=labels,
        load_N=np.repeat(np.array(loads, dtype=float), each),
        repeat=np.tile(np.arange(repeats), count * configurations),
    )


@examples(30)
@given(st.integers(0, 2**31), st.integers(1, 4), st.integers(2, 5))
def test_is_the_standard_deviation_of_the_distance(seed, configurations, repeats):
    p_mm = np.random.default_rng(seed).normal(500.0, 0.02, (2, configurations, repeats, 3))
    found = scatter_by_load(poses(p_mm, [44, 0]))
    expected = np.sqrt(p_mm.var(axis=2, ddof=1).sum(axis=2))
    assert list(found.index) == ["0N", "44N"]
    for name, at in (("44N", 0), ("0N", 1)):
        assert found.loc[name, "largest"] == pytest.approx(expected[at].max(), rel=1e-6)
        assert found.loc[name, "mean"] == pytest.approx(expected[at].mean(), rel=1e-6)


def test_nothing_is_known_without_repeats_or_without_grid_poses():
    p_mm = np.zeros((1, 3, 1, 3))
    assert scatter_by_load(poses(p_mm, [0])).empty
    assert scatter_by_load(poses(np.zeros((1, 1, 4, 3)), [0], kind="holdout")).empty


def test_says_where_the_general_model_predicts_far_better_than_the_papers(spoiled):
    assert better_general(spoiled) is None
    path = spoiled.folder / "calibration/general.json"
    health = json.loads(path.read_text(encoding="utf-8"))["health"]
    far_mm = 0.4 * headline(spoiled)[1].counted.rms_mm
    change(path, health={**health, "grade": "good", "held_out_rms_mm": far_mm})
    said = better_general(elsewhere(spoiled, spoiled.folder))
    assert f"leaves {far_mm:.3f} mm" in said
    assert "calibration.model to general" in said
    change(path, health={**health, "grade": "suspect_input", "held_out_rms_mm": far_mm})
    assert better_general(elsewhere(spoiled, spoiled.folder)) is None


def test_errors_after_are_those_with_what_has_no_name_where_that_is_all_that_is_predicted(spoiled):
    path = spoiled.folder / "discovery/verdict.json"
    change(path, effects=[])
    assert headline(elsewhere(spoiled, spoiled.folder))[1].name != "extended"
    part = {"ids": ["field"], "of": "without a name, predicted", "joints": {"1": 1.0}}
    part |= {"share": 0.5, "before_mm": 0.4, "after_mm": 0.3}
    whole = {"share": 0.5, "without_a_name": 0.5, "over": "held-out poses", "noise_mm": 0.1}
    change(path, explained={**whole, "of": [part], "before_mm": 0.4, "after_mm": 0.3})
    after = headline(elsewhere(spoiled, spoiled.folder))[1]
    assert after.name == "extended"
    assert after.title.startswith("with what has no name predicted")
