"""Scores of hand-made verdicts: every rule can fail, and does where it should."""

import numpy as np
import pytest

import made_up_trials
from made_up_trials import figures, hidden, named, scored
from pa10cal.errors import RecordError
from pa10cal.results.record import Name
from pa10cal_lab import trial_names
from pa10cal_lab.blind_trial import WILD
from pa10cal_lab.trial_names import (
    ELSEWHERE,
    FAILED,
    LISTED,
    NO_PLACE,
    NOT_TESTABLE,
    NOTHING,
    RIGHT_PLACE,
    WRONG_PLACE,
    is_place_found,
    outcome,
)
from pa10cal_lab.trial_tables import true_parameters

WAVE = Name("transmission_error", "joint 2")
DISK = Name("encoder_eccentricity", "joint 2")
ELLIPSE = Name("encoder_ellipticity", "joint 2")
MAP = Name("joint_error_map", "joint 2")
LOST = Name("backlash", "joint 3")
GAIN = Name("torque_gain", "joint 2")
THIRD = Name("third_harmonic", "joint 2")
FLOOR_MM = 0.005

#: Figures by short names.
LARGE = "one effect, separable, residual 3 times the floor or more: right id and place"
ALONE = "one effect, separable and large: named alone"
ABOVE = "one effect, residual 1.5 times the floor or more: among the effect or its alternatives"
FOUND = "one effect, anything found: among the effect or its alternatives"
DETECTED = "one effect, testable: anything found"
TORQUE_ALONE = "one effect, testable, that only the torque shows: listed"
WRONG = "one effect: a finding that matches no hidden effect"
NOT_SHOWN = "one effect: not testable, by the verdict"
ALTERNATIVES = "one effect, listed: alternatives beside it, mean"
OUTSIDE_WRONG = "effect outside the vocabulary: a confident wrong name"
OUTSIDE_PLACE = "effect outside the vocabulary: found at the right place"
OUTSIDE_SILENT = "effect outside the vocabulary: nothing found"
ALL_LISTED = "two or three effects: all named or in the alternatives"
ABOVE_LISTED = "two or three effects: those of a residual 1.5 times the floor or more"
NOTHING_EXTRA = "two or three effects: nothing extra"
GAP = "held-out mean after naming, over that of campaigns without missing effect"
INSIDE = "parameters of named effects: inside the 95 % interval"


def verdict(*effects, **more):
    return made_up_trials.verdict(*effects, **({"springs": (2, 3, 5)} | more))


def trial(kind, what, said, moved_mm=0.05, **more):
    what = (hidden(each, moved_mm=moved_mm) if isinstance(each, Name) else each for each in what)
    return made_up_trials.trial(kind, what, said, **more)


def single(what, said, **more):
    return trial("single", [what], said, **more)


def test_the_ratio_is_that_of_root_mean_squares_with_the_noise_added():
    floor_rms_mm = FLOOR_MM * np.sqrt(3.0 * np.pi / 8.0)
    found = single(WAVE, verdict(), moved_mm=2.0 * floor_rms_mm)
    assert found.moved_over_floor(found.hidden[0]) == pytest.approx(2.0)
    assert found.ratio(found.hidden[0]) == pytest.approx(np.sqrt(5.0))
    failed = single(WAVE, None)
    assert failed.ratio(failed.hidden[0]) is None


def test_the_floor_is_the_mean_length_of_a_vector_with_alike_components():
    length = np.linalg.norm(np.random.default_rng(0).standard_normal((200_000, 3)), axis=1)
    ratio = np.sqrt(np.mean(length**2)) / length.mean()
    found = single(WAVE, verdict(), moved_mm=FLOOR_MM * ratio)
    assert found.moved_over_floor(found.hidden[0]) == pytest.approx(1.0, abs=0.005)


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    ("said", "named_share", "unexplained_share"),
    [
        (verdict(), 0.0, 0.0),
        (verdict(word="not_sought"), 0.0, 0.0),
        (verdict(named(WAVE)), 1.0, 0.0),
        (verdict(named(WAVE, DISK)), 1.0, 0.0),
        (verdict(word="unexplained", places=("base",)), 0.0, 1.0),
        (verdict(named(LOST), word="unexplained", places=(None,)), 1.0, 1.0),
        (None, 1.0, 0.0),
    ],
)
def test_nothing_hidden(said, named_share, unexplained_share):
    found = figures([trial("null", [], said)])
    assert found["nothing hidden: a name | null"].reached == named_share
    unexplained = found["nothing hidden: something without a name | null"]
    assert unexplained.reached == unexplained_share


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    ("said", "right", "alone", "listed", "wrong"),
    [
        (verdict(named(WAVE)), 1.0, 1.0, 1.0, 0.0),
        (verdict(named(WAVE, LOST)), 1.0, 0.0, 1.0, 0.0),
        (verdict(named(WAVE), named(LOST)), 1.0, 0.0, 1.0, 1.0),
        (verdict(named(LOST, WAVE)), 0.0, 0.0, 1.0, 0.0),
        (verdict(named(LOST)), 0.0, 0.0, 0.0, 1.0),
        (verdict(named(Name("transmission_error", "joint 3"))), 0.0, 0.0, 0.0, 1.0),
        (verdict(), 0.0, 0.0, 0.0, 0.0),
        (verdict(word="not_sought"), 0.0, 0.0, 0.0, 0.0),
        (verdict(word="unexplained", places=("joint 2",)), 0.0, 0.0, 0.0, 0.0),
        (None, 0.0, 0.0, 0.0, 1.0),
    ],
)
def test_one_large_effect(said, right, alone, listed, wrong):
    found = figures([single(WAVE, said)])
    reached = [found[what].reached for what in (LARGE, ALONE, ABOVE, WRONG)]
    assert reached == [right, alone, listed, wrong]


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    ("said", "moved_mm", "large", "above"),
    [
        (verdict(), 2.0 * FLOOR_MM, 0, 1),
        (verdict(), 0.5 * FLOOR_MM, 0, 0),
        (verdict(named(LOST), indistinguishable=(frozenset({WAVE, LOST}),)), 0.05, 0, 1),
        (verdict(named(LOST), indistinguishable=(frozenset({DISK, LOST}),)), 0.05, 1, 1),
        (verdict(not_testable=frozenset({WAVE})), 0.05, 0, 1),
    ],
)
def test_only_large_and_separable_effects_must_be_named(said, moved_mm, large, above):
    found = figures([single(WAVE, said, moved_mm=moved_mm)])
    assert (found[LARGE].trials, found[ABOVE].trials) == (large, above)
    hopeless = WAVE in said.not_shown
    assert (found[NOT_SHOWN].count, found[DETECTED].trials) == (int(hopeless), int(not hopeless))


def test_a_map_is_no_rival_of_a_named_form_and_told_where_forms_are_told():
    with_map = verdict(named(DISK), indistinguishable=(frozenset({DISK, MAP}),))
    assert single(DISK, with_map).is_separable(hidden(DISK))
    assert single(MAP, with_map).is_separable(hidden(MAP))
    forms = verdict(named(DISK), indistinguishable=(frozenset({DISK, ELLIPSE, MAP}),))
    assert not single(DISK, forms).is_separable(hidden(DISK))
    assert not single(MAP, forms).is_separable(hidden(MAP))


def test_what_only_the_torque_shows_is_held_against_the_torque():
    rigid = Name("friction_torque", "joint 1")
    flexible = Name("friction_torque", "joint 2")
    one = single(GAIN, verdict(named(GAIN)))
    assert not one.moves_poses(one.hidden[0])
    assert not single(rigid, verdict()).moves_poses(hidden(rigid))
    assert single(flexible, verdict()).moves_poses(hidden(flexible))
    found = figures([one, single(rigid, verdict())])
    assert (found[LARGE].trials, found[ABOVE].trials) == (0, 0)
    assert (found[TORQUE_ALONE].count, found[TORQUE_ALONE].trials) == (1, 2)


def test_found_are_those_with_a_finding_and_alternatives_are_counted():
    trials = [
        single(WAVE, verdict(named(WAVE, DISK, LOST))),
        single(WAVE, verdict(named(WAVE))),
        single(WAVE, verdict(word="unexplained", places=(None,))),
        single(WAVE, verdict()),
    ]
    found = figures(trials)
    assert (found[FOUND].count, found[FOUND].trials) == (2, 3)
    assert (found[DETECTED].count, found[DETECTED].trials) == (3, 4)
    assert found[ALTERNATIVES].reached == pytest.approx(1.0)


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    ("what", "said", "wrong", "right_place", "silent"),
    [
        (THIRD, verdict(word="unexplained", places=("joint 2",)), 0.0, 1.0, 0.0),
        (THIRD, verdict(word="unexplained", places=("joint 3",)), 0.0, 0.0, 0.0),
        (THIRD, verdict(word="unexplained", places=("joint 3", "joint 2")), 0.0, 1.0, 0.0),
        (THIRD, verdict(named(MAP)), 0.0, 1.0, 0.0),
        (THIRD, verdict(named(Name("joint_error_map", "joint 3"))), 1.0, 0.0, 0.0),
        (THIRD, verdict(named(ELLIPSE)), 1.0, 0.0, 0.0),
        (THIRD, verdict(named(ELLIPSE, DISK)), 0.0, 0.0, 0.0),
        (THIRD, verdict(named(MAP), named(LOST)), 1.0, 1.0, 0.0),
        (Name("hysteresis", "joint 2"), verdict(named(MAP)), 1.0, 0.0, 0.0),
        (THIRD, verdict(), 0.0, 0.0, 1.0),
        (THIRD, None, 1.0, 0.0, 1.0),
    ],
)
def test_what_has_no_name(what, said, wrong, right_place, silent):
    found = figures([trial("outside", [what], said)])
    reached = [found[each].reached for each in (OUTSIDE_WRONG, OUTSIDE_PLACE, OUTSIDE_SILENT)]
    assert reached == [wrong, right_place, silent]


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    ("said", "listed", "nothing_extra"),
    [
        (verdict(named(LOST), named(WAVE)), 1.0, 1.0),
        (verdict(named(DISK, WAVE), named(LOST)), 1.0, 1.0),
        (verdict(named(WAVE)), 0.0, 1.0),
        (verdict(named(WAVE, LOST)), 0.0, 1.0),  # one finding cannot stand for two
        (verdict(named(WAVE, LOST), named(WAVE)), 1.0, 1.0),
        (verdict(named(WAVE), named(LOST), named(DISK)), 1.0, 0.0),
        (verdict(named(WAVE), named(DISK)), 0.0, 0.0),
        (verdict(), 0.0, 1.0),
        (None, 0.0, 0.0),
    ],
)
def test_two_effects(said, listed, nothing_extra):
    found = figures([trial("pair", [WAVE, LOST], said)])
    assert found[ALL_LISTED].reached == listed
    assert found[NOTHING_EXTRA].reached == nothing_extra
    assert found["several effects: all named or in the alternatives | pair"].reached == listed
    assert found["several effects: nothing extra | pair"].reached == nothing_extra


def test_two_effects_of_which_one_is_below_its_limit():
    small, large = hidden(LOST, moved_mm=0.1 * FLOOR_MM), hidden(WAVE)
    for said, above in ((verdict(named(WAVE)), 1.0), (verdict(named(LOST)), 0.0), (None, 0.0)):
        found = figures([trial("pair", [small, large], said)])
        assert found[ALL_LISTED].reached == 0.0
        assert found[ABOVE_LISTED].reached == above
    hopeless = verdict(not_testable=frozenset({GAIN}))
    for what, said, of in (
        ([small, small], verdict(), 0),
        ([small, GAIN], hopeless, 0),
        ([small, GAIN], verdict(), 1),
    ):
        found = figures([trial("pair", what, said)])[ABOVE_LISTED]
        assert (found.trials, found.count) == (of, 0)


def test_held_out_errors_are_held_against_those_of_the_same_layout():
    def null(layout, held_out_mm):
        return trial("null", [], verdict(after_mm=held_out_mm), layout=layout)

    trials = [
        null("grid", 0.01),
        null("grid", 0.03),
        null("wide", 0.1),
        single(WAVE, verdict(named(WAVE), after_mm=0.03), layout="grid"),
        single(WAVE, verdict(named(WAVE), after_mm=0.05), layout="wide"),
        single(WAVE, verdict(after_mm=9.0)),
    ]
    found = figures(trials)[GAP]
    assert found.trials == 2
    assert found.reached == pytest.approx((0.03 / 0.02 + 0.05 / 0.1) / 2.0)
    assert figures(trials[:3])[GAP].reached is None
    assert figures(trials[3:])[GAP].reached is None


def test_intervals_hold_parameters_whatever_the_sign_of_an_amplitude():
    wave = hidden(WAVE, A=-2.0e-4, phi=1.0)
    assert true_parameters(wave) == {"A": 2.0e-4, "phi": 1.0 + np.pi}
    good = named(WAVE, A=(2.0e-4, 1e-6), phi=(1.0 - np.pi + 0.01, 0.01))
    bad = named(WAVE, A=(2.1e-4, 1e-6), phi=(1.0, 0.01))
    trials = [single(wave, verdict(good)), single(wave, verdict(bad))]
    found = figures(trials)
    assert (found[INSIDE].count, found[INSIDE].trials) == (2, 4)
    by_parameter = [row for row in found.values() if "parameter of" in row.what]
    assert [row.by for row in by_parameter] == ["transmission_error A", "transmission_error phi"]
    assert by_parameter[0].reached == 0.5
    scores = sorted(each.score for each in scored(trials).parameter_scores)
    assert scores[:2] == pytest.approx([-314.159, 0.0], 1e-3)


def test_intervals_take_vectors_apart_and_leave_maps_and_wrong_places_out():
    drift = Name("base_drift", "base")
    true = hidden(drift, rate=[1e-5, 2e-5, 3e-5])
    estimates = {f"rate_{axis}": (k * 1e-5, 1e-7) for k, axis in enumerate("xyz", start=1)}
    found = figures([single(true, verdict(named(drift, **estimates)))])[INSIDE]
    assert (found.count, found.trials) == (3, 3)
    map_ = hidden(MAP, knots=[1e-4] * 3)
    elsewhere = named(Name("backlash", "joint 4"), b=(1e-4, 1e-6))
    none = figures(
        [
            single(map_, verdict(named(MAP, knots_x=(0.0, 1.0)))),
            single(hidden(LOST, b=1e-4), verdict(elsewhere)),
        ]
    )
    assert none[INSIDE].trials == 0
    assert none["parameters of named effects: score, root mean square"].reached is None


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (verdict(named(LOST), named(WAVE)), "transmission_error"),
        (verdict(named(LOST, WAVE)), LISTED),
        (verdict(named(LOST), named(Name("transmission_error", "joint 5"))), ELSEWHERE),
        (verdict(named(LOST)), "backlash"),
        (verdict(word="unexplained", places=("joint 2",)), RIGHT_PLACE),
        (verdict(word="unexplained", places=(None,)), NO_PLACE),
        (verdict(word="unexplained", places=(None, "base")), WRONG_PLACE),
        (verdict(), NOTHING),
        (verdict(not_testable=frozenset({WAVE})), NOT_TESTABLE),
        (None, FAILED),
    ],
)
def test_outcomes(said, expected):
    one = single(WAVE, said)
    assert outcome(one, one.hidden[0]) == expected
    (subject,) = scored([one, one]).subjects
    assert (subject.kind, subject.id) == ("single", "transmission_error")
    assert subject.counts == {expected: 2}


def test_what_is_called_another_hidden_effect_is_no_wrong_name():
    both = (WAVE, LOST)
    for said, expected in (
        (verdict(named(LOST)), NOTHING),
        (verdict(named(DISK, LOST)), NOTHING),
        (verdict(named(LOST), named(GAIN)), "torque_gain"),
        (verdict(named(LOST), not_testable=frozenset({WAVE})), NOT_TESTABLE),
        (verdict(named(LOST), word="unexplained", places=("joint 2",)), RIGHT_PLACE),
    ):
        case = trial("pair", both, said)
        assert outcome(case, case.hidden[0]) == expected


def test_a_map_at_the_joint_of_what_has_no_name_is_the_right_place():
    one = trial("outside", [THIRD], verdict(named(MAP)))
    assert outcome(one, one.hidden[0]) == RIGHT_PLACE


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (verdict(named(LOST, Name("gear_ratio_error", THIRD.of))), True),
        (verdict(word="unexplained", places=(THIRD.of,)), True),
        (verdict(named(Name("backlash", "joint 1"))), False),
        (verdict(), False),
        (None, False),
    ],
)
def test_a_place_is_told_by_whatever_name(said, told):
    one = trial("outside", [THIRD], said)
    assert is_place_found(one, THIRD) == told


def test_power_is_studied_by_size_and_by_what_moves():
    sizes = np.geomspace(0.1, 3.0, 30)
    trials = [
        single(
            hidden(WAVE, size, moved_mm=size * FLOOR_MM),
            verdict(named(WAVE)) if size > 0.5 else verdict(),
        )
        for size in sizes
    ]
    found = scored([*trials, single(LOST, verdict(named(LOST))), single(LOST, None)]).power
    assert found.by_id["backlash"] is None
    assert found.by_id["transmission_error"].half == pytest.approx(0.5, rel=0.1)
    assert found.by_moved.half == pytest.approx(0.5 / 1.085, rel=0.2)
    assert sum(entry.listed.trials for entry in found.bins) == 31
    assert found.bins[0].listed.trials + found.bins[1].listed.trials < 10


def _without_formulas(trials):
    return [bar for bar in scored(trials).bars if "formula" not in bar.what]


def test_bars_are_met_and_missed():
    good = [
        *[trial("null", [], verdict())] * 200,
        *[single(WAVE, verdict(named(WAVE)))] * 20,
        *[trial("outside", [THIRD], verdict(named(MAP)))] * 20,
        *[trial("triple", [WAVE, LOST, GAIN], verdict(*map(named, (GAIN, LOST, WAVE))))] * 20,
    ]
    assert all(bar.met for bar in _without_formulas(good))
    slow, slower = (
        verdict(named(ELLIPSE), after_mm=after_mm, seconds=100.0, not_testable={WAVE})
        for after_mm in (0.1, 0.01)
    )
    bad = [
        *[trial("null", [], slower)] * 5,
        *[single(DISK, slow)] * 20,
        *[trial("outside", [THIRD], slow)] * 20,
        *[trial("pair", [WAVE, LOST], slow)] * 20,
    ]
    assert not any(bar.met for bar in _without_formulas(bad))
    assert all(bar.met is None for bar in scored([]).bars)


def test_so_few_trials_that_one_alone_decides_judge_nothing():
    few = scored([trial("null", [], verdict())] * 4).bars[0]
    enough = scored([trial("null", [], verdict())] * 50).bars[0]
    wrong = scored([trial("null", [], verdict(named(WAVE)))] * 4).bars[0]
    assert few.met
    assert few.trials_needed == 50
    assert few.verdict == "too few to judge (50 needed)"
    assert enough.verdict == "yes"
    assert wrong.verdict == "no"  # four of four are wrong, where 2 % may be
    assert scored([]).bars[0].verdict == "no trial"
    listed = next(bar for bar in scored([]).bars if bar.at_least and bar.limit == 0.9)
    assert listed.trials_needed == 10


def test_a_compliance_where_the_model_has_a_spring_is_in_the_model_already():
    at_spring, at_rigid = Name("joint_compliance", "joint 5"), Name("joint_compliance", "joint 4")
    assert not single(at_spring, verdict()).is_testable(hidden(at_spring))
    assert single(at_rigid, verdict()).is_testable(hidden(at_rigid))
    assert single(WAVE, verdict()).is_testable(hidden(WAVE))


def test_trials_of_trackers_have_bars_of_their_own_and_the_others_alike():
    right = single(WAVE, verdict(named(WAVE)), measured="tracked")
    wrong = single(WAVE, verdict(named(LOST)), measured="tracked")
    unknown = single(WAVE, verdict(not_testable=frozenset({WAVE})), measured="tracked")
    ours = scored([right, right, right, wrong, unknown]).bars
    theirs = scored([single(WAVE, verdict(named(WAVE)))]).bars
    assert len(ours) == len(theirs) + 2
    assert [bar.what for bar in ours if bar.what not in {bar.what for bar in theirs}] == [
        "one effect of plausible size, testable: among the effect or its alternatives",
        "one effect: a confident wrong name",
    ]
    listed, confident = ours[1:3]
    assert (listed.reached, listed.trials, listed.met) == (0.75, 4, False)
    assert (confident.reached, confident.trials, confident.met) == (0.2, 5, False)


def claims(what, said, kind="single"):
    """What a trial's findings claim, by what they claim it of."""
    found = {}
    for claim in trial_names.claims(trial(kind, what, verdict(said))):
        found.setdefault(claim.of, []).append((claim.probability, claim.right))
    return found


@pytest.mark.parametrize(("cycles", "right"), [(3.0, True), (3.02, True), (7.0, False)])
@pytest.mark.parametrize("line", ["periodic_error", "gear_line"])
def test_a_line_is_right_if_it_has_the_hidden_cycles(line, cycles, right):
    said = verdict(named(Name(line, "joint 2"), k=(cycles, 0.1)))
    case = trial("outside", (THIRD,), said)
    assert [each.right for each in trial_names.claims(case) if each.of == "name"] == [right]


def test_probabilities_are_held_against_what_is_hidden():
    said = claims((DISK,), named(WAVE, DISK, ELLIPSE))
    assert [right for _, right in said["name"]] == [False]
    assert [right for _, right in said["alternative"]] == [True, False]
    assert said["none of these"] == [(pytest.approx(0.01), False)]
    assert said["set"] == [(0.95, True)]


def test_nothing_that_was_named_is_none_of_these_and_no_member_of_the_set_unless_likely():
    said = claims((LOST,), named(WAVE, DISK))
    assert said["none of these"] == [(pytest.approx(0.01), True)]
    assert said["set"] == [(0.95, False)]
    likely = named(WAVE).model_copy(update={"none_of_these": 0.3, "probability": 0.7})
    assert claims((LOST,), likely)["set"] == [(0.95, True)]


def test_a_set_counts_as_it_is_said_whoever_is_named_and_listed():
    unlikely = named(WAVE).model_copy(update={"set95": (named(DISK),)})
    assert claims((WAVE,), unlikely)["set"] == [(0.95, False)]
    assert claims((DISK,), unlikely)["set"] == [(0.95, True)]


def test_a_map_comes_true_where_an_error_by_angle_has_no_name():
    assert claims((THIRD,), named(MAP), "outside")["name"][0][1]
    assert not claims((DISK,), named(MAP))["name"][0][1]
    assert not claims((DISK,), named(WAVE, MAP))["alternative"][0][1]


@pytest.mark.parametrize(
    ("trials", "message"),
    [
        ([single(WAVE, verdict(), measured="laser")], "not those of one study"),
        (
            [single(WAVE, verdict()), trial("right", [], verdict(), measured=WILD)],
            "not those of one study",
        ),
        ([trial("nonsense", [], verdict(), measured=WILD)], "not those of one study"),
        ([trial("single", [], verdict())], "a trial of kind single hides nothing"),
        ([single(hidden(WAVE, size=0.0), verdict())], "size of a hidden effect is not above 0"),
        ([single(WAVE, verdict(noise_floor_mm=0.0))], "the noise of a trial is 0"),
    ],
)
def test_trials_that_cannot_be_scored_are_refused(trials, message):
    with pytest.raises(RecordError, match=message):
        scored(trials)


def test_trials_without_a_null_of_their_layout_are_told():
    lacks = "held-out ratio after naming: not known, as no trial of the layout hides nothing"
    one, other = (single(WAVE, verdict(named(WAVE)), layout=layout) for layout in ("grid", "wide"))
    found = figures([one, other, trial("null", [], verdict(), layout="grid")])
    assert (found[GAP].trials, found[lacks].count, found[lacks].trials) == (1, 1, 2)


def test_only_numbers_are_parameters():
    truth = hidden(WAVE, A=1, word="xyz", axis=[0.0, 1.0, 0.0], cubic=True, text=["a", "b", "c"])
    assert true_parameters(truth) == {"A": 1.0, "axis_x": 0.0, "axis_y": 1.0, "axis_z": 0.0}
