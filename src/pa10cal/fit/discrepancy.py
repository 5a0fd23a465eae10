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
prediction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple
from warnings import catch_warnings, simplefilter

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.optimize import isotonic_regression
from scipy.spatial import cKDTree

from pa10cal.arm.chain import BASE, end_pose_with_screws
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.logged_torques import is_fitted_to_log, lost_without_log_mm, under_weights
from pa10cal.fit.problem import GaussianPrior, Problem, Rows, possible_sizes
from pa10cal.fit.repeatability import (
    along_noise_axes,
    components_factor,
    is_chance,
    noise_mm2,
    repeatability_mm,
    to_mm,
    trust_of,
)
from pa10cal.fit.validity import Discrepancy
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.instrument import Instrument, group_means
from pa10cal.observe.observations import Observations
from pa10cal.observe.paths import along_a_path
from pa10cal.observe.points import keep_their_distances
from pa10cal.rules import LACK
from pa10cal.terms.field import embedded, well_spread
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import base_frame
from pa10cal.terms.wrapped import fixed

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
        repeatability_mm=of_repeats_mm,
    )
    if kept_apart is None or not len(kept_apart):
        return found
    apart = RowsAboutFit.of(model, kept_apart)
    apart = apart.with_repeatability(of_repeats_mm, kept_apart.readings).with_noise_by(
        rows.of_noise
    )
    of_mean = replace(found, repeatability_mm=0.0)  # readings are averaged
    more_mm2 = _beyond_promised_mm2(model, of_mean, apart, kept_apart.states.q_rad)
    return replace(found, error_mm=np.sqrt(mean_mm2 + more_mm2))


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


def _by_variance(measured: Instrument, residual: Array, variance: Array) -> Array:
    """Return root weights of components (P, b): by the larger of stated and observed variance."""
    seen, weight = measured.components_seen, np.zeros_like(residual)
    for _, columns in measured.component_kinds:
        of_kind = residual[:, columns][seen[:, columns]]
        observed = np.median(of_kind**2) / LACK.median_square if len(of_kind) else 1.0
        larger = np.maximum(variance[:, columns], max(observed, _NO_VARIANCE))
        weight[:, columns] = np.where(seen[:, columns], 1.0 / np.sqrt(larger), 0.0)
    return weight


def less_far_off(measured: Instrument, white: Array) -> Array:
    """Return by how much poses count in the fit of the others, (P,), by white residuals (P, b)."""
    seen = measured.components_seen
    size = np.sqrt((white**2).sum(axis=1) / np.maximum(seen.sum(axis=1), 1))
    return np.asarray(np.minimum(1.0, LACK.far * np.median(size) / np.maximum(size, _TINY)))


def _prior_about(expected: GaussianPrior, x: Array, free: Index, sizes: Array) -> Gaussian:
    """Return a prior of parameters as one of their deviations from x (k,), over sizes (u,).

    The first of the u unknowns are the parameters `free`. The prior is one of the first parameters
    of x, those of the arm, and says nothing of the others, such as those of the tool.
    """
    count = len(expected.mean)
    known = np.append(free < count, np.zeros(len(sizes) - len(free), bool))
    at = np.zeros(len(sizes), np.intp)  # of others the size is 0
    at[known] = free[free < count]
    off = expected.precision @ (x[:count] - expected.mean)
    gaussian = Gaussian.of_products(expected.precision[np.ix_(at, at)], off[at])
    return gaussian.in_sizes(np.where(known, sizes, 0.0))


def _with_maps_held(model: Fitted) -> tuple[Model, Index]:
    """Return a model with its maps held and a free base, and the indices of the free parameters."""
    held, free = [], []
    for term in model.model.terms:
        held.append(fixed(term, model.values_of(term)) if term.at_knots else term)
        if not term.at_knots:
            free.append(term)
    at = Model(model.model.chain, (*held, base_frame()))
    return at, model.model.parameter_indices(*free)


class SquaresOfPoses(NamedTuple):
    """Squares of position errors beyond noise, and by how much each counts."""

    mm2: Array  # (N,)
    certainty: Array  # (N,)


@dataclass(frozen=True, eq=False)
class RowsAboutFit:
    """Weighted rows of a model, linear about its fit, from which groups of poses can be taken.

    The unknowns are the model's parameters but for those of maps, six small motions of the base,
    and t coordinates of targets.
    """

    data: Array  # (P, b) weighted residuals without the field
    residual: Array  # (P, b) weighted residuals of the whole model, the field included
    weight: Array  # (P, b) root weights of the components, 0 where nothing was seen
    columns: Array  # (P, b, k) weighted derivative by the unknowns, each over its possible size
    sizes: Array  # (k,) possible size of each unknown
    # (k - 6 - t,) indices, among the model's parameters, of the first unknowns
    parameter_index: Index
    of_field: Mask  # (k,) which unknowns are those of a field, fitted to residuals of the others
    to_mm: Array  # (P, b) factor from a weighted component to its part of the position error [mm]
    noise_mm2: Array  # (P, b) what noise of each component adds to the square of that error
    # ratio of the variance of predictions by the model's covariance to that by these rows
    of_parameters: float
    # factor of a squared error: 3 where only the line-of-sight component is measured, else 1
    components_factor: float
    trust: Array  # (P,) by how much the error of each pose counts, 1 but for gross errors
    before: Gaussian  # what was known of the unknowns besides the rows
    of_noise: float = 1.0  # variance of the noise over the stated one

    @property
    def by_unknowns(self) -> Array:
        """Return the weighted derivative by the unknowns in their own units, (P, b, k)."""
        return self.columns / self.sizes

    @cached_property
    def every(self) -> Gaussian:
        """Return the normal equations of all rows and of what was known before."""
        return Gaussian.of(self.columns, self.data) + self.before

    def solved(self, rows: Gaussian, columns: Array) -> tuple[Array, Array]:
        """Return the unknowns (k,) by some rows, and variances of predictions by columns (…, k).

        A field is fitted to the residuals of the other unknowns.
        """
        others, field = np.flatnonzero(~self.of_field), np.flatnonzero(self.of_field)
        if not len(field):
            return rows.mean, rows.variances(columns)
        first, then, mean = rows.in_turn(others, field)
        return mean, first.variances(columns[..., others]) + then.variances(columns[..., field])

    @classmethod
    def of(
        cls,
        model: Fitted,
        poses: Observations,
        weight: Array | None = None,
        expected: GaussianPrior | None = None,
    ) -> RowsAboutFit:
        """Return the rows of averaged poses, as modelled.

        Args:
            weight: (P, b) root weights; None for those by the residuals.
            expected: prior of the model's parameters besides the rows; None for none.
        """
        poses = replace(poses, measured=poses.measured.of_end(model.T_end_shown))
        at, free = _with_maps_held(model)
        x = np.concatenate([model.x[free], np.zeros(len(BASE))])
        measured, count = poses.measured, len(model.targets_m)
        problem = Problem(at, np.arange(count), model.targets_m, model.T_instr_base, poses)
        rows, covariance = problem.rows(problem.start(x)), measured.stated_covariance
        jacobian, _ = along_noise_axes(measured, rows.jacobian, covariance)
        residual, covariance = along_noise_axes(measured, rows.residual, covariance)
        rows = Rows(residual, jacobian)
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        by_variance = _by_variance(measured, rows.residual, variance)
        white = by_variance * rows.residual
        if weight is None:
            weight = by_variance * less_far_off(measured, white)[:, None]
        sizes = possible_sizes(at, measured if count else None)
        of_field = np.append(at.having("field"), np.zeros(len(sizes) - len(at.parameters), bool))
        # Residuals are with the field, whose prior mean is zero.
        by_field = rows.jacobian[:, :, of_field] @ x[of_field[: len(x)]]
        trust = trust_of(measured, white)
        trust[keep_their_distances(measured)] = 1.0  # these readings are right
        before = Gaussian.none(len(sizes))
        if expected is not None:
            before = _prior_about(expected, model.x, free, sizes)
        about = cls(
            data=weight * (rows.residual - by_field),
            residual=weight * rows.residual,
            weight=weight,
            columns=weight[:, :, None] * rows.jacobian * sizes,
            sizes=sizes,
            parameter_index=free,
            of_field=of_field,
            to_mm=to_mm(measured, weight),
            noise_mm2=noise_mm2(measured, variance),
            of_parameters=1.0,
            components_factor=components_factor(measured),
            trust=trust,
            before=before,
        )
        if model.covariance is None:
            return about
        return replace(about, of_parameters=about._share_of_variance(model.covariance))

    def _by_parameters_mm2(self, covariance: Array) -> Array:
        """Return what a model's covariance (k, k) adds to the square of the position error, (P,).

        That of its maps is left out.
        """
        others = self.columns.shape[2] - len(self.parameter_index)  # base and targets
        known = np.append(self.parameter_index, np.arange(-others, 0))
        moved_mm = self.to_mm[:, :, None] * self.by_unknowns
        of_known = covariance[np.ix_(known, known)]
        return np.asarray(np.einsum("pbk,pbk->p", moved_mm @ of_known, moved_mm))

    def _share_of_variance(self, covariance: Array) -> float:
        """Return `of_parameters` by the model's covariance, at most 1."""
        by_model_mm2 = float(self._by_parameters_mm2(covariance).sum())
        by_rows_mm2 = float(np.sum(self.to_mm**2 * self.solved(self.every, self.columns)[1]))
        return min(by_model_mm2 / max(by_rows_mm2, _TINY), 1.0)

    def squares_mm2(self, covariance: Array) -> tuple[Array, Array]:
        """Return squared position errors (P,), and those by noise and a model's covariance (P,)."""
        error_mm2 = np.sum((self.to_mm * self.residual) ** 2, axis=1)
        expected_mm2 = self.noise_mm2.sum(axis=1) + self._by_parameters_mm2(covariance)
        return self.components_factor * error_mm2, self.components_factor * expected_mm2

    def with_noise_of_pairs(self, points: Array, label: Index, within_m: float) -> RowsAboutFit:
        """Return the rows with noise estimated from nearest neighbours, where it is the smaller.

        Two poses within a distance have the same error of the model: half the square of the
        difference of their residuals is noise (the nugget of a variogram). If it is less than the
        stated noise, the latter was too large.
        """
        away_m, at = map(np.asarray, cKDTree(points).query(points, k=2))
        other = at[:, 1]
        near = (away_m[:, 1] < within_m) & (label != label[other])
        if np.count_nonzero(near) < LACK.least_pairs:
            return self
        error_mm = self.to_mm * self.data
        half = 0.5 * ((error_mm - error_mm[other]) ** 2).sum(axis=1)[near]
        trust = (self.trust * self.trust[other])[near]
        stated = 0.5 * (self.noise_mm2 + self.noise_mm2[other]).sum(axis=1)[near]
        part = float(np.sum(trust * half)) / max(float(np.sum(trust * stated)), _TINY)
        return self.with_noise_by(min(part, 1.0))

    def with_noise_by(self, factor: float) -> RowsAboutFit:
        """Return the rows with variances of noise times a factor."""
        return replace(self, noise_mm2=factor * self.noise_mm2, of_noise=factor)

    def with_repeatability(self, of_reading_mm: float, readings: Index) -> RowsAboutFit:
        """Return the rows with noise that has the repeatability of the arm, too.

        Args:
            of_reading_mm: rms of the position in a single reading.
            readings: (P,) how many were averaged.
        """
        shown = self.to_mm > 0.0
        of_pose_mm2 = of_reading_mm**2 / (self.components_factor * readings)
        share = shown / np.maximum(shown.sum(axis=1, keepdims=True), 1)
        return replace(self, noise_mm2=self.noise_mm2 + of_pose_mm2[:, None] * share)

    def certainty(self, square_mm2: Array) -> Array:
        """Return by how much each component counts in mean squares beyond noise, (P, b).

        A square varies by its own expected size, so that those of noisy components would hide what
        a model lacks: each counts by the inverse square of noise and lack together, 1 for the least
        noisy. All count alike where together they surely show more than the certain ones.

        Args:
            square_mm2: (P, b) squares beyond noise and parameters.
        """
        shown = self.to_mm > 0.0
        count = np.maximum(shown.sum(axis=1, keepdims=True), 1)
        noise_mm2 = self.components_factor * count * self.noise_mm2  # if all components had it
        alike = certainty = shown.astype(float)
        every_mm2 = lack_mm2 = self._mean_mm2(square_mm2, alike)
        for _ in range(LACK.rounds):
            size_mm2 = np.maximum(noise_mm2 + max(lack_mm2, 0.0), _NO_SQUARE_MM2)
            certainty = np.where(shown, (size_mm2[shown].min(initial=np.inf) / size_mm2) ** 2, 0.0)
            lack_mm2 = self._mean_mm2(square_mm2, certainty)
        variance = 2.0 * np.sum(np.where(shown, size_mm2 / count, 0.0) ** 2, axis=1)
        u_mm2 = np.sqrt(np.sum(self.trust**2 * variance)) / self.trust.sum()
        return alike if every_mm2 - lack_mm2 > LACK.surely * u_mm2 else certainty

    def _mean_mm2(self, square_mm2: Array, certainty: Array) -> float:
        of_poses = self.of_poses(square_mm2, certainty)
        return float(np.average(of_poses.mm2, weights=self.trust * of_poses.certainty))

    @staticmethod
    def of_poses(square_mm2: Array, certainty: Array) -> SquaresOfPoses:
        """Return squares of position errors by those of components, and by how much they count.

        Args:
            square_mm2: (N, b) of components.
            certainty: (N, b) by how much each counts.
        """
        count, whole = np.count_nonzero(certainty, axis=1), certainty.sum(axis=1)
        mm2 = count * np.sum(certainty * square_mm2, axis=1) / np.maximum(whole, _TINY)
        return SquaresOfPoses(mm2, whole / np.maximum(count, 1))

    def beyond_noise_mm2(self, by_apparatus: Array, certainty: Array) -> float:
        """Return the mean squared error of the model at the poses fitted, less that of noise.

        Base and targets, which are no part of the model, are fitted; so is an apparatus, by which
        readings (P, b, a) depend on its stated coordinates.

        Args:
            certainty: (P, b) by how much each component counts.
        """
        not_own = self.columns[:, :, len(self.parameter_index) :]
        columns = np.concatenate([not_own, self.weight[:, :, None] * by_apparatus], axis=2)
        flat = columns.reshape(-1, columns.shape[2])
        flat = flat / np.maximum(np.linalg.norm(flat, axis=0), _TINY)
        fitted = flat @ np.linalg.lstsq(flat, self.residual.ravel(), rcond=None)[0]
        error_mm = self.to_mm * (self.residual - fitted.reshape(self.residual.shape))
        off_mm2 = self.components_factor * (error_mm**2 - self.noise_mm2)
        return self._mean_mm2(off_mm2, certainty)

    def beyond_parameters_mm2(self, out: Index) -> Array:
        """Return squared errors of held-out poses, less those by noise and parameters.

        They are those of components of the position error, (N, b).
        """
        columns, data = self.columns[out], self.data[out]
        mean, variances = self.solved(self.every - Gaussian.of(columns, data), columns)
        error = data - columns @ mean
        beyond = self.to_mm[out] ** 2 * (error**2 - self.of_parameters * variances)
        return np.asarray(self.components_factor * (beyond - self.noise_mm2[out]))
