"""The full non-linear fit of the model with some effects, weighed as the evidence weighs."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.calibration.levels import Linearisation, OneLevel
from pa10cal.discovery.evidence.likelihood import SIZES
from pa10cal.discovery.evidence.minimise import minimise
from pa10cal.discovery.evidence.problem import Problem
from pa10cal.discovery.operating_point import possible_sizes
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import base_frame
from pa10cal.terms.term import shows_torque

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fit:
    """The model with effects, fitted.

    Attributes:
        effects: the effects in it.
        sizes: index in `evidence.SIZES` of the size expected of each.
        level: whose model holds the baseline's terms, the effects and the base frame.
        x: (k,) parameters, in that order.
        pose_variance, torque_variance: shared errors by which it was weighed.
        converged: whether the solver stopped by itself.
    """

    effects: tuple[Effect, ...]
    sizes: tuple[int, ...]
    level: OneLevel
    x: Array
    pose_variance: float
    torque_variance: float
    converged: bool

    @property
    def model(self) -> Model:
        """Return the whole model."""
        return self.level.model

    def own_columns(self) -> NDArray[np.intp]:
        """Return the columns of the parameters that belong to no effect."""
        effects = np.concatenate(
            [np.zeros(0, int), *(np.arange(*s) for s in self.effect_columns())]
        )
        return np.setdiff1d(np.arange(len(self.x)), effects)

    def effect_columns(self) -> list[tuple[int, int]]:
        """Return first column and the one past the last of each effect."""
        widths = [len(effect.parameters) for effect in self.effects]
        stops = len(self.x) - 6 - np.cumsum([0, *widths[::-1]])[::-1]
        return list(pairwise(stops.tolist()))

    def of(self, effect: Effect) -> Array:
        """Return the parameters of one of its effects."""
        first, last = self.effect_columns()[self.effects.index(effect)]
        return self.x[first:last]


def fit(
    problem: Problem,
    effects: tuple[Effect, ...],
    sizes: tuple[int, ...],
    variances: tuple[float, float],
    start: Fit | None = None,
) -> Fit:
    """Fit the model with some effects; from several shapes where an effect has them, the best.

    Args:
        problem: the campaign.
        effects: what to add to the baseline.
        sizes: index of the size expected of each.
        variances: of the shared errors of poses and of torques.
        start: a fit to set out from; the baseline where None.
    """
    tried = [
        _fit_from(problem, effects, sizes, variances, start, shape)
        for shape in range(max((len(effect.starts) for effect in effects), default=1))
    ]
    return min(tried, key=lambda found: found[1])[0]


def _fit_from(
    problem: Problem,
    effects: tuple[Effect, ...],
    sizes: tuple[int, ...],
    variances: tuple[float, float],
    start: Fit | None,
    shape: int,
) -> tuple[Fit, float]:
    baseline = problem.baseline
    model = Model(baseline.model.chain, (*baseline.model.terms, *effects, base_frame()))
    level = OneLevel(model, problem.cells, baseline.T_instr_base)
    x_start = _start(problem, effects, start, shape)
    weigh = _Weighing(problem, effects, sizes, variances, level, x_start)
    x, cost, converged = minimise(weigh, x_start, model)
    return Fit(effects, sizes, level, x, *variances, converged), cost


def covariance_of(problem: Problem, found: Fit) -> Array:
    """Return the covariance (k, k) that data and expected sizes leave of all parameters."""
    variances = (found.pose_variance, found.torque_variance)
    weigh = _Weighing(problem, found.effects, found.sizes, variances, found.level, found.x)
    _, jacobian = weigh(found.x)
    information = jacobian.T @ jacobian
    size = 1.0 / np.sqrt(np.diag(information))
    inverse: Array = np.linalg.inv(information * np.outer(size, size)) * np.outer(size, size)
    return inverse


def apparatus_m(problem: Problem, found: Fit) -> Array:
    """Return what the fit says of the targets' places on the apparatus, (a,) [m].

    They are integrated out in the fit, and are known best once it is done: the error of their
    places that the poses all share.
    """
    u_m = problem.setup.apparatus_m
    scale = problem.pose.whitening(found.pose_variance).scale[:, None]
    common = scale * problem.pose.common
    left = scale * problem.pose.rows(pose_rows(found.level.linearise(found.x))[:, :, :1])
    information = common.T @ common + np.eye(common.shape[1])
    units = np.linalg.solve(information, common.T @ left)[:, 0]
    return np.asarray(-u_m * units, dtype=np.float64)


def as_read(
    T_base_ee: Array, T_instr_base: Array, poses: Observations[Pose], places_m: Array
) -> Array:
    """Return predicted poses as the instrument reads them with targets off their places.

    Args:
        T_base_ee: (P, 4, 4) predicted poses.
        T_instr_base: (4, 4) base frame.
        poses: the measured poses, which say how they answer to the targets' places.
        places_m: (a,) from `apparatus_m`.

    Returns:
        (P, 4, 4) in the base frame.
    """
    R = T_instr_base[:3, :3]
    moved = poses.measured.by_apparatus @ places_m
    T: Array = T_base_ee.copy()
    T[:, :3, 3] += moved[:, :3] @ R
    turned: Array = Rotation.from_rotvec(moved[:, 3:] @ R).as_matrix() @ T[:, :3, :3]
    T[:, :3, :3] = turned
    return T


def _start(problem: Problem, effects: tuple[Effect, ...], start: Fit | None, shape: int) -> Array:
    """Return where to set out: what is known of shared parameters, else zero in some shape."""
    own = (
        np.concatenate([problem.baseline.x, np.zeros(6)])
        if start is None
        else (start.x[start.own_columns()])
    )
    parts = []
    for effect in effects:
        if start is not None and effect in start.effects:
            parts.append(start.of(effect))
        else:
            parts.append(effect.starts[min(shape, len(effect.starts) - 1)])
    return np.concatenate([own[:-6], *parts, own[-6:]])


class _Weighing:
    """Rows of the fit: weighed poses and torques, and what is expected of every parameter."""

    def __init__(
        self,
        problem: Problem,
        effects: tuple[Effect, ...],
        sizes: tuple[int, ...],
        variances: tuple[float, float],
        level: OneLevel,
        x_start: Array,
    ) -> None:
        self._problem, self._level = problem, level
        self._pose = problem.pose.whitening(variances[0])
        shows = any(shows_torque(effect) for effect in effects)
        self._torque = (
            problem.torque.whitening(variances[1]) if problem.torque is not None and shows else None
        )
        possible = possible_sizes(level.model)
        rows = np.diag(1.0 / possible)
        # An effect in zero amount tells nothing of its shape: zero, the middle of what is expected
        # of all else, would draw the shape to the end of its range at the first step.
        middle = np.zeros(len(possible))
        column = len(possible) - 6 - sum(len(effect.parameters) for effect in effects)
        for effect, size in zip(effects, sizes, strict=True):
            here = slice(column, column + effect.linear)
            rows[here, here] = np.linalg.inv(SIZES[size] * effect.prior_factor)
            column += len(effect.parameters)
            middle[here.stop : column] = x_start[here.stop : column]
        self._expected, self._middle = rows, middle

    def __call__(self, x: Array) -> tuple[Array, Array]:
        """Return rows (R,) and their derivative (R, k)."""
        problem = self._problem
        at = self._level.linearise(x)
        rows = problem.pose.rows(pose_rows(at))
        weighed = [self._pose(rows)]
        if problem.torque is not None and self._torque is not None:
            weighed.append(
                self._torque(problem.torque.rows(torque_rows(problem, self._level.model, x)))
            )
        off = self._expected @ (x - self._middle)
        own = np.concatenate([off[:, None], self._expected], axis=1)
        everything = np.concatenate([*weighed, own])
        return everything[:, 0], everything[:, 1:]


def pose_rows(at: Linearisation) -> Array:
    """Return predicted minus measured and its derivative side by side, (C, 6, 1 + k)."""
    return np.concatenate([at.residuals[:, :, None], at.jacobian], axis=2)


def torque_rows(problem: Problem, model: Model, x: Array) -> Array:
    """Return predicted minus logged torque and its derivative side by side, (C, n, 1 + k)."""
    states = problem.cells.states
    residual = model.torque_Nm(states, x) - problem.torque_left_Nm
    return np.concatenate([residual[:, :, None], model.torque_jacobian(states, x)], axis=2)
