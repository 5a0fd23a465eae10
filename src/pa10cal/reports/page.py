"""The page of a campaign, of a folder with the results of several, and of a fleet."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

from pa10cal.errors import RecordError
from pa10cal.files.output import write_text
from pa10cal.input_files import read_csv, reason
from pa10cal.reports.accuracy import accuracy, repeats
from pa10cal.reports.blocks import Callout, Links, PageBlock, Paragraph, folded, grid
from pa10cal.reports.errors import headline
from pa10cal.reports.formatting import count, mm
from pa10cal.reports.measured import measurement_section, use
from pa10cal.reports.missing import missing, next_poses
from pa10cal.reports.outcome import errors_by_angle, grade, grade_sentence, verdict, verdict_glance
from pa10cal.reports.parameters import parameters
from pa10cal.reports.pictures import fleet_drawing
from pa10cal.reports.render import Glance, PageSection, images, rendered
from pa10cal.reports.residuals import residuals
from pa10cal.reports.results_bundle import REFUSED, ResultsBundle, is_synthetic, results_bundle
from pa10cal.reports.trust import trust
from pa10cal.results.codec import read
from pa10cal.results.evaluation import BETWEEN
from pa10cal.results.outcomes import FleetCampaign, FleetRecord, PicturesRecord

#: Larger files are no tables that were written here [bytes].
_MOST_TABLE_BYTES = 4_000_000
#: Each kind of attention in words, in the order of urgency.
ATTENTION = {
    "no_result": "no result",
    "input": "check the data",
    "moved": "the arm has changed",
    "incomplete": "an effect is missing",
    "none": "none",
}
#: Campaigns that a callout lists; of more only the first are shown.
_MOST_NAMES = 10


class Section(NamedTuple):
    """A section of a campaign's page."""

    id: str  # in the page
    title: str  # its heading
    # attribute of `ResultsBundle` without which it says only why that is missing; empty for none
    needs: str
    # its blocks, given all results and the result that it needs
    blocks: Callable[..., Iterator[PageBlock]]


#: The sections in the order of reading.
SECTIONS = (
    Section("angles", "Error of each joint over its angle", "", errors_by_angle),
    Section("measured", "What was measured", "", measurement_section),
    Section("grade", "Grade of the calibration", "calibration", grade),
    Section("verdict", "Verdict: what the model lacks", "verdict", verdict),
    Section("accuracy", "Before and after", "", accuracy),
    Section("iso9283", "Pose accuracy and repeatability (ISO 9283)", "iso9283", repeats),
    Section("residuals", "Where the model is off", "", residuals),
    Section("parameters", "Parameters", "calibration", parameters),
    Section("missing", "What is missing", "", missing),
    Section("next", "What to measure next", "", next_poses),
    Section("trust", "How far to trust it", "calibration", trust),
    Section("use", "How to use the model", "", use),
)


def write_page(
    results: Path, out: Path, campaign_dir: Path | None = None, load_case: str = "combined"
) -> tuple[str, int]:
    """Write the page of a results folder, and return the name of its subject and its size in bytes.

    Args:
        results: folder of the results of a campaign, or the folder of all results.
        out: page to write.
        campaign_dir, load_case: see `results_bundle`.

    Raises:
        RecordError, RawDataError: as `results_bundle`.
        OutputError: when the page cannot be written.
    """
    pages = []
    if campaign_dir is None and not (results / PicturesRecord.FILE).exists():
        pages = sorted((*results.glob("*/report.html"), *results.glob("fleet/fleet.html")))
    if pages:
        name, text = results.absolute().name, _overview_text(results, pages)
    else:
        bundle = results_bundle(results, load_case, campaign_dir)
        name, text = bundle.campaign, page_text(bundle)
    write_text(out, text)
    return name, len(text.encode())


def page_text(results: ResultsBundle) -> str:
    """Return the page of a campaign as HTML, with everything in it that it needs."""
    reasons: set[str] = set()  # why results are missing, as given so far
    sections = []
    for section in SECTIONS:
        if section.needs in results.absent:
            blocks: Iterable[PageBlock] = [Callout("missing", results.absent[section.needs])]
        else:
            needed = [getattr(results, section.needs)] if section.needs else []
            blocks = section.blocks(results, *needed)
        shown = [block for block in blocks if _is_news(block, reasons)]
        shown += images(results.pictures, results.folder, section.id)
        sections.append(PageSection(section.id, section.title, tuple(shown)))
    return rendered(results.campaign, list(_glances(results)), sections, results.synthetic)


def _is_news(block: PageBlock, reasons: set[str]) -> bool:
    """Return whether a block is other than a reason, given before, why a result is missing.

    Once a stage is said to have refused, its message explains all results that depend on it. A new
    reason is added to `reasons`.
    """
    if not isinstance(block, Callout) or block.word != "missing":
        return True
    refused = any(REFUSED in reason for reason in reasons)
    if block.text in reasons or (refused and REFUSED not in block.text):
        return False
    reasons.add(block.text)
    return True


def _glances(results: ResultsBundle) -> Iterator[Glance]:
    """Yield grade, verdict and error before and after, each in a word or number."""
    if results.calibration is None:
        yield Glance("Grade", "none", "There is no calibration.")
    else:
        word = results.calibration.health.grade.replace("_", " ")
        more = grade_sentence(results, results.calibration)
        yield Glance("Grade of the calibration", word, more)
    if results.verdict is None:
        yield Glance("Verdict", "none yet", "What the model lacks was not looked for.")
    else:
        yield Glance("Verdict", *verdict_glance(results, results.verdict))
    if (ends := headline(results)) is None:
        return
    before, after = ends
    first, last = before.counted, after.counted
    text = f"rms over {count(first.configurations, f'{before.kind} configuration')}"
    if after.where:
        text += f" {after.where}"
    text += f"; peak {mm(first.peak_mm)} to {mm(last.peak_mm)} mm"
    if flagged := after.with_flagged("rms_mm"):
        text += f"; {flagged}"
    if after.between:
        text += f"; {mm(after.between.rms_mm)} mm {BETWEEN}"
    yield Glance("Position error", f"{mm(first.rms_mm)} → {mm(last.rms_mm)} mm", f"{text}.")


def _overview_text(folder: Path, pages: Sequence[Path]) -> str:
    """Return the page of all results: a link to every page, pictures and tables of studies."""
    links = tuple((str(page.relative_to(folder)), page.parent.name) for page in pages)
    sections = [PageSection("campaigns", "Campaigns", (Links(links),))]
    for path in sorted(folder.rglob(PicturesRecord.FILE)):
        pictures = read(PicturesRecord, path, within=folder)
        if pictures.campaign is None:
            name = str(path.parent.relative_to(folder))
            blocks: list[PageBlock] = [*images(pictures, path.parent, "")]
            for table, caption in (pictures.captions or {}).items():
                file = path.parent / f"tables/{table}.csv"
                if os.path.lexists(file):
                    header, *rows = _table(file, folder)
                    if rows:
                        blocks += [grid(caption.title, header, rows), Paragraph(caption.text)]
            sections.append(PageSection(name, name.replace("_", " "), tuple(blocks)))
    return rendered("All results", [], sections, synthetic=False, heading="Report")


def _table(path: Path, folder: Path) -> list[list[str]]:
    """Return the header and the rows of a table of results.

    Raises:
        RecordError: when it cannot be read, or is no table.
    """
    try:
        rows = [row for _, row in read_csv(path, _MOST_TABLE_BYTES, folder)]
        if len(set(map(len, rows))) > 1:
            raise ValueError("its rows have different lengths")
    except (OSError, ValueError) as error:
        raise RecordError(
            f"a table cannot be read: {reason(error)}",
            where=str(path),
            allowed="a file that pa10cal figures wrote, in the results",
            remedy="write it again",
        ) from None
    return rows or [[]]


# The page of a fleet: the arms that need attention first, then every campaign.


def fleet_page_text(fleet: FleetRecord) -> str:
    """Return the page as HTML, with everything in it that it needs."""
    urgent = [arm for arm in fleet.arms if arm.attention != "none"]
    counts: Counter[str] = Counter(arm.attention for arm in urgent)
    kinds = [f"{counts[kind]} {words}" for kind, words in ATTENTION.items() if counts[kind]]
    glances = [
        Glance("Arms", str(len(fleet.arms)), f"{count(len(fleet.campaigns), 'campaign')} of them."),
        Glance("Need attention", str(len(urgent)), f"{', '.join(kinds) or 'None of them'}."),
    ]
    attention: PageBlock = Paragraph("No arm needs attention.", lead=True)
    if urgent:
        rows = [(arm.arm, arm.last, ATTENTION[arm.attention], arm.why) for arm in urgent]
        attention = grid("The most urgent first", "arm | last campaign | attention | why", rows)
    sections = [PageSection("attention", "Arms that need attention", (attention,))]
    if fleet.last_by_accuracy:
        drawing = fleet_drawing(fleet.last_by_accuracy)
        sections.append(PageSection("errors", "Errors before and after", (drawing,)))
        before_mm, after_mm = (
            median(getattr(campaign.became, name) for campaign in fleet.last_by_accuracy)
            for name in ("before_mm", "after_mm")
        )
        glances.append(
            Glance(
                "Mean position error",
                f"{mm(before_mm)} → {mm(after_mm)} mm",
                "Median over the last campaigns of the arms, uncalibrated and with the final "
                "model.",
            )
        )
    provenances = list(filter(None, (each.became.provenance for each in fleet.campaigns)))
    synthetic = bool(provenances) and all(map(is_synthetic, provenances))
    blocks = list(_campaign_blocks(fleet.campaigns))
    simulated = [c.campaign for c in fleet.campaigns if is_synthetic(c.became.provenance or "")]
    if simulated and not synthetic:
        blocks.insert(0, Callout("note", f"Synthetic data: {_first_of(simulated)}."))
    sections.append(PageSection("campaigns", "Every campaign", tuple(blocks)))
    return rendered("Fleet", glances, sections, synthetic, heading="Fleet report")


def _first_of(names: Sequence[str]) -> str:
    """Return the first names of a list, and whether there are more."""
    return f"{', '.join(names[:_MOST_NAMES])}{' …' * (len(names) > _MOST_NAMES)}"


def _campaign_blocks(campaigns: Sequence[FleetCampaign]) -> Iterator[PageBlock]:
    """Yield a warning of campaigns without a result, all campaigns, and those that differ."""
    lost = [campaign.campaign for campaign in campaigns if campaign.became.status != "done"]
    if lost:
        text = f"{count(len(lost), 'campaign')} gave no result: {_first_of(lost)}."
        yield Callout("warning", text)
    table = grid(
        "Mean position errors",
        "campaign | arm | measured | grade | verdict | effects and faults | before [mm] | "
        "after [mm] | as the campaign before it",
        map(_campaign_row, campaigns),
    )
    yield folded(table, "The table, one row a campaign")
    yield grid(
        "Campaigns whose model differs from the one before it",
        "campaign | arm | what was found",
        (
            (campaign.campaign, campaign.arm, campaign.moved)
            for campaign in campaigns
            if campaign.moved and campaign.agrees is not True
        ),
    )


def _campaign_row(campaign: FleetCampaign) -> tuple[str | float | None, ...]:
    outcome = campaign.became
    return (
        campaign.campaign,
        campaign.arm,
        campaign.measured,
        outcome.grade or outcome.status,
        outcome.verdict,
        "; ".join(outcome.notes or ()) or None,
        outcome.before_mm,
        outcome.after_mm,
        {None: None, True: "agrees", False: "differs"}[campaign.agrees],
    )
