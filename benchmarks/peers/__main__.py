"""Run all peers and us on the same problems, and write `benchmarks/peers.md`."""

from __future__ import annotations

import argparse
import os
import platform
import sys
from pathlib import Path
from statistics import median

from benchmarks.peers import environments, problems, simulate
from benchmarks.peers.problem import Problem
from benchmarks.peers.rounds import LIMIT_S, METHODS, ROUNDS, case_of, run_round
from benchmarks.peers.table import Run, page
from pa10cal.files.output import write_text

WORK = Path(__file__).parents[2] / "build" / "peers"
PAGE = Path(__file__).parents[1] / "peers.md"


def main() -> None:
    """Set up, run in turns, write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers")
    parser.add_argument(
        "--ipa",
        type=Path,
        default=os.environ.get("PA10CAL_IPA_DATA"),
        help="folder of the data set ipa-robot-accuracy; else what PA10CAL_IPA_DATA names",
    )
    arguments = parser.parse_args()
    pythons, notes = _environments()
    records, readings = WORK / "records", WORK / "problems"
    for folder in (records, readings):
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.iterdir():
            old.unlink()
    real: list[Path] = []
    if arguments.ipa is None:
        notes.append(f"{problems.REAL}: left out, PA10CAL_IPA_DATA names no folder")
    elif not (arguments.ipa / problems.READINGS).is_file():
        parser.error(f"no file {arguments.ipa / problems.READINGS}; name the data set's folder")
    else:
        real = [problems.write_real(readings, arguments.ipa)]
    runs: list[Run] = []
    for turn in range(ROUNDS):
        simulated = problems.write_simulated(readings, turn)
        runs += run_round(turn, pythons, simulated, real, records)
    errors_mm: dict[str, list[float]] = {}
    for path in sorted(readings.iterdir()):
        error_mm = problems.uncalibrated_errors_mm(Problem.read(path)).mean()
        errors_mm.setdefault(case_of(path.stem), []).append(float(error_mm))
    uncalibrated_mm = {case: median(each) for case, each in errors_mm.items()}
    names = [method.name for method in METHODS]
    text = page(runs, names, uncalibrated_mm, _conditions(), notes)
    write_text(PAGE, text)
    print(text)


def _environments() -> tuple[dict[str, Path], list[str]]:
    """Return the interpreters that are there, and a note for each that is not."""
    pythons, notes = {"ours": Path(sys.executable)}, []
    for peer in environments.PEERS:
        python, reason = environments.build(peer, WORK / "environments")
        if python is None:
            notes.append(f"{peer}: left out, cannot be installed here ({reason})")
            print(f"peers: {notes[-1]}", file=sys.stderr, flush=True)
        else:
            pythons[peer] = python
    return pythons, notes


def _conditions() -> list[str]:
    """Return what was run, as lines of the page."""
    versions = ", ".join(f"{peer} {environments.version(peer)}" for peer in environments.PEERS)
    repeats = ", ".join(f"{each.name} {each.rounds} and {each.real_rounds}" for each in METHODS)
    length_mm, angle_mrad = 1e3 * simulate.TOLERANCE_M, 1e3 * simulate.TOLERANCE_RAD
    return [
        f"`make peers` on {platform.machine()}, Python {platform.python_version()}, one thread; "
        f"{versions}. What each is given: `benchmarks/peers/README.md`.",
        f"Simulated UR10, positions with {1e3 * simulate.NOISE_M:g} mm noise an axis, "
        f"{simulate.TEST_POSES} noise-free test poses; errors of all rows of {length_mm:g} mm and "
        f"{angle_mrad:g} mrad (1 sigma): `rows-N`; parallel axes tilted by as much too: "
        "`tilted-N`; N poses to calibrate with.",
        f"Medians over {ROUNDS} rounds, a new simulated arm in each, methods in turns; simulated "
        f"and real rounds of each method: {repeats}. A problem may take {LIMIT_S} s.",
    ]


if __name__ == "__main__":
    main()
