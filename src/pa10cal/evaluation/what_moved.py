"""What moved in an arm from campaign to campaign, by fitted models and their covariances.

Links, springs and effects that both models have are compared as they are solved; base and tool
differ from campaign to campaign, and are reported apart. What could not be compared is listed, and
is part of the sentence. Differences are expected to scatter with the sum of both covariances; a
part that moved adds variance along its own directions, and the evidence for that decides
(`fit.moved`). Over several campaigns this is the drift of the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.special import chdtrc

from pa10cal.errors import ModelError
from pa10cal.evaluation.parameter_differences import Differences, differences, refuse_other_layout
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.moved import (
    BASE_MOVED,
    JOINT_ZERO,
    MODEL_ERROR,
    STIFFNESS,
    TOOL_MOVED,
    Hypothesis,
    MovedPart,
    hypotheses,
    sought,
)
from pa10cal.fit.problem import gain_along, remaining_disagreement
from pa10cal.numerics.covariances import NO_VARIANCE, precision_of
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.results.comparison import DriftRecord, DriftRows, DriftStep, MovedThing, WhatMoved
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.rules import COMPARED, MOVED
from pa10cal.terms.term import Term

_FRAMES = {BASE_MOVED, TOOL_MOVED}
#: Verdicts where parts of one kind moved and nothing else in the arm.
_VERDICTS = {JOINT_ZERO: "joint_zero_moved", STIFFNESS: "stiffness_changed"}
#: Verdicts by which nothing of the arm itself is known to have moved.
NOTHING_OF_ARM = ("unchanged", "base_or_tool_moved", "not_comparable")
#: What of a place moved, by kind.
_OF_PLACE = {JOINT_ZERO: "the zero of ", STIFFNESS: "the windup of "}
#: A millimetre and a milliradian (unit).
_UNIT = 1e-3
#: Factor and unit by which values of a unit are shown; others stay as they are (unit).
_SHOWN_IN = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "1": (1e2, "%")}


def what_moved(
    first: FittedModel, second: FittedModel, names: tuple[str, str] = ("first", "second")
) -> WhatMoved | None:
    """Return what moved between two models of one arm, in order; None without a covariance.

    Args:
        names: of the two, in messages.

    Raises:
        ModelError: when the arms differ in layout.
    """
    refuse_other_layout(first.arm, second.arm, names)
    if first.covariance is None or second.covariance is None:
        return None
    found = differences(first, second)
    possible = _possible(first, found)
    disagreement = _disagreement(found)
    moved = sought(disagreement, possible)
    things = tuple(
        _thing(part, moved, possible, disagreement, found)
        for part in moved
        if part.what.kind != MODEL_ERROR
    )
    variance_factor = 1.0 + sum(part.size**2 for part in moved if part.what.kind == MODEL_ERROR)
    square, dof = _chi_square(found)
    verdict = _verdict(moved) if dof else "not_comparable"
    same_readings = _same_readings(first, second)
    reservations = _reservations(found, same_readings)
    return WhatMoved(
        verdict=verdict,
        chi_square=square,
        dof=dof,
        chance=float(chdtrc(dof, square)) if dof else 1.0,
        factor=variance_factor,
        moved=things,
        only_in_one=found.only_in_one,
        not_compared=found.not_compared,
        same_readings=same_readings,
        line=_line(verdict, things, variance_factor, reservations),
    )


def _disagreement(found: Differences) -> Gaussian:
    """Return the differences (k,) as a Gaussian of precision zero where they have no variance.

    Along those directions both models are held, so their difference says nothing.
    """
    precision = precision_of(found.covariance)
    return Gaussian.of_products(precision, precision @ found.values)


def _same_readings(first: FittedModel, second: FittedModel) -> bool:
    """Return whether some readings are of both fits, or of the priors of these."""
    in_first, in_second = (
        set() if model.fitted_to is None else {*model.fitted_to.all_readings}
        for model in (first, second)
    )
    return not in_first.isdisjoint(in_second)


def _possible(first: FittedModel, found: Differences) -> tuple[Hypothesis, ...]:
    """Return the hypotheses: one for every part of the arm, for its base and its tool."""
    arm_count, count = len(found.x), len(found.values)
    covariance = found.covariance[found.of_arm, found.of_arm]
    of_arm = [
        replace(each, directions=np.pad(each.directions, ((0, count - arm_count), (0, 0))))
        for each in hypotheses(first.arm, found.terms, found.x, covariance)
    ]
    frames = []
    for kind, columns in ((BASE_MOVED, found.base), (TOOL_MOVED, found.tool_or_targets)):
        if len(columns):
            directions = np.zeros((count, len(columns)))
            directions[columns, np.arange(len(columns))] = _UNIT
            frames.append(Hypothesis(kind, kind, columns, directions, MOVED.motions))
    return (*of_arm, *frames)


def _verdict(moved: Sequence[MovedPart]) -> str:
    kinds_of_arm = {part.what.kind for part in moved} - _FRAMES
    if not kinds_of_arm:
        return "base_or_tool_moved" if moved else "unchanged"
    if len(kinds_of_arm) == 1:
        return _VERDICTS.get(next(iter(kinds_of_arm)), "something_else")
    return "something_else"


def _chi_square(found: Differences) -> tuple[float, int]:
    """Return chi-square and degrees of freedom of the arm's differences.

    Along directions that both fits identify and neither holds: eigenvectors of the covariance in
    units of the parameters' scales.
    """
    at = found.of_arm
    scale = np.array([parameter.scale for parameter in found.parameters[at]])
    covariance = found.covariance[at, at] / np.outer(scale, scale)
    variances, axes = np.linalg.eigh(covariance)
    held = variances <= NO_VARIANCE * (np.diag(covariance) @ axes**2)
    identified = ~held & (variances < MOVED.open_scales**2)
    along = axes[:, identified].T @ (found.values[at] / scale)
    return float(np.sum(along**2 / variances[identified])), int(np.count_nonzero(identified))


def _reservations(found: Differences, same_readings: bool) -> list[str]:
    """Return why something may have changed that the verdict does not tell, a clause each."""
    clauses = []
    if found.only_in_one:
        clauses.append(f"in one model alone: {', '.join(found.only_in_one)}")
    if found.not_compared:
        clauses.append(f"not compared: {', '.join(found.not_compared)}")
    if same_readings:
        clauses.append(
            "both models rest on the same readings, as where one was the prior of the other: a "
            "small change may go unseen"
        )
    return clauses


def _line(
    verdict: str,
    things: Sequence[MovedThing],
    variance_factor: float,
    reservations: Sequence[str],
) -> str:
    """Return the verdict, what moved and what may have moved unseen in one line."""
    clauses = []
    if verdict == "not_comparable":
        clauses.append("both fits identify no common parameter of links, springs or effects")
    for thing in things:
        clause = f"{thing.of} changed"
        if thing.by is not None and thing.interval95 is not None:
            times, unit = _SHOWN_IN.get(thing.unit, (1.0, thing.unit))
            low, high = (times * end for end in thing.interval95)
            clause = (
                f"{_in_words(thing.kind, thing.of)} by {times * thing.by:+.3g} {unit} "
                f"(95 % interval {low:.3g} to {high:.3g} {unit})"
            )
        if thing.alternatives:
            clause += f", or {', or '.join(thing.alternatives[:3])}"
        clauses.append(clause)
    if variance_factor > 1.0:
        times = np.sqrt(variance_factor)  # of standard uncertainties
        clauses.append(
            f"links and springs differ by more than noise explains, {times:.2g} times, as where "
            "the models lack an effect"
        )
    words = verdict.replace("_", " ")
    if reservations and verdict == "unchanged":
        words += " as far as compared"
    if clauses:
        words += f": {'; '.join(clauses)}"
    return "; ".join([words, *reservations])


def _in_words(kind: str, of: str) -> str:
    """Return what moved, or may have moved, by its kind and place."""
    return f"{_OF_PLACE.get(kind, '')}{of}"


def _thing(
    part: MovedPart,
    moved: Sequence[MovedPart],
    possible: Sequence[Hypothesis],
    disagreement: Gaussian,
    found: Differences,
) -> MovedThing:
    """Return a part that moved, with its amount where it is one parameter, and alternatives."""
    others = [other for other in moved if other is not part]
    thing = MovedThing(
        kind=part.what.kind,
        of=part.what.of,
        by=None,
        std=None,
        unit="",
        interval95=None,
        gain=part.gain,
        alternatives=_alternatives(part, others, possible, disagreement),
    )
    if len(part.what.columns) != 1:
        return thing
    (column,) = part.what.columns
    by, std = _estimated_amount(part, others, disagreement)
    unit = found.parameters[column].unit
    if part.what.kind == STIFFNESS:  # relative to what it was
        by, std, unit = by / found.x[column], abs(std / found.x[column]), "1"
    half_width = HALF_WIDTH_95 * std
    interval95 = (by - half_width, by + half_width)
    return thing.model_copy(update={"by": by, "std": std, "unit": unit, "interval95": interval95})


def _alternatives(
    part: MovedPart,
    others: Sequence[MovedPart],
    possible: Sequence[Hypothesis],
    disagreement: Gaussian,
) -> tuple[str, ...]:
    """Return what may have moved in place of a part, with nearly its evidence, the likeliest first.

    Beside the other parts that moved.
    """
    remaining = disagreement
    for other in others:
        remaining = remaining_disagreement(remaining, other.directions)
    gains = {
        (each.kind, each.of): gain_along(remaining, each.directions, each.sizes)[0]
        for each in possible
    }
    listed_loss = np.log(len(possible) / MOVED.listed)
    least_gain = max(gains[part.name] - listed_loss, 0.0)
    moved_names = {part.name, *(other.name for other in others)}
    return tuple(
        _in_words(kind, of)
        for (kind, of), gain in sorted(gains.items(), key=lambda item: -item[1])
        if (kind, of) not in moved_names and kind != MODEL_ERROR and gain > least_gain
    )


def _estimated_amount(
    part: MovedPart, others: Sequence[MovedPart], disagreement: Gaussian
) -> tuple[float, float]:
    """Estimate by how much the one parameter of a part moved, and its standard uncertainty.

    Amounts of the other parts, along their directions, have the prior variance one; that of the
    part itself has no prior.
    """
    (column,) = part.what.columns
    directions = np.hstack([part.what.directions, *(other.directions for other in others)])
    information = directions.T @ disagreement.gram @ directions
    prior_precision = np.ones(len(information))
    prior_precision[0] = 0.0
    covariance = np.linalg.inv(information + np.diag(prior_precision))
    size = float(part.what.directions[column, 0])
    by = float((covariance @ (directions.T @ disagreement.projection))[0] * size)
    return by, float(np.sqrt(covariance[0, 0]) * abs(size))


# The parameters of one arm over campaigns, and what moved from each to the next.


def drift(models: Sequence[FittedModel], names: Sequence[str]) -> DriftRecord:
    """Return the parameters of an arm over two campaigns or more, in order of time.

    What creeps moves by too little from each to the next: the first and the last are compared too.

    Args:
        models: of the campaigns, each with its covariance.
        names: of the campaigns, a name for each.

    Raises:
        ModelError: when there are fewer than two, names are not as many or two are the same, the
            arms differ in layout, or a covariance is not known.
    """
    _refuse_models(models, names)
    campaigns = list(zip(models, names, strict=True))
    steps = [_step(before, after) for before, after in pairwise(campaigns)]
    overall = _step(campaigns[0], campaigns[-1]) if len(steps) > 1 else None
    changes = [_change(step) for step in steps if step.what_moved.line != "unchanged"]
    if overall is not None and overall.what_moved.verdict != "unchanged":
        changes.append(f"over all, {_change(overall)}")
    return DriftRecord(
        robot=models[0].arm.name,
        campaigns=tuple(names),
        parameters=_parameter_rows(models, names),
        steps=tuple(steps),
        overall=overall,
        line="; ".join(changes) or f"unchanged over {len(models)} campaigns",
    )


def _step(before: tuple[FittedModel, str], after: tuple[FittedModel, str]) -> DriftStep:
    """Return what moved between the models of two campaigns, each with its name."""
    (first, first_name), (second, second_name) = before, after
    moved = what_moved(first, second, (first_name, second_name))
    assert moved is not None
    return DriftStep(first=first_name, second=second_name, what_moved=moved)


def _change(step: DriftStep) -> str:
    return f"{step.first} to {step.second}: {step.what_moved.line}"


def _refuse_models(models: Sequence[FittedModel], names: Sequence[str]) -> None:
    if len(models) < 2:
        raise ModelError(
            "drift over a single model",
            where="models",
            value=len(models),
            allowed="two models or more, in order of time",
            remedy="give the models of further campaigns",
        )
    if len(names) != len(models):
        raise ModelError(
            "names that are not as many as the models",
            where="names",
            value=list(names),
            allowed=f"{len(models)} names",
            remedy="give a name for each model",
        )
    for model, name in zip(models, names, strict=True):
        if model.covariance is None:
            raise ModelError(
                "the covariance of a model is not known",
                where=name,
                allowed="models with the file of their covariance beside them",
                remedy="copy model.covariance.npz together with model.yaml, or export it again",
            )
    if len(set(names)) < len(names):
        raise ModelError(
            "two models of the same name",
            where="models",
            value=list(names),
            allowed="a name for each",
            remedy="give each campaign once",
        )


def _parameter_rows(models: Sequence[FittedModel], names: Sequence[str]) -> DriftRows:
    """Return the parameters of links, springs and effects of all models, with 95 % intervals.

    Without those that no pose determines, whose uncertainty is 0, and without curves.
    """
    rows = [
        {
            "campaign": name,
            "term": term.id,
            "of": term.of,
            "parameter": parameter.name,
            "unit": parameter.unit,
            "value": value,
            "std": std,
            "low": value - HALF_WIDTH_95 * std,
            "high": value + HALF_WIDTH_95 * std,
        }
        for model, name in zip(models, names, strict=True)
        for term, parameter, value, std in model.every_reported()
        if std > 0.0 and len(term.parameters) <= COMPARED.most_parameters and _belongs_to_arm(term)
    ]
    return DriftRows.model_validate(rows)


def _belongs_to_arm(term: Term) -> bool:
    """Return whether a term is of links, springs or effects: not of a base, tool or weight."""
    return {"base", "tool", "weight"}.isdisjoint(term.roles)
