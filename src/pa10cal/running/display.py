"""Shows how far a run of the workflow is: finished jobs, and on a terminal those at work."""

from __future__ import annotations

import shutil
import sys
import time
from typing import NamedTuple, TextIO

#: What each rule does, in words for a reader; rules that are not listed are shown by their names.
_RULE_TITLES = {
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
#: Rules that do no work: they only collect the outputs of other rules. They are not shown.
_COLLECTING_RULES = {"all", "campaigns", "figures"}


class _Job(NamedTuple):
    """A job that has begun."""

    rule: str
    campaign: str  # may be empty
    began_s: float  # on the monotonic clock

    @property
    def title(self) -> str:
        return _RULE_TITLES.get(self.rule, self.rule)

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.began_s


class RunDisplay:
    """Shows a run on standard error.

    Args:
        lines: whether to print a line for every job that ends; on a terminal this is always done.
        out: stream to write to in place of standard error.
    """

    def __init__(self, *, lines: bool, out: TextIO | None = None) -> None:
        self._out = sys.stderr if out is None else out
        self._live = self._out.isatty()
        self._lines = lines or self._live
        self._began_s = time.monotonic()
        self._jobs: dict[int, _Job] = {}
        self._done, self._total = 0, 0

    @property
    def seconds(self) -> float:
        """Return how long the run has taken."""
        return time.monotonic() - self._began_s

    def started(self, job_id: int, rule: str, campaign: str) -> None:
        """Note that a job has begun."""
        self._jobs[job_id] = _Job(rule, campaign, time.monotonic())
        self.tick()

    def finished(self, job_id: int) -> None:
        """Print that a job has ended, and how long it took."""
        job = self._jobs.pop(job_id, None)
        if not self._lines or job is None or job.rule in _COLLECTING_RULES:
            return
        self.close()
        title = f"{job.campaign}: {job.title}".removeprefix(": ")
        print(f"  {title:<48} {job.seconds:7.1f} s", file=self._out, flush=True)
        self.tick()

    def progress(self, done: int, total: int) -> None:
        """Note how many jobs are done, of how many."""
        self._done, self._total = done, total

    def tick(self) -> None:
        """Show on a terminal which jobs are at work."""
        if not self._live:
            return
        at_work = [
            f"{job.title} {job.seconds:.0f} s"
            for job in self._jobs.values()
            if job.rule not in _COLLECTING_RULES
        ]
        done = f"{self._done} of {self._total}: " if self._total else ""
        text = f"  {done}{', '.join(at_work) or 'planning'} …"
        self.close()
        self._out.write(text[: shutil.get_terminal_size().columns - 1])
        self._out.flush()

    def close(self) -> None:
        """Erase the line that shows the jobs at work."""
        if self._live:
            # The command line wraps its streams so that control characters become visible.
            terminal: TextIO = getattr(self._out, "terminal", self._out)
            terminal.write("\r\x1b[K")
            terminal.flush()
