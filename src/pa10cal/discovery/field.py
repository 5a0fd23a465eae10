"""What a fitted model lacks without a name, predicted where held-out poses gain.

What the model leaves is fitted by effects of which none is named (`discovery.nameless`), by a
smooth displacement by the joints' positions (`terms.field`), or by both, the model itself staying
as it is: a correction in the manner of Kennedy and O'Hagan (J. R. Stat. Soc. B 63, 2001). The
displacement's size is the one that makes what is left most likely. Its length is the most likely
of those with which poses that were held out are predicted better, and whole regions that were held
out no worse; a rough one, which has no scale of its own, takes its place where these are predicted
better yet. Of effects, displacement and both those are taken with which held-out poses are
predicted best; where nothing helps, there is nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from pa10cal.arm.chain import BASE
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.discovery.nameless import Beside, all_at_once, beside, with_terms
from pa10cal.discovery.other_numbers import FIELD
from pa10cal.fit.discrepancy import RowsAboutFit, clusters_of, levers_m, places_of
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.forward import Forward
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.field import Field, Kernel, embedded, well_spread
from pa10cal.terms.term import Term

F = TypeVar("F", bound=Fitted)


@dataclass(frozen=True, eq=False)
class HeldOutSquares:
    """Mean squares of position errors over poses that were held out, without and with it."""

    without_mm2: float
    with_mm2: float
    sure: float  # their difference over its standard error, by groups

    @property
    def gain(self) -> float:
        """Return the part of the squares that it takes away; below 0 where it adds."""
        return 1.0 - self.with_mm2 / self.without_mm2 if self.without_mm2 else 0.0


@dataclass(frozen=True, eq=False)
class FieldFit:
    """What has no name beside a fitted model, where poses that were held out gain by it."""

    terms: tuple[Term, ...]  # a sum of effects, a smooth displacement, or both in this order
    x: Array  # (f,) their amounts
    covariance: Array  # (f, f) of them
    by_joint: Array  # (n,) part of its variance that goes with each joint


def field_of(model: Fitted, poses: Observations, effects: Sequence[Effect] = ()) -> FieldFit | None:
    """Return what a model lacks without a name, by the poses that it was fitted to.

    None where poses held out gain nothing by it, are too few, or cannot tell beside fine maps.

    Args:
        poses: averaged, and as modelled.
        effects: those that may be a part of it, proportional to their parameters.
    """
    if any(each.at_knots and len(each.parameters) > FIELD.most_knots for each in model.model.terms):
        return None
    held_out = _HeldOut.of(model, poses)
    if held_out is None:
        return None
    poses = held_out.poses
    found = held_out.best(Beside.none(model, poses))
    if effects and (together := all_at_once(model, poses, effects)) is not None:
        both = held_out.best(together)
        if both is not None and both.better_than(found):
            found = both
    return None if found is None else found.fit(model, poses.states)


@dataclass(frozen=True)
class _Likely:
    """A displacement in its most likely size."""

    field: Field
    scatter: float  # of a row beside it
    gained: float  # by how much more likely the rows are with it [nats]


@dataclass(frozen=True, eq=False)
class _Judged:
    """What stands beside a model, judged by poses that are held out."""

    there: Beside
    held_out: _HeldOut

    @cached_property
    def places(self) -> HeldOutSquares:
        """Return the errors of poses among others."""
        return self.held_out.squares(self.there, self.held_out.places)

    @cached_property
    def regions(self) -> HeldOutSquares:
        """Return the errors of whole regions."""
        return self.held_out.squares(self.there, self.held_out.regions)

    @property
    def left_mm2(self) -> float:
        """Return what it leaves of poses held out, among others and in whole regions."""
        return self.places.with_mm2 + self.regions.with_mm2

    @property
    def helps(self) -> bool:
        """Return whether poses held out gain by it, and whole regions lose nothing."""
        gains = self.places.sure > FIELD.standard_errors and self.places.gain > FIELD.least_gain
        return gains and self.regions.gain >= -FIELD.most_loss

    def better_than(self, other: _Judged | None) -> bool:
        """Return whether it predicts poses held out clearly better than something else."""
        least = np.inf if other is None else other.left_mm2
        return self.left_mm2 < (1.0 - FIELD.least_gain) * least

    def fit(self, model: Fitted, states: PoseStates) -> FieldFit:
        """Return it as it is to be used beside the model."""
        there, rows = self.there, self.there.rows
        sizes = rows.sizes[rows.of_field]
        return FieldFit(
            there.terms,
            there.model.x[there.model.model.having("field")],
            there.amounts.covariance * np.outer(sizes, sizes),
            by_joint(model, there.model, states),
        )


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """Poses in groups that are held out in turn, and how they lie."""

    model: Fitted  # that lacks something
    poses: Observations
    places: Index  # (P,) group of each pose, drawn at random, of a path stretches
    regions: Index  # (P,) cluster of neighbours
    through: Array  # (m, n) positions that a smooth displacement goes through
    lever_m: Array  # (n,)
    spread_m: float  # of the poses

    @classmethod
    def of(cls, model: Fitted, poses: Observations) -> _HeldOut | None:
        """Return the groups of poses; None where these are too few."""
        poses = poses.thinned_by_pose(FIELD.most_poses)
        _, label = np.unique(poses.pose, return_inverse=True)
        first = np.unique(label, return_index=True)[1]
        if len(first) < FIELD.group_poses * FIELD.groups:
            return None
        states = poses.states
        lever_m = levers_m(model.model, model.x, states)
        points = embedded(states.q_rad, lever_m, ~model.arm.prismatic)
        rng = np.random.default_rng(0)
        return cls(
            model,
            poses,
            places_of(states.q_rad[first], states.time_s[first], FIELD.groups, rng)[label],
            clusters_of(points[first], FIELD.groups, rng)[label],
            states.q_rad[well_spread(points, FIELD.most_places)],
            lever_m,
            float(np.sqrt(points.var(axis=0).sum())),
        )

    def best(self, there: Beside) -> _Judged | None:
        """Return what stands beside the model with the displacement that helps most.

        Of smooth ones the most likely that helps, or a rough one where that leaves less of poses
        held out. Without one where none helps any more; None where nothing helps.
        """
        without = _Judged(there, self) if there.terms else None
        smooth = [self._field(there, length, "squared exponential") for length in FIELD.lengths]
        likely = sorted(smooth, key=lambda field: -field.gained)
        rough = self._field(there, FIELD.rough_length, "exponential")
        found = self._first_helping(there, likely, without)
        tried = self._first_helping(there, [rough], without)
        if tried is not None and (found is None or tried.left_mm2 < found.left_mm2):
            found = tried
        if found is None and without is not None and without.helps:
            return without
        return found

    def _first_helping(
        self, there: Beside, fields: Sequence[_Likely], without: _Judged | None
    ) -> _Judged | None:
        """Return what stands beside the model with the first of displacements that helps."""
        for field in fields:
            if field.gained <= 0.0:
                continue
            terms, weight = (*there.terms, field.field), there.rows.weight
            tried = _Judged(beside(self.model, terms, self.poses, field.scatter, weight), self)
            if tried.helps and tried.better_than(without):
                return tried
        return None

    def _field(self, there: Beside, length: float, kernel: Kernel) -> _Likely:
        """Return a displacement of some length in its most likely size."""
        field = Field(
            q=tuple(tuple(row) for row in self.through.tolist()),
            lever_m=tuple(self.lever_m.tolist()),
            turns=tuple((~self.model.arm.prismatic).tolist()),
            length_m=length * self.spread_m,
            size_m=1.0,
            kernel=kernel,
        )
        rows = there.rows
        columns = _columns(field, rows, self.poses.states)
        size_m, scatter, gained = _most_likely(Gaussian.of(columns, rows.left), rows)
        return _Likely(replace(field, size_m=size_m), scatter, gained)

    def squares(self, there: Beside, group: Index) -> HeldOutSquares:
        """Return errors of poses whose group (P,) is held out, of all groups in turn.

        The model is fitted to the others first, then to what it leaves of them what is beside it.
        """
        squares = np.array(list(_by_group(there, group)))
        taken = squares[:, 0] - squares[:, 1]
        error = float(taken.std(ddof=1)) * np.sqrt(len(taken))
        without_mm2, with_mm2 = squares.sum(axis=0) / len(group)
        sure = float(taken.sum()) / error if error else 0.0
        return HeldOutSquares(float(without_mm2), float(with_mm2), sure)


def _by_group(there: Beside, group: Index) -> Iterator[tuple[float, float]]:
    rows, scatter = there.rows, there.scatter
    columns, data = rows.columns / scatter, rows.data / scatter
    own, field = np.flatnonzero(~rows.of_field), np.flatnonzero(rows.of_field)
    every = Gaussian.of(columns, data)
    for number in np.unique(group).tolist():
        out = np.flatnonzero(group == number)
        *_, mean = (every - Gaussian.of(columns[out], data[out])).in_turn(own, field)
        left = data[out] - columns[out][..., own] @ mean[own]
        ends = left - columns[out][..., field] @ mean[field]
        to_mm = scatter * rows.to_mm[out]
        yield float(np.sum((to_mm * left) ** 2)), float(np.sum((to_mm * ends) ** 2))


def with_field(model: F, fit: FieldFit) -> F:
    """Return the model with what has no name as last terms; what it then lacks is not known."""
    k, at = len(model.x), with_terms(model, fit.terms)
    covariance = None
    if model.covariance is not None:
        order = [*range(k), *range(k + len(BASE), k + len(BASE) + len(fit.x)), *range(k, k + 6)]
        size = len(order)
        covariance = np.zeros((size, size))
        covariance[: k + 6, : k + 6] = model.covariance
        covariance[k + 6 :, k + 6 :] = fit.covariance
        covariance = covariance[np.ix_(order, order)]
    return replace(at, x=np.concatenate([model.x, fit.x]), covariance=covariance)


def by_joint(model: Fitted, beside: Fitted, states: PoseStates) -> Array:
    """Return the part that goes with each joint of what stands beside a model, (n,).

    Of its variance over the poses, by how much it changes where the joint's position is that of
    another pose (total effects, M. J. W. Jansen, Computer Physics Communications 117, 1999), the
    sum being one.
    """
    q, others = states.q_rad, np.random.default_rng(0).permutation(len(states))
    here, changed = _displacement_m(model, beside, states), np.zeros(states.n)
    for joint in range(states.n):
        elsewhere = q.copy()
        elsewhere[:, joint] = q[others, joint]
        away = _displacement_m(model, beside, replace(states, q_rad=elsewhere))
        changed[joint] = np.sum((away - here) ** 2)
    total = float(changed.sum())
    return changed / total if total else changed


def _displacement_m(model: Fitted, beside: Fitted, states: PoseStates) -> Array:
    """Return by how much the first target or the tool is elsewhere with what stands beside."""
    frame, places = [*model.frames][-1], []
    for each in (model, beside):
        forward = Forward.of(each, frame)
        at = states if each.payload is None else forward.states(states)
        places.append(forward.T_base_frame(at)[:, :3, 3])
    return np.asarray(places[1] - places[0])


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
