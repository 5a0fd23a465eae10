"""Errors of rows that follow each other in time and are alike, and what they do to a fit.

A part c of the variance lasts: errors l rows apart have the correlation c rho^l (a first-order
autoregressive process and white noise). Share and duration maximise Whittle's likelihood (P.
Whittle, J. R. Stat. Soc. B 15, 1953) of the cosine transform of the residuals, but for its constant
term: a fit takes that up. That it is no chance is shown by rows in other orders.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import dct

from pa10cal.arrays import Array
from pa10cal.calibration.rules import ALIKE
from pa10cal.results.number_text import plain_number


@dataclass(frozen=True)
class SerialCorrelation:
    """How alike errors of rows are that follow each other in time."""

    share: float  # c, the part of the variance that lasts
    rows: float  # in which its correlation falls to 1/e

    def __str__(self) -> str:
        return (
            "errors of poses that follow each other are alike, as where air, temperature or the "
            f"base change slowly: of the base {plain_number(self.rows_for_one, 2)} poses tell as "
            "much as one would by itself; stated uncertainties hold it"
        )

    @property
    def rho(self) -> float:
        """Return the correlation of what lasts from one row to the next."""
        return float(np.exp(-1.0 / self.rows))

    @property
    def rows_for_one(self) -> float:
        """Return how many rows tell as much of a constant as one whose error is its own."""
        return 1.0 + 2.0 * self.share * self.rho / (1.0 - self.rho)

    def beside_independent(self, rows: Array) -> Array:
        """Return what correlations add to the normal equations as the covariance of a gradient.

        Args:
            rows: (P, b, k) whitened rows in order of time.

        Returns:
            (k, k) the sum over all pairs of rows that differ of their product times correlation.
        """
        pairs, later = np.zeros((rows.shape[2],) * 2), np.zeros_like(rows[0])
        for row, after in zip(rows[-2::-1], rows[:0:-1], strict=True):
            later = self.rho * (after + later)
            pairs += row.T @ later
        return self.share * (pairs + pairs.T)


def serial_correlation(white: Array) -> SerialCorrelation | None:
    """Return how alike whitened residuals (P, b) in order of time are; None where chance may be it.

    Components of a row may depend on each other; a row of zeros tells nothing.
    """
    if len(white) < ALIKE.least_rows or not white.any():
        return None
    durations = np.geomspace(*ALIKE.poses, ALIKE.tried)
    durations = durations[durations < len(white) // 2]
    shares = np.linspace(0.0, 1.0, ALIKE.tried + 1)[1:]
    frequency = np.pi * np.arange(1, len(white)) / len(white)
    rho = np.exp(-1.0 / durations)[:, None]
    lasting = (1.0 - rho**2) / (1.0 + rho**2 - 2.0 * rho * np.cos(frequency))
    spectra = 1.0 + shares[:, None, None] * (lasting - 1.0)
    spectra = spectra.reshape(-1, len(frequency))
    gained = _gained(spectra, white)
    best = int(np.argmax(gained))
    if gained[best] < -np.log(ALIKE.error_rate):
        return None
    rng = np.random.default_rng(0)
    for _ in range(ALIKE.orders):
        if _gained(spectra, white[rng.permutation(len(white))]).max() >= gained[best]:
            return None
    share, duration = np.unravel_index(best, (len(shares), len(durations)))
    return SerialCorrelation(float(shares[share]), float(durations[duration]))


def _gained(spectra: Array, white: Array) -> Array:
    """Return the log likelihood (G,) that spectra (G, P - 1) of rows (P, b) gain over an even one.

    The variance is profiled.
    """
    power = np.sum(dct(white, axis=0, norm="ortho")[1:] ** 2, axis=1)
    dof, terms = white.shape[1], len(power)
    level = (power / spectra).mean(axis=1) / power.mean()
    return np.asarray(-0.5 * dof * (np.log(spectra).sum(axis=1) + terms * np.log(level)))
