"""Springs in every joint of an arm without masses: gravity is told, and nothing is named."""

from __future__ import annotations

from dataclasses import replace

import pa10cal
from pa10cal.cell.campaign import measure_campaign, robot_of
from pa10cal.cell.options import SimulateOptions, TrackerOptions
from pa10cal.studies.simulated import as_read


def test_an_arm_without_masses_that_sags_gets_no_name():
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
    campaign = replace(campaign, arm=replace(arm, mass_kg=None, com_m=None))
    found = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
    assert found.effects == ()
    assert {"joint 2", "joint 3"} <= {place.of for place in found.unexplained}
    assert all("describe the masses of the arm" in place.why for place in found.unexplained)
