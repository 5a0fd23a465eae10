"""What moved in an arm between two fits: hypotheses, and the search for those that hold.

A hypothesis is a set of directions of the arm's parameters along which the prior is widened. Where
readings are many, hypotheses are accepted one after the other by their evidence (`sought`). Where
they are fewer than would determine every part of the arm anew, all small sets of hypotheses are
compared by their posterior probability, sizes and noise integrated out (`smallest_set`). The noise
is then what the instrument states and the discrepancy of the earlier model, or larger by a factor:
estimated from the residuals of so few readings, it would absorb whatever moved.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.fit.problem import GaussianPrior, Problem, gain_along, remaining_disagreement
from pa10cal.fit.validity import Discrepancy
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.rules import MOVED
from pa10cal.terms.effects.effect import is_effect
from pa10cal.terms.term import Term

#: Kinds of hypotheses, see `Hypothesis.kind`.
JOINT_ZERO, STIFFNESS, LINK, EFFECT = "joint_zero", "stiffness", "link", "effect"
MODEL_ERROR, EVERYTHING = "model_error", "everything"
#: Frames that each campaign has of its own.
BASE_MOVED, TOOL_MOVED = "base", "tool"
#: Sizes along all principal axes of a covariance that multiply it by each of `MOVED.factors`.
_OF_FACTORS = tuple(float(np.sqrt(factor - 1.0)) for factor in MOVED.factors)
#: Least uncertainty of a reading [m, rad]; and the singular value, relative to the largest, below
#: which a direction of base and tool does not act (computing).
_FINEST_M, _SAME = 1e-9, 1e-9


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Something that may have moved."""

    # `joint_zero`, `stiffness`, `link`, `effect`; `model_error`: all rigid parameters by more than
    # their covariance; `everything`: all of them by any size
    kind: str
    of: str  # its place: `joint 2`, `delta_a_2`, …
    columns: NDArray[np.intp]  # (c,) parameters that it changes
    directions: Array  # (k, r) of the parameters, each by a usual size
    sizes: tuple[float, ...]  # multiples of these that are possible


@dataclass(frozen=True, eq=False)
class MovedPart:
    """A hypothesis that holds."""

    what: Hypothesis
    size: float  # which of its sizes is the most likely
    gain: float  # gain in log evidence [nats]

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
    """Return what may have moved in an arm.

    Args:
        terms: its terms.
        x: (k,) their parameters.
        covariance: (k, k) of these.
    """
    zeros = {
        f"{'d' if slides else 'theta'}_{joint}": f"joint {joint}"
        for joint, slides in enumerate(arm.prismatic.tolist(), start=1)
    }
    possible: list[Hypothesis] = []
    rigid: list[int] = []  # columns of link and spring parameters
    first = 0
    for term in terms:
        columns = list(range(first, first + len(term.parameters)))
        first += len(columns)
        possible += _of_term(term, columns, x, zeros)
        if term.constant or "windup" in term.roles:
            rigid += columns
    return (*possible, _model_error(np.array(rigid, dtype=np.intp), covariance))


def _of_term(
    term: Term, columns: Sequence[int], x: Array, zeros: Mapping[str, str]
) -> Iterator[Hypothesis]:
    """Yield what may have moved of one term.

    Args:
        columns: those of its parameters in x.
        zeros: the joint of each chain coordinate that is a joint's zero.
    """

    def single(kind: str, of: str, column: int, size: float) -> Hypothesis:
        directions = np.zeros((len(x), 1))
        directions[column] = size
        return Hypothesis(kind, of, np.array([column]), directions, MOVED.sizes)

    if term.constant:
        for column, coordinate, parameter in zip(
            columns, term.coordinates, term.parameters, strict=True
        ):
            kind, of = LINK, parameter.name
            if coordinate in zeros:
                kind, of = JOINT_ZERO, zeros[coordinate]
            yield single(kind, of, column, parameter.scale)
    elif "windup" in term.roles:
        windup = columns[term.roles.index("windup")]
        yield single(STIFFNESS, term.of, windup, MOVED.softer_share * float(x[windup]))
    elif is_effect(term):
        directions = np.zeros((len(x), term.linear))
        directions[columns[: term.linear]] = term.prior_factor
        yield Hypothesis(EFFECT, f"{term.id} of {term.of}", np.array(columns), directions, (1.0,))


def _model_error(columns: NDArray[np.intp], covariance: Array) -> Hypothesis:
    """Return the hypothesis of a larger error of the model, along the axes of a covariance."""
    directions = np.zeros((len(covariance), len(columns)))
    values, vectors = np.linalg.eigh(covariance[np.ix_(columns, columns)])
    directions[columns] = vectors * np.sqrt(np.maximum(values, 0.0))
    return Hypothesis(MODEL_ERROR, "arm", columns, directions, _OF_FACTORS)


def sought(disagreed: Gaussian, possible: Sequence[Hypothesis]) -> tuple[MovedPart, ...]:
    """Return what moved: the set of hypotheses of the largest log evidence, less what each costs.

    A part costs ln(m / e), with m hypotheses and the allowed rate e of false names. A larger error
    of the model explains two parts that moved better than either of them alone does, and once it is
    in the set neither gains enough. So the best set is sought three times: without that hypothesis,
    from it alone, and from the parts of the first set together with it.

    Args:
        disagreed: disagreement of readings, or of another fit, with the prior; see
            `fit.problem.disagreement`.
    """
    cost = float(np.log(len(possible) / MOVED.error_rate))
    parts = _stepwise(disagreed, [each for each in possible if each.kind != MODEL_ERROR], (), cost)
    sets = [parts]
    for error in (each for each in possible if each.kind == MODEL_ERROR):
        sets.append(_stepwise(disagreed, possible, (error,), cost))
        sets.append(_stepwise(disagreed, possible, (*(part.what for part in parts), error), cost))
    return max(sets, key=lambda each: _evidence(disagreed, each) - cost * len(each))


def _stepwise(
    disagreed: Gaussian, possible: Sequence[Hypothesis], start: Sequence[Hypothesis], cost: float
) -> tuple[MovedPart, ...]:
    """Return a set, from a start, that no exchange, removal or addition of one part improves.

    In every round each part is taken out, and the hypothesis that gains most beside the others
    takes its place; then one more is added. A part that gains less than it costs stays out.
    """
    parts = [MovedPart(each, each.sizes[-1], 0.0) for each in start]
    seen: list[set[tuple[tuple[str, str], float]]] = []
    # Sets that differ by rounding alone might follow each other without end.
    while (now := {(part.name, part.size) for part in parts}) not in seen:
        seen.append(now)
        for part in tuple(parts):
            parts.remove(part)
            parts += _largest_gain(disagreed, possible, parts, cost)
        parts += _largest_gain(disagreed, possible, parts, cost)
    return tuple(sorted(parts, key=lambda part: -part.gain))


def _largest_gain(
    disagreed: Gaussian, possible: Sequence[Hypothesis], parts: Sequence[MovedPart], cost: float
) -> list[MovedPart]:
    """Return the hypothesis that gains most beside the parts; none where it costs more."""
    names = {part.name for part in parts}
    candidates = [each for each in possible if (each.kind, each.of) not in names]
    if not candidates:
        return []
    for part in parts:
        disagreed = remaining_disagreement(disagreed, part.directions)
    gains = [gain_along(disagreed, each.directions, each.sizes) for each in candidates]
    best = int(np.argmax([gain for gain, _ in gains]))
    gain, size = gains[best]
    return [MovedPart(candidates[best], size, gain)] if gain >= cost else []


def _evidence(disagreed: Gaussian, parts: Sequence[MovedPart]) -> float:
    """Return the gain in log evidence of a set, one part after the other."""
    gained = 0.0
    for part in parts:
        gained += gain_along(disagreed, part.what.directions, (part.size,))[0]
        gained -= float(np.log(len(part.what.sizes)))
        disagreed = remaining_disagreement(disagreed, part.directions)
    return gained


@dataclass(frozen=True, eq=False)
class Misfit:
    """Residuals of readings about the expected arm, without what base and tool can explain.

    They are linear combinations of the whitened residuals, independent of each other: their
    variance is one by the noise plus `known` by the uncertainty of the arm's parameters.
    """

    data: Array  # (m,) residuals
    rows: Array  # (m, k) their derivative by the parameters of the arm
    known: Array  # (m,) their variances by the uncertainty of these parameters

    @classmethod
    def of_poses(
        cls,
        problem: Problem,
        x: Array,
        trust: Array,
        expected: GaussianPrior,
        lacks: Discrepancy | None,
    ) -> Misfit:
        """Return the residuals of P poses, linearised about a point x of a problem.

        Args:
            trust: (P,) root of the weight of each pose.
            expected: prior of the first k unknowns; base and tool, the others, have none.
            lacks: discrepancy of the earlier model; None where not known.
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
        # Components normal to the columns of base and tool, then principal axes of the arm's part.
        left_vectors, sizes, _ = np.linalg.svd(frames)
        acting = np.count_nonzero(sizes > _SAME * sizes.max(initial=0.0))
        free_of_frames = left_vectors[:, acting:]
        by_arm = free_of_frames.T @ of_arm
        values, axes = np.linalg.eigh(by_arm @ expected.covariance @ by_arm.T)
        data = axes.T @ (free_of_frames.T @ residual)
        return cls(data, axes.T @ by_arm, np.maximum(values, 0.0))

    def evidence(self, directions: Array) -> float:
        """Return the log evidence of a prior widened along directions (s, k, r) in s sizes.

        It is averaged over the sizes, and over the l factors of the noise with their probabilities.
        """
        weights = 1.0 / (np.square(MOVED.louder)[:, None] + self.known)  # (l, m)
        log_prior_of_noise = -MOVED.louder_power * np.log(MOVED.louder)
        log_evidence = 0.5 * np.sum(np.log(weights) - weights * self.data**2, axis=1)
        if directions.size:
            columns = self.rows @ directions  # (s, m, r)
            normal = np.einsum("smi,lm,smj->slij", columns, weights, columns)
            normal += np.eye(columns.shape[2])
            right = np.einsum("smi,lm->sli", columns, weights * self.data)
            amounts = np.linalg.solve(normal, right[..., None])[..., 0]
            half_squares = 0.5 * np.sum(right * amounts, axis=2)
            log_evidence = log_evidence + half_squares - 0.5 * np.linalg.slogdet(normal)[1]
        log_sizes = np.log(max(len(directions), 1))
        of_noise = logsumexp(log_prior_of_noise)
        return float(logsumexp(log_evidence + log_prior_of_noise) - of_noise - log_sizes)


def smallest_set(misfit: Misfit, possible: Sequence[Hypothesis]) -> tuple[MovedPart, ...]:
    """Return the set of hypotheses of the largest posterior probability: mostly one, or none.

    The number of readings bounds that of the parts of a set, and `everything` is considered only if
    they can determine it. A larger error of the model is no hypothesis here, but one of the factors
    of the noise.
    """
    possible = [each for each in possible if each.kind != MODEL_ERROR]
    zero_count = sum(each.kind == JOINT_ZERO for each in possible)
    whole, count = everything(possible), len(misfit.data)
    log_prior = {id(each): _log_prior(each, possible, zero_count) for each in (*possible, whole)}

    def log_posterior(parts: tuple[Hypothesis, ...]) -> float:
        return misfit.evidence(_of_every_size(parts)) + sum(log_prior[id(each)] for each in parts)

    sets: list[tuple[Hypothesis, ...]] = [(), *((each,) for each in possible)]
    if count >= whole.directions.shape[1]:
        sets.append((whole,))
    if count >= 2 * MOVED.readings_each:
        single = [each for each in possible if each.directions.shape[1] == 1]
        sets += combinations(single, 2)
    values = [log_posterior(parts) for parts in sets]
    best, best_value = sets[int(np.argmax(values))], max(values)
    while 1 < len(best) < count // MOVED.readings_each:
        larger = [(*best, each) for each in possible if each not in best]
        values = [log_posterior(parts) for parts in larger]
        if not values or max(values) <= best_value:
            break
        best, best_value = larger[int(np.argmax(values))], max(values)
    return tuple(_sized(misfit, best))


def _log_prior(each: Hypothesis, possible: Sequence[Hypothesis], zero_count: int) -> float:
    """Return the log prior probability of one hypothesis, of its part in those of its kind."""
    if each.kind == JOINT_ZERO:
        return float(np.log(MOVED.zero_moved / zero_count))
    # `everything` is not among the possible, which may be joint zeros alone.
    return float(np.log(MOVED.other_moved / max(len(possible) - zero_count, 1)))


def _of_every_size(parts: Sequence[Hypothesis]) -> Array:
    """Return the directions (s, k, r) of a set in each of the s combinations of its sizes."""
    if not parts:
        return np.zeros((1, 0, 0))
    return np.array(
        [
            np.hstack([size * each.directions for size, each in zip(sizes, parts, strict=True)])
            for sizes in product(*(each.sizes for each in parts))
        ]
    )


def _sized(misfit: Misfit, parts: Sequence[Hypothesis]) -> Iterator[MovedPart]:
    """Yield the parts of a set in their most likely sizes, each with its gain in log evidence."""
    if not parts:
        return
    sizes = list(product(*(each.sizes for each in parts)))
    directions = _of_every_size(parts)
    best = int(np.argmax([misfit.evidence(of_sizes[None]) for of_sizes in directions]))
    for k, each in enumerate(parts):
        others = (*parts[:k], *parts[k + 1 :])
        gain = misfit.evidence(directions) - misfit.evidence(_of_every_size(others))
        yield MovedPart(each, sizes[best][k], gain)


def everything(possible: Sequence[Hypothesis]) -> Hypothesis:
    """Return the hypothesis that every joint, link and spring moved, by its largest size."""
    single = [each for each in possible if each.kind in (JOINT_ZERO, LINK, STIFFNESS)]
    return Hypothesis(
        EVERYTHING,
        "arm",
        np.concatenate([each.columns for each in single]),
        np.hstack([each.sizes[-1] * each.directions for each in single]),
        (1.0,),
    )
