"""Planned poses against the paper's grid of 27, the same box for the tool: benchmarks/plan.md.

Every row holds what the plan expects, and what simulated robots that were measured so then show.
"""

from __future__ import annotations

from pathlib import Path

from pa10cal.commands.command_line import limit_threads
from pa10cal.files.output import write_text

HERE = Path(__file__).parent
POSES, SEEDS = 27, 40
#: Arm, instrument, middle of the grid, loads, joints with springs.
CELLS = {
    "PA10-6CE, positions and orientations": ("pa10_6ce", "pose", (0, 15, 90, 0, 45, -90)),
    "PA10-6CE, the same, three springs, 0, 22 and 44 N": (
        "pa10_6ce",
        "pose",
        (0, 15, 90, 0, 45, -90),
        (0.0, 22.0, 44.0),
        (2, 3, 5),
    ),
    "UR10, positions and orientations": ("ur10", "pose", (0, -75, 110, -125, -90, 0)),
    "UR10, three reflectors": ("ur10", "points", (0, -75, 110, -125, -90, 0)),
}
#: Rows of the table: whether the plan keeps to the joint ranges of the grid, and the test poses.
ROWS = {
    "joint limits of the arm | all that these allow": (False, "within the limits"),
    "joint ranges of the grid | all that these allow": (True, "within the ranges"),
    "joint limits of the arm | orientations as in the grid": (False, "like the grid"),
    "joint ranges of the grid | orientations as in the grid": (True, "like the grid"),
}

HEAD = f"""# Planned poses against the paper's grid

`make plan`: the paper measures a grid of 3 x 3 x 3 = {POSES} points, 125 mm apart, in which the
tool turns by up to 0.5 rad about its x axis and 0.1 rad about the others. A plan of {POSES} poses
has the same box of 250 mm for its target. Its candidates are poses that bring the target there,
within the joint limits of the arm, or within the range through which the grid takes each joint. No
effects are planned for (`effects: 0`). The UR10 is given a grid of the same kind.

Expected is the standard uncertainty of the tool's position after the calibration. Simulated is the
error of the tool of {SEEDS} robots of the virtual cell, each measured at the grid and at the plan
with the same noise (0.03 mm, 0.1 mrad) and calibrated with the general model. Both are root mean
squares over test poses in the box, without load [mm]: none of them measured, drawn like the
candidates or like the grid.

"""

TAIL = """
## How to read it
The first row of each cell is the gain of a plan that stays within the grid's own box: the tool is
known at every orientation there. The orientations of the grid hardly differ, so that its model
extrapolates as soon as the tool turns further. In the second row the plan moves each joint no
further than the grid does. The other two rows judge both at orientations of the grid alone. There
is little to gain there: the mean variance of the readings that a calibration predicts at its own
poses is the number of unknowns over the number of poses, whichever poses these are.
"""


def main() -> None:
    limit_threads()
    text = HEAD + "\n".join(_table(name, cell) for name, cell in CELLS.items()) + TAIL
    write_text(HERE / "plan.md", text)
    print(text)


def _table(name: str, cell) -> str:
    """Return the heading and the table of one cell."""
    columns = ["plan within", "tested at"]
    columns += ["expected: grid, plan", "ratio", "simulated: grid, plan", "ratio"]
    head = [f"| {' | '.join(columns)} |", f"|{' --- |' * len(columns)}"]
    return "\n".join([f"## {name}", *head, *_rows(cell)]) + "\n"


def _rows(cell) -> list[str]:
    """Return the lines of one cell."""
    import numpy as np

    from benchmarks.planned import Cell

    bench = Cell(*cell)
    options = {within: bench.options(ranges_of_grid=within) for within in (False, True)}
    measured = {within: bench.planned(POSES, each) for within, each in options.items()}
    measured["grid"] = bench.grid()
    tests = {
        "within the limits": bench.tested(options[False]),
        "within the ranges": bench.tested(options[True]),
        "like the grid": bench.tested_like_grid(),
    }
    errors = {}
    for which, q in measured.items():
        every = [bench.simulated_mm(q, [*tests.values()], seed) for seed in range(1, SEEDS + 1)]
        rms = np.sqrt(np.mean(np.square(every), axis=0))
        errors[which] = dict(zip(tests, rms.tolist(), strict=True))
    lines = []
    for words, (within, tested) in ROWS.items():
        expected = (
            bench.expected_mm(measured[which], tests[tested], options[within])
            for which in ("grid", within)
        )
        simulated = (errors[which][tested] for which in ("grid", within))
        figures = " | ".join(
            f"{one:.3f}, {other:.3f} | {other / one:.2f}" for one, other in (expected, simulated)
        )
        lines.append(f"| {words} | {figures} |")
    return lines


if __name__ == "__main__":
    main()
