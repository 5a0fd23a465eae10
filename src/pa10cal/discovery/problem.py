"""A campaign made ready for the search: cells, what they carry, and how their rows are weighed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import BASE, TOOL, end_pose_with_screws
from pa10cal.arm.state import PoseStates, Seen
from pa10cal.arm.statics import Payload, Statics, statics
from pa10cal.calibration.pose_error import pose_error
from pa10cal.campaign.observations import PoseObservations
from pa10cal.discovery.cells import gather, shared_error
from pa10cal.discovery.channel import Channel
from pa10cal.discovery.repeatability import Repeatability, repeatability
from pa10cal.terms.effects.effect import CandidateContext
from pa10cal.terms.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Uncertainties:
    """Standard uncertainties of what repeats cannot show.

    Attributes:
        apparatus_m: a target's place on the apparatus, per axis.
        load: an external load, relative.
        mass: a link's mass, relative.
        com_m: a link's centre of mass, per axis.
        load_point_m: where the load hangs, per axis.
        tool_com_m: the apparatus' centre of mass, per axis.
        level_rad: how level the base stands, about each of its horizontal axes.
        torque_zero: zero of a logged torque, relative to the rated torque.
    """

    apparatus_m: float = 5e-6
    load: float = 0.005
    mass: float = 0.3
    com_m: float = 0.03
    load_point_m: float = 2e-3
    tool_com_m: float = 2e-3
    level_rad: float = 1e-3
    torque_zero: float = 0.01


@dataclass(frozen=True)
class Setting:
    """What is known of a campaign besides its poses.

    Attributes:
        payload: apparatus, load point, gravity; None where the arm's masses are not known.
        p_ee_targets_m: (B, 3) the instrument's targets on the apparatus, in the end-effector frame;
            none for an instrument that gives poses.
        reference_temperature_C: temperature at which lengths are nominal.
        flexible_joints: joints that the model gives a spring.
        uncertainties: of what repeats cannot show.
    """

    payload: Payload | None
    p_ee_targets_m: Array
    reference_temperature_C: float
    flexible_joints: tuple[int, ...]
    uncertainties: Uncertainties = Uncertainties()


@dataclass(frozen=True)
class Baseline:
    """The calibrated model from which the search sets out.

    Attributes:
        model: chain and terms, the base frame not among them.
        x: (k,) its parameters.
        T_instr_base: (4, 4) base frame.
    """

    model: Model
    x: Array
    T_instr_base: Array


@dataclass(frozen=True)
class Problem:
    """Everything that the search weighs effects by.

    Attributes:
        baseline: the calibrated model.
        setting: what is known besides the poses.
        readings: single readings, with what they carry.
        cells: the same in cells.
        noise: of single readings.
        pose: rows of the poses.
        torque: rows of the torques, None where they or the masses are not known.
        torque_left_Nm: (C, n) logged torques less those of all weights (zero where not known).
        context: where effects may sit.
    """

    baseline: Baseline
    setting: Setting
    readings: PoseObservations
    cells: PoseObservations
    noise: Repeatability
    pose: Channel
    torque: Channel | None
    torque_left_Nm: Array
    context: CandidateContext


def prepare(
    readings: PoseObservations,
    baseline: Baseline,
    setting: Setting,
    about: Baseline | None = None,
) -> Problem:
    """Make a campaign ready.

    Args:
        readings: single readings, with the instrument's covariance.
        baseline: the calibrated model.
        setting: what is known besides the poses.
        about: a better model, about which noise and weights are worked out; its effects may need
            what the readings carry. None for the baseline.

    Raises:
        DiscoveryError: when too little is repeated.
    """
    about = baseline if about is None else about
    readings = complete_about(readings, baseline, about, setting)
    noise = repeatability(readings, *_deviation_and_screws(readings, about))
    cells = complete_about(gather(readings, noise.cov_ee), baseline, about, setting)
    shared = shared_error(cells)
    pose = Channel.of(
        np.linalg.inv(np.linalg.cholesky(cells.cov_ee)),
        shared,
        setting.uncertainties.apparatus_m * cells.by_apparatus,
    )
    torque, left = None, np.zeros_like(cells.states.tau_Nm)
    if setting.payload is not None and np.all(np.isfinite(cells.states.tau_Nm)):
        weights = _statics(cells.states, about, setting.payload)
        left = cells.states.tau_Nm - weights.torque_Nm
        scale = np.sqrt(cells.repeats)[:, None] / noise.torque_Nm
        loads_N = np.unique(cells.states.load_N)
        common = common_torques(
            cells, weights, about, setting.payload, setting.uncertainties, loads_N[loads_N > 0]
        )
        torque = Channel.of(scale[:, :, None] * np.eye(baseline.model.chain.arm.n), shared, common)
    return Problem(
        baseline,
        setting,
        readings,
        cells,
        noise,
        pose,
        torque,
        left,
        context_of(cells, baseline, setting),
    )


def complete(poses: PoseObservations, baseline: Baseline, setting: Setting) -> PoseObservations:
    """Add to the states of poses what they carry and how they were seen."""
    states = replace(poses.states, seen=_seen(poses, setting.p_ee_targets_m))
    if setting.payload is not None:
        states = replace(
            states, static_loads=_statics(states, baseline, setting.payload).static_loads
        )
    return replace(poses, states=states)


def complete_about(
    poses: PoseObservations, baseline: Baseline, about: Baseline, setting: Setting
) -> PoseObservations:
    """Add what poses carry by a better model, whose effects may need what the baseline says."""
    poses = complete(poses, baseline, setting)
    return poses if about is baseline else complete(poses, about, setting)


def _statics(states: PoseStates, baseline: Baseline, payload: Payload) -> Statics:
    chain = baseline.model.chain
    coordinates = baseline.model.chain_coordinates(states, baseline.x)
    # Gravity is along the base's own axes; and what the instrument reads too much, which moves the
    # tool in the model, moves no weight.
    coordinates[:, chain.columns(BASE + TOOL)] = 0.0
    return statics(chain, coordinates, states.load_N, payload)


def _seen(poses: PoseObservations, p_ee_targets_m: Array) -> Seen:
    """Return where targets were and how the pose was made of them, along end-effector axes."""
    R, origin = poses.T_instr_ee[:, :3, :3], poses.T_instr_ee[:, :3, 3]
    count = len(poses)
    if not poses.by_apparatus.shape[2]:
        direct = np.zeros((count, 6, 3))
        direct[:, :3] = R.transpose(0, 2, 1)
        return Seen(origin[:, None, :], direct)
    targets = origin[:, None, :] + np.einsum("pij,bj->pbi", R, p_ee_targets_m)
    # A target read too far by v is one whose stated place on the apparatus is short by R^T v.
    by_place = poses.by_apparatus.reshape(count, 2, 3, -1, 3)
    by_reading = -np.einsum("pki,pakbl,pjl->paibj", R, by_place, R, optimize=True)
    return Seen(targets, by_reading.reshape(count, 6, -1))


def _deviation_and_screws(poses: PoseObservations, baseline: Baseline) -> tuple[Array, Array]:
    """Return measured minus predicted (P, 6) and joint screws (P, 6, n), instrument's axes."""
    chain = baseline.model.chain
    end = end_pose_with_screws(chain, baseline.model.chain_coordinates(poses.states, baseline.x))
    error = pose_error(baseline.T_instr_base @ end.T, poses.T_instr_ee)
    screws = end.screws[:, :, chain.joint_columns]
    R = baseline.T_instr_base[:3, :3]
    turned = np.concatenate([R @ screws[:, :3], R @ screws[:, 3:]], axis=1)
    return -np.concatenate([error.position_m, error.chord], axis=1), turned


def common_torques(
    cells: PoseObservations,
    weights: Statics,
    baseline: Baseline,
    payload: Payload,
    uncertainties: Uncertainties,
    loads_N: Array,
) -> Array:
    """Return what errors of masses, loads and zeros do to the torques, (C, n, c), at their size.

    Each of the loads `loads_N` has an error of its own.
    """
    arm = baseline.model.chain.arm
    mass_kg = np.zeros(arm.n) if arm.mass_kg is None else arm.mass_kg
    by_link = np.stack(
        [uncertainties.mass * mass_kg, *[uncertainties.com_m * mass_kg] * 3], axis=1
    ).ravel()
    load_N = cells.states.load_N[:, None] * (cells.states.load_N[:, None] == loads_N)
    by_payload = [
        _statics(cells.states, baseline, moved).torque_Nm - weights.torque_Nm
        for moved in _misplaced(payload, uncertainties)
    ]
    rated_Nm = arm.rated_Nm(np.abs(weights.torque_Nm).max(axis=0))
    zero = np.tile(np.diag(uncertainties.torque_zero * rated_Nm), (len(cells), 1, 1))
    return np.concatenate(
        [
            weights.torque_by_mass * by_link,
            uncertainties.load * weights.torque_by_load[:, :, None] * load_N[:, None, :],
            np.stack(by_payload, axis=2),
            zero,
        ],
        axis=2,
    )


def _misplaced(payload: Payload, uncertainties: Uncertainties) -> list[Payload]:
    """Return the payload with load, apparatus and gravity off by their standard uncertainties."""
    g = payload.gravity_m_s2
    level = uncertainties.level_rad * np.linalg.norm(g)
    return [
        *(
            replace(payload, load_point_m=payload.load_point_m + uncertainties.load_point_m * axis)
            for axis in np.eye(3)
        ),
        *(
            replace(payload, com_m=payload.com_m + uncertainties.tool_com_m * axis)
            for axis in np.eye(3)
        ),
        *(replace(payload, gravity_m_s2=g + level * axis) for axis in np.eye(3)[:2]),
    ]


def context_of(cells: PoseObservations, baseline: Baseline, setting: Setting) -> CandidateContext:
    """Return what decides where effects may sit; the poses are complete."""
    states = cells.states
    assert states.seen is not None
    return CandidateContext(
        arm=baseline.model.chain.arm,
        flexible_joints=setting.flexible_joints,
        reference_temperature_C=setting.reference_temperature_C,
        tau_span_Nm=np.abs(
            states.tau_Nm if states.static_loads is None else states.static_loads.joint_Nm
        ).max(axis=0),
        T_instr_base=baseline.T_instr_base,
        p_instr_middle_m=states.seen.p_instr_targets_m.reshape(-1, 3).mean(axis=0),
        q_span_rad=np.stack([states.q_rad.min(axis=0), states.q_rad.max(axis=0)], axis=1),
        time_span_s=(float(states.time_s.min()), float(states.time_s.max())),
    )
