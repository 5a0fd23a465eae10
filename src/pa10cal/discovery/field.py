"""The field of a fitted model: what it lacks without a name, predicted where held-out poses gain.

What the model leaves is fitted by a smooth displacement by the joints' positions (`terms.field`),
the model itself staying as it is: a correction in the manner of Kennedy and O'Hagan (J. R. Stat.
Soc. B 63, 2001). Its size is the one that makes what is left most likely. Its length is the most
likely of those with which poses that were held out are predicted better, and whole regions that
were held out no worse; where there is none, there is no field.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from pa10cal.arm.chain import BASE
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.discovery.rules import FIELD
from pa10cal.fit.discrepancy import RowsAboutFit, clusters_of, levers_m, places_of
from pa10cal.fit.fitted import Fitted
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.terms.field import Field, embedded, well_spread
from pa10cal.terms.model import Model

F = TypeVar("F", bound=Fitted)


@dataclass(frozen=True, eq=False)
class HeldOutSquares:
    """Mean squares of position errors over poses that were held out, without a field and with."""

    without_mm2: float
    with_mm2: float
    sure: float  # their difference over its standard error, by groups

    @property
    def gain(self) -> float:
        """Return the part of the squares that the field takes away; below 0 where it adds."""
        return 1.0 - self.with_mm2 / self.without_mm2 if self.without_mm2 else 0.0


@dataclass(frozen=True, eq=False)
class FieldFit:
    """A field beside a fitted model, and what poses that were held out say of it."""

    field: Field
    x: Array  # (f,) its amounts [m]
    covariance: Array  # (f, f) of them
    places: HeldOutSquares  # poses among others, of a path whole stretches, held out
    regions: HeldOutSquares  # clusters of neighbours, held out
    by_joint: Array  # (n,) part of its variance that goes with each joint


def field_of(model: Fitted, poses: Observations) -> FieldFit | None:
    """Return the field of a model, by the poses that it was fitted to, averaged and as modelled.

    None where poses held out gain nothing by one, are too few, or cannot tell beside fine maps.
    """
    if any(each.at_knots and len(each.parameters) > FIELD.most_knots for each in model.model.terms):
        return None
    _, label = np.unique(poses.pose, return_inverse=True)
    step = -(-len(poses) // FIELD.most_poses)
    if step > 1:
        poses = poses.take(np.flatnonzero(label % step == 0))
        _, label = np.unique(poses.pose, return_inverse=True)
    first = np.unique(label, return_index=True)[1]
    if len(first) < FIELD.group_poses * FIELD.groups:
        return None
    rows, states = RowsAboutFit.of(model, poses), poses.states
    lever_m, turns = levers_m(model.model, model.x, states), ~model.arm.prismatic
    points = embedded(states.q_rad, lever_m, turns)
    rng = np.random.default_rng(0)
    places = places_of(states.q_rad[first], states.time_s[first], FIELD.groups, rng)[label]
    regions = clusters_of(points[first], FIELD.groups, rng)[label]
    through = states.q_rad[well_spread(points, FIELD.most_places)]
    spread_m = float(np.sqrt(points.var(axis=0).sum()))
    best: tuple[float, FieldFit] | None = None
    for length in FIELD.lengths:
        field = Field(
            q=tuple(tuple(row) for row in through.tolist()),
            lever_m=tuple(lever_m.tolist()),
            turns=tuple(turns.tolist()),
            length_m=length * spread_m,
            size_m=1.0,
        )
        columns = _columns(field, rows, states)
        size_m, scatter, gained = _most_likely(Gaussian.of(columns, rows.data), rows)
        if gained <= (0.0 if best is None else best[0]):
            continue
        about = _Weighed(rows.columns, columns * size_m / scatter, rows.data, scatter, rows.to_mm)
        of_places, of_regions = about.held_out(places), about.held_out(regions)
        helps = of_places.sure > FIELD.standard_errors and of_places.gain > FIELD.least_gain
        if not helps or of_regions.gain < -FIELD.most_loss:
            continue
        # What is left is predicted less seen.
        found, field = about.every, replace(field, size_m=size_m)
        x = -size_m * found.mean
        fit = FieldFit(
            field,
            x,
            size_m**2 * found.covariance,
            of_places,
            of_regions,
            field.by_joint(states.q_rad, x),
        )
        best = gained, fit
    return None if best is None else best[1]


def with_field(model: F, fit: FieldFit) -> F:
    """Return the model with its field as last term; what it then lacks is not known."""
    k = len(model.x)
    covariance = None
    if model.covariance is not None:
        order = [*range(k), *range(k + len(BASE), k + len(BASE) + len(fit.x)), *range(k, k + 6)]
        size = len(order)
        covariance = np.zeros((size, size))
        covariance[: k + 6, : k + 6] = model.covariance
        covariance[k + 6 :, k + 6 :] = fit.covariance
        covariance = covariance[np.ix_(order, order)]
    return replace(
        model,
        model=Model(model.model.chain, (*model.model.terms, fit.field)),
        x=np.concatenate([model.x, fit.x]),
        covariance=covariance,
        discrepancy=None,
    )


def _columns(field: Field, rows: RowsAboutFit, states: PoseStates) -> Array:
    """Return how weighed rows follow the amounts of a field, (P, b, f)."""
    at = len(rows.own) + np.arange(len(field.coordinates))
    by_base = rows.by_unknowns[:, :, at]
    return np.asarray(by_base @ field.derivative(states, np.zeros(0)))


def _most_likely(every: Gaussian, rows: RowsAboutFit) -> tuple[float, float, float]:
    """Return the most likely size of amounts [m], the scatter of a row, and what evidence gains.

    The scatter is profiled: x ~ N(0, r² s² I), s² the variance of a row.
    """
    count = np.count_nonzero(rows.data)
    values, vectors = np.linalg.eigh(every.gram)
    values, along = np.maximum(values, 0.0), vectors.T @ every.projection
    sizes_m = np.geomspace(*FIELD.sizes_m)
    ratio = sizes_m[:, None] ** 2
    taken = ratio * along**2 / (1.0 + ratio * values)
    variance = (
        np.maximum(every.squares - taken.sum(axis=1), FIELD.least_scatter * every.squares) / count
    )
    complexity = np.log1p(ratio * values).sum(axis=1)
    gained = 0.5 * (count * np.log(every.squares / count / variance) - complexity)
    best = int(np.argmax(gained))
    scatter = float(np.sqrt(variance[best]))
    return float(sizes_m[best]) * scatter, scatter, float(gained[best])


@dataclass(frozen=True, eq=False)
class _Weighed:
    """Rows about a fit, their unknowns and a field."""

    own: Array  # (P, b, k) how they follow the unknowns of the model, each in its possible size
    columns: Array  # (P, b, f) how they follow the amounts of the field, in size and scatter
    data: Array  # (P, b)
    scatter: float  # standard deviation of a row beside both
    to_mm: Array  # (P, b) from a row to its part of the position error [mm]

    @cached_property
    def every(self) -> Gaussian:
        """Return what all rows say of the amounts, the model staying as it is."""
        return Gaussian.of(self.columns, self.data / self.scatter)

    def held_out(self, group: Index) -> HeldOutSquares:
        """Return errors of poses whose group (P,) is held out, of all groups in turn.

        The model is fitted to the others first, then the field to what it leaves of them.
        """
        squares = np.array(list(self._by_group(group)))
        taken = squares[:, 0] - squares[:, 1]
        error = float(taken.std(ddof=1)) * np.sqrt(len(taken))
        without_mm2, with_mm2 = squares.sum(axis=0) / len(self.data)
        sure = float(taken.sum()) / error if error else 0.0
        return HeldOutSquares(float(without_mm2), float(with_mm2), sure)

    def _by_group(self, group: Index) -> Iterator[tuple[float, float]]:
        both = np.concatenate([self.own / self.scatter, self.columns], axis=2)
        data, k = self.data / self.scatter, self.own.shape[2]
        every, own, field = Gaussian.of(both, data), np.arange(k), np.arange(k, both.shape[2])
        for number in np.unique(group).tolist():
            out = np.flatnonzero(group == number)
            *_, mean = (every - Gaussian.of(both[out], data[out])).in_turn(own, field)
            left = data[out] - both[out][..., :k] @ mean[:k]
            ends = left - self.columns[out] @ mean[k:]
            to_mm = self.scatter * self.to_mm[out]
            yield float(np.sum((to_mm * left) ** 2)), float(np.sum((to_mm * ends) ** 2))
