"""What every adapter does alike: read problems, time the calibration call, write records.

An adapter runs in the environment of its peer, once a round, as
`python -m benchmarks.peers.run_<peer> METHOD OUT LIMIT PROBLEM...`. This module needs numpy only.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import signal
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Protocol

import numpy as np

from benchmarks.peers.problem import Array, Problem

#: What a package does on its first call only is not calibration: this long, untimed, before [s].
_WARM_UP_S = 2


@dataclass(frozen=True)
class Fitted:
    """What a calibration says of itself.

    Attributes:
        parameters: how many it fitted.
        converged: whether it says that it converged.
        longest_m: the longest length in what it found, where it has such.
    """

    parameters: int
    converged: bool
    longest_m: float = float("nan")


class Calibration(Protocol):
    """One peer made ready for one problem; only `solve` is timed."""

    def solve(self) -> Fitted:
        """Calibrate."""
        ...

    def predict_m(self, q_rad: Array) -> Array:
        """Return the (P, 3) positions of the target that the calibrated model gives."""
        ...


class OverTimeError(BaseException):
    """The time limit has passed; no `Exception`, as peers catch those and say something else."""


def main(methods: Mapping[str, Callable[[Problem], Calibration]]) -> None:
    """Run one method on the problems named on the command line; one JSON record each."""
    parser = argparse.ArgumentParser()
    parser.add_argument("method", choices=sorted(methods))
    parser.add_argument("out", type=Path)
    parser.add_argument("limit", type=int, help="seconds a problem may take")
    parser.add_argument("problems", type=Path, nargs="+")
    arguments = parser.parse_args()
    make = methods[arguments.method]
    warnings.simplefilter("ignore")
    attempt(make, Problem.read(arguments.problems[0]), _WARM_UP_S)
    for path in arguments.problems:
        record = attempt(make, Problem.read(path), arguments.limit)
        record |= {"method": arguments.method, "problem": path.stem}
        (arguments.out / f"{arguments.method}.{path.stem}.json").write_text(json.dumps(record))


def attempt(
    make: Callable[[Problem], Calibration], problem: Problem, limit_s: int
) -> dict[str, object]:
    """Calibrate once; a peer that fails or takes too long is a record too."""
    try:
        with contextlib.redirect_stdout(io.StringIO()), _limit(limit_s):
            calibration = make(problem)
            began = time.perf_counter()
            fitted = calibration.solve()
            seconds = time.perf_counter() - began
            errors_mm = problem.test_errors_mm(calibration.predict_m(problem.q_test_rad))
    except OverTimeError:
        return {"status": "over time", "reason": f"longer than {limit_s} s"}
    except Exception as error:  # a peer may raise anything; the table says what
        return {"status": "failed", "reason": f"{type(error).__name__}: {error}"[:300]}
    if not np.isfinite(errors_mm).all():
        return {"status": "failed", "reason": "positions that are not finite"}
    return {
        "status": "ok" if fitted.converged else "not converged",
        "reason": "" if fitted.converged else "says itself that it did not converge",
        "seconds": seconds,
        "parameters": fitted.parameters,
        "longest_m": fitted.longest_m if np.isfinite(fitted.longest_m) else None,
        "mean_mm": float(errors_mm.mean()),
        "rms_mm": float(np.sqrt(np.mean(errors_mm**2))),
    }


@contextlib.contextmanager
def _limit(seconds: int) -> Iterator[None]:
    def over(_number: int, _frame: FrameType | None) -> None:
        raise OverTimeError

    before = signal.signal(signal.SIGALRM, over)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
