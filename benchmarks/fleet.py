"""Time and memory of fleets against their number of campaigns: benchmarks/fleet.md."""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap

from pa10cal.commands.command_line import limit_threads
from pa10cal.files.output import write_text

HERE = Path(__file__).parent
ROOT = HERE.parent
#: Campaigns of the runs, and of the plans alone.
RUNS, PLANS = (20, 60, 200), (20, 60, 200, 1000)
POSES, CORES, ROBOT = 60, 2, "irb120"
#: What the projection on paper is for.
ON_PAPER = 100_000

HEAD = f"""# Fleets: time and memory

`make fleet`: simulated campaigns of {POSES} poses under a tracker that sees three reflectors, each
of an {ROBOT} of its own and every two compared as if of one, from raw files to the fleet's page by
`pa10cal fleet --cores {CORES}`.
Work is the time on the processor of all processes below the run but Snakemake's own; overhead is
what the cores were held for besides, as a share of the work. Times are of one machine, no other
program running on it.

"""


@dataclass(frozen=True)
class Run:
    """One fleet, run: wall time [s], work [s], largest process [MB]."""

    campaigns: int
    wall_s: float
    work_s: float
    most_MB: float

    @property
    def overhead(self) -> float:
        """Return what the cores were held for besides the work, as its share."""
        return CORES * self.wall_s / self.work_s - 1.0


def simulate(folder: Path, campaigns: int) -> None:
    """Write the campaigns of a fleet, and their table."""
    from pa10cal.files.arms import load_arm
    from pa10cal_lab.cell.campaign import simulate_campaign
    from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
    from pa10cal_lab.cell.write import write_campaign

    arm, rows = load_arm(ROBOT), ["campaign,arm,measured"]
    plan = TrackerOptions(instrument="points", poses=POSES)
    for k in range(campaigns):
        name = f"c{k:04d}"
        settings = SimulateOptions(robot=ROBOT, random_seed=k, without_touches=plan)
        write_campaign(simulate_campaign(name, arm, settings), folder / name)
        rows.append(f"{name},arm-{k // 2:04d},2026-0{1 + k % 2}")
    write_text(folder / "arms.csv", "\n".join(rows) + "\n")


def part_of(raw: Path, count: int) -> Path:
    """Return a table of the first few campaigns of a fleet."""
    lines = (raw / "arms.csv").read_text(encoding="utf-8").splitlines()
    path = raw / f"arms-{count}.csv"
    write_text(path, "\n".join(lines[: count + 1]) + "\n")
    return path


def planned_s(raw: Path, table: Path, out: Path) -> float:
    """Return how long Snakemake takes to plan a fleet, nothing run [s]."""
    words = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "workflow/run.smk")]
    words += ["--directory", str(out), "--cores", str(CORES), "--nolock", "--dry-run", "--quiet"]
    words += ["all", "--workflow-profile", "none", "fleet", "--config", f"campaigns={table}"]
    words += [f"raw_dir={raw}", f"results_dir={out / 'results'}"]
    began = time.perf_counter()
    subprocess.run(words, check=True, capture_output=True)
    return time.perf_counter() - began


def run(raw: Path, table: Path, out: Path) -> Run:
    """Run a fleet."""
    words = [sys.executable, "-m", "pa10cal", "fleet", str(table), "--raw-dir", str(raw)]
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([*words, "--out", str(out), "--cores", str(CORES)], check=True)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    count = len(table.read_text(encoding="utf-8").splitlines()) - 1
    work = used - planned_s(raw, table, out / "again")
    return Run(count, wall, work, after.ru_maxrss / 1024)


def main() -> None:
    """Run and plan fleets, and write the page."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--runs", type=int, nargs="*", default=RUNS)
    asked.add_argument("--plans", type=int, nargs="*", default=PLANS)
    given = asked.parse_args()
    limit_threads()
    with tempfile.TemporaryDirectory() as folder:
        raw = Path(folder) / "raw"
        simulate(raw, max(*given.runs, *given.plans))
        plans = {
            count: planned_s(raw, part_of(raw, count), Path(folder) / f"plan-{count}")
            for count in given.plans
        }
        runs = [run(raw, part_of(raw, n), Path(folder) / f"run-{n}") for n in given.runs]
    text = HEAD + "\n".join(_lines(runs, plans)) + "\n"
    write_text(HERE / "fleet.md", text)
    print(text)


def _lines(runs: list[Run], plans: dict[int, float]) -> list[str]:
    lines = ["| campaigns | wall time | work | overhead | largest process |"]
    lines += ["| --- | --- | --- | --- | --- |"]
    lines += [
        f"| {each.campaigns} | {each.wall_s:.0f} s | {each.work_s:.0f} s | "
        f"{100 * each.overhead:.0f} % | {each.most_MB:.0f} MB |"
        for each in runs
    ]
    lines += ["", "| campaigns | planning alone |", "| --- | --- |"]
    lines += [f"| {count} | {seconds:.1f} s |" for count, seconds in plans.items()]
    if runs:
        a_campaign = runs[-1].work_s / runs[-1].campaigns
        hours = ON_PAPER * a_campaign / 3600
        lines += [
            "",
            *wrap(
                f"On paper: {ON_PAPER} campaigns like these are {hours:.0f} hours of one core at "
                f"{a_campaign:.1f} s each. One plan of all would take about "
                f"{plans[max(plans)] * ON_PAPER / max(plans) / 60:.0f} minutes if it grew in "
                "proportion; tables of some thousand campaigns, one after the other, need no more.",
                100,
            ),
        ]
    return lines


if __name__ == "__main__":
    main()
