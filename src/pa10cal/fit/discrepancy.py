"""Model discrepancy: how far a fitted model predicts off beyond what its parameters explain.

The covariance of a fit holds the noise of the readings. What the model lacks is in none of its
parameters, and shows where poses are predicted that were not fitted (Kennedy and O'Hagan, J. R.
Stat. Soc. B 63, 2001). Here groups of poses are held out in turn, linear about the fit: single
poses, drawn at random, and whole clusters of neighbours. What their errors have beyond noise and
parameters grows with the distance to the nearest pose that stayed, and is known by that distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from warnings import catch_warnings, simplefilter

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.optimize import isotonic_regression
from scipy.spatial import cKDTree

from pa10cal.arm.chain import BASE, end_pose_with_screws
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.fit.angles_seen import Discrepancy
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.problem import Problem, possible_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.order import along_a_path
from pa10cal.rules import LACK
from pa10cal.terms.field import embedded, well_spread
from pa10cal.terms.model import Model
from pa10cal.terms.term import base_frame, fixed

#: A weight and a variance [m², rad²] that are none (computing).
_TINY, _NO_VARIANCE = 1e-300, 1e-24


def discrepancy_of(model: Fitted, poses: Observations) -> Discrepancy | None:
    """Return what a model lacks, by the poses that it was fitted to, averaged and as modelled.

    Maps of joints stay as they were fitted: what is uncertain of them is in their covariance.
    None where there are too few poses to hold some out.
    """
    poses = poses.thinned_by_pose(LACK.most_poses)
    _, label = np.unique(poses.pose, return_inverse=True)
    count = int(label.max()) + 1
    groups = min(LACK.groups, count // LACK.least_in_group)
    if groups < 2:
        return None
    rows, lever_m = RowsAboutFit.of(model, poses), levers_m(model.model, model.x, poses.states)
    turns = ~model.arm.prismatic
    points = embedded(poses.states.q_rad, lever_m, turns)
    rows = rows.with_noise_of_pairs(points, label, LACK.pair_rad * float(lever_m.max()))
    places = well_spread(points, LACK.most_places)
    rng = np.random.default_rng(0)
    distance_m, square_mm2 = [], []
    for number, fold in enumerate(held_out_in_turn(points, label, poses.states, groups, rng)):
        for k in range(groups):
            out = np.flatnonzero(fold == k)
            stays = places[fold[places] != k]
            if not len(out) or not len(stays):
                continue
            distance_m.append(cKDTree(points[stays]).query(points[out])[0])
            square_mm2.append(rows.beyond_parameters_mm2(out))
        if number == 0:
            near_m = float(np.quantile(np.concatenate(distance_m), LACK.near_share))
    steps_m, mean_mm2 = _by_distance(np.concatenate(distance_m), np.concatenate(square_mm2))
    return Discrepancy(
        q=poses.states.q_rad[places],
        lever_m=lever_m,
        turns=turns,
        distance_m=steps_m,
        error_mm=np.sqrt(mean_mm2),
        near_m=near_m,
    )


def levers_m(model: Model, x: Array, states: PoseStates) -> Array:
    """Return how far a unit of each joint moves the end, (n,): root mean square over the poses.

    A joint near the end moves it by little, and turns it all the same.
    """
    chain, columns = model.chain, model.chain.joint_columns.tolist()
    at = model.chain_coordinates(states, x)
    moved_m = end_pose_with_screws(chain, at, columns).screws[:, :3, columns]
    lever_m = np.sqrt(np.mean(np.sum(moved_m**2, axis=1), axis=0))
    return np.asarray(np.maximum(lever_m, LACK.least_lever_share * lever_m.max()))


def held_out_in_turn(
    points: Array, label: Index, states: PoseStates, groups: int, rng: np.random.Generator
) -> Iterator[Index]:
    """Yield the group of each row (P,): places among others, clusters of neighbours, stretches.

    Rows of one label stay together.
    """
    first = np.unique(label, return_index=True)[1]
    yield places_of(states.q_rad[first], states.time_s[first], groups, rng)[label]
    yield clusters_of(points[first], groups, rng)[label]
    yield stretches_of(states.time_s[first], groups)[label]


def places_of(q: Array, time_s: Array, groups: int, rng: np.random.Generator) -> Index:
    """Return the group of each pose (P,) among the others: drawn at random, of a path stretches.

    Along a path the next row tells nearly all of a row.
    """
    if along_a_path(q[np.argsort(time_s, kind="stable")]):
        return stretches_of(time_s, LACK.stretches * groups) % groups
    return np.asarray(rng.permutation(len(q)) % groups)


def clusters_of(points: Array, groups: int, rng: np.random.Generator) -> Index:
    """Return the cluster of neighbours that each point (P, d) is in, (P,): k-means."""
    with catch_warnings():
        simplefilter("ignore", UserWarning)  # of a cluster that came out empty
        return np.asarray(kmeans2(points, groups, minit="++", rng=rng)[1], dtype=np.intp)


def stretches_of(time_s: Array, groups: int) -> Index:
    """Return the stretch of time of even size that each pose (P,) is in, (P,)."""
    rank = np.empty(len(time_s), dtype=np.intp)
    rank[np.argsort(time_s, kind="stable")] = np.arange(len(time_s))
    return rank * groups // len(time_s)


def _by_distance(distance_m: Array, square_mm2: Array) -> tuple[Array, Array]:
    """Return mean distances of steps (m,), rising, and mean squares there that never fall."""
    order = np.argsort(distance_m, kind="stable")
    steps = max(min(LACK.steps, len(order) // LACK.least_errors), 1)
    parts = np.array_split(order, steps)
    means_m = np.array([distance_m[part].mean() for part in parts])
    means_mm2 = np.array([square_mm2[part].mean() for part in parts])
    sizes = np.array([len(part) for part in parts])
    return means_m, np.maximum(isotonic_regression(means_mm2, weights=sizes).x, 0.0)


def _weights(measured: Instrument, residual: Array, variance: Array) -> Array:
    """Return weights of components (P, b) by their variance as stated, or as residuals scatter."""
    seen, weight = measured.components_seen, np.zeros_like(residual)
    for _, kind in measured.component_kinds:
        own = residual[:, kind][seen[:, kind]]
        usual = np.median(own**2) / LACK.median_square if len(own) else 1.0
        total = np.maximum(variance[:, kind], max(usual, _NO_VARIANCE))
        weight[:, kind] = np.where(seen[:, kind], 1.0 / np.sqrt(total), 0.0)
    size = np.sqrt(((weight * residual) ** 2).sum(axis=1) / np.maximum(seen.sum(axis=1), 1))
    weight *= np.minimum(1.0, LACK.far * np.median(size) / np.maximum(size, _TINY))[:, None]
    return weight


@dataclass(frozen=True, eq=False)
class RowsAboutFit:
    """Rows of a model about its fit, from which groups of poses can be taken.

    The unknowns are the model's but for its maps, six small motions of the base, and targets.
    """

    data: Array  # (P, b) what is left without a field, weighed
    left: Array  # (P, b) the same with it
    weight: Array  # (P, b) by which components are weighed, 0 where nothing was seen
    columns: Array  # (P, b, k) how it follows the unknowns, weighed, each in its possible size
    sizes: Array  # (k,) possible size of each unknown
    own: Index  # (k - 6 - t,) which of the model's parameters are unknowns, those of its maps apart
    of_field: Mask  # (k,) which unknowns are those of a field, fitted to what the others leave
    to_mm: Array  # (P, b) from a weighed component to its part of the position error [mm]
    noise_mm2: Array  # (P,) square of the position error that noise makes
    # variance of a prediction by the model's covariance, over what these rows make of it
    of_parameters: float
    # of a squared error: 3 where one line-of-sight component is measured, else 1
    components_factor: float

    @property
    def by_unknowns(self) -> Array:
        """Return how rows follow the unknowns in their own units, (P, b, k)."""
        return self.columns / self.sizes

    @cached_property
    def every(self) -> Gaussian:
        """Return what all rows say."""
        return Gaussian.of(self.columns, self.data)

    def found(self, rows: Gaussian, columns: Array) -> tuple[Array, Array]:
        """Return the unknowns (k,) by some rows, and variances of predictions by columns (…, k)."""
        own, field = np.flatnonzero(~self.of_field), np.flatnonzero(self.of_field)
        if not len(field):
            return rows.mean, rows.variances(columns)
        alone, beside, mean = rows.in_turn(own, field)
        return mean, alone.variances(columns[..., own]) + beside.variances(columns[..., field])

    @classmethod
    def of(cls, model: Fitted, poses: Observations, weight: Array | None = None) -> RowsAboutFit:
        """Return the rows of averaged poses, as modelled; weighed by what is left, or as given."""
        maps = [term for term in model.model.terms if term.at_knots]
        terms = [
            fixed(term, model.values_of(term)) if term in maps else term
            for term in model.model.terms
        ]
        at = Model(model.model.chain, (*terms, base_frame()))
        free = model.model.parameter_indices(*(t for t in model.model.terms if t not in maps))
        x = np.concatenate([model.x[free], np.zeros(6)])
        measured, count = poses.measured, len(model.targets_m)
        problem = Problem(at, np.arange(count), model.targets_m, model.T_instr_base, poses)
        rows = problem.rows(problem.start(x))
        seen = measured.components_seen
        variance = np.diagonal(measured.stated_covariance, axis1=1, axis2=2)
        if weight is None:
            weight = _weights(measured, rows.residual, variance)
        sizes = possible_sizes(at, measured if count else None)
        of_field = np.append(at.having("field"), np.zeros(len(sizes) - len(at.parameters), bool))
        without = rows.residual
        if of_field.any():  # which was expected about zero
            without = without - rows.jacobian[:, :, of_field] @ x[of_field[: len(x)]]
        data, left = weight * without, weight * rows.residual
        columns = weight[:, :, None] * rows.jacobian * sizes
        places = measured.position_columns
        axes = seen[:, places].sum(axis=1)
        times = np.maximum(axes / 3.0, 1.0)
        to_mm = np.zeros_like(weight)
        to_mm[:, places] = (
            np.where(seen[:, places], 1e3 / np.maximum(weight[:, places], _TINY), 0.0)
            / np.sqrt(times)[:, None]
        )
        noise = (np.where(seen[:, places], variance[:, places], 0.0).sum(axis=1) / times) * 1e6
        single = LACK.components if len(places) == 1 else 1.0
        found = cls(data, left, weight, columns, sizes, free, of_field, to_mm, noise, 1.0, single)
        if model.covariance is None:
            return found
        known = np.append(free, len(model.x) + np.arange(len(BASE)))
        moved = to_mm[:, :, None] * weight[:, :, None] * rows.jacobian[:, :, : len(known)]
        own = np.einsum(
            "pbk,kl,pbl->", moved, model.covariance[np.ix_(known, known)], moved, optimize=True
        )
        every_mm2 = float(np.sum(to_mm**2 * found.found(found.every, columns)[1]))
        return replace(found, of_parameters=min(float(own) / max(every_mm2, _TINY), 1.0))

    def with_noise_of_pairs(self, points: Array, label: Index, within_m: float) -> RowsAboutFit:
        """Return the rows with the noise that nearest neighbours show, where it is the smaller.

        Two poses so near each other have the same error of the model: half the square of the
        difference of their residuals is noise (the nugget of a variogram). Noise that was stated
        larger than that was assumed.
        """
        away_m, at = map(np.asarray, cKDTree(points).query(points, k=2))
        other = at[:, 1]
        near = (away_m[:, 1] < within_m) & (label != label[other])
        if np.count_nonzero(near) < LACK.least_pairs:
            return self
        error_mm = self.to_mm * self.data
        half = 0.5 * ((error_mm - error_mm[other]) ** 2).sum(axis=1)[near]
        return replace(self, noise_mm2=np.minimum(self.noise_mm2, float(half.mean())))

    def beyond_parameters_mm2(self, out: Index) -> Array:
        """Return squares of the errors of poses held out, less noise and parameters, (N,)."""
        columns, data = self.columns[out], self.data[out]
        mean, variances = self.found(self.every - Gaussian.of(columns, data), columns)
        error = data - columns @ mean
        beyond = error**2 - self.of_parameters * variances
        beyond = np.sum(self.to_mm[out] ** 2 * beyond, axis=1)
        return np.asarray(self.components_factor * (beyond - self.noise_mm2[out]))
