"""What a search judged by blocks of poses comes to, as the records of discovery."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from pa10cal.calibration.accuracy import Accuracy
from pa10cal.discovery.blocked_cv.discover import BlockedDiscovery
from pa10cal.discovery.blocked_cv.fill import FillingPose
from pa10cal.discovery.blocked_cv.gaps import PartedGap
from pa10cal.discovery.blocked_cv.judge import Prediction
from pa10cal.discovery.blocked_cv.lack import lack_of_fit
from pa10cal.discovery.blocked_cv.noise import NEARLY_SAME
from pa10cal.discovery.blocked_cv.search import LEAST_SHARE, STANDARD_ERRORS
from pa10cal.discovery.blocked_cv.survey import BLOCKS
from pa10cal.discovery.extended import extended_by_blocks
from pa10cal.discovery.lack_of_fit_record import lack_of_fit_part, naming_steps
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
from pa10cal.fit import angles_seen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_file import model_to_plain
from pa10cal.results import discovery as parts
from pa10cal.results.accuracy import BeforeAfter, Parameter
from pa10cal.results.analysis import AnalysisKeys, GapField, GapRows, LackOfFit, SearchStep


def outcome_by_blocks(
    found: BlockedDiscovery, error_rate: float, ahead: Sequence[FillingPose] = ()
) -> Outcome:
    """Return what a search comes to.

    Args:
        found: the search.
        error_rate: rate of false names allowed.
        ahead: what to measure next.
    """
    model = extended_by_blocks(found)
    return Outcome(
        verdict=verdict_by_blocks(found, error_rate, ahead),
        extended=_extended(found, model),
        analysis=_analysis(found),
        model=model,
    )


def verdict_by_blocks(
    found: BlockedDiscovery, error_rate: float, ahead: Sequence[FillingPose] = ()
) -> parts.VerdictKeys:
    """Return the verdict of a search, and what to measure next."""
    return parts.VerdictKeys(
        verdict=found.verdict,
        method="cross-validation over blocks",
        effects=tuple(
            found_effect(finding, _evidence(finding.proof)) for finding in found.findings
        ),
        unexplained=all_unexplained(found.findings, found.unexplained),
        not_testable=not_testable(found.not_testable),
        indistinguishable=(),
        gap=parts.Gap(
            noise_floor_mm=found.noise.floor_mm,
            noise_floor_from=_floor_from(found),
            train=_parted(found.train),
            holdout=None if found.holdout is None else _parted(found.holdout),
        ),
        remaining=parts.Remaining(
            **asdict(found.remaining),
            over_floor=found.remaining.over_floor,
            tried=tuple(
                parts.Tried(
                    id=entry.effect.id,
                    of=entry.effect.of,
                    gain=entry.gain,
                    gain_std=entry.gain_std,
                    helps=entry.helps,
                    positions_and_attitudes_agree=entry.kinds_agree,
                )
                for entry in found.tried
            ),
        ),
        search=parts.SearchByBlocks(
            candidates=found.candidates,
            error_rate=error_rate,
            blocks=BLOCKS,
            needed=parts.Needed(
                standard_errors=STANDARD_ERRORS,
                sum_of_squares=found.least_gain,
                part_of_remaining_error_over_noise=LEAST_SHARE,
            ),
            poses_down_weighted=int(np.sum(found.extended.weighing.weight < 1.0)),
            refit_converged=bool(found.extended.converged),
        ),
        angles_seen=angles_part(found.seen),
        suggested_poses=tuple(
            parts.SuggestedPose(
                q_deg=np.degrees(pose.q_rad),
                q_rad=pose.q_rad,
                load_N=pose.load_N,
                for_=tuple(f"angle of joint {joint} not seen" for joint in pose.joints),
            )
            for pose in ahead
        ),
    )


def angles_part(seen: angles_seen.AnglesSeen) -> tuple[parts.AnglesSeen, ...]:
    """Return the stretches that each joint's poses have seen."""
    return tuple(
        parts.AnglesSeen(turns=turns, stretches=stretches)
        for stretches, turns in zip(seen.intervals, seen.turns, strict=True)
    )


def _evidence(proof: Prediction) -> parts.EvidenceByBlocks:
    return parts.EvidenceByBlocks(
        cross_validation_over_blocks=parts.BlockedCrossValidation(**asdict(proof), z=proof.z)
    )


def _floor_from(found: BlockedDiscovery) -> str:
    if found.noise.pairs:
        return (
            f"{found.noise.pairs} pairs of poses closer than {1e3 * NEARLY_SAME:g} mrad in every "
            "joint"
        )
    return "the instrument's stated uncertainty: hardly any pose is repeated"


def _parted(found: PartedGap) -> parts.SetGap:
    return set_gap(
        found.whole,
        _pair(found.before_inside, found.after_inside),
        _pair(found.before_beyond, found.after_beyond),
    )


def _pair(before: Accuracy | None, after: Accuracy | None) -> BeforeAfter | None:
    if before is None or after is None:
        return None
    return BeforeAfter(before=before, after=after)


def _parameters(found: BlockedDiscovery) -> dict[str, Parameter]:
    extended, baseline = found.extended, found.survey.baseline
    own = len(baseline.x)
    along = np.eye(6)
    along[:3, :3] = baseline.T_instr_base[:3, :3]
    return model_parameters(
        baseline.model,
        extended.x[:own],
        extended.covariance[:own, :own],
        extended.T_instr_base,
        along @ extended.covariance[-6:, -6:] @ along.T,
    )


def _extended(found: BlockedDiscovery, model: FittedModel) -> parts.ExtendedKeys:
    return parts.ExtendedKeys(
        parameters=_parameters(found),
        T_instr_base=model.T_instr_base,
        fitted_model=model_to_plain(model),
        angles_seen=angles_part(found.seen),
    )


def _analysis(found: BlockedDiscovery) -> AnalysisKeys:
    survey, extended = found.survey, found.extended
    baseline = survey.baseline
    rows = 6 * len(survey.poses)

    def lack(model: FittedModel) -> LackOfFit:
        return lack_of_fit_part(lack_of_fit(survey, model, found.noise))

    def gap(of: PartedGap) -> GapRows:
        return gap_rows(of.whole, baseline.T_instr_base, ~of.inside)

    return AnalysisKeys(
        before=lack(FittedModel(baseline.model, baseline.x, baseline.T_instr_base)),
        after=lack(FittedModel(extended.model, extended.x, extended.T_instr_base)),
        steps=tuple(
            SearchStep(
                effects=tuple(name_of(member.effect) for member in step.members),
                squared_error_of_a_row=float(step.squares.sum()) / rows,
            )
            for step in found.steps
        ),
        naming=naming_steps(found.named),
        parameter_shifts=parameter_shifts(baseline, _parameters(found)),
        gap=GapField(
            train=gap(found.train),
            holdout=None if found.holdout is None else gap(found.holdout),
        ),
        noise_floor_mm=found.noise.floor_mm,
    )
