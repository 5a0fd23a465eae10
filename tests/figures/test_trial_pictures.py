"""Pictures of blind trials: drawn from scores of made-up trials, legible, with what they say."""

import json

import numpy as np
import pytest
from matplotlib.text import Text

import made_up_trials
from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.errors import RecordError
from pa10cal.figures.registry import NothingToShowError
from pa10cal.figures.style import WIDTH_MM
from pa10cal.results.codec import lines, read
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.record import Name
from pa10cal_lab.cell.effects.vocabulary import outside, vocabulary
from pa10cal_lab.cell.trials import STUDIES
from pa10cal_lab.pictures import (
    draw_trials_confusion,
    draw_trials_intervals,
    draw_trials_power,
    tabulate_trials_subjects,
    tabulate_trials_summary,
)
from pa10cal_lab.trial_records import OutcomeCounts, TrialScoresRecord

DRAWN = (draw_trials_confusion, draw_trials_power, draw_trials_intervals)
COUNTS = {"null": 9, "wrong_noise": 3, "wrong_mass": 3, "pair": 6, "triple": 5}


LAYOUTS = {study: tuple(STUDIES[study]) for study in ("touched", "tracked")}


def trial(rng, number, kind, names, measured):
    """Return a made-up verdict and its truth; larger effects are named more often."""
    size = float(np.exp(rng.uniform(np.log(0.1), np.log(3.0))))
    hidden = [
        made_up_trials.hidden(Name(name, f"joint {k + 1}"), size, 0.01 * size, A=1e-4, phi=0.3)
        for k, name in enumerate(names)
    ]
    effects = [
        made_up_trials.named(
            Name("backlash", each.of) if rng.random() < 0.1 else each,
            *([("tool_sag", "tool")] if rng.random() < 0.3 else []),
            A=(1e-4 * (1.0 + 0.01 * rng.standard_normal()), 1e-6),
            phi=(0.3 + 0.01 * rng.standard_normal(), 0.01),
        )
        for each in hidden
        if kind != "outside" and rng.random() < 0.3 + 0.5 * size
    ]
    word, places = "none" if not effects else "named", ()
    if kind == "outside":
        word, places = "unexplained", ("joint 1" if rng.random() < 0.8 else None,)
    said = made_up_trials.verdict(
        *effects,
        word=word,
        places=places,
        not_testable=[each for each in hidden if rng.random() < 0.05],
        springs=(2, 3, 5),
        before_mm=0.02,
        after_mm=float(rng.uniform(0.008, 0.01)),
    )
    layout = LAYOUTS[measured][number % len(LAYOUTS[measured])]
    made = made_up_trials.trial(kind, hidden, said, layout=layout, measured=measured)
    name = {"campaign": f"blind-{number:04d}"}
    return made.judgement.model_copy(update=name), made.truth.model_copy(update=name)


def write_scores(folder, kinds, measured="touched"):
    """Write scores of trials of (kind, hidden names); return the path."""
    rng = np.random.default_rng(7)
    both = [trial(rng, number, *what, measured) for number, what in enumerate(kinds)]
    paths = [folder / f"{name}.jsonl" for name in ("verdicts", "truths")]
    for path, records in zip(paths, zip(*both, strict=True), strict=True):
        path.write_text(lines(records), "utf-8")
    out = folder / "scores.json"
    words = ["--verdicts", str(paths[0]), "--truths", str(paths[1]), "--scores", str(out)]
    assert run_command("score_trials", [*words, "--trials", str(folder / "trials.csv")]) == 0
    return out


@pytest.fixture(scope="module", params=LAYOUTS)
def full(request, tmp_path_factory):
    several = {"pair": 2, "triple": 3}
    names = sorted(vocabulary())
    kinds = [("single", (name,)) for name in names for _ in range(4)]
    kinds += [("outside", (name,)) for name in sorted(outside()) for _ in range(3)]
    for kind, count in COUNTS.items():
        kinds += [(kind, tuple(names[: several.get(kind, 0)]))] * count
    return write_scores(tmp_path_factory.mktemp("full"), kinds, request.param)


@pytest.fixture(scope="module")
def few(tmp_path_factory):
    """Scores of nulls alone: nothing to draw for most pictures."""
    return write_scores(tmp_path_factory.mktemp("few"), [("null", ())] * 3)


@pytest.mark.slow
@pytest.mark.parametrize("draw", DRAWN, ids=lambda draw: draw.__name__)
def test_texts_are_large_enough_inside_the_picture_and_clear_of_each_other(
    full, draw, written_legibly
):
    figure = draw(read(TrialScoresRecord, full))
    written_legibly(figure, "Synthetic data.")
    assert figure.get_figwidth() * 25.4 == pytest.approx(WIDTH_MM)


@pytest.mark.usefixtures("project_looks")
@pytest.mark.parametrize("draw", DRAWN, ids=lambda draw: draw.__name__)
def test_of_a_few_trials_it_is_drawn_or_has_nothing_to_show(few, draw):
    with pytest.raises(NothingToShowError, match=r"^no (trial|hidden effect)"):
        draw(read(TrialScoresRecord, few))


@pytest.mark.slow_but_one_in(2)
def test_a_study_that_counts_no_intervals_has_none_to_show(full):
    """Trials of unstated masses and of sorted rows have parameters, and no rate of theirs."""
    scores = read(TrialScoresRecord, full)
    others = tuple(row for row in scores.rates if not row.what.startswith("parameter"))
    with pytest.raises(NothingToShowError, match="does not count"):
        draw_trials_intervals(scores.model_copy(update={"rates": others}))


@pytest.mark.usefixtures("project_looks")
def test_the_matrix_shows_every_count(full):
    scores = read(TrialScoresRecord, full)
    texts = (text.get_text() for text in draw_trials_confusion(scores).findobj(Text))
    shown = [int(text) for text in texts if text.isdigit()]
    trials = sum(subject.trials for subject in scores.subjects)
    assert sum(shown) == 2 * trials  # cells, and sums of rows


def test_the_table_has_a_row_a_bar_with_its_figure(full):
    scores = read(TrialScoresRecord, full)
    table = tabulate_trials_summary(scores)
    assert len(table.data) > len(scores.bars)
    targets = table.data[table.data["to reach"] != ""]
    first = targets.iloc[0]
    assert first["to reach"] == "≤ 2.0 %"
    assert first["reached"] == f"{100 * scores.bars[0].reached:.1f} %"
    assert first["trials"] == COUNTS["null"]
    assert list(targets["met"]) == [bar.verdict for bar in scores.bars]
    assert "no" in set(targets["met"])


def test_mixed_trials_count_what_was_found_and_have_the_notes_of_measured_robots(full):
    scores = read(TrialScoresRecord, full)
    counts = dict.fromkeys(("crashed", "refused", "false_comfort", "worse", "unexplained"), 0)
    counts |= {"false_name": 0, "suspected": 0, "above_noise": 5, "told": 4, "found": 7}
    mixed = OutcomeCounts(kind="mixed", id="backlash", trials=9, counts=counts)
    trials = tuple(each.model_copy(update={"kind": "mixed"}) for each in scores.per_trial)
    wild = {"measured": "wild", "subjects": (mixed,), "per_trial": trials}
    table = tabulate_trials_subjects(scores.model_copy(update=wild))
    assert list(table.data["found"]) == [7]
    notes = " ".join(tabulate_trials_summary(scores.model_copy(update=wild)).notes)
    assert "computed from the truth" in notes


@pytest.mark.slow
def test_the_stage_writes_pictures_and_tables(full, tmp_path):
    words = ["--results", str(full.parent), "--settings", '{"figures": {"png_dpi": 60}}']
    assert run_command("figures", [*words, "--out-dir", str(tmp_path)]) == 0
    written = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*")}
    names = [draw.__name__.removeprefix("draw_") for draw in DRAWN]
    expected = {f"figures/{name}.{ending}" for name in names for ending in ("svg", "pdf", "png")}
    expected |= {f"tables/trials_summary.{ending}" for ending in ("csv", "md")}
    assert written == expected | {"pictures.json"}
    assert "Synthetic data" in (tmp_path / "tables/trials_summary.md").read_text("utf-8")


def test_the_stage_refuses_another_name_and_other_records(full, tmp_path, capsys):
    words = ["--results", str(full.parent), "--out-dir", str(tmp_path)]
    assert run_command("figures", ["--figure", "l_curve", *words]) == REFUSED
    assert "no such figure" in capsys.readouterr().err
    other = tmp_path / "other.json"
    other.write_text(json.dumps({"schema": VerdictRecord.SCHEMA}))
    with pytest.raises(RecordError, match="not a record of this kind"):
        read(TrialScoresRecord, other)
    spoilt = json.loads(full.read_text("utf-8"))
    del spoilt["bars"][0]["limit"]
    other.write_text(json.dumps(spoilt))
    with pytest.raises(RecordError, match="limit"):
        read(TrialScoresRecord, other)
