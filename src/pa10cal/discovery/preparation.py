"""What is known of a campaign besides its readings, and readings made ready for the search."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.state import PoseStates, Seen
from pa10cal.arm.statics import Payload, Statics
from pa10cal.discovery.options import DiscoveryOptions
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.effects.effect import CandidateContext

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MeasurementSetup:
    """What is known of a campaign besides its poses.

    Attributes:
        payload: apparatus, load point, gravity; None where the arm's masses are not known.
        p_ee_targets_m: (B, 3) the instrument's targets on the apparatus, in the end-effector frame;
            none for an instrument that gives poses.
        reference_temperature_C: temperature at which lengths are nominal.
        flexible_joints: joints that the model gives a spring.
        apparatus_m: standard uncertainty of a target's place on the apparatus, per axis.
        options: standard uncertainties of what else repeats cannot show.
    """

    payload: Payload | None
    p_ee_targets_m: Array
    reference_temperature_C: float
    flexible_joints: tuple[int, ...]
    apparatus_m: float = 5e-6
    options: DiscoveryOptions = field(default_factory=DiscoveryOptions)


def complete(
    poses: Observations[Pose], baseline: FittedModel, setup: MeasurementSetup
) -> Observations[Pose]:
    """Add to the states of poses what they carry and how they were seen."""
    states = replace(poses.states, seen=_seen(poses, setup.p_ee_targets_m))
    if setup.payload is not None:
        states = replace(
            states, static_loads=static_loads(states, baseline, setup.payload).static_loads
        )
    return replace(poses, states=states)


def complete_about(
    poses: Observations[Pose],
    baseline: FittedModel,
    about: FittedModel,
    setup: MeasurementSetup,
) -> Observations[Pose]:
    """Add what poses carry by a better model, whose effects may need what the baseline says."""
    poses = complete(poses, baseline, setup)
    return poses if about is baseline else complete(poses, about, setup)


def static_loads(states: PoseStates, baseline: FittedModel, payload: Payload) -> Statics:
    """Return torques and moments that weights put on the arm, the base standing as it is."""
    return statics_of(baseline.model, baseline.x, states, payload)


def _seen(poses: Observations[Pose], p_ee_targets_m: Array) -> Seen:
    """Return where targets were and how the pose was made of them, along end-effector axes."""
    R, origin = poses.measured.T_instr_target[:, :3, :3], poses.measured.T_instr_target[:, :3, 3]
    count = len(poses)
    if not poses.measured.by_apparatus.shape[2]:
        direct = np.zeros((count, 6, 3))
        direct[:, :3] = R.transpose(0, 2, 1)
        return Seen(origin[:, None, :], direct)
    targets = origin[:, None, :] + np.einsum("pij,bj->pbi", R, p_ee_targets_m)
    # A target read too far by v is one whose stated place on the apparatus is short by R^T v.
    by_place = poses.measured.by_apparatus.reshape(count, 2, 3, -1, 3)
    by_reading = -np.einsum("pki,pakbl,pjl->paibj", R, by_place, R, optimize=True)
    return Seen(targets, by_reading.reshape(count, 6, -1))


def context_of(
    cells: Observations[Pose], baseline: FittedModel, setup: MeasurementSetup
) -> CandidateContext:
    """Return what decides where effects may sit; the poses are complete."""
    states = cells.states
    assert states.seen is not None
    return CandidateContext(
        arm=baseline.model.chain.arm,
        flexible_joints=setup.flexible_joints,
        reference_temperature_C=setup.reference_temperature_C,
        tau_span_Nm=np.abs(
            states.tau_Nm if states.static_loads is None else states.static_loads.joint_Nm
        ).max(axis=0),
        T_instr_base=baseline.T_instr_base,
        p_instr_middle_m=states.seen.p_instr_targets_m.reshape(-1, 3).mean(axis=0),
        q_span_rad=np.stack([states.q_rad.min(axis=0), states.q_rad.max(axis=0)], axis=1),
        time_span_s=(float(states.time_s.min()), float(states.time_s.max())),
    )
