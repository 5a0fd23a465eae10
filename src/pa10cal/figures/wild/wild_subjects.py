"""What became of wild trials, by what was put into them."""

from __future__ import annotations

from pa10cal.figures.registry import Picture
from pa10cal.figures.table import Shown, Table, frame_of
from pa10cal.results.trials import WildScoresRecord, WildSubject

PICTURE = Picture(
    title="What became of each stressor, fault and effect",
    needs=(),
    caption="""
Wild trials by what was put into their raw files ({name}): how many there are, and how many crashed,
were refused before calibration, were given a false name (a confident one where a fault or an effect
outside the vocabulary is in them), were told of the fault or named the effect, got *none* where
something above three times the noise is wrong, predict held-out poses worse than before, were left
unexplained, or were called suspect. Of unstated masses and sorted rows, effects count as above the
noise where they leave half as much again, and as told where they are named or listed. Synthetic
data.
""",
)

_HEADER = (
    "kind",
    "put in",
    "trials",
    "crashed",
    "refused",
    "false name",
    "above the noise",
    "told",
    "found",
    "false comfort",
    "worse held out",
    "unexplained",
    "suspect",
)
_FOUND_IN = ("effect", "beyond", "unstated_masses", "sorted_rows")


def tabulate(scores: WildScoresRecord) -> Table:
    """Return a row a disturbance or an effect."""
    data = frame_of(_HEADER, map(_row, scores.subjects))
    shown = data.astype(str).replace("<NA>", "")
    notes = tuple(
        f"{trial.campaign} ({trial.bench}, {'; '.join(trial.put_in) or 'nothing'}): "
        f"{', '.join(trial.failings)}: {trial.said}"
        for trial in scores.per_trial
        if trial.failings
    )
    return Table("Wild trials: what became of each", data, (Shown(shown),), notes)


def _row(subject: WildSubject) -> tuple[object, ...]:
    return (
        subject.kind,
        subject.id.replace("_", " "),
        subject.trials,
        subject.crashed,
        subject.refused,
        subject.false_names,
        subject.above_noise,
        subject.told,
        subject.found if subject.kind in _FOUND_IN else "",
        subject.false_comfort,
        subject.worse,
        subject.unexplained,
        subject.suspected,
    )
