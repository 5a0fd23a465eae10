"""Maps whose cause the motor's ripple says, under the name of that cause."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pa10cal.discovery.blocked_cv.candidate import SPACINGS
from pa10cal.discovery.blocked_cv.rows import ShapedEffect
from pa10cal.discovery.joint_series import joint_series
from pa10cal.discovery.motor_ripple import witnesses
from pa10cal.discovery.same_everywhere import agreement
from pa10cal.discovery.sensor_or_gear import JointCause
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.sensor_error import GearError, SensorError
from pa10cal.terms.model import Model

if TYPE_CHECKING:
    from pa10cal.discovery.blocked_cv.discover import VerdictByBlocks
    from pa10cal.terms.effects.effect import Effect

#: Knots of a map that follows ten waves a turn and more.
_FINE_KNOTS = SPACINGS[1][0]
_NAMES: Mapping[str, type[JointErrorMap]] = {"sensor": SensorError, "gear": GearError}


def with_causes(found: VerdictByBlocks) -> VerdictByBlocks:
    """Return a verdict in which maps bear the name of their cause, where that is known.

    Where by the ripple both err, or campaigns and turns do not show that the error is the joint's
    own, a map is ambiguous between sensor and gear. So is, without a ripple, a map
    of fine waves on which campaigns or turns agree, and one that was named already: nothing beside
    sensor and gear turns a joint to and fro ten times a turn. Any other map of a joint whose motor
    shows no ripple stays a map.
    """
    causes = _causes(found)
    names: dict[Effect, Effect] = {}
    alternatives: dict[Effect, tuple[Effect, ...]] = {}
    for effect in found.extended.effects:
        if not isinstance(effect, JointErrorMap):
            continue
        cause = causes[effect.joint]
        heard = None if cause.witness is None else cause.witness.likely
        agreed = cause.agreement is not None and cause.agreement.holds
        own = agreed and effect.knots >= _FINE_KNOTS
        if cause.cause is None and not (heard or own) and effect.id == JointErrorMap.id:
            continue
        likely = cause.cause or heard or "sensor"
        form = (effect.of, effect.knots, effect.spectrum)
        names[effect] = _NAMES[likely](*form)
        others = [kind(*form) for name, kind in _NAMES.items() if name != likely]
        alternatives[effect] = () if cause.cause else tuple(others)
    return _renamed(replace(found, causes=tuple(causes.values())), names, alternatives)


def _causes(found: VerdictByBlocks) -> dict[int, JointCause]:
    """Return what is known of the cause of every map, by joint."""
    joints = [each.joint for each in found.extended.effects if isinstance(each, JointErrorMap)]
    if not joints:
        return {}
    survey, at = found.survey, found.extended.at
    series = joint_series(
        at,
        survey.poses,
        survey.left_by(at),
        found.extended.weights.whiteners(np.arange(len(survey.poses))),
        joints,
    )
    said = witnesses(series, at.arm.gear_ratio)
    return {j: JointCause(j, said[j - 1], agreement(series[j - 1])) for j in sorted(joints)}


def _renamed(
    found: VerdictByBlocks,
    names: Mapping[Effect, Effect],
    alternatives: Mapping[Effect, tuple[Effect, ...]],
) -> VerdictByBlocks:
    """Return a verdict with effects under other names of the same form."""
    if not names:
        return found

    def name_of(effect: Effect) -> Effect:
        return names.get(effect, effect)

    extended, fine = found.extended, found.finest
    terms = tuple(names.get(term, term) for term in extended.model.terms)  # type: ignore[call-overload]
    return replace(
        found,
        findings=tuple(
            replace(
                each,
                effect=name_of(each.effect),
                alternatives=(*each.alternatives, *alternatives.get(each.effect, ())),
            )
            for each in found.findings
        ),
        extended=replace(
            extended,
            effects=tuple(map(name_of, extended.effects)),
            at=replace(extended.at, model=Model(extended.model.chain, terms)),
        ),
        finest=replace(
            fine,
            members=tuple(
                replace(
                    each,
                    shaped=ShapedEffect(name_of(each.shaped.effect), each.shaped.shape),
                )
                for each in fine.members
            ),
        ),
    )
