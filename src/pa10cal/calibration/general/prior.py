"""A fitted model as what is known of an arm before a further campaign of it.

Links, springs and effects of the arm are expected where the model has them, with its covariance;
base, tool and targets are each campaign's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.moved import JOINT_ZERO, STIFFNESS
from pa10cal.fit.problem import Expected
from pa10cal.fit.uncertain_weights import unknown_tool, weight_sizes
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_angle import ArrivalError
from pa10cal.terms.of_campaign import OfCampaign
from pa10cal.terms.term import Offsets, Parameter, Term
from pa10cal.terms.weights import Weights

#: Where effects sit that may be others in another campaign: of its foundation and its tool.
_OF_PLACE = ("base", "tool")
#: Grades of calibrations that say nothing reliable of an arm.
_UNSOUND = ("suspect_input", "not_converged")
#: Variance of a parameter that its fit left at the end of its range, in squares of its scale.
_AT_BOUND = 30.0


@dataclass(frozen=True)
class Release:
    """Something that moved since the prior was fitted, and is found anew."""

    kind: str  # see `fit.moved.Hypothesis`
    of: str  # where
    # by how much, where it is one number, of a stiffness as part of the windup; else None
    by: float | None
    std: float | None  # its standard uncertainty; likewise
    unit: str  # of both
    gain: float  # by how much evidence rose [nats]

    @property
    def words(self) -> str:
        """Return what moved, and by how much."""
        what = {JOINT_ZERO: "the zero of ", STIFFNESS: "the stiffness of "}.get(self.kind, "")
        if self.by is None or self.std is None:
            return f"{what}{self.of} changed"
        if self.kind == STIFFNESS:
            part = f"{100.0 * self.by:+.0f} % (95 % interval ±{196.0 * self.std:.0f} %)"
            return f"the windup of {self.of} changed by {part}"
        times, unit = {"rad": (1e3, "mrad"), "m": (1e3, "mm")}.get(self.unit, (1.0, self.unit))
        by, half = times * self.by, 1.96 * times * self.std
        return f"{what}{self.of} moved by {by:+.3f} {unit} (95 % interval ±{half:.3f} {unit})"


@dataclass(frozen=True)
class Moved:
    """What a prior was no longer right about."""

    campaign: str | None  # to which the prior was fitted; None where that is not known
    releases: tuple[Release, ...]  # what moved, the clearest first
    # of the prior's variances of links and springs, where all depart by more than noise
    factor: float

    @property
    def line(self) -> str:
        """Return the same in one sentence."""
        told = [each.words for each in self.releases]
        if self.factor > 1.0:
            told.append(
                "links and springs depart by more than noise explains: their variances count "
                f"{self.factor:.0f} times, as under a model that lacks an effect"
            )
        what = "; ".join(told) or "nothing in it moved, within its uncertainty"
        return f"started from the model of {self.campaign or 'an unnamed campaign'}: {what}"


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of an arm."""

    model: FittedModel  # the fitted model that says it
    terms: tuple[Term, ...]  # those of its terms that belong to the arm
    expected: Expected  # of their parameters


def refuse_unsound(model: FittedModel, *, force: bool = False) -> None:
    """Refuse a model whose calibration is not to be trusted.

    Args:
        model: the fitted model.
        force: whether it is taken all the same.

    Raises:
        CalibrationError: naming its grade.
    """
    if model.grade in _UNSOUND and not force:
        raise CalibrationError(
            f"the prior is graded {model.grade}",
            where="prior",
            value="" if model.fitted_to is None else model.fitted_to.health,
            allowed="a model graded good, few_poses or incomplete",
            remedy="follow the remedy of its grade, or take it all the same with --force",
        )


def prior_of(model: FittedModel, arm: Arm, payload: Payload | None) -> Prior:
    """Return what a fitted model says of an arm that may carry another tool.

    Args:
        model: the fitted model.
        arm: the nominal arm of the further campaign.
        payload: what the arm carries there; None where that is not known.

    Raises:
        CalibrationError: when the model is of another arm, or its covariance is not known.
    """
    covariance = _known(model, arm)
    terms: list[Term] = []
    from_: list[int] = []
    sizes: list[float] = []
    for term in model.model.terms:
        columns = np.arange(len(model.x))[model.model.columns_of(term)].tolist()
        if isinstance(term, ArrivalError):
            term, columns = ArrivalError(term.of), [-1]
        elif not of_arm(term):
            continue
        if isinstance(term, Weights):
            weights = _weights(term, arm, payload)
            if weights is None:
                continue
            at = dict(zip(term.columns, columns, strict=True))
            shared = {column for column in term.columns if column <= 4 * (term.n - 1)}
            columns = [at[c] if c in shared else -1 for c in weights.columns]
            term = weights
        if isinstance(term, Effect) and term.of in _OF_PLACE:
            columns = [-1] * len(columns)
        terms.append(term)
        from_ += columns
        sizes += [_size(parameter) for parameter in term.parameters]
    index, fresh = np.array(from_, dtype=np.intp), np.array(from_) < 0
    mean = np.where(fresh, 0.0, model.x[index])
    known = covariance[np.ix_(index, index)]
    known[fresh] = known[:, fresh] = 0.0
    open_ = np.diag(known) <= 0.0
    known[open_, open_] = np.square(sizes)[open_]
    return Prior(model, tuple(terms), Expected(mean, known))


def _known(model: FittedModel, arm: Arm) -> Array:
    """Return the covariance of a model of an arm, or refuse it."""
    layout = ("prismatic", "theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
    same = model.arm.n == arm.n and model.arm.convention == arm.convention
    differs = [
        name
        for name in layout
        if not same or not np.allclose(getattr(model.arm, name), getattr(arm, name), 0.0, 1e-9)
    ]
    if differs:
        raise CalibrationError(
            "the prior is a model of another arm",
            where="prior",
            value=f"{model.arm.name}; its {', '.join(differs)} differ",
            allowed=f"a model of {arm.name} with the same nominal rows",
            remedy="give a model of the arm that was measured",
        )
    if model.covariance is None:
        raise CalibrationError(
            "the covariance of the prior is not known",
            where="prior",
            value=model.arm.name,
            allowed="a model with the file of its covariance beside it",
            remedy="copy model.covariance.npz together with model.yaml, or export it again",
        )
    return model.covariance[: len(model.x), : len(model.x)].copy()


def of_arm(term: Term) -> bool:
    """Return whether a term stays with the arm from campaign to campaign, its size as well."""
    if isinstance(term, Offsets):
        return term.of == "links"
    if isinstance(term, OfCampaign | ArrivalError):
        return False
    if isinstance(term, Effect):
        moved = term.of in _OF_PLACE and term.goes_with_time
        return not moved and term.of != "instrument"
    return True


def _weights(term: Weights, arm: Arm, payload: Payload | None) -> Weights | None:
    """Return the weights that are uncertain with another tool; None where there are none."""
    if payload is None:
        return None
    if any(column <= 4 * (term.n - 1) for column in term.columns):
        weights = Weights.about(arm, weight_sizes(arm, payload))
        if term.held is not None:  # stiffness is relative to weights as heavy as these
            size = dict(zip(weights.columns, weights.sizes, strict=True))
            sizes = tuple(size.get(column, 0.0) for column in term.columns)
            weights = replace(term, sizes=sizes)
        return replace(weights, unknown_tool=not payload.known)
    return None if payload.known else unknown_tool(arm, payload)


def _size(parameter: Parameter) -> float:
    """Return how far a parameter may be of which no fit says anything."""
    return _AT_BOUND * parameter.scale if parameter.plausible is None else parameter.plausible
