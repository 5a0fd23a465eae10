"""The band of a joint's error, found from the data by marginal likelihood.

Sizes of waves are Gaussian a priori, with a standard deviation by a few numbers: levels below and
in a band, its ends, its decay, a floor. With all waves and the model's own parameters integrated
out, the data say which of these numbers are likely (type II maximum likelihood, empirical Bayes;
MacKay 1992, Neural Computation 4, 415). Products of the rows are all it takes, once; a step costs
one factorisation, and gives the gradient with it.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from scipy.linalg import block_diag, lapack

from pa10cal.arrays import Array
from pa10cal.terms.effects.sensor_error import TYPICAL
from pa10cal.terms.effects.spectrum import Band

#: Standard deviation, in logarithms, by which the numbers of a band may differ from typical
#: ones, and by which those of a joint may differ from the arm's.
_ANYWHERE = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 1.0])
_OF_A_JOINT = np.array([0.5, 0.4, 0.3, 0.2, 0.15, 0.2, 0.6])
#: Numbers of a band.
_NUMBERS = len(_ANYWHERE)
_MOST_STEPS = 40
#: Longest step of a logarithm, and the least damping after one that led downhill.
_LONGEST = 1.0
_LEAST_DAMPING = 0.1
#: Gain of twice the log-likelihood below which the climb ends.
_SETTLED = 0.1
_DIFFERENCE = 1e-4


@dataclass(frozen=True, eq=False)
class Waves:
    """Products of weighed rows in columns whose sizes are known, then waves of one map a joint."""

    # gram, projection and squares: (N, N), (N,) and a number: of columns with each other, of
    # columns with the data, of the data with themselves
    gram: Array
    projection: Array
    squares: float
    rows: int  # how many rows there were
    known: int  # columns before the waves; each in its size
    orders: Array  # (M,) cycles a turn of the waves, the same for every map

    @property
    def maps(self) -> int:
        """Return how many maps there are."""
        return (len(self.projection) - self.known) // len(self.orders)


@dataclass(frozen=True, eq=False)
class Bands:
    """The most likely bands."""

    bands: tuple[Band, ...]  # one a map; all the same where the data ask for no more
    log_std: Array  # (maps, k) standard uncertainty of the logarithms of the numbers of each
    scatter: float  # of the rows, in their stated unit
    shared: bool  # whether all maps have one band
    nats: float  # log-likelihood at the maximum, up to a constant


def most_likely(waves: Waves) -> Bands:
    """Return the bands under which the data are most likely, one for all maps or one for each."""
    together = _climb(_Cost(waves, own=False), np.append(_logs(TYPICAL), 0.0))
    if waves.maps == 1:
        return _bands(waves, together)
    at = together.at
    start = np.concatenate([at[:_NUMBERS], np.zeros(_NUMBERS * waves.maps), at[_NUMBERS:]])
    apart = _climb(_Cost(waves, own=True), start)
    return _bands(waves, min(together, apart, key=_minus_twice_log_evidence))


def minus_twice_log_likelihood(
    waves: Waves, log_sizes: Array, log_scatter: float
) -> tuple[float, Array, float, Array]:
    """Return minus twice the marginal log-likelihood, and its derivatives.

    Args:
        waves: products.
        log_sizes: (maps M,) logarithms of the standard deviations of all waves.
        log_scatter: logarithm of the scatter of the rows.

    Returns:
        The value; the derivative by each of `log_sizes`; that by `log_scatter`; the second
        derivative (maps M, maps M) by `log_sizes` to be expected.
    """
    sizes = np.concatenate([np.ones(waves.known), np.exp(log_sizes)])
    precision = float(np.exp(-2.0 * log_scatter))
    gram = waves.gram * sizes[:, None]
    gram *= sizes * precision
    projection, data = waves.projection * (sizes * precision), waves.squares * precision
    normal = gram.copy(order="F")
    normal[np.diag_indices_from(normal)] += 1.0
    root, failed = lapack.dpotrf(normal, lower=1, overwrite_a=1)
    assert not failed, "products plus one have no negative direction"
    x, _ = lapack.dpotrs(root, projection, lower=1)
    volume = 2.0 * float(np.log(np.diag(root)).sum())
    inverse, _ = lapack.dpotri(root, lower=1, overwrite_c=1)
    variance = np.diag(inverse)
    value = 2.0 * waves.rows * log_scatter + data - float(projection @ x) + volume
    left = data - 2.0 * float(projection @ x) + float(x @ gram @ x)
    determined = len(x) - float(variance.sum())
    of_waves = slice(waves.known, None)
    told = -np.tril(inverse[of_waves, of_waves])
    told += np.tril(told, -1).T
    told[np.diag_indices_from(told)] += 1.0
    by_sizes = 2.0 * (1.0 - variance - x**2)[of_waves]
    return value, by_sizes, 2.0 * (waves.rows - left - determined), 4.0 * told**2


@dataclass(frozen=True, eq=False)
class _Point:
    """A point of the climb: logarithms of the numbers, what joints have of their own, scatter."""

    at: Array  # (k + own k + 1,) the point; what joints have of their own in `_OF_A_JOINT`
    value: float  # minus twice the log-likelihood, with what is expected of the numbers
    gradient: Array  # its derivative
    curvature: Array  # its second derivative, as is to be expected
    logs: tuple[Array, ...]  # the logarithms of every map


class _Cost:
    """The cost of points: data, and what is expected of the numbers as if it had been seen."""

    def __init__(self, waves: Waves, *, own: bool) -> None:
        self._waves, self._own = waves, waves.maps if own else 0
        self._typical = _logs(TYPICAL)
        # How the logarithms of every map follow the point, but for the scatter.
        shared = np.tile(np.eye(_NUMBERS), (waves.maps, 1))
        of_own = np.kron(np.eye(self._own), np.diag(_OF_A_JOINT))
        self._by_point = np.asarray(np.hstack([shared, of_own]) if own else shared)

    def __call__(self, at: Array) -> _Point:
        """Return the cost at a point."""
        waves = self._waves
        logs = tuple((self._by_point @ at[:-1]).reshape(-1, _NUMBERS))
        value, by_sizes, by_scatter, curvature = minus_twice_log_likelihood(
            waves,
            np.concatenate([_log_sizes(each, waves.orders) for each in logs]),
            float(at[-1]),
        )
        slopes = block_diag(*(_slopes(each, waves.orders) for each in logs)) @ self._by_point
        off = np.append((at[:_NUMBERS] - self._typical) / _ANYWHERE, at[_NUMBERS:-1])
        expected = np.append(1.0 / _ANYWHERE, np.ones(len(at) - 1 - _NUMBERS))
        return _Point(
            at,
            value + float(off @ off),
            np.append(slopes.T @ by_sizes + 2.0 * expected * off, by_scatter),
            self._curvature(slopes.T @ curvature @ slopes + np.diag(2.0 * expected**2)),
            logs,
        )

    def _curvature(self, of_numbers: Array) -> Array:
        """Return the curvature by the numbers, then by the logarithm of the scatter."""
        found = np.diag(np.full(len(of_numbers) + 1, 4.0 * self._waves.rows))
        found[:-1, :-1] = of_numbers
        return found


def _climb(cost: _Cost, start: Array) -> _Point:
    """Return the most likely point from a start, by steps of the expected curvature (Fisher)."""
    here, damping = cost(start), 0.0
    for _ in range(_MOST_STEPS):
        damped = here.curvature + damping * np.diag(np.diag(here.curvature))
        step = -np.linalg.solve(damped, here.gradient)
        step *= min(1.0, _LONGEST / float(np.abs(step).max()))
        ahead = cost(here.at + step)
        if ahead.value > here.value:
            damping = max(10.0 * damping, _LEAST_DAMPING)
            continue
        gained, here, damping = here.value - ahead.value, ahead, 0.1 * damping
        if gained < _SETTLED:
            break
    return here


def _minus_twice_log_evidence(point: _Point) -> float:
    """Return minus twice the log evidence with the numbers integrated out, up to a constant.

    By Laplace's approximation: numbers that the data fix far more sharply than was expected of them
    cost what they were free to be.
    """
    _, volume = np.linalg.slogdet(0.5 * point.curvature[:-1, :-1])
    return point.value + float(volume)


def _bands(waves: Waves, point: _Point) -> Bands:
    """Return the bands at a point, as uncertain as the expected curvature says."""
    own = len(point.at) > 1 + _NUMBERS
    covariance = 2.0 * np.linalg.inv(point.curvature[:-1, :-1])
    by_point = np.hstack([np.eye(_NUMBERS), np.zeros((_NUMBERS, len(covariance) - _NUMBERS))])
    log_std = []
    for k in range(waves.maps):
        of_map = by_point.copy()
        if own:
            of_map[:, _NUMBERS * (k + 1) : _NUMBERS * (k + 2)] = np.diag(_OF_A_JOINT)
        log_std.append(np.sqrt(np.diag(of_map @ covariance @ of_map.T)))
    return Bands(
        bands=tuple(_band(each) for each in point.logs),
        log_std=np.array(log_std),
        scatter=float(np.exp(point.at[-1])),
        shared=not own,
        nats=-0.5 * point.value,
    )


def _logs(band: Band) -> Array:
    """Return the logarithms of the numbers of a band."""
    return np.asarray(np.log(np.array(astuple(band))))


def _band(logs: Array) -> Band:
    """Return the band of logarithms."""
    return Band(*(float(each) for each in np.exp(logs)))


def _log_sizes(logs: Array, orders: Array) -> Array:
    """Return the logarithms of the sizes (M,) of waves."""
    return np.asarray(np.log(_band(logs).sizes_rad(orders)))


def _slopes(logs: Array, orders: Array) -> Array:
    """Return how the logarithms of sizes follow those of the numbers, (M, k)."""
    steps = _DIFFERENCE * np.eye(_NUMBERS)
    ahead = [_log_sizes(logs + step, orders) - _log_sizes(logs - step, orders) for step in steps]
    return np.stack(ahead, axis=1) / (2.0 * _DIFFERENCE)
