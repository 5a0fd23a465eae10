"""The gap between model and measurement as a record."""

from __future__ import annotations

from pa10cal.calibration.accuracy import summarise
from pa10cal.discovery.gap import Gap, Paired
from pa10cal.results import discovery as parts
from pa10cal.results.accuracy import Accuracy, BeforeAfter


def set_gap(found: Gap, without: Gap | None = None) -> parts.SetGap:
    """Return the gap before and after: over all loads, load by load, and by what the fit saw.

    Args:
        found: the gap.
        without: the same without configurations that have a suspected reading.
    """
    seen = found.parts
    less = None if without is None or without is found else without
    return parts.SetGap(
        before=found.before,
        after=found.after,
        noise_floor_mm=found.noise_floor_mm,
        reduction=_reduction(found.reduction),
        per_load={
            f"{load:g}N": parts.LoadGap(
                before=before,
                after=after,
                reduction=_reduction(found.reduction_by_load[load]),
            )
            for load, (before, after) in found.by_load.items()
        },
        inside=None if seen is None else _pair(seen.before_inside, seen.after_inside),
        outside=None if seen is None else _pair(seen.before_beyond, seen.after_beyond),
        trusted=None if less is None else _pair(less.before, less.after),
        without_motion=None
        if found.without_motion is None
        else _pair(*map(summarise, found.without_motion)),
        with_rivals=None if found.with_rivals is None else summarise(found.with_rivals),
    )


def _pair(before: Accuracy | None, after: Accuracy | None) -> BeforeAfter | None:
    if before is None or after is None:
        return None
    return BeforeAfter(before=before, after=after)


def _reduction(paired: Paired) -> parts.Reduction:
    return parts.Reduction(
        mean_mm=paired.mean_mm,
        interval95_mm=(paired.low_mm, paired.high_mm),
        poses=paired.poses,
    )
