"""Monte Carlo of one plane: its draws against numpy drawing the same normals, and its memory."""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.files.arms import load_arm
from pa10cal.montecarlo.displacement import joint_screws, plan_displacement
from pa10cal.montecarlo.places import draw_places, reference_in_plane
from pa10cal.montecarlo.plane import BLOCK_CYCLES, counts_of, sample_errors, stream
from pa10cal.options import MonteCarloOptions

PLANE_MM = 500
ROUNDS = 9

#: Runs the stage and prints the peak resident set of that process alone [kB].
_STAGE = """
import sys
from pa10cal.__main__ import main
code = main(sys.argv[1:])
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(status["VmHWM"].split()[0])
sys.exit(code)
"""


@dataclass(frozen=True)
class Timing:
    """Processor time, best of several rounds, draws and sampling in turn, one process, one thread.

    Attributes:
        draw_s: numpy drawing the normals of all cycles and joints, block by block into one buffer.
        total_s: drawing them, exact forward kinematics of every cycle, and the sums.
        ratio: `total_s` over `draw_s`.
    """

    draw_s: float
    total_s: float

    @property
    def ratio(self) -> float:
        return self.total_s / self.draw_s


def measure(rounds: int = ROUNDS) -> Timing:
    """Time one full-size plane."""
    settings = MonteCarloOptions()
    arm = load_arm("pa10_6ce")
    chain = Chain.of(arm)
    reference = reference_in_plane(chain, 1e-3 * PLANE_MM, settings.reach_m)
    source = stream(settings.random_seed, PLANE_MM, None)
    places = draw_places(chain, reference, settings.reach_m, settings.positions, source)
    motion = joint_screws(chain, places.q_rad)
    plan = plan_displacement(motion, math.radians(settings.sigma_deg))
    counts = counts_of(settings.cycles)
    lengths = [
        min(BLOCK_CYCLES, settings.cycles - start)
        for start in range(0, settings.cycles, BLOCK_CYCLES)
    ]
    buffers = {length: np.empty((arm.n, length)) for length in set(lengths)}

    def fresh() -> list[np.random.Generator]:
        return [stream(settings.random_seed, PLANE_MM, k) for k in range(settings.positions)]

    def draw() -> None:
        for generator in fresh():
            for length in lengths:
                generator.standard_normal(out=buffers[length])

    def total() -> None:
        sample_errors(plan, fresh(), counts)

    draws: list[float] = []
    totals: list[float] = []
    for _ in range(rounds):
        for work, seconds in ((draw, draws), (total, totals)):
            began = time.process_time()
            work()
            seconds.append(time.process_time() - began)
    return Timing(min(draws), min(totals))


def peak_memory_MB() -> float:
    """Return the peak resident set of the stage at full size, in a process of its own (Linux)."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "plane.json"
        words = ["montecarlo", "--campaign", "bench", "--robot", "pa10_6ce"]
        words += ["--plane-mm", str(PLANE_MM), "--out", str(out)]
        command = [sys.executable, "-c", _STAGE, *words]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
    return int(done.stdout.split()[-1]) / 1024.0


def rows() -> list[tuple[str, float, str, str]]:
    """Return what was measured: what, value, unit, bar."""
    timing = measure()
    return [
        ("Monte Carlo, one plane: numpy draws the normals", timing.draw_s, "s", ""),
        ("Monte Carlo, one plane: draws, kinematics, sums", timing.total_s, "s", ""),
        ("Monte Carlo, over the time of the draws", timing.ratio, "×", "≤ 1.3"),
        ("Monte Carlo, peak memory of the stage", peak_memory_MB(), "MB", "< 300"),
    ]


if __name__ == "__main__":
    for what, value, unit, bar in rows():
        print(f"{what:<50} {value:8.3f} {unit:<3} {bar}")
