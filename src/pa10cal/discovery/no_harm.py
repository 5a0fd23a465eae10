"""No harm to held-out poses: the last check of a verdict, which selects no effect.

Where held-out poses are predicted worse than before, even by a new fit without effects, the
calibrated model replaces the extended one: beyond the joint positions of the fit or, if that is not
enough, everywhere. A name is contradicted if with it they are predicted worse by far more than its
uncertainty explains.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from pa10cal.arrays import Mask
from pa10cal.calibration.accuracy import summarise
from pa10cal.discovery.finding import Finding, is_named
from pa10cal.discovery.gap import PairedErrors, fallen_back, trusted
from pa10cal.discovery.jacobians import residual_and_jacobian
from pa10cal.discovery.refitted_verdict import without_names
from pa10cal.discovery.rules import NAMES
from pa10cal.discovery.verdict import Basis, Scorer, Verdict
from pa10cal.fit.fitted import FallBack
from pa10cal.fit.position_errors import position_noise_m2
from pa10cal.fit.repeatability import is_chance
from pa10cal.fit.validity import AngleCoverage, nothing_seen, span_visited
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.observe.paths import HeldOutPlaces
from pa10cal.results.evaluation import BeforeAfter
from pa10cal.terms.effects.effect import JointEffect

S = TypeVar("S", bound=Scorer)
B = TypeVar("B", bound=Basis)


def harmed(held_out: PairedErrors | None) -> bool:
    """Return whether held-out poses are predicted worse than by the calibrated model."""
    return held_out is not None and _harm(held_out, _every(held_out)) is not None


def worse_than(held_out: PairedErrors | None, other: PairedErrors | None) -> bool:
    """Return whether held-out poses are predicted worse than by another extended model."""
    if held_out is None or other is None:
        return False
    return harmed(replace(held_out, found_before=other.found_after))


def harmless(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict whose extended model predicts held-out poses no worse than before.

    Where none are held out, the poses fitted must be fitted no worse.
    """
    if found.trusted_holdout is None:
        return _fits_no_worse(found)
    visited = span_visited(found.prepared.readings.states.q_rad)
    found = _without_harmful(_without_contradicted(found, visited))
    found = _harmless_to_every_campaign(found)
    falls_back = limits(found)
    if falls_back is None:
        return found
    return replace(only_within(found, falls_back.within), falls_back=falls_back)


def _fits_no_worse(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict whose extended model fits the poses no worse than the calibrated one.

    A search that leaves an error without a name to a smooth function weighs readings by it: names
    that are false then fit the poses worse than none. The calibrated model stays then.
    """
    harm = _harm(found.train, _every(found.train))
    if harm is None:
        return found
    why = f"the poses fitted come out worse, and none are held out: {_before_after(harm)}; the"
    why += " extended model is the calibrated one everywhere"
    kept = FallBack(nothing_seen(found.baseline.arm.n), found.baseline, why)
    return replace(only_within(found, kept.within), falls_back=kept)


def limits(found: Verdict) -> FallBack | None:
    """Return where a verdict's model must fall back on the calibrated one; None for nowhere.

    Held-out poses must be predicted no worse: all together, those on stretches of a path that the
    fit has not seen, and those of the most harmed campaign of a group.
    """
    held_out = found.trusted_holdout
    if held_out is None:
        return None
    visited = span_visited(found.prepared.readings.states.q_rad)
    outside = ~visited.inside(held_out.poses.states.q_rad)
    judged = tuple(_judged_alone(found, held_out))

    def first_harm(gap: PairedErrors) -> BeforeAfter | None:
        return next((harm for rows in judged if (harm := _harm(gap, rows)) is not None), None)

    harm_outside = _harm(held_out, outside)
    if harm_outside is not None and _by_chance(found, held_out, outside):
        harm_outside = None
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
        f"held-out poses{where} are predicted worse {what}: {_before_after(harm)}; the extended "
        f"model is the calibrated one {then}"
    )
    return FallBack(within, found.baseline, why)


def _judged_alone(found: Verdict, held_out: PairedErrors) -> Iterator[Mask]:
    """Yield the sets of held-out poses (P,) of which each must be predicted no worse."""
    yield _every(held_out)
    unseen = HeldOutPlaces.of(held_out.poses, average_repeats(found.prepared.readings)).unseen
    if unseen is not None:
        yield unseen
    if (most := _most_harmed(found)) is not None:
        yield held_out.campaigns[most[0]]


def _without_contradicted(found: Verdict[S], visited: AngleCoverage) -> Verdict[S]:
    """Return the verdict without names that held-out poses contradict.

    Motion of the base that was found is subtracted from the errors: no name causes it.
    """
    while (contradiction := _contradiction(found, visited)) is not None:
        rows, harm = contradiction
        names = [name for name in found.effects if is_named(name.effect)]
        if not names:
            break
        # They contradict names of joints that are beyond the positions visited, or else all names.
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
    """Return held-out poses (P,) that contradict names, and their errors; None for none.

    The poses beyond the visited joint positions, or else all poses.
    """
    if (held_out := found.trusted_holdout) is None:
        return None
    held_out = held_out.without_motion or held_out
    outside = ~visited.inside(held_out.poses.states.q_rad)
    for rows in (outside, np.ones_like(outside)):
        harm = _harm(held_out, rows)
        if harm is None or not _is_over(NAMES.much_worse_ratio, harm):
            continue
        if _is_beyond(NAMES.contradicted_ratio, found, held_out, rows):
            return rows, harm
    return None


def _without_harmful(found: Verdict[S]) -> Verdict[S]:
    """Return the verdict without those of several names that significantly harm held-out poses.

    Such an effect may be present, but depend on a quantity that is not known well enough, as the
    tilt of a base on weights that are not stated. Held-out poses are predicted under the torques as
    logged, and so cannot contradict an error of the log.
    """
    while len(names := [name for name in found.effects if is_named(name.effect)]) > 1:
        if (held_out := found.holdout) is None:
            break
        worse: dict[Finding, BeforeAfter] = {}
        for name in names:
            if name.effect.error_of == "log":
                continue
            without = found.errors_by_name.held_out_without[name.effect]
            gap = trusted(replace(held_out, found_before=without), found.prepared.suspected)
            if gap is None:
                return found
            compared = _compare(gap, _every(gap))
            if compared is not None and compared.over and compared.surely:
                worse[name] = compared.errors
        if not worse:
            break
        name = max(worse, key=lambda name: _ratio(worse[name]))
        harm = worse[name]
        rms_mm = f"{harm.before.rms_mm:.4f} mm rms for {harm.after.rms_mm:.4f} mm"
        why = f"held-out poses do better without it, {rms_mm}"
        found = without_names(found, {name: why})
    return found


def _harmless_to_every_campaign(found: Verdict[S]) -> Verdict[S]:
    """Return the verdict on a group in which no campaign is predicted worse.

    The extended model falls back on the calibrated one beyond the joint positions of the other
    campaigns. If that is not enough, an effect is removed: the one without which that campaign is
    not harmed and the error at all held-out poses is smallest, or else that of the campaign.
    """
    while found.effects and (most := _most_harmed(found)) is not None:
        campaign, harm = most
        worse = f"held-out poses of campaign {campaign} are predicted worse, {_before_after(harm)}"
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
    """Return the verdict with the errors of the calibrated model beyond some joint positions."""
    return found.with_gaps(
        lambda gap: fallen_back(gap, ~within.inside(gap.poses.states.q_rad)),
    )


def _error_mm(found: Verdict, campaign: str) -> float:
    """Return the error of held-out poses, of a campaign alone if this is harmed."""
    gap = found.trusted_holdout
    assert gap is not None
    rows = gap.campaigns[campaign] if _is_harmed(found, campaign) else slice(None)
    return summarise(gap.found_after, rows).rms_mm


def _most_harmed(found: Verdict) -> tuple[str, BeforeAfter] | None:
    """Return the most harmed campaign of a group, and its errors; None where none is harmed."""
    if (gap := found.trusted_holdout) is None:
        return None
    every = ((name, gap.accuracies(rows)) for name, rows in gap.campaigns.items())
    worse = [(name, harm) for name, harm in every if harm and _is_harmed(found, name)]
    return max(worse, key=lambda pair: _ratio(pair[1]), default=None)


def _before_after(harm: BeforeAfter) -> str:
    """Return errors before and after in words: root mean squares or means, whichever grew more."""
    before, after = harm.before, harm.after
    if after.rms_mm * before.mean_mm >= after.mean_mm * before.rms_mm:
        return f"{before.rms_mm:.4f} mm rms before, {after.rms_mm:.4f} mm after"
    return f"{before.mean_mm:.4f} mm in the mean before, {after.mean_mm:.4f} mm after"


def _ratio(harm: BeforeAfter) -> float:
    return harm.after.rms_mm / harm.before.rms_mm


def _is_harmed(found: Verdict, campaign: str) -> bool:
    """Return whether held-out poses of a campaign are predicted worse by more than chance.

    If there are too few of them to be significant, the fitted poses of that campaign decide: an
    effect that only suits the other campaigns makes them worse, too. What they lose to a fit of
    the others is one change of the parameters, and not one of each pose.
    """

    def compared(gap: PairedErrors | None) -> _Comparison | None:
        if gap is None or campaign not in gap.campaigns:
            return None
        return _compare(gap, gap.campaigns[campaign])

    held_out, train = compared(found.trusted_holdout), compared(found.train)
    if held_out is None or not held_out.over:
        return False
    if held_out.surely or train is None or not (train.over and train.surely):
        return held_out.surely
    return not _fitted_worse_by_chance(found, train.errors)


def _fitted_worse_by_chance(found: Verdict, errors: BeforeAfter) -> bool:
    """Return whether a refit with the effects' parameters may lose as much at some fitted poses.

    Where effects are present, their parameters move by chance, and with them the sum of squares at
    these poses by chi square of as many components. The scatter is that of the poses themselves.
    """
    parameters = sum(len(finding.x) for finding in found.findings)
    before, after = errors.before, errors.after
    components = before.configurations * _components(found.train.poses)
    scatters = components * ((after.rms_mm / before.rms_mm) ** 2 - 1.0)
    return parameters > 0 and is_chance(scatters / parameters, parameters)


def _every(gap: PairedErrors) -> Mask:
    return np.ones(len(gap.poses), dtype=bool)


class _Comparison(NamedTuple):
    """Errors of some poses before and after."""

    errors: BeforeAfter
    over: bool  # whether those after are larger by the factor `NAMES.worse_ratio`
    surely: bool  # whether their mean is significantly larger


def _compare(gap: PairedErrors, rows: Mask) -> _Comparison | None:
    """Compare the errors of poses (P,); None where there are none."""
    errors = gap.accuracies(rows)
    if errors is None:
        return None
    paired = gap.reduction_of(rows)
    surely = paired.poses > 1 and paired.interval95_mm[1] < 0.0
    return _Comparison(errors, _is_over(NAMES.worse_ratio, errors), surely)


def _harm(gap: PairedErrors, rows: Mask) -> BeforeAfter | None:
    """Return the errors of poses (P,) if they are predicted worse, else None.

    Worse by the factor `NAMES.worse_ratio`, or significantly and by more than a trifle.
    """
    compared = _compare(gap, rows)
    if compared is None:
        return None
    errors = compared.errors
    more = errors.after.mean_mm > NAMES.trifling_ratio * errors.before.mean_mm
    return errors if compared.over or (more and compared.surely) else None


def _is_over(factor: float, harm: BeforeAfter) -> bool:
    """Return whether mean or root mean square are larger after by more than a factor."""
    before, after = harm.before, harm.after
    return after.mean_mm > factor * before.mean_mm or after.rms_mm > factor * before.rms_mm


def _by_chance(found: Verdict, gap: PairedErrors, rows: Mask) -> bool:
    """Return whether poses may be predicted worse by chance, as one or two in gaps of the fit."""
    compared = _compare(gap, rows)
    surely = compared is not None and compared.surely
    return not surely and not _is_beyond(1.0, found, gap, rows)


def _is_beyond(ratio: float, found: Verdict, gap: PairedErrors, rows: Mask) -> bool:
    """Return whether errors exceed what noise and the uncertainty of the model explain.

    By a ratio at least, and where poses are few by more than chance allows. The scatter of single
    poses replaces the noise where it is known.
    """
    poses = gap.poses.take(rows)
    jacobian = residual_and_jacobian(found.extended.at, poses)[1]
    covariance = found.covariance[: jacobian.shape[2], : jacobian.shape[2]]
    spread = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
    floor_mm = gap.noise_rms_mm
    if (scatter := found.scorer.scatter) is not None:
        spread, floor_mm = spread + scatter.covariance(found.extended.at, poses), 0.0
    variance = np.trace(position_noise_m2(poses.measured, spread), axis1=1, axis2=2)
    expected_mm = np.hypot(floor_mm, 1e3 * np.sqrt(variance.mean()))
    over = summarise(gap.found_after, rows).rms_mm / float(expected_mm)
    return over > ratio and not is_chance(over**2, len(poses) * _components(poses))


def _components(poses: Observations) -> int:
    """Return how many independent components the error of a pose has, however many targets."""
    return min(3, len(poses.measured.position_columns))
