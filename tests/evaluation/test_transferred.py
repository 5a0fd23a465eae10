"""Models judged in another campaign: apart where angles are new, and never worse than springs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from changed_arm import Change, draw_changed
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.general.case import fitted
from pa10cal.discovery.given import Extended
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.evaluation.holdout import Evaluation
from pa10cal.files.arms import load_arm
from pa10cal.fit.angles_seen import AngleCoverage
from pa10cal.lab.cell.options import TrackerOptions
from pa10cal.lab.simulated import measure, observations_of, payload_of_individual
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.model import Model

ARM = load_arm("ur10")


@pytest.fixture(scope="module")
def campaigns():
    """Return a model of an arm, and a campaign of the same arm mounted anew."""
    plan = TrackerOptions(poses=80, holdout_share=0.0, flexible_joints=(2,), hardening=False)
    robots = draw_changed(ARM, plan, Change(place=True), np.random.default_rng(3))
    before, after = (observations_of(measure(robot, plan, k)) for k, robot in enumerate(robots))
    payload = payload_of_individual(robots[0])
    model = fitted(calibrate_general(ARM, before, find_start(ARM, before), payload))
    kind = np.where(np.arange(len(after)) < 50, "grid", "holdout")
    setup = MeasurementSetup(payload, np.zeros((0, 3)), 20.0)
    return model, replace(after, kind=kind), setup


def with_map(model, knots):
    effect = JointErrorMap("joint 3")
    terms = (*model.model.terms, effect)
    longer = replace(
        model,
        model=Model(model.model.chain, terms),
        x=np.concatenate([model.x, knots * np.ones(effect.knots)]),
        covariance=None,
    )
    half = np.array([[-np.pi, 0.0]])
    seen = AngleCoverage((half, *[np.array([[-10.0, 10.0]])] * 5), (False,) * 6)
    return Extended(longer, seen)


def judge(campaigns, extended):
    model, every, setup = campaigns
    return Evaluation(every, {"linear": model}, extended, setup).judge(elsewhere=True)


def test_all_models_are_judged_apart_where_the_source_saw_no_such_angle(campaigns):
    waves = 1e-6 * np.sin(np.arange(12))
    found = judge(campaigns, with_map(campaigns[0], waves))
    assert set(found) == {"uncalibrated", "linear", "extended"}
    counts = {(m.inside.configurations, m.outside.configurations) for m in found.values()}
    assert len(counts) == 1
    assert sum(*counts) == 30
    assert all(count > 5 for count in next(iter(counts)))


def test_effects_that_harm_in_the_poses_of_the_frames_stay_away(campaigns):
    harmful = 2e-3 * np.sin(3.0 * np.arange(12))
    found = judge(campaigns, with_map(campaigns[0], harmful))
    assert found["extended"] == found["linear"]


def test_base_and_tool_are_enough_for_the_same_arm(campaigns):
    found = judge(campaigns, None)
    assert found["linear"].rms_mm < 0.13
    assert found["linear"].inside.configurations <= 30
