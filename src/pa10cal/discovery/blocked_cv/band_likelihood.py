"""The band of a joint's error, estimated from the data by marginal likelihood.

Amplitudes of waves are Gaussian a priori. Their standard deviation by order is a few parameters:
the level of the slowest waves, levels below and in a band, its ends, its decay, a floor. With all
waves and the model's parameters integrated out, the data determine which of these are likely (type
II maximum likelihood, empirical Bayes; MacKay 1992, Neural Computation 4, 415). The normal
equations suffice; a step costs one factorisation, which gives the gradient too.

A point of the search (p,) is the logarithms of the k parameters of a band, then, if each joint has
its own, the deviations of each joint's logarithms from these in units of `_STD_OF_JOINT`, then the
logarithm of the scatter of the rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from pa10cal.arrays import Array
from pa10cal.discovery.rules import MAPS
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.terms.effects.joint_error_map import TYPICAL, BandPrior

#: Standard deviations a priori of the logarithms of a band's parameters about typical ones, and of
#: those of a joint about the arm's.
_STD_OF_BAND = np.array(MAPS.band_std)
_STD_OF_JOINT = np.array(MAPS.band_std_of_joint)
#: How many parameters a band has.
_PARAMETERS = len(_STD_OF_BAND)


@dataclass(frozen=True, eq=False)
class Waves:
    """Normal equations of whitened rows: unknowns in known sizes, then waves of each map."""

    equations: Gaussian  # of N unknowns
    rows: int  # how many rows there were
    leading: int  # columns before the waves; each in units of its size
    orders: Array  # (M,) cycles a turn of the waves, the same for every map

    @property
    def maps(self) -> int:
        """Return how many maps there are."""
        return (self.equations.unknowns - self.leading) // len(self.orders)


@dataclass(frozen=True, eq=False)
class BandEstimates:
    """The most likely bands."""

    bands: tuple[BandPrior, ...]  # of each map; all equal where `shared`
    log_std: Array  # (maps, k) standard uncertainty of the logarithms of each band's parameters
    scatter: float  # standard deviation of the rows, in units of that stated
    shared: bool  # whether one band for all maps is likelier than one for each
    # whether the search arrived at its most likely point; else `log_std` holds only near that point
    settled: bool


class LogLikelihood(NamedTuple):
    """Minus twice the marginal log-likelihood, and its derivatives.

    By the logarithms of the standard deviations of all waves (maps M,), and by that of the scatter
    of the rows.
    """

    value: float
    by_sizes: Array  # (maps M,)
    by_scatter: float
    curvature: Array  # (maps M, maps M) expected second derivative by the sizes


def most_likely(waves: Waves) -> BandEstimates:
    """Return the bands under which the data are most likely, one for all maps or one for each.

    One for all where a search has not settled, as the evidence is known at likeliest points alone.
    The uncertainties are by the expected curvature (Laplace's approximation).
    """
    start = np.append(_logs(TYPICAL), 0.0)
    together, together_settled = _most_likely_from(_Cost(waves, each_its_own=False), start)
    if waves.maps == 1:
        return _bands(together, together_settled)
    shared, log_scatter = together.point[:_PARAMETERS], together.point[_PARAMETERS:]
    start = np.concatenate([shared, np.zeros(_PARAMETERS * waves.maps), log_scatter])
    apart, apart_settled = _most_likely_from(_Cost(waves, each_its_own=True), start)
    if not (together_settled and apart_settled):
        return _bands(together, together_settled)
    return _bands(min(together, apart, key=_minus_twice_log_evidence), True)


def minus_twice_log_likelihood(waves: Waves, log_sizes: Array, log_scatter: float) -> LogLikelihood:
    """Return minus twice the marginal log-likelihood at standard deviations of waves and rows."""
    sizes = np.concatenate([np.ones(waves.leading), np.exp(log_sizes)])
    equations = waves.equations.times(float(np.exp(-2.0 * log_scatter))).in_sizes(sizes)
    x, covariance = equations.mean, equations.covariance
    variance = np.diag(covariance)
    residual = equations.squares_at(x)
    determined = len(x) - float(variance.sum())
    of_waves = slice(waves.leading, None)
    # I - (A'A + I)^-1 = A' S^-1 A, with S = A A' + I the covariance of the rows, waves included.
    information = np.eye(len(log_sizes)) - covariance[of_waves, of_waves]
    return LogLikelihood(
        value=2.0 * (waves.rows * log_scatter - equations.log_evidence),
        by_sizes=2.0 * (1.0 - variance - x**2)[of_waves],
        by_scatter=2.0 * (waves.rows - residual - determined),
        curvature=4.0 * information**2,
    )


@dataclass(frozen=True, eq=False)
class _Point:
    """The cost at a point of the search."""

    point: Array  # (p,)
    value: float  # minus twice the log-likelihood and the log prior
    gradient: Array  # (p,)
    curvature: Array  # (p, p) expected second derivative
    logs_by_point: Array  # (maps k, p - 1) takes a point, without the scatter, to `logs`

    @property
    def logs(self) -> Array:
        """Return the logarithms of each map's parameters, (maps, k)."""
        return np.asarray((self.logs_by_point @ self.point[:-1]).reshape(-1, _PARAMETERS))

    @property
    def predicted_gain(self) -> float:
        """Return by how much an undamped step would lower the value, by gradient and curvature."""
        return 0.5 * float(self.gradient @ np.linalg.solve(self.curvature, self.gradient))


class _Cost:
    """Minus twice the log-likelihood of the data and the log prior of a band's parameters."""

    def __init__(self, waves: Waves, *, each_its_own: bool) -> None:
        self._waves, self._typical = waves, _logs(TYPICAL)
        logs_by_point = np.tile(np.eye(_PARAMETERS), (waves.maps, 1))
        if each_its_own:
            by_own = np.kron(np.eye(waves.maps), np.diag(_STD_OF_JOINT))
            logs_by_point = np.hstack([logs_by_point, by_own])
        self._logs_by_point = logs_by_point

    def __call__(self, point: Array) -> _Point:
        """Return the cost at a point."""
        waves, orders = self._waves, self._waves.orders
        logs = (self._logs_by_point @ point[:-1]).reshape(-1, _PARAMETERS)
        log_sizes = np.concatenate([_log_sizes(each, orders) for each in logs])
        likelihood = minus_twice_log_likelihood(waves, log_sizes, float(point[-1]))
        slopes = block_diag(*(_slopes(each, orders) for each in logs)) @ self._logs_by_point
        off = np.append((point[:_PARAMETERS] - self._typical) / _STD_OF_BAND, point[_PARAMETERS:-1])
        off_by_point = np.append(1.0 / _STD_OF_BAND, np.ones(len(point) - 1 - _PARAMETERS))
        of_prior = np.diag(2.0 * off_by_point**2)  # curvature of the squares of `off`
        by_logs = slopes.T @ likelihood.curvature @ slopes + of_prior
        gradient = slopes.T @ likelihood.by_sizes + 2.0 * off_by_point * off
        return _Point(
            point=point,
            value=likelihood.value + float(off @ off),
            gradient=np.append(gradient, likelihood.by_scatter),
            curvature=block_diag(by_logs, np.full((1, 1), 4.0 * waves.rows)),
            logs_by_point=self._logs_by_point,
        )


def _most_likely_from(cost: Callable[[Array], _Point], start: Array) -> tuple[_Point, bool]:
    """Return the most likely point from a start, by damped steps of Fisher scoring.

    And whether the steps settled there: neither the last one nor the next one gains much. A damped
    step may gain little far from the most likely point.
    """
    here, damping = cost(start), 0.0
    for _ in range(COMPUTING.band_steps):
        damped = here.curvature + damping * np.diag(np.diag(here.curvature))
        step = -np.linalg.solve(damped, here.gradient)
        longest = float(np.abs(step).max())
        if longest > COMPUTING.band_longest:
            step *= COMPUTING.band_longest / longest
        ahead = cost(here.point + step)
        if ahead.value > here.value:
            damping = max(COMPUTING.damping_up * damping, COMPUTING.band_damping)
            continue
        gained, here = here.value - ahead.value, ahead
        damping *= COMPUTING.damping_down
        if gained < COMPUTING.band_settled and here.predicted_gain < COMPUTING.band_settled:
            return here, True
    return here, here.predicted_gain < COMPUTING.band_settled


def _minus_twice_log_evidence(point: _Point) -> float:
    """Return minus twice the log evidence, parameters integrated out (Laplace's approximation)."""
    _, log_det = np.linalg.slogdet(0.5 * point.curvature[:-1, :-1])
    return point.value + float(log_det)


def _bands(at: _Point, settled: bool) -> BandEstimates:
    """Return the bands at a point, with uncertainties by the expected curvature."""
    covariance = 2.0 * np.linalg.inv(at.curvature[:-1, :-1])
    variances = np.diag(at.logs_by_point @ covariance @ at.logs_by_point.T)
    return BandEstimates(
        bands=tuple(map(_band, at.logs)),
        log_std=np.sqrt(variances).reshape(-1, _PARAMETERS),
        scatter=float(np.exp(at.point[-1])),
        shared=len(at.point) == 1 + _PARAMETERS,
        settled=settled,
    )


def _logs(band: BandPrior) -> Array:
    """Return the logarithms of the parameters of a band."""
    return np.asarray(np.log(np.array(astuple(band))))


def _band(logs: Array) -> BandPrior:
    """Return the band whose parameters have these logarithms."""
    return BandPrior(*(float(each) for each in np.exp(logs)))


def _log_sizes(logs: Array, orders: Array) -> Array:
    """Return the logarithms of the standard deviations (M,) of waves."""
    return np.asarray(np.log(_band(logs).sizes_rad(orders)))


def _slopes(logs: Array, orders: Array) -> Array:
    """Return the derivative of `_log_sizes` by the logarithms of the parameters, (M, k)."""
    steps = COMPUTING.band_difference * np.eye(_PARAMETERS)
    differences = [
        _log_sizes(logs + step, orders) - _log_sizes(logs - step, orders) for step in steps
    ]
    return np.stack(differences, axis=1) / (2.0 * COMPUTING.band_difference)
