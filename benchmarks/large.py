"""One large campaign of a tracker, from raw files to its calibrated model: time and memory.

    python -m benchmarks.large [--poses 100000] [--instrument pose|points|distance] [--robot ur10]

Each stage is a process of its own, as the workflow starts it, on one core.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pa10cal.commands.command_line import limit_threads
from pa10cal.files.arms import load_arm
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.cell.write import write_campaign

STAGES = {
    "ingest": "--campaign-dir {raw} --out poses.parquet --quarantine quarantine.csv",
    "seed": "--campaign-dir {raw} --poses poses.parquet --out base_frame.json",
    "calibrate": "--campaign-dir {raw} --poses poses.parquet --base-frame base_frame.json "
    "--out calibration",
}


def main() -> None:
    """Simulate a campaign, run its stages, print what each took."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--poses", type=int, default=100_000)
    asked.add_argument("--instrument", choices=("pose", "points", "distance"), default="pose")
    asked.add_argument("--robot", default="ur10")
    given = asked.parse_args()
    limit_threads()
    plan = TrackerOptions(instrument=given.instrument, poses=given.poses)
    settings = SimulateOptions(robot=given.robot, random_seed=1, without_touches=plan)
    total_s = 0.0
    with tempfile.TemporaryDirectory() as place:
        raw = Path(place) / "large"
        write_campaign(simulate_campaign("large", load_arm(given.robot), settings), raw)
        for stage, words in STAGES.items():
            command = [sys.executable, "-m", "pa10cal", stage, *words.format(raw=raw).split()]
            before, began = used_s(), time.perf_counter()
            subprocess.run(command, cwd=place, check=True, capture_output=True)
            wall_s = time.perf_counter() - began
            total_s += used_s() - before
            print(f"{stage}: {wall_s:.1f} s, {used_s() - before:.1f} s of the processor")
    most_GB = 1e-6 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1.024
    poses = f"{given.poses} poses of {given.robot}, {given.instrument}"
    print(f"{poses}: {total_s:.0f} s of the processor, {most_GB:.2f} GB at most")


def used_s() -> float:
    """Return the time that all processes started here have used on the processor."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
