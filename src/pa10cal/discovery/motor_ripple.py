"""The motor's ripple: spectral lines of a joint's residual at multiples of its gear ratio.

A controller stops a joint where the motor's cogging lets it. In poses to which a joint moved, its
residual therefore has lines in the motor's angle. If the gear errs by e(q), the motor of a joint
commanded to q stands at N q, where N is the gear ratio; if a sensor behind the gear errs by e(q),
the controller has turned the motor to N (q + e(q)). The phases of high lines tell the two apart:
for usual errors and the order n = 20, N n e(q) is most of a radian. In general the motor stands at
N (q + alpha e(q) + beta tau): alpha is the share of the error that it followed, beta its turn by a
torque.

Sums over poses at all orders are Fourier transforms of poses gridded over a few turns (Lomb and
Scargle, by an FFT). Where there is no line, the log-likelihood gained by one is Gamma(c)
distributed, c being the number of campaigns; this bounds the rate of false lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from math import factorial

import numpy as np
from scipy.special import bdtrc

from pa10cal.arrays import Array, Mask, take_rows
from pa10cal.discovery.rules import RIPPLE
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.results.maps import MotorRipple

_ALPHAS = np.linspace(*RIPPLE.share_grid)


@dataclass(frozen=True, eq=False)
class JointSeries:
    """One joint in P configurations of a campaign."""

    q_rad: Array  # (P,) commanded angle
    residual_rad: Array  # (P,) true angle less the angle by the model
    weight: Array  # (P,) inverse variance of the residual [1/rad²]
    error_rad: Array  # (P,) error of the angle by the model, true less commanded
    torque_Nm: Array  # (P,) torque; nan where not known
    moved: Mask  # (P,) whether the joint moved since the configuration before

    def __len__(self) -> int:
        return len(self.q_rad)

    def take(self, rows: Mask) -> JointSeries:
        """Return the series of these configurations only."""
        return take_rows(self, rows)

    @property
    def centred_rad(self) -> Array:
        """Return the residual less its weighted mean."""
        total = max(float(self.weight.sum()), COMPUTING.tiny)
        return self.residual_rad - float(self.weight @ self.residual_rad) / total

    def motor_rad(self, alpha: float) -> Array:
        """Return the motor's angle over the gear ratio if it followed the share alpha of errors."""
        return self.q_rad + alpha * self.error_rad


@dataclass(frozen=True)
class SpectralLine:
    """A line of a joint's residual."""

    order: float  # cycles a turn of the joint
    alpha: float  # share of the error, followed by the motor, with which it is strongest
    nats: float  # minus the logarithm of the probability to find it there by chance


def witnesses(
    joints: Sequence[Sequence[JointSeries]], stated_ratio: Array
) -> tuple[MotorRipple | None, ...]:
    """Return what the motor's ripple shows of every joint; None where a joint has no ripple.

    Args:
        joints: the series of each joint, one a campaign; none of a joint that is not searched.
        stated_ratio: (n,) gear ratio of each joint in the arm's description; nan where not known.
    """
    searched = sum(map(bool, joints))
    moved = [_long_enough([part.take(part.moved) for part in joint]) for joint in joints]
    found = [
        _lines_of_motor(lines(series, None, searched) if series else [], joint)
        for series, joint in zip(moved, joints, strict=True)
    ]
    common = common_ratio([line for of_joint in found for line in of_joint])
    ripples: list[MotorRipple | None] = []
    for joint, series, own, stated in zip(joints, moved, found, stated_ratio.tolist(), strict=True):
        ratio = common or common_ratio(own)
        if not np.isnan(stated):  # it holds unless the data have a ratio that is no multiple of it
            times = 1.0 if ratio is None else max(ratio / stated, stated / ratio)
            if ratio is None or abs(times - round(times)) < RIPPLE.commensurate_share * times:
                ratio = stated
        if not series or ratio is None:
            ripples.append(None)
        else:
            of_ratio = _lines_of_motor(lines(series, ratio, searched), joint)
            ripples.append(_ripple(series, ratio, of_ratio))
    return tuple(ripples)


def _long_enough(series: Sequence[JointSeries]) -> list[JointSeries]:
    return [part for part in series if len(part) >= RIPPLE.least_poses]


def lines(series: Sequence[JointSeries], ratio: float | None, joints: int) -> list[SpectralLine]:
    """Return the lines of a joint, the strongest first, each sought in what those before it leave.

    Args:
        series: the joint's campaigns, in configurations to which it moved.
        ratio: gear ratio at whose multiples lines are sought; None for all orders.
        joints: number of joints searched, which sets the threshold for the rate of false lines.
    """
    if ratio is None:
        orders = np.arange(RIPPLE.orders[0], RIPPLE.orders[1], 1.0 / RIPPLE.grid_turns)
        tests = float(RIPPLE.orders[1] - RIPPLE.orders[0]) * RIPPLE.grid_turns
    else:
        orders = ratio * np.arange(1, RIPPLE.most_orders + 1)
        orders = orders[orders < RIPPLE.orders[1] - 1]  # with a margin: the spectrum ends there
        tests = float(len(orders))
    if not len(orders):  # a stated ratio beyond all orders that poses can show
        return []
    at = np.round(orders * RIPPLE.grid_turns).astype(int)
    needed = float(np.log(tests * len(RIPPLE.error_shares) * joints / RIPPLE.false_rate))
    found: list[SpectralLine] = []
    remaining = list(series)
    while len(found) < RIPPLE.most_lines:
        nats = np.stack([_spectrum(remaining, alpha)[at] for alpha in RIPPLE.error_shares])
        a, k = np.unravel_index(int(np.argmax(nats)), nats.shape)
        line = SpectralLine(float(orders[k]), RIPPLE.error_shares[a], float(nats[a, k]))
        known = any(abs(line.order - other.order) < RIPPLE.same_order for other in found)
        if line.nats < needed or known:
            break
        found.append(line)
        remaining = [_without(part, line) for part in remaining]
    return found


def common_ratio(found: Sequence[SpectralLine]) -> float | None:
    """Return the greatest common divisor of lines; None where chance would make one as good.

    Lines at powers of two come from the divisions of a sensor, not from the motor.
    """
    orders = np.array([line.order for line in found])
    octaves = np.log2(orders)
    orders = orders[np.abs(orders - 2.0 ** np.round(octaves)) > RIPPLE.of_a_division]
    if len(orders) < 2:
        return None
    ratios = np.arange(RIPPLE.ratios[0], RIPPLE.ratios[1], RIPPLE.ratio_step)
    multiple = np.maximum(np.round(orders / ratios[:, None]), 1.0)
    tolerance = RIPPLE.same_order + RIPPLE.same_ratio * multiple
    near = np.abs(orders - multiple * ratios[:, None]) < tolerance
    chance = np.minimum(tolerance.mean(axis=1) / (ratios / 2.0), 1.0)
    log_p = np.log(np.maximum(bdtrc(near.sum(axis=1) - 1.0, len(orders), chance), COMPUTING.tiny))
    best = int(np.argmin(log_p))
    if -log_p[best] < np.log(len(ratios) / RIPPLE.false_rate):
        return None
    multiples = multiple[best, near[best]]
    ratio = float(multiples @ orders[near[best]] / (multiples @ multiples))
    whole = float(round(ratio))
    return whole if abs(ratio - whole) * multiples.max() < RIPPLE.same_order else ratio


def _lines_of_motor(
    found: Sequence[SpectralLine], joint: Sequence[JointSeries]
) -> list[SpectralLine]:
    """Return lines without those that also show where the joint stood: those are a sensor's."""
    stood = _long_enough([part.take(~part.moved) for part in joint])
    if not stood or not found:
        return list(found)
    nats = _spectrum(stood, 0.0)
    most = float(np.log(3 * len(found) / RIPPLE.false_rate))  # three orders are looked at for each
    at = [round(line.order * RIPPLE.grid_turns) for line in found]
    return [line for line, k in zip(found, at, strict=True) if nats[k - 1 : k + 2].max() <= most]


def _ripple(
    series: Sequence[JointSeries], ratio: float, own: Sequence[SpectralLine]
) -> MotorRipple | None:
    """Return alpha and beta by a joint's lines at multiples of a ratio, by profile likelihood.

    None where it has no lines, or where its error is too small to turn their phases.
    """
    found = sorted(own, key=lambda line: line.order)
    orders = [line.order for line in found]
    error_rad = max(float(np.std(part.error_rad)) for part in series)
    if not orders or orders[-1] * error_rad < RIPPLE.least_turn_rad:
        return None
    betas = _betas_rad_Nm(series, orders[-1])
    gains = np.zeros((len(_ALPHAS), len(betas)))
    for part in series:
        for line in found:
            others = [other for other in found if other is not line]
            gains += _gains(reduce(_without, others, part), line.order, betas)
    nats = gains.max(axis=1)
    best = int(np.argmax(nats))
    return MotorRipple(
        ratio=ratio,
        orders=tuple(round(order / ratio) for order in orders),
        alpha=_likeliest_alpha(nats),
        interval95=_interval(nats - nats[best]),
        gain_nats=float(nats[best] - np.interp(0.0, _ALPHAS, nats)),
        gain_over_one_nats=float(nats[best] - np.interp(1.0, _ALPHAS, nats)),
        beta_rad_Nm=float(betas[np.argmax(gains[best])]) if len(betas) > 1 else None,
        alphas=_ALPHAS,
        profile_nats=nats - nats[best],
    )


def _betas_rad_Nm(series: Sequence[JointSeries], highest_order: float) -> Array:
    """Return the turns of the motor by a torque that are tried, (B,) [rad/(N m)].

    Zero alone where torques are not known or hardly vary: a constant torque turns the motor by a
    constant, which is the line's own phase.
    """
    spread_Nm = max(float(np.std(part.torque_Nm)) for part in series)
    largest_Nm = max(float(np.abs(part.torque_Nm).max()) for part in series)
    if not np.isfinite(spread_Nm) or spread_Nm <= RIPPLE.varying_share * largest_Nm:
        return np.zeros(1)
    count = int(np.ceil(RIPPLE.most_turn_rad * highest_order / RIPPLE.phase_step_rad))
    turns_rad = np.linspace(-RIPPLE.most_turn_rad, RIPPLE.most_turn_rad, 2 * count + 1)
    return np.asarray(turns_rad / spread_Nm)


def _likeliest_alpha(nats: Array) -> float:
    """Return alpha at the vertex of a parabola through the best of `_ALPHAS` and its neighbours."""
    k = int(np.clip(np.argmax(nats), 1, len(nats) - 2))
    low, middle, high = nats[k - 1 : k + 2]
    curvature = low - 2.0 * middle + high
    step = 0.5 * (low - high) / curvature if curvature < 0.0 else 0.0
    return float(_ALPHAS[k] + np.clip(step, -1.0, 1.0) * (_ALPHAS[1] - _ALPHAS[0]))


def _spectrum(series: Sequence[JointSeries], alpha: float) -> Array:
    """Return minus the log probability that chance makes lines at orders k / grid_turns, (K,)."""
    count = RIPPLE.orders[1] * RIPPLE.grid_turns
    gained = sum((_gained(part, alpha) for part in series), np.zeros(count))
    # Survival function of Gamma(c) for c campaigns: exp(-x) sum of x^k / k! for k < c.
    terms = sum((gained**k / factorial(k) for k in range(len(series))), np.zeros_like(gained))
    return np.asarray(gained - np.log(terms))


def _gained(series: JointSeries, alpha: float) -> Array:
    """Return the log-likelihood gained in one campaign by lines at orders k / grid_turns, (K,).

    Gains are divided by their background where that is above the one of white noise: where the
    residual scatters by more than its weights state, chance gains more.
    """
    cells = RIPPLE.grid_cells
    position = np.mod(series.motor_rad(alpha) / (2.0 * np.pi * RIPPLE.grid_turns), 1.0) * cells
    cell = position.astype(np.intp)
    fraction = position - cell

    def transformed(values: Array) -> Array:
        grid = np.bincount(cell, values * (1.0 - fraction), cells)
        grid += np.bincount((cell + 1) % cells, values * fraction, cells)
        return np.asarray(np.fft.rfft(grid))

    count, weight = RIPPLE.orders[1] * RIPPLE.grid_turns, series.weight
    of_residual = transformed(weight * series.centred_rad)[:count]
    of_weight = transformed(weight)
    gained = _explained(
        of_residual, of_weight[:count], of_weight[: 2 * count : 2], float(weight.sum())
    )
    steps = RIPPLE.background_steps
    windows = gained[: count // steps * steps].reshape(-1, steps)
    middle = (np.arange(len(windows)) + 0.5) * steps
    # White noise gains Gamma(1), whose median is ln 2.
    background = np.interp(np.arange(count), middle, np.median(windows, axis=1)) / np.log(2.0)
    return np.asarray(gained / np.maximum(background, 1.0))


def _explained(of_residual: Array, of_weight: Array, of_double: Array, total: float) -> Array:
    """Return the log-likelihood gained by sine and cosine beside a constant.

    It is half the quadratic form s' N^-1 s of their normal equations N, the constant eliminated.

    Args:
        of_residual: sums over poses of weight times centred residual times exp(-i phase).
        of_weight: sums of weight times exp(-i phase).
        of_double: sums of weight times exp(-2 i phase).
        total: sum of the weights.
    """
    cc = 0.5 * (total + of_double.real) - of_weight.real**2 / total
    ss = 0.5 * (total - of_double.real) - of_weight.imag**2 / total
    cs = -0.5 * of_double.imag + of_weight.real * of_weight.imag / total
    c, s = of_residual.real, -of_residual.imag
    determinant = np.maximum(cc * ss - cs**2, COMPUTING.least_determinant * total**2)
    return np.asarray(0.5 * (c * c * ss - 2.0 * c * s * cs + s * s * cc) / determinant)


def _without(series: JointSeries, line: SpectralLine) -> JointSeries:
    """Return a series with a constant and a line fitted and subtracted from its residual."""
    phase = line.order * series.motor_rad(line.alpha)
    columns = np.column_stack([np.ones(len(series)), np.cos(phase), np.sin(phase)])
    weighted = columns * series.weight[:, None]
    normal, projection = weighted.T @ columns, weighted.T @ series.residual_rad
    amounts = np.linalg.lstsq(normal, projection, rcond=None)[0]
    return replace(series, residual_rad=series.residual_rad - columns @ amounts)


def _gains(series: JointSeries, order: float, betas: Array) -> Array:
    """Return the log-likelihood that a line gains, (A, B): by `_ALPHAS` and by beta."""
    weight, centred = series.weight, series.centred_rad
    total = float(weight.sum())
    by_beta = np.ones((1, len(series)), dtype=complex)
    if len(betas) > 1:
        torque_Nm = series.torque_Nm - series.torque_Nm.mean()
        by_beta = np.exp(-1j * order * betas[:, None] * torque_Nm)
    found = np.empty((len(_ALPHAS), len(betas)))
    for k, alpha in enumerate(_ALPHAS):
        phasor = np.exp(-1j * order * series.motor_rad(float(alpha)))
        of_residual, once, twice = weight * centred * phasor, weight * phasor, weight * phasor**2
        found[k] = _explained(by_beta @ of_residual, by_beta @ once, by_beta**2 @ twice, total)
    return found


def _interval(below: Array) -> tuple[float, float]:
    """Return the 95 % interval of alpha by the log-likelihood below the best, (A,)."""
    limit = -RIPPLE.half_chi2_95
    inside = np.flatnonzero(below > limit)
    first, last = int(inside[0]), int(inside[-1])
    rising = slice(max(first - 1, 0), first + 1)
    # The upper end falls; interpolation needs ordinates that rise.
    falling = np.arange(last, min(last + 2, len(below)))[::-1]
    low = np.interp(limit, below[rising], _ALPHAS[rising])
    high = np.interp(limit, below[falling], _ALPHAS[falling])
    return float(low), float(high)
