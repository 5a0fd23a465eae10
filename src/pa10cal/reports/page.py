"""The page of a campaign, and the page of a folder with the results of several."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from pa10cal.errors import RecordError
from pa10cal.files.output import write_text
from pa10cal.input_files import read_csv, reason
from pa10cal.reports.accuracy import accuracy, parameters, repeats
from pa10cal.reports.blocks import Callout, Links, PageBlock, Paragraph, grid
from pa10cal.reports.errors import headline
from pa10cal.reports.formatting import count, mm
from pa10cal.reports.measured import measurement_section, use
from pa10cal.reports.outcome import errors_by_angle, grade, grade_sentence, verdict, verdict_glance
from pa10cal.reports.render import Glance, PageSection, images, rendered
from pa10cal.reports.residuals import residuals
from pa10cal.reports.results_bundle import REFUSED, ResultsBundle, results_bundle
from pa10cal.reports.trust import missing, next_poses, trust
from pa10cal.results.codec import read
from pa10cal.results.evaluation import BETWEEN
from pa10cal.results.fleet import PicturesRecord

#: Larger files are no tables that were written here [bytes].
_MOST_TABLE_BYTES = 4_000_000


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
        needed = [getattr(results, section.needs)] if section.needs else []
        blocks: list[PageBlock] = []
        if None in needed:
            blocks = [Callout("missing", results.absent[section.needs])]
        else:
            blocks = list(section.blocks(results, *needed))
        shown = [block for block in blocks if not block.empty and _is_news(block, reasons)]
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
        yield Glance("Verdict", *verdict_glance(results.verdict))
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
                    blocks += [grid(caption.title, header, rows), Paragraph(caption.text)]
            sections.append(PageSection(name, name.replace("_", " "), tuple(blocks)))
    return rendered("All results", [], sections, synthetic=False, heading="Report")


def _table(path: Path, folder: Path) -> list[list[str]]:
    try:
        rows = [row for _, row in read_csv(path, _MOST_TABLE_BYTES, folder)]
    except (OSError, ValueError) as error:
        raise RecordError(
            f"a table cannot be read: {reason(error)}",
            where=str(path),
            allowed="a file that pa10cal figures wrote, in the results",
            remedy="write it again",
        ) from None
    return rows or [[]]
