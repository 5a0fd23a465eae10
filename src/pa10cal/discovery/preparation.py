"""A campaign made ready for the search: what is known of it, its readings, effects to be sought.

Of an effect it is decided here whether it can be predicted from what was logged.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.description import CampaignDescription
from pa10cal.discovery.finding import Untestable
from pa10cal.discovery.log_faults import DiagnosedFault, faults_of_input
from pa10cal.discovery.nuisances import MovedZeros
from pa10cal.discovery.row_faults import held_out_faults, row_faults
from pa10cal.discovery.rules import CANDIDATES, MAPS, NOISE
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import TorqueSource, with_static_loads, with_torques
from pa10cal.fit.uncertain_weights import with_uncertain_weights
from pa10cal.observe.arrivals import reversed_joints, with_arrivals
from pa10cal.observe.observations import Observations, average_repeats, reading_groups
from pa10cal.observe.quantities import MM
from pa10cal.options import DiscoveryOptions
from pa10cal.results.discovery import SuspectedReading
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal.terms.joint_spring import is_spring
from pa10cal.terms.statement_faults import fault_candidates, is_fault
from pa10cal.terms.term import Term, shows_torque
from pa10cal.terms.weights import holds_weights


@dataclass(frozen=True)
class MeasurementSetup:
    """What is known of a campaign besides its poses."""

    # masses and load point of the tool, gravity; None where the arm's masses are not known
    payload: Payload | None
    # (B, 3) stated places of the balls of an apparatus, in the end-effector frame; none where these
    # are unknowns of the calibration, or the instrument measures poses
    p_ee_targets_m: Array
    reference_temperature_C: float  # temperature at which lengths are nominal
    # standard uncertainty of a target's place on the apparatus, per axis
    apparatus_m: float = CANDIDATES.apparatus_m
    # options of the search, and standard uncertainties of errors that are the same in all poses
    options: DiscoveryOptions = field(default_factory=DiscoveryOptions)
    commanded: bool = False  # whether joint positions are those commanded, and not read back


def setup_of(
    campaign: CampaignDescription,
    arm: Arm,
    calibration: CalibrationOptions,
    discovery: DiscoveryOptions,
) -> MeasurementSetup:
    """Return what is known of a campaign by its description and the settings."""
    return MeasurementSetup(
        payload=campaign.payload(arm),
        p_ee_targets_m=MM * campaign.p_ee_balls_mm,
        reference_temperature_C=campaign.reference_temperature_C,
        apparatus_m=MM * calibration.apparatus_uncertainty_mm,
        options=discovery,
        commanded=campaign.joints == "commanded",
    )


@dataclass(frozen=True, eq=False)
class Prepared:
    """A campaign made ready for the search."""

    # P single readings of the poses fitted, with orientations and torques as the model defines them
    readings: Observations
    held_out: Observations | None  # H averaged held-out poses; None where there are none
    baseline: FittedModel  # the calibrated model, on a chain that has bends of the long links
    setup: MeasurementSetup  # what is known besides the poses
    torques: TorqueSource  # where the torques come from: `logged`, `masses`, or `none`
    arrivals_from_order: bool  # whether directions of arrival follow from the order of the poses
    faults: tuple[DiagnosedFault, ...] = ()  # faults of single rows or poses
    excluded: Mask | None = None  # (P,) readings with a fault; None for none
    suspected_readings: tuple[SuspectedReading, ...] = ()  # those of them without one in `faults`
    suspected: Mask | None = None  # (H,) held-out poses with a suspected reading; None for none
    moved: MovedZeros | None = None  # by which readings were corrected; None for none

    @property
    def gross(self) -> Mask:
        """Return which readings have a gross error or another fault, (P,)."""
        return np.zeros(len(self.readings), bool) if self.excluded is None else self.excluded

    def without_pose(self, pose: str, fault: DiagnosedFault) -> Prepared:
        """Return the campaign with the readings of a pose excluded, for a fault."""
        excluded = self.gross | (self.readings.pose == pose)
        return replace(self, excluded=excluded, faults=(*self.faults, fault))

    @property
    def trusted(self) -> Observations:
        """Return the readings without a fault."""
        return self.readings.take(~self.gross) if self.gross.any() else self.readings


def prepared(
    every: Observations,
    model: FittedModel,
    setup: MeasurementSetup,
    faults: Sequence[DiagnosedFault] = (),
    moved: MovedZeros | None = None,
) -> Prepared:
    """Return a campaign made ready: arrivals, orientations, torques, and which readings are faulty.

    Args:
        every: single readings of all kinds.
        model: the calibrated model.
        setup: what is known besides the readings.
        faults: faults found when the raw files were read.
        moved: zeros of joints that moved, by which readings are corrected.
    """
    every = every if moved is None else moved.corrected(every)
    of_input = _reversed_arrivals(every)
    every, from_order = with_arrivals(every, model.arm)
    if model.fitted_to is not None:
        of_input += faults_of_input(model.fitted_to.suspicions)
    readings, torques = _as_modelled(every.of_kind("grid"), model, setup)
    as_calibrated = model.with_bends()
    whole = complete(readings, as_calibrated, setup)
    of_rows = row_faults(whole, as_calibrated, setup.payload, torques)
    faults = (*faults, *of_input, *of_rows.faults)
    single, held_out, suspected = every.of_kind("holdout"), None, None
    if len(single):
        held_out, _ = _as_modelled(average_repeats(single), model, setup)
        alone = complete(_as_modelled(single, model, setup)[0], as_calibrated, setup)
        of_held_out = held_out_faults(alone, as_calibrated, whole.take(~of_rows.excluded))
        faults = (*faults, *of_held_out.faults)
        unsure = of_held_out.excluded
        if moved is not None:
            unsure = unsure | moved.of_unknown_side(single)
        if unsure.any():
            suspected = np.bincount(reading_groups(single), unsure) > 0.0
    if torques == "masses" and setup.payload is not None:
        model = with_uncertain_weights(model, setup.payload)
    return Prepared(
        readings=readings,
        held_out=held_out,
        baseline=model.with_bends(),
        setup=setup,
        torques=torques,
        arrivals_from_order=from_order,
        faults=faults,
        excluded=of_rows.excluded,
        suspected_readings=of_rows.suspected,
        suspected=suspected,
        moved=moved,
    )


def _reversed_arrivals(every: Observations) -> list[DiagnosedFault]:
    """Return the joints whose logged directions of arrival have the wrong sign, as faults."""
    return [
        DiagnosedFault(
            kind="direction",
            where=f"joint {joint}",
            what=f"joint {joint} is logged to arrive from the other side than where it stood "
            "before, nearly always, and the other joints are not; its directions were reversed",
            remedy=f"check the sign of the directions of arrival of joint {joint}",
        )
        for joint in (np.flatnonzero(reversed_joints(every)) + 1).tolist()
    ]


def _as_modelled(
    poses: Observations, model: FittedModel, setup: MeasurementSetup
) -> tuple[Observations, TorqueSource]:
    """Return poses with the end-effector's orientations and the torques that springs carry."""
    poses = poses.turned(model.R_ee_target)
    states, torques = with_torques(model.model, model.x, poses.states, setup.payload)
    return poses.with_states(states), torques


def complete(
    poses: Observations,
    baseline: FittedModel,
    setup: MeasurementSetup,
    about: FittedModel | None = None,
) -> Observations:
    """Return poses whose states have static loads, and how targets were read, by a model.

    By the baseline; then by a better model `about`, whose effects may need what the baseline gives.
    """
    if about is not None and about is not baseline:
        return complete(complete(poses, baseline, setup), about, setup)
    states = poses.states
    if setup.payload is not None:
        states = with_static_loads(baseline.model, baseline.x, states, setup.payload)
    T_instr_ee = baseline.T_instr_base @ baseline.model.predict(states, baseline.x)
    states = replace(states, seen=poses.measured.readout(T_instr_ee, targets_m(baseline, setup)))
    return poses.with_states(states)


def targets_m(model: FittedModel, setup: MeasurementSetup) -> Array:
    """Return the places of the targets in the end-effector frame, (t,): fitted, or as stated."""
    return model.targets_m if len(model.targets_m) else setup.p_ee_targets_m.ravel()


def context_of(
    cells: Observations, baseline: FittedModel, setup: MeasurementSetup
) -> CandidateContext:
    """Return what decides where effects are possible, by complete poses."""
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
        largest_tau_Nm=np.abs(
            states.tau_Nm if states.static_loads is None else states.static_loads.joint_Nm
        ).max(axis=0),
        p_instr_middle_m=np.mean(states.seen.p_instr_targets_m.reshape(-1, 3), axis=0),
        q_span_rad=np.stack([states.q_rad.min(axis=0), states.q_rad.max(axis=0)], axis=1),
        time_span_s=(float(states.time_s.min()), float(states.time_s.max())),
        loads_N=tuple(np.unique(states.load_N).tolist()),
        tool_kg=0.0 if setup.payload is None else setup.payload.mass_kg,
        campaign_tools_kg=_campaign_tools_kg(setup.payload, len(campaigns)),
        gravity_m_s2=(0.0, 0.0, 0.0)
        if setup.payload is None
        else tuple(setup.payload.gravity_m_s2.tolist()),
        torques=source,
        commanded=setup.commanded,
        campaigns=tuple(name for name, _ in campaigns),
        three_axes=all(each.three_axes for each in parts),
        lifts=_lifts(states, baseline.model.chain.arm),
    )


def _lifts(states: PoseStates, arm: Arm) -> tuple[int, float, float] | None:
    """Return the first joint that lifts the arm, and the torque there; see `CandidateContext`.

    It is in the phase of the joint's own link, as other links stand elsewhere at other angles.
    """
    if states.static_loads is None:
        return None
    torque_Nm = states.static_loads.joint_Nm
    most_Nm = np.where(arm.prismatic, 0.0, np.abs(torque_Nm).max(axis=0))
    if not most_Nm.any():
        return None
    joint = int(np.argmax(most_Nm > CANDIDATES.lifts_share * most_Nm.max()))
    q_rad, own_Nm = states.q_rad[:, joint], states.static_loads.by_weights[:, joint, 4 * joint]
    design = np.stack([np.sin(q_rad), np.cos(q_rad), np.ones_like(q_rad)], axis=-1)
    by_angle = np.linalg.lstsq(design, np.stack([torque_Nm[:, joint], own_Nm], -1), rcond=None)[0]
    every, own = by_angle[:2].T
    if not own.any():
        return None
    sine, cosine = (np.hypot(*every) / np.hypot(*own) * own).tolist()
    return joint + 1, sine, cosine


def _campaign_tools_kg(payload: Payload | None, campaigns: int) -> tuple[float, ...]:
    """Return the mass stated of the tool of each campaign of a group, 0 where it is not known."""
    if payload is None:
        return ()
    carried = payload.of_campaigns or (payload,) * campaigns
    return tuple(each.mass_kg if each.known else 0.0 for each in carried[:campaigns])


# Which effects are sought, and which of these poses can show: decided without the residuals.


def sought(context: CandidateContext, held: Iterable[Term] = ()) -> tuple[Effect, ...]:
    """Return the effects and the faults of the log that are sought, at every possible place."""
    held = tuple(held)
    return (*candidates(context, held), *fault_candidates(context, held))


def effects_in(family: Iterable[Effect]) -> int:
    """Return the number of effects, by which the threshold for a name rises: without faults."""
    return sum(not is_fault(effect) for effect in family)


def why_unknown(effect: Effect, states: PoseStates, *, logged: bool, weights: bool) -> str | None:
    """Return why an effect cannot be predicted from what was logged; None where it can.

    Args:
        states: of complete poses.
        logged: whether torques were logged.
        weights: whether the torques of the weights are known.
    """
    calculated = getattr(effect, "of_calculated", False)
    if shows_torque(effect) and not (logged or calculated):
        return "the torques were not logged"
    first = effect.starts[0]
    try:
        columns = [effect.derivative(states, start) for start in effect.starts]
    except CalibrationError as error:
        return error.what
    if why := _why_not_logged(columns):
        return why
    if shows_torque(effect):
        if not (weights or calculated):
            return "the torques of the weights are not known"
        return _why_not_logged([effect.torque_derivative(states, first)])
    return None


def _why_not_logged(columns: Sequence[Array]) -> str | None:
    """Return in how many of P rows derivatives (P, …) are not known; None where in none."""
    known = np.all([np.isfinite(v).reshape(len(v), -1).all(axis=1) for v in columns], axis=0)
    lost = int(np.sum(~known))
    of_rows = f" in {lost} of {len(known)} rows" if lost < len(known) else ""
    return f"what it depends on was not logged{of_rows}" if lost else None


def computable(
    effects: Iterable[Effect], states: PoseStates, *, logged: bool, weights: bool
) -> tuple[list[Effect], list[Untestable]]:
    """Return the effects that can be predicted, and the others with the reason; `why_unknown`."""
    reasons = {e: why_unknown(e, states, logged=logged, weights=weights) for e in effects}
    known = [effect for effect, why in reasons.items() if why is None]
    return known, [Untestable(e, why, by_these_poses=False) for e, why in reasons.items() if why]


def why_hidden(share: float, signal: float) -> str | None:
    """Return why poses cannot show an effect; None where they can.

    Args:
        share: part of the effect that the model's own parameters cannot follow.
        signal: size of that part at the plausible size of the effect, in standard deviations.
    """
    clear = signal >= CANDIDATES.clear_signal
    if share < (CANDIDATES.clear_share if clear else CANDIDATES.least_share):
        return f"{100 * share:.1f} % remains beside the model's own parameters"
    if signal * CANDIDATES.largest_sizes < CANDIDATES.least_signal:
        return "ten times its plausible size would not rise above the noise"
    return None


def _within_a_turn(q_rad: Array) -> Array:
    """Return angles (P,) modulo a turn, which begins in the middle of their largest gap."""
    turn = 2.0 * np.pi
    angles = np.sort(q_rad % turn)
    gaps = np.diff(angles, append=angles[0] + turn)
    widest = int(np.argmax(gaps))
    return np.asarray((q_rad - angles[widest] - 0.5 * gaps[widest]) % turn)


def _places(q: Array) -> Index:
    """Return a number for each position (P,) of a joint; those of the same pose have the same."""
    rising = np.unique(q)
    apart = rising > np.append(-np.inf, rising[:-1] + NOISE.same_pose)[: len(rising)]
    firsts, lasts = rising[apart], rising[np.roll(apart, -1)]
    if (lasts <= firsts + NOISE.same_pose).all():  # as poses that are repeated, or never
        return np.asarray(np.searchsorted(firsts, q, side="right") - 1)
    in_turn, k = [], 0
    while k < len(rising):
        in_turn.append(rising[k])
        k = int(np.searchsorted(rising, rising[k] + NOISE.same_pose, side="right"))
    return np.asarray(np.searchsorted(in_turn, q, side="right") - 1)


def why_few_angles(effect: Effect, states: PoseStates) -> str | None:
    """Return why a joint took too few angles for a map of its errors; None where it did not.

    On a grid, where most angles are those of several poses, held-out poses stand at the angles of
    others: nothing shows what a map does between them, and as many numbers as there are angles are
    a map of any joint that moves with this one. Other effects need no such number of angles.

    Args:
        effect: any effect; of a map its knots count.
        states: of the poses, (P,), repeats included or not.
    """
    if not is_error_map(effect):
        return None
    own = effect.joint - 1
    q_rad = states.q_rad.copy()
    q_rad[:, own] = _within_a_turn(q_rad[:, own])
    angles, rows_at = np.unique(_places(q_rad[:, own]), return_counts=True)
    turns = float(np.ptp(q_rad[:, own])) / (2.0 * np.pi)
    # A cubic spline has three freedoms more than intervals between knots; a periodic one has none.
    freedoms = min(effect.knots * turns + 3.0, float(effect.knots))
    if np.median(rows_at) < 2 or len(angles) >= MAPS.angles_a_freedom * freedoms:
        return None
    poses = np.unique(np.stack([_places(q) for q in q_rad.T], axis=1), axis=0)
    if np.median(np.unique(poses[:, own], return_counts=True)[1]) < 2:
        return None
    return f"the joint took {len(angles)} angles, too few to show what it does between them"
