"""What a search judged by repeats comes to, as the records of discovery."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.discover import Discovery
from pa10cal.discovery.evidence.confirm import Confirmation, LeftOut
from pa10cal.discovery.evidence.fit import covariance_of
from pa10cal.discovery.evidence.judge import FLIP_RATE, shared_error_mm
from pa10cal.discovery.evidence.search import threshold
from pa10cal.discovery.extended import extended_by_repeats
from pa10cal.discovery.lack_of_fit import lack_of_fit
from pa10cal.discovery.lack_of_fit_record import lack_of_fit_part, naming_steps
from pa10cal.discovery.naming import errors_by_name
from pa10cal.discovery.operating_point import moved_base
from pa10cal.discovery.records import (
    Outcome,
    all_unexplained,
    found_effect,
    gap_rows,
    model_parameters,
    name_of,
    not_testable,
    parameter_shifts,
    set_gap,
)
from pa10cal.discovery.suggest import Plan
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_file import model_to_plain
from pa10cal.results import discovery as parts
from pa10cal.results.accuracy import Parameter
from pa10cal.results.analysis import AnalysisKeys, GapField, SearchStep

Array = NDArray[np.float64]


def outcome_by_repeats(found: Discovery, error_rate: float, ahead: Plan | None = None) -> Outcome:
    """Return what a search comes to.

    Args:
        found: the search.
        error_rate: rate of false names allowed.
        ahead: what to measure next; None where that is not wanted.
    """
    model = extended_by_repeats(found)
    return Outcome(
        verdict=verdict_by_repeats(found, error_rate, ahead),
        extended=_extended(found, model),
        analysis=_analysis(found),
        model=model,
    )


def verdict_by_repeats(
    found: Discovery, error_rate: float, ahead: Plan | None = None
) -> parts.VerdictKeys:
    """Return the verdict of a search, and what to measure next."""
    judgement, search = found.judgement, found.judgement.found
    needed = threshold(len(found.family), error_rate)
    return parts.VerdictKeys(
        verdict=judgement.verdict,
        method="evidence of repeats",
        effects=tuple(
            found_effect(finding, _evidence(finding.proof, needed))
            for finding in judgement.findings
        ),
        unexplained=all_unexplained(judgement.findings, judgement.unexplained),
        not_testable=not_testable(found.not_testable),
        indistinguishable=tuple(
            tuple(name_of(effect) for effect in group) for group in found.alike
        ),
        gap=parts.Gap(
            noise_floor_mm=found.noise_floor_mm,
            train=set_gap(found.train),
            holdout=None if found.holdout is None else set_gap(found.holdout),
        ),
        search=parts.SearchByRepeats(
            candidates=len(found.family),
            error_rate=error_rate,
            needed_nats=needed,
            shared_error_mm=parts.SharedError(
                before=shared_error_mm(found.problem, search.nothing.pose_variance),
                after=shared_error_mm(found.problem, search.score.pose_variance),
            ),
        ),
        suggested_poses=() if ahead is None else _suggestions(ahead),
        separations=None if ahead is None else _separations(ahead),
    )


def _evidence(proof: Confirmation, needed_nats: float) -> parts.EvidenceByRepeats:
    return parts.EvidenceByRepeats(
        lost_without_it_nats=proof.loss,
        needed_nats=needed_nats,
        p_sign_flips_max_t=proof.p_flips,
        p_needed=FLIP_RATE,
        cross_validation_over_poses=_cross_validation(proof.poses),
        cross_validation_over_loads=None if proof.loads is None else _cross_validation(proof.loads),
    )


def _cross_validation(found: LeftOut) -> parts.CrossValidation:
    return parts.CrossValidation(explained=found.explained, z=found.z)


def _suggestions(ahead: Plan) -> tuple[parts.SuggestedPose, ...]:
    """Return the configurations, the most telling first; separations count all up to each."""
    return tuple(
        parts.SuggestedPose(
            q_deg=np.degrees(suggestion.q_rad),
            q_rad=suggestion.q_rad,
            load_N=suggestion.load_N,
            arrive_from=-suggestion.arrival,
            separation_nats=suggestion.separation_nats,
            for_=suggestion.for_effects,
        )
        for suggestion in ahead.suggestions
    )


def _separations(ahead: Plan) -> tuple[parts.Separation, ...]:
    return tuple(
        parts.Separation(
            pair=separation.label,
            before_nats=separation.before_nats,
            after_nats=separation.after_nats,
            possible_nats=separation.possible_nats,
            can_be_split=separation.can_be_split,
        )
        for separation in ahead.separations
    )


def _parameters(found: Discovery) -> dict[str, Parameter]:
    extended = found.extended
    covariance = covariance_of(found.problem, extended)
    own = extended.own_columns()[:-6]
    return model_parameters(
        found.problem.baseline.model,
        extended.x[own],
        covariance[np.ix_(own, own)],
        moved_base(extended.level.T_instr_base, extended.x[-6:]),
        covariance[-6:, -6:],
    )


def _extended(found: Discovery, model: FittedModel) -> parts.ExtendedKeys:
    return parts.ExtendedKeys(
        parameters=_parameters(found),
        T_instr_base=model.T_instr_base,
        fitted_model=model_to_plain(model),
    )


def _analysis(found: Discovery) -> AnalysisKeys:
    problem, baseline = found.problem, found.problem.baseline
    named = errors_by_name(problem, found.extended, found.train, found.holdout)
    return AnalysisKeys(
        before=lack_of_fit_part(lack_of_fit(problem, found.start)),
        after=lack_of_fit_part(lack_of_fit(problem, found.extended)),
        steps=tuple(
            SearchStep(
                effects=tuple(name_of(effect) for effect in step.effects),
                gain_nats=step.gain,
                rms_mm=step.rms_mm,
            )
            for step in found.judgement.found.steps
        ),
        naming=naming_steps(named),
        parameter_shifts=parameter_shifts(baseline, _parameters(found)),
        gap=GapField(
            train=gap_rows(found.train, baseline.T_instr_base),
            holdout=None
            if found.holdout is None
            else gap_rows(found.holdout, baseline.T_instr_base),
        ),
        noise_floor_mm=found.noise_floor_mm,
    )
