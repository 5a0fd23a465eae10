"""What the search of a survey comes to, fitted; and what is found after it beside that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pa10cal.discovery.blocked_cv.arrivals import arrivals, by_arrival
from pa10cal.discovery.blocked_cv.bands import InBands, in_bands
from pa10cal.discovery.blocked_cv.candidate import SPACINGS, Candidate
from pa10cal.discovery.blocked_cv.finest import Level, finest, level
from pa10cal.discovery.blocked_cv.held_poses import FoundAfter, HeldPoses
from pa10cal.discovery.blocked_cv.reference import weighted_rows
from pa10cal.discovery.blocked_cv.refit import Refit, refit
from pa10cal.discovery.blocked_cv.rows import Rows, ShapedEffect
from pa10cal.discovery.blocked_cv.search import Step
from pa10cal.discovery.blocked_cv.searched import Searched, searched_rows
from pa10cal.discovery.blocked_cv.selection import Columns
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.weights import AS_FOUND


@dataclass(frozen=True, eq=False)
class Found:
    """What a survey comes to."""

    survey: Survey  # the campaign, with the motion of its base as these effects leave it
    rows: Rows  # by which it was searched
    searched: Searched  # what the search found
    fine: Level  # the effects, by linear least squares
    finer_steps: tuple[Step, ...]  # steps to finer maps
    bands: InBands | None = None  # of maps that have one; None where none has

    @cached_property
    def extended(self) -> Refit:
        """Return the model with the effects, fitted."""
        effects = tuple(member.effect for member in self.fine.members)
        _, amounts = self.fine.fit(len(effects))
        widening = AS_FOUND if self.bands is None else self.bands.widening
        return refit(self.survey, effects, amounts, self.rows.weights, widening)

    @property
    def held_poses(self) -> HeldPoses:
        """Return every tenth pose, predicted by the model and weighed as its fit weighs them."""
        return HeldPoses(self.survey, self.extended, self.searched.least_gain)


def found_in(judged: Survey, shaped: tuple[ShapedEffect, ...], error_rate: float) -> Found:
    """Search a survey."""
    rows = weighted_rows(judged, shaped, SPACINGS[-1][0])
    searched = searched_rows(rows, error_rate)
    found = _settled(Found(judged, rows, searched, *finest(rows, searched.members)))
    if judged.context.commanded:
        found = with_more(found, arrivals(judged, found.held_poses, found.extended.effects))
    found = _settled(_with_bands(found))
    held = found.held_poses if judged.lag is not None else None
    if held is not None and not held.helps(held.squares(lag=False), held.squares()):
        found = replace(found, survey=replace(found.survey, lag=None))
    return found


def _with_bands(found: Found) -> Found:
    """Return what was found with maps in the bands that the data have, where they have some."""
    bands = in_bands(found.rows, found.fine)
    if bands is None:
        return found
    before, after = bands.of_time.T
    step = Step(bands.level.members, found.fine.squares * after / before)
    steps = (*found.finer_steps, step)
    return replace(found, fine=bands.level, finer_steps=steps, bands=bands)


def _settled(found: Found) -> Found:
    """Return what was found, what its survey has beside the model as these effects leave it."""
    beside = sum(len(each.sizes) for each in found.survey.nuisances)
    if not beside:
        return found
    own, _ = found.fine.fit(len(found.fine.members))
    return replace(found, survey=found.survey.with_amounts(own[len(own) - beside :]))


def with_more(found: Found, more: Sequence[FoundAfter]) -> Found:
    """Return what was found with effects beside it; a slow drift takes the place of a constant."""
    if not more:
        return found
    searched, names = found.searched, {(each.effect.id, each.effect.of) for each in more}
    stays = [k for k, each in enumerate(found.fine.members) if each.name not in names]
    places = {each.effect.of for each in more if by_arrival(each.effect)}
    none = Columns(np.zeros(0, np.intp), np.zeros(0))
    members = (
        *(found.fine.members[k] for k in stays),
        *(Candidate(ShapedEffect(each.effect), none) for each in more),
    )
    shaped = tuple(each.shaped for each in members if not each.is_map)
    fine = level(replace(found.rows, shaped=shaped), members)
    in_time = any(each.effect.goes_with_time for each in more)
    return replace(
        found,
        searched=replace(
            searched,
            members=members,
            # The same motion is not told twice.
            nameless=tuple(
                each for each in searched.nameless if not (in_time and each.goes_with_time)
            ),
            # Nor is what was tried in vain in the search, and helped after it, in any form.
            tried=tuple(
                each
                for each in searched.tried
                if (each.effect.id, each.effect.of) not in names
                and not (by_arrival(each.effect) and each.effect.of in places)
            ),
            predictions=(
                *(searched.predictions[k] for k in stays),
                *(each.proof for each in more),
            ),
            alternatives=(
                *(searched.alternatives[k] for k in stays),
                *(each.alternatives for each in more),
            ),
        ),
        fine=fine,
        finer_steps=(*found.finer_steps, Step(members, fine.squares)),
    )
