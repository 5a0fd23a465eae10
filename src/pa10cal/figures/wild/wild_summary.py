"""The figures that wild trials are to reach, and those reached."""

from __future__ import annotations

from pa10cal.figures.rates import BAR_HEADER, bar_row
from pa10cal.figures.registry import Picture
from pa10cal.figures.table import Shown, Table, frame_of
from pa10cal.results.trials import WildScoresRecord

PICTURE = Picture(
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

_NOTES = (
    "Too few to judge: one trial alone weighs more than the target leaves, and the interval holds "
    "the target.",
    "A fault is above the noise where it moves the residual of the calibrated model by more than "
    "three times what repeatability leaves, against the same campaign without it; faults of single "
    "rows, signs, zeros and units always are.",
    "Told: by kind and place in the faults of the verdict, by suspect_input, by a refusal before "
    "calibration, or, of a single reading, by its quarantine or among the suspected outliers.",
    "A refusal after calibration counts as a crash.",
)
_NOTES_MEASURED = (
    _NOTES[0],
    "What an effect leaves is worked out from the truth: the readings without noise, with the "
    "effect and without it, less all motions of base, joint frames and tool; with the noise it "
    "makes the residual of so many times the noise.",
    "Listed: as the name of an effect of the verdict, or among its alternatives. A name is wrong "
    "where neither it nor one of its alternatives is hidden.",
    "A motion is a fact where no joint, rail, load or order of the rows is named as another cause.",
)


def tabulate(scores: WildScoresRecord) -> Table:
    """Return a row a figure."""
    data = frame_of(BAR_HEADER, map(bar_row, scores.bars))
    kinds = {trial.kind for trial in scores.per_trial}
    notes = _NOTES_MEASURED if kinds <= {"unstated_masses", "sorted_rows"} else _NOTES
    return Table(
        "Wild trials: targets, and values reached", data, (Shown(data.astype(str)),), notes
    )
