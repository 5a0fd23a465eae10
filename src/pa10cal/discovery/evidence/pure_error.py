"""What is left of poses and torques against pure error: how much, and what it is in each cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import fdtrc

from pa10cal.discovery.evidence.fit import Fit, pose_rows, torque_rows
from pa10cal.discovery.evidence.noise_model import NoiseModel
from pa10cal.discovery.evidence.problem import Problem
from pa10cal.discovery.operating_point import possible_sizes

Array = NDArray[np.float64]

#: Rows with less of the shared error than this compare cells of a pose with each other.
_NO_PART = 1e-9


@dataclass(frozen=True)
class PureErrorTest:
    """What is left against pure error: Fisher's F.

    Attributes:
        chi_square: sum of squares in units of the pure error's variance.
        dof: rows less what the parameters took of them.
        pure_dof: behind the pure error, from repeats.
    """

    chi_square: float
    dof: float
    pure_dof: int

    @property
    def ratio(self) -> float:
        """Return F, near one where the model lacks nothing."""
        return self.chi_square / self.dof

    @property
    def p_value(self) -> float:
        """Return the probability of so large an F where the model lacks nothing."""
        return float(fdtrc(self.dof, self.pure_dof, self.ratio))


@dataclass(frozen=True)
class ChannelTest:
    """Lack of fit of one channel, row by row; the verdict rests on poses, not on this.

    Attributes:
        shared: what the cells of a pose share, by load, direction and time; None without such rows.
        unshared: what differs among them beyond that; None without such rows.
        shared_variance: of an error that the cells of a pose share and that would make up for what
            is left, in variances of one reading.
    """

    shared: PureErrorTest | None
    unshared: PureErrorTest | None
    shared_variance: float


def channel_tests(problem: Problem, found: Fit) -> tuple[ChannelTest, ChannelTest | None]:
    """Test both channels, the parameters' part of every row taken off its freedom."""
    channels = [(problem.pose, pose_rows(found.level.linearise(found.x)))]
    if problem.torque is not None:
        channels.append((problem.torque, torque_rows(problem, found.model, found.x)))
    weighed = [channel.whitening(0.0)(channel.rows(values)) for channel, values in channels]
    # Columns by what is thought possible of each parameter, so that those that the rows do not
    # tell take no freedom.
    by_x = [rows[:, 1:] * possible_sizes(found.model) for rows in weighed]
    factor = cho_factor(sum(rows.T @ rows for rows in by_x) + np.eye(len(found.x)))
    tests = []
    for (channel, values), rows, columns in zip(channels, weighed, by_x, strict=True):
        taken = np.einsum("rk,kr->r", columns, cho_solve(factor, columns.T))
        pure = problem.noise.differences * values.shape[1]
        tests.append(_channel_test(channel, rows[:, 0] ** 2, 1.0 - taken, pure))
    return tests[0], tests[1] if len(tests) > 1 else None


def _channel_test(channel: NoiseModel, squares: Array, dof: Array, pure: int) -> ChannelTest:
    shared = channel.shared_size > _NO_PART
    tests = [
        PureErrorTest(float(squares[rows].sum()), float(dof[rows].sum()), pure)
        if rows.any()
        else None
        for rows in (shared, ~shared)
    ]
    beyond = 0.0 if tests[0] is None else max(tests[0].chi_square - tests[0].dof, 0.0)
    largest = float(dof @ channel.shared_size)
    return ChannelTest(tests[0], tests[1], beyond / largest if beyond else 0.0)


def left_over(channel: NoiseModel, rows: Array, shared_variance: float) -> Array:
    """Return measured less predicted, whitened, less the errors alike in all poses, (C, b).

    These errors have unit variance each, by which they are held back; the error that poses share
    keeps them from taking what the model lacks.

    Args:
        channel: the channel.
        rows: (C, b, 1 + k) predicted less measured, and its derivative.
        shared_variance: of the error that poses share.
    """
    left = -channel.rows(rows[:, :, :1])
    weight = 1.0 / (1.0 + shared_variance * channel.shared_size)[:, None]
    normal = channel.common.T @ (weight * channel.common) + np.eye(channel.common.shape[1])
    common = cho_solve(cho_factor(normal), channel.common.T @ (weight * left))
    left = left - channel.common @ common
    white = channel.shared.turn.T @ left.reshape(len(rows), -1)
    return np.asarray(white)
