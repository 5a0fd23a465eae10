"""Summary of any fit: what it identified, correlated parameters, and how many poses it needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.calibration.rules import RECORDS
from pa10cal.fit.problem import GaussianPrior, Identifiability, Solution
from pa10cal.numerics.pose_sets import Information, greedy_order
from pa10cal.results import calibration as records
from pa10cal.terms.joint_spring import reported_name, stiffness_by_solved
from pa10cal.terms.term import Role, TermParameter


@dataclass(frozen=True)
class FitSummary:
    """Summary of any fit of k parameters to P poses."""

    solution: Solution
    pose: NDArray[np.str_]  # (P,) labels of the poses fitted
    parameters: tuple[TermParameter, ...]  # the k parameters that were solved for
    roles: tuple[Role, ...]  # (k,) what each is an unknown of
    departures: dict[str, str]  # chain coordinates of departures, see `Model.departures`
    covariance: Array  # (k, k) of the parameters
    identifiability: Identifiability  # rank of the rows
    white: Array  # (P, b, k) whitened Jacobian
    position: Array  # (P, c, k) derivative of predicted positions [m], of one target each
    not_identifiable: frozenset[str]  # names of parameters that the data do not identify
    # names of those that no pose of this instrument can identify
    hidden: frozenset[str] = frozenset()
    # names of those that contain the mounting of base or tool, and so are no departures of the arm
    of_mounting: frozenset[str] = frozenset()
    # (k, k) covariance with which they predict positions; None for the same
    of_positions: Array | None = None
    # what another campaign says of the first parameters; None for nothing
    expected: GaussianPrior | None = None

    @cached_property
    def known_before(self) -> Array:
        """Return the precision of the parameters, in their scales, without the poses, (k, k)."""
        scale = np.array([parameter.scale for parameter in self.parameters])
        precision = np.eye(len(scale)) / RECORDS.possible_scales**2
        if self.expected is not None:
            known = slice(len(self.expected.mean))
            precision[known, known] += (
                self.expected.precision * np.outer(scale, scale)[known, known]
            )
        return precision

    @cached_property
    def taken(self) -> float:
        """Return how many degrees of freedom of the rows the fit took.

        Those of a prior took none: then it is the trace of the matrix from readings to fitted ones.
        """
        if self.expected is None:
            return float(self.identifiability.rank)
        scale = np.array([parameter.scale for parameter in self.parameters])
        of_poses = _gram(self.white) * np.outer(scale, scale)
        return float(np.trace(np.linalg.solve(self.known_before + of_poses, of_poses)))

    @property
    def u_positions_mm(self) -> float:
        """Return the rms standard uncertainty of positions in the poses fitted, as of any pose."""
        covariance = self.covariance if self.of_positions is None else self.of_positions
        total_m2 = np.sum(covariance * _gram(self.position)) / len(self.white)
        return float(1e3 * np.sqrt(max(total_m2, 0.0)))

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Return the names of the parameters at the end of their physical range."""
        return names_of(self.parameters, self.solution.at_bound)

    @property
    def at_upper_bound(self) -> tuple[str, ...]:
        """Return the names of those at the upper end, as the windup of the softest spring."""
        upper = [np.inf if each.upper is None else each.upper for each in self.parameters]
        lower = [-np.inf if each.lower is None else each.lower for each in self.parameters]
        x = self.solution.x
        nearer_upper = np.abs(np.array(upper) - x) < np.abs(x - np.array(lower))
        return names_of(self.parameters, self.solution.at_bound & nearer_upper)

    def having(self, *roles: Role) -> tuple[str, ...]:
        """Return the names of the parameters with one of these roles."""
        return names_of(self.parameters, np.array([role in roles for role in self.roles], bool))

    @property
    def targets_not_seen(self) -> tuple[str, ...]:
        """Return the names of coordinates of targets that no reading of the poses depends on."""
        without_effect = ~self.white.any(axis=(0, 1))
        of_target = np.array([role == "target" for role in self.roles], dtype=bool)
        return names_of(self.parameters, of_target & without_effect)


def correlated(ended: FitSummary) -> tuple[records.CorrelatedPair, ...]:
    """Return pairs of highly correlated parameters as reported (stiffness, not windup)."""
    solved = [parameter.name for parameter in ended.parameters]
    known = np.flatnonzero(
        (np.diag(ended.covariance) > 0)
        & np.array([name not in ended.not_identifiable for name in solved])
    )
    by_solved = stiffness_by_solved(ended.roles, ended.solution.x)
    covariance = by_solved @ ended.covariance @ by_solved.T
    std = np.sqrt(np.diag(covariance))
    names = list(map(reported_name, solved))
    correlation = covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    first, second = np.nonzero(np.triu(np.abs(correlation) > RECORDS.correlated, 1))
    sizes = correlation[first, second]
    worst = np.argsort(-np.abs(sizes))[: RECORDS.most_pairs]
    return tuple(
        records.CorrelatedPair(
            parameters=(names[known[first[k]]], names[known[second[k]]]),
            correlation=float(sizes[k]),
        )
        for k in worst
    )


def poses_needed(
    ended: FitSummary, u_needed_mm: float, wanted_mm: float | None = None
) -> records.PosesNeeded:
    """Order the poses of a fit by information, and return how many of them an uncertainty needs.

    A pose adds its information J^T J, whatever was read there. In the order in which the
    determinant grows fastest (D-optimality; Sun and Hollerbach, 2008, compare such criteria) few of
    the measured poses may determine the model nearly as well as all.

    Args:
        u_needed_mm: standard uncertainty of a predicted position to reach, root mean square over
            all poses.
        wanted_mm: the required one; None where none is required.
    """
    white, scale = ended.white, np.array([parameter.scale for parameter in ended.parameters])
    count, scales = len(white), np.outer(scale, scale)
    pool = np.unique(np.linspace(0, count - 1, min(count, RECORDS.pool)).round().astype(np.intp))
    information = ended.known_before

    candidates = Information(white[pool] * scale * RECORDS.possible_scales)
    order = pool[greedy_order(candidates, min(len(pool), RECORDS.most_chosen))]
    spread = _gram(ended.position) * scales / count
    enough = -(-ended.identifiability.rank // white.shape[1])

    def u_mm(of_poses: Array) -> float | None:
        if len(of_poses) < enough:
            return None
        covariance = np.linalg.inv(information + _gram(of_poses) * scales)
        u_m = float(np.sqrt(np.sum(covariance * spread)))
        return 1e3 * u_m if np.isfinite(u_m) else None

    numbers = np.unique(
        np.geomspace(1, len(order), RECORDS.curve_points).round().astype(np.intp)
    ).tolist()
    expected = [
        records.ExpectedUncertainty(poses=n, u_optimal_mm=optimal, u_measured_mm=u_mm(white[:n]))
        for n in numbers
        if (optimal := u_mm(white[order[:n]])) is not None
    ]
    few = (each.poses for each in expected if each.u_optimal_mm <= u_needed_mm)
    return records.PosesNeeded(
        measured=count,
        needed=next(few, None),
        u_needed_mm=u_needed_mm,
        wanted_mm=wanted_mm,
        u_model_mm=u_mm(white),
        d_optimal_order=tuple(ended.pose[order].tolist()),
        expected=tuple(expected),
    )


def _gram(rows: Array) -> Array:
    """Return the products (k, k) of the columns of rows (P, b, k)."""
    flat = rows.reshape(-1, rows.shape[-1])
    return np.asarray(flat.T @ flat)


def names_of(parameters: Sequence[TermParameter], rows: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return the names of the parameters in these rows (k,)."""
    return tuple(p.name for p, of_them in zip(parameters, rows, strict=True) if of_them)
