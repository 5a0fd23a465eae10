"""Springs in every joint of an arm without masses, judged by repeats: they are what is named."""

from __future__ import annotations

from dataclasses import replace

import pytest

import pa10cal
from pa10cal.fit.weighed_arm import weighed_arm
from pa10cal_lab.cell.campaign import measure_campaign, robot_of
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.simulated import as_read


@pytest.mark.slow
def test_joints_of_an_arm_without_masses_give_way_and_nothing_else_is_named():
    arm = pa10cal.load_arm("ur10")
    plan = TrackerOptions(
        instrument="pose",
        poses=60,
        holdout_share=0.1,
        repeat_every=1,
        flexible_joints=(1, 2, 3, 4, 5, 6),
        hardening=False,
    )
    settings = SimulateOptions(random_seed=1, robot="ur10", without_touches=plan)
    campaign = as_read(measure_campaign("sagging", settings, robot_of(arm, settings)))
    bare = replace(arm, mass_kg=None, com_m=None)
    arm = weighed_arm(bare, campaign.observations, campaign.description.payload)
    campaign = replace(campaign, arm=arm)
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    assert found.effects == ()
    assert {"joint 2", "joint 3"} <= {finding.of for finding in found.gives_way}
