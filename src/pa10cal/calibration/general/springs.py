"""Which joints give way: springs that the readings show, and that predict poses not fitted.

A spring goes where readings do not show it (Schwarz's criterion, 1978). Under weights that nobody
stated one that looks certain may be what geometry lacks near the poses of the fit, and predict
others worse. So two fits of the same poses, with springs and without, are each held against
clusters of poses taken out in turn (k-means in joint space), linear about the fit. Springs stay
where clusters are predicted better by more than chance. Rows along a path leave whole regions
unseen: there no cluster and no stretch may be predicted worse.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from pa10cal.arrays import Array, Index, Mask
from pa10cal.calibration.general.fit import GeneralSolution, reach_of
from pa10cal.calibration.rules import SPRINGS
from pa10cal.fit.discrepancy import clusters_of, levers_m, stretches_of
from pa10cal.fit.problem import Problem
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.order import along_a_path
from pa10cal.terms.field import embedded
from pa10cal.terms.joint_spring import is_spring
from pa10cal.terms.model import Model
from pa10cal.terms.term import Term


def with_proven_springs(
    problem: Problem,
    found: GeneralSolution,
    springs: tuple[int, ...],
    begin: Mapping[str, float],
    fitted: Callable[..., GeneralSolution],
) -> tuple[Problem, GeneralSolution, tuple[int, ...], Array] | None:
    """Leave out springs, those that readings show least first, until they predict unseen poses.

    Args:
        problem, found, springs: what was solved, where that ended, and its springs.
        begin: where it began, by the name of the unknown; with rigid joints a fit begins there.

    Returns:
        The same of what stays, and where its fit began; None where all stay.
    """
    rigid, _ = rigid_at(problem, set(springs))
    x_rigid = np.array([begin[each.name] for each in rigid.parameters])
    without, x_start = fitted(rigid, x_rigid), None
    while not predicts_unseen((problem, found), (rigid, without)):
        gains = {joint: _gain_of_spring(problem, found, joint) for joint in springs}
        least = min(springs, key=lambda joint: gains[joint])
        springs = tuple(joint for joint in springs if joint != least)
        if not springs:
            return rigid, without, springs, x_rigid
        problem, kept = rigid_at(problem, {least})
        x_start = found.x[kept]
        found = fitted(problem, x_start)
    return None if x_start is None else (problem, found, springs, x_start)


def springs_not_shown(
    problem: Problem,
    found: GeneralSolution,
    springs: tuple[int, ...],
    sure: tuple[int, ...],
    *,
    stepwise: bool,
) -> set[int]:
    """Return the joints whose springs readings do not show: all, or the one that they show least.

    Args:
        problem, found: what was solved, and where that ended.
        sure: those of which it is there, whatever readings show.
        stepwise: whether weights are unknown too, so that springs stand in for each other.
    """
    enough = np.log(problem.readings)  # by Schwarz's criterion
    if stepwise:
        gains = {joint: _gain_of_spring(problem, found, joint) for joint in springs}
        least = min(springs, key=lambda joint: gains[joint], default=0)
        return {least} if springs and gains[least] < enough else set()
    names, variance = [each.name for each in problem.parameters], np.diag(found.covariance)
    return {
        joint
        for joint in set(springs) - set(sure)
        for k in [names.index(f"windup_{joint}")]
        if not (variance[k] > 0.0 and found.x[k] ** 2 > enough * variance[k])
    }


def _gain_of_spring(problem: Problem, found: GeneralSolution, joint: int) -> float:
    """Return by how much the weighted squares grow with a joint rigid, all else fitted anew.

    To first order, about the fit: masses act through the joint no more, and their own columns say
    what they can make up for elsewhere. Masses are expected about zero (as described), all other
    unknowns about the fit.
    """
    at = [parameter.name for parameter in problem.parameters].index(f"windup_{joint}")

    def squares(x: Array, free: Mask) -> float:
        columns, data, off = _whitened(problem, found, x, free)
        return Gaussian.of(columns, -data).about(-off).left

    free = ~found.at_bound
    with_it = squares(found.x, free)
    free[at] = False
    rigid = found.x.copy()
    rigid[at] = SPRINGS.rigid_rad
    return squares(rigid, free) - with_it


def _whitened(
    problem: Problem, found: GeneralSolution, x: Array, free: Mask
) -> tuple[Array, Array, Array]:
    """Return a problem at a point, in the noise of a fit and in what is expected of unknowns.

    Columns of the free unknowns (P, b, f) and data (P, b), and how far the masses among these are
    from what is expected of them, (f,).
    """
    root = np.sqrt(found.weights)[:, None, None] * found.whitener
    rows, reach = problem.rows(x), reach_of(problem)
    of_masses = problem.having("weight")
    columns = (root @ rows.jacobian)[:, :, free] * reach[free]
    data = (root @ rows.residual[:, :, None])[:, :, 0]
    return columns, data, np.where(of_masses, x / reach, 0.0)[free]


def rigid_at(problem: Problem, joints: set[int]) -> tuple[Problem, Mask]:
    """Return the problem without the springs of some joints, and which unknowns are left."""
    every = [term for term in problem.model.terms if is_spring(term)]
    off: list[Term] = [term for term in every if term.joint in joints]
    if len(off) == len(every):  # weights act by way of the springs alone
        off += problem.model.terms_of("weight")
    terms = tuple(term for term in problem.model.terms if term not in off)
    gone = {parameter.name for term in off for parameter in term.parameters}
    kept = np.array([parameter.name not in gone for parameter in problem.parameters])
    return replace(problem, model=Model(problem.model.chain, terms)), kept


def predicts_unseen(
    with_springs: tuple[Problem, GeneralSolution], rigid: tuple[Problem, GeneralSolution]
) -> bool:
    """Return whether springs help to predict poses that were not fitted, of two fits of the same.

    True where there are too few poses to hold clusters out.
    """
    problem, found = rigid
    states = problem.observations.states
    groups = min(SPRINGS.clusters, len(states) // SPRINGS.cluster_poses)
    if groups < 2:
        return True
    lever_m = levers_m(problem.model, problem.of_model(found.x), states)
    points = embedded(states.q_rad, lever_m, ~problem.model.chain.arm.prismatic)
    clusters = clusters_of(points, groups, np.random.default_rng(0))
    gains = _gains(with_springs, rigid, clusters)
    if gains.mean() <= gains.std(ddof=1) / np.sqrt(len(gains)):
        return False
    if not along_a_path(states.q_rad[np.argsort(states.time_s, kind="stable")]):
        return True
    along = _gains(with_springs, rigid, stretches_of(states.time_s, groups))
    return bool(min(gains.min(), along.min()) > -np.log(SPRINGS.worse_ratio))


def _gains(
    one: tuple[Problem, GeneralSolution], other: tuple[Problem, GeneralSolution], group: Index
) -> Array:
    """Return how much better one fit predicts each group held out: log of the ratio of errors."""
    first, second = _errors_m(*one, group), _errors_m(*other, group)
    return np.asarray(np.log(second / first))


def _errors_m(problem: Problem, found: GeneralSolution, group: Index) -> Array:
    """Return the root mean square position error of each group (G,) with it held out [m]."""
    free = ~found.at_bound
    columns, data, off = _whitened(problem, found, found.x, free)
    rows, reach = problem.rows(found.x), reach_of(problem)
    places = problem.observations.measured.position_columns
    parts = []
    for k in np.unique(group):
        out = np.flatnonzero(group == k)
        parts.append((out, Gaussian.of(columns[out], -data[out])))
    every = sum((own for _, own in parts), Gaussian.none(len(off)))
    errors = []
    for out, own in parts:
        step = np.zeros(len(reach))
        step[free] = reach[free] * ((every - own).about(-off).mean - off)
        left = (rows.residual[out] + rows.jacobian[out] @ step)[:, places]
        errors.append(np.sqrt(np.mean(np.sum(left**2, axis=1)) + SPRINGS.finest_m**2))
    return np.array(errors)
