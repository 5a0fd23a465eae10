"""The motor's ripple as a witness: lines of a joint's residual at multiples of its gear ratio.

A controller stops a joint where the motor's cogging lets it, so what a model leaves of the joint's
angle has lines in the angle at which the motor stands, in poses to which the joint moved. Where the
gear errs by e(q), the motor of a joint commanded to q stands at N q; where a sensor behind the gear
does, the controller has turned the motor to N (q + e(q)). Phases of high lines tell the two apart:
N n e(q) is most of a radian for usual errors and n = 20.

Sums over poses at all orders are Fourier transforms of poses gridded over a few turns (Lomb and
Scargle, by an FFT). The log-likelihood that a line gains goes as Gamma(campaigns) where nothing is
there, which bounds the rate of false lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations
from math import factorial

import numpy as np
from scipy.special import bdtrc

from pa10cal.arrays import Array, Mask
from pa10cal.discovery.linear import by_every_joint
from pa10cal.discovery.other_numbers import COMPUTING
from pa10cal.discovery.rules import RIPPLE
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.results.maps import Agreement, MotorRipple
from pa10cal.terms.effects.joint_error_map import is_error_map

_ALPHAS = np.linspace(*RIPPLE.share_grid)


@dataclass(frozen=True, eq=False)
class JointSeries:
    """One joint in P configurations of a campaign."""

    q_rad: Array  # (P,) its angle, as commanded
    left_rad: Array  # (P,) by how much further it stands than the model says
    weight: Array  # (P,) inverse variance of that [1/rad²]
    error_rad: Array  # (P,) error of its angle by the model, true less commanded
    torque_Nm: Array  # (P,) its torque; nan where not known
    moved: Mask  # (P,) whether it moved since the configuration before

    def __len__(self) -> int:
        return len(self.q_rad)

    def where(self, rows: Mask) -> JointSeries:
        """Return some of its configurations."""
        return JointSeries(*(getattr(self, field.name)[rows] for field in fields(self)))

    @property
    def centred_rad(self) -> Array:
        """Return what the model leaves less its weighted mean."""
        total = max(float(self.weight.sum()), COMPUTING.tiny)
        return self.left_rad - float(self.weight @ self.left_rad) / total

    def motor_rad(self, share: float) -> Array:
        """Return the angle at which the motor stands if it followed some of the error."""
        return self.q_rad + share * self.error_rad


@dataclass(frozen=True)
class SpectralLine:
    """A line of a joint's residual."""

    order: float  # cycles a turn of the joint
    share: float  # of the error with which it is strongest
    nats: float  # minus the logarithm of the probability to find it there by chance


def witnesses(
    joints: Sequence[Sequence[JointSeries]], stated_ratio: Array
) -> tuple[MotorRipple | None, ...]:
    """Return what the ripple of every joint says; None where it shows none.

    By each joint's campaigns, none of a joint that is not to be looked at, and the motor turns a
    joint turn (n,) that the arm's description states; nan where not known.
    """
    searched = sum(map(bool, joints))
    moved = [_long_enough([part.where(part.moved) for part in joint]) for joint in joints]
    found = [
        _of_motor(lines(series, None, searched) if series else [], joint)
        for series, joint in zip(moved, joints, strict=True)
    ]
    common = common_ratio([line for own in found for line in own])
    said: list[MotorRipple | None] = []
    for joint, series, own, stated in zip(joints, moved, found, stated_ratio.tolist(), strict=True):
        ratio = common or common_ratio(own)
        if not np.isnan(stated):  # unless the data have one that is no multiple or part of it
            times = 1.0 if ratio is None else max(ratio / stated, stated / ratio)
            if ratio is None or abs(times - round(times)) < RIPPLE.commensurate_share * times:
                ratio = stated
        if not series or ratio is None:
            said.append(None)
        else:
            said.append(_witness(series, ratio, _of_motor(lines(series, ratio, searched), joint)))
    return tuple(said)


def _long_enough(series: Sequence[JointSeries]) -> list[JointSeries]:
    return [part for part in series if len(part) >= RIPPLE.least_poses]


def lines(series: Sequence[JointSeries], ratio: float | None, joints: int) -> list[SpectralLine]:
    """Return the lines of a joint, the strongest first, each sought beside those before it.

    In its campaigns, each in configurations to which it moved; at multiples of a ratio alone, or at
    all orders. How many joints are searched decides the rate of false lines.
    """
    if ratio is None:
        orders = np.arange(RIPPLE.orders[0], RIPPLE.orders[1], 1.0 / RIPPLE.grid_turns)
        tests = float(RIPPLE.orders[1] - RIPPLE.orders[0]) * RIPPLE.grid_turns
    else:
        orders = ratio * np.arange(1, RIPPLE.most_orders + 1)
        orders = orders[orders < RIPPLE.orders[1] - 1]
        tests = float(len(orders))
    at = np.round(orders * RIPPLE.grid_turns).astype(int)
    needed = float(np.log(tests * len(RIPPLE.error_shares) * joints / RIPPLE.false_rate))
    found: list[SpectralLine] = []
    left = list(series)
    while len(found) < RIPPLE.most_lines:
        nats = np.stack([_spectrum(left, share)[at] for share in RIPPLE.error_shares])
        share, k = np.unravel_index(int(np.argmax(nats)), nats.shape)
        line = SpectralLine(float(orders[k]), RIPPLE.error_shares[share], float(nats[share, k]))
        if line.nats < needed or any(
            abs(line.order - each.order) < RIPPLE.same_order for each in found
        ):
            break
        found.append(line)
        left = [_without(each, line) for each in left]
    return found


def common_ratio(found: Sequence[SpectralLine]) -> float | None:
    """Return the greatest common divisor of lines; None where chance would make one as good.

    Lines at powers of two are those of a sensor's divisions, and are none of the motor.
    """
    orders = np.array([line.order for line in found])
    octaves = np.log2(orders)
    orders = orders[np.abs(orders - 2.0 ** np.round(octaves)) > RIPPLE.of_a_division]
    if len(orders) < 2:
        return None
    ratios = np.arange(RIPPLE.ratios[0], RIPPLE.ratios[1], RIPPLE.ratio_step)
    multiple = np.maximum(np.round(orders / ratios[:, None]), 1.0)
    reach = RIPPLE.same_order + RIPPLE.same_ratio * multiple
    near = np.abs(orders - multiple * ratios[:, None]) < reach
    chance = np.minimum(reach.mean(axis=1) / (ratios / 2.0), 1.0)
    log_p = np.log(np.maximum(bdtrc(near.sum(axis=1) - 1.0, len(orders), chance), COMPUTING.tiny))
    best = int(np.argmin(log_p))
    if -log_p[best] < np.log(len(ratios) / RIPPLE.false_rate):
        return None
    times = multiple[best, near[best]]
    ratio = float(times @ orders[near[best]] / (times @ times))
    whole = float(round(ratio))
    return whole if abs(ratio - whole) * times.max() < RIPPLE.same_order else ratio


def _of_motor(found: Sequence[SpectralLine], joint: Sequence[JointSeries]) -> list[SpectralLine]:
    """Return the lines that do not show where the joint did not move: else they are a sensor's."""
    stood = _long_enough([part.where(~part.moved) for part in joint])
    if not stood or not found:
        return list(found)
    nats = _spectrum(stood, 0.0)
    least = float(np.log(3 * len(found) / RIPPLE.false_rate))
    at = [round(line.order * RIPPLE.grid_turns) for line in found]
    return [line for line, k in zip(found, at, strict=True) if nats[k - 1 : k + 2].max() <= least]


def _witness(
    series: Sequence[JointSeries], ratio: float, own: Sequence[SpectralLine]
) -> MotorRipple | None:
    """Return what a joint's lines at multiples of a ratio say; None where it has none."""
    found = sorted(own, key=lambda line: line.order)
    orders = [line.order for line in found]
    error_rad = max(float(np.std(each.error_rad)) for each in series)
    if not orders or orders[-1] * error_rad < RIPPLE.least_turn_rad:
        return None
    spread_Nm = max(float(np.std(each.torque_Nm)) for each in series)
    turns = np.zeros(1)
    # A torque that hardly varies turns the motor by a constant, which is the line's own phase.
    largest_Nm = max(float(np.abs(each.torque_Nm).max()) for each in series)
    if spread_Nm > RIPPLE.varying_share * largest_Nm:
        count = int(np.ceil(RIPPLE.most_turn_rad * orders[-1] / RIPPLE.phase_step_rad))
        turns = np.linspace(-RIPPLE.most_turn_rad, RIPPLE.most_turn_rad, 2 * count + 1) / spread_Nm
    gains = np.zeros((len(_ALPHAS), len(turns)))
    for each in series:
        for line in found:  # each beside the others
            alone = each
            for other in found:
                alone = alone if other is line else _without(alone, other)
            gains += _gains(alone, line.order, turns)
    nats = gains.max(axis=1)
    best = int(np.argmax(nats))
    # Where the likelihood is highest between the shares tried, by a parabola.
    k = int(np.clip(best, 1, len(nats) - 2))
    low, middle, high = nats[k - 1 : k + 2]
    bend = low - 2.0 * middle + high
    step = 0.5 * (low - high) / bend if bend < 0.0 else 0.0
    alpha = float(_ALPHAS[k] + np.clip(step, -1.0, 1.0) * (_ALPHAS[1] - _ALPHAS[0]))
    return MotorRipple(
        ratio=ratio,
        orders=tuple(round(order / ratio) for order in orders),
        alpha=alpha,
        interval95=_interval(nats - nats[best]),
        gain_nats=float(nats[best] - np.interp(0.0, _ALPHAS, nats)),
        gain_over_one_nats=float(nats[best] - np.interp(1.0, _ALPHAS, nats)),
        beta_rad_Nm=float(turns[np.argmax(gains[best])]) if len(turns) > 1 else None,
        alphas=_ALPHAS,
        profile_nats=nats - nats[best],
    )


def _spectrum(series: Sequence[JointSeries], share: float) -> Array:
    """Return minus the log probability of lines at orders k/4 by chance, (K,)."""
    gained = sum(
        (_gained(part, share) for part in series), np.zeros(RIPPLE.orders[1] * RIPPLE.grid_turns)
    )
    # Of Gamma(c) with c campaigns, in closed form.
    terms = sum((gained**k / factorial(k) for k in range(len(series))), np.zeros_like(gained))
    return np.asarray(gained - np.log(terms))


def _gained(series: JointSeries, share: float) -> Array:
    """Return the log-likelihood that a line at orders k/4 gains in one campaign, (K,).

    In its background: where the residual's distribution is wider than its weights say, chance
    gains more.
    """
    part = (
        np.mod(series.motor_rad(share) / (2.0 * np.pi * RIPPLE.grid_turns), 1.0) * RIPPLE.grid_cells
    )
    cell = part.astype(np.intp)
    beyond = part - cell

    def transformed(values: Array) -> Array:
        grid = np.bincount(cell, values * (1.0 - beyond), RIPPLE.grid_cells)
        grid += np.bincount((cell + 1) % RIPPLE.grid_cells, values * beyond, RIPPLE.grid_cells)
        return np.asarray(np.fft.rfft(grid))

    count, weight = RIPPLE.orders[1] * RIPPLE.grid_turns, series.weight
    of_left = transformed(weight * series.centred_rad)[:count]
    of_weight = transformed(weight)
    gained = _explained(of_left, of_weight[:count], of_weight[: 2 * count : 2], float(weight.sum()))
    windows = gained[: count // RIPPLE.background_steps * RIPPLE.background_steps].reshape(
        -1, RIPPLE.background_steps
    )
    middle = (np.arange(len(windows)) + 0.5) * RIPPLE.background_steps
    usual = np.interp(np.arange(count), middle, np.median(windows, axis=1)) / np.log(2.0)
    return np.asarray(gained / np.maximum(usual, 1.0))


def _explained(of_left: Array, of_weight: Array, of_double: Array, total: float) -> Array:
    """Return the log-likelihood that sine and cosine gain beside a constant.

    By sums of weighted residuals times exp(-i phase), of weights times exp(-i phase) and
    exp(-2 i phase), and of weights.
    """
    cc = 0.5 * (total + of_double.real) - of_weight.real**2 / total
    ss = 0.5 * (total - of_double.real) - of_weight.imag**2 / total
    cs = -0.5 * of_double.imag + of_weight.real * of_weight.imag / total
    c, s = of_left.real, -of_left.imag
    determinant = np.maximum(cc * ss - cs**2, COMPUTING.least_determinant * total**2)
    return np.asarray(0.5 * (c * c * ss - 2.0 * c * s * cs + s * s * cc) / determinant)


def _without(series: JointSeries, line: SpectralLine) -> JointSeries:
    """Return a series with a line taken out of what is left."""
    phase = line.order * series.motor_rad(line.share)
    columns = np.column_stack([np.ones(len(series)), np.cos(phase), np.sin(phase)])
    weighted = columns * series.weight[:, None]
    amounts = np.linalg.lstsq(weighted.T @ columns, weighted.T @ series.left_rad, rcond=None)[0]
    return replace(series, left_rad=series.left_rad - columns @ amounts)


def _gains(series: JointSeries, order: float, turns: Array) -> Array:
    """Return the log-likelihood that a line gains, (A, B): by share and by turn a torque."""
    weight, centred = series.weight, series.centred_rad
    total = float(weight.sum())
    by_turn = np.ones((1, len(series)), dtype=complex)
    if len(turns) > 1:
        torque_Nm = series.torque_Nm - series.torque_Nm.mean()
        by_turn = np.exp(-1j * order * turns[:, None] * torque_Nm)
    found = np.empty((len(_ALPHAS), len(turns)))
    for k, share in enumerate(_ALPHAS):
        turn = np.exp(-1j * order * series.motor_rad(float(share)))
        left, once, twice = weight * centred * turn, weight * turn, weight * turn**2
        found[k] = _explained(by_turn @ left, by_turn @ once, by_turn**2 @ twice, total)
    return found


def _interval(below: Array) -> tuple[float, float]:
    """Return the 95 % interval about the best of all shares tried (A,), by log-likelihoods."""
    inside = np.flatnonzero(below > -RIPPLE.half_chi2_95)
    first, last = int(inside[0]), int(inside[-1])
    rises = slice(max(first - 1, 0), first + 1)
    falls = np.arange(last, min(last + 2, len(below)))[::-1]
    ends = (np.interp(-RIPPLE.half_chi2_95, below[at], _ALPHAS[at]) for at in (rises, falls))
    low, high = map(float, ends)
    return low, high


# What a model leaves of each joint's angle, pose by pose, as the ripple of its motor needs it.


def joint_series(
    at: FittedModel, poses: Observations, left: Array, whitener: Array, joints: Sequence[int]
) -> list[list[JointSeries]]:
    """Return each joint's residual in every campaign; none of joints that are not asked for.

    The residual of a pose is that of all its joints and of its reading at once; their variances are
    found from all poses (expectation and maximisation). What a joint makes of it, the others being
    noise, is its score. The model has its maps; it leaves (P, b), predicted minus measured, which
    the whitener (P, b, b) makes independent and of unit size. Joints are counted from 1.
    """
    score, weight = _scores(
        whitener @ by_every_joint(at, poses),
        -(whitener @ left[:, :, None])[:, :, 0],
        poses.measured.components_seen,
    )
    states, arm = poses.states, at.arm
    error_rad = np.zeros_like(score)
    for term in at.model.terms:
        if is_error_map(term):
            values = at.x[at.model.columns_of(term)]
            error_rad[:, term.joint - 1] += term.shift(states, values)[:, 0]
    torque_Nm = np.where(
        states.tau_Nm.std(axis=0)
        > RIPPLE.least_loaded_share * arm.rated_Nm(np.abs(states.tau_Nm).max(axis=0)),
        states.tau_Nm,
        np.nan,
    )
    campaign = np.zeros(len(poses), int) if states.campaign is None else states.campaign
    found: list[list[JointSeries]] = [[] for _ in range(score.shape[1])]
    for j in (joint - 1 for joint in joints):
        whole = JointSeries(
            q_rad=states.q_rad[:, j],
            left_rad=score[:, j] / weight[:, j],
            weight=weight[:, j],
            error_rad=error_rad[:, j],
            torque_Nm=torque_Nm[:, j],
            moved=states.move_from_previous[:, j] != 0.0,
        )
        found[j] = [whole.where(campaign == number) for number in np.unique(campaign)]
    return found


def _scores(screws: Array, left: Array, seen: Mask) -> tuple[Array, Array]:
    """Return score and weight of each joint in each pose, (P, n): their ratio is its residual.

    By how whitened components follow the joints (P, b, n), what is left of them, measured less
    predicted (P, b), and which were seen (P, b).
    """
    count = max(int(seen.sum()), 1)
    joint, reading = np.full(screws.shape[2], RIPPLE.joint_rad**2), 1.0
    across = screws.transpose(0, 2, 1)
    unit = np.eye(left.shape[1])
    for _ in range(RIPPLE.variance_rounds):
        precision = np.linalg.inv((screws * joint) @ across + reading * unit)
        pulled = (precision @ left[:, :, None])[:, :, 0]
        score = (across @ pulled[:, :, None])[:, :, 0]
        weight = np.einsum("pij,pik,pkj->pj", screws, precision, screws, optimize=True)
        joint = np.mean((joint * score) ** 2 + joint - joint**2 * weight, axis=0)
        alone = np.diagonal(precision, axis1=1, axis2=2)
        reading = float(
            np.sum(seen * ((reading * pulled) ** 2 + reading - reading**2 * alone)) / count
        )
    usual = np.sum(score**2, axis=0) / np.maximum(np.sum(weight, axis=0), COMPUTING.tiny)
    weight = np.maximum(weight, COMPUTING.least_weight * weight.max())
    return score / usual, weight / usual


# Whether campaigns, or turns of a joint, agree on its error by its angle.


def agreement(series: Sequence[JointSeries]) -> Agreement | None:
    """Return how well campaigns and turns agree where two of them were; None where none were.

    The error of a pose is what the model has of it and what it leaves. Means of each pair of
    campaigns or turns are compared less their own mean: a constant is a zero, and not an error that
    depends on the angle.
    """
    parts = [part for each in series for part in _by_turn(each)]
    products, count = np.zeros(3), 0
    for one, other in combinations(parts, 2):
        both = np.isfinite(one[0]) & np.isfinite(other[0])
        if both.sum() < 2:
            continue
        variances = one[1][both], other[1][both]
        weight = 1.0 / (variances[0] + variances[1])
        share = weight / weight.sum()
        a, b = (mean[both] - share @ mean[both] for mean in (one[0], other[0]))
        products += (
            weight @ (a * b),
            weight @ (a**2 - variances[0] * (1.0 - share)),
            weight @ (b**2 - variances[1] * (1.0 - share)),
        )
        count += int(both.sum())
    across, first, second = products
    if not count or min(first, second) <= 0.0:
        return None
    correlation = float(np.clip(across / np.sqrt(first * second), -1.0, 1.0))
    return Agreement(correlation=correlation, slope=float(across / first), arcs=count)


def _by_turn(series: JointSeries) -> list[tuple[Array, Array]]:
    """Return mean error and its variance in every arc, turn by turn; nan for none."""
    turns = series.q_rad / (2.0 * np.pi)
    turn = np.floor(turns).astype(int)
    arc = np.minimum(((turns - turn) * RIPPLE.arcs).astype(int), RIPPLE.arcs - 1)
    found = []
    for number in np.unique(turn):
        here = turn == number
        weight = np.bincount(arc[here], series.weight[here], RIPPLE.arcs)
        error_rad = (series.left_rad + series.error_rad)[here]
        total = np.bincount(arc[here], series.weight[here] * error_rad, RIPPLE.arcs)
        enough = np.bincount(arc[here], minlength=RIPPLE.arcs) >= RIPPLE.arc_poses
        mean, variance = np.full((2, RIPPLE.arcs), np.nan)
        mean[enough], variance[enough] = total[enough] / weight[enough], 1.0 / weight[enough]
        found.append((mean, variance))
    return found
