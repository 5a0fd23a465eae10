"""What a run ends with: one table of campaigns, what to know of each, and the paths."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
from pa10cal.results.discovery import VerdictKeys, VerdictRecord
from pa10cal.results.evaluation import Accuracy, HoldoutRecord, flagged
from pa10cal.results.fleet import ChainRecord

_HEAD = ("campaign", "grade", "verdict", "before", "after", "mean error over")
#: What a campaign's folder holds for its reader.
_PATHS = {
    "report": "report.html",
    "model": "model/model.yaml",
    "URDF": "model/robot.urdf",
    "table of link parameters": "model/dh.csv",
    "kinematics of the UR driver": "model/ur_kinematics.yaml",
    "figures": "figures",
    "tables": "tables",
    "rows not used": "ingest/quarantine.csv",
    "poses to measure next": "discovery/suggested_poses.csv",
}


@dataclass(frozen=True)
class CampaignSummary:
    """What a reader is told of a campaign."""

    became: ChainRecord  # what it came to
    # mean errors before and after without configurations that have a reading flagged as wrong [mm],
    # and in words the error after with them; None where there is none
    trusted: tuple[float, float] | None = None
    with_flagged: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """Return the sentence of the grade, effects and faults, a line each."""
        return (f"{self.became.grade}: {self.became.line}", *(self.became.notes or ()))

    @property
    def cells(self) -> tuple[str, ...]:
        """Return its row of the table."""
        became = self.became
        counted = self.trusted or (became.before_mm, became.after_mm)
        before, after = ("—" if mm is None else f"{mm:.3f} mm" for mm in counted)
        over = "; ".join(filter(None, (became.over, self.with_flagged)))
        return (became.campaign, str(became.grade), str(became.verdict), before, after, over)


def summarise(results: Path, calibration: str = "combined") -> CampaignSummary:
    """Read the results of a campaign.

    Args:
        results: its folder.
        calibration: load case that was evaluated.

    Raises:
        RecordError: when one of them is missing.
    """
    bundle = ResultsBundle(results, calibration)
    fitted = bundle.read(CalibrationRecord, f"calibration/{calibration}.json")
    verdict, held_out = bundle.read(VerdictRecord), bundle.read(HoldoutRecord)
    before, after = _errors(fitted, verdict, held_out)
    became = ChainRecord(
        campaign=fitted.campaign,
        status="done",
        robot=fitted.robot,
        provenance=fitted.provenance,
        grade=fitted.health.grade,
        line=fitted.health.line,
        verdict=verdict.verdict,
        notes=(*_started(fitted), *notes(verdict)),
        before_mm=before,
        after_mm=after,
        over="held-out poses" if held_out.models else "fitted poses",
    )
    return CampaignSummary(became, *_trusted(fitted, verdict, held_out))


def _started(fitted: CalibrationRecord) -> tuple[str, ...]:
    """Return what a calibration says of the model that it started from, if it did from one."""
    prior = fitted.prior if isinstance(fitted, GeneralCalibrationRecord) else None
    return () if prior is None else (prior.line,)


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


def _trusted(
    fitted: CalibrationRecord, verdict: VerdictRecord, held_out: HoldoutRecord
) -> tuple[tuple[float, float] | None, str]:
    """Return `_errors` without what is flagged as wrong, and in words the error after with it.

    None where nothing is.
    """
    if held_out.models:
        *_, last = held_out.models.values()
        first = held_out.models["uncalibrated"].trusted
        if first is None or last.trusted is None:
            return None, ""
        count = last.configurations - last.trusted.configurations
        apart = f"with {flagged(count)} {last.mean_mm:.3f} mm"
        return (first.mean_mm, last.trusted.mean_mm), apart
    every = list(fitted.errors.values())
    count = sum(e.after.configurations - e.trusted.after.configurations for e in every if e.trusted)
    before = _mean((each.trusted or each).before for each in every)
    after = _mean((each.trusted or each).after for each in every)
    whole = _mean(each.after for each in every)
    if not count or before is None or after is None:
        return None, ""
    # Where effects were found, their search had no readings that it lists as outliers.
    last_mm = verdict.gap.train.after.mean_mm if verdict.effects else after
    return (before, last_mm), f"with {flagged(count)} {whole:.3f} mm"


def _mean(errors: Iterable[Accuracy]) -> float | None:
    found = [(each.mean_mm, each.configurations) for each in errors]
    count = sum(configurations for _, configurations in found)
    return sum(mean * part for mean, part in found) / count if count else None


def notes(verdict: VerdictKeys) -> tuple[str, ...]:
    """Return what a verdict says beside its word, in one line each."""
    effects = [each.either for each in verdict.effects_by_share]
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
        f"{each.became.campaign}: {note}" if len(campaigns) > 1 else note
        for each in campaigns
        for note in each.notes
    ]
    return "\n".join((*lines, "", *told))


def paths(results: Path) -> str:
    """Return what a campaign's folder holds, one line each."""
    found = [
        (title, results / name)
        for title, name in _PATHS.items()
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
