"""The general model as a least-squares problem: which terms it has, and where it starts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import TOOL, Chain
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.rules import SPRINGS, UNKNOWNS
from pa10cal.errors import CalibrationError
from pa10cal.fit.loads import TorqueSource, with_loads_read_by, with_torques
from pa10cal.fit.problem import Problem
from pa10cal.fit.weighed_arm import unknown_weights
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.options import Tolerances
from pa10cal.results.calibration import Redundant
from pa10cal.terms.joint_spring import JointSpring, is_spring
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import OfCampaign, OfPart, of_one_campaign
from pa10cal.terms.term import Offsets, Term, TermParameter, base_frame, link_departures, tool_frame
from pa10cal.terms.weights import Weights

# Which parameters arm and instrument can identify: complete, since every one with an effect is
# there, and minimal, since none is redundant.
#
# Candidates are taken one after the other, frames first, then targets, then the links from the
# base outward; one whose effect is a combination of those before it is omitted. One that others
# represent only by large motions replaces the last of these: along nearly parallel axes, the
# height of tool or target represents the links only by a shift of metres. This depends on arm and
# instrument alone, so it is decided at random joint positions within the limits, before any
# reading. What the measured poses then identify is a separate question, answered by the rank.

#: Joints without a stated limit are taken through so much.
_WIDEST_RAD = np.pi


@dataclass(frozen=True)
class Unknowns:
    """The geometric parameters of a complete and minimal model."""

    links: Offsets  # departures kept
    # motions kept of the tool, none where the instrument has targets of its own; of a group, of
    # every campaign's tool and of the bases of all campaigns but the first
    frames: tuple[Offsets | OfCampaign | OfPart, ...]
    base: Offsets  # motions of the base kept
    places: NDArray[np.intp]  # coordinates of targets kept, as indices into `target_parameters`
    redundant: tuple[Redundant, ...]  # parameters omitted, with those that replace them

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Return the names of the parameters of `frames`."""
        return tuple(parameter.name for frame in self.frames for parameter in frame.parameters)


def choose_unknowns(
    arm: Arm, tolerances: Tolerances, measured: Instrument, start: Start
) -> Unknowns:
    """Choose the parameters that arm and instrument can identify.

    Args:
        measured: by which instrument; its readings play no part.
        start: about where frames and targets are.
    """
    links, base = link_departures(arm, tolerances), base_frame()
    own = _own_frames(measured)
    frames = (base, *own)
    model = Model(Chain.of(arm), (*frames, links))
    generator = np.random.default_rng(UNKNOWNS.random_seed)
    low, high = arm.axis_limits_rad.T
    low = np.where(arm.axes_slide, low, np.maximum(low, -_WIDEST_RAD))
    high = np.where(arm.axes_slide, high, np.minimum(high, _WIDEST_RAD))
    axes_rad = generator.uniform(low, high, (UNKNOWNS.configurations, len(low)))
    q_rad = arm.coupling.to_joints(axes_rad)
    zeros, zero = np.zeros_like(q_rad), np.zeros(UNKNOWNS.configurations)
    states = PoseStates(q_rad, zeros, zeros, zero, zero, zero)
    if measured.campaigns:
        # Of a group the same states in every campaign, in its rows, whose readings are idle.
        count, sizes = len(states), np.array([len(part) for _, part in measured.campaigns])
        number = np.repeat(np.arange(len(sizes)), count)
        states = states.take(np.tile(np.arange(count), len(sizes)))
        states = replace(states, campaign=number)
        measured = measured.take(np.repeat(np.cumsum(sizes) - sizes, count))
    predicted = model.predict_with_jacobian(states, np.zeros(len(model.parameters)))
    targets_m, R = start.targets_m, start.T_instr_base[:3, :3]
    T_instr_ee = start.T_instr_base @ predicted.T_base_ee
    found = measured.ideal(T_instr_ee, targets_m).compare(T_instr_ee, targets_m)
    by_end = (R @ predicted.jacobian[:, :3], R @ predicted.jacobian[:, 3:])
    by_model = found.by_end @ np.concatenate(by_end, axis=1)
    at = sum(len(frame.parameters) for frame in frames)
    parameters = (*model.parameters[:at], *measured.target_parameters, *model.parameters[at:])
    columns = np.concatenate([by_model[..., :at], found.by_targets, by_model[..., at:]], axis=2)
    columns = columns.reshape(-1, len(parameters)) * [p.scale for p in parameters]
    base_first = len(base.parameters)
    size = np.linalg.norm(columns, axis=0)
    columns[:, size <= UNKNOWNS.no_column * size.max()] = 0.0
    kept, parts = _well_said(columns, _independent(columns), base_first)
    redundant = _redundant(parts, kept, parameters)
    names = {parameters[k].name for k in kept}
    places = [k - at for k in kept if at <= k < at + len(targets_m)]
    return Unknowns(
        links=links.only(names),
        frames=tuple(kept for kept in (frame.only(names) for frame in own) if kept.parameters),
        base=base.only(names),
        places=np.array(places, dtype=np.intp),
        redundant=redundant,
    )


def _own_frames(measured: Instrument) -> tuple[Offsets | OfCampaign, ...]:
    """Return the tool, or the tools and further bases of the campaigns of a group.

    A tool is part of the chain where the targets are not unknowns of their own.
    """
    if not measured.campaigns:
        return () if measured.target_parameters else (tool_frame(),)
    campaigns = tuple(enumerate(measured.campaigns))
    return (
        *(OfCampaign(base_frame(), k, name) for k, (name, _) in campaigns[1:]),
        *(
            OfCampaign(tool_frame(), k, name)
            for k, (name, part) in campaigns
            if not part.target_parameters
        ),
    )


def _independent(columns: Array) -> list[int]:
    """Return the columns, in order, that are no combinations of those before them."""
    basis = np.empty((columns.shape[1], len(columns)))
    kept: list[int] = []
    for k, column in enumerate(np.ascontiguousarray(columns.T)):
        before = basis[: len(kept)]
        left = column - (before @ column) @ before
        left -= (before @ left) @ before  # once more, against rounding
        size, length = float(column @ column) ** 0.5, float(left @ left) ** 0.5
        if size > 0.0 and length > UNKNOWNS.least_left * size:
            basis[len(kept)] = left / length
            kept.append(k)
    return kept


def _well_said(columns: Array, kept: list[int], first: int) -> tuple[list[int], Array]:
    """Exchange columns kept, none before `first`, for those that they say only by large motions.

    Every exchange makes the volume that unit columns span larger by the motion's size (Gu and
    Eisenstat, 1996), so that they come to an end.

    Returns:
        What is kept, and its parts (kept, others) in the others.
    """
    size = np.linalg.norm(columns, axis=0)
    size[size == 0.0] = 1.0
    unit, shown = columns / size, np.flatnonzero(columns.any(axis=0))
    while True:
        others = [k for k in range(len(size)) if k not in kept]
        basis, triangle = np.linalg.qr(unit[:, kept])
        parts = np.linalg.solve(triangle, basis.T @ unit[:, others])
        large = np.abs(parts)
        large[np.array(kept) < first] = 0.0
        large[:, ~np.isin(others, shown)] = 0.0
        if not large.size or large.max() <= UNKNOWNS.most_times:
            return kept, parts * size[others] / size[kept][:, None]
        worst = int(np.argmax(large.max(axis=0)))
        last = int(np.flatnonzero(large[:, worst] > UNKNOWNS.most_times)[-1])
        kept = sorted([*kept[:last], *kept[last + 1 :], others[worst]])


def _redundant(
    parts: Array, kept: list[int], parameters: tuple[TermParameter, ...]
) -> tuple[Redundant, ...]:
    """Return the parameters omitted, and those kept that replace them."""
    others = [k for k in range(len(parameters)) if k not in kept]
    scale = np.array([parameter.scale for parameter in parameters])
    parts = (
        np.where(np.abs(parts) > UNKNOWNS.no_part, parts, 0.0)
        * scale[kept][:, None]
        / scale[others]
    )
    return tuple(
        Redundant(
            name=parameters[k].name,
            replaced_by={parameters[kept[j]].name: float(part[j]) for j in np.flatnonzero(part)},
        )
        for k, part in zip(others, parts.T, strict=True)
    )


@dataclass(frozen=True)
class GeneralProblem:
    """The general model, ready to be fitted."""

    # model and observations, with the torques of the nominal arm where none were logged
    problem: Problem
    x_start: Array  # (k,) nominal geometry, usual springs
    start: Start  # where frames and targets were thought to be, and how the orientation is turned
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
    """Put the general model together for an arm, an instrument and poses.

    Raises:
        CalibrationError: when springs are requested whose torques are not known.
    """
    chain, known = Chain.of(arm), weights_known(arm)
    states, source = with_torques(Model(chain, ()), np.zeros(0), observations.states, payload)
    unknown: tuple[Weights, ...] = ()
    if source == "masses" and payload is not None:
        unknown = unknown_weights(arm, payload, states)
    torques_Nm = states.tau_Nm
    for weights in unknown:  # a tool as heavy, and as far out, as it may well be
        beyond = np.array(weights.columns) - 4 * arm.n
        of_tool = (beyond == 0) & weights.unknown_tool
        if payload is not None and payload.com_u_m is not None:
            of_tool |= (beyond > -4) & (beyond < 0)
        torques_Nm = torques_Nm - weights.torque_Nm(states, np.where(of_tool, weights.sizes, 0.0))
    springs = _springs(arm, torques_Nm, source, options.general.springs)
    unknowns = choose_unknowns(arm, options.tolerances, observations.measured, start)
    sag_rad = SPRINGS.large_sag_rad if source == "masses" and known.assumed else None
    terms: list[Term] = [unknowns.links if links else Offsets((), ())]
    x_start = [np.zeros(len(terms[0].parameters))]
    for joint in springs:
        tau_ref_Nm = float(np.abs(torques_Nm[:, joint - 1]).max())
        spring = JointSpring(joint, tau_ref_Nm, cubic=False, plausible_rad=sag_rad)
        soft = tau_ref_Nm / SPRINGS.usual_sag_rad if known.assumed else SPRINGS.usual_Nm_per_rad
        terms.append(spring)
        x_start.append(spring.solved(soft, 0.0))
    if springs:
        terms += unknown
        x_start += [np.zeros(len(weights.parameters)) for weights in unknown]
    arm_terms = Model(chain, tuple(terms)), np.concatenate(x_start)
    posed = observations.with_states(with_loads_read_by(terms, states))
    problem, x = with_unknown_frames(*arm_terms, unknowns, start, posed)
    return GeneralProblem(problem, x, start, unknowns.redundant, source, payload)


def with_unknown_frames(
    arm: Model, x_arm: Array, unknowns: Unknowns, start: Start, observations: Observations
) -> tuple[Problem, Array]:
    """Return the problem of an arm whose frames and targets are unknown, and where it sets out.

    Args:
        arm: its chain, and its terms without those of frames.
        x_arm: their parameters to set out with.
    """
    frames = (*unknowns.frames, unknowns.base)
    problem = Problem(
        Model(arm.chain, (*arm.terms, *frames)),
        unknowns.places,
        start.targets_m,
        start.T_instr_base,
        observations.turned(start.R_ee_target),
    )
    of_frames = [x for frame in frames for x in _start_of(frame, start)]
    return problem, problem.start(np.concatenate([x_arm, of_frames]))


def _springs(
    arm: Arm,
    tau_Nm: Array,
    source: TorqueSource,
    springs: tuple[int, ...] | Literal["auto"],
) -> tuple[int, ...]:
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
            if not np.any(np.abs(tau_Nm[:, joint - 1]) > SPRINGS.no_torque_Nm):
                raise CalibrationError(
                    f"joint {joint} is unloaded in all poses, so its stiffness cannot be "
                    "identified",
                    where="general.springs",
                    value=joint,
                    allowed="joints that weights load",
                    remedy="remove the joint from general.springs, or measure with a load on it",
                )
        return tuple(sorted(set(springs)))
    return loaded_joints(arm, tau_Nm, SPRINGS.least_torque_share)


def loaded_joints(arm: Arm, tau_Nm: Array, share: float) -> tuple[int, ...]:
    """Return the turning joints whose torque varies by this part of the largest."""
    span = np.ptp(tau_Nm, axis=0)
    turning = ~arm.prismatic
    least = share * float(np.max(span[turning], initial=0.0))
    return tuple(
        int(joint) + 1
        for joint in np.flatnonzero(turning & (span > max(least, SPRINGS.no_torque_Nm)))
    )


def _start_of(frame: Term, start: Start) -> list[float]:
    """Return where the coordinates of a frame are thought to be: places of tools [m], else zero."""
    p_ee_target_m = start.p_ee_target_m
    if of_one_campaign(frame):
        p_ee_target_m = start.p_ee_targets_of_m.get(frame.name, p_ee_target_m)
    place_m = dict(zip(TOOL[:3], p_ee_target_m.tolist(), strict=True))
    return [place_m.get(coordinate, 0.0) for coordinate in frame.coordinates]


def check_enough(problem: Problem, *, known: int = 0) -> None:
    """Refuse a problem of fewer equations than unknowns, those not counted of which much is known.

    Raises:
        CalibrationError: naming how many poses would do.
    """
    unknowns, rows = len(problem.parameters) - known, problem.readings
    if rows < unknowns:
        a_pose = rows / max(1, len(problem.observations))
        given = f"{len(problem.observations)} poses with {rows} readings, {unknowns} unknowns"
        needed = int(np.ceil(unknowns / max(a_pose, UNKNOWNS.no_row)))
        raise CalibrationError(
            "fewer equations than unknowns",
            where="grid poses",
            value=given,
            allowed=f"at least {needed} poses like these",
            remedy="measure more poses",
        )
