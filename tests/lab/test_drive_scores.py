"""What trials of drives come to, from verdicts written out."""

import pytest

import made_up_trials
from made_up_trials import named, scored, verdict
from pa10cal.results.record import Name
from pa10cal_lab.trial_names import drive_outcome


def trial(kind, hidden, found, number=0, failed=None):
    """One joint 2 of an arm; `found` are names with alternatives, of joint 2 unless they say so."""
    effects = [named(*map(_name, names)) for names in found]
    return made_up_trials.trial(
        kind,
        [made_up_trials.hidden(_name(each), moved_mm=None, ratio=101.0) for each in hidden],
        None if failed else verdict(*effects, word="named" if effects else "none"),
        campaign=f"drive-{kind}-{number}",
        layout="ur10-1",
        measured="drives",
        springs=(),
        failed=failed or "",
    )


def _name(text):
    name, _, of = text.partition("@")
    return Name(name, of or "joint 2")


S, G, M = "sensor_error", "gear_error", "joint_error_map"


@pytest.mark.parametrize(
    ("hidden", "found", "became"),
    [
        ([S], [[S]], "right"),
        ([G], [[G]], "right"),
        ([S], [[S, G]], "ambiguous"),
        ([S], [[G, S]], "ambiguous"),
        ([S], [[G]], "wrong"),
        ([S, G], [[S, G]], "right"),
        ([S, G], [[S]], "ambiguous"),
        ([S, G], [[S], [G]], "right"),
        ([S], [[M], [S]], "right"),
        ([S], [[S], [G]], "ambiguous"),
        ([S], [[M]], "no_cause"),
        ([S], [["backlash"]], "missed"),
        ([S], [[S + "@joint 3"]], "missed"),
        ([S], [], "missed"),
    ],
)
def test_what_became_of_a_joint(hidden, found, became):
    assert drive_outcome(trial("sensor", hidden, found), "joint 2") == became


@pytest.mark.parametrize(
    ("kind", "hidden", "found", "share"),
    [
        ("neither", ["motor_ripple"], [["backlash@joint 3", "arrival_error"]], 1.0),
        ("neither", ["motor_ripple"], [[M]], 0.0),  # a map is no name
        ("neither", ["motor_ripple"], [["motor_ripple", S]], 0.0),
        ("sensor", [S], [[S, G]], None),
    ],
)
def test_false_names_are_those_of_nothing_hidden(kind, hidden, found, share):
    assert scored([trial(kind, hidden, found)]).bars[-1].reached == share


def test_bars_count_joints_and_quiet_trials():
    trials = [
        trial("sensor", [S], [[S]], 0),
        trial("sensor", [S], [[G]], 1),
        trial("gear", [G], [[G]], 2),
        trial("both", [S, G], [[S, G]], 3),
        trial("sensor", [S], [], 4, failed="no poses"),
        trial("neither", ["motor_ripple"], [], 5),
        trial("neither", ["motor_ripple"], [[S]], 6),
    ]
    found = scored(trials)
    whole, sensor, gear, both, wrong, quiet = found.bars
    assert (whole.reached, whole.trials) == (pytest.approx(3 / 5), 5)
    assert (sensor.reached, gear.reached, both.reached) == (pytest.approx(1 / 3), 1.0, 1.0)
    assert wrong.reached == pytest.approx(1 / 5)
    assert (quiet.reached, quiet.met) == (0.5, False)
    counts = {each.kind: each.counts for each in found.subjects}
    assert counts == {
        "sensor": {"right": 1, "wrong": 1, "failed": 1},
        "gear": {"right": 1},
        "both": {"right": 1},
    }
    assert found.per_trial[4].said == "crashed: no poses"
