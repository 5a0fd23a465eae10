"""What a run prints at its end: one table of campaigns, notes on each, and where results are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pa10cal.reports.errors import better_general, headline
from pa10cal.reports.results_bundle import OUTPUTS, ResultsBundle
from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord, Grade
from pa10cal.results.discovery import ExtendedRecord, NamedEffect, VerdictKeys, VerdictRecord
from pa10cal.results.evaluation import HoldoutRecord
from pa10cal.results.number_text import shown_probability
from pa10cal.results.outcomes import ChainRecord
from pa10cal.terms import wording

_HEAD = ("campaign", "grade", "verdict", "before", "after", "mean error over")


@dataclass(frozen=True)
class CampaignSummary:
    """The results of a campaign in short."""

    outcome: ChainRecord  # its grade, verdict and errors
    # Where configurations have a reading far from the model: mean errors before and after without
    # them [mm], and in words the error after with them.
    trusted: tuple[float, float] | None = None
    with_flagged: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """Return the sentence of the grade, and those on effects and faults."""
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
    verdict = bundle.read(VerdictRecord)
    bundle.read(HoldoutRecord)  # refused where it is missing: errors count over held-out poses
    before_and_after = headline(bundle)
    assert before_and_after is not None  # there are those of the calibration at least
    before, after = before_and_after
    prior = fitted.prior if isinstance(fitted, GeneralCalibrationRecord) else None
    about_fit = (None if prior is None else prior.line, better_general(bundle))
    grade, line = _grade_as_exported(fitted, bundle.extended)
    outcome = ChainRecord(
        campaign=fitted.campaign,
        status="done",
        robot=fitted.robot,
        provenance=fitted.provenance,
        grade=grade,
        line=line,
        verdict=verdict.verdict,
        notes=(*filter(None, about_fit), *notes(verdict)),
        before_mm=before.accuracy.mean_mm,
        after_mm=after.accuracy.mean_mm,
        over=after.over,
    )
    if before.trusted is None:
        return CampaignSummary(outcome)
    trusted = before.trusted.mean_mm, after.counted.mean_mm
    return CampaignSummary(outcome, trusted, after.with_flagged("mean_mm"))


def _grade_as_exported(
    fitted: CalibrationRecord, extended: ExtendedRecord | None
) -> tuple[Grade, str]:
    """Return grade and sentence: of the exported model, where what was found explains the other."""
    health = fitted.health
    about = {} if extended is None else extended.fitted_model.get("fitted_to") or {}
    if extended is None or not extended.adds_parameters:
        return health.grade, health.line
    if health.grade != "suspect_input" and not extended.moved_zeros:
        return health.grade, health.line
    if not isinstance(about, Mapping) or about.get("grade") != "incomplete":
        return health.grade, health.line
    return "incomplete", str(about["health"])


def notes(verdict: VerdictKeys) -> tuple[str, ...]:
    """Return what a verdict says beside its word, in one line each."""
    lines = []
    lead = verdict.explained
    if lead is not None and lead.of:
        lines += [wording.headline(lead), *wording.sentences(lead)[:1]]
    # Where the verdict is `named`, each effect is all but certain.
    certain = verdict.verdict == "named"
    effects = [
        effect.either if certain else _with_probabilities(effect)
        for effect in verdict.effects_by_share
    ]
    if effects:
        lines.append(f"{verdict.verdict}: {', '.join(effects)}")
    if verdict.why:
        lines.append(f"not_sought: {verdict.why}; {verdict.remedy}")
    for place in verdict.unexplained.all if verdict.unexplained else ():
        lines.append(f"unexplained: {place.of or 'place not known'}: {place.why}")
    places: dict[tuple[str, str], list[str]] = {}  # of faults of one kind
    for fault in verdict.faults or ():
        places.setdefault((fault.what, fault.remedy), []).append(fault.where)
    for (what, remedy), (first, *others) in places.items():
        more = f" and {len(others)} more" if others else ""
        lines.append(f"the log: {first}{more}: {what}; {remedy}")
    return tuple(lines)


def _with_probabilities(effect: NamedEffect) -> str:
    """Return an effect and its likely alternatives, each with its probability."""
    first = f"{effect.id} of {effect.of} ({shown_probability(effect.probability)})"
    others = [
        f"{each.id} of {each.of} ({shown_probability(each.probability)})" for each in effect.likely
    ]
    return " or ".join((first, *others))


def table(campaigns: Sequence[CampaignSummary]) -> str:
    """Return a table with a row for each campaign, and below it the notes on each."""
    rows: list[Sequence[str]] = [_HEAD]
    known = []
    for campaign in campaigns:
        outcome = campaign.outcome
        errors_mm = campaign.trusted or (outcome.before_mm, outcome.after_mm)
        errors = ("—" if error_mm is None else f"{error_mm:.3f} mm" for error_mm in errors_mm)
        over = "; ".join(filter(None, (outcome.over, campaign.with_flagged)))
        words = outcome.campaign, str(outcome.grade), str(outcome.verdict)
        rows.append((*words, *errors, over))
        prefix = f"{outcome.campaign}: " if len(campaigns) > 1 else ""
        known += [f"{prefix}{note}" for note in campaign.notes]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    rows.insert(1, ["-" * width for width in widths])
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    return "\n".join((*lines, "", *known))


def paths(results: Path) -> str:
    """Return where the results of a campaign are, one line each; none that is empty."""
    there = [output for output in OUTPUTS if output.title and output.has_content(results)]
    found = [(output.title, results / output.path) for output in there]
    width = max((len(title) for title, _ in found), default=0)
    return "\n".join(f"{title:<{width}}  {_short(path)}" for title, path in found)


def reports(results: Iterable[Path]) -> str:
    """Return where the reports of some campaigns are, one line each."""
    return "\n".join(f"report  {_short(folder / 'report.html')}" for folder in results)


def _short(path: Path) -> Path:
    """Return a path relative to the working folder, if it lies below it."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
