"""A base that moved slowly and smoothly while a campaign lasted: too little to be a wander.

A drift is known between poses, and not past a stretch of time, so every tenth pose is held out in
turn. The search's blocks are stretches of time, which see hardly more of it than a constant rate.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pa10cal.discovery.blocked_cv.candidate import standard_error
from pa10cal.discovery.blocked_cv.held_poses import FoundAfter, HeldPoses, proof_of
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.family import sought, why_unknown
from pa10cal.discovery.in_time.channel import like_a_scan
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.in_time import BaseDrift

#: Cosines along each axis: a drift that turns back more often is a wander.
WAVES = 6
#: Part of the readings that must have a time of their own.
_OWN_TIMES = 0.95


def slow_drift(survey: Survey, held: HeldPoses, there: Sequence[Effect]) -> tuple[FoundAfter, ...]:
    """Return a slow drift beside the effects found, where it helps.

    Args:
        survey: the campaign.
        held: its poses, predicted by the model found.
        there: the effects found.
    """
    poses = survey.poses
    time_s = poses.states.time_s
    known = len(np.unique(time_s)) > _OWN_TIMES * len(poses)
    if survey.wander is not None or poses.states.campaign is not None or not known:
        return ()
    if like_a_scan(poses) or not poses.states.tells_time:
        return ()
    drift = BaseDrift("base", float(time_s.min()), float(time_s.max()), WAVES)
    without, with_drift = held.squares(), held.squares([drift])
    if not held.helps(without, with_drift):
        return ()
    others = []
    for effect in _effects_of_time(survey, there):
        lost = held.squares([effect]).total - with_drift.total
        if lost.sum() <= standard_error(lost):
            others.append(effect)
    return (FoundAfter(drift, proof_of(without, with_drift), tuple(others)),)


def _effects_of_time(survey: Survey, there: Sequence[Effect]) -> list[Effect]:
    """Return named effects of time that are not in the model, and can be computed."""
    held = {effect.id for effect in there}
    return [
        effect
        for effect in sought(survey.context, survey.baseline.model.terms)
        if effect.goes_with_time
        and not effect.generic
        and effect.id not in held
        and why_unknown(effect, survey.poses.states, logged=survey.torques_logged, weights=True)
        is None
    ]
