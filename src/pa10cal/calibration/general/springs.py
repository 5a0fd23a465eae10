"""Selection of springs: those that the readings show, and that help to predict held-out poses.

A spring is dropped where the readings do not show it (Schwarz's criterion, 1978). Where nobody
stated the weights, a spring that looks certain may stand for an error of geometry near the poses
of the fit, and predict other poses worse. So two fits of the same poses, with springs and without,
are compared by cross-validation: clusters of poses (k-means in joint space) are held out in turn,
and predicted from the others, linearly about the fit. Springs stay if they predict the clusters
better by more than chance. Poses along a path leave whole regions unseen; there, moreover, no
cluster and no stretch of the path may be predicted worse.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array, Index, Mask
from pa10cal.calibration.general.fit import GeneralSolution, reach_of
from pa10cal.calibration.rules import SPRINGS
from pa10cal.fit.discrepancy import clusters_of, levers_m, stretches_of
from pa10cal.fit.problem import Problem
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.paths import along_a_path
from pa10cal.terms.field import embedded
from pa10cal.terms.joint_spring import is_spring
from pa10cal.terms.model import Model
from pa10cal.terms.term import Term


class SpringFit(NamedTuple):
    """A fit of a problem with springs at some joints."""

    problem: Problem
    found: GeneralSolution
    springs: tuple[int, ...]  # joints, from 1
    x_start: Array  # where the fit began

    def without(self, joints: set[int], fitted: Callable[..., GeneralSolution]) -> SpringFit:
        """Return a fit without the springs of some joints, which begins where this one ended."""
        problem, kept = rigid_at(self.problem, joints)
        x_start = self.found.x[kept]
        springs = tuple(joint for joint in self.springs if joint not in joints)
        return SpringFit(problem, fitted(problem, x_start), springs, x_start)


def with_proven_springs(
    full: SpringFit, begin: Mapping[str, float], fitted: Callable[..., GeneralSolution]
) -> SpringFit:
    """Drop springs, those that the readings show least first, until the others predict better.

    Args:
        full: the fit with all springs.
        begin: start of the unknowns by their names, for the fit with rigid joints.
        fitted: fits a problem from a start.
    """
    rigid, _ = rigid_at(full.problem, set(full.springs))
    x_rigid = np.array([begin[each.name] for each in rigid.parameters])
    without = fitted(rigid, x_rigid)
    while not predicts_unseen((full.problem, full.found), (rigid, without)):
        least = least_shown(full)[0]
        if full.springs == (least,):
            return SpringFit(rigid, without, (), x_rigid)
        full = full.without({least}, fitted)
    return full


def springs_not_shown(full: SpringFit, sure: tuple[int, ...], *, stepwise: bool) -> set[int]:
    """Return the joints whose springs the readings do not show, by Schwarz's criterion.

    Args:
        sure: joints whose springs stay, whatever the readings show.
        stepwise: whether to return only the spring that is shown least. Where the weights are
            unknown too, springs stand in for each other, and the rest has to be fitted anew.
    """
    threshold = np.log(full.problem.readings)
    if stepwise:
        if not full.springs:
            return set()
        least, gain = least_shown(full)
        return {least} if gain < threshold else set()
    names = [each.name for each in full.problem.parameters]
    not_shown = set()
    for joint in set(full.springs) - set(sure):
        k = names.index(f"windup_{joint}")
        windup, variance = full.found.x[k], full.found.covariance[k, k]
        if not (variance > 0.0 and windup**2 > threshold * variance):
            not_shown.add(joint)
    return not_shown


def least_shown(full: SpringFit) -> tuple[int, float]:
    """Return the joint whose spring the readings show least, and the gain of its spring."""
    gains = {joint: _gain_of_spring(full.problem, full.found, joint) for joint in full.springs}
    least = min(gains, key=lambda joint: gains[joint])
    return least, gains[least]


def _gain_of_spring(problem: Problem, found: GeneralSolution, joint: int) -> float:
    """Return by how much the weighted squares grow if a joint is rigid and all else is refitted.

    The problem is linear about the fit. At a rigid joint weights have no effect; what they can make
    up for by way of the other joints is in their columns. The prior of the weights is about zero
    (as described), that of all other unknowns about the fit.
    """
    at = [parameter.name for parameter in problem.parameters].index(f"windup_{joint}")

    def squares(x: Array, free: Mask) -> float:
        columns, residual, prior_offset = _whitened(problem, found, x, free)
        return Gaussian.of(columns, -residual).about(-prior_offset).residual_squares

    free = ~found.at_bound
    with_spring = squares(found.x, free)
    free[at] = False
    rigid = found.x.copy()
    rigid[at] = SPRINGS.rigid_rad
    return squares(rigid, free) - with_spring


def _whitened(
    problem: Problem, found: GeneralSolution, x: Array, free: Mask
) -> tuple[Array, Array, Array]:
    """Return a problem at a point, whitened by the noise of a fit and the reach of the unknowns.

    Returns:
        Columns of the free unknowns (P, b, f), residuals (P, b), and the distance of the weights
        among these unknowns from their expectation, (f,), in reaches.
    """
    root = np.sqrt(found.weights)[:, None, None] * found.whitener
    rows, reach = problem.rows(x), reach_of(problem)
    columns = (root @ rows.jacobian)[:, :, free] * reach[free]
    residual = (root @ rows.residual[:, :, None])[:, :, 0]
    return columns, residual, np.where(problem.having("weight"), x / reach, 0.0)[free]


def rigid_at(problem: Problem, joints: set[int]) -> tuple[Problem, Mask]:
    """Return the problem without the springs of some joints, and which unknowns (k,) remain."""
    springs = [term for term in problem.model.terms if is_spring(term)]
    dropped: list[Term] = [term for term in springs if term.joint in joints]
    if len(dropped) == len(springs):  # weights act by way of the springs alone
        dropped += problem.model.terms_of("weight")
    terms = tuple(term for term in problem.model.terms if term not in dropped)
    names = {parameter.name for term in dropped for parameter in term.parameters}
    kept = np.array([parameter.name not in names for parameter in problem.parameters])
    return replace(problem, model=Model(problem.model.chain, terms)), kept


def predicts_unseen(
    with_springs: tuple[Problem, GeneralSolution], rigid: tuple[Problem, GeneralSolution]
) -> bool:
    """Return whether springs help to predict held-out poses, by two fits of the same poses.

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
    by_cluster = _log_gains(with_springs, rigid, clusters)
    standard_error = by_cluster.std(ddof=1) / np.sqrt(len(by_cluster))
    if by_cluster.mean() <= standard_error:
        return False
    if not along_a_path(states.q_rad[np.argsort(states.time_s, kind="stable")]):
        return True
    by_stretch = _log_gains(with_springs, rigid, stretches_of(states.time_s, groups))
    return bool(min(by_cluster.min(), by_stretch.min()) > -np.log(SPRINGS.worse_ratio))


def _log_gains(
    better: tuple[Problem, GeneralSolution], worse: tuple[Problem, GeneralSolution], group: Index
) -> Array:
    """Return log(error of the worse fit / error of the better one) of each group held out, (G,)."""
    return np.asarray(
        np.log(_held_out_errors_m(*worse, group) / _held_out_errors_m(*better, group))
    )


def _held_out_errors_m(problem: Problem, found: GeneralSolution, group: Index) -> Array:
    """Return the root mean square position error of each group (G,), with it held out [m].

    Args:
        group: (P,) number of the group of every pose.
    """
    free = ~found.at_bound
    columns, residual, prior_offset = _whitened(problem, found, found.x, free)
    rows, reach = problem.rows(found.x), reach_of(problem)
    places = problem.observations.measured.position_columns
    groups = []
    for k in np.unique(group):
        poses = np.flatnonzero(group == k)
        groups.append((poses, Gaussian.of(columns[poses], -residual[poses])))
    total = sum((of_group for _, of_group in groups), Gaussian.none(len(prior_offset)))
    errors_m = []
    for poses, of_group in groups:
        others = (total - of_group).about(-prior_offset)
        step = np.zeros(len(reach))
        step[free] = reach[free] * (others.mean - prior_offset)
        predicted_less_seen = (rows.residual[poses] + rows.jacobian[poses] @ step)[:, places]
        mean_square = np.mean(np.sum(predicted_less_seen**2, axis=1))
        errors_m.append(np.sqrt(mean_square + SPRINGS.finest_m**2))
    return np.array(errors_m)
