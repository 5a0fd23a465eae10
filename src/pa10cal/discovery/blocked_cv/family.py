"""The candidates of a survey: all effects and maps, and which of them its poses can show.

All of it is settled before residuals are looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.discovery.blocked_cv.block_rows import BlockedRows, ShapedEffect
from pa10cal.discovery.blocked_cv.effect_set import Candidate, Columns
from pa10cal.discovery.blocked_cv.normal_equations import BlockEquations
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.finding import Untestable
from pa10cal.discovery.preparation import computable, sought, why_few_angles, why_hidden
from pa10cal.discovery.rules import BLOCKS, EVIDENCE, MAPS
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.periodic_spline import harmonic_orders
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import FadingPrior, JointErrorMap, is_error_map
from pa10cal.terms.statement_faults import is_fault


@dataclass(frozen=True)
class Family:
    """The candidates of a survey."""

    shown: tuple[Candidate, ...]  # candidates that these poses can show, all forms of each
    hidden: tuple[Untestable, ...]  # effects that they cannot show
    # of each effect shown, by name: the 5 % quantile, over directions of its parameters, of the
    # expected decrease of chi-square over all poses, at its plausible size and with the model's own
    # parameters estimated too
    gains: dict[tuple[str, str], float]


def computable_shapes(survey: Survey) -> tuple[tuple[ShapedEffect, ...], tuple[Untestable, ...]]:
    """Return the effects that can be computed from what is known of the poses, and the others.

    Each computable effect at each of its shapes; maps are not among them.
    """
    effects = (*survey.begins_with, *sought(survey.context, survey.baseline.model.terms))
    # What the survey begins with is first, and in its own form.
    by_name = {(effect.id, effect.of): effect for effect in effects}
    by_name |= {(effect.id, effect.of): effect for effect in survey.begins_with}
    known, refused = computable(
        (effect for effect in by_name.values() if not is_error_map(effect)),
        survey.poses.states,
        logged=survey.torques_logged,
        weights=True,
    )
    return (
        tuple(ShapedEffect(each, shape) for each in known for shape in range(len(each.starts))),
        tuple(each for each in refused if not is_fault(each.effect)),
    )


def map_candidates(rows: BlockedRows) -> list[Candidate]:
    """Return maps of every revolute joint in all spacings, smoothnesses and sizes."""
    found = []
    for joint, (knots, half_order), size_rad in product(rows.joints, MAPS.spacings, MAPS.sizes_rad):
        spectrum = FadingPrior(size_rad, half_order)
        # An even number K of knots determines only one of the two parts of order K / 2.
        harmonics = knots - (1 if knots == rows.knots else 2)
        sizes_rad = spectrum.sizes_rad(harmonic_orders(rows.knots)[1 : 1 + harmonics])
        shaped = ShapedEffect(JointErrorMap(f"joint {joint}", knots, spectrum))
        found.append(Candidate(rows.columns_of_map(joint)[:harmonics], sizes_rad, shaped))
    return found


def family(rows: BlockedRows, equations: BlockEquations) -> Family:
    """Return the candidates that these poses can show, and the effects that they cannot."""
    total, of_model = equations.summed().gram, rows.baseline_columns
    model = Gaussian.of_products(total[np.ix_(of_model, of_model)])
    beside_model = partial(_gram_beside_model, total, of_model, model)
    shown, followed, refused = [], [], {}
    gains: dict[tuple[str, str], float] = {}
    effects = [
        Candidate(part, np.ones(len(part)), shaped)
        for shaped, index in zip(rows.shaped, rows.columns_of_effects(), strict=True)
        for part in (index, *(index[list(places)] for places in shaped.effect.parts))
    ]
    few_angles = _few_angles(rows)
    for candidate in (*effects, *map_candidates(rows)):
        whole, distinct = beside_model(candidate)
        why = _why_hidden(rows, candidate, whole, distinct) or few_angles(candidate.effect)
        if why is None:
            shown.append(candidate)
            gain = _low_expected_gain(distinct)
            gains[candidate.name] = max(gains.get(candidate.name, 0.0), gain)
        elif not is_fault(candidate.effect):
            refused[candidate.name] = Untestable(_usual_form(candidate.effect), why)
            if why_hidden(1.0, _signal(distinct)) is None:
                followed.append(candidate)
    for candidate in _alike(followed, shown, beside_model):
        shown.append(candidate)
        gains[candidate.name] = _low_expected_gain(beside_model(candidate)[1])
    hidden = tuple(found for name, found in refused.items() if name not in gains)
    return Family(tuple(shown), hidden, gains)


def below_detection_limit(
    found: Family, is_surely_found: Callable[[float], bool]
) -> tuple[Untestable, ...]:
    """Return the effects that are sought and may well be missed at their plausible size."""
    effects = {
        candidate.name: _usual_form(candidate.effect)
        for candidate in found.shown
        if not is_fault(candidate.effect)
    }
    return tuple(
        Untestable(
            effects[name],
            f"at its plausible size it stands {np.sqrt(gain):.1f} standard deviations out of the "
            "noise of all poses together, too little to be found in 95 of 100 such campaigns",
        )
        for name, gain in found.gains.items()
        if name in effects and not is_surely_found(gain)
    )


def _gram_beside_model(
    gram: Array, of_model: Index, model: Gaussian, columns: Columns
) -> tuple[Array, Array]:
    """Return the products of columns in units of their sizes, (k, k) each.

    First of the whole columns, then of their part that the model's parameters cannot follow.
    """
    index, sizes = columns.index, columns.sizes
    across = gram[np.ix_(of_model, index)] * sizes
    whole = gram[np.ix_(index, index)] * np.outer(sizes, sizes)
    return whole, model.of_further(across, whole, np.zeros(len(index))).gram


def _low_expected_gain(distinct: Array) -> float:
    """Return the 5 % quantile, over directions, of the gain of an effect of plausible size.

    Poses may show one parameter well and another hardly. `distinct` (k, k) are the products of
    what the model cannot follow of the effect's columns, in units of their sizes.
    """
    values = np.maximum(np.linalg.eigvalsh(distinct), 0.0)
    return float(np.quantile(_shares(len(values)) @ values, BLOCKS.hidden_share))


@cache
def _shares(count: int) -> Array:
    """Return the squares (N, k) of k parameters in N random directions, of mean one in each."""
    drawn = np.random.default_rng(0).standard_normal((BLOCKS.directions, count)) ** 2
    return np.asarray(drawn / drawn.mean(axis=1, keepdims=True))


def _why_hidden(
    rows: BlockedRows, candidate: Candidate, whole: Array, distinct: Array
) -> str | None:
    """Return why the poses cannot show a candidate; None where they can."""
    if not np.trace(whole) > 0.0:
        return _why_zero(rows.survey.poses.states, candidate.shaped)
    share = float(np.sqrt(max(np.trace(distinct), 0.0) / np.trace(whole)))
    return why_hidden(share, _signal(distinct))


def _signal(distinct: Array) -> float:
    """Return the size of the part (k, k) that the model cannot follow, in standard deviations."""
    return float(np.sqrt(max(np.linalg.eigvalsh(distinct)[-1], 0.0)))


def _alike(
    followed: Sequence[Candidate],
    shown: Sequence[Candidate],
    beside_model: Callable[[Columns], tuple[Array, Array]],
) -> list[Candidate]:
    """Return those of one column whose part beside the model is that of such a candidate shown.

    What the model nearly follows is shown all the same then, as a scale of the instrument beside
    the lead of a quill: poses do not tell which of them is there.
    """
    first, second = ([c for c in each if len(c.index) == 1] for each in (followed, shown))
    if not first or not second:
        return []
    distinct = beside_model(Columns.together([*first, *second]))[1]
    size = np.sqrt(np.diag(distinct))
    same = np.abs(distinct) >= EVIDENCE.indistinguishable * np.outer(size, size)
    return [each for k, each in enumerate(first) if same[k, len(first) :].any()]


def _few_angles(rows: BlockedRows) -> Callable[[Effect], str | None]:
    """Return a function that says why a joint took too few angles for a map, see `why_few_angles`.

    Of maps of one joint with as many knots it is asked once.
    """
    states = rows.survey.poses.states
    known: dict[tuple[str, int], str | None] = {}

    def why(effect: Effect) -> str | None:
        if not is_error_map(effect):
            return None
        form = effect.of, effect.knots
        if form not in known:
            known[form] = why_few_angles(effect, states)
        return known[form]

    return why


def _why_zero(states: PoseStates, shaped: ShapedEffect) -> str:
    """Return why all columns of an effect are zero in these poses."""
    arrived = replace(states, arrival=np.ones_like(states.arrival))
    if np.any(shaped.effect.derivative(arrived, shaped.start)):
        return "the direction of arrival is not known"
    return "the poses do not exercise it"


def _usual_form(effect: Effect) -> Effect:
    """Return the map of a joint in its usual form, whatever its spacing; others as they are."""
    return JointErrorMap(effect.of) if is_error_map(effect) else effect
