"""What is known of a campaign besides its readings, and readings made ready for the search."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array, Mask
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.description import CampaignDescription
from pa10cal.discovery import linear
from pa10cal.discovery.finding import DiagnosedFault, Untestable, faults_of_input
from pa10cal.discovery.row_faults import held_out_faults, row_faults
from pa10cal.discovery.rules import CANDIDATES
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import TorqueSource, statics_of, with_torques
from pa10cal.fit.uncertain_weights import with_uncertain_weights
from pa10cal.observe.arrivals import reversed_joints, with_arrivals
from pa10cal.observe.observations import Observations, average_repeats, reading_groups
from pa10cal.observe.order import slow_joints
from pa10cal.observe.quantities import MM
from pa10cal.options import DiscoveryOptions
from pa10cal.terms.effects.effect import CandidateContext, Effect, candidates
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.joint_spring import is_spring
from pa10cal.terms.model import Model
from pa10cal.terms.term import Term, shows_torque
from pa10cal.terms.weights import fault_candidates, holds_weights, is_fault

# What a campaign can show of an effect: settled before residuals are looked at.


def sought(context: CandidateContext, held: Iterable[Term] = ()) -> tuple[Effect, ...]:
    """Return what is sought: effects and faults of the log, wherever each may sit."""
    held = tuple(held)
    return (*candidates(context, held), *fault_candidates(context, held))


def effects_in(family: Iterable[Effect]) -> int:
    """Return how many effects there are: faults do not make it harder to name one."""
    return sum(not is_fault(effect) for effect in family)


def why_unknown(effect: Effect, states: PoseStates, *, logged: bool, weights: bool) -> str | None:
    """Return why an effect cannot be predicted from what was logged; None where it can.

    By the states of complete poses, whether torques were logged, and whether those of the weights
    are known.
    """
    calculated = getattr(effect, "of_calculated", False)
    if shows_torque(effect) and not (logged or calculated):
        return "the torques were not logged"
    start = effect.starts[0]
    try:
        columns = [effect.derivative(states, start) for start in effect.starts]
    except CalibrationError as error:
        return error.what
    if not all(np.all(np.isfinite(values)) for values in columns):
        return "what it depends on was not logged"
    if shows_torque(effect):
        if not (weights or calculated):
            return "the torques of the weights are not known"
        if not np.all(np.isfinite(effect.torque_derivative(states, start))):
            return "what it depends on was not logged"
    return None


def computable(
    effects: Iterable[Effect], states: PoseStates, *, logged: bool, weights: bool
) -> tuple[list[Effect], list[Untestable]]:
    """Divide effects into those that can be predicted, and the others; see `why_unknown`."""
    reasons = {e: why_unknown(e, states, logged=logged, weights=weights) for e in effects}
    known = [effect for effect, why in reasons.items() if why is None]
    return known, [Untestable(e, why, by_these_poses=False) for e, why in reasons.items() if why]


def why_hidden(share: float, signal: float) -> str | None:
    """Return why poses cannot show an effect that moves something; None where they can.

    By the part of it that remains after the model's own parameters took what they can, and what
    that is of its usual size, in standard deviations.
    """
    if share < CANDIDATES.least_share:
        return f"{100 * share:.1f} % remains beside the model's own parameters"
    if signal * CANDIDATES.largest_sizes < CANDIDATES.least_signal:
        return "ten times its plausible size would not rise above the noise"
    return None


# How readings follow what goes with the pose, beside which something is sought in time.


def by_pose_and_time(
    at: FittedModel, poses: Observations, effects: Iterable[Effect], *, logged: bool, weights: bool
) -> tuple[Array, Array]:
    """Return how components follow what goes with the pose, (P, b, k), and effects of time."""
    known = [
        effect
        for effect in effects
        if not (is_error_map(effect) or (effect.generic and effect.goes_with_time))
        and why_unknown(effect, poses.states, logged=logged, weights=weights) is None
    ]
    shapes = [effect for effect in known for _ in effect.starts]
    starts = [start for effect in known for start in effect.starts]
    none = np.zeros((*poses.measured.components_seen.shape, 0))
    columns = [none, *linear.by_effects(at, poses, shapes, starts)]
    with_time = np.array([False, *(effect.goes_with_time for effect in shapes)])
    with_time = np.repeat(with_time, [each.shape[2] for each in columns])
    every = np.concatenate(columns, axis=2)
    static, of_time = every[..., ~with_time], CANDIDATES.sizes_of_time * every[..., with_time]
    if len(np.unique(poses.pose)) == len(poses):
        waves = _waves(at, poses, slow_joints(poses.states))
        static = np.concatenate([static, waves], axis=2)
    return static, of_time


def _waves(at: FittedModel, poses: Observations, slow: Mask) -> Array:
    """Return waves of the error of every turning joint by its angle, (P, b, w)."""
    arm = at.model.chain.arm
    joints = [joint for joint, slides in enumerate(arm.prismatic, start=1) if not slides]
    screws = linear.by_joints(at, poses, joints)
    q_rad = poses.states.q_rad[:, [joint - 1 for joint in joints]]
    columns = [np.zeros((*screws.shape[:2], 0))]
    for k, joint in enumerate(joints):
        angle = q_rad[:, k, None] * np.arange(1, CANDIDATES.waves[int(slow[joint - 1])] + 1)
        waves = np.concatenate([np.sin(angle), np.cos(angle)], axis=1)
        columns.append(screws[:, :, k, None] * waves[:, None])
    return np.asarray(CANDIDATES.wave_rad * np.concatenate(columns, axis=2))


# What the search needs to know of a campaign, from its description and the settings.


def setup_of(
    campaign: CampaignDescription,
    arm: Arm,
    calibration: CalibrationOptions,
    discovery: DiscoveryOptions,
) -> MeasurementSetup:
    """Return what the search needs to know besides the poses."""
    return MeasurementSetup(
        payload=campaign.payload(arm),
        p_ee_targets_m=MM * campaign.p_ee_balls_mm,
        reference_temperature_C=campaign.reference_temperature_C,
        apparatus_m=MM * calibration.apparatus_uncertainty_mm,
        options=discovery,
        commanded=campaign.joints == "commanded",
    )


@dataclass(frozen=True)
class MeasurementSetup:
    """What is known of a campaign besides its poses."""

    # apparatus, load point, gravity; None where the arm's masses are not known
    payload: Payload | None
    # (B, 3) stated places of the balls of an apparatus, in the end-effector frame; none for an
    # instrument that measures poses, and where they are unknowns of the calibration
    p_ee_targets_m: Array
    reference_temperature_C: float  # temperature at which lengths are nominal
    # standard uncertainty of a target's place on the apparatus, per axis
    apparatus_m: float = CANDIDATES.apparatus_m
    # standard uncertainties of what else repeats cannot show, and how to search
    options: DiscoveryOptions = field(default_factory=DiscoveryOptions)
    commanded: bool = False  # whether joint positions are those commanded, and not read back


@dataclass(frozen=True, eq=False)
class Prepared:
    """A campaign made ready for the search."""

    # single readings of the poses fitted, orientations and torques as the model has them
    readings: Observations
    held_out: Observations | None  # averaged held-out poses; None where there are none
    baseline: FittedModel  # the calibrated model; its chain has the bends of the long links
    setup: MeasurementSetup  # what is known besides the poses
    torques: TorqueSource  # where the torques come from: `logged`, `masses`, or `none`
    arrivals_from_order: bool  # whether directions of arrival are those of the order of poses
    faults: tuple[DiagnosedFault, ...] = ()  # faults of single rows or poses
    # (P,) readings that are not to be averaged; None for none
    excluded: Mask | None = None
    # (H,) held-out poses with a suspected reading; None for none
    suspected: Mask | None = None

    @property
    def gross(self) -> Mask:
        """Return which readings have a gross error, or a fault of their own, (P,)."""
        return np.zeros(len(self.readings), bool) if self.excluded is None else self.excluded

    def without_pose(self, pose: str, fault: DiagnosedFault) -> Prepared:
        """Return the campaign without the readings of a pose, which have a fault."""
        excluded = self.gross | (self.readings.pose == pose)
        return replace(self, excluded=excluded, faults=(*self.faults, fault))

    @property
    def trusted(self) -> Observations:
        """Return the readings that may be averaged: those without a gross error or a fault."""
        return self.readings.take(~self.gross) if self.gross.any() else self.readings


def prepared(
    every: Observations,
    model: FittedModel,
    setup: MeasurementSetup,
    faults: Sequence[DiagnosedFault] = (),
) -> Prepared:
    """Make a campaign ready: directions of arrival, orientations and torques as the model has them.

    From single readings of all kinds, and the faults found when the raw files were read.
    """
    of_input = [
        DiagnosedFault(
            kind="direction",
            where=f"joint {joint}",
            what=f"joint {joint} is logged to arrive from the other side than where it stood "
            "before, nearly always, and the other joints are not; its directions were reversed",
            remedy=f"check the sign of q{joint}_deg in the log of approaches",
        )
        for joint in (np.flatnonzero(reversed_joints(every)) + 1).tolist()
    ]
    every, from_order = with_arrivals(every, model.arm)
    as_calibrated = model.with_bends()
    if model.fitted_to is not None:
        of_input += faults_of_input(model.fitted_to.suspicions)

    def with_their_torques(poses: Observations) -> tuple[Observations, TorqueSource]:
        states, torques = with_torques(model.model, model.x, poses.states, setup.payload)
        return poses.with_states(states), torques

    readings, torques = with_their_torques(every.of_kind("grid").turned(model.R_ee_target))
    whole = complete(readings, as_calibrated, setup)
    found = row_faults(whole, as_calibrated, setup.payload, torques)
    single, held_out, suspected = every.of_kind("holdout"), None, None
    of_rows = found.faults
    if len(single):
        held_out, _ = with_their_torques(average_repeats(single).turned(model.R_ee_target))
        alone, _ = with_their_torques(single.turned(model.R_ee_target))
        alone = complete(alone, as_calibrated, setup)
        away = held_out_faults(alone, as_calibrated, whole.take(~found.excluded))
        of_rows = (*of_rows, *away.faults)
        if away.excluded.any():
            suspected = np.bincount(reading_groups(single), away.excluded) > 0.0
    if torques == "masses" and setup.payload is not None:
        model = with_uncertain_weights(model, setup.payload)
    return Prepared(
        readings=readings,
        held_out=held_out,
        baseline=model.with_bends(),
        setup=setup,
        torques=torques,
        arrivals_from_order=from_order,
        faults=(*faults, *of_input, *of_rows),
        excluded=found.excluded,
        suspected=suspected,
    )


def complete(poses: Observations, baseline: FittedModel, setup: MeasurementSetup) -> Observations:
    """Add to the states of poses what they carry and how they were read."""
    states = poses.states
    if setup.payload is not None:
        if baseline.model.terms_of("effect", "weight", "field"):
            # Such terms need what the arm carries as it stands nominally first.
            rigid = Model(baseline.model.chain, ())
            nominal = statics_of(rigid, np.zeros(0), states, setup.payload)
            states = replace(states, static_loads=states.static_loads or nominal.static_loads)
        loads = statics_of(baseline.model, baseline.x, states, setup.payload)
        states = replace(states, static_loads=loads.static_loads)
    T_instr_ee = baseline.T_instr_base @ baseline.model.predict(states, baseline.x)
    states = replace(states, seen=poses.measured.readout(T_instr_ee, targets_m(baseline, setup)))
    return poses.with_states(states)


def complete_about(
    poses: Observations, baseline: FittedModel, about: FittedModel, setup: MeasurementSetup
) -> Observations:
    """Add what poses carry by a better model, whose effects may need what the baseline says."""
    poses = complete(poses, baseline, setup)
    return poses if about is baseline else complete(poses, about, setup)


def targets_m(model: FittedModel, setup: MeasurementSetup) -> Array:
    """Return the places of the targets in the end-effector frame, (t,): fitted, or as stated."""
    return model.targets_m if len(model.targets_m) else setup.p_ee_targets_m.ravel()


def context_of(
    cells: Observations, baseline: FittedModel, setup: MeasurementSetup
) -> CandidateContext:
    """Return what decides where effects may sit; the poses are complete."""
    states, terms = cells.states, baseline.model.terms
    assert states.seen is not None
    campaigns = cells.measured.campaigns
    parts = [part for _, part in campaigns] or [cells.measured]
    source: TorqueSource = "none"
    if any(holds_weights(term) for term in terms):
        source = "masses"
    elif states.static_loads is not None and np.isfinite(states.tau_Nm).all():
        source = "logged"
    return CandidateContext(
        arm=baseline.model.chain.arm,
        flexible_joints=tuple(term.joint for term in terms if is_spring(term)),
        reference_temperature_C=setup.reference_temperature_C,
        tau_span_Nm=np.abs(
            states.tau_Nm if states.static_loads is None else states.static_loads.joint_Nm
        ).max(axis=0),
        p_instr_middle_m=np.mean(states.seen.p_instr_targets_m.reshape(-1, 3), axis=0),
        q_span_rad=np.stack([states.q_rad.min(axis=0), states.q_rad.max(axis=0)], axis=1),
        time_span_s=(float(states.time_s.min()), float(states.time_s.max())),
        loads_N=tuple(np.unique(states.load_N).tolist()),
        tool_kg=0.0 if setup.payload is None else setup.payload.mass_kg,
        torques=source,
        commanded=setup.commanded,
        campaigns=tuple(name for name, _ in campaigns),
        three_axes=all(each.three_axes for each in parts),
    )
