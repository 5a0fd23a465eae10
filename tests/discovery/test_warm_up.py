"""Arms that warm up in the first poses are told from what else settles or moves there."""

from dataclasses import replace

import numpy as np
import pytest

import pa10cal
from made_up_survey import observe
from mended import mend, write_simulated
from pa10cal.discovery import jacobians
from pa10cal.discovery import warm_ups as warm_ups_of_residual
from pa10cal.discovery.model_with_effects import with_base_motion
from pa10cal.discovery.pose_scatter import unweighted
from pa10cal.discovery.warm_ups import warm_ups_shown

POSES, SECONDS, TAU_S = 150, 60.0, 900.0
TARGETS_MM = [f"T{target}_{axis}_mm" for target in (1, 2, 3) for axis in "xyz"]


def discovered(folder, change=None, hidden=()):
    """Return the verdict on an arm under a tracker, after a change of its table."""
    plan = {"instrument": "points", "poses": POSES, "position_mm": 0.02, "hardening": False}
    raw = {
        "robot": "ur10",
        "random_seed": 4,
        "hidden_effects": list(hidden),
        "without_touches": {**plan, "seconds_a_pose": SECONDS, "unseen_share": 0.0},
    }
    write_simulated(folder / "raw", raw)
    if change is not None:
        mend(folder / "raw", "poses.csv", change)
    campaign = pa10cal.read_campaign(folder / "raw")
    return pa10cal.discover(campaign, pa10cal.calibrate(campaign))


def not_yet(table):
    """Return the part of a warm-up that each row still lacks, and the number of each row."""
    time_s = table.numbers(["time_s"])[:, 0]
    return np.exp(-(time_s - time_s.min()) / TAU_S), np.argsort(np.argsort(time_s))


def joints_warm_up(table):
    """Zeros of joints 2 and 3: the logged angles lack what has come, up to a constant."""
    names, amounts_mrad = ["q2_deg", "q3_deg"], np.array([0.4, -0.3])
    left, _ = not_yet(table)
    more_deg = np.degrees(1e-3 * np.outer(left, amounts_mrad))
    table.put(names, table.numbers(names) + more_deg)


def base_settles(table):
    left, _ = not_yet(table)
    table.put(TARGETS_MM, table.numbers(TARGETS_MM) + 0.4 * np.outer(left, np.tile([1, 0, -1], 3)))


def base_steps(table):
    _, row = not_yet(table)
    moved_mm = 0.4 * np.outer(row < 14, np.tile([1, 0, -1], 3))
    table.put(TARGETS_MM, table.numbers(TARGETS_MM) + moved_mm)


def names(verdict):
    return {(found.id, found.of) for found in verdict.effects}


@pytest.mark.slow
def test_joints_that_warm_up_are_named_with_their_size_and_time_constant(tmp_path):
    verdict = discovered(tmp_path, joints_warm_up)
    assert verdict.verdict == "named"
    assert names(verdict) == {("warm_up", "joint 2"), ("warm_up", "joint 3")}
    for found, amount in zip(verdict.effects, (4e-4, -3e-4), strict=True):
        for value, true, std in zip(
            found.x, (amount, TAU_S), np.sqrt(np.diag(found.covariance)), strict=True
        ):
            assert abs(value - true) < 3.0 * std < 0.5 * abs(true)
    # Poses without a time are those of the warm arm.
    q_rad = verdict.train.poses.states.q_rad
    warm = verdict.model.predict(q_rad).T[:, :3, 3]
    late = verdict.model.predict(q_rad, time_s=np.full(len(q_rad), 1e6)).T[:, :3, 3]
    np.testing.assert_allclose(warm, late, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("change", [None, base_settles, base_steps])
def test_what_else_settles_or_moves_is_no_warm_up(tmp_path, change):
    verdict = discovered(tmp_path, change)
    assert not {name for name, _ in names(verdict)} & {"warm_up", "link_warm_up"}
    assert (verdict.verdict == "none") == (change is None)


@pytest.mark.slow
def test_a_base_that_drifts_stays_a_drift(tmp_path):
    drift = {"id": "base_drift", "of": "base", "parameters": {"rate": [1e-4, 0.0, -5e-5]}}
    assert names(discovered(tmp_path, hidden=[drift])) == {("base_drift", "base")}


# What residuals show, about a model to which nothing is missing.

JOINTS = range(1, 7)


@pytest.fixture(scope="module")
def survey():
    return observe().survey


def shown(survey, by_joints_rad=None, base_m=None):
    """Return the warm-ups that are shown if joints (P, 6), or a base (P, 6), are off by so much."""
    poses, at = survey.poses, survey.baseline
    at = replace(at, model=with_base_motion(at), x=np.append(at.x, np.zeros(6)))
    left = at.compared(poses).residual
    if by_joints_rad is not None:
        left = left + np.einsum("pbj,pj->pb", jacobians.by_joints(at, poses, JOINTS), by_joints_rad)
    if base_m is not None:
        left = left + np.einsum("pbj,pj->pb", jacobians.by_base(at, poses), base_m)
    whitener = unweighted(poses.measured).whiteners()
    rows = jacobians.WhitenedPoses(at, poses, left, whitener)
    return warm_ups_shown(rows, survey.context, logged=False)


def test_joints_that_settle_together_are_shown_with_their_time_constant(survey):
    time_s = survey.poses.states.time_s
    tau_s = 0.05 * np.ptp(time_s)
    left = np.exp(-(time_s - time_s.min()) / tau_s)
    settling = np.outer(left, [0, 5e-4, -4e-4, 0, 0, 0])
    found = shown(survey, settling)
    assert {each.of for each in found} >= {"joint 2", "joint 3", "upper_arm", "forearm"}
    assert found[0].tau_s == pytest.approx(tau_s, rel=0.3)
    assert shown(survey) == ()
    assert shown(survey, base_m=np.outer(left, [3e-4, -3e-4, 2e-4, 0, 0, 0])) == ()
    # A step of the base in the first poses, and joints that err all the time, more and more.
    assert shown(survey, base_m=np.outer(left > 0.5, [3e-4, -3e-4, 2e-4, 0, 0, 0])) == ()
    assert shown(survey, np.outer(time_s / np.ptp(time_s), [0, 5e-4, 0, 0, 0, 0])) == ()


def test_one_pose_shows_no_warm_up(survey, monkeypatch):
    """Nor if nothing else that settles explains it; several poses do."""
    monkeypatch.setattr(warm_ups_of_residual, "_best_motion", lambda *_: -np.inf)
    off = 2e-3 * np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
    rank = np.argsort(np.argsort(survey.poses.states.time_s))
    assert shown(survey, np.outer(rank < 1, off)) == ()
    assert shown(survey, np.outer(rank < 6, off))
