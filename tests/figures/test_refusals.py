"""Nothing is drawn of a fit that did not converge, or of another model than the picture is of."""

import shutil
from dataclasses import replace

import pytest

from made_up_results import elsewhere
from pa10cal.errors import RecordError
from pa10cal.figures.draw import of_campaign
from pa10cal.figures.registry import entries

NEEDS = {name: {*entry.needs} for name, entry in entries("campaign").items()}
#: Drawn from no calibration.
OF_NO_FIT = {"fig4_test_path"} | {
    name for name, needs in NEEDS.items() if needs <= {"poses", "base_frame", "planes"}
}
DRAWN_OF_FITS = [name for name in entries("campaign") if name not in OF_NO_FIT]
REASON = "The maximum number of function evaluations is exceeded"
REMEDY = r"allowed: a calibration whose status is converged; .*calibration\.max_iterations"


@pytest.fixture
def unfinished(changed_from):
    """Copy results in which the fits named did not converge."""

    def copy(source, *keys, load="*"):
        def end_early(record):
            for key in keys:
                fit = record[key] if key else record
                fit.update(status="not converged", reason=REASON)

        return changed_from(source, f"calibration/{load}.json", end_early)

    return copy


def make(name, results):
    entry = entries("campaign")[name]
    return entry.make(results)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("name", DRAWN_OF_FITS)
def test_nothing_is_drawn_of_a_fit_that_did_not_converge(unfinished, results, name):
    source = unfinished(results, "")
    where = r"calibration/(combined|general)\.json: the fit did not converge"
    with pytest.raises(RecordError, match=rf"{where}.*not converged: {REASON}.*{REMEDY}"):
        make(name, source)


@pytest.mark.parametrize(
    ("source", "name", "key", "load", "where"),
    [
        ("learnt", "suspected_outliers", "geometry", "*", r"combined\.json: geometry"),
        ("results", "fig6_holdout", "linear", "combined", r"combined\.json: linear"),
        ("results", "fig5_before_after", "", "22N", r"22N\.json"),
        ("results", "table1_parameters", "", "22N", r"22N\.json"),
        ("results", "paper_against_ours", "", "22N", r"22N\.json"),
    ],
)
def test_nor_of_a_model_or_a_load_that_it_shows_too(
    request, unfinished, source, name, key, load, where
):
    spoiled = unfinished(request.getfixturevalue(source), key, load=load)
    with pytest.raises(RecordError, match=rf"{where}: the fit did not converge.*{REMEDY}"):
        make(name, spoiled)


@pytest.mark.parametrize("name", sorted(OF_NO_FIT))
def test_what_is_of_no_fit_is_drawn(unfinished, results, project_looks, name):
    made = make(name, unfinished(results, ""))
    assert made.axes if entries("campaign")[name].kind == "figure" else len(made.data)


@pytest.mark.parametrize(
    "name", ["fig5_before_after", "fig6_holdout", "table1_parameters", "paper_against_ours"]
)
def test_pictures_of_the_papers_model_are_of_no_other(sighted, name):
    with pytest.raises(RecordError, match=r"of the paper's model.*the general model.*pictures"):
        make(name, sighted["pose"])


def test_pictures_of_the_general_model_are_of_no_other(results, tmp_path):
    folder = tmp_path / "other"
    shutil.copytree(results.folder, folder)
    shutil.copy(folder / "calibration/combined.json", folder / "calibration/general.json")
    with pytest.raises(RecordError, match=r"general\.json: the picture is of the general model"):
        make("suspected_outliers", elsewhere(results, folder))


@pytest.fixture
def suspect(results, changed_from):
    """Results of a calibration whose input is suspect."""
    found = {"grade": "suspect_input", "line": "joint 6: its sign is reversed"}
    name = "calibration/combined.json"
    return changed_from(results, name, lambda record: record["health"].update(found))


def test_nothing_is_drawn_of_a_suspect_input_without_force(suspect):
    with pytest.raises(RecordError, match=r"grade suspect_input.*its sign is reversed.*--force"):
        make("table1_parameters", suspect)
    assert "Grade" not in of_campaign(suspect).footer


def test_with_force_it_is_drawn_and_every_picture_is_marked(suspect, unfinished, results):
    forced = replace(suspect, force=True)
    assert make("table1_parameters", forced) is not None
    assert "Grade of the calibration: suspect_input." in of_campaign(forced).footer
    assert "Grade" not in of_campaign(replace(results, force=True)).footer
    assert make("table1_parameters", replace(unfinished(results, ""), force=True)) is not None
