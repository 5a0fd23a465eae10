"""No harm to held-out poses: the last check of a verdict, which selects no effect.

Where held-out poses are predicted worse than before, even by a new fit without effects, the
extended model is replaced by the calibrated one: beyond the joint positions of the fit or, if that
is not enough, everywhere. A name with which they are predicted worse by far more than its
uncertainty explains is contradicted.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from pa10cal.arrays import Mask
from pa10cal.calibration.accuracy import summarise
from pa10cal.discovery.finding import Finding
from pa10cal.discovery.gap import PairedErrors, beside_motion, fallen_back, trusted
from pa10cal.discovery.linear import position_noise, residual_and_jacobian
from pa10cal.discovery.rules import NAMES
from pa10cal.discovery.verdict import (
    Basis,
    Scorer,
    Verdict,
    is_named,
    without_names,
)
from pa10cal.fit.angles_seen import AngleCoverage, nothing_seen, span_visited
from pa10cal.fit.fitted import FallBack
from pa10cal.observe.observations import average_repeats
from pa10cal.observe.order import HeldOutPlaces
from pa10cal.results.evaluation import BeforeAfter
from pa10cal.terms.effects.effect import JointEffect

S = TypeVar("S", bound=Scorer)
B = TypeVar("B", bound=Basis)


def harmed(held_out: PairedErrors | None, other: PairedErrors | None = None) -> bool:
    """Return whether held-out poses are predicted worse than before, or than after another fit."""
    if held_out is None:
        return False
    if other is not None:
        held_out = replace(held_out, found_before=other.found_after)
    return _harm(held_out, np.ones(len(held_out.poses), dtype=bool)) is not None


def harmless(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict whose extended model predicts held-out poses no worse than before.

    Nor those at stretches of a path that the fit has not seen.
    """
    visited = span_visited(found.prepared.readings.states.q_rad)
    found = _without_harmful(_without_contradicted(found, visited))
    found = _harmless_to_every_campaign(found)
    falls_back = limits(found)
    if falls_back is None:
        return found
    return replace(only_within(found, falls_back.within), falls_back=falls_back)


def limits(found: Verdict) -> FallBack | None:
    """Return where a verdict's model must fall back on the calibrated one; None for nowhere.

    No held-out poses are to be predicted worse: neither all, nor those at unseen stretches of a
    path, nor those of the most harmed campaign of a group.
    """
    held_out = found.trusted_holdout
    if held_out is None:
        return None
    visited = span_visited(found.prepared.readings.states.q_rad)
    outside = ~visited.inside(held_out.poses.states.q_rad)
    fitted = average_repeats(found.prepared.readings)
    judged = [np.ones_like(outside)]
    if (unseen := HeldOutPlaces.of(held_out.poses, fitted).unseen) is not None:
        judged.append(unseen)
    if (most := _most_harmed(found)) is not None:
        judged.append(held_out.campaigns[most[0]])

    def first_harm(gap: PairedErrors) -> BeforeAfter | None:
        return next((harm for rows in judged if (harm := _harm(gap, rows)) is not None), None)

    harm_outside = _harm(held_out, outside)
    harm = first_harm(held_out) or harm_outside
    if harm is None:
        return None
    within, where, then = nothing_seen(len(visited.turns)), "", "everywhere"
    may_be_outside = found.falls_back is None and outside.any()
    if may_be_outside and first_harm(fallen_back(held_out, outside)) is None:
        harm, within = harm_outside or harm, visited
        where, then = " beyond the joint positions of the fit", "there"
    what = "with the effects" if found.findings else "by the model fitted anew"
    why = (
        f"held-out poses{where} are predicted worse {what}: {harm.before.rms_mm:.4f} mm rms "
        f"before, {harm.after.rms_mm:.4f} mm after; the extended model is the calibrated one {then}"
    )
    return FallBack(within, found.baseline, why)


def _without_contradicted(found: Verdict[S], visited: AngleCoverage) -> Verdict[S]:
    """Return the verdict without names that held-out poses contradict.

    Motion of the base that was found is no fault of a name: it is subtracted here.
    """
    while (contradiction := _contradiction(found, visited)) is not None:
        rows, harm = contradiction
        names = [name for name in found.effects if is_named(name.effect)]
        if not names:
            break
        # Names of joints that left the visited positions there; all names where there are none.
        assert found.trusted_holdout is not None
        q_rad = found.trusted_holdout.poses.states.q_rad[rows]
        left = np.any(~visited.covers(q_rad), axis=0)
        of_joints = [
            name
            for name in names
            if isinstance(name.effect, JointEffect) and left[name.effect.joint - 1]
        ]
        rms_mm = f"{harm.before.rms_mm:.4f} mm rms before and {harm.after.rms_mm:.4f} mm with it"
        why = f"held-out poses contradict it, {rms_mm}"
        found = without_names(found, dict.fromkeys(of_joints or names, why))
    return found


def _contradiction(found: Verdict, visited: AngleCoverage) -> tuple[Mask, BeforeAfter] | None:
    """Return held-out poses (P,) that contradict names, and their errors; None for no such poses.

    They are those beyond the visited joint positions, or else all.
    """
    if (held_out := found.trusted_holdout) is None:
        return None
    held_out = beside_motion(held_out)
    outside = ~visited.inside(held_out.poses.states.q_rad)
    for rows in (outside, np.ones_like(outside)):
        harm = _harm(held_out, rows)
        if harm is None or not _is_over(NAMES.much_worse_ratio, harm):
            continue
        if _beyond_uncertainty(found, held_out, rows):
            return rows, harm
    return None


def _without_harmful(found: Verdict[S]) -> Verdict[S]:
    """Return the verdict without those of several names that significantly harm held-out poses.

    Such an effect may be there, if what it depends on is not known: a base that tilts under weights
    that nobody stated.
    """
    while len(names := [name for name in found.effects if is_named(name.effect)]) > 1:
        worse: dict[Finding, BeforeAfter] = {}
        for name in names:
            without = found.errors_by_name.without[name.effect]
            gap = None if found.holdout is None else replace(found.holdout, found_before=without)
            if (gap := trusted(gap, found.prepared.suspected)) is None:
                return found
            harm, _, surely = _worse(gap, np.ones(len(gap.poses), dtype=bool))
            if surely and harm is not None:
                worse[name] = harm
        if not worse:
            break
        name = max(worse, key=lambda name: _ratio(worse[name]))
        harm = worse[name]
        rms_mm = f"{harm.before.rms_mm:.4f} mm rms for {harm.after.rms_mm:.4f} mm"
        found = without_names(found, {name: f"held-out poses do better without it, {rms_mm}"})
    return found


def _harmless_to_every_campaign(found: Verdict[S]) -> Verdict[S]:
    """Return the verdict on a group in which none of its campaigns is predicted worse.

    Beyond the joint positions of the other campaigns the extended model falls back on the
    calibrated one. If that is not enough an effect goes: the one without which the campaign is not
    harmed and all held-out poses are best, or else that campaign is best.
    """
    while found.effects and (most := _most_harmed(found)) is not None:
        campaign, harm = most
        worse = (
            f"held-out poses of campaign {campaign} are predicted worse, "
            f"{harm.before.rms_mm:.4f} mm rms before and {harm.after.rms_mm:.4f} mm after"
        )
        others = ~found.train.campaigns[campaign]
        within = span_visited(found.train.poses.states.q_rad[others])
        apart = only_within(found, within)
        if _most_harmed(apart) is None:
            why = (
                f"with the effects {worse}; the extended model is the calibrated one beyond the "
                "joint positions of the other campaigns"
            )
            return replace(apart, falls_back=FallBack(within, found.baseline, why))
        tried = [without_names(found, {name: f"with it {worse}"}) for name in found.effects]
        found = min(tried, key=lambda one: (_is_harmed(one, campaign), _error_mm(one, campaign)))
    return found


def only_within(found: Verdict[B], within: AngleCoverage) -> Verdict[B]:
    """Return the verdict with the calibrated model's errors beyond some joint positions."""
    return found.with_gaps(
        lambda gap: fallen_back(gap, ~within.inside(gap.poses.states.q_rad)),
    )


def _error_mm(found: Verdict, campaign: str) -> float:
    """Return the error of held-out poses, or of those of a campaign if they are harmed."""
    gap = found.trusted_holdout
    assert gap is not None
    rows = gap.campaigns[campaign] if _is_harmed(found, campaign) else slice(None)
    return summarise(gap.found_after, rows).rms_mm


def _most_harmed(found: Verdict) -> tuple[str, BeforeAfter] | None:
    """Return the campaign of a group that is predicted worse by most, and its errors.

    None where none is predicted worse.
    """
    if (gap := found.trusted_holdout) is None:
        return None
    every = ((name, gap.accuracies(rows)) for name, rows in gap.campaigns.items())
    worse = [(name, harm) for name, harm in every if harm and _is_harmed(found, name)]
    return max(worse, key=lambda pair: _ratio(pair[1]), default=None)


def _ratio(harm: BeforeAfter) -> float:
    return harm.after.rms_mm / harm.before.rms_mm


def _is_harmed(found: Verdict, campaign: str) -> bool:
    """Return whether held-out poses of a campaign are predicted worse by more than chance.

    Where they are too few to be significant, the fitted poses of that campaign decide: an effect
    that only suits the other campaigns makes them worse, too.
    """

    def worse(gap: PairedErrors | None) -> tuple[bool, bool]:
        if gap is None or campaign not in gap.campaigns:
            return False, False
        return _worse(gap, gap.campaigns[campaign])[1:]

    over, surely = worse(found.trusted_holdout)
    return surely or (over and worse(found.train)[1])


def _worse(gap: PairedErrors, rows: Mask) -> tuple[BeforeAfter | None, bool, bool]:
    """Return errors of configurations (P,), whether they are worse, and whether significantly."""
    harm, paired = gap.accuracies(rows), gap.reduction_of(rows)
    over = harm is not None and _is_over(NAMES.worse_ratio, harm)
    return harm, over, over and paired.poses > 1 and paired.interval95_mm[1] < 0.0


def _harm(gap: PairedErrors, rows: Mask) -> BeforeAfter | None:
    """Return the errors of configurations (P,) that are predicted worse; None where they are not.

    They count as worse if significantly so, or if larger by the factor `NAMES.worse_ratio`.
    """
    harm = gap.accuracies(rows)
    if harm is None:
        return None
    paired = gap.reduction_of(rows)
    worse = harm.after.mean_mm > NAMES.trifling_ratio * harm.before.mean_mm
    surely = worse and paired.poses > 1 and paired.interval95_mm[1] < 0.0
    return harm if _is_over(NAMES.worse_ratio, harm) or surely else None


def _is_over(factor: float, harm: BeforeAfter) -> bool:
    """Return whether the mean or the root mean square is larger by more than a factor."""
    before, after = harm.before, harm.after
    return after.mean_mm > factor * before.mean_mm or after.rms_mm > factor * before.rms_mm


def _beyond_uncertainty(found: Verdict, gap: PairedErrors, rows: Mask) -> bool:
    """Return whether errors exceed what noise and the uncertainty of the model explain.

    The scatter of single poses, where it is known, takes the place of noise.
    """
    poses = gap.poses.take(rows)
    jacobian = residual_and_jacobian(found.extended.at, poses)[1]
    covariance = found.covariance[: jacobian.shape[2], : jacobian.shape[2]]
    spread = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
    floor_mm = gap.noise_floor_mm
    if (scatter := found.scorer.scatter) is not None:
        spread, floor_mm = spread + scatter.covariance(found.extended.at, poses), 0.0
    variance = np.trace(position_noise(poses.measured, spread), axis1=1, axis2=2)
    expected_mm = np.hypot(floor_mm, 1e3 * np.sqrt(variance.mean()))
    after_mm = summarise(gap.found_after, rows).rms_mm
    return bool(after_mm > NAMES.contradicted_ratio * expected_mm)
