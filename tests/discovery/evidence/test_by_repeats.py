"""The whole search on made-up campaigns: right names, honest doubt, nothing made of nothing."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

import pa10cal
from made_up_arm import Missing, harmonic, measure
from made_up_poses import at_rest
from pa10cal.discovery import preparation
from pa10cal.discovery.discover import discover
from pa10cal.discovery.evidence import by_repeats
from pa10cal.discovery.evidence.by_repeats import ByRepeats
from pa10cal.discovery.evidence.judge import noise_floor_mm
from pa10cal.discovery.next_poses import unresolved_pairs
from pa10cal.discovery.nuisances import Jump, Wander
from pa10cal.discovery.verdict_records import verdict_keys
from pa10cal.errors import CalibrationError, DiscoveryError
from pa10cal.fit.forward import Forward
from pa10cal.fit.position_errors import position_error_mm
from pa10cal.terms.effects import vocabulary
from pa10cal.terms.effects.joint import JointHarmonic
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.simulated import as_read


def name(effect):
    return effect.id, effect.of


def said(found):
    """Return the verdict in words and numbers."""
    judged = found.scorer.judgement
    return (
        found.verdict,
        [name(finding.effect) for finding in judged.findings],
        [finding.x.tolist() for finding in judged.findings],
        [tuple(map(name, finding.alternatives)) for finding in judged.findings],
        [(place.of, place.shared_error_mm) for place in judged.unexplained],
        found.extended.x.tolist(),
    )


@pytest.mark.parametrize("from_s", [0.0, 1.764e9])
def test_held_out_poses_move_by_their_own_times_wherever_the_clock_began(from_s):
    times_s = from_s + 60.0 * np.arange(40)
    jump = Jump(times_s[20] - 30.0, times_s[19], times_s[20], 1e-3, 1.0)
    wander = Wander(times_s=times_s, jumps=(jump,), amounts=np.eye(6)[0])
    states = SimpleNamespace(time_s=times_s, load_N=np.zeros(40))
    pose = np.array([f"{k // 2:02d}" for k in range(40)])
    problem = SimpleNamespace(
        readings=SimpleNamespace(states=states, pose=pose), in_time=SimpleNamespace(wander=wander)
    )
    scorer = SimpleNamespace(problem=problem)
    held_out_s = times_s[-1] + 60.0 * np.arange(1, 21)  # as many as poses fitted, after the jump
    moved_m = ByRepeats._base_motion(scorer, held_out_s)[:, 0, 3]
    assert moved_m == pytest.approx(wander.motions(held_out_s)[:, 0])
    fitted_s = times_s.reshape(-1, 2).mean(axis=1)
    moved_m = ByRepeats._base_motion(scorer, fitted_s)[:, 0, 3]
    assert moved_m == pytest.approx(wander.motions(times_s)[:, 0].reshape(-1, 2).mean(axis=1))


def test_why_no_poses_are_suggested_is_told(wave, monkeypatch):
    def refuse(*_):
        raise DiscoveryError(
            "no configuration keeps clear", where="limits", allowed="one", remedy="allow more room"
        )

    found = wave.discovery
    monkeypatch.setattr(by_repeats, "separating_poses", refuse)
    plan = found.next_poses(3)
    assert (plan.poses, plan.why_none) == ((), "no configuration keeps clear; allow more room")
    record = verdict_keys(found, plan)
    assert record.no_separating_poses == plan.why_none
    assert "no_separating_poses" not in verdict_keys(found).model_dump()


def test_where_nothing_is_missing_the_verdict_is_none(null):
    found = null.discovery
    assert found.verdict == "none"
    assert found.extended.effects == ()
    # The extended model is the baseline; what is left is what noise leaves.
    assert found.train.after.mean_mm == pytest.approx(found.train.before.mean_mm, rel=0.1)
    assert found.train.after.mean_mm == pytest.approx(found.noise_floor_mm, rel=0.1)
    assert found.holdout.after.mean_mm < 1.3 * found.noise_floor_mm


def test_a_transmission_error_is_named_and_the_gap_closed(wave, null):
    found = wave.discovery
    assert found.verdict == "named"
    (finding,) = found.effects
    assert name(finding.effect) == ("transmission_error", "joint 2")
    std = np.sqrt(np.diag(finding.covariance))
    assert (np.abs(finding.x - [2e-4, 1.0]) < 4.0 * std).all()
    assert (std < [1e-5, 0.05]).all()
    assert finding.proof.p_sign_flips_max_t < 0.01
    assert found.extended.effects == (finding.effect,)
    search = found.scorer.judgement.ended
    assert search.fit.converged
    assert search.score.variances.pose < 0.05 < search.nothing.variances.pose
    for closed, bare in (
        (found.train, null.discovery.train),
        (found.holdout, null.discovery.holdout),
    ):
        assert closed.before.mean_mm > 4.0 * closed.after.mean_mm
        assert closed.after.mean_mm < 1.3 * bare.after.mean_mm
        assert closed.reduction.interval95_mm[0] > 0.0
        for at_load in closed.record().per_load.values():
            assert at_load.reduction.interval95_mm[0] > 0.0
    assert set(found.holdout.record().per_load) == {"0N", "22N", "66N"}


@pytest.mark.slow
def test_friction_is_seen_in_torque_and_pose(rubbing):
    found = rubbing.discovery
    assert found.verdict == "named"
    (finding,) = found.effects
    assert name(finding.effect) == ("friction_torque", "joint 3")
    assert abs(finding.x[0] - 3.0) < 4.0 * np.sqrt(finding.covariance[0, 0])
    nothing, score = found.scorer.judgement.ended.nothing, found.scorer.judgement.ended.score
    assert nothing.variances.torque > 100.0 > 1.0 > score.variances.torque
    # The spring of joint 3 was wound by a torque that the log made up.
    assert found.holdout.reduction.interval95_mm[0] > 0.0
    assert found.holdout.after.mean_mm < 1.3 * found.noise_floor_mm


@pytest.mark.slow
def test_a_scale_of_the_log_is_in_neither_weights_nor_positions():
    """Under the weights of the log as it is, springs sagged, and an eccentricity was named too."""
    gain = {"id": "torque_gain", "of": "joint 2", "parameters": {"g": 0.06}}
    settings = SimulateOptions(
        random_seed=5,
        hidden_effects=(gain,),
        built="drawn",
        repeats=4,
        poses={"layout": "wide", "tilt_seed": 1519709630},
    )
    made = simulate_campaign("scaled", pa10cal.load_arm(settings.robot), settings)
    read, truth = as_read(made), made.truth
    found = pa10cal.discover(read, pa10cal.calibrate(read))
    assert [name(finding.effect) for finding in found.effects] == [("torque_gain", "joint 2")]
    # Predictions calculate torques; readings had logged ones.
    forward, schedule = Forward.of(found.model), truth.schedule
    states = at_rest(truth.q_motor, load_N=schedule.load_N, arrival=schedule.arrival)
    T = found.model.T_instr_base @ forward.T_base_frame(forward.states(states))
    off_m = (T - truth.robot.T_instr_base @ truth.rest.T_base_ee)[:, :3, 3]
    assert np.linalg.norm(off_m, axis=1).mean() < 6e-5


@pytest.mark.slow
def test_a_bowed_axis_is_unexplained_at_the_instrument(bowed):
    found = bowed.discovery
    judged = found.scorer.judgement
    assert found.verdict == "unexplained"
    assert judged.findings == ()
    (place,) = judged.unexplained
    assert (place.of, place.form) == ("instrument", "place_map")
    assert place.shared_error_mm > noise_floor_mm(bowed.problem)
    # No name, no improvement: what only says where is not in the extended model.
    assert found.extended.effects == ()
    assert found.holdout.after.mean_mm > 3.0 * found.noise_floor_mm


@pytest.mark.slow
def test_what_these_poses_cannot_tell_apart_is_ambiguous(soft_wrist):
    found = soft_wrist.discovery
    assert found.verdict == "ambiguous"
    (finding,) = found.effects
    pair = {("joint_compliance", "joint 4"), ("link_torsion", "forearm")}
    assert {name(finding.effect), *map(name, finding.alternatives)} == pair
    assert [set(map(name, group)) for group in found.indistinguishable] == [pair]
    (first, *_) = unresolved_pairs(found.effects, found.not_testable)
    assert {name(first[0]), name(first[1])} == pair
    # Either of them closes the gap.
    assert found.holdout.after.mean_mm < 1.3 * found.noise_floor_mm


def test_what_cannot_be_told_at_all_is_listed_with_the_reason(null):
    found = null.discovery
    refused = {name(entry.effect): entry for entry in found.not_testable}
    assert refused["thermal_growth", "arm"].why == "what it depends on was not logged"
    assert not refused.keys() & set(map(name, found.scorer.judgement.ended.family))
    asked = unresolved_pairs(found.effects, found.not_testable)
    assert all(rival is None for _, rival in asked)
    # Other poses do not log a temperature.
    assert ("thermal_growth", "arm") not in [name(effect) for effect, _ in asked]
    assert ("torque_gain", "joint 1") in [name(effect) for effect, _ in asked]


@pytest.mark.slow
def test_held_out_poses_decide_nothing(wave):
    held_out = wave.held_out
    T = held_out.measured.T_instr_target.copy()
    T[:, :3, 3] += np.random.default_rng(2).normal(0.0, 1e-3, (len(T), 3))
    spoilt = wave.discovered(held_out=held_out.with_measured(T_instr_target=T))
    without = wave.discovered(held_out=None)
    assert said(spoilt) == said(wave.discovery) == said(without)
    assert spoilt.train.after == wave.discovery.train.after
    assert spoilt.holdout.after.mean_mm > 50.0 * wave.discovery.holdout.after.mean_mm
    assert without.holdout is None


@pytest.mark.slow
def test_the_other_poses_do_decide(wave):
    fewer = wave.readings.take(wave.readings.pose != "P03")
    assert said(wave.discovered(readings=fewer, held_out=None)) != said(wave.discovery)


@dataclass(frozen=True)
class ThirdHarmonic(JointHarmonic):
    """Three cycles a turn of the joint: not in the vocabulary."""

    id: ClassVar[str] = "third_harmonic"

    order_stated: ClassVar[float] = 3.0


@pytest.fixture(scope="module")
def campaign():
    return measure(Missing(turn=harmonic(1, 3.0, 3e-4, 1.0)))


class TestANewEffect:
    @pytest.mark.slow
    def test_without_it_only_the_place_is_named_and_its_map_is_the_error(self, campaign):
        (finding,) = campaign.discovery.scorer.judgement.findings
        assert name(finding.effect) == ("joint_error_map", "joint 1")
        assert finding.alternatives == ()
        q_rad = np.zeros((40, 6))
        q_rad[:, 0] = np.linspace(*campaign.problem.context.q_span_rad[0], 40)
        states = at_rest(q_rad, tau_Nm=q_rad, arrival=q_rad)
        off = finding.effect.shift(states, finding.x)[:, 0] - 3e-4 * np.sin(3.0 * q_rad[:, 0] + 1.0)
        assert np.std(off) < 0.1 * 3e-4  # less a constant that calibration takes

    def test_dropped_into_the_library_it_is_found_and_named(self, campaign, monkeypatch):
        known = (*vocabulary.every_effect(), ThirdHarmonic)
        monkeypatch.setattr(vocabulary, "every_effect", lambda: known)
        found = campaign.discovered()
        family = found.scorer.judgement.ended.family
        assert sum(effect.id == "third_harmonic" for effect in family) == 6
        assert found.verdict == "named"
        (finding,) = found.effects
        assert name(finding.effect) == ("third_harmonic", "joint 1")
        assert finding.alternatives == ()
        std = np.sqrt(np.diag(finding.covariance))
        assert (np.abs(finding.x - [3e-4, 1.0]) < 4.0 * std).all()
        assert found.holdout.after.mean_mm < 1.3 * found.noise_floor_mm


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("log", [False, True], ids=["the arm alone", "its log as well"])
def test_a_zero_that_moved_between_repeats_is_no_noise(log):
    """Joint 3 by 3e-4 rad after a third of the time: sixty times the noise of its log."""

    def step(states):
        return 3e-4 * (states.time_s > 3600.0)[:, None] * np.eye(6)[2]

    measured = measure(Missing(turn=step))
    readings = measured.readings
    if log:
        moved = replace(readings.states, q_rad=readings.states.q_rad + step(readings.states))
        readings = readings.with_states(moved)
    found = discover(readings, measured.baseline, measured.setup)
    if log:  # the arm moved, and its log as much
        assert found.verdict == "none"
        return
    assert found.verdict == "check_the_log"
    (fault,) = found.faults
    assert fault.kind == "step_in_time"
    assert fault.what.startswith("the zero of joint 3 moved by +0.3")
    assert "at 3600 s and" in fault.where
    assert not found.prepared.gross.any()
    assert found.train.after.mean_mm < 1.2 * found.noise_floor_mm
    assert "the model is of the arm since then" in fault.remedy
    assert found.explained is None  # the step is all
    (moved_rad,) = found.since.moved
    assert abs(moved_rad - 3e-4) < 4.0 * np.sqrt(found.since.covariance[0, 0]) < 1e-4
    # Readings as logged: the model is of those after the step, and not of those before.
    poses = preparation.complete(readings, measured.baseline, measured.setup, found.model)
    error_mm = position_error_mm(poses.measured, found.model.compared(poses).residual)
    later = poses.states.time_s > 3600.0
    assert error_mm[later].mean() < 0.2 * error_mm[~later].mean()


@pytest.mark.slow
@pytest.mark.parametrize("moved_rad", [0.0, 3e-4])
def test_a_zero_that_moved_is_told_where_repeats_are_too_few_for_a_search(moved_rad):
    def step(states):
        return moved_rad * (states.time_s > 5400.0)[:, None] * np.eye(6)[2]

    measured = measure(Missing(turn=step))
    readings = measured.readings
    kept = np.isin(readings.pose, np.unique(readings.pose)[:15])
    few = (readings.states.load_N == 0.0) & (readings.states.arrival[:, 0] > 0.0) & kept
    found = discover(readings.take(few), measured.baseline, measured.setup)
    assert found.verdict == "not_sought"
    assert [fault.kind for fault in found.faults] == ["step_in_time"] * (moved_rad > 0.0)
    assert not found.prepared.gross.any()
    if moved_rad:
        assert found.faults[0].what.startswith("the zero of joint 3 moved by +0.3")
        assert "calibrate the readings before and after" in found.faults[0].remedy


def test_a_campaign_without_repeats_is_refused(null):
    _, first = np.unique(null.readings.pose, return_index=True)
    with pytest.raises(DiscoveryError, match="too few repeats"):
        null.discovered(readings=null.readings.take(first), held_out=None)


def test_a_spring_without_torque_is_refused(null):
    readings = null.problem.readings
    silent = replace(readings.states, tau_Nm=np.full_like(readings.states.tau_Nm, np.nan))
    with pytest.raises(CalibrationError, match="has a spring, but no torque"):
        null.discovered(readings=replace(readings, states=silent), held_out=None)
