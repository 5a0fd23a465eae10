"""The prior that a fitted model is for its arm in another campaign, and what cannot be one.

Links, springs and effects of the arm have the model's values and covariance. Nothing is known of
what changes with the tool, of what the model does not determine, and of base and targets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Mask
from pa10cal.calibration.rules import GROUPS, UNKNOWNS
from pa10cal.campaign.description import CampaignDescription
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import GaussianPrior
from pa10cal.fit.uncertain_weights import unknown_tool, weight_sizes
from pa10cal.observe.observations import Observations, reading_checksums
from pa10cal.terms.term import Term
from pa10cal.terms.weights import Weights, holds_weights

#: Grades of calibrations that are not reliable.
_UNSOUND = ("suspect_input", "not_converged")


@dataclass(frozen=True, eq=False)
class Prior:
    """What a fitted model says of an arm in another campaign."""

    model: FittedModel  # the fitted model
    terms: tuple[Term, ...]  # its terms that belong to the arm
    expected: GaussianPrior  # prior of their parameters


def refuse_unsound(model: FittedModel, *, force: bool = False) -> None:
    """Refuse a model whose calibration is not reliable, unless `force`.

    Raises:
        CalibrationError: naming its grade.
    """
    if model.grade in _UNSOUND and not force:
        raise CalibrationError(
            f"the prior is graded {model.grade}",
            where="prior",
            value="" if model.fitted_to is None else model.fitted_to.health,
            allowed="a model graded good, few_poses or incomplete",
            remedy="follow the remedy of its grade, or override with --force",
        )


def refuse_own_readings(
    model: FittedModel, poses: Observations, campaign: CampaignDescription
) -> None:
    """Refuse a prior that was fitted to the poses to be fitted: their noise would count twice.

    Raises:
        CalibrationError: when the prior is of the same readings under some load, whatever name
            they have; of a member of the group; or of as many poses between the same times, and of
            a campaign of this name, or, where it has no checksums of its readings, of these poses.
    """
    of, time_s = model.fitted_to, poses.states.time_s
    if of is None:
        return
    of_prior = np.array([of.poses, *of.time_s])
    of_poses = np.array([len(poses), time_s.min(), time_s.max()])
    same = not set(of.readings).isdisjoint(reading_checksums(poses))
    if np.array_equal(of_prior, of_poses, equal_nan=True):
        same |= of.campaign == campaign.name
        if not of.readings and model.discrepancy is not None:
            kept = model.discrepancy.q[:, None]
            same |= bool((kept == poses.states.q_rad).all(axis=2).any(axis=1).all())
    if same or of.campaign in [member.name for member in campaign.campaigns]:
        raise CalibrationError(
            "a campaign is not its own prior: the same readings would count twice",
            where="prior",
            value=of.campaign,
            allowed="the model of another campaign of the same arm",
            remedy="omit the prior, or give the other campaign a name of its own; a copy of the "
            "readings is no other campaign",
        )


def prior_of(model: FittedModel, arm: Arm, payload: Payload | None) -> Prior:
    """Return the prior of an arm, which may carry another tool, by a fitted model.

    Raises:
        CalibrationError: when the model is of another arm, or its covariance is not known.
    """
    refuse_as_prior(model, arm)
    assert model.covariance is not None
    covariance = model.covariance[: len(model.x), : len(model.x)].copy()
    terms: list[Term] = []
    # of every parameter: its column in the model, -1 for one that the model does not determine, and
    # its standard deviation where nothing is known
    sources: list[int] = []
    sizes: list[float] = []
    for term in model.model.terms:
        columns = model.model.parameter_indices(term).tolist()
        transferred = term.elsewhere()
        if transferred is None:
            continue
        there = transferred.term
        if holds_weights(term):
            weights = _weights(term, arm, payload)
            if weights is None:
                continue
            column_of = dict(zip(term.columns, columns, strict=True))
            links = _columns_of_links(term)
            columns = [column_of[c] if c in links else -1 for c in weights.columns]
            there = weights
        elif not transferred.same_amounts:
            columns = [-1] * len(there.parameters)
        terms.append(there)
        sources += columns
        sizes += [
            GROUPS.bound_squares * each.scale if each.plausible is None else each.plausible
            for each in there.parameters
        ]
    index = np.array(sources, dtype=np.intp)
    new = index < 0
    mean = np.where(new, 0.0, model.x[index])
    known = covariance[np.ix_(index, index)]
    known[new] = known[:, new] = 0.0
    without_variance = np.diag(known) <= 0.0  # new, or at a bound
    known[without_variance, without_variance] = np.square(sizes)[without_variance]
    variances = _with_windups_at_bound(terms, without_variance & ~new, np.diag(known))
    known[without_variance, without_variance] = variances[without_variance]
    return Prior(model, tuple(terms), GaussianPrior(mean, known))


def _columns_of_links(term: Weights) -> set[int]:
    """Return the columns of weights that another tool does not change.

    Column 4 j is the mass of link j, the next three are its first moment. Of the last link only the
    mass is without the tool.
    """
    return {column for column in term.columns if column <= 4 * (term.n - 1)}


def _with_windups_at_bound(terms: Sequence[Term], held: Mask, variances: Array) -> Array:
    """Return variances (k,), with those of windups that a fit held at a bound estimated.

    The poses would have shown a windup there about as well as those of the other joints, so these
    have at most the median variance of the others.
    """
    springs = np.array(
        [role in ("windup", "cubic") for term in terms for role in term.roles], dtype=bool
    )
    others = springs & ~held
    if others.any():
        usual = float(np.median(variances[others]))
        variances = np.where(springs & held, np.minimum(usual, variances), variances)
    return variances


def refuse_as_prior(model: FittedModel, arm: Arm) -> None:
    """Refuse a prior that is a model of another arm, or one without covariance.

    Raises:
        CalibrationError: see `refuse_another_arm`; or when there is no covariance.
    """
    refuse_another_arm(model, arm)
    if model.covariance is None:
        raise CalibrationError(
            "the covariance of the prior is not known",
            where="prior",
            value=model.arm.name,
            allowed="a model with the file of its covariance beside it",
            remedy="copy model.covariance.npz together with model.yaml, or export it again",
        )


def refuse_another_arm(
    model: FittedModel, arm: Arm, where: str = "prior", called: str = "the prior"
) -> None:
    """Refuse a model of another arm.

    Args:
        where, called: parameter that it is, and what it is called in the refusal.

    Raises:
        CalibrationError: naming the arms, or the rows that differ.
    """
    layout = ("prismatic", "theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
    same = model.arm.n == arm.n and model.arm.convention == arm.convention
    differs = [
        name
        for name in layout
        if not same
        or not np.allclose(getattr(model.arm, name), getattr(arm, name), 0.0, UNKNOWNS.same_length)
    ]
    what, value = f"{called} is a model of another arm", model.arm.name
    if model.arm.name != arm.name:
        allowed = f"a model of {arm.name}"
        remedy = (
            "give a model of the arm that was measured; where it is one arm under two names, give "
            "both descriptions the same name"
        )
    elif differs:
        value = f"{model.arm.name}; its {', '.join(differs)} differ"
        allowed = f"a model of {arm.name} with the same nominal rows"
        remedy = "give a model of the arm that was measured"
    else:
        return
    raise CalibrationError(what, where=where, value=value, allowed=allowed, remedy=remedy)


def _weights(term: Weights, arm: Arm, payload: Payload | None) -> Weights | None:
    """Return the weights that are uncertain with another tool; None where there are none."""
    if payload is None:
        return None
    if _columns_of_links(term):
        weights = Weights.about(arm, weight_sizes(arm, payload))
        if term.held is not None:  # stiffness is relative to weights as heavy as these
            size = dict(zip(weights.columns, weights.sizes, strict=True))
            sizes = tuple(size.get(column, 0.0) for column in term.columns)
            weights = replace(term, sizes=sizes)
        return replace(weights, unknown_tool=not payload.known)
    return next(iter(unknown_tool(arm, payload)), None)
