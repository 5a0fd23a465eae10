"""Least squares on normal equations: solver, what a fit identifies, and the best of many fits.

`minimise` solves every fit but the paper's two levels, which use scipy: Gauss-Newton steps, damped
as by Levenberg and Marquardt where they raise the cost; unknowns that would leave their range are
held at its end. Normal equations are accurate enough here, because every unknown has a prior as a
row of its own, or the problem is a small geometric one. `descend` is `minimise` for the latter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded, qr
from scipy.linalg.lapack import dposv, dpotrf, dtrtri

from pa10cal.arrays import Array, Index

Point = TypeVar("Point")

#: Actual over predicted reduction of the cost below which a step counts as too long (computing).
_POOR = 0.25
#: Damping after a first step that raises the cost, and beyond which none can lower it (computing).
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-4, 1e8
#: Relative size of rounding: of eigenvalues of normal equations, and of costs (computing).
_ROUNDING = 1e-14
#: A direction is determined by far where its eigenvalue is more than this part of the sum of all:
#: further above rounding than a factorisation may err (computing).
_BY_FAR = 1e-12
#: Rounding may make a lower bound larger than the misfit by this factor (computing).
_SLACK = 1.001
#: A descent ends after so many steps, when no unknown moves by more than this [m, rad], or when the
#: cost falls by less than this part (computing).
DESCENT_STEPS, _SMALL_STEP, SMALL_GAIN = 100, 1e-13, 1e-15
#: Unknowns are not identified if others can reproduce all but this part of their effect: an error
#: of millimetres in the nominal geometry would move their estimates by metres (size).
NOT_REPRODUCED = 1e-3


class Ranged(Protocol):
    """A parameter with a physical range."""

    @property
    def lower(self) -> float | None:
        """Return the lower bound; None where there is none."""

    @property
    def upper(self) -> float | None:
        """Return the upper bound; None where there is none."""


@dataclass(frozen=True)
class Bounds:
    """Physical ranges of k unknowns."""

    lower: Array  # (k,) lower bounds, minus infinity where there is none
    upper: Array  # (k,) upper bounds, infinity where there is none

    @classmethod
    def of(cls, parameters: Sequence[Ranged]) -> Bounds:
        """Return the ranges of parameters."""
        return cls(
            np.array([-np.inf if p.lower is None else p.lower for p in parameters]),
            np.array([np.inf if p.upper is None else p.upper for p in parameters]),
        )

    def clip(self, x: Array) -> Array:
        """Return the nearest point within the ranges."""
        return np.clip(x, self.lower, self.upper)

    def beyond(self, x: Array, step: Array) -> Array:
        """Return the correction (k,) of a step that ends outside the ranges; zero within."""
        return self.clip(x + step) - (x + step)

    def held(self, x: Array, gradient: Array) -> NDArray[np.bool_]:
        """Return which unknowns are fixed, or at a bound that lower cost lies beyond, (k,)."""
        at_lower = (x <= self.lower) & (gradient > 0.0)
        at_upper = (x >= self.upper) & (gradient < 0.0)
        return np.asarray(at_lower | at_upper | self.fixed, dtype=np.bool_)

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """Return which unknowns have a range of a single value, (k,)."""
        return np.asarray(self.lower == self.upper, dtype=np.bool_)


@dataclass(frozen=True)
class Equations:
    """Normal equations of a weighted least-squares problem at one point."""

    cost: float  # sum of squares of the residuals r, predicted minus measured
    gradient: Array  # (k,) J^T r, half the gradient of the cost; J is the derivative of r
    normal: Array  # (k, k) J^T J

    @classmethod
    def of(cls, residual: Array, jacobian: Array) -> Equations:
        """Return the equations of residuals (R,) with derivative (R, k)."""
        return cls(float(residual @ residual), jacobian.T @ residual, jacobian.T @ jacobian)


@dataclass(frozen=True)
class Factor:
    """The factor U of normal equations N (k, k), in units of their diagonal: N = D U^T U D."""

    upper: Array  # (k, k) of which the upper triangle is U
    size: Array  # (k,) the diagonal of D

    def inverse_root(self) -> Array:
        """Return R (k, k) with R R^T = N^-1, upper triangular."""
        inverse, _ = dtrtri(self.upper)
        root = np.triu(inverse)
        root /= self.size[:, None]
        return np.asarray(root, dtype=np.float64)


@dataclass(frozen=True)
class Step:
    """An accepted step."""

    step: Array  # (k,)
    held: NDArray[np.bool_]  # (k,) unknowns held at a bound
    # of the normal equations of all others; None where these are singular, where the step was
    # damped, or where it took unknowns beyond their bounds
    factor: Factor | None
    before: Equations  # at the point where it began
    gained: float  # decrease of the cost
    damping: float  # relative to the diagonal of the normal equations


@dataclass(frozen=True)
class Minimum(Generic[Point]):
    """The result of a minimisation."""

    at: Point  # the last point
    equations: Equations  # at that point
    iterations: int  # number of accepted steps
    converged: bool  # whether the last step was small, or none lowered the cost
    reason: str  # why it stopped


def minimise(
    start: Point,
    equations: Callable[[Point], Equations],
    moved: Callable[[Point, Array], Point],
    arrived: Callable[[Point, Step], bool],
    *,
    most_steps: int,
    held: Callable[[Point, Array], NDArray[np.bool_]] | None = None,
    beyond: Callable[[Point, Array], Array] | None = None,
    cost: Callable[[Point], float] | None = None,
    reweighted: Callable[[Point, Step], Equations] | None = None,
    first_damping: float = 0.0,
    no_worse: float = 1e-12,
) -> Minimum[Point]:
    """Minimise a sum of squares from a start.

    Args:
        start: the first point, within the ranges of the unknowns.
        equations: returns the equations at a point, by the present weights.
        moved: returns the point after a step (k,), within the ranges.
        arrived: returns whether an accepted step, which led to a point, was the last.
        most_steps: largest number of accepted steps.
        held: returns the unknowns held at a bound, by `Equations.gradient`; None without bounds.
        beyond: returns the correction (k,) of a step that takes unknowns beyond their bounds, zero
            for others; the step of the other unknowns is then solved again. None where there are no
            bounds, or `moved` clips the unknowns by itself.
        cost: returns the cost at a point, where that is cheaper than the equations.
        reweighted: renews the weights after an accepted step and returns the equations by these;
            None where weights stay.
        first_damping: damping of the first step, relative to the diagonal.
        no_worse: relative increase of the cost that counts as rounding.
    """
    at, here, damping = start, equations(start), first_damping
    if not np.isfinite(here.cost):
        return Minimum(at, here, 0, False, "the error at the start is no finite number")
    for count in range(most_steps):
        active = np.zeros(len(here.gradient), bool) if held is None else held(at, here.gradient)
        correction = partial(beyond, at) if beyond is not None else np.zeros_like
        while True:
            step, factor = _step_within(here, ~active, damping, correction)
            next_point = moved(at, step)
            if cost is None:
                there = equations(next_point)
                next_cost = there.cost
            else:
                there, next_cost = None, cost(next_point)
            if next_cost <= here.cost * (1.0 + no_worse):
                break
            damping = max(10.0 * damping, _LEAST_DAMPING)
            if damping > _LARGEST_DAMPING:
                return Minimum(at, here, count, True, "no step reduces the error: rounding")
        taken = Step(step, active, factor, here, here.cost - next_cost, damping)
        if reweighted is not None:
            there = reweighted(next_point, taken)
        at, here = next_point, there or equations(next_point)
        if arrived(at, taken):
            return Minimum(at, here, count + 1, True, "the last step was small")
        predicted = -float(step @ (2.0 * taken.before.gradient + taken.before.normal @ step))
        if taken.gained < _POOR * predicted and predicted > _ROUNDING * next_cost:
            damping = max(10.0 * damping, _LEAST_DAMPING)  # it overshoots a curved valley
        else:
            damping *= 0.1
    return Minimum(at, here, most_steps, False, f"{most_steps} steps were not enough")


def _step_within(
    here: Equations, free: NDArray[np.bool_], damping: float, correction: Callable[[Array], Array]
) -> tuple[Array, Factor | None]:
    """Return a damped step (k,) of the free unknowns; those that reach a bound stop there.

    And the factor of `Step`.
    """
    step, begun, factor = np.zeros(len(free)), free, None
    while free.any():
        normal, gradient = here.normal, here.gradient
        if not free.all():
            normal = normal[np.ix_(free, free)]
            gradient = gradient[free] + here.normal[np.ix_(free, ~free)] @ step[~free]
        solved, factor = _solved(normal, gradient, damping)
        step[free] = -solved
        beyond = correction(step)
        step += beyond
        stopped = free & (beyond != 0.0)
        if not stopped.any():
            break
        free = free & ~stopped
    return step, None if damping or free is not begun else factor


def solve_normal(normal: Array, right: Array) -> Array:
    """Return the solution of normal equations (k, k) for a right side (k,).

    Along directions that they do not determine, to within rounding, the solution is zero.
    """
    return _solved(normal, right, 0.0)[0] if len(right) else np.zeros(0)


def _solved(normal: Array, right: Array, damping: float) -> tuple[Array, Factor | None]:
    """Return what `solve_normal` does, and the factor; None where the equations are singular.

    Args:
        damping: added to the diagonal, relative to it.
    """
    size = np.sqrt(normal.diagonal())
    size[size == 0.0] = 1.0
    unit = normal / (size[:, None] * size)
    unit.flat[:: len(size) + 1] += damping
    diagonal = unit.diagonal().copy()
    # Its transpose is the same matrix in Fortran's order: half of it is factorised in place.
    upper, solved, failed = dposv(unit.T, right / size, overwrite_a=1)
    if failed:
        unit.flat[:: len(size) + 1] = diagonal
        values, vectors = np.linalg.eigh(unit.T)
        determined = values > _ROUNDING * values[-1]
        directions = vectors[:, determined]
        solved = directions @ ((directions.T @ (right / size)) / values[determined])
    factor = None if failed else Factor(upper, size)
    return np.asarray(solved / size, dtype=np.float64), factor


@dataclass(frozen=True)
class Linearised:
    """A least-squares problem at one point."""

    by_step: Array  # (m, k) derivative of the prediction by the step
    residual: Array  # (m,) measured minus predicted; `Equations.of` takes the opposite sign

    @property
    def cost(self) -> float:
        """Return the sum of squares."""
        return float(self.residual @ self.residual)


@dataclass(frozen=True)
class Split:
    """Directions of k unknowns that the data identify, and those that they do not."""

    identified: Array  # (k, r) a column a direction
    unidentified: Array  # (k, k - r) a column a direction, of unit length


def descend(
    start: Point,
    linearise: Callable[[Point], Linearised],
    moved: Callable[[Point, Array], Point],
    small_gain: float = SMALL_GAIN,
    most_steps: int = DESCENT_STEPS,
) -> tuple[Point, Linearised]:
    """Minimise the sum of squares of a small geometric fit, some of whose directions may be open.

    Args:
        linearise: returns the problem at a point.
        moved: returns the point after a step (k,).
        small_gain: a step that lowers the cost by a smaller part is the last.
        most_steps: largest number of steps.

    Returns:
        The point of the lowest cost, and the problem there.
    """
    # Points that were evaluated last: the minimum is mostly among them, and need not be anew.
    last_two: list[tuple[Point, Linearised]] = []

    def equations(at: Point) -> Equations:
        here = linearise(at)
        last_two[:] = [*last_two[-1:], (at, here)]
        downhill = here.by_step.T @ here.residual
        return _held_where_undetermined(here.cost, -downhill, here.by_step.T @ here.by_step)

    def arrived(at: Point, taken: Step) -> bool:
        del at
        still = np.abs(taken.step).max(initial=0.0) <= _SMALL_STEP
        return bool(still or taken.gained <= small_gain * taken.before.cost)

    minimum = minimise(start, equations, moved, arrived, most_steps=most_steps)
    for at, here in last_two:
        if at is minimum.at:
            return at, here
    return minimum.at, linearise(minimum.at)


def _held_where_undetermined(cost: float, gradient: Array, normal: Array) -> Equations:
    """Return equations whose steps have no part along directions that the data do not determine.

    Such a direction gets a gradient of zero and a large normal term. Otherwise rounding would make
    large steps along it: in the height of a fixed point over the plane of all poses, for example,
    which changes no distance.
    """
    # Mostly all are determined by far, which a factorisation shows in a fifth of the time.
    lowered = normal.copy()
    lowered.flat[:: len(normal) + 1] -= _BY_FAR * normal.trace()
    if not dpotrf(lowered.T, overwrite_a=1)[1]:
        return Equations(cost, gradient, normal)
    values, vectors = np.linalg.eigh(normal)
    undetermined = vectors[:, values <= _ROUNDING * values[-1]]
    if undetermined.shape[1]:
        gradient = gradient - undetermined @ (undetermined.T @ gradient)
        normal = normal + values[-1] * undetermined @ undetermined.T
    return Equations(cost, gradient, normal)


def split_identified(by_these: Array, by_others: Array) -> Split:
    """Split directions of unknowns by whether other unknowns can reproduce their effect.

    Args:
        by_these: (m, k) derivative of the prediction by the unknowns to split.
        by_others: (m, l) derivative by the others.
    """
    size = np.maximum(np.sqrt((by_these**2).sum(axis=0)), np.finfo(float).tiny)
    unit = by_these / size
    basis = np.asarray(np.linalg.qr(by_others)[0], dtype=float)
    not_reproduced = unit - basis @ (basis.T @ unit)
    squares, directions = np.linalg.eigh(not_reproduced.T @ not_reproduced)
    steps = np.asarray(directions / size[:, None], dtype=float)
    identified = squares > NOT_REPRODUCED**2
    return Split(steps[:, identified], _along_single_unknowns(steps[:, ~identified]))


def cluster_covariance(inverse: Array, scores: Array, cluster: Index) -> Array:
    """Return the covariance (k, k) of least squares whose errors correlate within clusters.

    That of Liang and Zeger (Biometrika 73, 1986), times G / (G - 1) for few clusters G.

    Args:
        inverse: (k, k) of the normal equations.
        scores: (N, k) each row of the design matrix times its residual.
        cluster: (N,) number of the cluster of each row, from 0.
    """
    count = int(cluster.max()) + 1
    sums = np.zeros((count, scores.shape[1]))
    np.add.at(sums, cluster, scores)
    half = inverse @ sums.T
    return np.asarray(half @ half.T * count / max(count - 1, 1))


def axis_text(vector: Array) -> str:
    """Return a direction for messages, its largest component positive."""
    unit = vector / np.linalg.norm(vector) * np.sign(vector[np.argmax(np.abs(vector))])
    return "(" + ", ".join(f"{value:.2f}" for value in unit.round(2) + 0.0) + ")"


def _along_single_unknowns(directions: Array) -> Array:
    """Return unit columns of the same span, along single unknowns as far as possible."""
    if not directions.size:
        return directions
    pivots = qr(directions.T, pivoting=True, mode="economic")[2][: directions.shape[1]]
    sparse = directions @ np.linalg.inv(directions[pivots])
    return np.asarray(sparse / np.linalg.norm(sparse, axis=0))


@dataclass(frozen=True)
class BlockTridiagonal:
    """Normal equations of P vectors of d unknowns, each coupled with the one before and after it.

    The blocks beside the diagonal are diagonal themselves, as a random walk in d components makes
    them. The matrix is a band of width d, so all is computed in time proportional to P.
    """

    blocks: Array  # (P, d, d) on the diagonal; the whole matrix is positive definite
    coupling: Array  # (P - 1, d) minus the diagonals of the blocks beside it

    @classmethod
    def of(cls, information: Array, prior: Array, coupling: Array) -> BlockTridiagonal:
        """Return the matrix with blocks information (P, d, d) plus diagonals prior (P, d)."""
        blocks, diagonal = information.copy(), range(prior.shape[1])
        blocks[:, diagonal, diagonal] += prior
        return cls(blocks, coupling)

    @cached_property
    def factor(self) -> Array:
        """Return the Cholesky factor as a lower band, (d + 1, P d)."""
        count, d = self.blocks.shape[:2]
        band = np.zeros((d + 1, count * d))
        for below in range(d):
            for column in range(d - below):
                band[below, column::d] = self.blocks[:, column + below, column]
        band[d, : (count - 1) * d] = -self.coupling.ravel()
        factor: Array = cholesky_banded(band, lower=True, check_finite=False)
        return factor

    @property
    def log_determinant(self) -> float:
        """Return the logarithm of the determinant."""
        return 2.0 * float(np.sum(np.log(self.factor[0])))

    def solve(self, right: Array) -> Array:
        """Return the solution (P, d) for a right-hand side (P, d)."""
        solution = cho_solve_banded((self.factor, True), right.ravel(), check_finite=False)
        return np.asarray(solution, dtype=np.float64).reshape(right.shape)

    def covariance(self) -> Array:
        """Return the blocks (P, d, d) on the diagonal of the inverse.

        Block elimination from both ends leaves the information of each block with all before it,
        and with all after it; the block itself is in both.
        """
        count = len(self.blocks)
        forward, backward = self.blocks.copy(), self.blocks.copy()
        for i in range(1, count):
            coupling = self.coupling[i - 1]
            forward[i] -= coupling[:, None] * np.linalg.inv(forward[i - 1]) * coupling
            j = count - 1 - i
            coupling = self.coupling[j]
            backward[j] -= coupling[:, None] * np.linalg.inv(backward[j + 1]) * coupling
        return np.asarray(np.linalg.inv(forward + backward - self.blocks), dtype=np.float64)


class BestCandidate(NamedTuple):
    """The candidate with the smallest misfit."""

    misfit: float
    number: int  # position among the candidates, from 0


def may_be_within(lower_bound: float, limit: float) -> bool:
    """Return whether a misfit with this lower bound may be at most `limit`, in the same unit."""
    return lower_bound <= _SLACK * limit


def best_candidate(
    lower_bounds: Sequence[float], misfit_of: Callable[[int], float], limit: float
) -> BestCandidate | None:
    """Return the candidate with the smallest misfit; of several such the first (branch and bound).

    A fit is expensive; a lower bound of its misfit is cheap, by a relaxed problem such as a linear
    one (`frame.target_problem`). Candidates are fitted by rising lower bound until that exceeds the
    best misfit so far. The result is the same as if all were fitted.

    Args:
        lower_bounds: lower bound of the misfit of every candidate, in the unit of the misfits.
        misfit_of: fits the candidate of this number, and returns its misfit.
        limit: the largest misfit that counts.

    Returns:
        The best candidate; None where no misfit is within the limit.
    """
    best: BestCandidate | None = None
    for number in np.argsort(lower_bounds, kind="stable").tolist():
        threshold = limit if best is None else best.misfit
        if not may_be_within(lower_bounds[number], threshold):
            break
        candidate = BestCandidate(misfit_of(number), number)
        # Of equal misfits the lower number is the smaller tuple.
        if candidate.misfit <= limit and (best is None or candidate < best):
            best = candidate
    return best
