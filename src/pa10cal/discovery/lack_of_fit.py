"""Where model and data disagree: the remaining error against noise, and where it sits.

Everything is computed for cells: averaged readings of a pose, or single poses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from pa10cal.arrays import Array
from pa10cal.discovery import jacobians
from pa10cal.discovery.tuning import COMPUTING, PLACES
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import (
    position_error_mm,
    position_errors_along_axes,
    position_noise_m2,
)
from pa10cal.numerics.covariances import whitener_of
from pa10cal.numerics.least_squares import cluster_covariance
from pa10cal.observe.observations import Observations
from pa10cal.results import analysis as records
from pa10cal.results.evaluation import Estimate

# Weighted means and slopes whose uncertainty counts poses, not rows.
#
# Rows of a pose share its errors, so the scatter from pose to pose decides.


def mean(values: Array, weight: Array, pose: NDArray[np.str_]) -> Estimate:
    """Return the weighted mean of (C,) values of cells at (C,) poses."""
    return _last_coefficient(np.ones((len(values), 1)), values, weight, pose)


def drift(by: Array, values: Array, weight: Array, pose: NDArray[np.str_]) -> Estimate | None:
    """Return the change of values (C,) over the range of another quantity (C,), by a line.

    None where that quantity is constant to rounding, or not known.
    """
    if not np.ptp(by) > COMPUTING.same_share * np.abs(by).max():
        return None
    columns = np.column_stack([np.ones(len(by)), (by - by.mean()) / np.ptp(by)])
    return _last_coefficient(columns, values, weight, pose)


def _last_coefficient(
    columns: Array, values: Array, weight: Array, pose: NDArray[np.str_]
) -> Estimate:
    weighted = columns * weight[:, None]
    inverse = np.asarray(np.linalg.inv(columns.T @ weighted), dtype=float)
    found = inverse @ (weighted.T @ values)
    labels, cluster = np.unique(pose, return_inverse=True)
    scores: Array = weighted * (values - columns @ found)[:, None]
    std = float(np.sqrt(cluster_covariance(inverse, scores, cluster)[-1, -1]))
    known = len(labels) > 1 and np.isfinite(std)
    return Estimate(value=float(found[-1]), std=std if known else None)


# Residuals of the model as errors of joint angles, and how they depend on each joint's angle.
#
# This shows where to look and is no test: the angles of one cell follow from six numbers, so an
# error that no joint causes appears in several of them.


def joint_errors(jacobian: Array, white_residual: Array) -> tuple[Array, Array]:
    """Return errors of the joints by least squares, (C, n) [rad, m], and their standard deviations.

    An error is the true position less that of the model. Residuals (C, b, 1), measured less
    predicted, and their Jacobian by the joints (C, b, n) are whitened by the noise of each cell.
    """
    across = jacobian.transpose(0, 2, 1)
    covariance = np.linalg.inv(
        across @ jacobian + np.eye(jacobian.shape[2]) / PLACES.possible_rad**2
    )
    std_rad: Array = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return (covariance @ (across @ white_residual))[:, :, 0], std_rad


def periodogram(
    q_rad: Array, error_rad: Array, weight: Array, gear_ratio: float
) -> records.Periodogram | None:
    """Return the periodogram of one joint's error by its angle, None where it hardly turned.

    It is the generalised one of Lomb and Scargle, with a free constant: for each order the root
    mean square that a sinusoid explains, not its amplitude. Marked are the orders of usual errors:
    once and twice a turn of the joint, and of the motor if its gear ratio is known (not nan).
    Angles, errors and weights are those of the cells, (C,).
    """
    turns = float(np.ptp(q_rad)) / (2.0 * np.pi)
    known = (gear_ratio, 2.0 * gear_ratio) if np.isfinite(gear_ratio) else ()
    highest = PLACES.most_ratios * max(gear_ratio if known else PLACES.usual_ratio, 1.0)
    # An arc that is a small part of the finest cycle contains no information on any cycle.
    if turns * highest < 1.0:
        return None
    step = min(PLACES.largest_step, 1.0 / (PLACES.steps_a_peak * turns))
    orders = np.arange(PLACES.least_order, highest + step, step)
    marked = tuple(sorted({1.0, 2.0, *map(float, known)}))
    share = weight / weight.sum()
    centred = error_rad - share @ error_rad
    variance = float(share @ centred**2)
    every = np.concatenate([orders, marked])
    explained_rad = np.zeros(len(every))
    if variance != 0.0:
        explained_rad = np.sqrt(_explained_variance(q_rad, centred, share, every).clip(0, variance))
    return records.Periodogram(
        orders=rounded(orders),
        explained_rad=rounded(explained_rad[: len(orders)]),
        marked=np.array(marked),
        marked_rad=rounded(explained_rad[len(orders) :]),
    )


def _explained_variance(q_rad: Array, centred: Array, share: Array, orders: Array) -> Array:
    """Return the variance that a sinusoid of each order (O,) explains beside a constant.

    As `scipy.signal.lombscargle`, whose import takes longer than all periodograms of a campaign.
    """
    phase = np.outer(orders, q_rad)
    cos, sin = np.cos(phase), np.sin(phase)
    C, S = cos @ share, sin @ share
    CC, CS = cos**2 @ share - C**2, (cos * sin) @ share - C * S
    normal = np.array([[CC, CS], [CS, 1.0 - CC - C**2 - S**2]]).transpose(2, 0, 1)
    across = np.stack([cos @ (share * centred), sin @ (share * centred)], axis=1)
    inverse = np.linalg.pinv(normal, hermitian=True)
    return np.asarray(np.einsum("oi,oij,oj->o", across, inverse, across))


AXES = ("x", "y", "z")


def pure_error_test(chi_square: float, dof: float, pure_dof: int) -> records.PureErrorTest:
    """Return Fisher's F of a remaining error, which is near one for a complete model.

    Args:
        chi_square: sum of squares in units of the variance of the pure error.
        dof: its degrees of freedom.
        pure_dof: degrees of freedom of the pure error, from repeats.
    """
    F, pure = chi_square / dof, float(pure_dof)
    p_value = float(fdtrc(dof, pure, F))
    return records.PureErrorTest(
        chi_square=chi_square, dof=dof, pure_error_dof=pure, F=F, p_value=p_value
    )


@dataclass(frozen=True)
class CellResiduals:
    """Residuals of C cells about a model."""

    at: FittedModel  # the model
    cells: Observations  # the cells, complete
    components: Array  # (C, b) measured minus predicted [m, rad]
    cov: Array  # (C, b, b) covariance of the cells' noise
    screws: Array  # (C, b, n) Jacobian of the components by the joints
    torque_Nm: Array | None = None  # (C, n) logged minus predicted; None where not known
    torque_noise_Nm: Array | None = None  # (n,) standard deviation of one reading

    @classmethod
    def about(cls, at: FittedModel, poses: Observations, cov: Array) -> CellResiduals:
        """Return the residuals of complete poses, whose components have a covariance (P, b, b)."""
        joints = range(1, poses.states.n + 1)
        return cls(
            at, poses, -at.compared(poses).residual, cov, jacobians.by_joints(at, poses, joints)
        )


def lack_of_fit(
    residuals: CellResiduals, pure_error: records.PureErrorTest | None = None
) -> records.LackOfFit:
    """Return where a model and the data disagree.

    `pure_error` is the test of the errors that readings of a pose share; None without repeats.
    """
    cells, states, cov = residuals.cells, residuals.cells.states, residuals.cov
    squares = position_error_mm(cells.measured, residuals.components) ** 2
    noise = 1e6 * np.trace(position_noise_m2(cells.measured, cov), axis1=1, axis2=2)
    found_m, found_m2 = position_errors_along_axes(residuals.at, cells, residuals.components, cov)
    position_mm, noise_mm2 = 1e3 * found_m, 1e6 * found_m2
    weight = cells.readings.astype(float)
    return records.LackOfFit(
        pure_error=pure_error,
        by_load=tuple(
            _part(f"{load:g} N", squares[states.load_N == load], noise[states.load_N == load])
            for load in dict.fromkeys(states.load_N.tolist())
        ),
        by_axis=tuple(map(_part, AXES, position_mm.T**2, noise_mm2.T)),
        by_joint=tuple(_by_joint(residuals)),
        drifts=tuple(
            records.Drift(
                axis=axis,
                with_time_mm=drift(states.time_s, of_axis, weight, cells.pose),
                with_temperature_mm=drift(states.temperature_C, of_axis, weight, cells.pose),
            )
            for axis, of_axis in zip(AXES, position_mm.T, strict=True)
        ),
    )


def _part(of: str, squares: Array, noise: Array) -> records.ErrorPart:
    return records.ErrorPart(of=of, rms_mm=_root_mean(squares), floor_mm=_root_mean(noise))


def _by_joint(residuals: CellResiduals) -> Iterator[records.JointPart]:
    """Yield the residuals as errors of each joint, and those of its torque."""
    last, most = len(residuals.cells) - 1, min(len(residuals.cells), PLACES.most_cells)
    shown = np.unique(np.linspace(0, last, most).round().astype(int))
    cells, arm = residuals.cells.take(shown), residuals.at.arm
    white = whitener_of(residuals.cov[shown])
    errors = joint_errors(
        white @ residuals.screws[shown], white @ residuals.components[shown, :, None]
    )
    for j, (error_rad, std_rad) in enumerate(zip(errors[0].T, errors[1].T, strict=True)):
        q_rad, arrival, weight = cells.states.q_rad[:, j], cells.states.arrival[:, j], std_rad**-2.0
        share = weight / weight.sum()
        torque_Nm = noise_Nm = None
        if residuals.torque_Nm is not None and residuals.torque_noise_Nm is not None:
            torque_Nm = rounded(residuals.torque_Nm[shown, j])
            noise_Nm = _root_mean(residuals.torque_noise_Nm[j] ** 2 / residuals.cells.readings)
        yield records.JointPart(
            joint=j + 1,
            rms_rad=float(np.sqrt(share @ error_rad**2)),
            floor_rad=float(np.sqrt(share @ std_rad**2)),
            arrivals=tuple(_by_arrival(error_rad, weight, arrival, cells.pose)),
            periodogram=None
            if arm.prismatic[j]
            else periodogram(q_rad, error_rad, weight, float(arm.gear_ratio[j])),
            q_rad=rounded(q_rad),
            arrival=rounded(arrival),
            error_rad=rounded(error_rad),
            std_rad=rounded(std_rad),
            torque_residual_Nm=torque_Nm,
            torque_noise_Nm=noise_Nm,
        )


def _by_arrival(
    error_rad: Array, weight: Array, arrival: Array, pose: NDArray[np.str_]
) -> Iterator[records.Arrival]:
    """Yield the mean error of a joint in cells (C,) reached from either side."""
    for sign in (-1, 1):
        if (rows := np.sign(arrival) == sign).any():
            of = mean(error_rad[rows], weight[rows], pose[rows])
            yield records.Arrival(direction=sign, mean_rad=of.value, std_rad=of.std)


def rounded(values: Array) -> Array:
    """Return numbers rounded to the digits that a picture shows."""
    flat = [float(f"{value:.{PLACES.digits}g}") for value in np.ravel(values).tolist()]
    return np.array(flat).reshape(np.shape(values))


def _root_mean(squares: Array) -> float:
    return float(np.sqrt(np.mean(squares)))
