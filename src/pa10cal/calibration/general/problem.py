"""The general model as a least-squares problem: its terms, and the start of their parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pa10cal.arm.chain import TOOL, Chain
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.calibration.general.unknowns import ChosenUnknowns, choose_unknowns
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.rules import SPRINGS, UNKNOWNS
from pa10cal.errors import CalibrationError, TooFewPosesError
from pa10cal.fit.loads import TorqueSource, with_loads_read_by, with_torques
from pa10cal.fit.problem import Problem
from pa10cal.fit.uncertain_weights import unknown_weights
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.results.calibration import Redundant
from pa10cal.terms.joint_spring import JointSpring, is_spring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import Offsets
from pa10cal.terms.term import Term
from pa10cal.terms.weights import Weights
from pa10cal.terms.wrapped import of_one_campaign


@dataclass(frozen=True)
class GeneralProblem:
    """The general model, ready to be fitted."""

    # model and observations, with the torques of the nominal arm where none were logged
    problem: Problem
    x_start: Array  # (k,) nominal geometry, usual springs
    start: Start  # approximate frames and targets, and how measured orientations are turned
    redundant: tuple[Redundant, ...]  # geometric parameters omitted
    torques_from: TorqueSource  # `logged`, `masses`, or `none`
    payload: Payload | None  # what the arm carried; None where that is not known

    @property
    def arm(self) -> Arm:
        """Return the nominal arm."""
        return self.problem.model.chain.arm

    @property
    def springs(self) -> tuple[int, ...]:
        """Return the joints with a spring."""
        terms = self.problem.model.terms
        return tuple(term.joint for term in terms if is_spring(term))


def general_problem(
    arm: Arm,
    observations: Observations,
    start: Start,
    payload: Payload | None,
    options: CalibrationOptions,
    *,
    links: bool = True,
) -> GeneralProblem:
    """Return the general model of an arm and its start, for an instrument and poses.

    Args:
        payload: what the arm carries; None where it is not known.
        links: whether the departures of the links are unknowns.

    Raises:
        CalibrationError: when springs are requested whose torques are not known.
    """
    chain, assumed = Chain.of(arm), weights_known(arm).assumed
    states, source = with_torques(Model(chain, ()), np.zeros(0), observations.states, payload)
    weights: tuple[Weights, ...] = ()
    torques_Nm = states.tau_Nm
    if source == "masses" and payload is not None:
        weights = unknown_weights(arm, payload, states)
        for term in weights:
            heavy = _heaviest_tool(term, payload)
            torques_Nm = torques_Nm - term.torque_Nm(states, heavy)
    springs = _springs(arm, torques_Nm, source, options.general.springs)
    unknowns = choose_unknowns(arm, options.tolerances, observations.measured, start)
    sag_rad = SPRINGS.large_sag_rad if source == "masses" and assumed else None
    terms: list[Term] = [unknowns.links if links else Offsets((), ())]
    x_start = [np.zeros(len(terms[0].parameters))]
    for joint in springs:
        tau_ref_Nm = float(np.abs(torques_Nm[:, joint - 1]).max())
        spring = JointSpring(joint, tau_ref_Nm, cubic=False, plausible_rad=sag_rad)
        usual = tau_ref_Nm / SPRINGS.usual_sag_rad if assumed else SPRINGS.usual_Nm_per_rad
        terms.append(spring)
        x_start.append(spring.solved(usual, 0.0))
    if springs:
        terms += weights
        x_start += [np.zeros(len(term.parameters)) for term in weights]
    posed = observations.with_states(with_loads_read_by(terms, states))
    problem, x = with_unknown_frames(
        Model(chain, tuple(terms)), np.concatenate(x_start), unknowns, start, posed
    )
    return GeneralProblem(problem, x, start, unknowns.redundant, source, payload)


def _heaviest_tool(weights: Weights, payload: Payload) -> Array:
    """Return the unknown weights (w,) with the tool as heavy, and as far out, as it may well be."""
    of_tool = weights.of_tool_mass & weights.unknown_tool
    if payload.com_u_m is not None:
        of_tool |= weights.of_last_moment
    return np.where(of_tool, weights.sizes, 0.0)


def with_unknown_frames(
    arm: Model, x_arm: Array, unknowns: ChosenUnknowns, start: Start, observations: Observations
) -> tuple[Problem, Array]:
    """Return the problem of an arm whose frames and targets are unknown, and its start (k,).

    Args:
        arm: its chain, and its terms without those of frames.
        x_arm: start of their parameters.
    """
    frames = (*unknowns.frames, unknowns.base)
    problem = Problem(
        Model(arm.chain, (*arm.terms, *frames)),
        unknowns.targets_kept,
        start.targets_m,
        start.T_instr_base,
        observations.turned(start.R_ee_target),
    )
    of_frames = [x for frame in frames for x in _start_of(frame, start)]
    return problem, problem.start(np.concatenate([x_arm, of_frames]))


def _springs(
    arm: Arm, tau_Nm: Array, source: TorqueSource, requested: tuple[int, ...] | Literal["auto"]
) -> tuple[int, ...]:
    """Return the joints with a spring: those requested, or those whose torque varies."""
    if requested == "auto":
        return () if source == "none" else loaded_joints(arm, tau_Nm, SPRINGS.least_torque_share)
    if requested and source == "none":
        raise CalibrationError(
            f"joint {requested[0]} has a spring, but its torques are not known",
            where=f"tau{requested[0]}_Nm",
            allowed="torques logged in every pose, or the masses of the links in the arm's "
            "description",
            remedy=f"log the torques, describe mass_kg and com_m of {arm.name}, or remove the "
            "joint from general.springs (an empty list calibrates a rigid arm)",
        )
    for joint in requested:
        if not 1 <= joint <= arm.n or arm.prismatic[joint - 1]:
            raise CalibrationError(
                "no such revolute joint",
                where="general.springs",
                value=joint,
                allowed=f"revolute joints, 1 to {arm.n}",
                remedy="correct the list",
            )
        if not np.any(np.abs(tau_Nm[:, joint - 1]) > SPRINGS.no_torque_Nm):
            raise CalibrationError(
                f"joint {joint} is unloaded in all poses, so its stiffness cannot be identified",
                where="general.springs",
                value=joint,
                allowed="joints that weights load",
                remedy="remove the joint from general.springs, or measure with a load on it",
            )
    return tuple(sorted(set(requested)))


def loaded_joints(arm: Arm, tau_Nm: Array, share: float) -> tuple[int, ...]:
    """Return the revolute joints whose torque varies by more than this share of the largest.

    Joints without a motor of their own, which follow others, are not among them.
    """
    span = np.ptp(tau_Nm, axis=0)
    revolute = ~arm.prismatic & np.isin(np.arange(arm.n), arm.coupling.own)
    threshold = max(share * float(np.max(span[revolute], initial=0.0)), SPRINGS.no_torque_Nm)
    return tuple(int(joint) + 1 for joint in np.flatnonzero(revolute & (span > threshold)))


def _start_of(frame: Term, start: Start) -> list[float]:
    """Return the start of the coordinates of a frame: places of tools [m], else zero."""
    p_ee_target_m = start.p_ee_target_m
    if of_one_campaign(frame):
        p_ee_target_m = start.p_ee_target_by_campaign_m.get(frame.name, p_ee_target_m)
    place_m = dict(zip(TOOL[:3], p_ee_target_m.tolist(), strict=True))
    return [place_m.get(coordinate, 0.0) for coordinate in frame.coordinates]


def to_determine(problem: Problem, *, known: int = 0) -> int:
    """Return how many unknowns the readings have to determine.

    Those of which a size is expected, such as assumed weights, have a prior and do not count.

    Args:
        known: number of the first unknowns with an informative prior; they do not count either.
    """
    return sum(each.plausible is None for each in problem.parameters[known:])


def check_enough(problem: Problem, *, known: int = 0) -> None:
    """Refuse a problem with fewer equations than unknowns; see `to_determine`.

    Raises:
        TooFewPosesError: with the number of poses that is needed.
    """
    unknowns, rows = to_determine(problem, known=known), problem.readings
    if rows < unknowns:
        poses = len(problem.observations)
        given = f"{poses} poses with {rows} readings, {unknowns} unknowns"
        needed = int(np.ceil(unknowns / max(rows / max(1, poses), UNKNOWNS.no_row)))
        raise TooFewPosesError(
            "fewer equations than unknowns",
            where="grid poses",
            value=given,
            allowed=f"at least {needed} poses like these",
            remedy="measure more poses",
        )
