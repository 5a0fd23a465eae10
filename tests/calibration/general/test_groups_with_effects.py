"""Campaigns of a group that contradict each other, judged again with the effects found."""

from dataclasses import replace

import numpy as np
import pytest

from calibrated import general
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload, statics
from pa10cal.calibration.general.as_model import fitted
from pa10cal.calibration.general.calibrate import find_start
from pa10cal.calibration.general.contradictions import contradictions
from pa10cal.calibration.general.per_campaign import per_campaign_fits
from pa10cal.discovery.blocked_cv.by_campaign import contradictions_left
from pa10cal.discovery.blocked_cv.refit import refit
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.discover import discover
from pa10cal.discovery.pose_scatter import unweighted
from pa10cal.discovery.preparation import MeasurementSetup, prepared
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted import FittedTo
from pa10cal.observe.joined import GroupCampaign, join
from pa10cal.terms.effects.joint import SoftWindup
from pa10cal.terms.statement_faults import CampaignToolStated

ARM, NOISE_M = load_arm("ur10"), 4e-5
SOFT, SPAN_NM = (2, 3), 100.0
#: Mass of the tool of each campaign, as it is [kg].
CARRIED_KG = (1.0, 9.0)


def tool(mass_kg):
    return Payload(mass_kg, np.array([0.0, 0.02, 0.1]), np.zeros(3), np.array([0.0, 0.0, -9.81]))


def measured(see, carried_kg, campaign, deflected_rad, moved_rad=0.0):
    """Let a campaign see an arm whose joints deflect by a function of their torques."""
    drawn = []

    def posed(q_rad):
        drawn.append(q_rad)
        coordinates = Chain.of(ARM).coordinates(q_rad)
        tau_Nm = statics(
            Chain.of(ARM), coordinates, np.zeros(len(q_rad)), tool(carried_kg)
        ).joint_Nm
        held_rad = q_rad - deflected_rad(tau_Nm)
        held_rad[:, 2] += moved_rad
        return held_rad

    every = see("ur10", "points", 70 + campaign, noise_m=NOISE_M, size=0.3, posed=posed)
    every = every.with_states(replace(every.states, q_rad=drawn[0]))
    return GroupCampaign(f"of-{campaign}", every, find_start(ARM, every))


def calibrated(every, stated_kg):
    """Return a calibration, its contradictions, and what is known of the campaigns besides."""
    payload = replace(tool(stated_kg[0]), of_campaigns=tuple(map(tool, stated_kg)))
    found = general(ARM, every, payload)
    told = contradictions(per_campaign_fits(found.problem, found.fit, payload), {})
    return found, told, MeasurementSetup(payload, np.zeros((0, 3)), 20.0)


def compared(members, stated_kg, effects):
    """Return the contradictions of a calibration, and those left with effects fitted as well."""
    every = join(members)
    found, told, setup = calibrated(every, stated_kg)
    survey = Survey.of(prepared(every, fitted(found), setup))
    weights = unweighted(survey.poses.measured)
    starts = tuple(effect.starts[0] for effect in effects)
    return told, contradictions_left(survey, refit(survey, effects, starts, weights))


def softer_near_zero(tau_Nm):
    """Return the deflection of joints [rad]; some are softer near zero, by no formula of ours."""
    held_rad, by_soft = 3e-6 * tau_Nm, tau_Nm / 20.0
    soft_rad = 6e-4 * by_soft / np.sqrt(1.0 + by_soft**2)
    soft_rad[:, [joint not in SOFT for joint in range(1, 7)]] = 0.0
    return held_rad + soft_rad


@pytest.mark.parametrize("moved_rad", [0.0, 6e-4])
def test_soft_drives_are_no_tool_stated_wrongly_and_hide_no_change_of_the_arm(see, moved_rad):
    members = [
        measured(see, kg, k, softer_near_zero, moved_rad * k) for k, kg in enumerate(CARRIED_KG)
    ]
    effects = tuple(SoftWindup(f"joint {joint}", SPAN_NM, SPAN_NM) for joint in SOFT)
    told, left = compared(members, CARRIED_KG, effects)
    assert all(each.between_campaigns for each in told)
    assert told
    assert bool(left) is bool(moved_rad)


def test_the_tool_of_one_campaign_explains_that_it_differs(see):
    members = [
        measured(see, kg, k, lambda tau_Nm: 3e-6 * tau_Nm) for k, kg in enumerate(CARRIED_KG)
    ]
    stated_kg = (CARRIED_KG[0], 6.0)
    effect = CampaignToolStated("tool@of-1", True, ARM.n, 6.0, float(ARM.mass_kg.sum()), 1)
    told, left = compared(members, stated_kg, (effect,))
    assert [each.kind for each in told] == ["payload"]
    assert left == ()


@pytest.mark.slow
def test_a_tool_stated_wrongly_is_told_once_and_the_model_has_it(see):
    members = [
        measured(see, kg, k, lambda tau_Nm: 3e-6 * tau_Nm) for k, kg in enumerate(CARRIED_KG)
    ]
    every = join(members)
    found, told, setup = calibrated(every, (CARRIED_KG[0], 6.0))
    about = FittedTo(
        campaign="both", provenance="", calibration="combined", instrument="points",
        poses=len(every), temperature_C=None, time_s=(0.0, 1.0), grade="suspect_input",
        health="check the input", suspicions=told,
    )  # fmt: skip
    verdict = discover(every, replace(fitted(found), fitted_to=about), setup)
    (fault,) = verdict.faults
    assert fault.where.startswith("of-1: ")
    assert verdict.campaigns_agree
    assert verdict.model.fitted_to.grade == "incomplete"
    (tool_found,) = verdict.findings
    mass_kg, std_kg = tool_found.x[0], np.sqrt(tool_found.covariance[0, 0])
    assert abs(mass_kg - 3.0) < 3.0 * std_kg < 3.0
