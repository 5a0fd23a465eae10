"""Mean and spread of the position error: from the sums of the draws, and in closed form.

The closed form is of first order in the joint errors. A small joint error δ ~ N(0, σ² I) moves the
flange by J δ, a normal vector of covariance σ² J Jᵀ. The mean length of a normal vector is an
elliptic integral of the eigenvalues λ of its covariance: its length and its direction after scaling
to the unit sphere are independent, so

    E|J δ| = E|χ₃| · mean over the sphere of √(λ₁n₁² + λ₂n₂² + λ₃n₃²) = √(8/π) R_G(λ₁, λ₂, λ₃),

with Carlson's completely symmetric integral R_G (DLMF 19.16.3). Vanishing eigenvalues are allowed:
one gives the planar case, two the half-normal one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import elliprg

from pa10cal.arrays import Array
from pa10cal.montecarlo.sampling import ErrorSums

_NORMAL_95 = 1.959963984540054
_MEAN_OF_CHI_3 = np.sqrt(8.0 / np.pi)


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of the drawn errors at P places."""

    place_mean_m: Array  # (P,) mean at each place
    place_std_m: Array  # (P,) standard deviation at each place
    mean_m: float  # mean of all draws
    std_within_m: float  # spread within a place: root mean square of `place_std_m`
    std_between_m: float  # standard deviation of `place_mean_m`
    std_total_m: float  # standard deviation of all draws
    # half the 95 % interval of `mean_m` over these places: what more cycles would narrow
    half_width_m: float
    # half the 95 % interval of `mean_m` over all places of the plane: what more places would
    # narrow
    places_half_width_m: float


@dataclass(frozen=True)
class Convergence:
    """Mean of all places after the first cycles at each."""

    cycles: NDArray[np.int64]  # (C,) cycles at each place
    mean_m: Array  # (C,) running mean
    half_width_m: Array  # (C,) half its 95 % interval over these places


@dataclass(frozen=True)
class ExpectedError:
    """Expected length of the flange's displacement at P positions."""

    mean_m: Array  # (P,) mean
    std_m: Array  # (P,) standard deviation


def counts_of(cycles: int, most: int = 20, first: int = 10) -> NDArray[np.int64]:
    """Return at most `most` counts of cycles, evenly spread by ratio, that end with all of them."""
    return np.unique(np.round(np.geomspace(min(first, cycles), cycles, most)).astype(np.int64))


def summarise(sums: ErrorSums) -> ErrorStatistics:
    """Return the statistics of all cycles."""
    mean, variance = _moments(sums)
    mean, variance = mean[:, -1], variance[:, -1]
    places, cycles = len(mean), int(sums.cycles[-1])
    between = float(np.std(mean, ddof=1))
    total = np.mean(sums.squared_m2[:, -1]) / cycles - np.mean(mean) ** 2
    return ErrorStatistics(
        place_mean_m=mean,
        place_std_m=np.sqrt(variance),
        mean_m=float(np.mean(mean)),
        std_within_m=float(np.sqrt(np.mean(variance))),
        std_between_m=between,
        std_total_m=float(np.sqrt(total)),
        half_width_m=float(_half_width(variance[:, None], sums.cycles[-1:])[0]),
        places_half_width_m=_NORMAL_95 * between / float(np.sqrt(places)),
    )


def convergence(sums: ErrorSums) -> Convergence:
    """Return how the mean settled."""
    mean, variance = _moments(sums)
    return Convergence(sums.cycles, mean.mean(axis=0), _half_width(variance, sums.cycles))


def _moments(sums: ErrorSums) -> tuple[Array, Array]:
    """Return mean and unbiased variance (P, C) of the first cycles at each place."""
    mean = sums.error_m / sums.cycles
    return mean, np.maximum(sums.squared_m2 - sums.error_m * mean, 0.0) / (sums.cycles - 1)


def _half_width(variance: Array, cycles: NDArray[np.int64]) -> Array:
    """Return half the 95 % interval (C,) of the mean of all places."""
    variance_of_sum: Array = (variance / cycles).sum(axis=0)
    return _NORMAL_95 * np.sqrt(variance_of_sum) / len(variance)


def expected_error(jacobian: Array, sigma_rad: float) -> ExpectedError:
    """Return the expected position error of joints with independent errors of `sigma_rad`.

    Args:
        jacobian: (P, 3, n) velocity of the flange by each joint [m/rad].
        sigma_rad: standard deviation of every joint.
    """
    squares = sigma_rad**2 * (jacobian @ jacobian.transpose(0, 2, 1))
    # Rounding leaves an eigenvalue that should vanish a little below zero.
    eigenvalues = np.maximum(np.linalg.eigvalsh(squares), 0.0)
    mean_m = _MEAN_OF_CHI_3 * elliprg(*eigenvalues.T)
    variance = np.maximum(eigenvalues.sum(axis=1) - mean_m**2, 0.0)
    return ExpectedError(mean_m=mean_m, std_m=np.sqrt(variance))
