"""Whether the readings show that parallel axes are tilted.

Hayati's parameters take up a tilt across the common normal. Where axes are as parallel as they were
designed, within the uncertainty of the readings, these parameters only spread the noise: zero
then predicts better. Schwarz's criterion (1978) decides, over all of them together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.calibration.general.fit import Fit
from pa10cal.fit.problem import Problem
from pa10cal.terms.term import Parameter

_TILT = "delta_beta_"


@dataclass(frozen=True)
class Settled:
    """A parameter left at zero because the readings do not show it."""

    parameter: Parameter  # which
    std: float  # its standard uncertainty, had it been fitted


def tilts_not_shown(problem: Problem, fit: Fit) -> tuple[Settled, ...]:
    """Return the tilts of parallel axes that the readings do not show; none where they do."""
    names = [parameter.name for parameter in problem.parameters]
    at = np.array([k for k, name in enumerate(names) if name.startswith(_TILT)], dtype=np.intp)
    covariance = fit.covariance[np.ix_(at, at)]
    std = np.sqrt(np.diag(covariance))
    if not len(at) or not np.all(std > 0.0):
        return ()
    tilts = fit.x[at]
    gain = float(tilts @ np.linalg.solve(covariance, tilts))
    if gain > len(at) * np.log(problem.readings):
        return ()
    return tuple(
        Settled(problem.parameters[k], float(sigma)) for k, sigma in zip(at, std, strict=True)
    )
