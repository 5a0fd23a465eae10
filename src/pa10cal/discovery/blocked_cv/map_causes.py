"""The cause of a map of joint errors, sensor or gear, as far as the readings show it.

Two things show it: the ripple of the motor (`motor_ripple`) in the residual of the joint, and
campaigns or turns that agree on its error, which is then the joint's own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery.blocked_cv.refit import Refit
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.jacobians import WhitenedPoses
from pa10cal.discovery.motor_ripple import JointSeries, witnesses
from pa10cal.discovery.rules import MAPS, RIPPLE
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.fit.joint_noise import ideal_by_joints
from pa10cal.results.maps import Agreement, JointWitness
from pa10cal.terms.effects.context import driven_joints
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import (
    GearError,
    JointErrorMap,
    SensorError,
    is_error_map,
)
from pa10cal.terms.term import Term

#: The effect by which a map is named, for each cause.
_NAMES: Mapping[str, type[JointErrorMap]] = {"sensor": SensorError, "gear": GearError}


def causes_of(survey: Survey, found: Refit) -> dict[int, JointWitness]:
    """Return the ripple and the agreement that show the cause of every map, by joint.

    A joint that only follows others has neither sensor nor gear.
    """
    driven = driven_joints(survey.context)
    maps = filter(is_error_map, found.effects)
    joints = [each.joint for each in maps if each.joint in driven]
    if not joints:
        return {}
    series = joint_series(survey.whitened(found.at, found.weights.whiteners()), joints)
    ripples = witnesses(series, found.at.arm.gear_ratio)
    return {
        joint: JointWitness(ripple=ripples[joint - 1], agreement=agreement(series[joint - 1]))
        for joint in sorted(joints)
    }


def joint_series(rows: WhitenedPoses, joints: Sequence[int]) -> list[list[JointSeries]]:
    """Return the series of each joint, one a campaign; empty lists for joints not listed.

    The error of a joint is what its maps say: other effects of it (play, a spring) are neither of
    its sensor nor of its gear's form.

    Args:
        rows: the poses about a model, its maps of joints included.
        joints: joints wanted, counted from 1.
    """
    at, poses, states, arm = rows.at, rows.poses, rows.poses.states, rows.at.arm
    jacobian, seen = rows.whitener @ ideal_by_joints(at, poses), poses.measured.components_seen
    residual_rad, weight = _joint_residuals(jacobian, rows.data, seen)
    error_rad = np.zeros_like(residual_rad)
    for term in at.model.terms:
        if is_error_map(term):
            values = at.x[at.model.columns_of(term)]
            error_rad[:, term.joint - 1] += term.shift(states, values)[:, 0]
    rated_Nm = arm.rated_Nm(np.abs(np.nan_to_num(states.tau_Nm)).max(axis=0))
    campaign = np.zeros(len(poses), int) if states.campaign is None else states.campaign
    found: list[list[JointSeries]] = [[] for _ in range(arm.n)]
    for joint in joints:
        j = joint - 1
        all_campaigns = JointSeries(
            q_rad=states.q_rad[:, j],
            residual_rad=residual_rad[:, j],
            weight=weight[:, j],
            error_rad=error_rad[:, j],
            torque_Nm=_varying_torque(states.tau_Nm[:, j], float(rated_Nm[j]), campaign),
            moved=states.move_from_previous[:, j] != 0.0,
        )
        found[j] = [all_campaigns.take(campaign == number) for number in np.unique(campaign)]
    return found


def _varying_torque(torque_Nm: Array, rated_Nm: float, campaign: Index) -> Array:
    """Return the torque (P,) of a joint; nan in all poses where it hardly varies or is not known.

    In single poses without a torque it is the mean of their campaign, or zero where that has none:
    the same torque in all poses of a campaign turns the motor by a constant, which is of no effect.
    """
    known = np.isfinite(torque_Nm)
    if not known.any() or torque_Nm[known].std() <= RIPPLE.least_loaded_share * rated_Nm:
        return np.full_like(torque_Nm, np.nan)
    filled_Nm = torque_Nm.copy()
    for number in np.unique(campaign[~known]):
        here = campaign == number
        filled_Nm[here & ~known] = torque_Nm[here & known].mean() if known[here].any() else 0.0
    return filled_Nm


# The residual of each joint.
#
# The residual r of a pose is J e + n: contributions e of all joints, of variances V, through their
# derivatives J, and reading noise n of variance s. Its covariance is C = J V J' + s.


def _joint_residuals(jacobian: Array, residual: Array, seen: Mask) -> tuple[Array, Array]:
    """Return residual [rad] and weight [1/rad²] of each joint in each pose, (P, n) each.

    They are those of generalised least squares for one joint, the others being noise: its score
    J_j' C^-1 r over its information J_j' C^-1 J_j. The joint's own variance in C cancels. Weights
    are scaled to the scatter of the residuals.

    Args:
        jacobian: (P, b, n) derivative of the whitened components by the joints.
        residual: (P, b) whitened, measured less predicted.
        seen: (P, b) components that were measured.
    """
    precision = _precision(jacobian, *_variances(jacobian, residual, seen))
    score, information = _score_and_information(jacobian, residual, precision)
    # By the model, the variance of a score is its information.
    scatter = np.sum(score**2, axis=0) / np.maximum(np.sum(information, axis=0), COMPUTING.tiny)
    scatter[scatter == 0.0] = 1.0  # residuals of zero scatter by nothing, whatever their weight
    information = np.maximum(information, COMPUTING.least_weight * information.max())
    return score / information, information / scatter


def _variances(jacobian: Array, residual: Array, seen: Mask) -> tuple[Array, float]:
    """Return the variances (n,) of the joints' contributions [rad²] and that of whitened readings.

    They are estimated from all poses by expectation maximisation: each becomes the mean of expected
    squares, those of the posterior mean plus the posterior variance.

    Args:
        jacobian, residual, seen: as in `_joint_residuals`.
    """
    joint_variance, reading_variance = np.full(jacobian.shape[2], RIPPLE.joint_rad**2), 1.0
    for _ in range(1, RIPPLE.variance_rounds):  # the last round is that of the residuals
        precision = _precision(jacobian, joint_variance, reading_variance)
        score, information = _score_and_information(jacobian, residual, precision)
        joint_variance = np.mean(
            (joint_variance * score) ** 2 + joint_variance - joint_variance**2 * information,
            axis=0,
        )
        noise = reading_variance * (precision @ residual[:, :, None])[:, :, 0]  # posterior mean
        taken = reading_variance**2 * np.diagonal(precision, axis1=1, axis2=2)
        squares = noise**2 + reading_variance - taken
        reading_variance = float(np.sum(seen * squares) / max(int(seen.sum()), 1))
    return joint_variance, reading_variance


def _precision(jacobian: Array, joint_variance: Array, reading_variance: float) -> Array:
    """Return the inverse (P, b, b) of the covariance of the residuals of each pose."""
    of_joints = (jacobian * joint_variance) @ jacobian.transpose(0, 2, 1)
    return np.asarray(np.linalg.inv(of_joints + reading_variance * np.eye(jacobian.shape[1])))


def _score_and_information(
    jacobian: Array, residual: Array, precision: Array
) -> tuple[Array, Array]:
    """Return score and information of each joint in each pose, (P, n) each."""
    score = np.einsum("pij,pi->pj", jacobian, (precision @ residual[:, :, None])[:, :, 0])
    information = np.einsum("pij,pik,pkj->pj", jacobian, precision, jacobian, optimize=True)
    return score, information


# The agreement of campaigns and turns.


class ArcMeans(NamedTuple):
    """Mean errors of a joint in the arcs of one turn; nan in arcs with too few poses."""

    mean_rad: Array  # (A,)
    variance: Array  # (A,) [rad²]


def agreement(series: Sequence[JointSeries]) -> Agreement | None:
    """Return how well the campaigns and turns of a joint agree on its error by its angle.

    None where no two of them visited the same two arcs, or where the error of one side is not sure:
    less than `RIPPLE.sure_std` standard deviations beyond noise. The error of a pose is its error
    by the model plus its residual. Each pair of campaigns or turns is compared by its means over
    arcs, less their weighted mean: a constant is an offset of the joint's zero, not an error by the
    angle.
    """
    turns = [turn for part in series for turn in _arc_means_by_turn(part)]
    product, count = 0.0, 0
    squares = np.zeros(2)  # of the errors without noise, as the first of a pair and as the second
    weights = np.zeros((2, len(turns), RIPPLE.arcs))  # with which each mean's square is in them
    for pair in combinations(range(len(turns)), 2):
        first, second = (turns[k] for k in pair)
        both = np.isfinite(first.mean_rad) & np.isfinite(second.mean_rad)
        if both.sum() < 2:
            continue
        weight = 1.0 / (first.variance[both] + second.variance[both])
        share = weight / weight.sum()
        centred = [turn.mean_rad[both] - share @ turn.mean_rad[both] for turn in (first, second)]
        product += float(weight @ (centred[0] * centred[1]))
        for side, turn in enumerate((first, second)):
            # Of the square of noise v, less its weighted mean, the weighted sum is w v (1 - share).
            noise = turn.variance[both] * (1.0 - share)
            squares[side] += weight @ (centred[side] ** 2 - noise)
            weights[side, pair[side], both] += weight
        count += int(both.sum())
    if not count or np.any(squares <= RIPPLE.sure_std * _noise_std(turns, weights)):
        return None
    # By the mean of both squares: errors of one form and unlike sizes agree less, in any order.
    correlation = float(np.clip(product / squares.mean(), -1.0, 1.0))
    return Agreement(correlation=correlation, slope=product / float(squares[0]), arcs=count)


def _noise_std(turns: Sequence[ArcMeans], weights: Array) -> Array:
    """Return the standard deviation (2,) that noise alone gives weighted sums of squared means.

    Args:
        weights: (2, T, A) weight of each turn's mean in each arc, in each of the two sums.
    """
    # The variance of the square of normal noise of variance v is 2 v².
    variance = np.nan_to_num([turn.variance for turn in turns])
    return np.asarray(np.sqrt(2.0 * np.sum((weights * variance) ** 2, axis=(1, 2))))


def _arc_means_by_turn(series: JointSeries) -> list[ArcMeans]:
    """Return the weighted mean error in every arc, turn by turn."""
    revolutions = series.q_rad / (2.0 * np.pi)
    turn = np.floor(revolutions).astype(int)
    arc = np.minimum(((revolutions - turn) * RIPPLE.arcs).astype(int), RIPPLE.arcs - 1)
    found = []
    for number in np.unique(turn):
        here = turn == number
        weight = np.bincount(arc[here], series.weight[here], RIPPLE.arcs)
        error_rad = (series.residual_rad + series.error_rad)[here]
        total = np.bincount(arc[here], series.weight[here] * error_rad, RIPPLE.arcs)
        enough = np.bincount(arc[here], minlength=RIPPLE.arcs) >= RIPPLE.arc_poses
        mean, variance = np.full((2, RIPPLE.arcs), np.nan)
        mean[enough], variance[enough] = total[enough] / weight[enough], 1.0 / weight[enough]
        found.append(ArcMeans(mean, variance))
    return found


# Names of maps by their cause.


class NamedMap(NamedTuple):
    """A map under the name of its cause."""

    effect: JointErrorMap  # the sensor or gear error of the same form
    alternatives: tuple[JointErrorMap, ...]  # the same by the other cause, where that is possible


def named_by_cause(
    effects: Sequence[Effect], causes: Mapping[int, JointWitness]
) -> dict[Term, NamedMap]:
    """Return the name of each map among some effects whose cause is known, as `causes_of` shows."""
    found: dict[Term, NamedMap] = {}
    for effect in effects:
        if is_error_map(effect) and effect.joint in causes:
            named = _named(effect, causes[effect.joint])
            if named is not None:
                found[effect] = named
    return found


def _named(error_map: JointErrorMap, witness: JointWitness) -> NamedMap | None:
    """Return a map under the name of its cause; None where it stays a map.

    Sensor and gear are alternatives of each other if the ripple does not decide between them.
    Without a ripple they are the causes of a map with fine waves on which campaigns or turns agree,
    since nothing else turns a joint to and fro ten times a turn, or of one that was named already.
    """
    likely = None if witness.ripple is None else witness.ripple.likely
    agreed = witness.agreement is not None and witness.agreement.holds
    is_of_joint = agreed and error_map.knots >= MAPS.fine_knots
    was_named = error_map.id != JointErrorMap.id
    if not (witness.cause or likely or is_of_joint or was_named):
        return None
    # Where nothing says which, the sensor stands first, and the gear is its alternative.
    cause = witness.cause or likely or "sensor"
    form = (error_map.of, error_map.knots, error_map.spectrum)
    others = tuple(kind(*form) for name, kind in _NAMES.items() if name != cause)
    return NamedMap(_NAMES[cause](*form), () if witness.cause else others)
