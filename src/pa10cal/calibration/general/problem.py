"""The general model as a least-squares problem: which terms it has, and where it starts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.state import PoseStates
from pa10cal.arm.statics import Payload
from pa10cal.arm.weights import weights_known
from pa10cal.arrays import Array
from pa10cal.calibration.general.unknowns import Unknowns, choose_unknowns
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.errors import CalibrationError
from pa10cal.fit.loads import TorqueSource, with_torques
from pa10cal.fit.problem import Problem
from pa10cal.fit.uncertain_weights import unknown_weights
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import OF
from pa10cal.terms.offsets import Offsets
from pa10cal.terms.weights import Weights

#: Part of the largest torque that a joint's torque must vary by for its spring to be looked for.
_LEAST_TORQUE_SHARE = 0.005
#: Less than this is none.
_NO_TORQUE_NM = 1e-9
#: A usual stiffness, from which springs start [N m/rad].
_USUAL_STIFFNESS = 5e4
#: A usual sag, from which springs under assumed weights start [rad].
_USUAL_SAG_RAD = 3e-4
#: A large one, about which that of any robot lies: a 3 m robot sags by milliradians [rad].
_LARGE_SAG_RAD = 5e-3


@dataclass(frozen=True)
class GeneralProblem:
    """The general model, ready to be fitted."""

    # model and observations, with the torques of the nominal arm where none were logged
    problem: Problem
    x_start: Array  # (k,) nominal geometry, usual springs
    unknowns: Unknowns  # geometric parameters chosen, and those omitted
    springs: tuple[int, ...]  # joints with a spring
    torques_from: TorqueSource  # `logged`, `masses`, or `none`


def general_problem(
    arm: Arm,
    observations: Observations,
    start: Start,
    payload: Payload | None,
    options: CalibrationOptions,
    *,
    links: bool = True,
) -> GeneralProblem:
    """Put the general model together for an arm, an instrument and poses.

    Args:
        arm: the nominal arm.
        observations: P poses.
        start: about where base, tool and targets are.
        payload: what the arm carries; None where it is not known.
        options: which springs, and tolerances of the links.
        links: whether the geometry of the links is unknown; else frames and targets alone.

    Raises:
        CalibrationError: when springs are requested whose torques are not known.
    """
    chain = Chain.of(arm)
    states, source = with_torques(Model(chain, ()), np.zeros(0), observations.states, payload)
    observations = observations.with_states(states)
    unknown: tuple[Weights, ...] = ()
    if source == "masses" and payload is not None:
        unknown = unknown_weights(arm, payload, states)
    torques_Nm = _with_tool(arm, states, unknown)
    springs = _springs(arm, torques_Nm, source, options.general.springs)
    tau_Nm = np.abs(torques_Nm).max(axis=0)
    observations = observations.turned(start.R_ee_target)
    unknowns = choose_unknowns(
        arm, options.tolerances, observations.measured, start.T_instr_base, start.targets_m
    )
    if not links:
        unknowns = replace(unknowns, links=Offsets((), ()))
    sag_rad = _LARGE_SAG_RAD if source == "masses" and weights_known(arm).assumed else None
    terms = tuple(
        JointSpring(joint, float(tau_Nm[joint - 1]), cubic=False, plausible_rad=sag_rad)
        for joint in springs
    )
    weights = unknown if terms else ()
    model = Model(chain, (unknowns.links, *terms, *weights, *unknowns.frames, unknowns.base))
    problem = Problem(model, unknowns.places, start.targets_m, start.T_instr_base, observations)
    x_start = problem.start(_model_start(problem.model, start))
    return GeneralProblem(problem, x_start, unknowns, springs, source)


def _with_tool(arm: Arm, states: PoseStates, unknown: tuple[Weights, ...]) -> Array:
    """Return the torques of poses (P, n), a tool of unknown mass as heavy as it may well be."""
    tau_Nm: Array = states.tau_Nm
    for weights in unknown:
        of_tool = np.array(weights.columns) == 4 * arm.n
        mass = np.where(of_tool & weights.unknown_tool, weights.sizes, 0.0)
        tau_Nm = tau_Nm - weights.torque_Nm(states, mass)
    return tau_Nm


def _springs(
    arm: Arm,
    tau_Nm: Array,
    source: TorqueSource,
    springs: tuple[int, ...] | Literal["auto"],
) -> tuple[int, ...]:
    """Return the joints to give a spring."""
    if springs == ():
        return ()
    if source == "none":
        if springs == "auto":
            return ()
        raise CalibrationError(
            f"joint {springs[0]} has a spring, but its torques are not known",
            where=f"tau{springs[0]}_Nm",
            allowed="torques logged in every pose, or the masses of the links in the arm's "
            "description",
            remedy=f"log the torques, describe mass_kg and com_m of {arm.name}, or remove the "
            "joint from general.springs (an empty list calibrates a rigid arm)",
        )
    if springs != "auto":
        for joint in springs:
            if not 1 <= joint <= arm.n or arm.prismatic[joint - 1]:
                raise CalibrationError(
                    "no such revolute joint",
                    where="general.springs",
                    value=joint,
                    allowed=f"revolute joints, 1 to {arm.n}",
                    remedy="correct the list",
                )
            if not np.any(np.abs(tau_Nm[:, joint - 1]) > _NO_TORQUE_NM):
                raise CalibrationError(
                    f"joint {joint} is unloaded in all poses, so its stiffness cannot be "
                    "identified",
                    where="general.springs",
                    value=joint,
                    allowed="joints that weights load",
                    remedy="remove the joint from general.springs, or measure with a load on it",
                )
        return tuple(sorted(set(springs)))
    return loaded_joints(arm, tau_Nm, _LEAST_TORQUE_SHARE)


def loaded_joints(arm: Arm, tau_Nm: Array, share: float) -> tuple[int, ...]:
    """Return the turning joints whose torque varies by this part of the largest."""
    span = np.ptp(tau_Nm, axis=0)
    turning = ~arm.prismatic
    least = share * float(np.max(span[turning], initial=0.0))
    return tuple(
        int(joint) + 1 for joint in np.flatnonzero(turning & (span > max(least, _NO_TORQUE_NM)))
    )


def _model_start(model: Model, start: Start) -> Array:
    """Return nominal geometry with usual springs and the tool where it is thought to be."""
    parts = []
    for term in model.terms:
        if isinstance(term, JointSpring):
            known = weights_known(model.chain.arm)
            soft = term.tau_ref_Nm / _USUAL_SAG_RAD if known.assumed else _USUAL_STIFFNESS
            parts.append(term.solved(soft, 0.0))
        else:
            values = np.zeros(len(term.parameters))
            for k, parameter in enumerate(term.parameters):
                values[k] = start_of_tool(parameter.name, start)
            parts.append(values)
    return np.concatenate(parts)


def start_of_tool(parameter: str, start: Start) -> float:
    """Return where a coordinate of a tool is thought to be [m], of a campaign's own by its name.

    Zero for any other parameter.
    """
    name, _, campaign = parameter.partition(OF)
    if name not in ("tool_x", "tool_y", "tool_z"):
        return 0.0
    p_ee_target_m = start.p_ee_targets_of_m.get(campaign, start.p_ee_target_m)
    return float(p_ee_target_m["xyz".index(name[-1])])


def check_enough(problem: Problem, *, known: int = 0) -> None:
    """Refuse a problem of fewer equations than unknowns, those not counted of which much is known.

    Raises:
        CalibrationError: naming how many poses would do.
    """
    unknowns, rows = len(problem.parameters) - known, problem.readings
    if rows < unknowns:
        a_pose = rows / max(1, len(problem.observations))
        raise CalibrationError(
            "fewer equations than unknowns",
            where="grid poses",
            value=f"{len(problem.observations)} poses with {rows} readings, {unknowns} unknowns",
            allowed=f"at least {int(np.ceil(unknowns / max(a_pose, 1e-9)))} poses like these",
            remedy="measure more poses",
        )
