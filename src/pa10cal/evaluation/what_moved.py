"""What moved in an arm between two campaigns, by two fitted models and their covariances.

Links, springs and effects that both models have are compared as they are solved; base and tool
differ from campaign to campaign, and are reported apart. Differences are expected to scatter with
the sum of both covariances; a part that moved adds variance along its own directions, and the
evidence for that decides (`fit.moved`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from pa10cal.arrays import Array
from pa10cal.evaluation.parameter_differences import Differences, differences
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
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.results.comparison import MovedThing, WhatMoved
from pa10cal.results.record import HALF_WIDTH_95
from pa10cal.rules import MOVED

_FRAMES = {BASE_MOVED, TOOL_MOVED}
#: Verdicts where parts of one kind moved and nothing else in the arm.
_VERDICTS = {JOINT_ZERO: "joint_zero_moved", STIFFNESS: "stiffness_changed"}
#: A millimetre and a milliradian (unit).
_UNIT = 1e-3


def what_moved(first: FittedModel, second: FittedModel) -> WhatMoved | None:
    """Return what moved between two models of one arm, in order; None without a covariance."""
    if first.covariance is None or second.covariance is None:
        return None
    found = differences(first, second)
    possible = _possible(first, found)
    known = np.diag(found.covariance) > 0.0
    precision = np.zeros_like(found.covariance)
    precision[np.ix_(known, known)] = np.linalg.inv(found.covariance[np.ix_(known, known)])
    disagreement = Gaussian.of_products(precision, precision @ found.values)
    moved = sought(disagreement, possible)
    things = tuple(
        _thing(part, moved, possible, disagreement, found)
        for part in moved
        if part.what.kind != MODEL_ERROR
    )
    factor = 1.0 + sum(part.size**2 for part in moved if part.what.kind == MODEL_ERROR)
    verdict = _verdict(moved)
    square, dof = _chi_square(found)
    effects_1, effects_2 = (
        {f"{term.id} of {term.of}" for term in model.model.terms_of("effect")}
        for model in (first, second)
    )
    return WhatMoved(
        verdict=verdict,
        chi_square=square,
        dof=dof,
        chance=float(chdtrc(dof, square)) if dof else 1.0,
        factor=factor,
        moved=things,
        only_in_one=tuple(sorted(effects_1 ^ effects_2)),
        line=_line(verdict, things, factor),
    )


def _possible(first: FittedModel, found: Differences) -> tuple[Hypothesis, ...]:
    """Return the hypotheses: one for every part of the arm, for its base and its tool."""
    arm_count, count = len(found.x), len(found.values)
    covariance = found.covariance[:arm_count, :arm_count]
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

    Along directions that both fits identify: eigenvectors of the covariance in units of the
    parameters' scales.
    """
    count = len(found.x)
    scale = np.array([parameter.scale for parameter in found.parameters])
    covariance = found.covariance[:count, :count] / np.outer(scale, scale)
    variances, axes = np.linalg.eigh(covariance)
    identified = (variances > 0.0) & (variances < MOVED.open_scales**2)
    along = axes[:, identified].T @ (found.values[:count] / scale)
    return float(np.sum(along**2 / variances[identified])), int(np.count_nonzero(identified))


#: Factor and unit by which values of a unit are shown; others stay as they are (unit).
_SHOWN_IN = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "1": (1e2, "%")}


def _line(verdict: str, things: Sequence[MovedThing], factor: float) -> str:
    """Return the verdict and what moved in one line."""
    clauses = []
    for thing in things:
        clause = f"{thing.of} changed"
        if thing.by is not None and thing.interval95 is not None:
            times, unit = _SHOWN_IN.get(thing.unit, (1.0, thing.unit))
            low, high = (times * end for end in thing.interval95)
            what = {JOINT_ZERO: "the zero of ", STIFFNESS: "the windup of "}.get(thing.kind, "")
            clause = (
                f"{what}{thing.of} by {times * thing.by:+.3g} {unit} (95 % interval {low:.3g} to "
                f"{high:.3g} {unit})"
            )
        if thing.alternatives:
            clause += f", or {', or '.join(thing.alternatives[:3])}"
        clauses.append(clause)
    if factor > 1.0:
        clauses.append(
            f"links and springs differ by more than noise explains, {np.sqrt(factor):.0f} times, "
            "as where the models lack an effect"
        )
    words = verdict.replace("_", " ")
    return f"{words}: {'; '.join(clauses)}" if clauses else words


class _Motion(NamedTuple):
    """By how much one parameter moved."""

    by: float
    std: float
    unit: str


def _thing(
    part: MovedPart,
    moved: Sequence[MovedPart],
    possible: Sequence[Hypothesis],
    disagreement: Gaussian,
    found: Differences,
) -> MovedThing:
    """Return a part that moved, with its amount where it is one parameter, and alternatives."""
    others = [other for other in moved if other is not part]
    without_part = disagreement
    for other in others:
        without_part = remaining_disagreement(without_part, other.directions)
    gains = {
        (each.kind, each.of): gain_along(without_part, each.directions, each.sizes)[0]
        for each in possible
    }
    moved_names = {(other.what.kind, other.what.of) for other in moved}
    listed_loss = np.log(len(possible) / MOVED.listed)
    least_gain = max(gains[part.what.kind, part.what.of] - listed_loss, 0.0)
    named = {JOINT_ZERO: "the zero of ", STIFFNESS: "the stiffness of "}
    alternatives = tuple(
        f"{named.get(kind, '')}{of}"
        for (kind, of), gain in sorted(gains.items(), key=lambda item: -item[1])
        if (kind, of) not in moved_names and kind != MODEL_ERROR and gain > least_gain
    )
    motion = interval95 = None
    if len(part.what.columns) == 1:
        motion = _motion(part, [other.directions for other in others], disagreement, found)
        half_width = HALF_WIDTH_95 * motion.std
        interval95 = (motion.by - half_width, motion.by + half_width)
    return MovedThing(
        kind=part.what.kind,
        of=part.what.of,
        by=None if motion is None else motion.by,
        std=None if motion is None else motion.std,
        unit="" if motion is None else motion.unit,
        interval95=interval95,
        gain=part.gain,
        alternatives=alternatives,
    )


def _motion(
    part: MovedPart, others: Sequence[Array], disagreement: Gaussian, found: Differences
) -> _Motion:
    """Estimate by how much the one parameter of a part moved; a stiffness relative to itself.

    Amounts of the other parts, along their directions (k, r), have the prior variance one; that of
    the part itself has no prior.
    """
    (column,) = part.what.columns
    directions = np.hstack([part.what.directions, *others])
    information = directions.T @ disagreement.gram @ directions
    information += np.diag(np.append(0.0, np.ones(len(information) - 1)))
    covariance = np.linalg.inv(information)
    size = float(part.what.directions[column, 0])
    by = float((covariance @ (directions.T @ disagreement.projection))[0] * size)
    std = float(np.sqrt(covariance[0, 0]) * abs(size))
    if part.what.kind == STIFFNESS:
        return _Motion(by / found.x[column], abs(std / found.x[column]), "1")
    return _Motion(by, std, found.parameters[column].unit)
