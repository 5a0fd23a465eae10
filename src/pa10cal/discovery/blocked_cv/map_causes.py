"""Names of maps of joint errors by their cause, sensor or gear, as far as the readings show it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from pa10cal.discovery import linear
from pa10cal.discovery.blocked_cv.refit import Refit
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.joint_series import agreement, joint_series
from pa10cal.discovery.motor_ripple import witnesses
from pa10cal.discovery.rules import MAPS
from pa10cal.results.maps import JointWitness
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
    rows = linear.WhitenedPoses(found.at, survey.poses, residual, whiteners)
    series = joint_series(rows, joints)
    ripples = witnesses(series, found.at.arm.gear_ratio)
    return {
        joint: JointWitness(ripple=ripples[joint - 1], agreement=agreement(series[joint - 1]))
        for joint in sorted(joints)
    }


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
