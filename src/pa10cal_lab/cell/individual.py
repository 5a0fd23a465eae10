"""Individual robots: the paper's, drawn from tolerances, or of unstated lengths and weights."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm, with_hayati_rows
from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import SimulationError
from pa10cal.options import Tolerances
from pa10cal_lab.cell.mechanism import Departures, Mechanism
from pa10cal_lab.cell.options import SimulateOptions, SlideOptions, TrackerOptions, UnstatedOptions
from pa10cal_lab.cell.poses import centre_rad
from pa10cal_lab.cell.robot import (
    BALLS_DESIGN_M,
    Robot,
    Springs,
    apparatus_payload,
    draw_balls,
    ring_of_targets,
    tool_payload,
)

KcubReading = Literal["text_e7", "table_e8"]

PAPER_ROBOT = "pa10_6ce"
#: Table I of the paper. It gives beta in the row of joint 2, in place of a departure of d.
TABLE_1 = Departures(
    a_m=1e-3 * np.array([0.33, -0.46, 1.09, -0.48, -0.30, -3.44]),
    alpha_rad=np.array([-4.9e-4, 1.2e-4, -2.3e-3, 2.1e-4, 3.7e-5, -7.1e-4]),
    d_m=1e-3 * np.array([0.09, 0.0, 1.26, 0.22, 0.10, 0.17]),
    theta_rad=np.array([-5.9e-3, -7.8e-3, 2.9e-3, 8.1e-3, -1.5e-3, 1.3e-2]),
    beta_rad=np.array([0.0, -1.0e-3, 0.0, 0.0, 0.0, 0.0]),
)
TABLE_1_K_LIN = np.array([np.inf, 1.98e4, 1.27e4, np.inf, 2.56e3, np.inf])
#: Section III.B prints the cubic stiffnesses ten times smaller than Table I.
PAPER_K_CUB: dict[KcubReading, Array] = {
    "text_e7": np.array([0.0, 3.35e7, 1.46e7, 0.0, 3.83e7, 0.0]),
    "table_e8": np.array([0.0, 3.35e8, 1.46e8, 0.0, 3.84e8, 0.0]),
}

#: Middle of the balls in the measuring machine, its standard deviation, and that of the base's
#: tilt.
_MACHINE_MIDDLE_M = np.array([0.40, 0.40, 0.40])
_MACHINE_MIDDLE_SPREAD_M = 0.02
_TILT_RAD = 4e-3
#: Stiffness of a drawn robot's joints over their rated torques [1/rad], its standard deviation in
#: the logarithm, and k_cub over k_lin. Those of the paper's harmonic drives are 85 to 177 per
#: radian, with hardening by 1 to 19 % at 5 mrad.
_K_LIN_PER_RATED = 120.0
_K_LIN_SPREAD = 0.25
_K_CUB_PER_K_LIN = 1700.0


def build_robot(
    arm: Arm, settings: SimulateOptions, kcub_reading: KcubReading, rng: np.random.Generator
) -> Robot:
    """Build one robot with its tool, in front of the instrument.

    Args:
        arm: its description; with masses where joints are flexible or loads hang.
        settings: of its campaign: deviations, springs, tool and errors of masses; for touched balls
            also the middle of the grid, which is put into the middle of the measuring machine.
        kcub_reading: which of the paper's two cubic stiffnesses is used.
        rng: draws it.

    Raises:
        SimulationError: for springs or touched balls of an arm without masses or rated torques, a
            flexible joint that does not exist or slides, Table I on another robot, or mass factors
            that are not as many as the links.
    """
    if settings.without_touches is not None:
        return draw_individual(arm, settings.without_touches, rng, settings.mass_factor)
    need_masses(arm, "an arm description with mass_kg and com_m")
    refuse_unrated(arm, range(1, arm.n + 1), "robot")
    if settings.built == "table_1":
        departures, springs = _paper_robot(arm, kcub_reading)
    else:
        departures = draw_departures(arm, rng)
        springs = draw_springs(arm, settings.flexible_joints, rng)
    balls = draw_balls(settings.noise.apparatus_mm, rng)
    payload = apparatus_payload()
    nominal = Mechanism.of(arm, Departures.none(arm.n), payload)
    T_base_middle = nominal.T_base_ee(centre_rad(arm, settings.poses)[None])[0]
    p_base_middle_m = (T_base_middle @ np.append(BALLS_DESIGN_M.mean(axis=0), 1.0))[:3]
    return Robot(
        arm=arm,
        mechanism=Mechanism.of(
            arm, departures, payload, _true_masses_kg(arm, settings.mass_factor)
        ),
        springs=springs,
        T_instr_base=_in_machine(p_base_middle_m, rng),
        targets=balls,
        T_ee_target=np.eye(4),
        departures=departures,
    )


def draw_individual(
    arm: Arm, plan: TrackerOptions, rng: np.random.Generator, mass_factor: tuple[float, ...] = ()
) -> Robot:
    """Draw one robot in front of a tracker: geometry, springs, base, targets; see `build_robot`."""
    geometry, stiffness = rng.spawn(2)  # so that geometry is the same with or without springs
    own = plan.unstated
    arm = arm if own is None else described(arm, own)
    springs = Springs.rigid(arm.n)
    if plan.flexible_joints:
        need_masses(arm, "an arm description with mass_kg and com_m, or no flexible joints")
        springs = draw_springs(arm, plan.flexible_joints, stiffness)
        springs = springs if plan.hardening else replace(springs, k_cub=np.zeros(arm.n))
    departures = draw_departures(arm, geometry) if plan.departs == "rows" else None
    mechanism = Mechanism.of(
        arm,
        departures or Departures.none(arm.n),
        tool_payload(plan.tool_mass_kg),
        _true_masses_kg(arm, mass_factor),
    )
    mechanism = mechanism if own is None else weighed(mechanism, own)
    if departures is None:
        turn_rad = np.array([plan.axis_rad, plan.axis_rad, plan.zero_rad])
        axes = _small_motions(arm.n, plan.axis_m, turn_rad, geometry)
        flange = _small_motions(1, plan.axis_m, plan.axis_rad, geometry)[0]
        mechanism = replace(
            mechanism,
            placements=mechanism.placements @ axes,
            T_last_ee=mechanism.T_last_ee @ flange,
        )
    turned = Rotation.random(rng=geometry).as_matrix()  # base and instrument in any orientation
    direction = geometry.standard_normal(3)
    off_m = geometry.uniform(*plan.stand_off_m) * direction / np.linalg.norm(direction)
    T_instr_base = homogeneous(turned, off_m)
    T_ee_target = _small_motions(1, plan.target_m, plan.target_rad, geometry)[0]
    designed = ring_of_targets(plan.target_count)
    targets = replace(designed, p_ee_m=geometry.normal(designed.p_ee_m, plan.target_m))
    return Robot(arm, mechanism, springs, T_instr_base, targets, T_ee_target, departures)


def draw_departures(arm: Arm, rng: np.random.Generator) -> Departures:
    """Draw deviations of every row from the manufacturing tolerances."""
    tolerance = Tolerances()
    hayati = arm.hayati.astype(float)
    return Departures(
        a_m=rng.normal(0.0, tolerance.a_m, arm.n),
        alpha_rad=rng.normal(0.0, tolerance.alpha_rad, arm.n),
        d_m=rng.normal(0.0, tolerance.d_m, arm.n) * (1.0 - hayati),
        theta_rad=rng.normal(0.0, tolerance.theta_rad, arm.n),
        beta_rad=rng.normal(0.0, tolerance.beta_rad, arm.n) * hayati,
    )


def draw_springs(arm: Arm, flexible_joints: tuple[int, ...], rng: np.random.Generator) -> Springs:
    """Draw springs from the rated torques of an arm.

    Args:
        flexible_joints: from 1; the others are rigid.

    Raises:
        SimulationError: when a joint is named that does not exist, slides, or has no rated torque.
    """
    turning = (np.flatnonzero(~arm.prismatic) + 1).tolist()
    unfit = [joint for joint in flexible_joints if joint not in turning]
    if unfit:
        what = "a flexible joint slides" if unfit[0] <= arm.n else "a flexible joint does not exist"
        turn = ", ".join(map(str, turning))
        raise SimulationError(
            what,
            where="flexible_joints",
            value=unfit[0],
            allowed=f"revolute joints of {arm.name}: {turn}",
            remedy="name joints of this robot",
        )
    refuse_unrated(arm, flexible_joints, "flexible_joints")
    spread = np.exp(rng.normal(0.0, _K_LIN_SPREAD, arm.n))
    hardening = np.exp(rng.normal(0.0, _K_LIN_SPREAD, arm.n))
    k_lin = _K_LIN_PER_RATED * arm.torque_limit_Nm * spread
    flexible = np.isin(np.arange(1, arm.n + 1), flexible_joints)
    return Springs(
        np.where(flexible, k_lin, np.inf),
        np.where(flexible, _K_CUB_PER_K_LIN * k_lin * hardening, 0.0),
        "drawn",
    )


def refuse_unrated(arm: Arm, joints: Iterable[int], where: str) -> None:
    """Refuse an arm some of whose joints, from 1, have no rated torque."""
    unrated = [joint for joint in joints if np.isnan(arm.torque_limit_Nm[joint - 1])]
    if unrated:
        raise SimulationError(
            "a joint has no rated torque, which the size of springs and torque noise goes by",
            where=where,
            value=f"joint {unrated[0]} of {arm.name}",
            allowed="an arm description with rated torques",
            remedy="add them to the description, or request no springs and torques",
        )


def need_masses(arm: Arm, allowed: str) -> None:
    """Refuse an arm whose description has no masses."""
    if arm.mass_kg is None or arm.com_m is None:
        raise SimulationError(
            "the arm has no masses, so gravity loads neither springs nor motors",
            where=f"robot {arm.name}",
            allowed=allowed,
            remedy="add them to the description or choose another robot",
        )


def _true_masses_kg(arm: Arm, factor: tuple[float, ...]) -> Array | None:
    """Return the true masses of the links; None where none are described."""
    if factor and len(factor) != arm.n:
        raise SimulationError(
            f"{len(factor)} mass factors for {arm.n} links",
            where="mass_factor",
            value=factor,
            allowed=f"{arm.n} factors, or none",
            remedy="give one factor a link",
        )
    return arm.mass_kg if arm.mass_kg is None or not factor else arm.mass_kg * np.array(factor)


def _paper_robot(arm: Arm, kcub_reading: KcubReading) -> tuple[Departures, Springs]:
    if arm.name != PAPER_ROBOT:
        raise SimulationError(
            "Table I belongs to another robot",
            where="robot",
            value=arm.name,
            allowed=f"{PAPER_ROBOT} with built: table_1",
            remedy="set built: drawn",
        )
    return TABLE_1, Springs(TABLE_1_K_LIN, PAPER_K_CUB[kcub_reading], kcub_reading)


def _in_machine(p_base_middle_m: Array, rng: np.random.Generator) -> Array:
    """Draw the base in the machine: at any angle about the vertical, and with a small tilt."""
    roll, pitch = rng.normal(0.0, _TILT_RAD, 2)
    R = Rotation.from_euler("xyz", [roll, pitch, rng.uniform(-np.pi, np.pi)]).as_matrix()
    p_instr_middle_m = _MACHINE_MIDDLE_M + rng.normal(0.0, _MACHINE_MIDDLE_SPREAD_M, 3)
    return homogeneous(R, p_instr_middle_m - R @ p_base_middle_m)


def _small_motions(
    count: int, shift_m: float, turn_rad: Array | float, rng: np.random.Generator
) -> Array:
    """Draw (count, 4, 4) motions: shifts and rotation vectors with these standard deviations."""
    shifts_m = shift_m * rng.standard_normal((count, 3))
    turns = Rotation.from_rotvec(turn_rad * rng.standard_normal((count, 3)))
    return homogeneous(turns.as_matrix(), shifts_m)


# Arms of which a campaign describes the geometry only: their lengths and their true weights.
#
# The model of the weights differs from the estimator's on purpose: masses decrease from joint to
# joint, whatever the lengths of the links, and centres of mass lie anywhere along a link, or behind
# its joint like a counterbalance.

#: Name of such an arm in its campaign.
NAME = "own_arm"
#: Reach [m], and standard deviation of the factor of a row about that of the arm, in the logarithm.
REACH_M = (0.3, 3.5)
_ROW_SCATTER = 0.15
#: Mass of an arm of 1 m reach [kg], and the power of the reach in the mass of others.
MASS_KG = (8.0, 60.0)
_POWER = (2.5, 3.0)
#: Decrease of the logarithm of mass from link to link, its standard deviation, and the tool's
#: share.
_TAPER = (0.1, 0.6)
_MASS_SCATTER = 0.35
TOOL_SHARE = (0.01, 0.08)
#: Centre of a link over the distance to the next joint, negative for a share of counterbalanced
#: links; its standard deviation per axis over the link's length, and over the reach.
_ALONG = (0.15, 0.75)
_BEHIND = (-0.35, 0.0)
_COUNTERBALANCED = 0.2
_ASIDE = (0.08, 0.01)
#: Mass of the carriage of a rail or a column over that of the arm.
_CARRIAGE = (0.1, 0.5)


def described(arm: Arm, own: UnstatedOptions) -> Arm:
    """Return the arm as the campaign describes it: its lengths, without weights and drives.

    Raises:
        SimulationError: where there are not as many lengths or weights as rows.
    """
    if own.slide is not None:
        arm = _on_slide(arm, own.slide)
    for name in ("lengths", "mass_kg", "com_m"):
        if len(getattr(own, name)) != arm.n:
            raise SimulationError(
                f"{len(getattr(own, name))} entries for {arm.n} rows",
                where=f"without_touches.unstated.{name}",
                allowed=f"{arm.n} entries, one a row",
                remedy="give one a row",
            )
    factor = np.array(own.lengths)
    base, tool = arm.T_base_row1.copy(), arm.T_row_n_ee.copy()
    base[:3, 3] *= factor[0]
    tool[:3, 3] *= factor[-1]
    unknown = np.full(arm.n, np.nan)
    return replace(
        arm,
        name=NAME,
        title="an arm without stated masses",
        a_m=(factor * arm.a_m).round(5),
        d_m=(factor * arm.d_m).round(5),
        limits_rad=np.where(
            arm.prismatic[:, None], factor[:, None] * arm.limits_rad, arm.limits_rad
        ),
        gear_ratio=unknown,
        torque_limit_Nm=unknown,
        mass_kg=None,
        com_m=None,
        T_base_row1=base,
        T_row_n_ee=tool,
    )


def _on_slide(arm: Arm, slide: SlideOptions) -> Arm:
    """Return an arm with a slide as a further joint before its first."""
    if (arm.T_base_row1 != np.eye(4)).any() or arm.convention != "standard":
        raise SimulationError(
            "the arm has a frame of its own before its first row, or modified rows",
            where="without_touches.unstated.slide",
            value=arm.name,
            allowed="an arm in standard rows that start at its base",
            remedy="describe it so, with the slide as its first row",
        )
    zero, turned = np.zeros(1), slide.kind != "column"
    along = Rotation.from_euler("x", 0.5 * np.pi if slide.kind == "rail" else 0.0)
    carriage = {
        **dict.fromkeys(("theta_rad", "d_m", "a_m", "beta_rad"), zero),
        "alpha_rad": np.array([-0.5 * np.pi if turned else 0.0]),
        "hayati": np.array([False]),
        "prismatic": np.array([True]),
        "limits_rad": np.array([[0.0, slide.stroke_m]]),
        **dict.fromkeys(("gear_ratio", "torque_limit_Nm"), np.array([np.nan])),
    }
    rows: dict[str, Any] = {
        name: np.concatenate([first, getattr(arm, name)]) for name, first in carriage.items()
    }
    base = homogeneous(along.as_matrix(), np.zeros(3))
    return with_hayati_rows(replace(arm, T_base_row1=base, mass_kg=None, com_m=None, **rows))


def weighed(mechanism: Mechanism, own: UnstatedOptions) -> Mechanism:
    """Return a mechanism with the true weights of its links."""
    return replace(mechanism, mass_kg=np.array(own.mass_kg), com_m=np.array(own.com_m))


def nominal(arm: Arm, own: UnstatedOptions, tool_kg: float) -> Mechanism:
    """Return the mechanism of the described geometry with the true weights."""
    arm = described(arm, own)
    bare = Mechanism.of(arm, Departures.none(arm.n), tool_payload(tool_kg))
    return weighed(bare, own)


def draw_unstated(arm: Arm, rng: np.random.Generator) -> tuple[UnstatedOptions, float]:
    """Draw lengths and weights of an arm, and the mass of its tool [kg]."""
    reach_m = float(np.exp(rng.uniform(*np.log(REACH_M))))
    rows = np.exp(rng.normal(0.0, _ROW_SCATTER, arm.n))
    bare = {"mass_kg": np.zeros(arm.n), "com_m": np.zeros((arm.n, 3))}
    scattered = described(arm, _own(lengths=rows, **bare))
    lengths = (reach_m / scattered.reach_m * rows).round(4)

    total_kg = np.exp(rng.uniform(*np.log(MASS_KG))) * reach_m ** rng.uniform(*_POWER)
    fall = np.exp(-rng.uniform(*_TAPER) * np.arange(arm.n))
    shares = fall * np.exp(rng.normal(0.0, _MASS_SCATTER, arm.n))
    mass_kg = total_kg * shares / shares.sum()

    mechanism = nominal(arm, _own(lengths=lengths, **bare), 0.0)
    ends_m = np.concatenate([mechanism.placements[1:], mechanism.T_last_ee[None]])[:, :3, 3]
    behind = rng.random(arm.n) < _COUNTERBALANCED
    along = np.where(behind, rng.uniform(*_BEHIND, arm.n), rng.uniform(*_ALONG, arm.n))
    aside_m = _ASIDE[0] * np.linalg.norm(ends_m, axis=1) + _ASIDE[1] * reach_m
    com_m = along[:, None] * ends_m + aside_m[:, None] * rng.standard_normal((arm.n, 3))
    tool_kg = float(total_kg * np.exp(rng.uniform(*np.log(TOOL_SHARE))))
    own = _own(lengths=lengths, mass_kg=mass_kg.round(4), com_m=com_m.round(4))
    return own, round(tool_kg, 3)


def put_on_slide(
    own: UnstatedOptions, slide: SlideOptions, rng: np.random.Generator
) -> UnstatedOptions:
    """Return lengths and weights of an arm on a carriage, whose weight is drawn."""
    total_kg = sum(own.mass_kg)
    centre_m = rng.normal(0.0, 0.05 * slide.stroke_m, 3).round(4).tolist()
    return own.model_copy(
        update={
            "lengths": (1.0, *own.lengths),
            "mass_kg": (round(total_kg * float(rng.uniform(*_CARRIAGE)), 4), *own.mass_kg),
            "com_m": (tuple(centre_m), *own.com_m),
            "slide": slide,
        }
    )


def _own(**arrays: Array) -> UnstatedOptions:
    """Return arrays as options."""
    return UnstatedOptions.model_validate({name: array.tolist() for name, array in arrays.items()})
