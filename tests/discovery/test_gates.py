"""Gates of the verdict: what a name and what `none` must fulfil, under either scorer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from made_up_arm import Missing, at_joint, measure
from made_up_model import fitted_to
from made_up_poses import context_of
from pa10cal.discovery import against_none, gates, refitted_verdict
from pa10cal.discovery.against_none import reasons_against_none
from pa10cal.discovery.credible_amounts import holds_zero
from pa10cal.discovery.evidence.by_repeats import ByRepeats
from pa10cal.discovery.finding import Finding
from pa10cal.discovery.gates import gated, with_cable_torques
from pa10cal.discovery.lack_of_fit import pure_error_test
from pa10cal.discovery.other_explanations import with_doubt, with_other_readings
from pa10cal.discovery.refitted_verdict import unfit, with_findings, without_names
from pa10cal.discovery.rules import NAMES
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.arrivals import AlongMove
from pa10cal.terms.effects.joint import Backlash, GearRatioError
from pa10cal.terms.effects.over_time import BaseDrift
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal.terms.statement_faults import GravityStated


def names(verdict):
    return [(finding.id, finding.of) for finding in verdict.effects]


def why(verdict):
    return "; ".join(place.why for place in verdict.unexplained)


@pytest.fixture(scope="module")
def pushing():
    """A joint whose friction would push it along."""
    return measure(Missing(log=lambda states: at_joint(3, -3.0 * states.arrival[:, 2])))


@pytest.fixture(scope="module")
def stiffening():
    """A joint that turns against its torque: a negative stiffness."""
    return measure(Missing(turn=lambda states: at_joint(4, states.tau_Nm[:, 3] / 3000.0)))


@pytest.mark.slow
@pytest.mark.parametrize("campaign", ["null", "wave", "rubbing", "nothing_hidden", "eccentric"])
def test_what_is_physical_and_agrees_passes_as_it_is(request, campaign):
    found = request.getfixturevalue(campaign).discovery
    assert gated(found) is found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("campaign", "of", "parameter"),
    [("pushing", "joint 3", "tau_c"), ("stiffening", "forearm", "c")],
)
def test_a_sign_that_is_not_physical_is_no_name(request, campaign, of, parameter):
    found = request.getfixturevalue(campaign).discovery
    assert found.effects != ()
    after = gated(found)
    assert after.verdict == "unexplained"
    assert after.effects == ()
    assert [place.of for place in after.unexplained] == [of]
    assert f"its {parameter} would be negative, which is not physical" in why(after)
    assert [place.below_zero for place in after.unexplained] == [True]
    # The model is what it was before the search, and so is the gap.
    assert len(after.model.model.terms) == len(found.baseline.model.terms)
    assert after.train.after.mean_mm == pytest.approx(after.train.before.mean_mm, rel=0.1)
    assert gated(after) is after


def made(found, factor=1.0, uncertainty=1.0):
    """Return the first finding, and the model with other values or uncertainties of its effect."""
    finding, model = found.effects[0], found.model
    x, columns = model.x.copy(), model.model.columns_of(finding.effect)
    x[columns] *= factor
    return finding, replace(model, x=x, covariance=uncertainty**2 * model.covariance)


def erring(gap, mean_mm):
    """Return a gap with another mean error after, and the same deviations pose by pose."""
    other = replace(gap)
    other.__dict__["after"] = gap.after.model_copy(update={"mean_mm": mean_mm})
    return other


def judged_statement(monkeypatch, *, x=0.1, probability=0.9, left_mm=0.02, torques="masses"):
    """Return why a direction of gravity with a standard error of 0.02 is not told as wrong.

    Without it the error is 0.03 mm, of which 0.01 mm are noise.
    """
    stated = GravityStated("base", True, 6, (0.0, 0.0, -9.81))
    finding = SimpleNamespace(effect=stated, x=np.array([x, 0.0]), covariance=4e-4 * np.eye(2))

    def leaving(rms_mm):
        errors = SimpleNamespace(after=SimpleNamespace(rms_mm=rms_mm), noise_rms_mm=0.01)
        prepared = SimpleNamespace(torques=torques)
        return SimpleNamespace(findings=(finding,), prepared=prepared, train=errors)

    monkeypatch.setattr(gates, "with_findings", lambda *_: leaving(0.03))
    likely = SimpleNamespace(probability=probability)
    monkeypatch.setattr(gates, "with_unknown_cause", lambda *_: likely)
    return "; ".join(gates._reasons_against_statement(leaving(left_mm), finding))


def test_a_statement_that_is_surely_wrong_is_told(monkeypatch):
    assert judged_statement(monkeypatch) == ""
    # Logged torques show it, and poses do not.
    assert judged_statement(monkeypatch, left_mm=0.03, torques="logged") == ""


@pytest.mark.parametrize(
    ("statement", "why_not"),
    [
        ({"x": 0.05}, "2.5 standard errors from what is stated"),
        ({"probability": 0.4}, "other causes are likelier (probability 0.60 together)"),
        ({"left_mm": 0.025}, "explains less (0.03 mm without it, 0.025 mm with it)"),
    ],
    ids=["small", "unlikely", "much_left"],
)
def test_a_statement_that_may_be_right_is_not_accused(monkeypatch, statement, why_not):
    assert why_not in judged_statement(monkeypatch, **statement)


def test_a_size_that_is_not_plausible_is_no_name(wave):
    finding, model = made(wave.discovery)
    x = model.values_of(finding.effect)
    sizes = np.abs(np.linalg.solve(finding.effect.prior_factor, x)).max()
    for times, passes in ((0.99, True), (1.01, False)):
        factor = times * NAMES.most_sizes / sizes
        reasons = [*unfit(*made(wave.discovery, factor))]
        assert (reasons == []) == passes
    assert "10 times as large as is plausible" in reasons[0]


def test_a_size_that_may_be_plausible_is_a_name(wave):
    """Amounts are estimates: one at the edge is refused where its whole interval is beyond it."""
    finding, model = made(wave.discovery)
    x, at = model.values_of(finding.effect), model.model.columns_of(finding.effect)
    amounts = np.linalg.solve(finding.effect.prior_factor, x)
    factor = 1.1 * NAMES.most_sizes / np.abs(amounts).max()
    std = np.sqrt(np.diag(model.covariance[at, at]))
    tenth = 0.1 * factor * float((np.abs(x) / std).max())  # a standard uncertainty of a tenth
    assert [*unfit(*made(wave.discovery, factor, tenth))] == []
    assert [*unfit(*made(wave.discovery, factor, 0.1 * tenth))]


@pytest.mark.parametrize(
    ("rate_z_m_h", "short", "size", "refused"),
    [
        (-5e-4, False, 1.0, False),
        (-4e-3, False, 1.0, True),
        (-4e-3, True, 1.0, False),
        (-4e-3, False, 5.0, False),
    ],  # a tripod, no mount, a short time, a crane
)
def test_a_mount_limits_the_rate_of_a_drift_and_not_its_plausible_size(
    rate_z_m_h, short, size, refused
):
    drift = BaseDrift.over(np.array([0.0, 360.0 if short else 36000.0]), 10.0)
    x, covariance = np.array([1e-5, 2e-4, rate_z_m_h]), 1e-6**2 * np.eye(3)
    finding = SimpleNamespace(effect=drift, alternatives=())
    model = SimpleNamespace(
        values_of=lambda _: x,
        covariance=covariance,
        arm=replace(arm := load_arm("pa10_6ce"), a_m=size * arm.a_m, d_m=size * arm.d_m),
        model=SimpleNamespace(columns_of=lambda _: slice(0, 3), u_scale=0.0),
    )
    reasons = [*unfit(finding, model)]
    assert bool(reasons) == refused
    assert not refused or reasons[0].startswith("its rate_z would be -0.004 ± 2e-06 m/h: no mount")


def test_an_amount_within_its_uncertainty_is_no_name(wave):
    finding, model = made(wave.discovery)
    at = model.model.columns_of(finding.effect)
    x, covariance = model.x[at], model.covariance[at, at]
    sigmas = np.sqrt(x @ np.linalg.solve(covariance, x))
    # Both of its parameters are within 2.45 standard uncertainties with a probability of 95 %.
    assert [*unfit(*made(wave.discovery, uncertainty=sigmas / 2.46))] == []
    (reason,) = unfit(*made(wave.discovery, uncertainty=sigmas / 2.44))
    assert reason == "it is 2.4 standard uncertainties from zero"


def test_what_is_off_zero_in_a_combination_alone_is_no_name():
    """Scales of three axes alone are known by their differences."""
    context = context_of(load_arm("pa10_6ce"), three_axes=True)
    drift, scale = (
        next(each for each in candidates(context) if each.id == name)
        for name in ("base_drift", "cmm_scale")
    )
    amounts = SimpleNamespace(
        values_of=lambda _: 1e-5 * np.array([-2.0, -3.0, 5.0]),
        model=SimpleNamespace(columns_of=lambda _: slice(0, 3)),
        covariance=1e-5**2 * np.eye(3) + 1e-4**2 * np.ones((3, 3)),
    )
    assert [*holds_zero(drift, amounts)] == [
        "the intervals of its rate_x, rate_y, rate_z hold zero"
    ]
    assert [*holds_zero(scale, amounts)] == []
    amounts.covariance = 1e-5**2 * np.eye(3)
    assert [*holds_zero(drift, amounts)] == []
    amounts.covariance = 3e-5**2 * np.eye(3)
    assert [*holds_zero(scale, amounts)] == ["it is 2.1 standard uncertainties from zero"]


@pytest.mark.slow
def test_between_robot_and_instrument_it_is_the_robot():
    """Both are there: what stands for the other is the robot's, and the other is listed."""

    def skew(p_instr_m):
        return 2e-4 * p_instr_m[..., 1:2] * np.array([1.0, 0.0, 0.0])

    def turn(states):
        return at_joint(2, 2e-4 * np.sin(100.0 * states.q_rad[:, 1]))

    made = measure(Missing(turn=turn, read=skew))
    found, wave = made.discovery, made.effect("transmission_error", "joint 2")
    (skewed,) = (each for each in found.findings if each.id == "cmm_squareness")
    either = replace(skewed, alternatives=(wave,))
    one = with_findings(replace(found, findings=(either,)), [either])
    assert names(one) == [("cmm_squareness", "instrument")]
    assert [each.effect for each in gated(one).effects] == [wave]
    assert [each.id for each in gated(one).effects[0].alternatives] == ["cmm_squareness"]


def beside(made, *others):
    """Return the verdict of a campaign with further names before its own, the model fitted anew."""
    found = made.discovery
    (own,) = found.effects
    effects = tuple(made.effect(*other) for other in others)
    known = replace(found, findings=(replace(own, alternatives=effects),))
    more = [replace(own, effect=effect, alternatives=()) for effect in effects]
    return with_findings(known, (*more, own))


def test_every_name_that_is_not_significant_goes(wave):
    """Each withdrawal fits the model anew, so that the findings after it are others."""
    three = beside(wave, ("gear_ratio_error", "joint 4"), ("gear_ratio_error", "joint 5"))
    assert len(three.effects) == 3
    after = gated(three)
    assert names(after) == names(wave.discovery)
    assert after.unexplained == ()


def test_a_name_that_no_longer_passes_goes(monkeypatch, wave):
    """What passes beside another name may fail without it."""
    two = beside(wave, ("gear_ratio_error", "joint 4"))
    first, own = two.effects

    def fails(finding, model, _states=None):
        if finding.effect == first.effect:
            return iter(["it is made up"])
        return iter([] if first.effect in model.model.terms else ["it is alone"])

    monkeypatch.setattr(gates, "unfit", fails)
    after = gated(replace(two, findings=(own, first)))
    assert after.effects == ()
    assert "it is made up" in why(after)
    assert "it is alone" in why(after)


def test_an_effect_of_the_instrument_is_no_better_than_another(wave):
    """Only the robot's stands in for one that passes."""
    own, square, scales = (
        wave.discovery.effects[0],
        wave.effect("cmm_squareness", "instrument"),
        wave.effect("scale", "instrument"),
    )
    either = replace(own, effect=square, alternatives=(scales,))
    found = replace(wave.discovery, findings=(either,))
    assert gates._robot_in_place_of_instrument(found, either) is found


def test_an_unlikely_effect_of_the_instrument_goes_whatever_held_out_poses_say(monkeypatch, wave):
    """Their readings are false as it says, or the base is moved for nothing."""
    two = beside(wave, ("cmm_squareness", "instrument"))
    monkeypatch.setattr(
        gates, "with_unknown_cause", lambda _found, name: replace(name, unknown_probability=0.9)
    )
    monkeypatch.setattr(gates, "harmed", lambda _after, before=None: before is not None)
    assert names(gates._without_unlikely_names(two)) == names(wave.discovery)


def test_predictions_hold_that_an_effect_of_the_instrument_may_not_be_there(wave):
    """Else a wrong one moves base and geometry by many times the uncertainty."""
    two = beside(wave, ("cmm_squareness", "instrument"))
    unsure = [
        replace(each, unknown_probability=0.3) if each.id == "cmm_squareness" else each
        for each in two.findings
    ]
    otherwise = with_other_readings(replace(two, findings=tuple(unsure))).otherwise
    assert otherwise.probability == pytest.approx(0.3, abs=0.05)
    assert all(term.id != "cmm_squareness" for term in otherwise.model.model.terms)
    assert np.abs(otherwise.model.T_instr_base - two.model.T_instr_base).max() > 1e-7


def test_predictions_hold_that_an_effect_may_be_none_of_those_known(wave):
    """It is then an imitation, and errors of other poses are as large as without it."""
    sure = wave.discovery
    assert with_doubt(sure).doubt is None
    (named,) = sure.findings
    unsure = with_doubt(replace(sure, findings=(replace(named, unknown_probability=0.3),)))
    probability, without = unsure.doubt
    assert probability == pytest.approx(0.3, abs=0.05)
    found, lacks = unsure.model.discrepancy, sure.model.discrepancy
    assert without.error_mm.min() > 2.0 * lacks.error_mm.max()
    expected = (1.0 - probability) * lacks.error_mm**2 + probability * without.error_mm**2
    np.testing.assert_allclose(found.error_mm**2, expected, rtol=0.05)


def test_what_uncertain_weights_take_up_is_no_comfort(monkeypatch, wave, nothing_hidden):
    """Any term that is there stands for uncertain weights; here the effect lowers the error."""
    assert "the weights may differ from the description" not in "".join(
        reasons_against_none(wave.discovery)
    )
    monkeypatch.setattr(against_none, "holds_weights", lambda term: True)
    assert "the weights may differ from the description" in "".join(
        reasons_against_none(wave.discovery)
    )
    assert [*reasons_against_none(nothing_hidden.discovery)] == []


@pytest.mark.parametrize("differ", [False, True])
def test_loads_that_are_off_by_one_factor_look_like_weights_that_are(monkeypatch, wave, differ):
    monkeypatch.setattr(against_none, "holds_weights", lambda term: True)
    train = wave.discovery.train
    states = train.poses.states
    load_N = 40.0 * differ * (np.arange(len(states)) % 2)
    poses = train.poses.with_states(replace(states, load_N=load_N))
    found = replace(wave.discovery, train=replace(train, poses=poses))
    told = "".join(reasons_against_none(found))
    assert ("they do, or all loads do from load_N by one factor, or" in told) == differ


def test_too_many_alternatives_are_no_name(wave):
    finding, model = made(wave.discovery)
    others = [effect for effect in wave.family if effect != finding.effect and not effect.generic]
    for count in (NAMES.most_alternatives, NAMES.most_alternatives + 1):
        reasons = [*unfit(replace(finding, alternatives=tuple(others[:count])), model)]
        assert (reasons == []) == (count == NAMES.most_alternatives)
    assert reasons == ["7 other effects explain the data as well"]


@pytest.mark.parametrize("campaign", ["wave", "eccentric"])
def test_with_its_own_findings_a_verdict_stays(request, campaign):
    found = request.getfixturevalue(campaign).discovery
    again = with_findings(found, found.effects)
    assert names(again) == names(found) != []
    for one, other in zip(again.effects, found.effects, strict=True):
        np.testing.assert_allclose(one.x, other.x, rtol=0.01)
    assert again.train.after.mean_mm == pytest.approx(found.train.after.mean_mm, rel=0.01)
    none = with_findings(found, ())
    assert none.effects == ()
    assert none.train.after.mean_mm > 1.2 * found.train.after.mean_mm
    assert [step.effects for step in none.errors_by_name.steps] == [()]


@pytest.mark.slow
def test_an_alternative_that_passes_stands_in(monkeypatch, soft_wrist):
    """A soft joint 4 looks like a forearm that no arm has."""
    found = soft_wrist.discovery
    (finding,) = found.effects
    (other,) = finding.alternatives
    assert (finding.id, other.id, other.of) == ("link_torsion", "joint_compliance", "joint 4")
    after = gated(found)
    assert after.verdict == "named"
    assert names(after) == [("joint_compliance", "joint 4")]
    assert after.effects[0].parameters["K"].value == pytest.approx(3000.0, rel=0.02)
    assert finding.effect not in after.model.model.terms
    for module in (gates, refitted_verdict):
        monkeypatch.setattr(module, "unfit", lambda *_of_effect: iter(["it is made up"]))
    neither = gated(found)
    assert neither.verdict == "unexplained"
    assert why(neither) == "link_torsion of forearm fits best, but is not named: it is made up"


class TestNone:
    """What must agree before it is said that nothing is missing."""

    @pytest.fixture(params=["null", "nothing_hidden"])
    def found(self, request):
        found = request.getfixturevalue(request.param).discovery
        assert gated(found).verdict == "none"
        return found

    def test_held_out_error_and_repeatability(self, found):
        for factor, word in ((2.0, "none"), (6.0, "unexplained")):
            mean_mm = factor * found.holdout.noise_floor_mm
            doubtful = gated(replace(found, holdout=erring(found.holdout, mean_mm)))
            assert doubtful.verdict == word
        assert "the held-out error is" in why(doubtful)

    def test_error_left_and_repeatability(self, found):
        # Below what repeats show is an error of these readings; below what is stated is none.
        by_repeats = replace(found, noise_floor_from=None)
        for given, factor, word in (
            (found, 5.0, "unexplained"),
            (replace(found, noise_floor_from="stated"), 0.2, "none"),
            (by_repeats, 0.2, "unexplained"),
            (by_repeats, 5.0, "unexplained"),
        ):
            mean_mm = factor * found.train.noise_floor_mm
            doubtful = gated(replace(given, train=erring(found.train, mean_mm)))
            assert doubtful.verdict == word
            assert word == "none" or "the remaining error is" in why(doubtful)

    def test_stated_uncertainty_and_repeatability(self, found):
        poses = found.train.poses
        for factor in (1e-3, 100.0):
            stated = poses.with_measured(cov=factor**2 * poses.measured.cov)
            doubtful = gated(replace(found, train=replace(found.train, poses=stated)))
            if factor < 1.0 and not doubtful.unexplained:
                continue  # what joints scatter by explains the repeatability
            assert doubtful.verdict == "unexplained"
            assert "where the stated uncertainty gives" in why(doubtful)

    def test_the_grade_of_the_calibration(self, found):
        about = fitted_to("c", grade="suspect_input")
        baseline = replace(found.prepared.baseline, fitted_to=about)
        suspect = replace(found, prepared=replace(found.prepared, baseline=baseline))
        assert gated(suspect).verdict == "unexplained"
        assert (
            why(gated(suspect))
            == "nothing was found beside the calibrated model, yet the calibration is suspect_input"
        )
        for grade in ("good", "few_poses", "incomplete"):
            other = replace(baseline, fitted_to=fitted_to("c", grade=grade))
            judged = gated(replace(found, prepared=replace(found.prepared, baseline=other)))
            # Without repeats only a stated uncertainty speaks for it.
            by_repeats = found.method == "evidence of repeats"
            doubted = grade == "incomplete" and by_repeats
            assert judged.verdict == ("unexplained" if doubted else "none")

    def test_suspected_outliers_that_show_what_is_missing(self, found):
        shown = {"grade": "incomplete", "outliers_show": "17 of 18 are among the first 20 poses"}
        about = replace(found.prepared.baseline, fitted_to=fitted_to("c", **shown))
        judged = gated(replace(found, prepared=replace(found.prepared, baseline=about)))
        assert judged.verdict == "unexplained"
        assert shown["outliers_show"] in why(judged)


def test_none_is_not_said_of_torques_that_do_not_fit(monkeypatch, null):
    own = null.discovery.scorer.torque_test
    assert own is not None
    assert own.F < 1.5
    for ratio, word in ((1.2, "none"), (1.6, "unexplained"), (162.0, "unexplained")):
        test = pure_error_test(ratio * 1500.0, 1500.0, 3000)
        monkeypatch.setattr(ByRepeats, "torque_test", property(lambda _, test=test: test))
        after = gated(null.discovery)
        assert after.verdict == word
    assert "the logged torques differ from those of the weights: F = 162" in why(after)


@pytest.mark.parametrize("logged", [False, True])
def test_a_pull_looks_like_a_gear_ratio_unless_torques_are_logged(eccentric, logged):
    found = eccentric.discovery
    gear = GearRatioError("joint 2")
    findings = tuple(replace(each, effect=gear, rivals=()) for each in found.findings)
    prepared = replace(found.prepared, torques="logged" if logged else "masses")
    found = replace(found, findings=findings, prepared=prepared)
    after = with_cable_torques(found)
    pulls = [(other.id, other.of) for each in after.findings for other in each.alternatives]
    assert pulls == ([] if logged else [("joint_error_map", "joint 2")])
    assert after.verdict == ("named" if logged else "ambiguous")
    assert (after is found) == logged


def test_names_that_a_verdict_has_not_or_twice_are_refused(wave):
    found = wave.discovery
    (own,) = found.findings
    foreign = replace(own, effect=GearRatioError("joint 6"))
    with pytest.raises(ValueError, match="gear_ratio_error of joint 6 is not among the findings"):
        without_names(found, {foreign: "it is made up"})
    with pytest.raises(ValueError, match="is among the findings twice"):
        with_findings(found, [own, own])


def test_what_the_fit_before_predicted_is_not_that_of_a_new_fit(wave):
    found = wave.discovery
    by_names = SimpleNamespace(train=found.train, holdout=found.holdout)
    old = replace(found, predicted=SimpleNamespace(by_names=by_names), doubt=(0.5, None))
    new = with_findings(old, [])
    assert (new.predicted, new.doubt) == (None, None)
    assert new.by_names.train is new.train


@dataclass(frozen=True)
class Judged:
    """A verdict as far as a joint that is logged late asks for it."""

    rms_mm: float
    commanded: bool = False
    move_share: object = ()

    @property
    def context(self):
        return SimpleNamespace(arm=load_arm("ur10"), commanded=self.commanded, campaigns=())

    @property
    def states(self):
        return SimpleNamespace(move_share=self.move_share)

    @property
    def train(self):
        return SimpleNamespace(after=SimpleNamespace(rms_mm=self.rms_mm))


@pytest.mark.parametrize(
    ("b_rad", "found", "left_mm", "late"),
    [
        (-5e-5, Judged(0.05), 0.03, True),
        (5e-5, Judged(0.05), 0.03, False),  # lost motion as it can be
        (-5e-5, Judged(0.05), 0.06, False),  # the error does not grow with the move
        (-5e-5, Judged(0.05), None, False),  # the fit rules it out
        (-5e-5, Judged(0.05, commanded=True), 0.03, False),  # a controller stops beyond its command
        (-5e-5, Judged(0.05, move_share=None), 0.03, False),  # no times: moves are not known
    ],
)
def test_a_joint_that_is_ahead_of_its_log_is_logged_late(monkeypatch, b_rad, found, left_mm, late):
    tried = []

    def fitted(_, old, new):
        tried.append(new.effect)
        return None if left_mm is None else Judged(left_mm)

    monkeypatch.setattr(gates, "fitted_instead", fitted)
    lost = Finding(Backlash("joint 2"), np.array([b_rad]), np.eye(1), (), object())
    instead = gates._logged_late(found, lost)
    assert (instead is not None) is late
    if late:
        assert tried == [AlongMove("joint 2", (2,))]


def test_a_joint_that_is_logged_late_is_off_by_its_own_part_of_the_move():
    share = np.array([[1.0, -0.5, 0.0], [0.2, 1.0, -1.0]])
    states = SimpleNamespace(move_share=share, campaign=np.zeros(2))
    columns = AlongMove("joint 2", (2,)).per_unit(states)
    np.testing.assert_allclose(np.broadcast_to(columns, (2, 1, 1))[:, 0, 0], [-0.5, 1.0])
