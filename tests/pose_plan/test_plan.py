"""A plan of poses: within all limits, better than chance, refused in one message."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.arm.chain import Chain, end_pose
from pa10cal.arm.workspace import Box, PosturePoints
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.observe.kinds import instruments
from pa10cal.pose_plan.expected import expected_rows
from pa10cal.pose_plan.options import PlanOptions
from pa10cal.pose_plan.plan import plan_poses
from pa10cal.pose_plan.setup import PlanSetup

FEW = {"candidates": 150, "effects": 0.0}


def option(**keys):
    return PlanOptions(**{**FEW, **keys})


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("instrument", sorted(instruments()))
def test_every_instrument_gets_a_plan_that_beats_chance(instrument):
    poses = 40 if instrument == "distance" else 15
    plan = plan_poses(load_arm("irb120"), instrument, poses, option())
    assert len(plan) == poses
    assert len(np.unique(plan.q, axis=0)) == poses
    assert not plan.expected.not_identified
    assert np.all(np.diff(plan.expected.criterion) > 0.0)
    assert plan.expected.tool.plan_mm < plan.expected.tool.random_mm
    assert all(each.std > 0.0 for each in plan.expected.parameters.values())
    low, high = PlanSetup(plan.arm, plan.kind, plan.options).joint_ranges
    assert np.all((plan.q >= low - 1e-5) & (plan.q <= high + 1e-5))


def test_all_poses_keep_to_every_limit():
    arm = load_arm("ur10")
    options = option(
        workspace_mm=((-900, -900, 100), (900, 900, 1200)),
        reach_mm=1000,
        keep_out=[{"min_mm": (300, -2000, -2000), "max_mm": (500, 2000, 500), "name": "wall"}],
        instrument_at_mm=(3000, 0, 500),
        facing_deg=70,
        targets_mm=((0, 0, 50), (40, 0, 50), (0, 40, 50)),
    )
    plan = plan_poses(arm, "points", 20, options)
    targets_m = 1e-3 * np.array(options.targets_mm)
    at = PosturePoints.of(Chain.of(arm), plan.q, targets_m)
    first = at.p_base_targets[:, 0]
    assert plan.p_base_target_m == pytest.approx(first)
    assert np.all((first >= [-0.9, -0.9, 0.1]) & (first <= [0.9, 0.9, 1.2]))
    assert np.linalg.norm(first, axis=1).max() <= 1.0
    wall = Box(np.array([0.3, -2.0, -2.0]), np.array([0.5, 2.0, 0.5]))
    assert not wall.holds(at.p_base_tool).any()
    assert not wall.meets(np.array([3.0, 0.0, 0.5]), at.p_base_targets).any()
    way = np.array([3.0, 0.0, 0.5]) - at.p_base_targets
    cosine = np.einsum("pbi,pi->pb", way, at.T_base_ee[:, :3, 2]) / np.linalg.norm(way, axis=2)
    assert np.degrees(np.arccos(cosine.min())) <= 70.0 + 1e-9
    assert plan.expected.removed["line of sight"] > 0


def test_effects_count_where_they_are_wanted():
    arm = load_arm("irb120")
    assert not plan_poses(arm, "pose", 20, option()).expected.effects
    little, much = (plan_poses(arm, "pose", 20, option(effects=part)) for part in (1e-6, 0.9))
    assert len(much.expected.effects) > 10
    assert all(each.u_alone <= each.u_among_all + 1e-9 for each in much.expected.effects)
    before, after = (
        np.log([each.u_among_all for each in plan.expected.effects]).mean()
        for plan in (little, much)
    )
    assert after < before
    assert much.expected.tool.plan_mm > little.expected.tool.plan_mm


def test_loads_show_springs_and_there_are_candidates_for_every_pose():
    plan = plan_poses(load_arm("gx4_351s"), "pose", 80, option(floor_mm=None))
    assert plan.expected.candidates == 3 * 80
    arm, two = load_arm("pa10_6ce"), {"tool_kg": 2.0, "loads_N": (0.0, 44.0)}
    once, loaded = (plan_poses(arm, "pose", 15, option(**keys)) for keys in ({}, two))
    assert loaded.expected.springs
    of_loaded, of_once = (plan.expected.parameters["windup_2"].std for plan in (loaded, once))
    assert of_loaded < of_once


def rows_expected(instrument, robot="irb120", count=20, **keys):
    setup = PlanSetup(load_arm(robot), instruments()[instrument], option(**keys))
    low, high = setup.joint_ranges
    q = np.random.default_rng(1).uniform(low, high, (count, len(low)))
    return setup, q, expected_rows(setup, q, CalibrationOptions())


@pytest.mark.parametrize("instrument", ["pose", "points", "touch_trigger_cmm"])
def test_the_position_expected_is_that_of_the_first_target(instrument):
    targets_mm = ((80, 0, 50), (-60, 40, 50), (0, -70, 90))
    targets_mm = targets_mm[:1] if instrument == "pose" else targets_mm
    setup, q, rows = rows_expected(instrument, targets_mm=targets_mm)
    chain, step = Chain.of(setup.arm), 1e-6
    place = np.append(1e-3 * np.array(targets_mm[0]), 1.0)
    for name in ("a_2", "theta_3", "alpha_5"):
        coordinates = np.stack([chain.coordinates(q)] * 2)
        coordinates[:, :, chain.columns((name,))] += np.array([-step, step])[:, None, None]
        before, after = ((end_pose(chain, each) @ place)[:, :3] for each in coordinates)
        k = [parameter.name for parameter in rows.parameters].index(f"delta_{name}")
        np.testing.assert_allclose(
            rows.target_jacobian[:, :, k] / rows.sizes[k],
            (after - before) / (2.0 * step),
            atol=1e-7,
        )


def test_the_position_expected_is_that_under_the_least_load_in_whatever_order():
    tool = {"tool_kg": 2.0, "targets_mm": ((80, 0, 50),)}
    one, other = (
        rows_expected("pose", "pa10_6ce", loads_N=loads_N, **tool)[2]
        for loads_N in ((0.0, 60.0), (60.0, 0.0))
    )
    assert one.springs
    np.testing.assert_allclose(one.target_jacobian, other.target_jacobian, atol=1e-12)


def test_what_rounding_leaves_is_no_effect():
    # The tool hangs on the axis of the last joint, which carries no torque then.
    _, _, rows = rows_expected("pose", "ur10", effects=0.5, tool_kg=2.0)
    kinds_at_joint_6 = {effect.id for effect in rows.effects if effect.of == "joint 6"}
    assert "lateral_compliance" in kinds_at_joint_6
    assert "joint_compliance" not in kinds_at_joint_6


@pytest.mark.slow_but_one_in(9)
@pytest.mark.parametrize(
    ("instrument", "poses", "options", "words"),
    [
        ("pose", 4, {}, ["fewer equations than unknowns", "at least 5 poses"]),
        ("distance", 10, {}, ["fewer equations than unknowns", "at least"]),
        ("point", 20, {}, ["no such instrument", "points"]),
        ("pose", 20, {"reach_mm": 10}, ["no pose is left", "reach_mm: 9"]),
        ("touch_trigger_cmm", 20, {"targets_mm": ((0, 0, 9),) * 3}, ["not give an orientation"]),
        ("touch_trigger_cmm", 20, {"targets_mm": ((0, 0, 9),)}, ["three or more"]),
        ("pose", 20, {"joints_deg": ((0, 1),)}, ["not one range a joint"]),
        ("pose", 20, {"largest_angle_deg": 1, "limit_margin": 0.49}, ["joint 3", "18.2 or more"]),
        ("pose", 20, {"joints_deg": ((0, 999), *[(0, 10)] * 5)}, ["leaves the joint's limits"]),
        (
            "pose",
            20,
            {"keep_out": [{"min_mm": (-5e3,) * 3, "max_mm": (5e3,) * 3, "name": "hall"}]},
            ["no pose is left", "keep-out 1 (hall)"],
        ),
    ],
)
def test_what_cannot_be_planned_is_refused_in_one_message(instrument, poses, options, words):
    with pytest.raises(CalibrationError) as refused:
        plan_poses(load_arm("irb120"), instrument, poses, option(**options))
    assert all(each in str(refused.value) for each in words), str(refused.value)


def on_a_rail(arm, stroke_m):
    """Return an arm whose first joint is a rail."""
    slides = np.array([True, *[False] * (arm.n - 1)])
    limits = arm.limits_rad.copy()
    limits[0] = 0.0, stroke_m
    return replace(arm, prismatic=slides, limits_rad=limits)


def test_a_rail_is_no_reach_of_the_arm_that_it_carries():
    arm = load_arm("ur10")
    limits = PlanSetup(on_a_rail(arm, 50.0), instruments()["points"], option()).constraints
    assert "the tool off the base's axis" not in limits
    assert (
        "the tool off the base's axis"
        in PlanSetup(arm, instruments()["points"], option()).constraints
    )
    plan = plan_poses(on_a_rail(arm, 50.0), "points", 30, option())
    assert len(plan) == 30


def test_targets_too_near_the_links_are_told_what_to_state():
    near = {"targets_mm": ((0, 0, 1), (1, 0, 1), (0, 1, 1)), "floor_mm": None}
    with pytest.raises(CalibrationError, match="state targets further from the flange"):
        plan_poses(load_arm("gx4_351s"), "points", 20, option(**near))
