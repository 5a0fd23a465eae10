"""Lack of fit against the scatter of repeats, in two channels: components of poses, and torques."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.fit import (
    EvidenceFit,
    pose_rows,
    torque_residual_Nm,
    torque_rows,
)
from pa10cal.discovery.evidence.noise_model import NoiseModel
from pa10cal.discovery.evidence.problem import EvidenceProblem
from pa10cal.discovery.lack_of_fit import CellResiduals, lack_of_fit, pure_error_test
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.fit.joint_noise import ideal_by_joints
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.results.analysis import LackOfFit, PureErrorTest


class ChannelTest(NamedTuple):
    """Test of the errors that readings of a pose share, in poses or in torques."""

    pure_error: PureErrorTest | None  # None without repeats
    shared_variance: float  # of these errors, in units of the variance of a reading


def evidence_lack_of_fit(problem: EvidenceProblem, fitted: EvidenceFit) -> LackOfFit:
    """Compute where a fit and the data disagree, in poses and in torques.

    Residuals are those beyond the most likely errors common to all poses: of places of targets on
    the apparatus, masses, loads and zeros.
    """
    cells, at = problem.cells, fitted.at
    of_poses, of_torques = channel_tests(problem, fitted)
    difference = at.compared(cells).residual
    components = _net_residual(problem.pose, difference, of_poses.shared_variance)
    residuals = CellResiduals(at, cells, components, problem.cell_cov, ideal_by_joints(at, cells))
    if problem.torque is not None and of_torques is not None:
        difference_Nm = torque_residual_Nm(problem, at)
        torque_Nm = _net_residual(problem.torque, difference_Nm, of_torques.shared_variance)
        residuals = replace(residuals, torque_Nm=torque_Nm, torque_noise_Nm=problem.noise.torque_Nm)
    return lack_of_fit(residuals, of_poses.pure_error)


class _Channel(NamedTuple):
    """Poses or torques of C cells, with b components each, about a fit with k unknowns."""

    noise: NoiseModel
    values: Array  # (C, b, 1 + k) predicted minus measured, and its derivative
    pure_dof: int  # degrees of freedom of the noise of repeats


def channel_tests(
    problem: EvidenceProblem, fitted: EvidenceFit
) -> tuple[ChannelTest, ChannelTest | None]:
    """Test the errors that readings of a pose share, in poses and, where logged, in torques.

    Row i of a channel, whitened as if there were no such error, has d_i degrees of freedom: one
    less its leverage, by the parameters of the fit to the rows of both channels.
    """
    noise = problem.noise
    channels = [_Channel(problem.pose, pose_rows(problem, fitted.at), noise.components_compared)]
    if problem.torque is not None:
        torques = torque_rows(problem, fitted.at)
        channels.append(_Channel(problem.torque, torques, noise.differences * torques.shape[1]))
    whitened = [channel.noise.whitened(channel.values, 0.0) for channel in channels]
    # Columns in units of the possible size of each parameter, so that those that the rows do not
    # determine take no degree of freedom.
    sizes = possible_sizes(fitted.model, problem.cells.measured)
    columns = [rows[:, 1:] * sizes for rows in whitened]
    nothing = Gaussian.none(len(fitted.x))
    both = sum((Gaussian.of(by_x, np.zeros(len(by_x))) for by_x in columns), nothing)
    tests = [
        _channel_test(channel, rows[:, 0], 1.0 - both.variances(by_x))
        for channel, rows, by_x in zip(channels, whitened, columns, strict=True)
    ]
    return tests[0], None if problem.torque is None else tests[1]


def _channel_test(channel: _Channel, residual: Array, dof_of_row: Array) -> ChannelTest:
    """Test the shared error of one channel by its whitened residuals (R,).

    With v the variance of that error, and s_i its part in row i (zero in rows that hold none), the
    expected square of the residual of row i is about d_i (1 + v s_i). The chi-square of the rows
    with s_i > 0 is tested against their sum of d_i, and v = (chi-square - sum d_i) / sum d_i s_i.

    Args:
        dof_of_row: (R,) degrees of freedom d_i.
    """
    part = channel.noise.shared.variance
    has_part = part > COMPUTING.no_part
    dof = float(dof_of_row[has_part].sum())
    if dof <= COMPUTING.no_part:
        return ChannelTest(None, 0.0)
    test = pure_error_test(float((residual[has_part] ** 2).sum()), dof, channel.pure_dof)
    beyond_noise = max(test.chi_square - test.dof, 0.0)
    return ChannelTest(test, beyond_noise / float(dof_of_row @ part) if beyond_noise else 0.0)


def _net_residual(noise: NoiseModel, difference: Array, shared_variance: float) -> Array:
    """Return measured less predicted (C, b) without the errors common to all poses.

    Those are estimated in rows that are whitened by the noise of their cell, and rotated among the
    cells of a pose (`NoiseModel.noise_whitened`). Then rotation and whitening are undone.

    Args:
        difference: (C, b) predicted minus measured.
        shared_variance: of the errors that the cells of a pose share.
    """
    rows = -noise.noise_whitened(difference[:, :, None])
    net = rows - noise.common @ noise.common_amounts(rows, shared_variance)
    whitened = (noise.shared.rotation.T @ net).reshape(*difference.shape, 1)
    return np.asarray(np.linalg.solve(noise.whitener, whitened)[:, :, 0])
