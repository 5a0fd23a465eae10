"""Weights stated wrongly: what the joints hold then, and how it is told."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import at_rest, context_of
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload, across, statics
from pa10cal.files.arms import load_arm
from pa10cal.terms.statement_faults import (
    CampaignToolStated,
    GravityStated,
    LoadStated,
    ToolStated,
    fault_candidates,
)
from pa10cal.terms.wording import place_in_words

ARM = load_arm("pa10_6ce")
TOOL = Payload(2.4, np.array([0.0, 0, 0.19]), np.array([0, 0, 0.03]), np.array([0, 0, -9.80665]))
LOADS_N = np.repeat([0.0, 22.0, 40.0], 4)


def found(load_N=LOADS_N, tool=TOOL):
    q_rad = np.random.default_rng(2).uniform(-1.5, 1.5, (len(LOADS_N), ARM.n))
    loads = statics(Chain.of(ARM), Chain.of(ARM).coordinates(q_rad), load_N, tool)
    loaded = {"load_N": LOADS_N, "static_loads": loads}
    return at_rest(q_rad, tau_Nm=loads.joint_Nm, **loaded)


def of(kind, **changes):
    usual = {"loads_N": (0.0, 22.0, 40.0), "tool_kg": 2.4, "torques": "logged"}
    context = context_of(ARM, **usual | changes)
    return [fault for fault in fault_candidates(context) if isinstance(fault, kind)]


def test_a_load_stated_too_small_is_held_in_its_own_poses():
    more = np.where(LOADS_N == 40.0, 44.0, LOADS_N)
    held_Nm = found(more).tau_Nm - found().tau_Nm
    _, logged = of(LoadStated)
    assert logged.load_N == 40.0
    np.testing.assert_allclose(logged.torque_Nm(found(), np.array([0.1])), held_Nm, atol=1e-12)
    _, calculated = of(LoadStated, torques="masses")
    np.testing.assert_allclose(calculated.torque_Nm(found(), np.array([0.1])), -held_Nm, atol=1e-12)
    assert logged.acts_on_joint
    assert not calculated.acts_on_joint


def test_a_tool_stated_wrongly_is_held_everywhere():
    truth = replace(TOOL, mass_kg=3.0, com_m=TOOL.com_m + np.array([0, 0.02, 0]))
    held_Nm = found(tool=truth).tau_Nm - found().tau_Nm
    (tool,) = of(ToolStated)
    x = np.array([0.6, 0.0, 3.0 * 0.02, 0.0])
    np.testing.assert_allclose(tool.torque_Nm(found(), x), held_Nm, atol=1e-12)
    told = tool.fault_text(x, np.full(4, 0.01))
    assert "seems to be 3.00 ± 0.02 kg, its centre +20 mm along y" in told.what


def test_a_tool_stated_wrongly_may_be_any_where_torques_were_calculated():
    (logged,), (calculated,) = of(ToolStated), of(ToolStated, torques="masses", tool_kg=0.5)
    assert logged.reported[0].plausible == pytest.approx(0.3 * 2.4)
    assert calculated.reported[0].plausible == pytest.approx(0.1 * ARM.mass_kg.sum())
    assert calculated.of_calculated


def test_the_tool_of_one_campaign_is_carried_in_its_own_poses():
    group = {"campaigns": ("june", "july", "august"), "campaign_tools_kg": (2.4, 0.0, 5.0)}
    _, tool = of(CampaignToolStated, torques="masses", **group)
    assert (tool.of, tool.tool_kg, tool.campaign) == ("tool@august", 5.0, 2)
    (whole,) = of(ToolStated, torques="masses")[:1]
    x, campaign = np.array([0.6, 0.0, 0.01, 0.0]), np.resize([0, 1, 2], len(LOADS_N))
    torque_Nm = tool.torque_Nm(replace(found(), campaign=campaign), x)
    expected_Nm = np.where((campaign == 2)[:, None], whole.torque_Nm(found(), x), 0.0)
    np.testing.assert_allclose(torque_Nm, expected_Nm, atol=1e-12)
    told = tool.fault_text(x, np.full(4, 0.01))
    assert told.where.startswith("august: tool.mass_kg")
    assert "weigh the tool of august" in told.remedy


@pytest.mark.parametrize("torques", ["logged", "masses"])
def test_no_tool_and_no_load_weighs_less_than_nothing(torques):
    (tool,), loads = of(ToolStated, torques=torques), of(LoadStated, torques=torques)
    assert tool.reported[0].lower == -2.4
    assert {load.reported[0].lower for load in loads} == {-1.0}


def test_gravity_off_its_stated_direction_is_told_as_a_vector():
    tilt = np.radians(3.0)
    along = TOOL.gravity_m_s2[2] * np.array([0.0, np.sin(tilt), np.cos(tilt)])
    held_Nm = found(tool=replace(TOOL, gravity_m_s2=along)).tau_Nm - found().tau_Nm
    stated = tuple(TOOL.gravity_m_s2.tolist())
    (gravity,) = of(GravityStated, torques="masses", gravity_m_s2=stated)
    x = across(TOOL.gravity_m_s2) @ along / (np.linalg.norm(along) ** 2 * np.cos(tilt))
    torque_Nm = gravity.torque_Nm(found(), x)
    np.testing.assert_allclose(-torque_Nm, held_Nm, atol=2e-3 * np.abs(found().tau_Nm).max())
    told = gravity.fault_text(x, np.full(2, np.radians(0.1)))
    assert "gravity seems to act 3.0 ± 0.2 deg off its stated direction" in told.what
    assert "gravity_m_s2: [0.00, -0.51, -9.79]" in told.remedy


def test_a_load_is_told_as_it_seems_to_be():
    told = LoadStated("load 40 N", False, 40.0).fault_text(np.array([0.1]), np.array([0.005]))
    assert told.where == "load_N = 40"
    assert "44.0 ± 0.4 N" in told.what
    small = LoadStated("load 0.5 N", False, 0.5).fault_text(np.array([0.1]), np.array([0.02]))
    assert "seems to be 0.55 ± 0.02 N" in small.what


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        (LoadStated, {"loads_N": (40.0,)}),
        (LoadStated, {"torques": "none"}),
        (ToolStated, {"torques": "none"}),
        (ToolStated, {"tool_kg": 0.0}),
        (GravityStated, {"torques": "logged", "gravity_m_s2": (0.0, 0.0, -9.81)}),
        (GravityStated, {"torques": "masses"}),
    ],
)
def test_what_nothing_could_show_is_not_sought(kind, changes):
    assert of(kind, **changes) == []


def test_the_tool_of_a_campaign_is_told_with_its_campaign():
    assert place_in_words("tool@wrist_a") == "the tool of wrist_a"
    assert place_in_words("tool") == "the tool"
