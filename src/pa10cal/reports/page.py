"""The page: its head, its sections in the order of reading, and its text."""

from __future__ import annotations

import csv
from base64 import b64encode
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pa10cal.files.output import write_text
from pa10cal.reports.accuracy import accuracy, parameters, repeats
from pa10cal.reports.blocks import (
    Beside,
    Block,
    Callout,
    Drawing,
    Folded,
    Image,
    Links,
    Paragraph,
    Section,
    grid,
)
from pa10cal.reports.errors import headline
from pa10cal.reports.formatting import count, mm
from pa10cal.reports.measured import measured, use
from pa10cal.reports.outcome import grade, grade_sentence, verdict, verdict_glance
from pa10cal.reports.residuals import residuals
from pa10cal.reports.results_bundle import REFUSED, ResultsBundle, is_synthetic, results_bundle
from pa10cal.reports.theme import BLUE, VERMILLION, drawn, library, new_figure
from pa10cal.reports.trust import missing, next_poses, trust
from pa10cal.results.codec import read
from pa10cal.results.fleet import FleetCampaign, FleetRecord, PicturesRecord

#: The sections in the order of reading: id in the page, heading, and what yields their blocks.
SECTIONS = (
    ("measured", "What was measured", measured),
    ("grade", "Grade of the calibration", grade),
    ("verdict", "Verdict: what the model lacks", verdict),
    ("accuracy", "Before and after", accuracy),
    ("iso9283", "Pose accuracy and repeatability (ISO 9283)", repeats),
    ("residuals", "Where the model is off", residuals),
    ("parameters", "Parameters", parameters),
    ("missing", "What is missing", missing),
    ("next", "What to measure next", next_poses),
    ("trust", "How far to trust it", trust),
    ("use", "How to use the model", use),
)
SYNTHETIC = "Synthetic data: simulated, no robot was measured."


@dataclass(frozen=True)
class Glance:
    """One of the answers at the top of the page."""

    question: str  # what it answers
    answer: str  # in a word or a number
    more: str  # one sentence


def write_page(
    results: Path, out: Path, campaign_dir: Path | None = None, load_case: str = "combined"
) -> tuple[str, int]:
    """Write the page of a results folder, and return its name and the size in bytes.

    Args:
        results, load_case, campaign_dir: see `results_bundle`; or the folder of all results.
        out: page to write.

    Raises:
        RecordError, RawDataError: as `results_bundle`.
        OutputError: when the page cannot be written.
    """
    if campaign_dir is None and not (results / PicturesRecord.FILE).exists() and pages_in(results):
        name, text = results.absolute().name, overview_text(results)
    else:
        found = results_bundle(results, load_case, campaign_dir)
        name, text = found.campaign, page_text(found)
    write_text(out, text)
    return name, len(text.encode())


def page_text(results: ResultsBundle) -> str:
    """Return the page of a campaign as HTML, everything in it that it needs."""
    return rendered(
        results.campaign,
        list(_glances(results)),
        list(
            _said_once(
                Section(
                    id, title, (*blocks(results), *images(results.pictures, results.folder, id))
                )
                for id, title, blocks in SECTIONS
            )
        ),
        synthetic=results.synthetic,
    )


def images(pictures: PicturesRecord | None, folder: Path, section: str) -> Iterator[Image]:
    """Yield the figures and films of a results folder that one section shows."""
    for name, of in ((pictures and pictures.captions) or {}).items():
        for kind, endings in (("svg+xml", ("svg", "png")), ("gif", ("gif",))):
            path = folder / f"figures/{name}.{endings[0]}"
            if of.section == section and path.exists():
                content = b64encode(path.read_bytes()).decode()
                source = f"data:image/{kind};base64,{content}"
                yield Image(source, of.title, of.text, name, endings)


# The page of all results: where the page of every campaign is, and the pictures of every study.


def pages_in(folder: Path) -> list[Path]:
    """Return the pages of the campaigns, and of the fleet, below a folder of results."""
    return sorted((*folder.glob("*/report.html"), *folder.glob("fleet/fleet.html")))


def overview_text(folder: Path) -> str:
    """Return the page of a folder of results, everything in it that it needs."""
    links = [(str(page.relative_to(folder)), page.parent.name) for page in pages_in(folder)]
    sections = [Section("campaigns", "Campaigns", (Links(tuple(links)),))]
    for path in sorted(folder.rglob(PicturesRecord.FILE)):
        pictures = read(PicturesRecord, path)
        if pictures.campaign is None:
            name = str(path.parent.relative_to(folder))
            shown = (*images(pictures, path.parent, ""), *_tables(pictures, path.parent))
            sections.append(Section(name, name.replace("_", " "), shown))
    return rendered("All results", [], sections, synthetic=False, over="Report")


def _tables(pictures: PicturesRecord, folder: Path) -> Iterator[Block]:
    """Yield the tables of a study, as their CSV files hold them."""
    for name, of in (pictures.captions or {}).items():
        path = folder / f"tables/{name}.csv"
        if path.exists():
            with path.open(encoding="utf-8", newline="") as file:
                header, *rows = csv.reader(file)
            yield grid(of.title, header, rows)
            yield Paragraph(of.text)


def _said_once(sections: Iterable[Section]) -> Iterator[Section]:
    """Yield sections with every reason why a result is missing once, and none without more.

    Where a stage has refused, its message alone says why all that follows it is missing.
    """
    said: set[str] = set()
    for section in sections:
        kept = []
        for block in section.blocks:
            if isinstance(block, Callout) and block.word == "missing":
                refused = any(REFUSED in text for text in said)
                if block.text in said or (refused and REFUSED not in block.text):
                    continue
                said.add(block.text)
            kept.append(block)
        if kept:
            yield Section(section.id, section.title, tuple(kept))


def rendered(
    title: str,
    glances: Sequence[Glance],
    sections: Sequence[Section],
    *,
    synthetic: bool,
    over: str = "Calibration report",
) -> str:
    """Return a page as HTML, everything in it that it needs.

    Args:
        title: what it is of.
        glances: the answers at its top.
        sections: in the order of reading.
        synthetic: whether what it shows was simulated.
        over: what kind of page it is, above the title.
    """
    environment = Environment(
        loader=PackageLoader("pa10cal.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    style, script = (
        files("pa10cal.reports").joinpath(f"templates/page.{ending}").read_text(encoding="utf-8")
        for ending in ("css", "js")
    )
    text: str = environment.get_template("page.html.j2").render(
        campaign=title,
        over=over,
        synthetic=SYNTHETIC if synthetic else None,
        glances=glances,
        sections=sections,
        style=Markup(style),
        script=Markup(script),
        library=library() if any(map(_draws, sections)) else None,
        drawn=drawn,
        version=version("pa10cal"),
    )
    return text


def _glances(results: ResultsBundle) -> Iterator[Glance]:
    if results.calibration is None:
        yield Glance("Grade", "none", "There is no calibration.")
    else:
        health = results.calibration.health
        more = grade_sentence(health)
        if results.verdict is not None and results.verdict.effects:
            more += " This is before the effects found are added."
        yield Glance("Grade of the calibration", health.grade.replace("_", " "), more)
    if results.verdict is None:
        yield Glance("Verdict", "none yet", "What the model lacks was not looked for.")
    else:
        yield Glance("Verdict", *verdict_glance(results.verdict))
    ends = headline(results)
    if ends is not None:
        before, after = ends
        apart = f"; {told}" if (told := after.with_flagged("rms_mm")) else ""
        first, last = before.counted, after.counted
        over = f"rms over {count(first.configurations, f'{before.kind} configuration')}"
        peaks = f"peak {mm(first.peak_mm)} to {mm(last.peak_mm)} mm"
        said = f"{mm(first.rms_mm)} → {mm(last.rms_mm)} mm"
        yield Glance("Position error", said, f"{over}; {peaks}{apart}.")


def _draws(part: Section | Folded) -> bool:
    """Return whether there is a figure in a part of the page."""
    return any(
        isinstance(block, Drawing | Beside) or (isinstance(block, Folded) and _draws(block))
        for block in part.blocks
    )


# The page of a fleet: arms that need attention first, then every campaign.

#: What a reader is told of each kind of attention, in the order of urgency.
ATTENTION = {
    "no_result": "no result",
    "input": "check the data",
    "moved": "the arm has changed",
    "incomplete": "an effect is missing",
    "none": "none",
}
_ROW_PX, _LEAST_PX, _MOST_PX = 16, 300, 1600


def fleet_page_text(fleet: FleetRecord) -> str:
    """Return the page as HTML, everything in it that it needs."""
    sections = [Section("attention", "Arms that need attention", tuple(_first(fleet)))]
    if fleet.judged:
        sections.append(Section("errors", "Errors before and after", (_errors(fleet),)))
    sections.append(Section("campaigns", "Every campaign", tuple(_campaigns(fleet))))
    told = [each.became.provenance for each in fleet.campaigns if each.became.provenance]
    return rendered(
        "Fleet",
        list(_fleet_glances(fleet)),
        sections,
        synthetic=any(map(is_synthetic, told)),
        over="Fleet report",
    )


def _fleet_glances(fleet: FleetRecord) -> Iterator[Glance]:
    ill = [each for each in fleet.arms if each.attention != "none"]
    yield Glance(
        "Arms", str(len(fleet.arms)), f"{count(len(fleet.campaigns), 'campaign')} of them."
    )
    often: Counter[str] = Counter(each.attention for each in ill)
    kinds = [f"{often[kind]} {words}" for kind, words in ATTENTION.items() if often[kind]]
    yield Glance("Need attention", str(len(ill)), f"{', '.join(kinds) or 'None of them'}.")
    judged = fleet.judged
    if judged:
        before, after = (
            float(np.median([_error(each, name) for each in judged]))
            for name in ("before_mm", "after_mm")
        )
        yield Glance(
            "Mean position error",
            f"{mm(before)} → {mm(after)} mm",
            "Median over the last campaigns of the arms, uncalibrated and with the final model.",
        )


def _first(fleet: FleetRecord) -> Iterator[Block]:
    ill = [each for each in fleet.arms if each.attention != "none"]
    if not ill:
        yield Paragraph("No arm needs attention.", lead=True)
        return
    yield grid(
        "The most urgent first",
        ("arm", "last campaign", "attention", "why"),
        [(each.arm, each.last, ATTENTION[each.attention], each.why) for each in ill],
    )


def _error(campaign: FleetCampaign, name: str) -> float:
    return float(getattr(campaign.became, name))


def _errors(fleet: FleetRecord) -> Drawing:
    judged = fleet.judged
    arms = [each.arm for each in judged]
    figure = new_figure(
        int(np.clip(_ROW_PX * len(arms) + 90, _LEAST_PX, _MOST_PX)),
        {"title": {"text": "mean position error [mm]"}, "type": "log"},
        {"type": "category", "title": {"text": "arm"}},
    )
    for name, told, color, symbol in (
        ("before_mm", "uncalibrated", VERMILLION, "diamond"),
        ("after_mm", "final model", BLUE, "circle"),
    ):
        figure.add_scatter(
            x=[_error(each, name) for each in judged],
            y=arms,
            mode="markers",
            name=told,
            marker={"color": color, "symbol": symbol, "size": 7},
            hovertemplate="%{y}: %{x:.4f} mm<extra>" + told + "</extra>",
        )
    return Drawing(
        figure,
        "Mean position error of every arm",
        "Last campaign of each arm, the most accurate below. Over held-out poses where a campaign "
        "has some, else over the poses fitted.",
        "fleet-errors",
    )


def _campaigns(fleet: FleetRecord) -> Iterator[Block]:
    lost = [each for each in fleet.campaigns if each.became.status != "done"]
    if lost:
        yield Callout(
            "warning",
            f"{count(len(lost), 'campaign')} gave no result: "
            + ", ".join(each.campaign for each in lost[:10])
            + (" …" if len(lost) > 10 else "")
            + ".",
        )
    header = (
        *("campaign", "arm", "measured", "grade", "verdict", "effects and faults"),
        *("before", "after", "as the campaign before it"),
    )
    yield Folded(
        "The table, one row a campaign",
        (grid("Mean position errors [mm]", header, map(_row, fleet.campaigns), (6, 7)),),
    )
    changed = [each for each in fleet.campaigns if each.moved and each.agrees is not True]
    if changed:
        yield grid(
            "Campaigns whose model differs from the one before it",
            ("campaign", "arm", "what was found"),
            [(each.campaign, each.arm, str(each.moved)) for each in changed],
        )


def _row(each: FleetCampaign) -> tuple[str, ...]:
    became = each.became
    agrees = {None: "–", True: "agrees", False: "differs"}[each.agrees]
    return (
        *(each.campaign, each.arm, each.measured or "–", became.grade or became.status),
        *(became.verdict or "–", "; ".join(became.notes or ()) or "–"),
        *(mm(became.before_mm), mm(became.after_mm), agrees),
    )
