"""Rounds: every method on the same problems, each in its own process and environment, in turns."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.peers.table import OURS, Run

#: How long a problem may take [s].
LIMIT_S = 120

_ROOT = Path(__file__).parents[2]
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Method:
    """A method, the environment it runs in, and how often: slow ones less.

    Attributes:
        name: as its adapter knows it.
        peer: environment and adapter, `ours` for this package.
        rounds: simulated arms it gets.
        real_rounds: times it gets the real one.
    """

    name: str
    peer: str
    rounds: int = 5
    real_rounds: int = 3


METHODS = (
    Method(OURS, "ours"),
    Method("figaroh-structural", "figaroh", real_rounds=1),
    Method("figaroh-excitation", "figaroh", real_rounds=1),
    Method("figaroh-map", "figaroh", real_rounds=1),
    Method("pybotics-distance", "pybotics", rounds=1, real_rounds=1),
    Method("pybotics-xyz", "pybotics"),
    Method("robotkinecal", "robotkinecal"),
)
ROUNDS = max(method.rounds for method in METHODS)


def run_round(
    turn: int,
    pythons: Mapping[str, Path],
    simulated: Sequence[Path],
    real: Sequence[Path],
    records: Path,
) -> list[Run]:
    """Run all methods once, begun at another one each round, so that none is always first.

    Args:
        turn: number of the round.
        pythons: interpreters by environment; methods without one are passed over.
        simulated: problems of a simulated arm, the smallest first.
        real: problems of real arms.
        records: folder for what the adapters write.
    """
    first = turn % len(METHODS)
    runs = []
    for method in (*METHODS[first:], *METHODS[:first]):
        paths = [*simulated] if turn < method.rounds else []
        paths += real if turn < method.real_rounds else []
        if method.peer in pythons and paths:
            print(f"peers: round {turn + 1} of {ROUNDS}, {method.name}", flush=True)
            runs += _run(method, pythons[method.peer], paths, records, turn)
    return runs


def case_of(problem: str) -> str:
    """Return the name of a problem without its seed: `rows-0027-3` is of `rows-0027`."""
    return problem.rpartition("-")[0] if problem.count("-") == 2 else problem


def _run(
    method: Method, python: Path, paths: Sequence[Path], records: Path, turn: int
) -> list[Run]:
    """Run one method on its problems; what wrote no record is a failed run."""
    written = {path.stem: records / f"{method.name}.{path.stem}.json" for path in paths}
    for record in written.values():
        record.unlink(missing_ok=True)
    module = f"benchmarks.peers.run_{method.peer}"
    command = [str(python), "-m", module, method.name, str(records), str(LIMIT_S)]
    reason = "the adapter ended without a record"
    try:
        done = subprocess.run(
            [*command, *map(str, paths)],
            cwd=_ROOT,
            env={**os.environ, **dict.fromkeys(_THREADS, "1"), "MPLBACKEND": "Agg"},
            timeout=(LIMIT_S + 30) * len(paths),
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0 and done.stderr:
            reason = done.stderr.splitlines()[-1][:200]
    except subprocess.TimeoutExpired:
        reason = "the adapter did not end"
    return [
        _read(record, Run(method.name, case_of(problem), turn, "failed", reason))
        for problem, record in written.items()
    ]


def _read(path: Path, missing: Run) -> Run:
    """Return the run that a record tells of, or what stands for it where there is no record."""
    if not path.is_file():
        return missing
    record = json.loads(path.read_text())
    numbers = {
        name: record[name]
        for name in ("mean_mm", "rms_mm", "seconds", "parameters", "longest_m")
        if record.get(name) is not None
    }
    return replace(missing, status=record["status"], reason=record.get("reason", ""), **numbers)
