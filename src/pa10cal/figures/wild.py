"""Tables of wild trials: how often the pipeline fails, what became of what was put in."""

from __future__ import annotations

from pa10cal.figures.registry import picture
from pa10cal.figures.table import Table, frame_of
from pa10cal.figures.trials import BAR_HEADER, TOO_FEW, bar_row
from pa10cal.results.trials import WildScoresRecord, WildSubject

#: Columns of the table, and the keys that they show.
_COLUMNS = {
    "kind": "kind",
    "put in": "id",
    "trials": "trials",
    "crashed": "crashed",
    "refused": "refused",
    "false name": "false_names",
    "above the noise": "above_noise",
    "told": "told",
    "found": "found",
    "false comfort": "false_comfort",
    "worse held out": "worse",
    "unexplained": "unexplained",
    "suspect": "suspected",
}
_FOUND_IN = ("effect", "beyond", "unstated_masses", "sorted_rows")


@picture(
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
def tabulate_wild_subjects(scores: WildScoresRecord) -> Table:
    """Return a row a disturbance or an effect."""
    data = frame_of(list(_COLUMNS), map(_row, scores.subjects))
    notes = tuple(
        f"{trial.campaign} ({trial.bench}, {'; '.join(trial.put_in) or 'nothing'}): "
        f"{', '.join(trial.failings)}: {trial.said}"
        for trial in scores.per_trial
        if trial.failings
    )
    return Table("Wild trials: what became of each", data, notes=notes)


def _row(subject: WildSubject) -> list[object]:
    cells = subject.model_dump() | {"id": subject.id.replace("_", " ")}
    if subject.kind not in _FOUND_IN:
        cells["found"] = ""
    return [cells[key] for key in _COLUMNS.values()]


# The figures that wild trials are to reach, and those reached.

_NOTES = (
    TOO_FEW,
    "A fault is above the noise where it moves the residual of the calibrated model by more than "
    "three times what repeatability leaves, against the same campaign without it; faults of single "
    "rows, signs, zeros and units always are.",
    "Told: by kind and place in the faults of the verdict, by suspect_input, by a refusal before "
    "calibration, or, of a single reading, by its quarantine or among the suspected outliers.",
    "A refusal after calibration counts as a crash.",
)
_NOTES_MEASURED = (
    TOO_FEW,
    "What an effect leaves is worked out from the truth: the readings without noise, with the "
    "effect and without it, less all motions of base, joint frames and tool; with the noise it "
    "makes the residual of so many times the noise.",
    "Listed: as the name of an effect of the verdict, or among its alternatives. A name is wrong "
    "where neither it nor one of its alternatives is hidden.",
    "A motion is a fact where no joint, rail, load or order of the rows is named as another cause.",
)


@picture(
    title="Targets, and values reached",
    needs=(),
    caption="""
Targets of the whole pipeline in wild trials, and the values reached ({name}). Each trial is a
simulated campaign of one of several arms and instruments; stressors of ordinary logs or faults are
put into its raw files, or its masses are not stated, or its rows are sorted. Every command runs on
these files alone, and what is said is compared with what was put in afterwards. The interval is
that of a share of so many trials. A target that is missed is reported like any other. The data are
synthetic: rates hold for errors that the simulation can produce.
""",
)
def tabulate_wild_summary(scores: WildScoresRecord) -> Table:
    """Return a row a figure."""
    data = frame_of(BAR_HEADER, map(bar_row, scores.bars))
    kinds = {trial.kind for trial in scores.per_trial}
    notes = _NOTES_MEASURED if kinds <= {"unstated_masses", "sorted_rows"} else _NOTES
    return Table("Wild trials: targets, and values reached", data, notes=notes)
