"""The whole search on a campaign of many different poses, by blocks of poses left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.blocked_cv.candidate import SPACINGS, Candidate
from pa10cal.discovery.blocked_cv.family import askable, family
from pa10cal.discovery.blocked_cv.finest import finest
from pa10cal.discovery.blocked_cv.gaps import PartedGap, compare, errors_by_name
from pa10cal.discovery.blocked_cv.judge import (
    Prediction,
    Remaining,
    Tried,
    alternatives,
    predictions,
    remaining_error,
    tried,
    unexplained,
    without_rivals,
)
from pa10cal.discovery.blocked_cv.noise import Noise, noise_of
from pa10cal.discovery.blocked_cv.reference import noise_squares, weighed_rows
from pa10cal.discovery.blocked_cv.refit import Refit, refit
from pa10cal.discovery.blocked_cv.rows import Rows
from pa10cal.discovery.blocked_cv.search import Search, Step
from pa10cal.discovery.blocked_cv.survey import Survey, survey
from pa10cal.discovery.naming import Named
from pa10cal.discovery.operating_point import left
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.discovery.verdict import Finding, NotTestable, Unexplained, Word, reported, word_of
from pa10cal.fit.angles_seen import AnglesSeen, angles_seen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.effects.effect import Effect

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BlockedDiscovery:
    """What became of a campaign.

    Attributes:
        survey: the campaign as it was judged.
        verdict: in a word.
        findings: effects of the vocabulary, in the order found.
        unexplained: what remains without a name.
        nameless: smooth unknown functions that the search held.
        tried: what else was tried on the remaining error, the most helpful first.
        remaining: position error of the blocks left out, against noise.
        candidates: how many effects and rivals were tried.
        least_gain: sum of squares by which one must help at least.
        not_testable: effects that these data cannot show.
        steps: of the search, each with what it left of the rows of blocks left out.
        extended: the model with the findings.
        noise: of single readings.
        seen: angles that the fit has seen.
        train, holdout: the gap before and after; None without held-out poses.
        named: errors as the findings join the model one by one.
    """

    survey: Survey
    verdict: Word
    findings: tuple[Finding[Prediction], ...]
    unexplained: tuple[Unexplained, ...]
    nameless: tuple[Effect, ...]
    tried: tuple[Tried, ...]
    remaining: Remaining
    candidates: int
    least_gain: float
    not_testable: tuple[NotTestable, ...]
    steps: tuple[Step, ...]
    extended: Refit
    noise: Noise
    seen: AnglesSeen
    train: PartedGap
    holdout: PartedGap | None
    named: tuple[Named, ...]


def discover_by_blocks(
    readings: Observations[Pose],
    held_out: Observations[Pose] | None,
    baseline: FittedModel,
    setup: MeasurementSetup,
    error_rate: float,
    *,
    torques_logged: bool = False,
) -> BlockedDiscovery:
    """Search a campaign of many different poses for missing effects.

    Args:
        readings: the poses of the fit, attitudes and torques as the model has them.
        held_out: held-out poses, used for nothing but the gap; None where there are none.
        baseline: the calibrated model; its chain has the bends of the long links.
        setup: what is known besides the poses.
        error_rate: probability allowed of naming anything where nothing is missing.
        torques_logged: whether the torques are those of a log.

    Raises:
        DiscoveryError: when there are too few poses.
    """
    campaign = survey(readings, baseline, setup, torques_logged=torques_logged)
    asked, unknown = askable(campaign)
    rows = weighed_rows(campaign, asked, SPACINGS[-1][0])
    searched = _search(rows, error_rate)
    fine, finer_steps = finest(rows, searched.members)
    effects = tuple(member.effect for member in fine.members)
    _, amounts = fine.fit(len(effects))
    extended = refit(campaign, effects, amounts, rows.weighing)
    place = FittedModel(extended.model, extended.x, extended.T_instr_base)
    noise = noise_of(campaign.poses, left(place, campaign.poses))
    remaining = remaining_error(rows, searched.errors_mm, noise.floor_mm)
    nameless = unexplained(remaining, searched.nameless, searched.tried)
    findings = tuple(
        Finding(effect, *_reported(extended, effect), others, proof)
        for effect, others, proof in zip(
            effects, searched.alternatives, searched.predictions, strict=True
        )
    )
    seen = angles_seen(campaign.poses.states.q_rad, ~campaign.context.arm.prismatic)
    train = compare(campaign, extended, seen, campaign.poses, noise.floor_mm)
    holdout = None
    if held_out is not None and len(held_out):
        holdout = compare(campaign, extended, seen, held_out, noise.floor_mm)
    return BlockedDiscovery(
        survey=campaign,
        verdict=word_of(findings, nameless),
        findings=findings,
        unexplained=nameless,
        nameless=searched.nameless,
        tried=searched.tried,
        remaining=remaining,
        candidates=searched.candidates,
        least_gain=searched.least_gain,
        not_testable=(*unknown, *searched.hidden),
        steps=(*searched.steps, *finer_steps),
        extended=extended,
        noise=noise,
        seen=seen,
        train=train,
        holdout=holdout,
        named=errors_by_name(campaign, fine, train, holdout),
    )


@dataclass(frozen=True, eq=False)
class _Searched:
    """What the search found, without its products, which are large."""

    members: tuple[Candidate, ...]
    nameless: tuple[Effect, ...]
    tried: tuple[Tried, ...]
    predictions: tuple[Prediction, ...]
    alternatives: tuple[tuple[Effect, ...], ...]
    errors_mm: Array
    hidden: tuple[NotTestable, ...]
    steps: tuple[Step, ...]
    candidates: int
    least_gain: float


def _search(rows: Rows, error_rate: float) -> _Searched:
    """Search, and judge what was found."""
    products = rows.products()
    candidates, hidden = family(rows, products)
    poses = rows.survey.poses
    noise = noise_squares(rows, noise_of(poses, left(rows.place, poses)))
    search = Search(products, rows.own, candidates, noise, error_rate)
    chosen = search.run()
    others = tried(search, chosen)
    nameless = tuple(member.effect for member in chosen.members if member.effect.generic)
    chosen = without_rivals(chosen)
    proofs, errors_mm = predictions(rows, chosen)
    return _Searched(
        members=chosen.members,
        nameless=nameless,
        tried=others,
        predictions=proofs,
        alternatives=tuple(
            alternatives(search, chosen, member) for member in range(len(chosen.members))
        ),
        errors_mm=errors_mm,
        hidden=hidden,
        steps=tuple(search.steps),
        candidates=len({candidate.name for candidate in candidates}),
        least_gain=search.least_gain,
    )


def _reported(extended: Refit, effect: Effect) -> tuple[Array, Array]:
    """Return the reported parameters of an effect, and their covariance."""
    columns = extended.columns_of(effect)
    return reported(effect, extended.x[columns], extended.covariance[columns, columns])
