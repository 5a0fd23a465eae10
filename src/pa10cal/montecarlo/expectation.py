"""Mean and spread of the position error in closed form, to first order in the joint errors.

A small joint error δ ~ N(0, σ² I) moves the flange by J δ, a normal vector of covariance
σ² J Jᵀ. The mean length of a normal vector is an elliptic integral of the eigenvalues λ of its
covariance: its length and its direction after scaling to the unit sphere are independent, so

    E|J δ| = E|χ₃| · mean over the sphere of √(λ₁n₁² + λ₂n₂² + λ₃n₃²) = √(8/π) R_G(λ₁, λ₂, λ₃),

with Carlson's completely symmetric integral R_G (DLMF 19.16.3). Vanishing eigenvalues are allowed:
one gives the planar case, two the half-normal one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import elliprg

Array = NDArray[np.float64]

_MEAN_OF_CHI_3 = np.sqrt(8.0 / np.pi)


@dataclass(frozen=True)
class ExpectedError:
    """Expected length of the flange's displacement at P positions.

    Attributes:
        mean_m: (P,) mean.
        std_m: (P,) standard deviation.
    """

    mean_m: Array
    std_m: Array


def expected_error(jacobian: Array, sigma_rad: float) -> ExpectedError:
    """Return the expected position error of joints that err independently by `sigma_rad`.

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
