"""Jacobians of the residual of a fitted model at measured poses.

The residual is predicted minus measured, (P, b) [m, rad]: P poses of b components as the instrument
measures them, zero where a component was not seen (`FittedModel.compared`). Jacobians (P, b, k) are
exact derivatives by k parameters at the parameters of the model, whose terms may move the base away
from its base frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array, Index, drawn
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.joint_noise import along_base
from pa10cal.fit.problem import possible_sizes
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.offsets import Offsets, base_frame
from pa10cal.terms.term import Term, TermParameter


def residual_and_jacobian(at: FittedModel, poses: Observations) -> tuple[Array, Array]:
    """Return the residual (P, b) and its derivative by parameters and targets, (P, b, k + t)."""
    residual, jacobian = residual_and_lazy_jacobian(at, poses)
    return residual, jacobian()


def residual_and_lazy_jacobian(
    at: FittedModel, poses: Observations
) -> tuple[Array, Callable[[], Array]]:
    """Return the residual (P, b) and a function that computes its derivative (P, b, k + t)."""
    predicted = at.model.predict_with_jacobian(poses.states, at.x)
    compared = poses.measured.compare(
        at.T_instr_base @ predicted.T_base_ee, at.targets_read_m(poses.states)
    )

    def jacobian() -> Array:
        by_model = along_base(compared.by_end, at) @ predicted.jacobian
        if not len(at.targets_m):
            return by_model
        for term in at.model.terms:
            columns = at.model.columns_of(term)
            distorted = by_target_distortion(compared.by_targets, poses, term, at.x[columns])
            if distorted is not None:
                by_model[:, :, columns] += distorted
        return np.concatenate([by_model, compared.by_targets], axis=2)

    return compared.residual, jacobian


# By some of the parameters of a model, or by those of terms that it does not have.


def by_terms(
    at: FittedModel,
    poses: Observations,
    terms: Sequence[Term],
    points: Sequence[Array],
    whiteners: Array | None = None,
) -> list[Array]:
    """Return the derivative of the residual by the parameters of each term, (P, b, k').

    Args:
        terms: of the model or not.
        points: parameters (k',) of each term at which the derivative is taken.
        whiteners: (P, b, b); where given, the derivative is of the whitened residual.
    """
    return motions_by_terms(at, poses, terms, points).by_parameters(whiteners)


@dataclass(frozen=True, eq=False)
class MotionsByTerms:
    """Motions of P poses by the parameters of terms, and how b components follow."""

    by_end: Array  # (P, b, 6) derivative of the residual by motions of the end along base axes
    in_base: tuple[Array, ...]  # of each term (P, 6, k'), these motions by its parameters
    # of each term the derivative (P, b, k') by how it distorts the targets' pattern; None: it does
    # not
    distorted: tuple[Array | None, ...]

    def by_parameters(self, whiteners: Array | None = None) -> list[Array]:
        """Return the derivative of the residual, or of the whitened one, as `by_terms` does."""
        by_end = self.by_end if whiteners is None else whiteners @ self.by_end
        by_parameters = [by_end @ columns for columns in self.in_base]
        for columns, distorted in zip(by_parameters, self.distorted, strict=True):
            if distorted is not None:
                columns += distorted if whiteners is None else whiteners @ distorted
        return by_parameters

    def of(self, chosen: Sequence[int]) -> MotionsByTerms:
        """Return the motions by some of the terms."""
        in_base = tuple(self.in_base[k] for k in chosen)
        return MotionsByTerms(self.by_end, in_base, tuple(self.distorted[k] for k in chosen))


def motions_by_terms(
    at: FittedModel, poses: Observations, terms: Sequence[Term], points: Sequence[Array]
) -> MotionsByTerms:
    """Return the motions of poses by the parameters of terms; arguments as of `by_terms`."""
    T_base_ee, in_base = at.model.by_terms(poses.states, at.x, terms, points)
    compared = poses.measured.compare(at.T_instr_base @ T_base_ee, at.targets_m)
    distorted = (
        by_target_distortion(compared.by_targets, poses, term, point)
        for term, point in zip(terms, points, strict=True)
    )
    return MotionsByTerms(along_base(compared.by_end, at), tuple(in_base), tuple(distorted))


def by_target_distortion(
    by_targets: Array, poses: Observations, term: Term, point: Array
) -> Array | None:
    """Return the derivative (P, b, k) of components by how a term distorts the targets' pattern.

    None where it does not. `by_targets` (P, b, t) is the derivative by the targets' coordinates.
    """
    distorted = term.targets_derivative(poses.states, point) if by_targets.shape[2] else None
    return None if distorted is None else by_targets @ distorted


def by_scaled_terms(
    at: FittedModel,
    poses: Observations,
    terms: Sequence[Term],
    whiteners: Array | None = None,
) -> list[Array]:
    """Return `by_terms` of terms of the model, a unit of a parameter being its possible size."""
    places = [at.model.columns_of(term) for term in terms]
    sizes = possible_sizes(at.model)
    by_parameters = by_terms(at, poses, terms, [at.x[place] for place in places], whiteners)
    return [columns * sizes[place] for columns, place in zip(by_parameters, places, strict=True)]


def by_scaled_effects(
    at: FittedModel,
    poses: Observations,
    effects: Sequence[Effect],
    points: Sequence[Array],
    whiteners: Array | None = None,
) -> list[Array]:
    """Return `by_terms` of the linear parameters of effects, in their plausible sizes."""
    by_parameters = by_terms(at, poses, effects, points, whiteners)
    return [
        columns[:, :, : effect.linear] @ effect.prior_factor
        for columns, effect in zip(by_parameters, effects, strict=True)
    ]


def by_base(at: FittedModel, poses: Observations) -> Array:
    """Return the derivative of the residual by six small motions of the base, (P, b, 6)."""
    return by_terms(at, poses, [base_frame()], [np.zeros(6)])[0]


def by_joints(at: FittedModel, poses: Observations, joints: Sequence[int]) -> Array:
    """Return the derivative of the residual by the positions of joints, from 1: (P, b, j)."""
    return by_terms(at, poses, [joint_positions(at, joints)], [np.zeros(len(joints))])[0]


def by_coordinates(at: FittedModel, poses: Observations, coordinates: Sequence[str]) -> Array:
    """Return the derivative of the residual by c chain coordinates: (P, b, c)."""
    names = tuple(coordinates)
    offsets = Offsets(tuple(TermParameter(name, "", 1.0) for name in names), names)
    return by_terms(at, poses, [offsets], [np.zeros(len(names))])[0]


def joint_positions(at: FittedModel, joints: Sequence[int]) -> Offsets:
    """Return errors of the positions of joints, from 1, as a term."""
    chain = at.model.chain
    driven = [chain.motions[chain.joint_columns[joint - 1]].coordinate for joint in joints]
    return Offsets(tuple(TermParameter(name, "", 1.0) for name in driven), tuple(driven))


@dataclass(frozen=True, eq=False)
class WhitenedPoses:
    """P complete poses about a model that was fitted to them, with what whitens their residual."""

    at: FittedModel
    poses: Observations
    residual: Array  # (P, b) predicted minus measured components
    whitener: Array  # (P, b, b) by which the noise of the residual has the unit covariance

    def at_most(self, count: int) -> WhitenedPoses:
        """Return at most `count` of the poses; of more, so many are drawn at random."""
        return self if len(self.poses) <= count else self.take(drawn(len(self.poses), count))

    def take(self, rows: Index) -> WhitenedPoses:
        """Return some of the poses."""
        poses, residual = self.poses.take(rows), self.residual[rows]
        return WhitenedPoses(self.at, poses, residual, self.whitener[rows])

    @property
    def data(self) -> Array:
        """Return whitened measured minus predicted components, (P, b)."""
        return -(self.whitener @ self.residual[:, :, None])[:, :, 0]

    @property
    def by_targets(self) -> Array:
        """Return the derivative of the whitened residual by targets, (P, b, t)."""
        return np.asarray(self.whitener @ self.at.compared(self.poses).by_targets)
