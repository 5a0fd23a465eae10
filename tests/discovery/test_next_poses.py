"""What to measure next, put to the test: measure it in the virtual cell, and search again."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from calibrated import calibrated
from mended import write_simulated
from pa10cal.arm.chain import Chain
from pa10cal.arm.workspace import PosturePoints, clearance_m
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.read import read_campaign
from pa10cal.discovery.blocked_cv.as_repeated import as_repeated
from pa10cal.discovery.evidence.candidates import split_testable
from pa10cal.discovery.evidence.fit import EvidenceFit, fit
from pa10cal.discovery.evidence.noise_model import NO_SHARED_ERROR
from pa10cal.discovery.evidence.problem import EvidenceProblem, prepare
from pa10cal.discovery.evidence.search import evidence_about, search
from pa10cal.discovery.next_poses import (
    PairProbability,
    draw_near,
    poses_at_unseen_angles,
    separating_poses,
    unresolved_pairs,
)
from pa10cal.discovery.preparation import setup_of
from pa10cal.discovery.rules import EVIDENCE, PROBABILITIES
from pa10cal.discovery.separation import separation_criteria
from pa10cal.discovery.tuning import NEXT_POSES
from pa10cal.discovery.unmeasured_poses import as_if_measured
from pa10cal.errors import DiscoveryError
from pa10cal.files.arms import load_arm
from pa10cal.fit.validity import AngleCoverage, angles_seen
from pa10cal.options import DiscoveryOptions
from pa10cal.rules import ANGLES
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal.terms.term import yields

ARM = load_arm("pa10_6ce")
FLEXIBLE = (2, 3, 5)
#: Two models are told apart where one is so much likelier.
APART_NATS = 8.0


@dataclass
class Measured:
    """A campaign, the baseline fitted to it, and which effects it can show."""

    problem: EvidenceProblem
    start: EvidenceFit
    shown: tuple[Effect, ...]
    refused: tuple[Effect, ...]

    def effect(self, id_, of):
        return next(
            effect for effect in (*self.shown, *self.refused) if (effect.id, effect.of) == (id_, of)
        )

    def search(self):
        return search(self.problem, self.shown, 0.01, self.start)

    def apart(self, found, pair, count):
        """Return the poses that separate a pair of effects, and what they are expected to bring."""
        plan = separating_poses(self.problem, found, {pair: None}, count)
        return plan.poses, plan.separations[0]


@pytest.fixture(scope="module")
def measure(tmp_path_factory):
    """Measure a robot that hides one effect, on the grid and where else is asked."""

    def measured(id_, of, parameters, further=()):
        raw = {
            "random_seed": 7,
            "built": "drawn",
            "repeats": 4,
            "holdout_points": 0,
            "hidden_effects": [{"id": id_, "of": of, "parameters": parameters}],
            "poses": {
                "tilt_seed": 3,
                "extra_deg": [np.degrees(suggestion.q_rad).tolist() for suggestion in further],
            },
        }
        found = read_campaign(write_simulated(tmp_path_factory.mktemp("campaign") / "raw", raw))
        options = CalibrationOptions(starts=1, flexible_joints=FLEXIBLE, inner_poses="all")
        model = calibrated(found.description, ARM, found.calibration, options=options)
        setup = setup_of(found.description, ARM, options, DiscoveryOptions())
        problem = prepare(found.calibration, model.with_bends(), setup)
        start = fit(problem, (), (), NO_SHARED_ERROR)
        shown, refused = split_testable(problem, start, candidates(problem.context))
        return Measured(problem, start, shown, tuple(entry.effect for entry in refused))

    return measured


RATIO = ("gear_ratio_error", "joint 2", {"eps": 2e-4})
ECCENTRIC = ("encoder_eccentricity", "joint 2", {"A": 1.45e-4, "phi": 2.0})
WINDUP = ("soft_windup", "joint 3", {"A": 3e-4, "tau0": 10.0})


@pytest.fixture(scope="module")
def ratio(measure):
    return measure(*RATIO)


@pytest.fixture(scope="module")
def found_first(ratio):
    return ratio.search()


def names(found):
    return [(effect.id, effect.of) for effect in found.fit.effects]


def behind(found, effect):
    """Return how much less likely the data are with one effect alone than with what was found."""
    k = found.family.index(effect)
    alone = [found.evidence.score(((k, size),)).log_evidence for size in range(len(EVIDENCE.sizes))]
    return found.score.log_evidence - max(alone)


def gain(measured, effect):
    """Return what one effect adds to the evidence of the baseline."""
    evidence = evidence_about(measured.problem, measured.start, (effect,))
    alone = [evidence.score(((0, size),)).log_evidence for size in range(len(EVIDENCE.sizes))]
    return max(alone) - evidence.score(()).log_evidence


@pytest.mark.slow
def test_an_effect_and_its_double_come_apart_where_suggested(measure, ratio, found_first):
    effect, rival = ratio.effect(*RATIO[:2]), ratio.effect(*ECCENTRIC[:2])
    assert names(found_first) == [RATIO[:2]]
    assert behind(found_first, rival) < APART_NATS  # ambiguous so far
    poses, separation = ratio.apart(found_first.fit, (effect, rival), 4)
    assert separation.before_nats < 2.0
    assert separation.can_be_split
    assert separation.after_nats == poses[-1].separation_nats > APART_NATS
    again = measure(*RATIO, further=poses).search()
    assert names(again) == [RATIO[:2]]
    # Expected with one load a pose; the cell hangs all three.
    rival = next(e for e in again.family if (e.id, e.of) == ECCENTRIC[:2])
    assert behind(again, rival) > separation.after_nats


@pytest.mark.slow
def test_a_wrong_name_among_doubles_is_put_right(measure):
    first = measure(*ECCENTRIC)
    found = first.search()
    truth, double = (first.effect(id_, "joint 2") for id_ in (ECCENTRIC[0], "encoder_ellipticity"))
    assert found.fit.effects == (double,)  # with these poses, the likelier of the two
    assert behind(found, truth) < APART_NATS
    further, _ = first.apart(found.fit, (double, truth), 4)
    again = measure(*ECCENTRIC, further=further).search()
    assert names(again) == [ECCENTRIC[:2]]
    assert behind(again, double) > APART_NATS


@pytest.mark.slow
def test_what_was_not_testable_shows_where_suggested(measure):
    first = measure(*WINDUP)
    effect = first.effect(*WINDUP[:2])
    assert effect in first.refused
    assert gain(first, effect) < NEXT_POSES.apart_nats
    poses, separation = first.apart(first.start, (effect, None), 4)
    assert separation.before_nats < NEXT_POSES.apart_nats
    assert separation.can_be_split
    again = measure(*WINDUP, further=poses)
    effect = again.effect(*WINDUP[:2])
    assert effect in again.shown
    assert gain(again, effect) > APART_NATS


@pytest.mark.slow
def test_poses_cannot_tell_a_twisting_forearm_from_a_yielding_joint_4(measure):
    first = measure("link_torsion", "forearm", {"c": 3e-5})
    pair = (
        first.effect("link_torsion", "forearm"),
        first.effect("joint_compliance", "joint 4"),
    )
    for effect, rival in (pair, pair[::-1]):
        there = fit(first.problem, (effect,), (1,), NO_SHARED_ERROR)
        poses, separation = first.apart(there, (effect, rival), 10)
        assert poses == ()
        assert not separation.can_be_split
        assert separation.possible_nats < NEXT_POSES.apart_nats


def test_a_hopeless_pair_takes_no_configuration_from_another(ratio, found_first):
    pair = (ratio.effect(*RATIO[:2]), ratio.effect(*ECCENTRIC[:2]))
    hopeless = (ratio.effect("thermal_growth", "arm"), None)
    alone = separating_poses(ratio.problem, found_first.fit, {pair: None}, 3)
    both = separating_poses(ratio.problem, found_first.fit, dict.fromkeys([pair, hopeless]), 3)
    assert [separation.can_be_split for separation in both.separations] == [True, False]
    for one, other in zip(alone.poses, both.poses, strict=True):
        assert np.array_equal(one.q_rad, other.q_rad)
        assert other.for_ == (both.separations[0].pair,)


def test_a_pair_of_unknown_quantities_leaves_all_others_as_they_are(ratio, found_first):
    pair = (ratio.effect(*RATIO[:2]), ratio.effect(*ECCENTRIC[:2]))
    unknown = (ratio.effect("thermal_growth", "arm"), None)
    states = replace(ratio.problem.cells.states, static_loads=None).take(np.arange(8))
    states = replace(states, tau_Nm=np.full(states.tau_Nm.shape, np.nan))
    states = replace(states, temperature_C=np.full(8, np.nan))
    ahead = as_if_measured(ratio.problem, found_first.fit, states)
    (alone,) = separation_criteria(ratio.problem, found_first.fit, [pair], ahead)
    both = separation_criteria(ratio.problem, found_first.fit, [pair, unknown], ahead)
    assert both[0].gains() == pytest.approx(alone.gains())
    assert both[0].gains().max() > 1e-3
    assert both[1].gains() == pytest.approx(0.0, abs=1e-4)


def test_suggestions_rise_repeat_and_keep_to_the_campaign(ratio, found_first):
    pair = (ratio.effect(*RATIO[:2]), ratio.effect(*ECCENTRIC[:2]))
    first, again = (
        separating_poses(ratio.problem, found_first.fit, {pair: None}, 5, 3).poses for _ in range(2)
    )
    nats = [suggestion.separation_nats for suggestion in first]
    assert np.all(np.diff(nats) > 0)
    assert [s.q_rad.tolist() for s in first] == [s.q_rad.tolist() for s in again]
    assert len({tuple(suggestion.q_rad) for suggestion in first}) == 5
    for suggestion in first:
        assert set(suggestion.arrive_from) <= {-1.0, 1.0}
        assert suggestion.load_N in (0.0, 44.0)
    assert separating_poses(ratio.problem, found_first.fit, {}, 5).poses == ()
    # Of no poses nothing is known: that any other could not separate them is not said.
    assert separating_poses(ratio.problem, found_first.fit, {pair: None}, 0).separations == ()


def test_drawn_configurations_keep_clear_near_the_measured_poses(ratio, monkeypatch):
    q_rad = draw_near(ratio.problem, 300, 0)
    low, high = ARM.limits_rad.T
    assert q_rad.shape == (300, 6)
    assert np.all((q_rad > low + 0.049 * (high - low)) & (q_rad < high - 0.049 * (high - low)))
    drawn, measured = (
        PosturePoints.of(Chain.of(ARM), q, ratio.problem.setup.p_ee_targets_m)
        for q in (q_rad, ratio.problem.cells.states.q_rad)
    )
    assert drawn.p_base_tool[..., 2].min() > 0.15
    assert np.hypot(*drawn.p_base_tool[..., :2].T).min() > 0.25
    end, low, high = drawn.p_base_end, *(f(measured.p_base_end, axis=0) for f in (np.min, np.max))
    assert np.all((end > low - 0.3) & (end < high + 0.3))
    assert np.ptp(end, axis=0) == pytest.approx(high - low + 0.6, rel=0.1)
    nowhere = replace(NEXT_POSES, limit_share=0.5)  # the middle of all ranges alone
    monkeypatch.setattr("pa10cal.discovery.next_poses.NEXT_POSES", nowhere)
    with pytest.raises(DiscoveryError, match="no configuration"):
        draw_near(ratio.problem, 10, 0)


def test_what_is_predicted_is_what_was_measured(ratio):
    """In configurations of the campaign itself."""
    readings, noise = ratio.problem.readings, ratio.problem.noise
    rows = np.arange(0, len(readings), 13)
    measured = readings.take(rows)
    states = measured.states
    nan = np.full(states.tau_Nm.shape, np.nan)
    ahead = as_if_measured(
        ratio.problem, ratio.start, replace(states, tau_Nm=nan, static_loads=None)
    )
    poses = ahead.cells
    assert poses.measured.T_instr_target[:, :3, 3] == pytest.approx(
        measured.measured.T_instr_target[:, :3, 3], abs=5e-4
    )
    assert poses.states.tau_Nm == pytest.approx(states.tau_Nm, abs=5.0 * noise.torque_Nm.max())
    assert np.all(poses.readings == 4)
    # Touches see the balls from fixed sides, so the end's own axes are not quite all that matters.
    for foreseen, seen in (
        (poses.measured.by_apparatus, measured.measured.by_apparatus),
        (4.0 * ahead.cell_cov, noise.cov[rows]),
    ):
        for part in (np.s_[:, :3], np.s_[:, 3:]):
            assert np.linalg.norm((foreseen - seen)[part]) < 0.2 * np.linalg.norm(seen[part])
    assert np.abs(ratio.start.at.compared(poses).residual).max() < 1e-12


def test_torques_that_no_mass_explains_are_not_predicted(ratio):
    """Nor those that bend the model where one reading has none; else torques have no rows."""
    problem, states = ratio.problem, ratio.problem.readings.states
    tau_Nm = states.tau_Nm.copy()
    tau_Nm[3, 0] = np.nan
    ahead = replace(states.take(np.arange(8)), tau_Nm=tau_Nm[:8] * np.nan, static_loads=None)
    without_masses = replace(problem, setup=replace(problem.setup, payload=None))
    partly = problem.readings.with_states(replace(states, tau_Nm=tau_Nm))
    for readings in (problem.readings, partly):
        with pytest.raises(DiscoveryError, match="torques cannot be predicted"):
            as_if_measured(replace(without_masses, readings=readings), ratio.start, ahead)
    model = ratio.start.at.model
    rigid = replace(model, terms=tuple(term for term in model.terms if not yields(term)))
    at = ratio.start.at
    x = at.x[model.parameter_indices(*rigid.terms)]
    stiff = replace(ratio.start, at=replace(at, model=rigid, x=x))
    baseline = replace(problem.baseline, model=rigid, x=x)
    known = replace(without_masses, readings=partly, baseline=baseline)
    assert as_if_measured(known, stiff, ahead).torque is None


def test_some_of_very_many_poses_stand_for_all(eccentric, monkeypatch):
    """The larger separation is as by all of them; the smaller depends on which are taken."""
    scorer = eccentric.discovery.scorer
    (finding,) = eccentric.discovery.findings
    rival = next(
        each
        for each in candidates(eccentric.discovery.context)
        if (each.id, each.of) == ("gear_ratio_error", finding.of)
    )
    states = replace(scorer.survey.poses.states.take(np.arange(10)), static_loads=None)
    states = replace(states, tau_Nm=np.full(states.tau_Nm.shape, np.nan))
    values = []
    for most in (1000, len(scorer.survey.poses) // 2):
        monkeypatch.setattr(
            "pa10cal.discovery.blocked_cv.as_repeated.NEXT_POSES",
            replace(NEXT_POSES, most_measured=most),
        )
        problem, found = as_repeated(scorer.survey, scorer.extended, scorer.noise)
        pair = (finding.effect, rival)
        ahead = as_if_measured(problem, found, states)
        values.append(separation_criteria(problem, found, [pair], ahead)[0].values.max())
    assert values[1] == pytest.approx(values[0], rel=0.05)


# What more log evidence is expected to say.


@pytest.mark.parametrize("p", [0.5, 0.58, 0.9, 0.999])
def test_expected_information_grows_from_none_to_all_that_is_open(p):
    odds, nats = PairProbability(p, 1.0 - p), np.append(0.0, np.geomspace(1e-3, 500.0, 60))
    bits = odds.information_bits(nats)
    assert bits[0] == 0.0
    assert np.all(np.diff(bits) >= 0.0)
    assert np.all(np.diff(bits[nats < 10.0]) > 0.0)
    assert np.all(bits <= odds.open_bits + 1e-12)
    assert bits[-1] == pytest.approx(odds.open_bits, rel=1e-4)
    assert bits == pytest.approx(PairProbability(1.0 - p, p).information_bits(nats), abs=1e-9)
    assert PairProbability(p / 2, (1.0 - p) / 2).information_bits(nats) == pytest.approx(bits / 2)


def test_expected_information_is_that_of_many_draws():
    p, nats = 0.7, 3.0
    rng = np.random.default_rng(0)
    sign = np.where(rng.random(400_000) < p, 1.0, -1.0)
    log_odds = np.log(p / (1.0 - p)) + sign * nats + rng.normal(0.0, np.sqrt(2.0 * nats), len(sign))
    first = 1.0 / (1.0 + np.exp(-log_odds))
    left = -(first * np.log2(first) + (1.0 - first) * np.log2(1.0 - first)).mean()
    odds = PairProbability(p, 1.0 - p)
    said = odds.information_bits(np.array(nats))
    assert said == pytest.approx(odds.open_bits - left, abs=3e-3)
    likelier = np.maximum(first, 1.0 - first).mean()
    assert odds.expected_probability(nats) == pytest.approx(likelier, abs=3e-3)
    assert odds.expected_probability(0.0) == pytest.approx(p)


def test_poses_go_to_the_pair_that_is_open(ratio, found_first):
    effect = ratio.effect(*RATIO[:2])
    pairs = (
        (effect, ratio.effect(*ECCENTRIC[:2])),
        (effect, ratio.effect("link_bending", "forearm")),
    )
    after = []
    for first in ((0.5, 0.5), (0.99999, 0.00001)):
        odds = (
            PairProbability(*first),
            PairProbability(*(0.5, 0.5) if first[0] > 0.9 else (0.99999, 0.00001)),
        )
        asked = dict(zip(pairs, odds, strict=True))
        plan = separating_poses(ratio.problem, found_first.fit, asked, 2)
        assert all(each.can_be_split for each in plan.separations)
        for each, known in zip(plan.separations, odds, strict=True):
            assert each.probability == pytest.approx(known.probability)
            assert 0.5 < each.expected_probability <= 1.0
        after.append([each.after_nats for each in plan.separations])
    (open_first, settled_second), (settled_first, open_second) = after
    assert open_first > settled_first
    assert open_second > settled_second


# Campaigns without repeats: angles not seen, and rivals.


def test_suggested_poses_take_joints_to_angles_not_seen(nothing_hidden):
    survey = nothing_hidden.survey
    seen = angles_seen(survey.poses.states.q_rad, np.full(6, ANGLES.fine_order))
    found = poses_at_unseen_angles(survey, seen, 5)
    assert len(found) == 5
    for pose in found:
        new = ~seen.covers(pose.q_rad[None])[0]
        joints = np.flatnonzero(new) + 1
        away_rad = np.abs(survey.poses.states.q_rad - pose.q_rad).min(axis=0)
        assert pose.for_ == tuple(
            f"few poses near the angle of joint {j}"
            if away_rad[j - 1] < np.radians(5.0)
            else f"angle of joint {j} not seen"
            for j in joints
        )
    joints = [len(pose.for_) for pose in found]
    assert joints == sorted(joints, reverse=True)
    limits = survey.context.arm.limits_rad
    q_rad = np.array([pose.q_rad for pose in found])
    assert np.all((q_rad > limits[:, 0]) & (q_rad < limits[:, 1]))


def test_targets_come_as_close_to_links_as_they_were_measured(nothing_hidden):
    """The target of a short tool, or of a small arm, is never far off them."""
    survey, place_m = nothing_hidden.survey, np.array([0.0, 0.0, 0.01])
    at = replace(survey.baseline, targets_m=place_m)
    found = draw_near(replace(survey, baseline=at), 20, 0)
    assert len(found) == 20

    def closest_m(q_rad):
        points = PosturePoints.of(at.model.chain, q_rad, place_m[None])
        return clearance_m(points).min()

    measured_m = closest_m(survey.poses.states.q_rad)
    assert measured_m < NEXT_POSES.clearance_m
    assert closest_m(found) == pytest.approx(measured_m)


@pytest.mark.parametrize("count", [0, 3])
def test_there_are_none_where_all_was_seen(nothing_hidden, count):
    whole = AngleCoverage((np.array([[0.0, 2.0 * np.pi]]),) * 6, (True,) * 6)
    assert poses_at_unseen_angles(nothing_hidden.survey, whole, count) == ()


def test_what_is_ambiguous_among_poses_without_repeats_comes_apart_too(eccentric):
    verdict = eccentric.discovery
    (finding,) = verdict.findings
    (rival,) = (
        each
        for each in candidates(verdict.context)
        if (each.id, each.of) == ("gear_ratio_error", finding.of)
    )
    ambiguous = replace(verdict, findings=(replace(finding, alternatives=(rival,)),))
    found = ambiguous.next_poses(3)
    (separation,) = found.separations
    nats = [separation.before_nats, *(pose.separation_nats for pose in found.poses)]
    assert len(nats) == 4
    assert np.all(np.diff(nats) > 0.0)
    assert separation.after_nats == nats[-1]
    (odds,) = unresolved_pairs(ambiguous.effects).values()
    assert separation.probability == odds.probability
    tempered = (separation.after_nats - separation.before_nats) / PROBABILITIES.blocks
    assert separation.expected_probability == pytest.approx(odds.expected_probability(tempered))
    assert verdict.next_poses(3).separations is None
