"""Where a fit and the data disagree, tested against pure error."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.fit import Fit, pose_rows, torque_rows
from pa10cal.discovery.evidence.noise_model import NoiseModel
from pa10cal.discovery.evidence.problem import Problem
from pa10cal.discovery.lack_of_fit import (
    CellResiduals,
    ChannelTest,
    LackOfFit,
    PureErrorTest,
    TorqueResiduals,
    lack_of_fit,
)
from pa10cal.discovery.linear import by_every_joint, possible_sizes

#: Rows with less of the shared error than this compare cells of a pose with each other.
_NO_PART = 1e-9


def evidence_lack_of_fit(problem: Problem, found: Fit) -> LackOfFit:
    """Compute where a fit and the data disagree.

    Two channels: poses, measured against predicted, and torques, logged against the weights. Errors
    common to all poses take their part first: places of targets on the apparatus, masses, loads,
    zeros.

    Args:
        problem: the campaign.
        found: the fit, with or without effects.
    """
    cells, at = problem.cells, found.at
    pose, torque = channel_tests(problem, found)
    components = _left_over(problem.pose, pose_rows(problem, at), pose)
    torques = None
    if problem.torque is not None and torque is not None:
        left_Nm = _left_over(problem.torque, torque_rows(problem, at), torque)
        torques = TorqueResiduals(left_Nm, problem.noise.torque_Nm)
    left = CellResiduals(at, cells, components, problem.cell_cov, by_every_joint(at, cells))
    return lack_of_fit(left, (pose, torque), torques)


def channel_tests(problem: Problem, found: Fit) -> tuple[ChannelTest, ChannelTest | None]:
    """Test both channels, the parameters' part of every row taken off its freedom."""
    channels = [(problem.pose, pose_rows(problem, found.at))]
    if problem.torque is not None:
        channels.append((problem.torque, torque_rows(problem, found.at)))
    weighed = [channel.whitening(0.0)(channel.rows(values)) for channel, values in channels]
    # Columns by the possible size of each parameter, so that those that the rows do not determine
    # take no degree of freedom.
    by_x = [rows[:, 1:] * possible_sizes(found.model, problem.cells.measured) for rows in weighed]
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
        if float(dof[rows].sum()) > _NO_PART
        else None
        for rows in (shared, ~shared)
    ]
    beyond = 0.0 if tests[0] is None else max(tests[0].chi_square - tests[0].dof, 0.0)
    largest = float(dof @ channel.shared_size)
    return ChannelTest(tests[0], tests[1], beyond / largest if beyond else 0.0)


def _left_over(model: NoiseModel, rows: Array, test: ChannelTest) -> Array:
    """Return measured less predicted, less the errors common to all poses, (C, b).

    These errors have unit variance each, by which they are held back; the error that poses share
    keeps them from taking what the model lacks.

    Args:
        model: the noise of the channel.
        rows: (C, b, 1 + k) predicted less measured, and its derivative.
        test: says what error the poses share.
    """
    left = -model.rows(rows[:, :, :1])
    weight = 1.0 / (1.0 + test.shared_variance * model.shared_size)[:, None]
    normal = model.common.T @ (weight * model.common) + np.eye(model.common.shape[1])
    common = cho_solve(cho_factor(normal), model.common.T @ (weight * left))
    left = left - model.common @ common
    white = model.shared.turn.T @ left.reshape(len(rows), -1)
    return np.asarray(np.linalg.solve(model.whitener, white[..., None])[:, :, 0])
