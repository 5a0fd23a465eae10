"""The model fitted with effects that are given, weighed as the evidence weighs them."""

from __future__ import annotations

from pa10cal.discovery.evidence.fit import Fit, fit
from pa10cal.discovery.evidence.problem import Problem
from pa10cal.discovery.evidence.search import evidence_about, refit, resized
from pa10cal.terms.effects.effect import Effect

_MOST_ROUNDS = 4
#: Index in `likelihood.SIZES` of the size first expected of an effect: the usual one.
_USUAL = 1


def fit_given(problem: Problem, effects: tuple[Effect, ...]) -> tuple[Problem, Fit]:
    """Fit the baseline with effects, whether or not the data speak for them.

    Sizes expected and errors of unknown cause are those of the greatest evidence; noise and weights
    are computed about the fit, until nothing changes.

    Args:
        problem: the campaign, made ready about the baseline.
        effects: what to add.

    Returns:
        The campaign made ready about the fit, and the fit.
    """
    current = fit(problem, (), (), (0.0, 0.0))
    members, sizes = tuple(range(len(effects))), (_USUAL,) * len(effects)
    settled: tuple[object, ...] = ()
    for _ in range(_MOST_ROUNDS):
        evidence = evidence_about(problem, current, effects)
        _, sizes = resized(evidence, members, sizes)
        score = evidence.score(members, sizes)
        choice = (sizes, score.nearest)
        variances = (score.pose_variance, score.torque_variance)
        problem, current = refit(problem, effects, sizes, variances, current)
        if choice == settled:
            break
        settled = choice
    return problem, current
