"""Springs judged where poses are predicted that were not fitted: clusters of neighbours held out.

Under weights that nobody stated a spring that looks certain may be what geometry lacks near the
poses of the fit, and predict others worse. So two fits of the same poses, with springs and without,
are each held against clusters of poses taken out in turn (k-means in joint space), linear about
the fit. Springs stay where clusters are predicted better by more than chance. Rows along a path
leave whole regions unseen: there no cluster and no stretch may be predicted worse.
"""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.calibration.general.fit import GeneralSolution, reach_of
from pa10cal.fit.angles_seen import embedded
from pa10cal.fit.discrepancy import clusters_of, levers_m, stretches_of
from pa10cal.fit.problem import Problem
from pa10cal.observe.paths import along_a_path
from pa10cal.terms.weights import WEIGHT

#: Clusters held out in turn, and the poses of each, at least.
_CLUSTERS, _LEAST_IN_CLUSTER = 10, 2
#: Of a path, an error larger by this factor is worse.
_WORSE = 1.05
#: Errors below this are rounding [m].
_FINEST_M = 1e-12


def predicts_unseen(
    with_springs: tuple[Problem, GeneralSolution], rigid: tuple[Problem, GeneralSolution]
) -> bool:
    """Return whether springs help to predict poses that were not fitted, of two fits of the same.

    True where there are too few poses to hold clusters out.
    """
    problem, found = rigid
    states = problem.observations.states
    groups = min(_CLUSTERS, len(states) // _LEAST_IN_CLUSTER)
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
    return bool(min(gains.min(), along.min()) > -np.log(_WORSE))


def _gains(
    one: tuple[Problem, GeneralSolution], other: tuple[Problem, GeneralSolution], group: Index
) -> Array:
    """Return how much better one fit predicts each group held out: log of the ratio of errors."""
    first, second = _errors_m(*one, group), _errors_m(*other, group)
    return np.asarray(np.log(second / first))


def _errors_m(problem: Problem, found: GeneralSolution, group: Index) -> Array:
    """Return the root mean square position error of each group (G,) with it held out [m]."""
    rows, reach = problem.rows(found.x), reach_of(problem)
    free = np.flatnonzero(~found.at_bound)
    of_weights = np.array([each.name.startswith(WEIGHT) for each in problem.parameters])
    places = problem.observations.measured.position_columns
    off = np.where(of_weights, found.x / reach, 0.0)[free]
    parts = []
    for k in np.unique(group):
        out = np.flatnonzero(group == k)
        root = np.sqrt(found.weights[out])[:, None, None] * found.whitener[out]
        columns = rows.jacobian[out][:, :, free] * reach[free]
        white = (root @ columns).reshape(-1, len(free))
        data = (root @ rows.residual[out][:, :, None]).ravel()
        parts.append((out, white.T @ white, white.T @ data))
    normal = np.sum([part[1] for part in parts], axis=0) + np.eye(len(free))
    gradient = np.sum([part[2] for part in parts], axis=0) + off
    errors = []
    for out, own, own_gradient in parts:
        step = np.zeros(len(reach))
        step[free] = -reach[free] * np.linalg.solve(normal - own, gradient - own_gradient)
        left = (rows.residual[out] + rows.jacobian[out] @ step)[:, places]
        errors.append(np.sqrt(np.mean(np.sum(left**2, axis=1)) + _FINEST_M**2))
    return np.array(errors)
