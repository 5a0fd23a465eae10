"""What a run ends with: one table of campaigns, what to know of each, and the paths."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from pa10cal.input_files import is_file, read_csv
from pa10cal.reports.errors import better_general, headline
from pa10cal.reports.results_bundle import OUTPUTS, ResultsBundle
from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
from pa10cal.results.discovery import NamedEffect, VerdictKeys, VerdictRecord
from pa10cal.results.evaluation import HoldoutRecord
from pa10cal.results.fleet import ChainRecord
from pa10cal.terms import wording

_HEAD = ("campaign", "grade", "verdict", "before", "after", "mean error over")


@dataclass(frozen=True)
class CampaignSummary:
    """What a reader is told of a campaign."""

    outcome: ChainRecord  # what it came to
    # mean errors before and after without configurations that have a reading far from the model
    # [mm], and in words the error after with them; None where there is none
    trusted: tuple[float, float] | None = None
    with_flagged: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """Return the sentence of the grade, effects and faults, a line each."""
        return (f"{self.outcome.grade}: {self.outcome.line}", *(self.outcome.notes or ()))


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
    verdict, _ = bundle.read(VerdictRecord), bundle.read(HoldoutRecord)
    ends = headline(bundle)
    assert ends is not None  # those of the calibration at least
    before, after = ends
    prior = fitted.prior if isinstance(fitted, GeneralCalibrationRecord) else None
    about_fit = (None if prior is None else prior.line, better_general(bundle))
    outcome = ChainRecord(
        campaign=fitted.campaign,
        status="done",
        robot=fitted.robot,
        provenance=fitted.provenance,
        grade=fitted.health.grade,
        line=fitted.health.line,
        verdict=verdict.verdict,
        notes=(*filter(None, about_fit), *notes(verdict)),
        before_mm=before.of.mean_mm,
        after_mm=after.of.mean_mm,
        over=after.over,
    )
    if before.trusted is None:
        return CampaignSummary(outcome)
    trusted = before.trusted.mean_mm, after.counted.mean_mm
    return CampaignSummary(outcome, trusted, after.with_flagged("mean_mm"))


def notes(verdict: VerdictKeys) -> tuple[str, ...]:
    """Return what a verdict says beside its word, in one line each."""
    by_share = verdict.effects_by_share
    # Where all are named, each is all but certain.
    sure = verdict.verdict == "named"
    effects = [each.either if sure else _with_probabilities(each) for each in by_share]
    lead = verdict.explained
    explained = [wording.headline(lead), *wording.sentences(lead)[:1]] if lead and lead.of else []
    named = [f"{verdict.verdict}: {', '.join(effects)}"] if effects else []
    unsought = [f"not_sought: {verdict.why}; {verdict.remedy}"] if verdict.why else []
    nameless = [
        f"unexplained: {place.of or 'place not known'}: {place.why}"
        for place in (verdict.unexplained.all if verdict.unexplained else ())
    ]
    alike: dict[tuple[str, str], list[str]] = {}
    for fault in verdict.faults or ():
        alike.setdefault((fault.what, fault.remedy), []).append(fault.where)
    faults = [
        f"the log: {where[0]}{f' and {len(where) - 1} more' * (len(where) > 1)}: {what}; {remedy}"
        for (what, remedy), where in alike.items()
    ]
    return (*explained, *named, *unsought, *nameless, *faults)


def _with_probabilities(effect: NamedEffect) -> str:
    """Return an effect and what else is likely, each with its probability."""
    first = f"{effect.id} of {effect.of} ({effect.probability:.2f})"
    others = (f"{each.id} of {each.of} ({each.probability:.2f})" for each in effect.likely)
    return " or ".join((first, *others))


def table(campaigns: Sequence[CampaignSummary]) -> str:
    """Return the table, and under it what to know of each campaign."""
    rows: list[Sequence[str]] = [_HEAD]
    for of in campaigns:
        outcome = of.outcome
        errors = of.trusted or (outcome.before_mm, outcome.after_mm)
        before, after = ("—" if mm is None else f"{mm:.3f} mm" for mm in errors)
        over = "; ".join(filter(None, (outcome.over, of.with_flagged)))
        words = outcome.campaign, str(outcome.grade), str(outcome.verdict)
        rows.append((*words, before, after, over))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    rows.insert(1, ["-" * width for width in widths])
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    known = [
        f"{of.outcome.campaign}: {note}" if len(campaigns) > 1 else note
        for of in campaigns
        for note in of.notes
    ]
    return "\n".join((*lines, "", *known))


def paths(results: Path) -> str:
    """Return what a campaign's folder holds, one line each; no table without a row."""
    found = []
    for name, title, _ in OUTPUTS:
        path = results / name
        there = bool(title) and path.exists()
        if there and path.suffix == ".csv":
            there = is_file(path, results)
            rows = read_csv(path, path.stat().st_size, results) if there else ()
            there = len(list(islice(rows, 2))) > 1
        if there:
            found.append((title, path))
    width = max((len(title) for title, _ in found), default=0)
    return "\n".join(f"{title:<{width}}  {_short(path)}" for title, path in found)


def reports(results: Iterable[Path]) -> str:
    """Return where the reports of some campaigns are, one line each."""
    return "\n".join(f"report  {_short(folder / 'report.html')}" for folder in results)


def _short(path: Path) -> Path:
    """Return a path from the working folder, where it lies below that."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
