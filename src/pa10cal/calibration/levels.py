"""Residuals of the calibration and their exact derivative, on two levels and on one.

Rows are those of paper equations (2) and (4): position difference over r_max, and the chord of the
orientation difference, for every pose. On two levels the base frame is the inner minimum for each
set of outer parameters, so its derivative is that of an implicit function; on one level six
parameters of the model place the base.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.inner import BaseFrame, fit_base_frame
from pa10cal.frame.pose_error import pose_error
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Linearisation:
    """Residuals of N poses at one point and their derivatives there.

    Attributes:
        residuals: (N, 6) position over r_max, then chord of the orientation.
        jacobian: (N, 6, k) total derivative by the parameters.
        by_base: (N, 6, 6) derivative by the base frame: translation in the instrument's frame
            [m], then a small right rotation.
        T_instr_base: (4, 4) base frame.
        base_jacobian: (6, k) derivative of the base frame by the parameters.
    """

    residuals: Array
    jacobian: Array
    by_base: Array
    T_instr_base: Array
    base_jacobian: Array


class Level(Protocol):
    """What the solver needs of a calibration problem."""

    @property
    def model(self) -> Model:
        """Return the model whose parameters are fitted."""

    @property
    def observations(self) -> Observations[Pose]:
        """Return the measured poses."""

    @property
    def inner_rows(self) -> NDArray[np.intp]:
        """Return the rows of the inner level, none on one level."""

    def base(self, x: Array) -> BaseFrame:
        """Return the base frame that goes with parameters x."""

    def residuals(self, x: Array) -> Array:
        """Return (N, 6) residuals."""

    def linearise(self, x: Array) -> Linearisation:
        """Return residuals and exact derivatives."""


@dataclass(frozen=True)
class TwoLevel:
    """The paper's problem: base frame inside, link parameters and springs outside.

    Attributes:
        model: chain and terms, without terms that move the base.
        observations: N measured poses.
        inner_rows: rows of the M poses of the inner level.
        r_max_m: length that normalises positions.
    """

    model: Model
    observations: Observations[Pose]
    inner_rows: NDArray[np.intp]
    r_max_m: float = 1.0

    def base(self, x: Array) -> BaseFrame:
        """Return the inner minimum for parameters x."""
        inner = self.observations.take(self.inner_rows)
        return fit_base_frame(
            self.model.predict(inner.states, x),
            inner.measured.T_instr_target,
            attitude_weight_m2=self.r_max_m**2,
        )

    def residuals(self, x: Array) -> Array:
        """Return (N, 6) residuals."""
        T_base_ee = self.model.predict(self.observations.states, x)
        base = self._fit(T_base_ee, None)
        return _residuals(
            base.T_instr_base @ T_base_ee, self.observations.measured.T_instr_target, self.r_max_m
        )

    def linearise(self, x: Array) -> Linearisation:
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


@dataclass(frozen=True)
class OneLevel:
    """All unknowns at once; the model's own terms move the base away from `T_instr_base`.

    Attributes:
        model: chain and terms, a base-frame term among them.
        observations: N measured poses.
        T_instr_base: (4, 4) where the base is when its term is zero.
        r_max_m: length that normalises positions.
    """

    model: Model
    observations: Observations[Pose]
    T_instr_base: Array
    r_max_m: float = 1.0

    @property
    def inner_rows(self) -> NDArray[np.intp]:
        """Return no rows: there is no inner level."""
        return np.zeros(0, dtype=np.intp)

    def base(self, x: Array) -> BaseFrame:
        """Return the fixed frame that the model's base term starts from."""
        return BaseFrame(self.T_instr_base, np.zeros((6, len(x))))

    def residuals(self, x: Array) -> Array:
        """Return (N, 6) residuals."""
        T_base_ee = self.model.predict(self.observations.states, x)
        return _residuals(
            self.T_instr_base @ T_base_ee, self.observations.measured.T_instr_target, self.r_max_m
        )

    def linearise(self, x: Array) -> Linearisation:
        """Return residuals and exact derivatives."""
        predicted = self.model.predict_with_jacobian(self.observations.states, x)
        return _linearise(
            predicted.T_base_ee, predicted.jacobian, self.base(x), self.observations, self.r_max_m
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
) -> Linearisation:
    T_instr_base = base.T_instr_base
    R = T_instr_base[:3, :3]
    base_jacobian = base.jacobian if base.jacobian is not None else np.zeros((6, 0))
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
    total += by_base @ base_jacobian
    residuals = np.concatenate([error.position_m / r_max_m, error.chord], axis=1)
    return Linearisation(residuals, total, by_base, T_instr_base, base_jacobian)
