"""The tolerance terms of paper equation (2): their weight, and the directions on which they act.

As printed they act on every departure and so pull identified parameters towards nominal. Their
use is to fix directions that the data do not identify; `null_space_terms` does that and no more.
"""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array
from pa10cal.fit.identifiability import Identifiability
from pa10cal.terms.term import Parameter


def all_terms(parameters: tuple[Parameter, ...], weight: float) -> Array:
    """Return rows W (r, k) such that W x are the tolerance terms on every departure.

    Args:
        parameters: the k parameters; those without a tolerance have no term.
        weight: factor on the residual, epsilon or its square root (see `residual_weight`).
    """
    rows = np.array(
        [
            0.0 if parameter.tolerance is None else weight / parameter.tolerance
            for parameter in parameters
        ]
    )
    return np.diag(rows)[rows > 0]


def null_space_terms(identifiability: Identifiability, scale: Array, weight: float) -> Array:
    """Return rows W (r, k) that act only on the r directions that the data do not identify."""
    return weight * identifiability.null_space.T / scale


def residual_weight(epsilon: float, acts_on: str) -> float:
    """Return the factor on the residuals for either reading of epsilon."""
    return epsilon if acts_on == "residual" else float(np.sqrt(epsilon))
