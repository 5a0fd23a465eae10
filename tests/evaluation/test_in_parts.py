"""A carried model in a campaign whose instrument was knocked: a base for every part."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from changed_arm import Change, draw_changed
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.general.case import fitted
from pa10cal.discovery.given import Extended
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.evaluation.holdout import (
    Evaluation,
    held_out_record,
    said_of_parts,
    transfer_record,
    worth_cutting,
)
from pa10cal.files.arms import load_arm
from pa10cal.lab.cell.options import TrackerOptions
from pa10cal.lab.simulated import measure, observations_of, payload_of_individual

ARM = load_arm("ur10")
CAMPAIGN = SimpleNamespace(name="b", provenance="p", robot="ur10")
POSES, KNOCKED_AT = 120, 70
SHIFT_M, TURN_RAD = np.array([2.5e-4, -3e-4, 1e-4]), np.array([0.0, 1e-4, 1e-4])


@pytest.fixture(scope="module", name="carried")
def _carried():
    """Return a model of an arm, and a campaign of the same arm mounted anew."""
    plan = TrackerOptions(poses=POSES, holdout_share=0.0, flexible_joints=(2,), hardening=False)
    robots = draw_changed(ARM, plan, Change(place=True), np.random.default_rng(4))
    before, after = (observations_of(measure(robot, plan, k)) for k, robot in enumerate(robots))
    payload = payload_of_individual(robots[0])
    model = fitted(calibrate_general(ARM, before, find_start(ARM, before), payload))
    after = after.take(np.argsort(after.states.time_s))
    kind = np.where(np.arange(POSES) % 4 < 3, "grid", "holdout")
    return model, replace(after, kind=kind), MeasurementSetup(payload, np.zeros((0, 3)), 20.0)


def knocked(every):
    """Return readings whose instrument was knocked before one of them."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(TURN_RAD).as_matrix(), SHIFT_M
    late = np.arange(POSES) >= KNOCKED_AT
    seen = every.measured.T_instr_target
    return every.with_measured(T_instr_target=np.where(late[:, None, None], T @ seen, seen))


def elsewhere(carried, every):
    model, _, setup = carried
    return transfer_record(CAMPAIGN, "a", Evaluation(every, {"linear": model}, None, setup))


@pytest.fixture(scope="module", name="in_parts")
def _in_parts(carried):
    return elsewhere(carried, knocked(carried[1]))


def test_a_base_for_every_part_brings_back_what_the_model_is_worth(carried, in_parts):
    still = elsewhere(carried, carried[1])
    assert still.parts is None
    assert still.one_base is None
    assert in_parts.models["linear"].rms_mm < 1.1 * still.models["linear"].rms_mm
    assert in_parts.one_base["linear"].rms_mm > 1.5 * still.models["linear"].rms_mm


def test_the_parts_and_the_motion_between_them_are_recovered(carried, in_parts):
    first, second = in_parts.parts
    times_s = carried[1].states.time_s
    # Held-out poses have no part in it, so that the knock is known to within one of them.
    assert abs(np.searchsorted(times_s, second.from_s) - KNOCKED_AT) <= 1
    assert (first.poses + second.poses, first.held_out + second.held_out) == (90, 30)
    assert first.moved_by_mm is None
    places_m = carried[1].measured.T_instr_target[:, :3, 3]
    by_m = places_m @ (Rotation.from_rotvec(TURN_RAD).as_matrix() - np.eye(3)).T + SHIFT_M
    true_mm = 1e3 * np.sqrt(np.mean(np.sum(by_m**2, axis=1)))
    assert second.moved_by_mm == pytest.approx(true_mm, abs=0.05)
    assert second.turned_by_mrad == pytest.approx(1e3 * np.linalg.norm(TURN_RAD), abs=0.05)


def test_the_record_says_so(carried, in_parts):
    plain = in_parts.model_dump(mode="json")
    assert [set(part) for part in plain["parts"]] == [
        {"from", "to", "poses", "held_out", "moved_by_mm", "turned_by_mrad"}
    ] * 2
    assert in_parts.one_base["linear"].rms_mm > in_parts.models["linear"].rms_mm
    assert "a base for every part" in said_of_parts(in_parts.parts)
    still = elsewhere(carried, carried[1])
    assert not {"parts", "one_base"} & set(still.model_dump(mode="json"))
    assert said_of_parts(still.parts or ()) == ""


def test_rows_in_the_order_of_their_angles_are_not_cut(carried):
    every = knocked(carried[1])
    ramp = np.linspace(-1.0, 1.0, POSES)[:, None] * np.ones(ARM.n)
    model = carried[0]
    seen = model.predict(ramp, frame="tool").T
    states = replace(every.states, q_rad=ramp)
    T = np.eye(4)
    T[:3, 3] = SHIFT_M
    seen[KNOCKED_AT:] = T @ seen[KNOCKED_AT:]
    seen[:, :3, 3] += 1e-5 * np.random.default_rng(1).standard_normal((POSES, 3))
    every = every.with_states(states).with_measured(T_instr_target=seen)
    assert elsewhere(carried, every).parts is None


def test_in_its_own_campaign_a_model_is_parted_where_the_verdict_tells_a_step(carried):
    model, _, setup = carried
    every = knocked(carried[1])
    times_s = every.states.time_s
    step_s = 0.5 * (times_s[KNOCKED_AT - 1] + times_s[KNOCKED_AT])
    models, extended = {"linear": model}, Extended(model, steps_s=(step_s,))
    found = held_out_record(CAMPAIGN, "combined", Evaluation(every, models, extended, setup))
    assert [part.poses + part.held_out for part in found.parts] == [KNOCKED_AT, POSES - KNOCKED_AT]
    whole = Evaluation(every, {"linear": model}, None, setup).judge(elsewhere=True)
    assert found.by_parts["linear"].rms_mm < 0.7 * whole["linear"].rms_mm
    still = held_out_record(CAMPAIGN, "combined", Evaluation(every, models, Extended(model), setup))
    assert still.by_parts is None
    assert still.parts is None


def test_a_part_with_too_few_poses_joins_its_neighbour(carried):
    every = carried[1]
    times_s = every.states.time_s
    assert worth_cutting(every, (times_s[60], times_s[30])) == (times_s[30], times_s[60])
    # Eight readings before the first, or between two: across the less certain step.
    assert worth_cutting(every, (times_s[60], times_s[8])) == (times_s[60],)
    assert worth_cutting(every, (times_s[60], times_s[66])) == (times_s[60],)
    assert worth_cutting(every, (times_s[66], times_s[60])) == (times_s[66],)
