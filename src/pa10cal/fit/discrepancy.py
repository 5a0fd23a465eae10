"""Model discrepancy: errors of prediction beyond noise and the covariance of the parameters.

The covariance of a fit accounts for the noise of the readings only. Errors of the model itself show
where poses are predicted that were not fitted (Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001).
Here groups of poses are held out in turn, with the model linear about its fit: poses drawn at
random, clusters of neighbours, and stretches of time. The squares of their errors, less those by
noise and parameters, are estimated as a function of the distance to the nearest fitted pose.
Components count by how certainly noise lets their squares be known, since those of the noisiest
would hide all others. Readings beyond the tails of the others count less, the farther they are: a
gross error is no property of the model. Springs that were fitted to logged torques are judged as
they predict, by the torques of the weights: noise of the log moves the poses of a fit, and no
prediction. What a fit takes for an error of the log predictions leave out. A log of another instant
and an arm that stands off its place along its last move show the same, and nobody knows how a pose
to be predicted will be reached: all of it counts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple
from warnings import catch_warnings, simplefilter

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.optimize import isotonic_regression
from scipy.spatial import cKDTree

from pa10cal.arm.chain import end_pose_with_screws
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.levels import with_levels
from pa10cal.fit.logged_torques import is_fitted_to_log, lost_without_log_mm, under_weights
from pa10cal.fit.problem import GaussianPrior
from pa10cal.fit.repeatability import (
    is_chance,
    repeatability_mm,
)
from pa10cal.fit.rows_about_fit import RowsAboutFit
from pa10cal.fit.validity import Discrepancy
from pa10cal.observe.instrument import group_means
from pa10cal.observe.observations import Observations
from pa10cal.observe.paths import along_a_path
from pa10cal.rules import LACK
from pa10cal.terms.field import embedded, well_spread
from pa10cal.terms.model import Model

#: Least divisor, and least variance [m², rad²] (computing).
_TINY, _NO_VARIANCE, _NO_SQUARE_MM2 = 1e-300, 1e-24, 1e-18


def discrepancy_of(
    model: Fitted,
    poses: Observations,
    expected: GaussianPrior | None = None,
    kept_apart: Observations | None = None,
    readings: Observations | None = None,
) -> Discrepancy | None:
    """Return the discrepancy of a model; None where there are too few poses to hold some out.

    Maps of joints stay as they were fitted: their uncertainty is in their covariance.

    Args:
        poses: the averaged poses that it was fitted to, as modelled.
        expected: prior of the model's parameters that its fit had besides these poses; None for
            none.
        kept_apart: averaged poses, as modelled, by which nothing of the model was chosen: what they
            show beyond it is added. None for none.
        readings: single readings of the poses, as modelled, by whose repeats the repeatability of
            the arm is found; None where it is not to be.
    """
    lost_mm = 0.0
    if is_fitted_to_log(model):
        of_fit = model
        lost_mm = lost_without_log_mm(of_fit, poses)
        model, poses = under_weights(of_fit, poses)
        if kept_apart:
            kept_apart = under_weights(of_fit, kept_apart)[1]
        if readings:
            readings = under_weights(of_fit, readings)[1]
    of_repeats_mm = 0.0 if readings is None else repeatability_mm(model, readings)
    by_moves_mm = _left_to_log_mm(model, poses)
    poses = poses.thinned_by_pose(LACK.most_poses)
    _, label = np.unique(poses.pose, return_inverse=True)
    count = int(label.max()) + 1
    groups = min(LACK.groups, count // LACK.least_in_group)
    if groups < 2:
        return None
    rows = RowsAboutFit.of(model, poses, expected=expected)
    rows = rows.with_repeatability(of_repeats_mm, poses.readings)
    lever_m = levers_m(model.model, model.x, poses.states)
    turns = ~model.arm.prismatic
    points = embedded(poses.states.q_rad, lever_m, turns)
    rows = rows.with_noise_of_pairs(points, label, LACK.pair_rad * float(lever_m.max()))
    places = well_spread(points, LACK.most_places)
    folds = held_out_in_turn(points, label, poses.states, groups, np.random.default_rng(0))
    held_out = _HeldOut.of(rows, points, places, folds)
    certainty = rows.certainty(group_means(held_out.square_mm2, held_out.pose))
    of_poses = rows.of_poses(held_out.square_mm2, certainty[held_out.pose])
    errors_mm2, weights = of_poses.mm2, rows.trust[held_out.pose] * of_poses.certainty
    steps_m, mean_mm2 = _by_distance(held_out.distance_m, errors_mm2, weights)
    # Poses held out are predicted by a new fit; the model itself may be further off than that even
    # where it was fitted, as one that was fitted beside an error without a name.
    expected_mm2 = max(float(np.average(errors_mm2, weights=weights)), 0.0)
    own_mm2 = rows.beyond_noise_mm2(poses.measured.by_stated_targets, certainty)
    # Base and targets were fitted under the log, too, so that a part of what is lost without it is
    # theirs.
    own_mm2 = max(own_mm2, lost_mm**2)
    mean_mm2 = mean_mm2 + max(own_mm2 - expected_mm2, 0.0)
    found = Discrepancy(
        q=poses.states.q_rad[places],
        lever_m=lever_m,
        turns=turns,
        distance_m=steps_m,
        error_mm=np.sqrt(mean_mm2),
        near_m=held_out.near_m,
        repeatability_mm=float(np.hypot(of_repeats_mm, by_moves_mm)),
    )
    found = with_levels(found, model, rows, poses)
    if kept_apart is None or not len(kept_apart):
        return found
    apart = RowsAboutFit.of(model, kept_apart)
    apart = apart.with_repeatability(of_repeats_mm, kept_apart.readings).with_noise_by(
        rows.of_noise
    )
    # Readings are averaged, and their moves known.
    of_mean = replace(found, repeatability_mm=0.0)
    more_mm2 = _beyond_promised_mm2(model, of_mean, apart, kept_apart.states.q_rad)
    return replace(found, error_mm=np.sqrt(mean_mm2 + more_mm2))


def _left_to_log_mm(model: Fitted, poses: Observations) -> float:
    """Return how far what the log errs by puts the end off, rms over poses [mm]."""
    of_log = [term for term in model.model.terms if term.error_of == "log"]
    if not of_log:
        return 0.0
    x = model.x.copy()
    x[model.model.parameter_indices(*of_log)] = 0.0
    off_m = (model.model.predict(poses.states, at)[:, :3, 3] for at in (model.x, x))
    return 1e3 * float(np.sqrt(np.mean(np.sum(np.subtract(*off_m) ** 2, axis=1))))


class _HeldOut(NamedTuple):
    """Poses held out in turn, N in all, each as often as there are partitions."""

    pose: Index  # (N,) number of each pose
    distance_m: Array  # (N,) from the nearest pose that stayed
    square_mm2: Array  # (N, b) squared errors beyond noise and parameters
    near_m: float  # distance within which most poses of the first partition are

    @classmethod
    def of(
        cls, rows: RowsAboutFit, points: Array, places: Index, folds: Iterator[Index]
    ) -> _HeldOut:
        """Hold out every group of each partition, given as the group of every pose (P,).

        Args:
            places: the poses to which distances are taken.
        """
        pose, distance_m, square_mm2, near_m = [], [], [], None
        for fold in folds:
            for k in range(int(fold.max()) + 1):
                out, stays = np.flatnonzero(fold == k), places[fold[places] != k]
                if len(out) and len(stays):
                    pose.append(out)
                    distance_m.append(cKDTree(points[stays]).query(points[out])[0])
                    square_mm2.append(rows.beyond_parameters_mm2(out))
            if near_m is None:
                near_m = float(np.quantile(np.concatenate(distance_m), LACK.near_share))
        assert near_m is not None
        return cls(
            np.concatenate(pose), np.concatenate(distance_m), np.concatenate(square_mm2), near_m
        )


def _beyond_promised_mm2(
    model: Fitted, found: Discrepancy, apart: RowsAboutFit, q_rad: Array
) -> float:
    """Return by how much squared errors at poses kept apart exceed those promised; 0 for chance.

    What was chosen of a model by the poses fitted looks better by these, however they are held out.
    All errors of a cluster of neighbours count as one.
    """
    points = embedded(q_rad, found.lever_m, found.turns)
    clusters = min(LACK.groups, len(points) // LACK.least_in_group)
    if clusters < 2 or model.covariance is None:
        return 0.0
    error_mm2, expected_mm2 = apart.squares_mm2(model.covariance)
    promised_mm2 = expected_mm2 + found.error_at_mm(q_rad) ** 2
    cluster = clusters_of(points, clusters, np.random.default_rng(0))
    errors, promised = (
        np.bincount(cluster, apart.trust * of_poses) for of_poses in (error_mm2, promised_mm2)
    )
    seen = promised > 0.0
    over = float(np.mean(errors[seen] / promised[seen]))
    if over <= 1.0 or is_chance(over, int(np.count_nonzero(seen))):  # each cluster as one deviate
        return 0.0
    return (over - 1.0) * float(np.average(promised_mm2, weights=apart.trust))


def lacking_mm(found: Discrepancy | None, q_rad: Array) -> float:
    """Return the rms of what a model lacks at joint positions (N, n) [mm]; 0 where not known."""
    return 0.0 if found is None else float(np.sqrt(np.mean(found.error_at_mm(q_rad) ** 2)))


def by_uncertain_joints_mm(model: Model, x: Array, poses: Observations) -> float:
    """Return how far stated uncertainties of joint positions put the end off, rms over poses [mm].

    It is 0 where none is stated.
    """
    if poses.log is None or not (u := poses.log.q_u_stated).any():
        return 0.0
    moved_m = _moved_by_joints(model, x, poses.states) * u[:, None]
    return 1e3 * float(np.sqrt(np.mean(np.sum(moved_m**2, axis=(1, 2)))))


def levers_m(model: Model, x: Array, states: PoseStates) -> Array:
    """Return the motion of the end for a unit of each joint, (n,): root mean square over poses.

    A joint near the end moves it by little but still turns it: its lever has a lower bound,
    relative to the largest.
    """
    moved_m = _moved_by_joints(model, x, states)
    lever_m = np.sqrt(np.mean(np.sum(moved_m**2, axis=1), axis=0))
    return np.asarray(np.maximum(lever_m, LACK.least_lever_share * lever_m.max()))


def _moved_by_joints(model: Model, x: Array, states: PoseStates) -> Array:
    """Return how the end moves for a unit of each joint, (P, 3, n)."""
    chain, columns = model.chain, model.chain.joint_columns.tolist()
    at = model.chain_coordinates(states, x)
    return end_pose_with_screws(chain, at, columns).screws[:, :3, columns]


def held_out_in_turn(
    points: Array, label: Index, states: PoseStates, groups: int, rng: np.random.Generator
) -> Iterator[Index]:
    """Yield three partitions, each as the group of every row (P,); rows of one label stay together.

    They are of random groups, of clusters of neighbours, and of stretches of time.
    """
    first = np.unique(label, return_index=True)[1]
    yield places_of(states.q_rad[first], states.time_s[first], groups, rng)[label]
    yield clusters_of(points[first], groups, rng)[label]
    yield stretches_of(states.time_s[first], groups)[label]


def places_of(q: Array, time_s: Array, groups: int, rng: np.random.Generator) -> Index:
    """Return the group of each pose (P,), drawn at random; along a path groups of short stretches.

    Successive poses of a path are nearly the same, so that single ones would not be held out.
    """
    if along_a_path(q[np.argsort(time_s, kind="stable")]):
        return stretches_of(time_s, LACK.stretches * groups) % groups
    return np.asarray(rng.permutation(len(q)) % groups)


def clusters_of(points: Array, groups: int, rng: np.random.Generator) -> Index:
    """Return the cluster of neighbours that each point (P, d) is in, (P,): k-means."""
    with catch_warnings():
        simplefilter("ignore", UserWarning)  # about a cluster that is empty
        return np.asarray(kmeans2(points, groups, minit="++", rng=rng)[1], dtype=np.intp)


def stretches_of(time_s: Array, groups: int) -> Index:
    """Return the stretch of time that each pose is in, (P,); all have about as many poses."""
    rank = np.empty(len(time_s), dtype=np.intp)
    rank[np.argsort(time_s, kind="stable")] = np.arange(len(time_s))
    return rank * groups // len(time_s)


def _by_distance(distance_m: Array, square_mm2: Array, trust: Array) -> tuple[Array, Array]:
    """Return mean distances (m,) of steps, ascending, and non-decreasing mean squares there.

    Args:
        trust: (N,) weight of each error.
    """
    order = np.argsort(distance_m, kind="stable")
    steps = max(min(LACK.steps, len(order) // LACK.least_errors), 1)
    parts = np.array_split(order, steps)
    means_m = np.array([distance_m[part].mean() for part in parts])
    means_mm2 = np.array([np.average(square_mm2[part], weights=trust[part]) for part in parts])
    sizes = np.array([trust[part].sum() for part in parts])
    return means_m, np.maximum(isotonic_regression(means_mm2, weights=sizes).x, 0.0)
