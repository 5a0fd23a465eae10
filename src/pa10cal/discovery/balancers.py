"""Torques that the description of an arm lacks, as rivals of errors of its sensors and gears.

Through the spring of its joint a balancer moves the arm as an error of the joint's angle does.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.special import logsumexp

from pa10cal.discovery.finding import Finding, Rival, is_named
from pa10cal.discovery.no_harm import worse_than
from pa10cal.discovery.probabilities import with_unknown_cause
from pa10cal.discovery.refitted_verdict import fitted_instead, instead, with_findings
from pa10cal.discovery.rules import EVIDENCE, NAMES, PROBABILITIES
from pa10cal.discovery.verdict import Scorer, Verdict
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint import EncoderEccentricity
from pa10cal.terms.effects.structure import Balancer
from pa10cal.terms.joint_spring import JointSpring, is_spring

S = TypeVar("S", bound=Scorer)


def with_balancers(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict in which a balancer has its odds, and stands for several errors of a joint.

    It is the only cause at its joint where it leaves as little as two names there.
    """
    for balancer in Balancer.everywhere(found.context):
        for finding in found.findings:
            if finding.of == balancer.of:
                wider = _with_odds(found.model, finding, balancer)
                found = replace(found, findings=instead(found, wider))
        found = _in_place_of_several(found, balancer)
    return found


def _with_odds(model: FittedModel, finding: Finding, balancer: Balancer) -> Finding:
    """Return a finding at a balancer's joint with the prior odds of either.

    An eccentricity has the balancer among its alternatives, since it moves the arm the same.
    """
    odds, rivals = balancer.prior_odds, finding.rivals
    if finding.id == Balancer.id:
        rivals = tuple(replace(each, prior_odds=each.prior_odds / odds) for each in rivals)
        return replace(finding, rivals=rivals)
    springs = [each for each in model.model.terms if is_spring(each) and each.of == balancer.of]
    if finding.id == EncoderEccentricity.id and springs:
        others = tuple(each for each in finding.alternatives if each.id != Balancer.id)
        nats = _nats_by_sizes(model, finding.effect, balancer, springs[0])
        finding = replace(finding, alternatives=(balancer, *others))
        rivals = (
            *(each for each in rivals if each.effect.id != Balancer.id),
            Rival(balancer, np.array([nats])),
        )
    rivals = tuple(
        replace(each, prior_odds=odds) if each.effect.id == Balancer.id else each for each in rivals
    )
    return replace(finding, rivals=rivals)


def _nats_by_sizes(
    model: FittedModel, eccentric: Effect, balancer: Balancer, spring: JointSpring
) -> float:
    """Return the log odds of a balancer against an eccentricity of a model that looks the same.

    A sine of the angle is either. What is expected of each in size and phase parts them.
    """
    from scipy.stats import multivariate_normal  # late: half a second, for few campaigns

    x, columns = model.values_of(eccentric), model.model.columns_of(eccentric)
    by_fit = np.zeros((2, 2)) if model.covariance is None else model.covariance[columns, columns]
    rad_Nm = float(model.values_of(spring)[0]) / spring.tau_ref_Nm
    nats = [
        logsumexp(
            [
                multivariate_normal.logpdf(x, cov=by_fit + size**2 * factor @ factor.T)
                for size in EVIDENCE.sizes
            ]
        )
        for factor in (eccentric.prior_factor, rad_Nm * balancer.prior_factor[:2, :2])
    ]
    return float(nats[1] - nats[0])


def _is_curve(effect: Effect) -> bool:
    """Return whether an effect names a curve of an angle: a balancer may look like several."""
    return bool(effect.curve_of) and is_named(effect)


def _in_place_of_several(found: Verdict[S], balancer: Balancer) -> Verdict[S]:
    """Return a verdict with a balancer in place of two and more names of its joint, if as good."""
    names = [each for each in found.findings if each.of == balancer.of and _is_curve(each.effect)]
    if len(names) < 2:
        return found

    def probability(finding: Finding) -> float:
        return with_unknown_cause(found, finding).explanations.probability(balancer)

    likeliest = max(names, key=probability)
    if not probability(likeliest):
        return found
    alone = likeliest.exchanged_for(balancer)
    rivals = tuple(
        replace(each, prior_odds=each.prior_odds * PROBABILITIES.second)
        if _is_curve(each.effect)
        else each
        for each in alone.rivals
    )
    tried = fitted_instead(found, likeliest, replace(alone, rivals=rivals))
    if tried is None:
        return found
    gone = [each.effect for each in names if each is not likeliest]
    tried = with_findings(tried, [each for each in tried.findings if each.effect not in gone])
    most_mm = NAMES.worse_ratio * found.train.after.rms_mm
    as_good = tried.train.after.rms_mm <= most_mm
    return (
        tried if as_good and not worse_than(tried.trusted_holdout, found.trusted_holdout) else found
    )
