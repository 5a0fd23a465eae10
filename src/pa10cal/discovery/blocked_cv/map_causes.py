"""The cause of a map of joint errors, sensor or gear, as far as the readings show it.

Two things show it: the ripple of the motor (`motor_ripple`) in the residual of the joint, and
campaigns or turns that agree on its error, which is then the joint's own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array, Mask
from pa10cal.discovery.blocked_cv.refit import Refit
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.jacobians import WhitenedPoses, ideal_by_joints
from pa10cal.discovery.motor_ripple import JointSeries, witnesses
from pa10cal.discovery.rules import MAPS, RIPPLE
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.results.maps import Agreement, JointWitness
from pa10cal.terms.effects.effect import Effect, driven_joints
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
    residual, whiteners = survey.net_residual(found.at), found.weights.whiteners()
    rows = WhitenedPoses(found.at, survey.poses, residual, whiteners)
    series = joint_series(rows, joints)
    ripples = witnesses(series, found.at.arm.gear_ratio)
    return {
        joint: JointWitness(ripple=ripples[joint - 1], agreement=agreement(series[joint - 1]))
        for joint in sorted(joints)
    }


def joint_series(rows: WhitenedPoses, joints: Sequence[int]) -> list[list[JointSeries]]:
    """Return the series of each joint, one a campaign; empty lists for joints not listed.

    The residual of a pose is the sum of contributions of all joints and of reading noise. Their
    variances are estimated from all poses by expectation maximisation. A joint's residual is then
    its score over its information, the other joints being noise.

    Args:
        rows: the poses about a model, its maps of joints included.
        joints: joints wanted, counted from 1.
    """
    at, poses, states, arm = rows.at, rows.poses, rows.poses.states, rows.at.arm
    screws, seen = rows.whitener @ ideal_by_joints(at, poses), poses.measured.components_seen
    score, weight = _scores(screws, rows.data, seen)
    error_rad = np.zeros_like(score)
    for term in at.model.terms:
        if is_error_map(term):
            values = at.x[at.model.columns_of(term)]
            error_rad[:, term.joint - 1] += term.shift(states, values)[:, 0]
    rated_Nm = arm.rated_Nm(np.abs(states.tau_Nm).max(axis=0))
    loaded = states.tau_Nm.std(axis=0) > RIPPLE.least_loaded_share * rated_Nm
    torque_Nm = np.where(loaded, states.tau_Nm, np.nan)
    campaign = np.zeros(len(poses), int) if states.campaign is None else states.campaign
    found: list[list[JointSeries]] = [[] for _ in range(score.shape[1])]
    for joint in joints:
        j = joint - 1
        all_campaigns = JointSeries(
            q_rad=states.q_rad[:, j],
            residual_rad=score[:, j] / weight[:, j],
            weight=weight[:, j],
            error_rad=error_rad[:, j],
            torque_Nm=torque_Nm[:, j],
            moved=states.move_from_previous[:, j] != 0.0,
        )
        found[j] = [all_campaigns.take(campaign == number) for number in np.unique(campaign)]
    return found


def _scores(screws: Array, residual: Array, seen: Mask) -> tuple[Array, Array]:
    """Return score and information of each joint in each pose, (P, n) each.

    Their ratio is the joint's residual, the information the inverse of its variance.

    Args:
        screws: (P, b, n) derivative of the whitened components by the joints.
        residual: (P, b) whitened, measured less predicted.
        seen: (P, b) components that were measured.
    """
    count = max(int(seen.sum()), 1)
    joint_variance, reading_variance = np.full(screws.shape[2], RIPPLE.joint_rad**2), 1.0
    across = screws.transpose(0, 2, 1)
    unit = np.eye(residual.shape[1])
    for _ in range(RIPPLE.variance_rounds):
        precision = np.linalg.inv((screws * joint_variance) @ across + reading_variance * unit)
        pulled = (precision @ residual[:, :, None])[:, :, 0]
        score = (across @ pulled[:, :, None])[:, :, 0]
        weight = np.einsum("pij,pik,pkj->pj", screws, precision, screws, optimize=True)
        # Expected squares given the data: squared mean plus posterior variance.
        joint_variance = np.mean(
            (joint_variance * score) ** 2 + joint_variance - joint_variance**2 * weight, axis=0
        )
        diagonal = np.diagonal(precision, axis1=1, axis2=2)
        squares = (reading_variance * pulled) ** 2 + reading_variance
        squares -= reading_variance**2 * diagonal
        reading_variance = float(np.sum(seen * squares) / count)
    # The variance of a score is its information; scale both to the scatter that the scores show.
    scale = np.sum(score**2, axis=0) / np.maximum(np.sum(weight, axis=0), COMPUTING.tiny)
    weight = np.maximum(weight, COMPUTING.least_weight * weight.max())
    return score / scale, weight / scale


class ArcMeans(NamedTuple):
    """Mean errors of a joint in the arcs of one turn; nan in arcs with too few poses."""

    mean_rad: Array  # (A,)
    variance: Array  # (A,) [rad²]


def agreement(series: Sequence[JointSeries]) -> Agreement | None:
    """Return how well the campaigns and turns of a joint agree on its error by its angle.

    None where no arc was visited by two of them. The error of a pose is its error by the model plus
    its residual. Each pair of campaigns or turns is compared by its means over arcs, less their
    weighted mean: a constant is an offset of the joint's zero, not an error by the angle.
    """
    turns = [turn for part in series for turn in _arc_means_by_turn(part)]
    products, count = np.zeros(3), 0
    for first, second in combinations(turns, 2):
        both = np.isfinite(first.mean_rad) & np.isfinite(second.mean_rad)
        if both.sum() < 2:
            continue
        first_variance, second_variance = first.variance[both], second.variance[both]
        weight = 1.0 / (first_variance + second_variance)
        share = weight / weight.sum()
        a, b = (mean[both] - share @ mean[both] for mean in (first.mean_rad, second.mean_rad))
        products += (
            weight @ (a * b),
            weight @ (a**2 - first_variance * (1.0 - share)),
            weight @ (b**2 - second_variance * (1.0 - share)),
        )
        count += int(both.sum())
    product, first_square, second_square = products
    if not count or min(first_square, second_square) <= 0.0:
        return None
    correlation = float(np.clip(product / np.sqrt(first_square * second_square), -1.0, 1.0))
    return Agreement(correlation=correlation, slope=float(product / first_square), arcs=count)


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
    cause = witness.cause or likely or "sensor"
    form = (error_map.of, error_map.knots, error_map.spectrum)
    others = tuple(kind(*form) for name, kind in _NAMES.items() if name != cause)
    return NamedMap(_NAMES[cause](*form), () if witness.cause else others)
