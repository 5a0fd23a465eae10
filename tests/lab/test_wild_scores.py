"""Scores of made-up wild trials: every bar can be missed, and is where it should be."""

import pytest

import made_up_trials
from made_up_trials import hidden, named, put_in, scored, scored_by_command, verdict
from pa10cal.commands.command_line import run_command
from pa10cal.figures.registry import entries
from pa10cal.results.codec import write
from pa10cal.results.record import Name
from pa10cal_lab.blind_trial import WILD

DISK, LOST = Name("encoder_eccentricity", "joint 2"), Name("backlash", "joint 3")
FLOOR_MM = 0.01
JUMP = put_in("jump", ("time 40 s",), False, ("step_in_time",), False, None)
LABEL = put_in("labels_exchanged", ("P007",), False, ("label",), False, None)
ZERO = put_in("joint_zero", ("joint 2",), False, ("joint_zero",), False, None)
SMALL = put_in("payload_off", ("tool",), False, ("payload",), True, 0.01)
LARGE = SMALL.model_copy(update={"moved_mm": 0.1})
LENGTH = put_in("length_typo", ("delta_a_3",), False, ("departure",), False, None)
TAILS = put_in("heavy_tails", ("instrument",), True, (), False, None)
WALK = put_in("random_walk", ("instrument",), True, ("step_in_time",), True, 0.1)


def said(word="none", names=(), faults=(), grade="good", left_out=(), departures=(), after_mm=0.02):
    return verdict(
        *map(named, names),
        word=word,
        noise_floor_mm=FLOOR_MM,
        after_mm=after_mm,
        before_mm=0.02,
        faults=faults,
        health=(grade, left_out, departures),
    )


def trial(kind, said, *disturbed, hiding=(), refused=False, springs=()):
    return made_up_trials.trial(
        kind,
        [hidden(name, moved_mm=0.1) for name in hiding],
        said,
        layout="ur10-pose",
        measured=WILD,
        springs=springs,
        put_in=disturbed,
        refused=refused,
    )


CASES = {
    "right data": (trial("right", said()), ()),
    "right data with a name": (trial("right", said("named", [DISK])), ("false name",)),
    "a spring that the arm has": (
        trial("right", said("named", [Name("joint_compliance", "joint 5")]), springs=(5,)),
        (),
    ),
    "right data accused": (trial("right", said(grade="suspect_input")), ("accused",)),
    "right data refused": (trial("right", None, refused=True), ("accused",)),
    "right data, and a crash": (trial("right", None), ("crash",)),
    "tails": (trial("stressed", said("check_the_log"), TAILS), ("accused",)),
    "a walk may be told": (
        trial("stressed", said("check_the_log", faults=(("step_in_time", "base"),)), WALK),
        (),
    ),
    "a walk is not nothing": (trial("stressed", said(), WALK), ("not told", "false comfort")),
    "an effect": (trial("effect", said("named", [DISK]), TAILS, hiding=[DISK]), ()),
    "another effect": (
        trial("effect", said("named", [LOST]), TAILS, hiding=[DISK]),
        ("false name", "not found"),
    ),
    "an effect, and the log accused": (
        trial("effect", said("check_the_log", [DISK]), TAILS, hiding=[DISK]),
        ("accused",),
    ),
    "no effect": (
        trial("effect", said(), TAILS, hiding=[DISK]),
        ("false comfort", "not found"),
    ),
    "worse held out": (
        trial("effect", said("named", [DISK], after_mm=0.0212), TAILS, hiding=[DISK]),
        ("worse held out",),
    ),
    "a label left out": (trial("fault", said(left_out=["P007"]), LABEL), ()),
    "another left out": (
        trial("fault", said(left_out=["P008"]), LABEL),
        ("not told", "false comfort"),
    ),
    "a length found": (trial("fault", said(departures=["delta_a_3", "delta_d_1"]), LENGTH), ()),
    "a length found elsewhere": (
        trial("fault", said(departures=["delta_a_30"]), LENGTH),
        ("not told", "false comfort"),
    ),
    "a label told": (
        trial("fault", said("check_the_log", faults=(("label", "P007, 0 N"),)), LABEL),
        (),
    ),
    "a label told elsewhere": (
        trial("fault", said("check_the_log", faults=(("label", "P0071"),)), LABEL),
        ("not told",),
    ),
    "another fault": (
        trial("fault", said("check_the_log", faults=(("load", "joint 2"),)), ZERO),
        ("not told",),
    ),
    "a zero suspected": (trial("fault", said("unexplained", grade="suspect_input"), ZERO), ()),
    "a zero that poses confirm": (trial("fault", said(departures=["joint 2"]), ZERO), ()),
    "a zero refused": (trial("fault", None, ZERO, refused=True), ()),
    "a step": (trial("fault", said("check_the_log", faults=(("step_in_time", "x"),)), JUMP), ()),
    "a step with a name": (
        trial("fault", said("named", [LOST]), JUMP),
        ("confident false name", "not told"),
    ),
    "below the noise": (trial("fault", said(), SMALL), ()),
    "above the noise": (trial("fault", said(), LARGE), ("not told", "false comfort")),
    "no name for it": (trial("beyond", said("unexplained"), hiding=[Name("saw", "joint 1")]), ()),
    "a name for it": (
        trial("beyond", said("named", [DISK]), hiding=[Name("saw", "joint 1")]),
        ("confident false name",),
    ),
}


TRIALS = [case for case, _ in CASES.values()]


@pytest.mark.slow_but_one_in(5)
@pytest.mark.parametrize("name", CASES)
def test_a_trial_counts_against_the_bars_that_it_misses(name):
    case, expected = CASES[name]
    assert scored([case]).per_trial[0].failings == expected


def test_bars_count_the_failings_of_the_trials():
    found = [bar for bar in scored(TRIALS).bars if bar.share and "formula" not in bar.what]
    names = (
        *("crash", "false name", "confident false name", "confident false name", "not told"),
        *("false comfort", "worse held out", "not found", "accused"),
    )
    counts = [bar.trials - bar.count if bar.at_least else bar.count for bar in found]
    both, accused = counts[2] + counts[3], counts[9] + counts[10]
    expected = [sum(name in missed for _, missed in CASES.values()) for name in names]
    assert [*counts[:2], both, *counts[4:8], accused] == [*expected[:3], *expected[4:]]
    assert all(bar.met is not None for bar in found)
    assert not any(bar.met for bar in found)
    fine = [
        CASES[name][0] for name in ("right data", "an effect", "a label told", "no name for it")
    ]
    assert all(bar.met for bar in scored(fine).bars if "formula" not in bar.what)


def test_scores_are_drawn_and_listed(tmp_path):
    scores = scored(TRIALS)
    assert scores.trials == len(CASES)
    assert sum(subject.trials for subject in scores.subjects) == len(CASES)
    write(scores, tmp_path / "scores.json")
    assert run_command("figures", ["--results", str(tmp_path)]) == 0
    for name in ("trials_summary", "trials_subjects"):
        assert "ynthetic" in entries("trials")[name].caption
        assert "Synthetic data" in (tmp_path / f"tables/{name}.md").read_text("utf-8")


def test_wild_truths_are_scored_as_such(tmp_path):
    refused = made_up_trials.trial(
        "fault", [], None, measured=WILD, put_in=[JUMP], refused=True, failed="too few rows"
    )
    scores, (row,) = scored_by_command(tmp_path, refused)
    assert scores["schema"] == "pa10cal-trials/2"
    assert row["said"] == "refused: too few rows"
    assert row["put_in"] == "jump at time 40 s"
    assert row["failings"] == ""
