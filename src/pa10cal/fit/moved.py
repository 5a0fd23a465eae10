"""What may have moved in an arm between two fits, as directions of its parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.fit.angles_seen import Discrepancy
from pa10cal.fit.problem import GaussianPrior, Problem, gain_along, remaining_disagreement
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.rules import MOVED
from pa10cal.terms.effects.effect import is_effect
from pa10cal.terms.term import Term

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
_OF_FACTORS = tuple(float(np.sqrt(factor - 1.0)) for factor in MOVED.factors)


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
    def name(self) -> tuple[str, str]:
        """Return the kind and the place."""
        return self.what.kind, self.what.of

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
    zeros = {
        f"{'d' if slides else 'theta'}_{joint}": (JOINT_ZERO, f"joint {joint}")
        for joint, slides in enumerate(arm.prismatic.tolist(), start=1)
    }

    def single(kind: str, of: str, column: int, size: float) -> Hypothesis:
        directions = np.zeros((count, 1))
        directions[column] = size
        return Hypothesis(kind, of, np.array([column]), directions, MOVED.sizes)

    for term in terms:
        columns = np.arange(first, first + len(term.parameters))
        first += len(columns)
        if term.constant:
            rigid += columns.tolist()
            for column, coordinate, parameter in zip(
                columns.tolist(), term.coordinates, term.parameters, strict=True
            ):
                what = zeros.get(coordinate, (LINK, parameter.name))
                found.append(single(*what, column, parameter.scale))
        elif "windup" in term.roles:
            rigid += columns.tolist()
            windup = int(columns[term.roles.index("windup")])
            found.append(single(STIFFNESS, term.of, windup, MOVED.softer_share * float(x[windup])))
        elif is_effect(term):
            directions = np.zeros((count, term.linear))
            directions[columns[: term.linear]] = term.prior_factor
            found.append(Hypothesis(EFFECT, f"{term.id} of {term.of}", columns, directions, (1.0,)))
    at = np.array(rigid, dtype=np.intp)
    directions = np.zeros((count, len(at)))
    values, vectors = np.linalg.eigh(covariance[np.ix_(at, at)])
    directions[at] = vectors * np.sqrt(np.maximum(values, 0.0))
    return (*found, Hypothesis(MODEL_ERROR, "arm", at, directions, _OF_FACTORS))


def sought(
    disagreed: Gaussian,
    possible: Sequence[Hypothesis],
    before: Sequence[MovedPart] = (),
) -> tuple[MovedPart, ...]:
    """Return what moved: what evidence asks for most, one after the other.

    Each has to gain the logarithm of the number of hypotheses over the rate of false names allowed.

    Args:
        disagreed: what readings, or two fits, say of more than was expected.
        before: what was found already; it is not sought again, but for a model's error.
    """
    known = {(each.what.kind, each.what.of) for each in before if each.what.kind != MODEL_ERROR}
    left = [each for each in possible if (each.kind, each.of) not in known]
    least = float(np.log(len(possible) / MOVED.error_rate))
    found: list[MovedPart] = []
    while left:
        gains = [gain_along(disagreed, each.directions, each.sizes) for each in left]
        k = int(np.argmax([gain for gain, _ in gains]))
        gain, size = gains[k]
        if gain < least:
            break
        found.append(MovedPart(left.pop(k), size, gain))
        disagreed = remaining_disagreement(disagreed, found[-1].directions)
    return tuple(found)


# What moved, by few readings: fewer than would show every part of the arm anew.
#
# Readings beyond those that base and tool take up are few enough to weigh every small set of
# departures by its evidence, sizes and noise integrated out. The noise is what the instrument
# states and what the earlier model was found to lack, or larger by some factor: were it found from
# the residuals of so few readings, whatever moved would count as noise, and nothing be found.

#: The finest uncertainty of a reading [m, rad]; and the part of the largest below which a direction
#: of base and tool is none (computing).
_FINEST_M, _SAME = 1e-9, 1e-9


@dataclass(frozen=True, eq=False)
class Misfit:
    """What readings show that the arm as it was does not explain, base and tool anew.

    Independent numbers of unit noise, beside what the parameters are uncertain by.
    """

    data: Array  # (m,)
    rows: Array  # (m, k) their derivative by the parameters of the arm, from what was expected
    known: Array  # (m,) variances by the uncertainty of these

    @classmethod
    def of_poses(
        cls,
        problem: Problem,
        x: Array,
        trust: Array,
        expected: GaussianPrior,
        lacks: Discrepancy | None,
    ) -> Misfit:
        """Return what remains of P poses about a point x of a problem, the arm as expected.

        Args:
            trust: (P,) root of the weight of each pose.
            expected: of the first k unknowns; the others are found anew.
            lacks: what the model of the arm was found to lack; None where not known.
        """
        k, rows, seen = len(expected.mean), problem.rows(x), problem.components_seen
        covariance = problem.stated_covariance + _FINEST_M**2 * np.eye(seen.shape[1])
        if lacks is not None:
            error_m = 1e-3 * lacks.error_at_mm(problem.observations.states.q_rad)
            variance = float(np.mean(error_m**2)) / MOVED.axes
            for kind, columns in problem.observations.measured.component_kinds:
                lever_m = lacks.lever_m.max() if kind.startswith("attitude") else 1.0
                np.einsum("pii->pi", covariance)[:, columns] += variance / lever_m**2
        root = trust[:, None, None] * np.linalg.inv(np.linalg.cholesky(covariance))
        jacobian = (root @ rows.jacobian)[seen]
        of_arm, frames = jacobian[:, :k], jacobian[:, k:] * problem.scale[k:]
        residual = (root @ rows.residual[:, :, None])[seen][:, 0]
        residual += of_arm @ (expected.mean - x[:k])
        left, sizes, _ = np.linalg.svd(frames)
        beyond = left[:, np.count_nonzero(sizes > _SAME * sizes.max(initial=0.0)) :]
        by_arm = beyond.T @ of_arm
        values, turn = np.linalg.eigh(by_arm @ expected.covariance @ by_arm.T)
        return cls(turn.T @ (beyond.T @ residual), turn.T @ by_arm, np.maximum(values, 0.0))

    def evidence(self, directions: Array) -> float:
        """Return the log evidence if more is possible along directions (s, k, r), of s sizes each.

        Every size, and every level of the noise, counts with its probability.
        """
        weights = 1.0 / (np.square(MOVED.louder)[:, None] + self.known)
        likely = -MOVED.louder_power * np.log(MOVED.louder)
        found = 0.5 * np.sum(np.log(weights) - weights * self.data**2, axis=1)
        if directions.size:
            columns = self.rows @ directions
            seen = np.einsum("smi,lm,smj->slij", columns, weights, columns)
            seen += np.eye(columns.shape[2])
            pull = np.einsum("smi,lm->sli", columns, weights * self.data)
            gained = np.linalg.solve(seen, pull[..., None])[..., 0]
            found = found + 0.5 * np.sum(pull * gained, axis=2) - 0.5 * np.linalg.slogdet(seen)[1]
        sizes = max(len(directions), 1)
        return float(logsumexp(found + likely) - logsumexp(likely) - np.log(sizes))


def smallest_set(misfit: Misfit, possible: Sequence[Hypothesis]) -> tuple[MovedPart, ...]:
    """Return the set of departures that is most likely by few readings: mostly one, or none.

    No set has more parts than the readings bear, and everything is anew only where they bear that.
    That a model lacks more than it was found to lack is among the levels of the noise.
    """
    possible = [each for each in possible if each.kind != MODEL_ERROR]
    zeros = [each for each in possible if each.kind == JOINT_ZERO]
    whole, count = everything(possible), len(misfit.data)
    prior = {id(each): _log_prior(each, possible, len(zeros)) for each in (*possible, whole)}

    def posterior(parts: tuple[Hypothesis, ...]) -> float:
        return misfit.evidence(_of_every_size(parts)) + sum(prior[id(each)] for each in parts)

    sets: list[tuple[Hypothesis, ...]] = [(), *((each,) for each in possible)]
    if count >= whole.directions.shape[1]:
        sets.append((whole,))
    if count >= 2 * MOVED.readings_each:
        single = [each for each in possible if each.directions.shape[1] == 1]
        sets += combinations(single, 2)
    values = [posterior(parts) for parts in sets]
    best, value = sets[int(np.argmax(values))], max(values)
    while 1 < len(best) < count // MOVED.readings_each:
        more = [(*best, each) for each in possible if each not in best]
        values = [posterior(parts) for parts in more]
        if max(values) <= value:
            break
        best, value = more[int(np.argmax(values))], max(values)
    return tuple(_sized(misfit, best))


def _log_prior(each: Hypothesis, possible: Sequence[Hypothesis], zeros: int) -> float:
    zero = each.kind == JOINT_ZERO
    share, count = (MOVED.zero_moved, zeros) if zero else (MOVED.other_moved, len(possible) - zeros)
    return float(np.log(share / count))


def _of_every_size(parts: Sequence[Hypothesis]) -> Array:
    """Return the directions (s, k, r) of a set in each of its s sizes."""
    if not parts:
        return np.zeros((1, 0, 0))
    return np.array(
        [
            np.hstack([size * each.directions for size, each in zip(sizes, parts, strict=True)])
            for sizes in product(*(each.sizes for each in parts))
        ]
    )


def _sized(misfit: Misfit, parts: Sequence[Hypothesis]) -> Iterator[MovedPart]:
    """Yield the parts of a set in the sizes that are most likely, each with what it gains."""
    if not parts:
        return
    sizes = list(product(*(each.sizes for each in parts)))
    best = int(np.argmax([misfit.evidence(each[None]) for each in _of_every_size(parts)]))
    for k, each in enumerate(parts):
        others = (*parts[:k], *parts[k + 1 :])
        gain = misfit.evidence(_of_every_size(parts)) - misfit.evidence(_of_every_size(others))
        yield MovedPart(each, sizes[best][k], gain)


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
