"""The figures that blind trials are to reach, and those reached."""

from __future__ import annotations

from pa10cal.figures.rates import BAR_HEADER, bar_row
from pa10cal.figures.registry import Picture
from pa10cal.figures.table import Shown, Table, frame_of
from pa10cal.results.trials import TrialScoresRecord

PICTURE = Picture(
    title="Targets, and values reached",
    needs=(),
    caption="""
Targets of discovery in blind trials, and the values reached ({name}). Each trial is a simulated
campaign with robot, poses, noise and hidden effects drawn at random; the verdict uses its raw
files only and is compared with the truth afterwards. The interval is that of a share of so many
trials. A target that is missed is reported like any other. The result says how well discovery
does on errors that the simulation can produce.
""",
)

_NOTES = (
    "Too few to judge: one trial alone weighs more than the target leaves, and the interval holds "
    "the target.",
    "Ratio: remaining position error of the calibrated model over that of noise alone, from the "
    "difference to the same campaign without the effect. A rotation about the last axis, a gain of "
    "the logged torque and friction at a rigid joint do not change it.",
    "Separable: distinguishable from every other name by the geometry of the poses alone. A map of "
    "a joint's error can represent any named error of that joint and is no alternative to one.",
    "A trial that failed counts against every target it belongs to.",
)


def tabulate(scores: TrialScoresRecord) -> Table:
    """Return a row a figure."""
    data = frame_of(BAR_HEADER, map(bar_row, scores.bars))
    return Table(
        "Blind trials: targets, and values reached",
        data,
        (Shown(data.astype(str)),),
        _notes(scores),
    )


def _notes(scores: TrialScoresRecord) -> tuple[str, ...]:
    singles, gap = scores.single, scores.gap
    notes = [*_NOTES]
    if singles.alternatives is not None:
        notes.append(
            f"One effect: {singles.alternatives:.2f} alternatives beside the truth on average; "
            f"{singles.not_testable} trials hid what the verdict had said it could not show."
        )
    if gap is not None:
        notes.append(
            f"Held-out error after naming over the mean where nothing is missing: median "
            f"{gap.median:.2f}, 95 of 100 below {gap.high:.2f}; where nothing is missing itself 95 "
            f"of 100 below {gap.null_high:.2f}."
        )
    return tuple(notes)
