"""How far a run is: a line a job, and on a terminal what is at work now."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TextIO

from pa10cal.results.calibration import CalibrationRecord
from pa10cal.results.codec import read
from pa10cal.results.discovery import VerdictKeys, VerdictRecord
from pa10cal.results.evaluation import Accuracy, HoldoutRecord

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
        self._clear()
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
        self._clear()
        self._out.write(text[: shutil.get_terminal_size().columns - 1])
        self._out.flush()

    def close(self) -> None:
        """Take what is at work off the terminal."""
        self._clear()

    def _clear(self) -> None:
        if self._live:
            self._out.write("\r\x1b[K")
            self._out.flush()


# What a run ends with: one table of campaigns, what to know of each, and the paths.

_HEAD = ("campaign", "grade", "verdict", "before", "after", "mean error over")
#: What a campaign's folder holds for its reader, the first that is there of each line.
_PATHS = {
    "report": ("report.html",),
    "model": ("model/model.yaml",),
    "URDF": ("model/robot.urdf",),
    "table of link parameters": ("model/dh.csv",),
    "kinematics of the UR driver": ("model/ur_kinematics.yaml",),
    "figures": ("figures",),
    "tables": ("tables",),
    "rows not used": ("ingest/quarantine.csv",),
    "poses to measure next": ("discovery/suggested_poses.csv",),
}


@dataclass(frozen=True)
class CampaignSummary:
    """What a reader is told of a campaign."""

    # name, grade and verdict: in a word each
    name: str
    grade: str
    verdict: str
    # before and after: mean error of the uncalibrated arm and of the final model [mm]
    before: float | None
    after: float | None
    over: str  # poses that these are of: `held-out poses` or `fitted poses`
    notes: tuple[str, ...]  # the sentence of the grade, effects, faults

    @property
    def cells(self) -> tuple[str, ...]:
        """Return its row of the table."""
        before, after = ("—" if mm is None else f"{mm:.3f} mm" for mm in (self.before, self.after))
        return (self.name, self.grade, self.verdict, before, after, self.over)


def summarise(results: Path, calibration: str = "combined") -> CampaignSummary:
    """Read the results of a campaign.

    Args:
        results: its folder.
        calibration: load case that was evaluated.

    Raises:
        RecordError: when one of them is missing.
    """
    fitted = read(CalibrationRecord, results / f"calibration/{calibration}.json")
    verdict = read(VerdictRecord, results / "discovery/verdict.json")
    held_out = read(HoldoutRecord, results / "evaluation/holdout.json")
    before, after = _errors(fitted, verdict, held_out)
    return CampaignSummary(
        fitted.campaign,
        fitted.health.grade,
        verdict.verdict,
        before,
        after,
        "held-out poses" if held_out.models else "fitted poses",
        (f"{fitted.health.grade}: {fitted.health.line}", *notes(verdict)),
    )


def _errors(
    fitted: CalibrationRecord, verdict: VerdictRecord, held_out: HoldoutRecord
) -> tuple[float | None, float | None]:
    """Return mean errors before and after [mm]: held out, or without such poses as fitted."""
    if held_out.models:
        *_, last = held_out.models.values()
        return held_out.models["uncalibrated"].mean_mm, last.mean_mm
    before = _mean(each.before for each in fitted.errors.values())
    gap = verdict.gap.train
    return before, gap.after.mean_mm if gap else _mean(e.after for e in fitted.errors.values())


def _mean(errors: Iterable[Accuracy]) -> float | None:
    found = [(each.mean_mm, each.configurations) for each in errors]
    count = sum(configurations for _, configurations in found)
    return sum(mean * part for mean, part in found) / count if count else None


def notes(verdict: VerdictKeys) -> tuple[str, ...]:
    """Return what a verdict says beside its word, in one line each."""
    effects = [
        " or ".join(f"{name.id} of {name.of}" for name in (each, *each.alternatives))
        for each in verdict.effects_by_share
    ]
    lead = verdict.explained
    explained = [lead.headline, *lead.sentences[:1]] if lead is not None and lead.of else []
    named = [f"{verdict.verdict}: {', '.join(effects)}"] if effects else []
    unsought = [f"not_sought: {verdict.why}; {verdict.remedy}"] if verdict.why else []
    nameless = [
        f"unexplained: {place.of or 'place not known'}: {place.why}"
        for place in (verdict.unexplained.all if verdict.unexplained else ())
    ]
    faults = [
        f"the log: {fault.where}: {fault.what}; {fault.remedy}" for fault in verdict.faults or ()
    ]
    return (*explained, *named, *unsought, *nameless, *faults)


def table(campaigns: Sequence[CampaignSummary]) -> str:
    """Return the table, and under it what to know of each campaign."""
    rows = [_HEAD, *(each.cells for each in campaigns)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(_HEAD))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    lines.insert(1, "  ".join("-" * width for width in widths))
    told = [
        f"{each.name}: {note}" if len(campaigns) > 1 else note
        for each in campaigns
        for note in each.notes
    ]
    return "\n".join((*lines, "", *told))


def paths(results: Path) -> str:
    """Return what a campaign's folder holds, one line each."""
    found = [
        (title, results / name)
        for title, names in _PATHS.items()
        for name in names
        if _holds_something(results / name)
    ]
    width = max((len(title) for title, _ in found), default=0)
    return "\n".join(f"{title:<{width}}  {_short(path)}" for title, path in found)


def _holds_something(path: Path) -> bool:
    """Return whether a file or folder is there and, if a table, has a row below its header."""
    if path.suffix != ".csv" or not path.exists():
        return path.exists()
    with path.open(encoding="utf-8") as file:
        return len(list(islice(file, 2))) > 1


def reports(results: Iterable[Path]) -> str:
    """Return where the reports of some campaigns are, one line each."""
    return "\n".join(f"report  {_short(folder / 'report.html')}" for folder in results)


def _short(path: Path) -> Path:
    """Return a path from the working folder, where it lies below that."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
