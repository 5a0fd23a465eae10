"""How probable a name is, among all that was tried in its place."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pa10cal.discovery import probabilities
from pa10cal.discovery.finding import Explanations, Finding, Rival, line_of
from pa10cal.discovery.gap import PairedErrors
from pa10cal.discovery.proof import UnknownCause
from pa10cal.discovery.refitted_verdict import fitted_instead
from pa10cal.discovery.rules import PROBABILITIES
from pa10cal.results.record import EffectName
from pa10cal.terms.effects.arrivals import AlongMove
from pa10cal.terms.effects.generic import DirectionMap
from pa10cal.terms.effects.joint import (
    Backlash,
    EncoderEccentricity,
    EncoderEllipticity,
    GearRatioError,
)
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.over_time import BaseDrift
from pa10cal.terms.effects.structure import BaseCompliance

SURE = 1.0 - PROBABILITIES.unknown
BACKLASH, GEAR = Backlash("joint 1"), GearRatioError("joint 1")
ELSEWHERE = Backlash("joint 2")
KNOWN = dict(zip(("odds", "power", "fall"), PROBABILITIES.known_effect, strict=True))
NAMELESS = DirectionMap("joint 1", 10.0, 1.0)


def finding(*rivals, alternatives=()):
    """A finding of lost motion, with what was tried in its place."""
    return Finding(BACKLASH, np.array([1e-4]), np.eye(1), alternatives, object(), rivals)


def blocks(*nats):
    """Scores of ten blocks of poses that repeat some numbers."""
    return np.resize(np.array(nats, dtype=float), 10)


def test_nothing_else_tried_leaves_what_is_unknown():
    said = finding().explanations
    assert said.probability(BACKLASH) == pytest.approx(SURE)
    assert said.none_of_these == pytest.approx(PROBABILITIES.unknown)
    assert said.smallest_set == (BACKLASH,)


def test_by_repeats_odds_are_those_of_the_evidence():
    said = finding(Rival(GEAR, np.array([-np.log(4.0)]))).explanations
    assert said.probability(BACKLASH) == pytest.approx(0.8 * SURE)
    assert said.probability(GEAR) == pytest.approx(0.2 * SURE)
    assert said.smallest_set == (BACKLASH, GEAR)


def test_what_is_as_good_and_has_no_score_is_as_likely():
    said = finding(alternatives=(GEAR,)).explanations
    assert said.probability(GEAR) == pytest.approx(said.probability(BACKLASH))


def test_an_alternative_takes_the_place_of_an_effect_where_nothing_has_a_score():
    other = finding(alternatives=(GEAR,)).exchanged_for(GEAR).explanations
    assert other.probability(BACKLASH) == pytest.approx(other.probability(GEAR))


def test_a_finding_in_whose_place_another_fits_better_is_the_less_likely():
    said = finding(Rival(GEAR, np.array([np.log(9.0)]))).explanations
    assert said.named[0] == (GEAR, pytest.approx(0.9 * SURE))


def test_blocks_that_contradict_each_other_leave_both_likely():
    # The sums are the same: one rival loses in every block, the other much in one and none else.
    said = finding(
        Rival(GEAR, blocks(-1.2)), Rival(ELSEWHERE, blocks(-12.0, *[0.0] * 9))
    ).explanations
    assert said.probability(GEAR) < 1e-3
    assert said.probability(ELSEWHERE) > 0.03


def test_what_has_no_name_makes_none_of_these_likely():
    weight = PROBABILITIES.flexible
    said = finding(Rival(NAMELESS, np.zeros(1), weight)).explanations
    assert said.probability(NAMELESS) == 0.0
    assert said.none_of_these == pytest.approx(PROBABILITIES.unknown + SURE * weight / (1 + weight))


@given(st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=6), st.sampled_from([1, 10]))
def test_probabilities_sum_to_one_and_fall(nats, count):
    others = [Backlash(f"joint {k + 2}") for k in range(len(nats))]
    rivals = [Rival(e, np.full(count, n / count)) for e, n in zip(others, nats, strict=True)]
    said = finding(*rivals).explanations
    shares = [share for _, share in said.named]
    assert sum(shares) + said.none_of_these == pytest.approx(1.0)
    assert shares == sorted(shares, reverse=True)
    assert 0.0 <= said.none_of_these <= 1.0


@pytest.mark.parametrize(
    ("shares", "none", "members"),
    [
        ((0.96,), 0.04, 1),
        ((0.94,), 0.06, 1),
        ((0.5, 0.3, 0.16), 0.04, 3),
        ((0.9, 0.04, 0.03), 0.03, 3),
        ((0.9, 0.03, 0.02), 0.05, 1),
        ((0.3,), 0.7, 1),
    ],
)
def test_the_smallest_set_holds_what_is_there(shares, none, members):
    effects = [Backlash(f"joint {k + 1}") for k in range(len(shares))]
    said = Explanations(tuple(zip(effects, shares, strict=True)), none)
    assert said.smallest_set == tuple(effects[:members])


def test_listed_is_what_is_likely_enough():
    near, far = Rival(GEAR, np.array([-2.0])), Rival(ELSEWHERE, np.array([-12.0]))
    listed = finding(near, far, alternatives=(ELSEWHERE,)).with_likely_alternatives()
    assert listed.alternatives == (GEAR,)
    record = listed.explanations
    assert record.named[0][0] == BACKLASH


def test_a_name_is_less_likely_with_every_rival_that_is_as_good():
    alone, both = (
        finding(Rival(GEAR, np.zeros(1))),
        finding(Rival(GEAR, np.zeros(1)), Rival(ELSEWHERE, np.zeros(1))),
    )
    assert alone.explanations.probability(BACKLASH) == pytest.approx(SURE / 2)
    assert both.explanations.probability(BACKLASH) == pytest.approx(SURE / 3)


def test_another_form_of_the_effect_is_no_other_name():
    other = BaseDrift("base", 0.0, 100.0, 3)
    found = Finding(BaseDrift("base", 0.0, 100.0, 1), np.zeros(6), np.eye(6), (other,), object())
    for rivals in ((), (Rival(other, np.array([3.0])),)):
        said = replace(found, rivals=rivals)
        assert said.explanations.probability(found.effect) == pytest.approx(SURE)
        assert said.with_likely_alternatives().alternatives == ()


@given(st.floats(0.01, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.001, 0.1))
def test_the_more_is_left_of_an_error_the_likelier_something_else_makes_it(
    without_mm, part, less, noise_mm
):
    with_mm = part * without_mm
    left = [
        UnknownCause(without_mm, each, odds=12.0, power=0.3) for each in (less * with_mm, with_mm)
    ]
    little, much = (each.probability(noise_mm) for each in left)
    assert PROBABILITIES.unknown <= little <= much <= 1.0


@given(st.floats(1.0, 5.0), st.floats(1.0, 5.0))
def test_the_more_is_left_over_noise_the_less_likely_is_any_name(one, more):
    def beside(left_mm):  # what it takes over what it leaves is the same
        return UnknownCause(np.sqrt(2.0) * left_mm, left_mm, **KNOWN)

    little, much = (beside(left_mm).probability(0.01) for left_mm in (0.03, 0.03 * one))
    rounding = 1e-14
    assert little <= much + rounding
    assert much <= beside(0.03 * one * more).probability(0.01) + rounding
    most = beside(100.0).probability(0.01)
    assert most == pytest.approx(beside(1e4).probability(0.01))
    assert most < 1.0


def test_odds_are_those_stated_where_as_much_is_taken_as_is_left():
    taken = UnknownCause(np.sqrt(2.0), 1.0, odds=3.0, power=0.3)
    assert taken.probability(0.0) == pytest.approx(0.25)
    assert UnknownCause(1.0, 0.0, odds=12.0, power=0.3).probability(0.0) == PROBABILITIES.unknown


def test_what_removes_nothing_has_no_odds_even_if_nothing_is_left():
    assert UnknownCause(0.0, 0.0, odds=12.0, power=0.3).probability(0.0) == 1.0


def doubt(components, left):
    """Return the probability of another cause where `left` times the noise is left of poses.

    Each pose has so many components of position: one of a distance, three of a target.
    """
    lengths_mm = np.linalg.norm(np.random.default_rng(3).normal(size=(20000, components)), axis=1)
    rms_mm = float(np.sqrt(np.mean(lengths_mm**2)))
    measured = SimpleNamespace(
        components_seen=np.ones((1, components), bool),
        position_columns=np.arange(components),
        from_touches=False,
    )
    poses = SimpleNamespace(measured=measured)
    found = SimpleNamespace(
        train=PairedErrors(poses, None, None, float(lengths_mm.mean())),
        unexplained=(),
        prepared=SimpleNamespace(readings=poses),
        scorer=SimpleNamespace(extended=SimpleNamespace(effects=())),
    )
    cause = UnknownCause(5.0 * rms_mm, left * rms_mm, **KNOWN)
    known = replace(finding(), proof=SimpleNamespace(unknown_cause=cause, weights=None))
    return probabilities.with_unknown_cause(found, known).unknown_probability


@pytest.mark.parametrize("components", [1, 3, 9])
def test_noise_alone_leaves_nothing_for_another_cause(components):
    assert doubt(components, 1.0) == pytest.approx(PROBABILITIES.unknown)
    assert doubt(components, 1.1) == pytest.approx(doubt(2, 1.1), rel=0.05)


@given(
    st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=4),
    st.floats(-5.0, 5.0),
    st.sampled_from([0.3, 1.0]),
    st.booleans(),
)
def test_another_name_in_its_place_makes_nothing_more_probable(nats, other, weight, unscored):
    rivals = Rival(GEAR, blocks(*nats), weight), Rival(NAMELESS, np.array([other]), 0.1)
    told = finding(*rivals, alternatives=(ELSEWHERE, GEAR) if unscored else (GEAR,))
    swapped = told.exchanged_for(GEAR)
    assert swapped.effect == GEAR
    assert GEAR not in swapped.alternatives
    before, after = told.explanations, swapped.explanations
    for effect in (BACKLASH, GEAR, ELSEWHERE):
        assert after.probability(effect) == pytest.approx(before.probability(effect), abs=1e-9)
    assert after.none_of_these == pytest.approx(before.none_of_these, abs=1e-9)


def test_a_score_that_is_none_is_refused():
    with pytest.raises(AssertionError, match="gear_ratio_error of joint 1"):
        Rival(GEAR, np.array([np.nan]))


def test_an_effect_in_anothers_place_names_it_beside_the_evidence(eccentric):
    told = finding(Rival(GEAR, np.ones(1)), alternatives=(GEAR,))
    swapped = told.exchanged_for(GEAR).with_proof_of(told)
    assert (told.proof_of, swapped.proof_of) == (None, BACKLASH)
    assert swapped.exchanged_for(BACKLASH).with_proof_of(swapped).proof_of is None
    found = eccentric.discovery
    (named,) = found.effects
    others = [rival.effect for rival in named.rivals if not rival.effect.generic]
    fitted = (fitted_instead(found, named, named.exchanged_for(other)) for other in others)
    (exchanged,) = next(each for each in fitted if each is not None).findings
    assert exchanged.effect in others
    assert exchanged.record().evidence_of == EffectName(id=named.id, of=named.of)
    assert "evidence_of" not in named.record().model_dump()


@pytest.mark.parametrize("nats", [(3.0, -2.0), (-2.0, 3.0)])
def test_of_several_forms_of_one_name_the_best_counts(nats):
    forms = BaseDrift("base", 0.0, 100.0, 1), BaseDrift("base", 0.0, 100.0, 3)
    rivals = [Rival(form, np.array([each])) for form, each in zip(forms, nats, strict=True)]
    said = finding(*rivals).explanations
    assert said.named[0] == (forms[int(np.argmax(nats))], pytest.approx(SURE / (1 + np.exp(-3.0))))


def test_another_form_of_the_effect_stays_no_rival_after_an_exchange():
    forms = BaseDrift("base", 0.0, 100.0, 1), BaseDrift("base", 0.0, 100.0, 3)
    rivals = Rival(forms[1], np.array([-3.0])), Rival(GEAR, np.zeros(1))
    told = Finding(forms[0], np.zeros(6), np.eye(6), (), object(), rivals)
    swapped = told.exchanged_for(GEAR).explanations
    for effect in (forms[0], GEAR):
        assert told.explanations.probability(effect) == pytest.approx(SURE / 2)
        assert swapped.probability(effect) == pytest.approx(SURE / 2)


def test_an_effect_that_is_larger_than_such_effects_are_is_in_doubt(monkeypatch, wave):
    (finding,) = wave.discovery.findings
    assert 0.3 < probabilities._plausible_sizes(wave.discovery, finding.effect) < 1.0
    for lifts, doubted in (((2, 1.0, 0.0), True), ((3, 1.0, 0.0), False), (None, True)):
        # A joint before the one that lifts is turned by no weight, by which another would look so.
        context = replace(wave.discovery.context, lifts=lifts)
        of_weights = replace(wave.discovery, context=context)
        assert (probabilities._plausible_sizes(of_weights, finding.effect) > 0.0) is doubted
    unknown = []
    for size in (0.5, 2.0, 4.0, 8.0):
        monkeypatch.setattr(probabilities, "_plausible_sizes", lambda *_, size=size: size)
        doubted = probabilities.with_unknown_cause(wave.discovery, finding)
        unknown.append(doubted.unknown_probability)
    assert unknown[0] == unknown[1] == pytest.approx(PROBABILITIES.unknown)
    odds = [each / (1.0 - each) for each in unknown]
    assert np.divide(odds, odds[0]) == pytest.approx([1.0, 1.0, 8.0, 64.0])


def test_of_touches_a_log_of_another_instant_may_be_a_machine_that_reads_by_the_side():
    measured = SimpleNamespace(from_touches=True)
    found = SimpleNamespace(
        unexplained=(),
        over_noise=False,
        prepared=SimpleNamespace(readings=SimpleNamespace(measured=measured)),
        scorer=SimpleNamespace(extended=SimpleNamespace(effects=())),
    )
    proof = SimpleNamespace(unknown_cause=None, weights=None)
    along = replace(finding(), effect=AlongMove("arm", (1, 2, 3)), proof=proof)
    backlash = replace(finding(), proof=proof)
    doubted = probabilities.with_unknown_cause(found, along).probability
    assert doubted == pytest.approx(1.0 - PROBABILITIES.machine_reverses)
    assert doubted < PROBABILITIES.surely
    assert probabilities.with_unknown_cause(found, backlash).probability == pytest.approx(SURE)
    measured.from_touches = False
    assert probabilities.with_unknown_cause(found, along).probability == pytest.approx(SURE)


@pytest.mark.parametrize(
    ("others", "least", "most"),
    [
        ((EncoderEllipticity("joint 1", 2.0),), 0.0, 0.02),  # one sensor
        ((GearRatioError("joint 2"),), 0.0, 0.02),
        ((GEAR,), 0.5, 0.5),
        ((GEAR, EncoderEllipticity("joint 1", 2.0)), 0.5, 0.5),
        ((GEAR, JointErrorMap("joint 1")), 0.9, 1.0),
    ],
)
def test_errors_of_several_parts_of_one_joint_may_be_one_curve(others, least, most):
    proof = SimpleNamespace(unknown_cause=None, weights=None)
    effects = (EncoderEccentricity("joint 1", 1.0), *others)
    findings = tuple(replace(finding(), effect=each, proof=proof) for each in effects)
    found = SimpleNamespace(
        findings=findings,
        unexplained=(),
        over_noise=False,
        prepared=SimpleNamespace(
            readings=SimpleNamespace(measured=SimpleNamespace(from_touches=False))
        ),
        scorer=SimpleNamespace(extended=SimpleNamespace(effects=())),
    )
    told = probabilities.with_unknown_cause(found, findings[0]).explanations
    assert least - 1e-9 <= told.none_of_these <= most + 1e-9


@pytest.mark.parametrize(
    ("effect", "left", "unknown"),
    [
        (BaseCompliance("base"), ("lateral_compliance", True), PROBABILITIES.unknown_beside),
        (BaseCompliance("base"), ("joint_compliance", True), PROBABILITIES.unknown_beside),
        (BaseCompliance("base"), ("joint_compliance", False), PROBABILITIES.unknown),
        (BaseCompliance("base"), ("backlash", True), PROBABILITIES.unknown),
        (BaseCompliance("base"), (None, False), PROBABILITIES.unknown),
        (GEAR, ("lateral_compliance", True), PROBABILITIES.unknown),
    ],
)
def test_what_gives_way_beside_something_that_would_stiffen_is_less_sure(effect, left, unknown):
    """As a bearing with play, which the next joint would have to take back."""
    by_errors = SimpleNamespace(probability=lambda noise_mm: PROBABILITIES.unknown)
    proof = SimpleNamespace(unknown_cause=by_errors, weights=None)
    form, below_zero = left
    found = SimpleNamespace(
        findings=(),
        unexplained=(SimpleNamespace(form=form, below_zero=below_zero),),
        train=SimpleNamespace(noise_rms_mm=0.03),
        prepared=SimpleNamespace(
            readings=SimpleNamespace(measured=SimpleNamespace(from_touches=False))
        ),
        scorer=SimpleNamespace(extended=SimpleNamespace(effects=())),
    )
    told = probabilities.with_unknown_cause(found, replace(finding(), effect=effect, proof=proof))
    assert told.unknown_probability == pytest.approx(unknown)


def test_a_line_says_what_else_may_be_there():
    surely = line_of(finding(Rival(GEAR, np.array([-12.0]))))
    assert surely.startswith("backlash of joint 1: ")
    assert "probability" not in surely
    unsure = finding(Rival(GEAR, np.array([2.0])))
    share = unsure.explanations.probability(GEAR)
    other = f"; else gear_ratio_error of joint 1 ({share:.2f})"
    assert f", probability {unsure.probability:.2f}{other}" in line_of(unsure)
    nameless = replace(finding(), unknown_probability=0.3)
    assert line_of(nameless).endswith("probability 0.70; else none of these (0.30)")
