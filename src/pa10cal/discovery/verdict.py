"""What a search comes to: effects found, what has no name, and the word for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from pa10cal.terms.effects.effect import Effect

Array = NDArray[np.float64]
Word = Literal["none", "named", "ambiguous", "unexplained"]
P_co = TypeVar("P_co", covariant=True)

MAP = "joint_error_map"


@dataclass(frozen=True, eq=False)
class Finding(Generic[P_co]):
    """One effect that was found.

    Attributes:
        effect: which, and where.
        x, covariance: its reported parameters, and their covariance.
        alternatives: effects that explain the data as well in its place.
        proof: the statistics that decided.
    """

    effect: Effect
    x: Array
    covariance: Array
    alternatives: tuple[Effect, ...]
    proof: P_co


@dataclass(frozen=True)
class Unexplained:
    """Something that is missing from the model and has no name.

    Attributes:
        of: where it sits, as a place of the vocabulary; None where the data do not say.
        form: id of the smooth unknown function that predicts it best; None where none does.
        error_mm: its position error; None where a map has taken it up.
        why: why it has no name, one clause.
    """

    of: str | None
    form: str | None
    error_mm: float | None
    why: str


@dataclass(frozen=True)
class NotTestable:
    """An effect that these data cannot show.

    Attributes:
        effect: which, and where.
        why: the reason.
        by_these_poses: whether other poses might show it; not where what it needs was not logged.
    """

    effect: Effect
    why: str
    by_these_poses: bool = True


def is_named(effect: Effect) -> bool:
    """Tell whether an effect says what is wrong, and not only where."""
    return not (effect.generic or effect.id == MAP)


def reported(effect: Effect, x: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the reported parameters of an effect, and their covariance, from those solved."""
    report = effect.report(x)
    return report.values, report.jacobian @ covariance @ report.jacobian.T


def word_of(findings: Sequence[Finding[object]], unexplained: Sequence[Unexplained]) -> Word:
    """Return the verdict in a word."""
    if unexplained:
        return "unexplained"
    if not findings:
        return "none"
    return "ambiguous" if any(finding.alternatives for finding in findings) else "named"


def without_a_cause(
    findings: Sequence[Finding[object]], unexplained: Sequence[Unexplained]
) -> tuple[Unexplained, ...]:
    """Return what is unexplained, or else the maps: they say where an error is, and not why."""
    maps = [finding.effect for finding in findings if finding.effect.id == MAP]
    return tuple(unexplained) or tuple(
        Unexplained(effect.of, effect.id, None, "cause not known") for effect in maps
    )
