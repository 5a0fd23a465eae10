"""Errors of logged torques: usual ones, scatter about weights, and those that are taken out."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pa10cal.arm.description import Arm, weights_known
from pa10cal.arrays import MEDIAN_TO_SIGMA, Array
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.observations import Observations
from pa10cal.rules import MASSES


class ErrorsShown(NamedTuple):
    """Zeros and friction that logged torques show."""

    zero_Nm: Array = np.zeros(0)  # (n,), 0 where not shown; empty where no joint shows one
    friction_Nm: Array = np.zeros(0)  # the same, by the direction of arrival
    u_friction_Nm: Array = np.zeros(0)  # its standard uncertainty
    said: str = ""  # the large ones, and what to do; empty for none


def without_torque_errors(every: Observations, arm: Arm) -> Observations:
    """Return readings without the zeros and friction that the weighed arm has of their torques.

    A fit takes the zero of a torque, through a spring, as one of the joint, and friction of a motor
    as lost motion. Predictions calculate torques from the weights, which have neither.
    """
    by_log = weights_known(arm).by_log
    if by_log is None or not (by_log.zero_Nm.any() or by_log.friction_Nm.any()):
        return every
    tau_Nm = every.states.tau_Nm
    if len(by_log.zero_Nm):
        tau_Nm = tau_Nm - by_log.zero_Nm
    if len(by_log.friction_Nm):
        tau_Nm = tau_Nm - by_log.friction_Nm * with_arrivals(every, arm)[0].states.arrival
    return every.with_states(replace(every.states, tau_Nm=tau_Nm))


def errors_of_logs(
    torque_Nm: Array, rated_Nm: Array, arrival: Array, gain: float = MASSES.gain
) -> Array:
    """Return the usual errors of logged torques as columns of unit expected size, (P, n, 3 n).

    Scale errors, friction and zero offsets of the joints.

    Args:
        torque_Nm, arrival: (P, n) torques of the weights, and directions of arrival.
        rated_Nm: (n,) rated torques.
        gain: expected size of a scale error.
    """
    diagonal = np.eye(len(rated_Nm))
    zeros_Nm = np.broadcast_to(
        MASSES.zero_share * rated_Nm[:, None] * diagonal, (*torque_Nm.shape, len(rated_Nm))
    )
    friction_Nm = MASSES.friction_share * (rated_Nm * arrival)[:, :, None] * diagonal
    return np.concatenate([gain * torque_Nm[:, :, None] * diagonal, friction_Nm, zeros_Nm], axis=2)


def scatter_about(
    columns: Array, torque_Nm: Array, rounds: int, least_Nm: float = 0.0
) -> tuple[Array, Array]:
    """Fit torques (P, n) by columns (P, n, k), reweighted by each joint's scatter.

    Returns:
        Scatter (n,) of the residuals, at least `least_Nm`, and coefficients (k,).
    """
    noise_Nm = np.maximum(_spread(torque_Nm - np.median(torque_Nm, axis=0)), least_Nm)
    for _ in range(rounds):
        x = Gaussian.of(columns / noise_Nm[:, None], torque_Nm / noise_Nm).mean
        noise_Nm = np.maximum(_spread(torque_Nm - columns @ x), least_Nm)
    return noise_Nm, x


def _spread(residual_Nm: Array) -> Array:
    """Return the scatter (n,) of each joint's residuals (P, n), from the median of their size."""
    sigma_Nm = MEDIAN_TO_SIGMA * np.median(np.abs(residual_Nm), axis=0)
    return np.asarray(np.maximum(sigma_Nm, MASSES.least_of_largest * sigma_Nm.max()))
