"""Names of maps by their cause, sensor or gear, as far as the motor's ripple shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pa10cal.discovery.blocked_cv.refit import Refit
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.joint_series import agreement, joint_series
from pa10cal.discovery.motor_ripple import witnesses
from pa10cal.discovery.rules import MAPS
from pa10cal.results.maps import JointWitness
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import (
    GearError,
    JointErrorMap,
    SensorError,
    is_error_map,
)

#: The effect by which a map is named, for each cause.
_NAMES: Mapping[str, type[JointErrorMap]] = {"sensor": SensorError, "gear": GearError}


def causes_of(survey: Survey, found: Refit) -> dict[int, JointWitness]:
    """Return the ripple and the agreement that show the cause of every map, by joint."""
    joints = [each.joint for each in found.effects if is_error_map(each)]
    if not joints:
        return {}
    residual, whiteners = survey.net_residual(found.at), found.weights.whiteners()
    series = joint_series(found.at, survey.poses, residual, whiteners, joints)
    ripples = witnesses(series, found.at.arm.gear_ratio)
    return {
        joint: JointWitness(ripple=ripples[joint - 1], agreement=agreement(series[joint - 1]))
        for joint in sorted(joints)
    }


def names_by_cause(
    effects: Sequence[Effect], causes: Mapping[int, JointWitness]
) -> tuple[dict[Effect, Effect], dict[Effect, tuple[Effect, ...]]]:
    """Return the named effect, and its alternatives, for each map whose cause is known.

    Sensor and gear are alternatives if both err by the ripple, or if nothing shows that the error
    is the joint's own. Without a ripple they are so for a map that has fine waves on which
    campaigns or turns agree, or that was named already: nothing else turns a joint to and fro ten
    times a turn. Any other map of a joint whose motor shows no ripple stays a map.
    """
    names: dict[Effect, Effect] = {}
    alternatives: dict[Effect, tuple[Effect, ...]] = {}
    for effect in effects:
        if not is_error_map(effect):
            continue
        witness = causes[effect.joint]
        by_ripple = None if witness.ripple is None else witness.ripple.likely
        agreed = witness.agreement is not None and witness.agreement.holds
        of_joint = by_ripple or (agreed and effect.knots >= MAPS.fine_knots)
        if witness.cause is None and not of_joint and effect.id == JointErrorMap.id:
            continue
        likely = witness.cause or by_ripple or "sensor"
        form = (effect.of, effect.knots, effect.spectrum)
        names[effect] = _NAMES[likely](*form)
        others = [kind(*form) for name, kind in _NAMES.items() if name != likely]
        alternatives[effect] = () if witness.cause else tuple(others)
    return names, alternatives
