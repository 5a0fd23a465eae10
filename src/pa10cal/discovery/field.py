"""Prediction of a fitted model's discrepancy without a name, if held-out poses gain by it.

The residual is fitted by effects of which none is named (`discovery.nameless`), by a smooth
displacement, a Gaussian process of the joint positions (`terms.field`), or by both; the model is
not changed (Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001). The displacement's size maximises
the marginal likelihood. Its length is the likeliest of those with which held-out poses are
predicted better and whole held-out regions no worse; a rough process is used in its place if that
predicts them better still. Effects, displacement or both are used, whichever predicts held-out
poses best, or none of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.discovery.nameless import AddedTerms, effects_together, with_terms
from pa10cal.discovery.tuning import FIELD
from pa10cal.fit.discrepancy import clusters_of, levers_m, places_of
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.forward import Forward
from pa10cal.fit.rows_about_fit import RowsAboutFit
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.field import Field, Kernel, embedded, well_spread
from pa10cal.terms.term import Term

F = TypeVar("F", bound=Fitted)


@dataclass(frozen=True, eq=False)
class HeldOutSquares:
    """Mean squares of position errors of held-out poses, without and with added terms."""

    without_mm2: float
    with_mm2: float
    sure: float  # their difference over its standard error between groups

    @property
    def gain(self) -> float:
        """Return the part of the squares that the terms remove; negative where they add."""
        return 1.0 - self.with_mm2 / self.without_mm2 if self.without_mm2 else 0.0


@dataclass(frozen=True, eq=False)
class FieldFit:
    """Terms without a name that are added to a fitted model, as held-out poses gain by them."""

    terms: tuple[Term, ...]  # a sum of effects, a smooth displacement, or both in this order
    x: Array  # (f,) their amounts
    covariance: Array  # (f, f) of them
    by_joint: Array  # (n,) part of their variance that follows each joint


def field_of(model: Fitted, poses: Observations, effects: Sequence[Effect] = ()) -> FieldFit | None:
    """Return the terms to add to a model, by the poses that it was fitted to.

    None where held-out poses gain nothing by them, are too few, or cannot judge beside fine maps.

    Args:
        poses: averaged and complete.
        effects: effects that may be among the terms, proportional to their parameters.
    """
    if any(term.at_knots and len(term.parameters) > FIELD.most_knots for term in model.model.terms):
        return None
    held_out = _HeldOutGroups.of(model, poses)
    if held_out is None:
        return None
    poses = held_out.poses
    best = held_out.best(AddedTerms.none(model, poses))
    if effects and (of_effects := effects_together(model, poses, effects)) is not None:
        with_effects = held_out.best(of_effects)
        if with_effects is not None and with_effects.better_than(best):
            best = with_effects
    return None if best is None else best.fit(model, poses.states)


@dataclass(frozen=True)
class _LikelyField:
    """A displacement of its most likely size."""

    field: Field
    scatter: float  # standard deviation of a row beside it
    gained: float  # log evidence gained by it [nat]


@dataclass(frozen=True, eq=False)
class _JudgedTerms:
    """Terms added to a model, judged by held-out poses."""

    added: AddedTerms
    held_out: _HeldOutGroups

    @cached_property
    def places(self) -> HeldOutSquares:
        """Return the errors of held-out poses among others."""
        return self.held_out.squares(self.added, self.held_out.places)

    @cached_property
    def regions(self) -> HeldOutSquares:
        """Return the errors of whole held-out regions."""
        return self.held_out.squares(self.added, self.held_out.regions)

    @property
    def squares_mm2(self) -> float:
        """Return the mean squares of held-out poses, among others and in whole regions, added."""
        return self.places.with_mm2 + self.regions.with_mm2

    @property
    def helps(self) -> bool:
        """Return whether held-out poses gain significantly, and whole regions do not lose."""
        gains = self.places.sure > FIELD.standard_errors and self.places.gain > FIELD.least_gain
        return gains and self.regions.gain >= -FIELD.most_loss

    def better_than(self, other: _JudgedTerms | None) -> bool:
        """Return whether held-out poses are predicted clearly better than by other terms."""
        least = np.inf if other is None else other.squares_mm2
        return self.squares_mm2 < (1.0 - FIELD.least_gain) * least

    def fit(self, model: Fitted, states: PoseStates) -> FieldFit:
        """Return the terms as they are added to the model."""
        added, rows = self.added, self.added.rows
        sizes = rows.sizes[rows.of_field]
        return FieldFit(
            added.terms,
            added.model.x[added.model.model.having("field")],
            added.amounts.covariance * np.outer(sizes, sizes),
            by_joint(model, added.model, states),
        )


@dataclass(frozen=True, eq=False)
class _HeldOutGroups:
    """Poses in groups that are held out in turn."""

    model: Fitted  # that lacks something
    poses: Observations
    places: Index  # (P,) group of each pose: random ones, or stretches of a path
    regions: Index  # (P,) cluster of neighbours of each pose
    through: Array  # (m, n) joint positions of the inducing points of a displacement
    lever_m: Array  # (n,) distance that a unit motion of each joint moves the end
    spread_m: float  # of the poses, root mean square

    @classmethod
    def of(cls, model: Fitted, poses: Observations) -> _HeldOutGroups | None:
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

    def best(self, added: AddedTerms) -> _JudgedTerms | None:
        """Return the terms already added with the displacement that helps most.

        It is the most likely smooth displacement that helps, or a rough one with which the squares
        of held-out poses are smaller. Without one where none helps; None where the terms do not.
        """
        without = _JudgedTerms(added, self) if added.terms else None
        smooth = [self._field(added, length, "squared exponential") for length in FIELD.lengths]
        likely = sorted(smooth, key=lambda field: -field.gained)
        rough = self._field(added, FIELD.rough_length, "exponential")
        best = self._first_helping(added, likely, without)
        with_rough = self._first_helping(added, [rough], without)
        if with_rough is not None and (best is None or with_rough.squares_mm2 < best.squares_mm2):
            best = with_rough
        if best is None and without is not None and without.helps:
            return without
        return best

    def _first_helping(
        self, added: AddedTerms, fields: Sequence[_LikelyField], without: _JudgedTerms | None
    ) -> _JudgedTerms | None:
        """Return the added terms with the first of some displacements that helps."""
        for field in fields:
            if field.gained <= 0.0:
                continue
            terms, rows = (*added.terms, field.field), added.rows
            fitted = AddedTerms.fitted(self.model, terms, self.poses, field.scatter, rows.weight)
            tried = _JudgedTerms(fitted, self)
            if tried.helps and tried.better_than(without):
                return tried
        return None

    def _field(self, added: AddedTerms, length: float, kernel: Kernel) -> _LikelyField:
        """Return a displacement of a length, in the spread of poses, in its most likely size."""
        field = Field(
            q=tuple(tuple(row) for row in self.through.tolist()),
            lever_m=tuple(self.lever_m.tolist()),
            turns=tuple((~self.model.arm.prismatic).tolist()),
            length_m=length * self.spread_m,
            size_m=1.0,
            kernel=kernel,
        )
        columns = _columns(field, added.rows, self.poses.states)
        count = int(np.count_nonzero(added.rows.data))
        return _of_likeliest_size(field, Gaussian.of(columns, added.rows.residual), count)

    def squares(self, added: AddedTerms, group: Index) -> HeldOutSquares:
        """Return the errors of poses, each group (P,) predicted from all others.

        The model is fitted to the others first, then the added terms to its residuals there.
        """
        squares = np.array(list(_squares_by_group(added, group)))
        removed = squares[:, 0] - squares[:, 1]
        error = float(removed.std(ddof=1)) * np.sqrt(len(removed))
        without_mm2, with_mm2 = squares.sum(axis=0) / len(group)
        sure = float(removed.sum()) / error if error else 0.0
        return HeldOutSquares(float(without_mm2), float(with_mm2), sure)


def _squares_by_group(added: AddedTerms, group: Index) -> Iterator[tuple[float, float]]:
    """Yield the squares of position errors [mm²] of each group, without and with added terms."""
    rows, scatter = added.rows, added.scatter
    columns, data = rows.columns / scatter, rows.data / scatter
    of_model, field = np.flatnonzero(~rows.of_field), np.flatnonzero(rows.of_field)
    every = Gaussian.of(columns, data)
    for number in np.unique(group).tolist():
        out = np.flatnonzero(group == number)
        *_, mean = (every - Gaussian.of(columns[out], data[out])).in_turn(of_model, field)
        without = data[out] - columns[out][..., of_model] @ mean[of_model]
        with_terms = without - columns[out][..., field] @ mean[field]
        to_mm = scatter * rows.to_mm[out]
        yield float(np.sum((to_mm * without) ** 2)), float(np.sum((to_mm * with_terms) ** 2))


def with_field(model: F, fit: FieldFit) -> F:
    """Return the model with the terms of a fit added last; its discrepancy is then not known."""
    k, extended = len(model.x), with_terms(model, fit.terms)
    covariance = None
    if model.covariance is not None:
        # Parameters of the model, then those of the fit, then base and targets.
        at, of_fit = np.full(len(fit.x), k), k + np.arange(len(fit.x))
        covariance = np.insert(np.insert(model.covariance, at, 0.0, axis=0), at, 0.0, axis=1)
        covariance[np.ix_(of_fit, of_fit)] = fit.covariance
    return replace(extended, x=np.concatenate([model.x, fit.x]), covariance=covariance)


def by_joint(model: Fitted, extended: Fitted, states: PoseStates) -> Array:
    """Return the part (n,) of the variance of added terms over the poses that follows each joint.

    These are total-effect indices, by the change where the joint's position is that of another pose
    (M. J. W. Jansen, Computer Physics Communications 117, 1999), scaled to a sum of one.
    """
    q, others = states.q_rad, np.random.default_rng(0).permutation(len(states))
    here, changed = _displacement_m(model, extended, states), np.zeros(states.n)
    for joint in range(states.n):
        elsewhere = q.copy()
        elsewhere[:, joint] = q[others, joint]
        away = _displacement_m(model, extended, replace(states, q_rad=elsewhere))
        changed[joint] = np.sum((away - here) ** 2)
    total = float(changed.sum())
    return changed / total if total else changed


def _displacement_m(model: Fitted, extended: Fitted, states: PoseStates) -> Array:
    """Return how far added terms move the first target, or the tool, (P, 3)."""
    frame, places = [*model.frames][-1], []
    for either in (model, extended):
        forward = Forward.of(either, frame)
        at = states if either.payload is None else forward.states(states)
        places.append(forward.T_base_frame(at)[:, :3, 3])
    return np.asarray(places[1] - places[0])


def _columns(field: Field, rows: RowsAboutFit, states: PoseStates) -> Array:
    """Return whitened columns (P, b, f) of the amounts of a field."""
    at = len(rows.parameter_index) + np.arange(len(field.coordinates))
    by_base = rows.by_unknowns[:, :, at]
    return np.asarray(by_base @ field.derivative(states, np.zeros(0)))


def _of_likeliest_size(field: Field, equations: Gaussian, count: int) -> _LikelyField:
    """Return a displacement in its most likely size r s, by `count` rows of the variance s².

    The scatter s is profiled: amounts are x ~ N(0, r² s² I).
    """
    values, vectors = np.linalg.eigh(equations.gram)
    values, along = np.maximum(values, 0.0), vectors.T @ equations.projection
    sizes_m = np.geomspace(*FIELD.sizes_m)  # r
    ratio = sizes_m[:, None] ** 2
    squares = equations.squares
    removed = np.sum(ratio * along**2 / (1.0 + ratio * values), axis=1)
    variance = np.maximum(squares - removed, FIELD.least_scatter * squares) / count
    complexity = np.log1p(ratio * values).sum(axis=1)
    gained = 0.5 * (count * np.log(squares / count / variance) - complexity)
    best = int(np.argmax(gained))
    scatter = float(np.sqrt(variance[best]))
    size_m = float(sizes_m[best]) * scatter
    return _LikelyField(replace(field, size_m=size_m), scatter, float(gained[best]))
