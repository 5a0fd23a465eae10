"""Residuals of the calibration on two levels, and their exact derivative.

Rows are those of paper equations (2) and (4): position difference over r_max, and the chord of the
orientation difference, for every pose. The base frame is the inner minimum for each set of outer
parameters, so its derivative is that of an implicit function. On one level, where six parameters
of the model place the base, the problem is `fit.Problem`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.calibration.inner import BaseFrame, fit_base_frame
from pa10cal.fit.problem import Problem, Rows
from pa10cal.frame.pose_error import pose_error
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import base_frame
from pa10cal.terms.term import Parameter


@dataclass(frozen=True)
class TwoLevelRows(Rows):
    """Rows of N poses at one point, through the inner level.

    Attributes:
        residual: (N, 6) position over r_max, then chord of the orientation.
        jacobian: (N, 6, k) total derivative by the parameters.
    """

    # (N, 6, 6) derivative by the base frame: translation in the instrument's frame [m], then a
    # small right rotation
    by_base: Array
    T_instr_base: Array  # (4, 4) base frame
    base_jacobian: Array  # (6, k) derivative of the base frame by the parameters


@dataclass(frozen=True)
class TwoLevel:
    """The paper's problem: base frame inside, link parameters and springs outside."""

    model: Model  # chain and terms, without terms that move the base
    observations: Observations[Pose]  # N measured poses
    inner_rows: NDArray[np.intp]  # rows of the M poses of the inner level
    r_max_m: float = 1.0  # length that normalises positions

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the outer parameters, those of the model."""
        return self.model.parameters

    @property
    def weights(self) -> Array:
        """Return what components [m, rad] are multiplied by in the rows, (6,)."""
        return np.concatenate([np.full(3, 1.0 / self.r_max_m), np.ones(3)])

    def one_level(self, T_instr_base: Array) -> Problem:
        """Return the same with the base among the unknowns, as six small motions, the last ones.

        Args:
            T_instr_base: (4, 4) where the base is when these are zero.
        """
        model = Model(self.model.chain, (*self.model.terms, base_frame()))
        none = np.zeros(0)
        return Problem(model, none.astype(np.intp), none, T_instr_base, self.observations)

    def base(self, x: Array) -> BaseFrame:
        """Return the inner minimum for parameters x."""
        inner = self.observations.take(self.inner_rows)
        return fit_base_frame(
            self.model.predict(inner.states, x),
            inner.measured.T_instr_target,
            attitude_weight_m2=self.r_max_m**2,
        )

    def residual(self, x: Array) -> Array:
        """Return predicted less measured, (N, 6)."""
        T_base_ee = self.model.predict(self.observations.states, x)
        base = self._fit(T_base_ee, None)
        return _residuals(
            base.T_instr_base @ T_base_ee, self.observations.measured.T_instr_target, self.r_max_m
        )

    def rows(self, x: Array) -> TwoLevelRows:
        """Return residuals and exact derivatives, by one inner solve."""
        predicted = self.model.predict_with_jacobian(self.observations.states, x)
        base = self._fit(predicted.T_base_ee, predicted.jacobian)
        return _linearise(
            predicted.T_base_ee, predicted.jacobian, base, self.observations, self.r_max_m
        )

    def _fit(self, T_base_ee: Array, jacobian: Array | None) -> BaseFrame:
        rows = self.inner_rows
        return fit_base_frame(
            T_base_ee[rows],
            self.observations.measured.T_instr_target[rows],
            attitude_weight_m2=self.r_max_m**2,
            jacobian=None if jacobian is None else jacobian[rows],
        )


def _residuals(T_predicted: Array, T_measured: Array, r_max_m: float) -> Array:
    error = pose_error(T_predicted, T_measured)
    return np.concatenate([error.position_m / r_max_m, error.chord], axis=1)


def _linearise(
    T_base_ee: Array,
    jacobian: Array,
    base: BaseFrame,
    observations: Observations[Pose],
    r_max_m: float,
) -> TwoLevelRows:
    T_instr_base = base.T_instr_base
    R = T_instr_base[:3, :3]
    assert base.jacobian is not None
    error = pose_error(T_instr_base @ T_base_ee, observations.measured.T_instr_target)
    # R exp([omega]) p + t: the base moves the point by dt + (R omega) x (R p), turns it by R omega.
    p = T_base_ee[:, :3, 3] @ R.T
    by_base = np.zeros((len(p), 6, 6))
    by_base[:, :3, :3] = np.eye(3) / r_max_m
    by_base[:, :3, 3:] = np.cross(R.T[None], p[:, None, :]).transpose(0, 2, 1) / r_max_m
    by_base[:, 3:, 3:] = error.by_rotation @ R
    total = np.empty_like(jacobian)
    total[:, :3] = (R / r_max_m) @ jacobian[:, :3]
    total[:, 3:] = by_base[:, 3:, 3:] @ jacobian[:, 3:]
    total += by_base @ base.jacobian
    residuals = np.concatenate([error.position_m / r_max_m, error.chord], axis=1)
    return TwoLevelRows(residuals, total, by_base, T_instr_base, base.jacobian)
