"""What an error is of, by the kind of instrument."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Seen:
    """What an instrument's errors are of.

    Attributes:
        error: on an axis: `position error`.
        of: what they are, said once in a picture or table.
        arrows: what an arrow that shows one is.
    """

    error: str
    of: str
    arrows: str


_SEEN = {
    "touch_trigger_cmm": Seen(
        "position error",
        "Errors are distances of the end-effector, predicted from measured.",
        "Arrows: of the end-effector.",
    ),
    "pose": Seen(
        "position error",
        "Errors are distances of the target seen, predicted from measured.",
        "Arrows: of the target.",
    ),
    "points": Seen(
        "position error",
        "The error of a pose is the root mean square over the targets seen in it.",
        "Arrows: mean over the targets seen in a pose.",
    ),
    "distance": Seen(
        "distance error",
        "Errors are of the distance measured: what is across the line of sight does not show.",
        "Arrows lie along the line of sight: what is across it does not show.",
    ),
}


def seen_by(instrument: str) -> Seen:
    """Return what the errors of an instrument are of."""
    return _SEEN[instrument]
