"""A model adapted to the first poses of another campaign."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.general.case import fitted
from pa10cal.cell.options import TrackerOptions
from pa10cal.errors import CalibrationError
from pa10cal.evaluation.adapted import adapted_steps
from pa10cal.figures.over_campaigns import write_adaptation
from pa10cal.files.arms import load_arm
from pa10cal.results.comparison import AdaptationRecord
from pa10cal.studies.changes import Change, draw_changed
from pa10cal.studies.simulated import measured, observations_of, payload_of_individual

ARM = load_arm("ur10")


@pytest.fixture(scope="module")
def campaigns():
    plan = TrackerOptions(poses=100, holdout_share=0.0, flexible_joints=(2,), hardening=False)
    change = Change(True, zero_rad=((4, 1e-3),))
    robots = draw_changed(ARM, plan, change, np.random.default_rng(3))
    before, after = (observations_of(measured(robot, plan, k)) for k, robot in enumerate(robots))
    payload = payload_of_individual(robots[0])
    model = fitted(calibrate_general(ARM, before, find_start(ARM, before), payload))
    kind = np.where(np.arange(len(after)) < 70, "grid", "holdout")
    return model, replace(after, kind=kind), payload


def test_a_model_needs_few_poses_of_another_campaign(campaigns, tmp_path):
    model, every, payload = campaigns
    said: list[str] = []
    steps = adapted_steps(model, ARM, every, payload, (0.15, 0.7), said.append)
    few, many = steps
    assert [step.configurations for step in steps] == [15, 70]
    assert few.prior.rms_mm < 1.3 * many.prior.rms_mm
    assert few.prior.rms_mm < few.frames.rms_mm
    assert many.prior.orientation_deg < 0.1
    assert few.prior.rms_mm < few.alone.rms_mm
    assert "the zero of joint 4" in few.line
    assert len(said) == 2
    record = AdaptationRecord(
        campaign="after", provenance="made up", from_="before", held_out=30, steps=steps
    )
    write_adaptation(record, tmp_path, "adapted", 80)
    assert len(list(tmp_path.iterdir())) == 3


def test_a_campaign_without_held_out_poses_is_refused(campaigns):
    model, every, payload = campaigns
    fitted_alone = replace(every, kind=np.full(len(every), "grid"))
    with pytest.raises(CalibrationError, match="nothing is held out"):
        adapted_steps(model, ARM, fitted_alone, payload, (0.1,), print)
