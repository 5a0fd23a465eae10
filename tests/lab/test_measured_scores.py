"""Scores of made-up trials of unstated masses and of sorted rows: every bar can be missed."""

from dataclasses import replace

import pytest

import made_up_trials
from made_up_trials import hidden, named, scored, scored_by_command, verdict
from pa10cal.commands.command_line import run_command
from pa10cal.results.codec import write
from pa10cal.results.record import Name
from pa10cal_lab.blind_trial import WILD
from pa10cal_lab.cell.measured_trials import MIXED, SORTED, UNSTATED

NOISE_MM = 0.02
TWO, THREE, SIX = (Name("joint_compliance", f"joint {joint}") for joint in (2, 3, 6))
DISK = Name("encoder_eccentricity", "joint 2")
RATIO = Name("gear_ratio_error", "joint 1")
WANDERED = "the instrument or the base wandered by 0.1 mm (root mean square) in 2 h"
MOVED = "the instrument or the base moved by 0.2 mm and 0.1 mrad"


def said(word="named", names=(), faults=(), motions=(), grade="good", after_mm=0.02):
    """Return a verdict; a name with alternatives is a tuple of names."""
    found = [each if isinstance(each[0], Name) else (each,) for each in names]
    return verdict(
        *(named(*each) for each in found),
        word=word,
        not_testable=[TWO],  # what the verdict itself says of that does not count
        springs=(2, 3),
        noise_floor_mm=99.0,  # nor its noise
        after_mm=after_mm,
        before_mm=0.02,
        faults=faults,
        motions=motions,
        health=(grade, (), ()),
    )


def trial(kind, said, *hiding, refused=False):
    """Return a trial with effects of so many noises: (name, moved, apart)."""
    return made_up_trials.trial(
        kind,
        [
            hidden(name, moved_mm=moved * NOISE_MM, apart_mm=apart * NOISE_MM)
            for name, moved, apart in hiding
        ],
        said,
        layout="ur10-pose",
        measured=WILD,
        springs=(),
        noise_mm=NOISE_MM,
        refused=refused,
    )


LARGE, LESS, SMALL = (TWO, 9.0, 8.0), (THREE, 1.2, 0.5), (SIX, 1.0, 1.0)
CASES = {
    "named": (trial(UNSTATED, said(names=[TWO, THREE]), LARGE, LESS), ()),
    "an alternative": (trial(UNSTATED, said(names=[(DISK, TWO)]), LARGE), ()),
    "a small one need not be": (trial(UNSTATED, said(names=[TWO]), LARGE, SMALL), ()),
    "a small one may be": (trial(UNSTATED, said(names=[TWO, SIX]), LARGE, SMALL), ()),
    "not found": (
        trial(UNSTATED, said("unexplained"), LARGE),
        ("spring not found",),
    ),
    "another name instead": (
        trial(UNSTATED, said(names=[DISK]), LARGE),
        ("spring not found", "wrong name"),
    ),
    "wrong in any verdict": (
        trial(UNSTATED, said("unexplained", names=[TWO, RATIO]), LARGE),
        ("wrong name",),
    ),
    "a spring where none is": (
        trial(UNSTATED, said(names=[TWO, SIX]), LARGE),
        ("wrong name",),
    ),
    "another effect": (
        trial(UNSTATED, said(names=[TWO]), LARGE, (RATIO, 5.0, 5.0)),
        ("other effect not found",),
    ),
    "nothing hidden": (trial(UNSTATED, said("none")), ()),
    "nothing hidden, a spring": (
        trial(UNSTATED, said("ambiguous", names=[(TWO, DISK)])),
        ("nothing hidden, a name",),
    ),
    "crash": (trial(UNSTATED, None, LARGE), ("no verdict", "spring not found")),
    "refused": (trial(UNSTATED, None, refused=True), ("no verdict", "accused")),
    "suspected": (
        trial(UNSTATED, said("named", [TWO], grade="suspect_input"), LARGE),
        ("accused",),
    ),
    "worse": (trial(UNSTATED, said(names=[TWO], after_mm=0.022), LARGE), ("worse held out",)),
    "a drift in masses trials is no bar": (
        trial(UNSTATED, said(names=[TWO], motions=[WANDERED]), LARGE),
        (),
    ),
    "sorted": (trial(SORTED, said("none")), ()),
    "sorted, unnamed": (trial(SORTED, said("unexplained"), LARGE), ()),
    "sorted, wandered": (
        trial(SORTED, said("unexplained", motions=[WANDERED])),
        ("motion as a fact",),
    ),
    "sorted, a step": (
        trial(SORTED, said("check_the_log", faults=[("step_in_time", "P1")], motions=[MOVED])),
        ("motion as a fact", "accused"),
    ),
    "sorted, a drift": (
        trial(SORTED, said(names=[Name("base_drift", "base")])),
        ("nothing hidden, a name", "motion as a fact"),
    ),
    "sorted, told with its rival": (
        trial(
            SORTED,
            said("unexplained", motions=[f"{WANDERED}, or an error of joint 1 by which rows go"]),
        ),
        (),
    ),
    "sorted, a null named": (
        trial(SORTED, said(names=[DISK])),
        ("nothing hidden, a name",),
    ),
}


TRIALS = [case for case, _ in CASES.values()]


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("name", CASES)
def test_a_trial_counts_against_the_bars_that_it_misses(name):
    case, expected = CASES[name]
    assert set(scored([case]).per_trial[0].failings) == set(expected)


def bars_of(kind, trials):
    """Return the bars of the trials of one kind, which are a study of their own."""
    return {bar.what: bar for bar in scored([each for each in trials if each.kind == kind]).bars}


def test_bars_count_springs_and_trials():
    found = bars_of(UNSTATED, TRIALS)
    springs = found["springs that leave 1.5 times the noise: named or listed"]
    assert springs.trials == 14
    assert springs.trials - round(springs.reached * springs.trials) == 3
    apart = found["of these, that nothing else hidden can replace: named or listed"]
    assert apart.trials == 13
    wrong = found["springs or an effect: a wrong confident name"]
    assert round(wrong.reached * wrong.trials) == 3
    nulls = found["no masses stated, nothing hidden: a name"]
    assert (nulls.trials, round(nulls.reached * nulls.trials)) == (3, 1)
    assert not any(bar.met for bar in found.values() if bar.share)
    motion = bars_of(SORTED, TRIALS)["rows sorted: a motion told as a fact"]
    assert (motion.trials, round(motion.reached * motion.trials)) == (7, 3)
    assert motion.limit == 0.0
    fine = [CASES[name][0] for name in ("named", "another effect", "nothing hidden", "sorted")]
    fine[1] = replace(fine[1], judgement=said(names=[TWO, RATIO]))
    for kind in (UNSTATED, SORTED):
        assert all(bar.met for bar in bars_of(kind, fine).values() if bar.trials)


def test_scores_are_drawn_and_listed(tmp_path):
    scores = scored([each for each in TRIALS if each.kind == UNSTATED])
    by_id = {(each.kind, each.id): each for each in scores.subjects}
    springs = by_id[UNSTATED, "joint_compliance"]
    assert (springs.counts["above_noise"], springs.counts["told"]) == (14, 11)
    assert (UNSTATED, "encoder_eccentricity") not in by_id  # named, never hidden
    write(scores, tmp_path / "scores.json")
    assert run_command("figures", ["--results", str(tmp_path)]) == 0
    assert "another cause" in (tmp_path / "tables/trials_summary.md").read_text("utf-8")


def test_truths_of_these_kinds_are_scored_as_such(tmp_path):
    scores, _ = scored_by_command(tmp_path, trial(UNSTATED, None, LARGE))
    assert scores["schema"] == "pa10cal-trials/2"
    without, springs = scores["bars"][:2]
    assert (without["trials"], without["reached"]) == (1, 1.0)
    assert (springs["trials"], springs["reached"]) == (1, 0.0)
    assert scores["per_trial"][0]["failings"] == ["no verdict", "spring not found"]


WAVES, BEARING = Name("small_waves", "joint 3"), Name("soft_bearing", "joint 3")
MAP, LINE, TILT = (
    Name(id, "joint 3") for id in ("joint_error_map", "periodic_error", "lateral_compliance")
)


def mixed(said, *hiding, outside=False):
    """Return a trial that hides several effects, maybe waves and a soft bearing of joint 3."""
    case = trial(MIXED, said, *hiding)
    background = (
        hidden(WAVES, outside=True, orders=[2.4, 61.0]),
        hidden(BEARING, outside=True),
    )
    named = tuple(each.model_copy(update={"outside": False}) for each in case.truth.hidden_effects)
    known = case.truth.model_copy(update={"hidden_effects": named + background * outside})
    return replace(case, truth=known)


def said_line(k):
    return verdict(named(LINE, k=(k, 0.1)), word="unexplained", noise_floor_mm=1.0)


BESIDE = (RATIO, 5.0, 5.0)
SEVERAL = {
    "both": (mixed(said(names=[TWO, RATIO]), LARGE, BESIDE), set()),
    "one missed": (mixed(said(names=[TWO]), LARGE, BESIDE), {"effect not found"}),
    "small ones need not be": (mixed(said(names=[TWO]), LARGE, SMALL), set()),
    "wrong, with alternatives": (mixed(said(names=[TWO, (DISK, SIX)]), LARGE), set()),
    "wrong, alone": (mixed(said("unexplained", names=[TWO, DISK]), LARGE), {"wrong name alone"}),
    "the background": (mixed(said(names=[TWO, MAP, TILT]), LARGE, outside=True), set()),
    "a map of nothing": (mixed(said(names=[TWO, MAP]), LARGE), {"wrong name alone"}),
    "a line of it": (mixed(said_line(61.0), SMALL, outside=True), set()),
    "another line": (mixed(said_line(30.0), SMALL, outside=True), {"wrong name alone"}),
    "no verdict": (mixed(None, LARGE), {"no verdict", "effect not found"}),
}


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("name", SEVERAL)
def test_a_trial_of_several_effects_counts_against_the_bars_that_it_misses(name):
    case, expected = SEVERAL[name]
    assert set(scored([case]).per_trial[0].failings) == expected


def test_several_effects_are_counted_by_what_else_is_hidden(tmp_path):
    scores = scored([case for case, _ in SEVERAL.values()])
    rates = {(rate.what, rate.by): rate for rate in scores.rates}
    whole = "several effects: all named or in the alternatives"
    assert rates[whole, "a background"].count == 1
    assert rates[whole, "nothing else"].count == 4
    bars = {bar.what: bar for bar in scores.bars}
    extra = bars["several effects: nothing extra"]
    assert (extra.trials, extra.count) == (10, 5)
    write(scores, tmp_path / "scores.json")
    assert run_command("figures", ["--results", str(tmp_path)]) == 0
