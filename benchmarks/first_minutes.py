"""The first minutes with one's own files: commands, edits and seconds from files to a report.

`python -m benchmarks.first_minutes [--only NAME …]` writes files as instruments and controllers of
seven families write them (SYNTHETIC: readings of the virtual cell in the exports of the tests, and
a T-Scan's of `benchmarks/inputs`), goes from them to a report as their owner would, by `pa10cal
columns` and `pa10cal run .`, and counts: commands, edits of what was proposed, and seconds on this
machine, of the clock and of its processors. `benchmarks/first_minutes.md` has the table. An edit is
a key of campaign.yaml that is added or changed; at most two edits and three commands are wanted.
Names of families are those of `FAMILIES`.
"""

from __future__ import annotations

import argparse
import importlib
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.commands.command_line import limit_threads
from pa10cal.files.arms import load_arm
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.options import SimulateOptions

_INPUTS = Path(__file__).with_name("inputs")
_TABLE = Path(__file__).with_suffix(".md")
_TESTS = Path(__file__).parents[1] / "tests"
_PROGRAM = (sys.executable, "-m", "pa10cal")
_POSES, _NOISE_MM, _NOISE_RAD = 60, 0.05, 1e-4
MOST_COMMANDS, MOST_EDITS = 3, 2
#: Grades of input that was read rightly.
RIGHT = ("good", "incomplete", "few_poses")
#: What only the owner knows, whatever the files: where they are from, and that nothing is carried.
EDITS = {
    "provenance: to be stated": "provenance: SYNTHETIC",
    "  mass_kg: 0.0": "  massless: true\n  mass_kg: 0.0",
}


@dataclass(frozen=True)
class Measured:
    """What was logged and read."""

    q_deg: np.ndarray  # (P, n) joint positions
    T: np.ndarray  # (P, 4, 4) the target in the instrument's frame [m]

    @property
    def points(self) -> list[tuple[int, tuple[float, ...]]]:
        """Return numbers from 1 and places [mm], in another order than they were driven to."""
        order = np.random.default_rng(3).permutation(len(self.T)).tolist()
        return [(k + 1, tuple(1e3 * self.T[k, :3, 3])) for k in order]


def exports(module: str) -> Any:
    """Return what makes files as others write them, which the tests have."""
    if str(_TESTS) not in sys.path:
        sys.path.append(str(_TESTS))
    return importlib.import_module(module)


def measured(robot: str, seed: int) -> Measured:
    """Measure an arm of the virtual cell, a little off its design, under a tracker of poses."""
    plan = {
        "instrument": "pose",
        "poses": _POSES,
        "position_mm": _NOISE_MM,
        "attitude_rad": _NOISE_RAD,
        "tool_mass_kg": 0.0,
        "target_m": 0.1,
    }
    settings = {"random_seed": seed, "robot": robot, "without_touches": plan}
    made = simulate_campaign("cell", load_arm(robot), SimulateOptions.model_validate(settings))
    table = made.tables["poses"]
    T = np.tile(np.eye(4), (len(table), 1, 1))
    quaternion = table[["qw", "qx", "qy", "qz"]].to_numpy()
    T[:, :3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    T[:, :3, 3] = 1e-3 * table[["x_mm", "y_mm", "z_mm"]].to_numpy()
    return Measured(table[[f"q{k}_deg" for k in range(1, 7)]].to_numpy(), T)


def rows(header: str, values: Iterable[Iterable[object]], separator: str = ",") -> str:
    """Return a table as text: numbers to six decimals, all else as it is."""
    lines = [header]
    for row in values:
        fields = (f"{each:.6f}" if isinstance(each, float) else str(each) for each in row)
        lines.append(separator.join(fields))
    return "\n".join([*lines, ""])


# Each writes the files of one family into a folder, and returns their names and the robot's.


def motive_and_rtde(folder: Path) -> tuple[list[str], str]:
    """Write a take of OptiTrack, and the stream of a UR's controller, on clocks of their own."""
    logs = exports("made_up_streams").streams(4, 125.0, 120.0, poses=40)
    take = exports("made_up_formats").TAKES["motive"][0]
    (folder / "take.csv").write_text(take(logs.readings["Time [s]"].to_numpy(), logs.T_read))
    time_s, *q_deg = logs.joints.to_numpy().T
    header = " ".join(["timestamp", *(f"actual_q_{k}" for k in range(6))])
    table = np.column_stack([time_s, *np.radians(q_deg)]).tolist()
    (folder / "rtde.csv").write_text(rows(header, table, " "))
    return ["rtde.csv", "take.csv"], "ur10"


def leica_tscan(folder: Path) -> tuple[list[str], str]:
    """Write blocks of a T-Scan of a Leica tracker, and joints without names of columns."""
    for path in (_INPUTS / "w02s-position-blocks").iterdir():
        shutil.copy(path, folder)
    return ["joints.txt", "tscan.txt"], "ur5"


def spatialanalyzer(folder: Path) -> tuple[list[str], str]:
    """Write points of SpatialAnalyzer, and a list of joints under the same labels."""
    seen = measured("ur10", 1)
    (folder / "points.txt").write_text(
        exports("made_up_reports").REPORTS["spatialanalyzer"](seen.points)
    )
    header = ";".join(["Point", *(f"A{k}" for k in range(1, 7))])
    labelled = ([f"P{k}", *q] for k, q in enumerate(seen.q_deg.tolist(), start=1))
    (folder / "joints.csv").write_text(rows(header, labelled, ";"))
    return ["joints.csv", "points.txt"], "ur10"


def program(name: str, file: str, robot: str) -> Callable[[Path], tuple[list[str], str]]:
    """Return what writes a program of joint targets, and a tracker's list of points."""

    def write(folder: Path) -> tuple[list[str], str]:
        seen = measured(robot, 2)
        text, called = exports("made_up_formats").PROGRAMS[name]
        (folder / file).write_text(text(seen.q_deg))
        labelled = ([called.format(k), *place] for k, place in seen.points)
        (folder / "tracker.csv").write_text(rows("Name,X [mm],Y [mm],Z [mm]", labelled))
        return [file, "tracker.csv"], robot

    return write


def matlab(folder: Path) -> tuple[list[str], str]:
    """Write joints and matrices of poses as MATLAB saves them."""
    seen = measured("ur10", 3)
    (folder / "run.mat").write_bytes(
        exports("made_up_arrays").ARRAYS["packed.mat"](seen.q_deg, seen.T)
    )
    return ["run.mat"], "ur10"


def lerobot(folder: Path) -> tuple[list[str], str]:
    """Write an episode of lerobot, names of motors beside it, and a tracker's readings by time."""
    seen, arrays = measured("ur10", 4), exports("made_up_arrays")
    time_s, order = 10.0 * np.arange(len(seen.T)), np.argsort(arrays.MOTORS)
    (folder / "episode_000000.parquet").write_bytes(
        arrays.lerobot_table(time_s, seen.q_deg[:, order])
    )
    names = [f"{arrays.MOTORS[k]}.pos" for k in order]
    (folder / "info.json").write_text(arrays.lerobot_info(names))
    table = np.column_stack([time_s, 1e3 * seen.T[:, :3, 3]]).tolist()
    (folder / "tracker.csv").write_text(rows("t [s];X [mm];Y [mm];Z [mm]", table, ";"))
    return ["episode_000000.parquet", "tracker.csv"], "ur10"


FAMILIES: dict[str, tuple[str, Callable[[Path], tuple[list[str], str]]]] = {
    "motive": ("OptiTrack Motive take, UR RTDE stream", motive_and_rtde),
    "tscan": ("Leica T-Scan text, joints without names", leica_tscan),
    "spatialanalyzer": ("SpatialAnalyzer points, joints as CSV", spatialanalyzer),
    "kuka": ("KUKA data list, tracker's points as CSV", program("kuka", "calpts.dat", "ur10")),
    "abb": ("ABB RAPID module, tracker's points as CSV", program("abb", "calpts.mod", "irb120")),
    "matlab": ("MATLAB joints and matrices", matlab),
    "lerobot": ("lerobot Parquet, tracker's readings as CSV", lerobot),
}


@dataclass(frozen=True)
class Minutes:
    """How a family came to its report."""

    title: str
    commands: tuple[str, ...]
    edits: tuple[str, ...]  # keys of campaign.yaml
    seconds: float
    processor_s: float
    grade: str  # of the table that is printed; or why there is none
    after_mm: str  # held-out error of the model

    @property
    def right(self) -> bool:
        """Return whether it came to a report of input read rightly, in few steps."""
        few = len(self.commands) <= MOST_COMMANDS and len(self.edits) <= MOST_EDITS
        return few and self.grade in RIGHT


def minutes(folder: Path, name: str) -> Minutes:
    """Go from the files of a family to its report, as their owner would."""
    title, write = FAMILIES[name]
    folder.mkdir(parents=True)
    files, robot = write(folder)
    begun, before_s, commands = (
        time.monotonic(),
        of_children_s(),
        [f"columns {' '.join(files)} --robot {robot}"],
    )
    proposed = called(folder, *commands[0].split())
    text, edits = proposed.stdout, []
    for stands, stated in EDITS.items():
        if stands in text:
            text = text.replace(stands, stated, 1)
            edits.append(stated.split(":")[0].strip())
    (folder / "campaign.yaml").write_text(text, encoding="utf-8")
    if proposed.returncode == 0:
        commands.append("run .")
        done = called(folder, "run", ".")
    else:
        done = proposed
    seconds, processor_s = time.monotonic() - begun, of_children_s() - before_s
    fields = next(
        (line.split() for line in done.stdout.splitlines() if line.startswith(f"{folder.name} ")),
        [],
    )
    report = folder.parent / "results" / folder.name / "report.html"
    whole = done.returncode == 0 and report.is_file() and len(fields) > 5
    grade = fields[1] if whole else (done.stderr or done.stdout).strip()[-300:]
    after = " ".join(fields[5:7]) if whole else ""
    return Minutes(title, tuple(commands), tuple(edits), seconds, processor_s, grade, after)


def of_children_s() -> float:
    """Return the seconds of a processor that programs called so far have taken."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def called(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Call the program in a folder."""
    words = (*_PROGRAM, *words)
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)


def table_of(found: Iterable[Minutes]) -> str:
    """Return the table."""
    lines = [
        "# First minutes",
        "From files alone to a report, by `python -m benchmarks.first_minutes`. All files are",
        "synthetic: an arm of the virtual cell, or of an own simulation, in the exports of its",
        "family. Seconds are those of the machine that it ran on, whose two cores had other work",
        "besides, and of its processors. The owner states where the data are from, and that the",
        "target weighs nothing (`tool.massless`); all else is as proposed. Of the T-Scan there are",
        "27 poses.",
        "",
        "| files | commands | edits | seconds | of processors | grade | held out |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for each in found:
        commands = "; ".join(f"`pa10cal {command}`" for command in each.commands)
        edits = f"{len(each.edits)}: {', '.join(each.edits)}"
        took = f"{each.seconds:.0f}", f"{each.processor_s:.0f}"
        cells = (each.title, f"{len(each.commands)}: {commands}", edits, *took)
        lines.append(f"| {' | '.join((*cells, each.grade, each.after_mm))} |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Go through the families, print a line each, and write the table where all were."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    asked = parser.parse_args()
    limit_threads()
    found = []
    with tempfile.TemporaryDirectory() as place:
        for name in asked.only:
            one = minutes(Path(place) / name / name, name)
            found.append(one)
            said = f"{len(one.commands)} commands, {len(one.edits)} edits, {one.seconds:.0f} s"
            print(
                f"{name}: {'' if one.right else 'NOT '}{said}; {one.grade} {one.after_mm}",
                flush=True,
            )
    print(f"{sum(one.right for one in found)} of {len(found)} in few steps")
    if len(found) == len(FAMILIES):
        _TABLE.write_text(table_of(found), encoding="utf-8")


if __name__ == "__main__":
    main()
