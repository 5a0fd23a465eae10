"""A search by held-out blocks, and what is known of everything it found."""

from __future__ import annotations

from dataclasses import dataclass

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.candidate import Candidate
from pa10cal.discovery.blocked_cv.family import below_detection_limit, family
from pa10cal.discovery.blocked_cv.judge import (
    Prediction,
    Tried,
    alternatives,
    predictions,
    tried,
    without_rivals,
)
from pa10cal.discovery.blocked_cv.reference import noise_squares
from pa10cal.discovery.blocked_cv.rows import Rows
from pa10cal.discovery.blocked_cv.search import Search, Step
from pa10cal.discovery.finding import NotTestable
from pa10cal.discovery.noise import noise_of_near_poses
from pa10cal.discovery.torque_noise import with_torque_noise
from pa10cal.terms.effects.effect import Effect


@dataclass(frozen=True, eq=False)
class Searched:
    """What the search found, without its products, which are large."""

    members: tuple[Candidate, ...]
    nameless: tuple[Effect, ...]
    tried: tuple[Tried, ...]
    predictions: tuple[Prediction, ...]
    alternatives: tuple[tuple[Effect, ...], ...]
    errors_mm: Array
    hidden: tuple[NotTestable, ...]
    below_detection_limit: tuple[NotTestable, ...]
    steps: tuple[Step, ...]
    candidates: int
    least_gain: float
    noise: float


def searched_rows(rows: Rows, error_rate: float) -> Searched:
    """Search, and judge what was found."""
    products = rows.products()
    known = family(rows, products)
    poses = rows.survey.poses
    of_readings = noise_of_near_poses(poses, rows.survey.left_by(rows.place))
    if rows.survey.torques_logged:
        payload = rows.survey.setup.payload
        of_readings = with_torque_noise(of_readings, rows.place, poses, payload)
    noise = noise_squares(rows, of_readings)
    search = Search(products, rows.own, known.shown, noise, error_rate, rows.own_sizes)
    chosen = search.run()
    others = tried(search, chosen)
    nameless = tuple(member.effect for member in chosen.members if member.effect.generic)
    chosen = without_rivals(chosen)
    proofs, errors_mm = predictions(rows, chosen, search.least_gain)
    return Searched(
        members=chosen.members,
        nameless=nameless,
        tried=others,
        predictions=proofs,
        alternatives=tuple(
            alternatives(search, chosen, member) for member in range(len(chosen.members))
        ),
        errors_mm=errors_mm,
        hidden=known.hidden,
        below_detection_limit=below_detection_limit(known, search.is_surely_found),
        steps=tuple(search.steps),
        candidates=search.effects,
        least_gain=search.least_gain,
        noise=search.noise,
    )
