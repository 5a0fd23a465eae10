"""One individual of any described arm, standing before an instrument with targets on its flange."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.cell.apparatus import LOAD_POINT_M
from pa10cal.cell.built import Departures, Springs
from pa10cal.cell.individual import draw_springs
from pa10cal.cell.linkage import Linkage, Payload
from pa10cal.errors import SimulationError
from pa10cal.settings import SightedPlan

Array = NDArray[np.float64]

#: Targets as designed: on a ring around the flange's axis, every other one further out.
RING_RADIUS_M = 0.100
RING_HEIGHTS_M = (0.100, 0.140)
TOOL_COM_M = np.array([0.0, 0.0, 0.060])
#: How far the robot stands from the origin of the instrument, in any direction.
STAND_OFF_M = (1.5, 2.5)

_MOTIONS = ("x", "y", "z", "rx", "ry", "rz")
_LINK_DEPARTURE = re.compile(r"delta_(a|alpha|d|theta|beta)_([1-9][0-9]*)")
_FRAME_DEPARTURE = re.compile(r"(base|tool)_(r?[xyz])")


@dataclass(frozen=True)
class Targets:
    """B targets on the flange; places in the end-effector frame.

    Attributes:
        names: B names.
        p_ee_m: (B, 3) where they are.
        p_ee_stated_m: (B, 3) where the campaign says they are.
    """

    names: tuple[str, ...]
    p_ee_m: Array
    p_ee_stated_m: Array

    @classmethod
    def designed(cls, count: int) -> Targets:
        """Return `count` targets that are where the campaign says."""
        turn = 2.0 * np.pi * np.arange(count) / count
        places_m = np.column_stack(
            [
                RING_RADIUS_M * np.cos(turn),
                RING_RADIUS_M * np.sin(turn),
                np.resize(RING_HEIGHTS_M, count),
            ]
        ).round(6)
        return cls(tuple(f"T{number}" for number in range(1, count + 1)), places_m, places_m)


@dataclass(frozen=True)
class IndividualArm:
    """One individual arm: the truth behind any number of campaigns.

    Attributes:
        arm: the arm as its maker describes it.
        linkage: its joints, links and springs as they are.
        T_instr_base: (4, 4) its base in the instrument's frame [m].
        T_ee_target: (4, 4) the target of a tracker of poses, in the end-effector frame [m]; the
            campaign says that it is the end-effector frame itself.
        targets: targets of the other instruments.
    """

    arm: Arm
    linkage: Linkage
    T_instr_base: Array
    T_ee_target: Array
    targets: Targets

    def forward(self, q: Array, load_N: Array | float = 0.0) -> Array:
        """Return the true T_base_ee (P, 4, 4) [m] with the motors at `q`, springs deflected.

        Args:
            q: (P, n) positions of the motors [rad, or m of a sliding joint].
            load_N: (P,) or one weight at the load point.
        """
        return self.linkage.rest(q, np.broadcast_to(load_N, len(q))).T_base_ee

    def T_instr_target(self, T_base_ee: Array) -> Array:
        """Return what a tracker would see of end-effector poses (P, 4, 4), without its noise."""
        T: Array = self.T_instr_base @ T_base_ee @ self.T_ee_target
        return T

    def p_instr_targets_m(self, T_base_ee: Array) -> Array:
        """Return the places of the targets (P, B, 3) in the instrument's frame."""
        T_instr_ee = self.T_instr_base @ T_base_ee
        along = np.einsum("pij,bj->pbi", T_instr_ee[:, :3, :3], self.targets.p_ee_m)
        places: Array = along + T_instr_ee[:, None, :3, 3]
        return places

    def d_m(self, T_base_ee: Array) -> Array:
        """Return the distances (P,) of the first target from the instrument's origin."""
        distances: Array = np.linalg.norm(self.p_instr_targets_m(T_base_ee)[:, 0], axis=1)
        return distances


def draw_individual(arm: Arm, plan: SightedPlan, rng: np.random.Generator) -> IndividualArm:
    """Draw one individual: axes off in every direction, springs, base, places of the targets.

    Args:
        arm: its description; with masses where joints are flexible or loads hang.
        plan: how far it departs, its flexible joints, its tool and targets.
        rng: draws it.

    Raises:
        SimulationError: for a flexible joint that does not exist, slides or has no rated torque,
            or of an arm without masses.
    """
    geometry, stiffness = rng.spawn(2)  # springs or none, the geometry is the same
    linkage = Linkage.of(
        arm, Departures.none(arm.n), _payload(plan), _springs(arm, plan, stiffness)
    )
    turn_rad = np.array([plan.axis_rad, plan.axis_rad, plan.zero_rad])
    placements = linkage.placements @ _small_motions(arm.n, plan.axis_m, turn_rad, geometry)
    T_last_ee = linkage.T_last_ee @ _small_motions(1, plan.axis_m, plan.axis_rad, geometry)[0]
    T_instr_base = _anywhere(geometry)
    designed = Targets.designed(_target_count(plan))
    return IndividualArm(
        arm=arm,
        linkage=replace(linkage, placements=placements, T_last_ee=T_last_ee),
        T_instr_base=T_instr_base,
        T_ee_target=_small_motions(1, plan.target_m, plan.target_rad, geometry)[0],
        targets=replace(
            designed,
            p_ee_m=geometry.normal(designed.p_ee_m, plan.target_m),
        ),
    )


def individual_from_departures(
    arm: Arm,
    departures: Mapping[str, float],
    *,
    plan: SightedPlan | None = None,
    springs: Springs | None = None,
    T_instr_base: Array | None = None,
    targets: Targets | None = None,
) -> IndividualArm:
    """Build the individual that departs from its description by exactly the named parameters.

    Args:
        arm: its description.
        departures: by name [m, rad]: `delta_a_k`, `delta_alpha_k`, `delta_d_k`, `delta_theta_k`,
            `delta_beta_k` of row k; `base_x`, `base_y`, `base_z`, `base_rx`, `base_ry`, `base_rz`
            and the same of `tool`: shifts along x, y, z, then turns about the moved x, y, z. The
            base moves outside the arm's constant frame before its first row; the tool moves the
            end-effector frame, behind the constant one.
        plan: gives the tool's mass and the number of targets; None for the defaults.
        springs: its springs; None for none.
        T_instr_base: (4, 4) where its base would be without departures; None for the instrument's
            own frame.
        targets: its targets, in the end-effector frame; None for such as are where the campaign
            says.

    Raises:
        SimulationError: for a name that is not one of these.
    """
    plan = SightedPlan() if plan is None else plan
    rows = Departures.none(arm.n)
    columns = {field.name.rsplit("_", 1)[0]: getattr(rows, field.name) for field in fields(rows)}
    frames = {"base": dict.fromkeys(_MOTIONS, 0.0), "tool": dict.fromkeys(_MOTIONS, 0.0)}
    for name, value in departures.items():
        link, frame = _LINK_DEPARTURE.fullmatch(name), _FRAME_DEPARTURE.fullmatch(name)
        if link and int(link[2]) <= arm.n:
            columns[link[1]][int(link[2]) - 1] = value
        elif frame:
            frames[frame[1]][frame[2]] = value
        else:
            raise SimulationError(
                "no such departure",
                where="departures",
                value=name,
                allowed=f"delta_a_k, delta_alpha_k, delta_d_k, delta_theta_k, delta_beta_k with "
                f"k from 1 to {arm.n}; base_x … base_rz, tool_x … tool_rz",
                remedy="correct the name",
            )
    linkage = Linkage.of(arm, rows, _payload(plan), springs or Springs.rigid(arm.n))
    stands = np.eye(4) if T_instr_base is None else T_instr_base
    return IndividualArm(
        arm=arm,
        linkage=replace(linkage, T_last_ee=linkage.T_last_ee @ _in_turn(frames["tool"])),
        T_instr_base=stands @ _in_turn(frames["base"]),
        T_ee_target=np.eye(4),
        targets=Targets.designed(_target_count(plan)) if targets is None else targets,
    )


def _springs(arm: Arm, plan: SightedPlan, rng: np.random.Generator) -> Springs:
    if not plan.flexible_joints:
        return Springs.rigid(arm.n)
    if arm.mass_kg is None:
        raise SimulationError(
            "the arm has no masses, so gravity cannot load its springs",
            where=f"robot {arm.name}",
            allowed="an arm description with mass_kg and com_m, or no flexible joints",
            remedy="add them to the description or name no flexible_joints",
        )
    springs = draw_springs(arm, plan.flexible_joints, rng)
    return springs if plan.hardening else replace(springs, k_cub=np.zeros(arm.n))


def _target_count(plan: SightedPlan) -> int:
    return plan.targets if plan.instrument == "points" else 1


def _payload(plan: SightedPlan) -> Payload:
    return Payload(plan.tool_mass_kg, TOOL_COM_M, LOAD_POINT_M)


def _in_turn(motions: Mapping[str, float]) -> Array:
    """Return (4, 4): shifts, then turns about the moved x, y and z."""
    turns = [pin.rpy.rotate(axis, motions[f"r{axis}"]) for axis in "xyz"]
    T = np.eye(4)
    T[:3, :3] = turns[0] @ turns[1] @ turns[2]
    T[:3, 3] = [motions[axis] for axis in "xyz"]
    return T


def _small_motions(
    count: int, shift_m: float, turn_rad: Array | float, rng: np.random.Generator
) -> Array:
    """Draw (count, 4, 4) motions: shifts and rotation vectors with these standard deviations."""
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, 3] = shift_m * rng.standard_normal((count, 3))
    T[:, :3, :3] = Rotation.from_rotvec(turn_rad * rng.standard_normal((count, 3))).as_matrix()
    return T


def _anywhere(rng: np.random.Generator) -> Array:
    """Draw the (4, 4) base in the instrument's frame: any attitude, any direction, some way off."""
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    direction = rng.standard_normal(3)
    T[:3, 3] = rng.uniform(*STAND_OFF_M) * direction / np.linalg.norm(direction)
    return T
