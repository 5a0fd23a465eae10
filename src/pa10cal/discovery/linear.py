"""Residuals of a model at measured poses and their derivatives, and the model with effects.

The model is taken at an operating point; its terms may move the base away from its base frame.
Every pose has b components as the instrument measures them, zero where a component was not seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.chain import BASE, end_pose_with_screws
from pa10cal.arrays import Array, Index, Mask, drawn
from pa10cal.calibration.general.unknowns import ChosenUnknowns, choose_unknowns
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.least_squares import Bounds
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.options import Tolerances
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import about_moved_base, motion_of_base
from pa10cal.terms.term import Offsets, Term, TermParameter, base_frame


def residual(at: FittedModel, poses: Observations) -> Array:
    """Return predicted minus measured components, (P, b) [m, rad]."""
    return at.compared(poses).residual


def residual_and_jacobian(at: FittedModel, poses: Observations) -> tuple[Array, Array]:
    """Return `residual`, and its exact derivative (P, b, k + t) by parameters and targets."""
    left, jacobian = residual_then_jacobian(at, poses)
    return left, jacobian()


def residual_then_jacobian(
    at: FittedModel, poses: Observations
) -> tuple[Array, Callable[[], Array]]:
    """Return `residual`, and a function that computes its derivative."""
    predicted = at.model.predict_with_jacobian(poses.states, at.x)
    found = poses.measured.compare(
        at.T_instr_base @ predicted.T_base_ee, at.targets_read_m(poses.states)
    )

    def jacobian() -> Array:
        by_model = _along_base(found.by_end, at) @ predicted.jacobian
        if not len(at.targets_m):
            return by_model
        for term in at.model.terms:
            columns = at.model.columns_of(term)
            distorted = by_distortion(found.by_targets, poses, term, at.x[columns])
            if distorted is not None:
                by_model[:, :, columns] += distorted
        return np.concatenate([by_model, found.by_targets], axis=2)

    return found.residual, jacobian


def by_terms(
    at: FittedModel,
    poses: Observations,
    terms: Sequence[Term],
    points: Sequence[Array],
    whiteners: Array | None = None,
) -> list[Array]:
    """Return the derivative of `residual` by the parameters of terms, each (P, b, k').

    Of the whitened residual where whiteners (P, b, b) are given.
    """
    T_base_ee, in_base = at.model.by_terms(poses.states, at.x, terms, points)
    found = poses.measured.compare(at.T_instr_base @ T_base_ee, at.targets_m)
    by_base = _along_base(found.by_end, at)
    if whiteners is not None:
        by_base = whiteners @ by_base
    by_parameters = [by_base @ columns for columns in in_base]
    for columns, term, point in zip(by_parameters, terms, points, strict=True):
        if (distorted := by_distortion(found.by_targets, poses, term, point)) is not None:
            columns += distorted if whiteners is None else whiteners @ distorted
    return by_parameters


def by_distortion(by_targets: Array, poses: Observations, term: Term, point: Array) -> Array | None:
    """Return the derivative (P, b, k) of components by how a term distorts the targets' pattern.

    None where it does not. `by_targets` (P, b, t) is the derivative by the targets' coordinates.
    """
    distorted = term.targets_derivative(poses.states, point) if by_targets.shape[2] else None
    return None if distorted is None else by_targets @ distorted


def by_own_terms(
    at: FittedModel,
    poses: Observations,
    terms: Sequence[Term],
    whiteners: Array | None = None,
) -> list[Array]:
    """Return the derivative by terms of the model itself, times their possible sizes."""
    places = [at.model.columns_of(term) for term in terms]
    sizes = possible_sizes(at.model)
    found = by_terms(at, poses, terms, [at.x[place] for place in places], whiteners)
    return [columns * sizes[place] for columns, place in zip(found, places, strict=True)]


def by_effects(
    at: FittedModel,
    poses: Observations,
    effects: Sequence[Effect],
    points: Sequence[Array],
    whiteners: Array | None = None,
) -> list[Array]:
    """Return the derivative by the linear parameters of effects, in their plausible sizes."""
    found = by_terms(at, poses, effects, points, whiteners)
    return [
        columns[:, :, : effect.linear] @ effect.prior_factor
        for columns, effect in zip(found, effects, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class WhitenedPoses:
    """P complete poses about a model that was fitted to them, with what makes them white."""

    at: FittedModel
    poses: Observations
    residual: Array  # (P, b) predicted less measured components
    whitener: Array  # (P, b, b) makes the residual of each pose white

    def at_most(self, count: int) -> WhitenedPoses:
        """Return so many of the poses, drawn at random, where there are more."""
        return self if len(self.poses) <= count else self.take(drawn(len(self.poses), count))

    def take(self, rows: Index) -> WhitenedPoses:
        """Return some of the poses."""
        poses, residual = self.poses.take(rows), self.residual[rows]
        return WhitenedPoses(self.at, poses, residual, self.whitener[rows])

    @property
    def data(self) -> Array:
        """Return whitened measured less predicted components, (P, b)."""
        return -(self.whitener @ self.residual[:, :, None])[:, :, 0]

    @property
    def by_targets(self) -> Array:
        """Return the derivative of the whitened residual by targets, (P, b, t)."""
        return np.asarray(self.whitener @ by_targets(self.at, self.poses))


def by_end(at: FittedModel, poses: Observations, T_base_ee: Array) -> Array:
    """Return the derivative of components by velocities of the end along base axes, (P, b, 6).

    For a residual of zero with the end at T_base_ee (P, 4, 4): the components of an orientation
    error then equal its angles.
    """
    T_instr_ee, measured = at.T_instr_base @ T_base_ee, poses.measured
    found = measured.ideal(T_instr_ee, at.targets_m).compare(T_instr_ee, at.targets_m)
    return _along_base(found.by_end * measured.components_seen[..., None], at)


def by_every_joint(at: FittedModel, poses: Observations) -> Array:
    """Return the derivative of components by each joint's position, (P, b, n); see `by_end`."""
    chain = at.model.chain
    end = end_pose_with_screws(chain, at.model.chain_coordinates(poses.states, at.x))
    return np.asarray(by_end(at, poses, end.T) @ end.screws[:, :, chain.joint_columns])


def by_base(at: FittedModel, poses: Observations) -> Array:
    """Return the derivative of `residual` by six small motions of the base, (P, b, 6)."""
    return by_terms(at, poses, [base_frame()], [np.zeros(6)])[0]


def by_targets(at: FittedModel, poses: Observations) -> Array:
    """Return the derivative of `residual` by the coordinates of targets, (P, b, t)."""
    return at.compared(poses).by_targets


def by_joints(at: FittedModel, poses: Observations, joints: Sequence[int]) -> Array:
    """Return the derivative of `residual` by the positions of joints, from 1: (P, b, j)."""
    return by_terms(at, poses, [positions_of(at, joints)], [np.zeros(len(joints))])[0]


def positions_of(at: FittedModel, joints: Sequence[int]) -> Offsets:
    """Return the positions of joints, from 1, as a term."""
    chain = at.model.chain
    driven = [chain.motions[chain.joint_columns[joint - 1]].coordinate for joint in joints]
    return Offsets(tuple(TermParameter(name, "", 1.0) for name in driven), tuple(driven))


def error_mm(measured: Instrument, residual: Array) -> Array:
    """Return the position error (P,) of a residual (P, b): rms over targets, or of the distance."""
    at, times = _positions(measured)
    return np.asarray(1e3 * np.sqrt(np.sum(residual[:, at] ** 2, axis=1) / times))


def rms(values: Array) -> float:
    """Return the root mean square of values."""
    return float(np.sqrt(np.mean(values**2)))


def standard_error(gain: Array) -> float:
    """Return the standard error of the sum of values of blocks, by their scatter."""
    return float(np.sqrt(len(gain)) * gain.std(ddof=1))


def left_out(data: Array, columns: Array, fold: Index) -> Array:
    """Return the residuals of rows (R,), those of each fold predicted from all other folds.

    By columns (R, k), each in its expected size.
    """
    found = np.empty(len(data))
    parts = [np.flatnonzero(fold == number) for number in np.unique(fold)]
    each = [Gaussian.of(columns[rows], data[rows]) for rows in parts]
    every = sum(each, Gaussian.none(columns.shape[1]))
    for rows, part in zip(parts, each, strict=True):
        found[rows] = data[rows] - columns[rows] @ (every - part).mean
    return found


def cluster_covariance(inverse: Array, scores: Array, cluster: Index) -> Array:
    """Return the covariance (k, k) of least squares with correlated errors within clusters.

    That of Liang and Zeger (1986), with the usual factor for few clusters.

    Args:
        inverse: (k, k) of the normal equations.
        scores: (N, k) columns times residual of each row.
        cluster: (N,) number of the cluster of each row, from 0.
    """
    count = int(cluster.max()) + 1
    sums = np.zeros((count, scores.shape[1]))
    np.add.at(sums, cluster, scores)
    half = inverse @ sums.T
    return np.asarray(half @ half.T * count / max(count - 1, 1))


def position_m(
    at: FittedModel, poses: Observations, components: Array, cov: Array
) -> tuple[Array, Array]:
    """Return the position errors of components, (P, 3) [m], and the variances of their noise.

    Along the instrument's axes and averaged over the targets; of a distance, along the line of
    sight. Components (P, b) are measured minus predicted, their noise has a covariance (P, b, b).
    """
    rows, times = _positions(poses.measured)
    T_instr_ee = at.T_instr_base @ at.model.predict(poses.states, at.x)
    ideal = poses.measured.ideal(T_instr_ee, at.targets_m).compare(T_instr_ee, at.targets_m)
    seen = poses.measured.components_seen[:, rows, None]
    to_axes = (seen * ideal.by_end[:, rows, :3] / times[:, None, None]).transpose(0, 2, 1)
    position = (to_axes @ components[:, rows, None])[:, :, 0]
    own = cov[:, rows[:, None], rows]
    variance = np.einsum("pik,pkl,pil->pi", to_axes, own, to_axes, optimize=True)
    return position, variance


def position_noise(measured: Instrument, cov: Array) -> Array:
    """Return covariances (P, d, d) [m²] of vectors of the length of each pose's position error.

    From the covariance (P, b, b) of the components.
    """
    at, times = _positions(measured)
    seen = measured.components_seen[:, at]
    both = seen[:, :, None] & seen[:, None, :]
    return np.asarray(np.where(both, cov[:, at[:, None], at], 0.0) / times[:, None, None])


def mean_length(covariance: Array) -> Array:
    """Return the mean length of Gaussian vectors, (P,), for covariances (P, d, d)."""
    sizes = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))
    draws = np.random.default_rng(0).standard_normal((COMPUTING.draws, covariance.shape[1]))
    lengths = np.sqrt((sizes[:, None, :] ** 2 * draws[None] ** 2).sum(axis=2))
    return np.asarray(lengths.mean(axis=1))


def mean_error_of_noise_mm(measured: Instrument, cov: Array) -> float:
    """Return the mean position error by noise of covariances (P, b, b), averaged over the poses."""
    noise = position_noise(measured, cov)
    if not measured.campaigns:
        return float(1e3 * mean_length(noise.mean(axis=0, keepdims=True))[0])
    _, way = np.unique(measured.components_seen, axis=0, return_inverse=True)
    means = np.stack([noise[way.ravel() == k].mean(axis=0) for k in range(way.max() + 1)])
    return float(1e3 * np.average(mean_length(means), weights=np.bincount(way.ravel())))


def _along_base(by_end: Array, at: FittedModel) -> Array:
    """Return a derivative (P, b, 6) by the end, along base axes from the instrument's."""
    R = at.T_instr_base[:3, :3]
    return np.concatenate([by_end[..., :3] @ R, by_end[..., 3:] @ R], axis=2)


def _positions(measured: Instrument) -> tuple[Index, Array]:
    """Return which components are of positions, and over how many targets each pose has them."""
    at = measured.position_columns
    return at, np.maximum(measured.components_seen[:, at].sum(axis=1) / 3.0, 1.0)


# The calibrated model with effects, in which every search ends.


@dataclass(frozen=True, eq=False)
class ModelWithEffects:
    """The calibrated model with effects.

    The unknowns are the parameters of the calibrated model, effect by effect, six small motions of
    the base, and the places of the instrument's targets, in that order.
    """

    effects: tuple[Effect, ...]
    # chain and terms: those of the calibrated model, the effects, and small motions of the base;
    # with their parameters, and targets where the instrument has some of its own
    at: FittedModel
    converged: bool  # whether the solver stopped by itself

    @property
    def model(self) -> Model:
        """Return chain and terms, the base's own among them."""
        return self.at.model

    @property
    def x(self) -> Array:
        """Return all unknowns."""
        return unknowns(self.at)

    def columns_of(self, effect: Effect) -> slice:
        """Return the columns of one of its effects."""
        return self.model.columns_of(effect)

    def own_columns(self) -> Index:
        """Return the columns of the unknowns that belong to no effect."""
        own = np.ones(len(self.x), dtype=bool)
        for effect in self.effects:
            own[self.columns_of(effect)] = False
        return np.flatnonzero(own)

    def of(self, effect: Effect) -> Array:
        """Return the parameters of one of its effects."""
        return self.at.x[self.columns_of(effect)]

    def reported(self, effect: Effect, covariance: Array) -> tuple[Array, Array]:
        """Return the reported parameters of an effect, and their part of the covariance (k, k)."""
        columns = self.columns_of(effect)
        report = effect.report(self.at.x[columns])
        own = covariance[columns, columns]
        return report.values, report.covariance(own, self.at.model.u_scale)

    def fitted(self, covariance: Array | None = None) -> FittedModel:
        """Return the model with the motion of its base in the base frame, not in a term of its own.

        Its discrepancy is not known.

        Args:
            covariance: (k, k) of all unknowns; None where it is not needed.
        """
        k, terms = len(self.at.x) - 6, self.model.terms[:-1]
        return replace(
            self.at,
            model=Model(self.model.chain, terms),
            x=about_moved_base(terms, self.at.x[:k], self.at.x[k:]),
            T_instr_base=moved_base(self.at.T_instr_base, self.at.x[k:]),
            covariance=None if covariance is None else covariance[: k + 6, : k + 6],
            discrepancy=None,  # that of the model without effects
        )


def with_base_term(baseline: FittedModel, effects: tuple[Effect, ...] = ()) -> Model:
    """Return the calibrated model's terms, effects, and small motions of the base."""
    terms = (*baseline.model.terms, *effects, base_frame())
    return Model(baseline.model.chain, terms)


def chosen_unknowns(baseline: FittedModel, measured: Instrument) -> ChosenUnknowns:
    """Return the geometric parameters that calibrations of this arm and instrument identify."""
    start = Start(
        baseline.T_instr_base, np.zeros(3), baseline.R_ee_target, targets_m=baseline.targets_m
    )
    return choose_unknowns(baseline.arm, Tolerances(), measured, start)


def bounds_about(baseline: FittedModel, model: Model, measured: Instrument) -> Bounds:
    """Return the ranges of a model's parameters and of the targets' coordinates (k + t,).

    Coordinates that the geometry does not identify are held where the calibration has them: with
    all axes parallel the height of a target is that of the base. Effects that tilt the axes would
    show it, but no better than they are known themselves.
    """
    count = len(baseline.targets_m)
    bounds = Bounds.of((*model.parameters, *measured.target_parameters[:count]))
    if not count:
        return bounds
    held = np.ones(count, dtype=bool)
    held[chosen_unknowns(baseline, measured).places] = False
    at = len(model.parameters) + np.flatnonzero(held)
    bounds.lower[at] = bounds.upper[at] = baseline.targets_m[held]
    return bounds


def base_shown(measured: Instrument) -> Mask:
    """Return which small motions of the base (6,) are identifiable: turns if directions are."""
    return np.array([measured.directional or name not in BASE[3:] for name in BASE])


def unknowns(at: FittedModel) -> Array:
    """Return the parameters of a model's terms and the places of its targets, (k + t,)."""
    return np.concatenate([at.x, at.targets_m])


def at_unknowns(at: FittedModel, x: Array) -> FittedModel:
    """Return a model with other `unknowns` (k + t,)."""
    k = len(at.model.parameters)
    return replace(at, x=x[:k], targets_m=x[k:])


def moved_base(T_instr_base: Array, small: Array) -> Array:
    """Return a base frame moved by the six small motions (6,) that a model's base term makes."""
    return np.asarray(T_instr_base @ motion_of_base(small))
