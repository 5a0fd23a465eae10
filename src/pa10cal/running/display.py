"""How far a run is: a line a job, and on a terminal what is at work now."""

from __future__ import annotations

import shutil
import sys
import time
from typing import TextIO

#: What rules do, for a reader; the name of a rule that is not here.
_WORDS = {
    "ingest": "read the raw files",
    "base_frame": "locate base and targets",
    "calibrate": "calibrate",
    "calibrate_baseline": "calibrate without effects",
    "montecarlo": "Monte Carlo of the joint sensors",
    "discover": "look for missing effects",
    "evaluate": "judge held-out poses",
    "export": "write the model",
    "pictures": "draw figures and tables",
    "page": "write the report",
    "chain": "raw files to model",
    "fleet": "summarise the fleet",
    "judge_trials": "blind trials",
    "score_trials": "score blind trials",
    "trial_pictures": "draw blind trials",
}
#: Rules that only gather what others made.
_SILENT = {"all", "campaigns", "figures"}


class RunDisplay:
    """Shows a run on standard error.

    Args:
        lines: whether every job gets a line; else nothing is shown but on a terminal.
        out: where to.
    """

    def __init__(self, *, lines: bool, out: TextIO | None = None) -> None:
        self._out = sys.stderr if out is None else out
        self._live = self._out.isatty()
        self._lines = lines or self._live
        self._began = time.monotonic()
        self._running: dict[int, tuple[str, str, float]] = {}
        self._done, self._total = 0, 0

    @property
    def seconds(self) -> float:
        """Return how long the run has taken."""
        return time.monotonic() - self._began

    def started(self, job: int, rule: str, campaign: str) -> None:
        """Note that a job has begun."""
        self._running[job] = (rule, campaign, time.monotonic())
        self.tick()

    def finished(self, job: int) -> None:
        """Show that a job has ended, and how long it took."""
        rule, campaign, began = self._running.pop(job, ("", "", 0.0))
        if not self._lines or not rule or rule in _SILENT:
            return
        self.close()
        title = f"{campaign}: {_WORDS.get(rule, rule)}".removeprefix(": ")
        print(f"  {title:<48} {time.monotonic() - began:7.1f} s", file=self._out, flush=True)
        self.tick()

    def progress(self, done: int, total: int) -> None:
        """Note how many jobs are done."""
        self._done, self._total = done, total

    def tick(self) -> None:
        """Show on a terminal what is at work."""
        if not self._live:
            return
        now = time.monotonic()
        jobs = [
            f"{_WORDS.get(rule, rule)} {now - began:.0f} s"
            for rule, _, began in self._running.values()
            if rule not in _SILENT
        ]
        counted = f"{self._done} of {self._total}: " if self._total else ""
        text = f"  {counted}{', '.join(jobs) or 'planning'} …"
        self.close()
        self._out.write(text[: shutil.get_terminal_size().columns - 1])
        self._out.flush()

    def close(self) -> None:
        """Take what is at work off the terminal."""
        if self._live:
            self._out.write("\r\x1b[K")
            self._out.flush()
