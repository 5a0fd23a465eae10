"""No harm: held-out poses are never predicted worse for the effects that a model was given.

The check comes last and chooses no effect. Where held-out poses are predicted worse than before,
be it for the weights of a fit without effects, the extended model is the calibrated one: beyond
the joint positions that the fit has visited, or, where that does not do, everywhere. A name that
predicts them worse by far more than its own uncertainty allows is contradicted, and is no name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.accuracy import summarise
from pa10cal.discovery.finding import Finding, Unexplained
from pa10cal.discovery.gap import Gap, beside_motion, fallen_back, reduction, trusted
from pa10cal.discovery.linear import position_noise, residual_and_jacobian
from pa10cal.discovery.verdict import FallsBack, Verdict, is_named, label_of
from pa10cal.fit.angles_seen import AnglesSeen, nothing_seen, span_visited
from pa10cal.results.accuracy import Accuracy
from pa10cal.terms.effects.effect import JointEffect

V = TypeVar("V", bound=Verdict[object])
Rows = NDArray[np.bool_]

#: Errors larger than before by this factor are worse, whatever chance may do.
WORSE = 1.02
#: By this factor they speak against a name.
MUCH_WORSE = 1.05
#: Errors larger by less than this are the same, however sure it is.
TRIFLING = 1.005
#: Errors over what noise and the model's own uncertainty explain by which a name is contradicted.
CONTRADICTED = 1.5


@dataclass(frozen=True)
class _Harm:
    """Held-out poses that are predicted worse than before: errors before and after."""

    before: Accuracy
    after: Accuracy

    def over(self, factor: float) -> bool:
        """Return whether their mean or their root mean square is larger by more than a factor."""
        return (
            self.after.mean_mm > factor * self.before.mean_mm
            or self.after.rms_mm > factor * self.before.rms_mm
        )

    @property
    def errors(self) -> str:
        """Return both errors in words."""
        return f"{self.before.rms_mm:.4f} mm rms before and {self.after.rms_mm:.4f} mm with it"


def harmless(found: V) -> V:
    """Return a verdict whose extended model predicts held-out poses no worse than before."""
    if found.holdout is None:
        return found
    visited = span_visited(found.prepared.readings.states.q_rad)
    found = _without_contradicted(found, visited)
    held_out = trusted(found.holdout, found.prepared.suspected)
    if held_out is None:
        return found
    outside = ~visited.inside(held_out.poses.states.q_rad)
    there, all_over = _harm(held_out, outside), _harm(held_out, np.ones_like(outside))
    if there is None and all_over is None:
        return found
    if outside.any() and _harm(fallen_back(held_out, outside), np.ones_like(outside)) is None:
        return _falling_back(found, visited, there or all_over)
    return _falling_back(found, nothing_seen(len(visited.turns)), all_over or there)


def _falling_back(found: V, within: AnglesSeen, harm: _Harm | None) -> V:
    """Return the verdict with a model that holds within some joint positions alone."""
    assert harm is not None
    everywhere = not any(len(stretches) for stretches in within.intervals)
    where = "" if everywhere else " beyond the joint positions of the fit"
    what = "with the effects" if found.findings else "by the model fitted anew"
    why = (
        f"held-out poses{where} are predicted worse {what}: {harm.before.rms_mm:.4f} mm rms "
        f"before, {harm.after.rms_mm:.4f} mm after; the extended model is the calibrated one "
        + ("everywhere" if everywhere else "there")
    )

    def left_out(gap: Gap) -> Gap:
        return fallen_back(gap, ~within.inside(gap.poses.states.q_rad))

    return replace(
        found,
        falls_back=FallsBack(within, why),
        train=left_out(found.train),
        holdout=None if found.holdout is None else left_out(found.holdout),
    )


def _without_contradicted(found: V, visited: AnglesSeen) -> V:
    """Return the verdict without names that held-out poses contradict.

    Motion of the base that was found is no fault of a name: it is taken out of the readings here.
    """
    unknown: list[Unexplained] = []
    while (held_out := trusted(found.holdout, found.prepared.suspected)) is not None:
        held_out = beside_motion(held_out)
        q_rad = held_out.poses.states.q_rad
        every: Rows = np.ones(len(q_rad), dtype=bool)
        for rows in (~visited.inside(q_rad), every):
            harm = _harm(held_out, rows)
            if harm is None or not harm.over(MUCH_WORSE):
                continue
            if _beyond_uncertainty(found, held_out, rows):
                break
        else:
            break
        left = ~visited.each(q_rad)[rows]
        names = _suspects(found.effects, np.asarray(left.any(axis=0)))
        if not names:
            break
        kept = [each for each in found.findings if each not in names]
        found = found.with_findings(kept)
        unknown += [
            Unexplained(
                each.of,
                each.id,
                found.train.after.mean_mm,
                f"{label_of(each.effect, None)} fits best, and is no name: held-out poses "
                f"contradict it, {harm.errors}",
            )
            for each in names
        ]
    return replace(found, unexplained=(*found.unexplained, *unknown)) if unknown else found


def _suspects(findings: Sequence[Finding[object]], left: Rows) -> list[Finding[object]]:
    """Return the names of joints that left what was visited; all names where none did.

    Args:
        findings: what was found.
        left: (n,) whether each joint did.
    """
    names = [each for each in findings if is_named(each.effect)]
    of_joints = [
        each
        for each in names
        if isinstance(each.effect, JointEffect) and left[each.effect.joint - 1]
    ]
    return of_joints or names


def _harm(gap: Gap, rows: Rows) -> _Harm | None:
    """Return how much worse some configurations (P,) are predicted; None where they are not.

    They are by more than chance, or by more than two parts in a hundred.
    """
    if not rows.any():
        return None
    harm = _Harm(summarise(gap.found_before, rows), summarise(gap.found_after, rows))
    paired = reduction(gap, rows)
    worse = harm.after.mean_mm > TRIFLING * harm.before.mean_mm
    surely = worse and paired.poses > 1 and paired.high_mm < 0.0
    return harm if harm.over(WORSE) or surely else None


def _beyond_uncertainty(found: Verdict[object], gap: Gap, rows: Rows) -> bool:
    """Return whether errors exceed what noise and the uncertainty of the model explain.

    Where single poses scatter by more than noise, as joints do that stop where friction lets them,
    by that scatter: it is there in the poses of the fit as well.
    """
    poses = gap.poses.take(rows)
    jacobian = residual_and_jacobian(found.extended.at, poses)[1]
    covariance = found.covariance[: jacobian.shape[2], : jacobian.shape[2]]
    spread = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
    floor_mm = gap.noise_floor_mm
    if found.scatter is not None:
        spread, floor_mm = spread + found.scatter.covariance(found.extended.at, poses), 0.0
    variance = np.trace(position_noise(poses.measured, spread), axis1=1, axis2=2)
    expected_mm = np.hypot(floor_mm, 1e3 * np.sqrt(variance.mean()))
    after_mm = summarise(gap.found_after, rows).rms_mm
    return bool(after_mm > CONTRADICTED * expected_mm)
