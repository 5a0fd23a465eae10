"""What may have moved in an arm between two fits, as directions of its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.fit.problem import Disagreement
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.term import Offsets, Term

JOINT_ZERO, STIFFNESS, LINK, EFFECT, MODEL_ERROR, EVERYTHING = (
    "joint_zero",
    "stiffness",
    "link",
    "effect",
    "model_error",
    "everything",
)
#: Frames that each campaign has of its own.
BASE_MOVED, TOOL_MOVED = "base", "tool"
#: Probability allowed of a name where nothing moved.
ERROR_RATE = 0.01
#: Sizes of a motion, in the tolerance of the parameter or this part of a windup.
_SIZES = (1.0, 10.0)
_SOFTER = 0.3
#: An arm whose model lacks something departs by more than its noise, by such factors of variance.
_FACTORS = (3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
_OF_FACTORS = tuple(float(np.sqrt(factor - 1.0)) for factor in _FACTORS)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Something that may have moved."""

    # `joint_zero`, `stiffness`, `link`, `effect`, or `model_error`: everything, by more than the
    # noise
    kind: str
    of: str  # where: `joint 2`, `delta_a_2`, …
    columns: NDArray[np.intp]  # (c,) parameters that it changes
    directions: Array  # (k, r) of the parameters, each of a usual size
    sizes: tuple[float, ...]  # multiples of that


@dataclass(frozen=True, eq=False)
class MovedPart:
    """Something that moved."""

    what: Hypothesis  # the hypothesis
    size: float  # by which of its sizes
    gain: float  # by how much evidence rose [nats]

    @property
    def directions(self) -> Array:
        """Return the directions (k, r) at that size."""
        directions: Array = self.size * self.what.directions
        return directions


def hypotheses(
    arm: Arm, terms: Sequence[Term], x: Array, covariance: Array
) -> tuple[Hypothesis, ...]:
    """Return what may have moved in an arm of whose parameters something is known.

    Args:
        x: (k,) their parameters.
        covariance: (k, k) how well these are known.
    """
    found: list[Hypothesis] = []
    rigid: list[int] = []
    first, count = 0, len(x)

    def single(kind: str, of: str, column: int, size: float) -> Hypothesis:
        directions = np.zeros((count, 1))
        directions[column] = size
        return Hypothesis(kind, of, np.array([column]), directions, _SIZES)

    for term in terms:
        columns = np.arange(first, first + len(term.parameters))
        first += len(columns)
        if isinstance(term, Offsets):
            rigid += columns.tolist()
            for column, coordinate, parameter in zip(
                columns.tolist(), term.coordinates, term.parameters, strict=True
            ):
                kind, _, row = coordinate.rpartition("_")
                zero = kind == ("d" if arm.prismatic[int(row) - 1] else "theta")
                what = (JOINT_ZERO, f"joint {row}") if zero else (LINK, parameter.name)
                found.append(single(*what, column, parameter.scale))
        elif isinstance(term, JointSpring):
            rigid += columns.tolist()
            softer = _SOFTER * float(x[columns[0]])
            found.append(single(STIFFNESS, term.of, int(columns[0]), softer))
        elif isinstance(term, Effect):
            directions = np.zeros((count, term.linear))
            directions[columns[: term.linear]] = term.prior_factor
            found.append(Hypothesis(EFFECT, f"{term.id} of {term.of}", columns, directions, (1.0,)))
    at = np.array(rigid, dtype=np.intp)
    directions = np.zeros((count, len(at)))
    values, vectors = np.linalg.eigh(covariance[np.ix_(at, at)])
    directions[at] = vectors * np.sqrt(np.maximum(values, 0.0))
    return (*found, Hypothesis(MODEL_ERROR, "arm", at, directions, _OF_FACTORS))


def sought(
    disagreement: Disagreement,
    possible: Sequence[Hypothesis],
    before: Sequence[MovedPart] = (),
) -> tuple[MovedPart, ...]:
    """Return what moved: what evidence asks for most, one after the other.

    Each has to gain the logarithm of the number of hypotheses over the rate of false names allowed.

    Args:
        disagreement: of readings, or of two fits.
        before: what was found already; it is not sought again, but for a model's error.
    """
    known = {(each.what.kind, each.what.of) for each in before if each.what.kind != MODEL_ERROR}
    left = [each for each in possible if (each.kind, each.of) not in known]
    least = float(np.log(len(possible) / ERROR_RATE))
    found: list[MovedPart] = []
    while left:
        gains = [disagreement.gain(each.directions, each.sizes) for each in left]
        k = int(np.argmax([gain for gain, _ in gains]))
        gain, size = gains[k]
        if gain < least:
            break
        found.append(MovedPart(left.pop(k), size, gain))
        disagreement = disagreement.widened(found[-1].directions)
    return tuple(found)


def everything(possible: Sequence[Hypothesis]) -> Hypothesis:
    """Return that every joint, link and spring moved: what is left where no names suffice."""
    single = [each for each in possible if each.kind in (JOINT_ZERO, LINK, STIFFNESS)]
    return Hypothesis(
        EVERYTHING,
        "arm",
        np.concatenate([each.columns for each in single]),
        np.hstack([each.sizes[-1] * each.directions for each in single]),
        (1.0,),
    )
