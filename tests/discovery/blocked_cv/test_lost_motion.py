"""Lost motion of all joints, against what a move leaves of them: who may stand for whom."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_survey import ARM, Hidden, observe
from pa10cal.arrays import rms
from pa10cal.discovery.blocked_cv.interleaved_check import (
    InterleavedCheck,
    SquaresByBlock,
    proof_of,
)
from pa10cal.discovery.blocked_cv.judge import Judged
from pa10cal.discovery.blocked_cv.lost_motion import lost_motion_instead, stand_for_lost_motion
from pa10cal.discovery.blocked_cv.outcome import search_survey
from pa10cal.discovery.finding import Rival
from pa10cal.discovery.other_explanations import with_other_readings
from pa10cal.terms.effects.arrivals import AlongMove, LostMotion, MoveSettling
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.joint import Backlash, FrictionTorque
from pa10cal_lab.cell.effects.joint import SimulatedAlongMove

LOST_RAD = 3e-4
#: Noise over that stated, by which no joint alone shows lost motion but the second.
COARSE = 20.0
BLOCKS = 10
MOVE = AlongMove("arm", tuple(range(1, 7)))
CONTEXT = CandidateContext(
    arm=ARM,
    flexible_joints=(),
    reference_temperature_C=20.0,
    largest_tau_Nm=np.ones(6),
    p_instr_middle_m=np.zeros(3),
    q_span_rad=ARM.joint_ranges_rad,
    time_span_s=(0.0, 3600.0),
)


class MadeUp(InterleavedCheck):
    """Left-out poses that are predicted as is said here."""

    def __init__(self, gain_of_move, gain_of_joint, gain_of_both, scatter=0.0, leads=False):
        self.leads_beside_move = leads
        self.gains = gain_of_move, gain_of_joint, gain_of_both
        self.scatter = scatter * np.resize([1.0, -1.0], BLOCKS)
        self._least_gain = 16.0

    def squares(self, effects=(), *, lag=True):
        of_move, of_joint, of_both = self.gains
        joints = sum(len(each.joints) for each in effects if each.id == "lost_motion")
        joints += sum(each.id == "backlash" for each in effects)
        moved = any(each.id == "along_move" for each in effects)
        gain = of_both * joints / 6 if moved and joints else of_move * moved + of_joint * joints
        blocks = np.full(BLOCKS, 100.0 - gain / BLOCKS) + self.scatter * bool(joints)
        return SquaresByBlock(np.stack([blocks, np.zeros(BLOCKS)]), 1.0)

    def amounts(self, effect, beside=()):
        return np.ones(len(effect.joints)) - 2.0 * bool(beside and self.leads_beside_move)

    def nats(self, chosen, instead):
        return chosen.total - instead.total


def stands(check, *others):
    proof = proof_of(check.squares(), check.squares([MOVE]))
    judged = tuple(Judged(each, proof, ()) for each in (MOVE, *others))
    return judged, instead_of(check, judged)


def instead_of(check, judged, candidates=(MOVE,)):
    assert stand_for_lost_motion(judged) == judged
    return lost_motion_instead(CONTEXT, check, judged, candidates)


def of_joint(joint, check, rivals=(), alternatives=()):
    backlash = Backlash(f"joint {joint}")
    proof = proof_of(check.squares(), check.squares([backlash]))
    return Judged(backlash, proof, tuple(alternatives), tuple(rivals))


def effects(judged):
    return [each.effect for each in judged]


def scores(judged):
    return {rival.effect.id: rival.nats.sum() for rival in judged.rivals}


def test_lost_motion_of_each_joint_replaces_a_move_that_predicts_worse():
    others = Backlash("joint 2")
    _, found = stands(MadeUp(100.0, 40.0, 260.0), others)
    assert [each.effect.of for each in found] == [f"joint {joint}" for joint in range(1, 7)]
    assert {each.effect.id for each in found} == {"backlash"}
    # 260 in squares; with the move 6 / 6 x 43.3 beside joint 2, and 100 without that
    for each in found:
        of_move = 100.0 if each.effect.of == "joint 2" else 260.0 / 6
        assert scores(each) == {"along_move": pytest.approx(of_move - 240.0)}


@pytest.mark.parametrize("of_both", [101.0, 110.0])
def test_a_move_that_predicts_better_stays_as_it_was(of_both):
    judged, found = stands(MadeUp(100.0, 12.0, of_both))
    assert effects(found) == effects(judged)
    assert scores(found[0]) == {"lost_motion": pytest.approx(72.0 - 100.0)}


def test_both_stand_where_each_is_needed_beside_the_other():
    _, found = stands(MadeUp(200.0, 40.0, 440.0))
    assert [each.effect.id for each in found] == ["along_move"] + 6 * ["backlash"]
    assert [scores(each) for each in found] == [{"lost_motion": pytest.approx(-200.0)}] + 6 * [{}]


def test_lost_motion_that_would_lead_beside_the_move_is_none():
    judged, found = stands(MadeUp(200.0, 40.0, 440.0, leads=True))
    assert effects(found) == effects(judged)
    assert scores(found[0]) == {"lost_motion": pytest.approx(40.0)}


@pytest.mark.parametrize(("of_move", "first"), [(241.0, "along_move"), (239.0, "lost_motion")])
def test_what_predicts_alike_is_an_alternative(of_move, first):
    _, (found,) = stands(MadeUp(of_move, 40.0, 241.0, scatter=5.0))
    (alternative,), (rival,) = found.alternatives, found.rivals
    assert found.effect.id == first
    assert {first, alternative.id} == {"along_move", "lost_motion"}
    assert rival.effect == alternative
    np.testing.assert_allclose(rival.nats.sum(), -1.0)


def test_nothing_changes_where_lost_motion_does_not_help():
    judged, found = stands(MadeUp(100.0, 2.0, 101.0))
    assert effects(found) == effects(judged)


@pytest.mark.parametrize("of_move", [10.0, 100.0])
def test_a_joint_keeps_what_was_tried_in_its_place(of_move):
    check = MadeUp(of_move, 40.0, 241.0)
    score = Rival(FrictionTorque("joint 2", 100.0), np.full(BLOCKS, -0.1))
    settling = Rival(MoveSettling("arm", MOVE.joints), np.zeros(BLOCKS))
    other = Rival(Backlash("joint 5"), np.zeros(BLOCKS))
    rivals = (score, settling, other)
    before = of_joint(2, check, rivals, [rival.effect for rival in rivals])
    found = {each.effect.of: each for each in instead_of(check, (before,))}
    assert set(found) == {f"joint {joint}" for joint in range(1, 7)}
    assert found["joint 2"].alternatives == (score.effect,)
    of_all = {"along_move": pytest.approx(of_move - 240.0)}
    assert scores(found["joint 2"]) == of_all | {"friction_torque": pytest.approx(-1.0)}
    assert scores(found["joint 1"]) == of_all


@pytest.mark.parametrize(
    ("of_move", "names"),
    [(300.0, ["along_move"]), (239.0, ["lost_motion"]), (100.0, 6 * ["backlash"])],
)
@pytest.mark.parametrize("shown", [(2,), range(1, 7)])
def test_a_late_log_that_shows_first_as_lost_motion_of_joints_is_told(of_move, names, shown):
    check = MadeUp(of_move, 40.0, max(of_move, 240.0) + 1.0, scatter=5.0)
    found = instead_of(check, tuple(of_joint(joint, check) for joint in shown))
    assert [each.effect.id for each in found] == names
    if of_move < 200.0:
        return
    (only,) = found
    assert scores(only) == {
        {"along_move": "lost_motion", "lost_motion": "along_move"}[only.effect.id]: pytest.approx(
            -abs(of_move - 240.0)
        )
    }


@pytest.fixture(scope="module")
def loose():
    return search_survey(surveyed(lambda came: -LOST_RAD * came.arrival).survey)


def surveyed(turn):
    return observe(Hidden(turn=turn, noise=COARSE), poses=120, held_out=0)


def test_lost_motion_that_one_joint_shows_alone_is_that_of_all_that_move_the_target(loose):
    fitted = loose.extended
    assert {(each.id, each.of) for each in fitted.effects} >= {
        ("backlash", f"joint {joint}") for joint in (1, 2, 3)
    }
    for effect in fitted.effects:
        at = fitted.columns_of(effect)
        std_rad = np.sqrt(fitted.covariance[at, at]).item()
        assert abs(fitted.x[at].item() - LOST_RAD) < 4.0 * std_rad


def test_the_remaining_error_is_that_of_the_model_with_lost_motion(loose):
    left_out = loose.interleaved_check.squares()
    assert rms(loose.held_out.errors_mm) == pytest.approx(left_out.rms_mm, rel=0.03)


def test_lost_motion_of_a_joint_is_no_smooth_unknown_of_it_as_well(loose):
    assert loose.nameless == ()


@pytest.mark.slow
def test_lost_motion_of_all_joints_explains_a_survey_that_has_it():
    hidden = Hidden(turn=lambda came: -3e-5 * came.arrival)
    found = observe(hidden, seed=1, poses=120, held_out=0).discovery
    assert {each.id for each in found.effects} == {"backlash"}
    assert found.verdict == "named"
    assert not found.scorer.remaining.over_floor


@pytest.fixture(scope="module")
def late():
    return surveyed(SimulatedAlongMove(c=-4e-4).at("arm").added).discovery


def test_a_log_that_is_late_is_no_lost_motion(late):
    (found,) = late.effects
    assert (found.id, found.alternatives) == ("along_move", ())
    assert with_other_readings(late).otherwise is None


def test_predictions_hold_lost_motion_that_a_late_log_may_be(late):
    (finding,) = late.effects
    lost = LostMotion("arm", (1, 2))
    rival = Rival(lost, np.zeros(BLOCKS))
    told = replace(finding, alternatives=(lost,), rivals=(rival,))
    otherwise = with_other_readings(replace(late, findings=(told,))).otherwise
    apart_mm = otherwise.model.values_of(lost)[0] * 1e3 * np.sqrt(otherwise.probability)
    q_rad = np.tile([0.3, 0.0, 0.2, -0.4, 0.5, 0.1], (2, 1))  # it reaches more than a metre
    for arrival in (0.0, 1.0):
        alone = late.model.predict(q_rad, arrival=arrival)
        held = replace(late.model, otherwise=otherwise).predict(q_rad, arrival=arrival)
        np.testing.assert_array_equal(held.T, alone.T)
        assert np.all(held.u_mm > np.hypot(alone.u_mm, apart_mm))
