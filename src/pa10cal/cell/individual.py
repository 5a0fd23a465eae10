"""One individual robot: the paper's, or one drawn from manufacturing tolerances."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.cell.apparatus import BALLS_DESIGN_M, make_apparatus
from pa10cal.cell.built import BuiltRobot, Departures, Springs
from pa10cal.cell.mechanism import Mechanism
from pa10cal.cell.poses import centre_rad
from pa10cal.errors import SimulationError
from pa10cal.settings import SimulateSettings, ToleranceSettings

Array = NDArray[np.float64]
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

#: Where the balls are in the measuring machine, and how level the robot stands.
_CMM_MIDDLE_M = np.array([0.40, 0.40, 0.40])
_CMM_MIDDLE_SPREAD_M = 0.02
_TILT_RAD = 4e-3

#: Joint stiffness a rated torque, and its spread, of a drawn robot; harmonic drives of the
#: paper's robot lie at 85 to 177 rated torques a radian, hardening by 1 to 19 % at 5 mrad.
_K_LIN_PER_RATED = 120.0
_K_LIN_SPREAD = 0.25
_K_CUB_PER_K_LIN = 1700.0


def build_robot(
    arm: Arm,
    settings: SimulateSettings,
    kcub_reading: KcubReading,
    rng: np.random.Generator,
) -> BuiltRobot:
    """Build one robot and stand it in front of the measuring machine.

    Args:
        arm: its description, with masses.
        settings: whether it is the paper's robot or a drawn one, how well its apparatus was
            measured, how far its masses are off, and the middle of the grid, which comes to the
            middle of the machine.
        kcub_reading: which of the paper's two cubic stiffnesses holds.
        rng: draws the base's place, the balls, and the departures where they are drawn.

    Raises:
        SimulationError: for an arm without masses or rated torques, for Table I on another robot,
            or for mass factors that are not as many as the links.
    """
    if arm.mass_kg is None or arm.com_m is None:
        raise SimulationError(
            "the arm has no masses, so gravity cannot load its springs",
            where=f"robot {arm.name}",
            allowed="an arm description with mass_kg and com_m",
            remedy="add them to the description or choose another robot",
        )
    refuse_unrated(arm, range(1, arm.n + 1), "robot")
    if settings.built == "table_1":
        departures, springs = _paper_robot(arm, kcub_reading)
    else:
        departures, springs = _drawn_robot(arm, settings.flexible_joints, rng)
    apparatus = make_apparatus(settings.noise.apparatus_mm, rng)
    nominal = Mechanism(arm, Departures.none(arm.n), arm.mass_kg, arm.com_m, apparatus)
    T_base_middle = nominal.T_base_ee(centre_rad(arm, settings.poses))
    p_base_middle_m = (T_base_middle @ np.append(BALLS_DESIGN_M.mean(axis=0), 1.0))[:3]
    return BuiltRobot(
        arm=arm,
        departures=departures,
        springs=springs,
        mass_kg=_true_masses_kg(arm.mass_kg, settings.mass_factor),
        com_m=arm.com_m,
        apparatus=apparatus,
        T_instr_base=_stand(p_base_middle_m, rng),
    )


def _true_masses_kg(described_kg: Array, factor: tuple[float, ...]) -> Array:
    if factor and len(factor) != len(described_kg):
        raise SimulationError(
            f"{len(factor)} mass factors for {len(described_kg)} links",
            where="mass_factor",
            value=factor,
            allowed=f"{len(described_kg)} factors, or none",
            remedy="give one factor a link",
        )
    return described_kg * np.array(factor) if factor else described_kg


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


def _drawn_robot(
    arm: Arm, flexible_joints: tuple[int, ...], rng: np.random.Generator
) -> tuple[Departures, Springs]:
    """Draw departures from the tolerances and springs from the rated torques."""
    tolerance = ToleranceSettings()
    hayati = arm.hayati.astype(float)
    departures = Departures(
        a_m=rng.normal(0.0, tolerance.a_m, arm.n),
        alpha_rad=rng.normal(0.0, tolerance.alpha_rad, arm.n),
        d_m=rng.normal(0.0, tolerance.d_m, arm.n) * (1.0 - hayati),
        theta_rad=rng.normal(0.0, tolerance.theta_rad, arm.n),
        beta_rad=rng.normal(0.0, tolerance.beta_rad, arm.n) * hayati,
    )
    return departures, draw_springs(arm, flexible_joints, rng)


def draw_springs(arm: Arm, flexible_joints: tuple[int, ...], rng: np.random.Generator) -> Springs:
    """Draw springs from the rated torques of an arm.

    Args:
        arm: gives the rated torques.
        flexible_joints: joints that yield, from 1; the others are rigid.
        rng: draws stiffness and hardening.

    Raises:
        SimulationError: when a joint is named that does not exist, slides, or has no rated torque.
    """
    turning = (np.flatnonzero(~arm.prismatic) + 1).tolist()
    unfit = [joint for joint in flexible_joints if joint not in turning]
    if unfit:
        raise SimulationError(
            "a flexible joint slides" if unfit[0] <= arm.n else "a flexible joint does not exist",
            where="flexible_joints",
            value=unfit[0],
            allowed=f"turning joints of {arm.name}: {', '.join(map(str, turning))}",
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
    """Refuse an arm some of whose joints, from 1, have no rated torque.

    Args:
        arm: gives the rated torques.
        joints: the joints that need one.
        where: what needs them, for the message.
    """
    unrated = [joint for joint in joints if np.isnan(arm.torque_limit_Nm[joint - 1])]
    if unrated:
        raise SimulationError(
            "a joint has no rated torque, which the size of springs and torque noise goes by",
            where=where,
            value=f"joint {unrated[0]} of {arm.name}",
            allowed="an arm description with rated torques",
            remedy="add them to the description or ask for no springs and torques",
        )


def _stand(p_base_middle_m: Array, rng: np.random.Generator) -> Array:
    """Return the base in the machine: turned any way about the vertical, and not quite level."""
    roll, pitch = rng.normal(0.0, _TILT_RAD, 2)
    T_instr_base = np.eye(4)
    T_instr_base[:3, :3] = pin.rpy.rpyToMatrix(roll, pitch, rng.uniform(-np.pi, np.pi))
    p_instr_middle_m = _CMM_MIDDLE_M + rng.normal(0.0, _CMM_MIDDLE_SPREAD_M, 3)
    T_instr_base[:3, 3] = p_instr_middle_m - T_instr_base[:3, :3] @ p_base_middle_m
    return T_instr_base
