"""The pages: of a campaign, of all results and of a fleet, everything in them that they need."""

from __future__ import annotations

import csv
from base64 import b64encode
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from statistics import median

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pa10cal.files.output import write_text
from pa10cal.reports.accuracy import accuracy, parameters, repeats
from pa10cal.reports.blocks import (
    Beside,
    Callout,
    Drawing,
    Folded,
    Image,
    Links,
    PageBlock,
    PageSection,
    Paragraph,
    folded,
    grid,
)
from pa10cal.reports.errors import headline
from pa10cal.reports.formatting import count, mm
from pa10cal.reports.measured import measurement_section, use
from pa10cal.reports.outcome import errors_by_angle, grade, grade_sentence, verdict, verdict_glance
from pa10cal.reports.pictures import fleet_drawing
from pa10cal.reports.residuals import residuals
from pa10cal.reports.results_bundle import REFUSED, ResultsBundle, is_synthetic, results_bundle
from pa10cal.reports.theme import packed_figure, packed_library
from pa10cal.reports.trust import missing, next_poses, trust
from pa10cal.results.codec import read
from pa10cal.results.fleet import FleetCampaign, FleetRecord, PicturesRecord

#: The sections in the order of reading: id in the page, heading, and what yields their blocks.
SECTIONS = (
    ("angles", "Error of each joint over its angle", errors_by_angle),
    ("measured", "What was measured", measurement_section),
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
    of_all = campaign_dir is None and not (results / PicturesRecord.FILE).exists()
    if of_all and (
        pages := sorted((*results.glob("*/report.html"), *results.glob("fleet/fleet.html")))
    ):
        name, text = results.absolute().name, _overview_text(results, pages)
    else:
        bundle = results_bundle(results, load_case, campaign_dir)
        name, text = bundle.campaign, page_text(bundle)
    write_text(out, text)
    return name, len(text.encode())


def page_text(results: ResultsBundle) -> str:
    """Return the page of a campaign as HTML, everything in it that it needs."""
    said: set[str] = set()

    def says_more(block: PageBlock) -> bool:
        """Say whether a block is not a reason why a result is missing that was given before.

        Where a stage has refused, its message alone says why all that follows it is missing.
        """
        if not isinstance(block, Callout) or block.word != "missing":
            return True
        refused = any(REFUSED in text for text in said)
        if block.text in said or (refused and REFUSED not in block.text):
            return False
        said.add(block.text)
        return True

    sections = [
        PageSection(
            id,
            title,
            (*filter(says_more, blocks(results)), *images(results.pictures, results.folder, id)),
        )
        for id, title, blocks in SECTIONS
    ]
    with_content = [section for section in sections if section.blocks]
    return _rendered(
        results.campaign, list(_glances(results)), with_content, synthetic=results.synthetic
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
    if (ends := headline(results)) is not None:
        before, after = ends
        first, last = before.counted, after.counted
        flagged = after.with_flagged("rms_mm")
        yield Glance(
            "Position error",
            f"{mm(first.rms_mm)} → {mm(last.rms_mm)} mm",
            f"rms over {count(first.configurations, f'{before.kind} configuration')}; peak "
            f"{mm(first.peak_mm)} to {mm(last.peak_mm)} mm{'; ' * bool(flagged)}{flagged}.",
        )


def _overview_text(folder: Path, pages: Sequence[Path]) -> str:
    """Return the page of all results: a link to every page, pictures and tables of studies."""
    links = tuple((str(page.relative_to(folder)), page.parent.name) for page in pages)
    sections = [PageSection("campaigns", "Campaigns", (Links(links),))]
    for path in sorted(folder.rglob(PicturesRecord.FILE)):
        pictures = read(PicturesRecord, path)
        if pictures.campaign is None:
            name = str(path.parent.relative_to(folder))
            blocks: list[PageBlock] = [*images(pictures, path.parent, "")]
            for table, of in (pictures.captions or {}).items():
                if (data := path.parent / f"tables/{table}.csv").exists():
                    with data.open(encoding="utf-8", newline="") as file:
                        header, *rows = csv.reader(file)
                    blocks += [grid(of.title, header, rows), Paragraph(of.text)]
            sections.append(PageSection(name, name.replace("_", " "), tuple(blocks)))
    return _rendered("All results", [], sections, synthetic=False, over="Report")


def _rendered(
    title: str,
    glances: Sequence[Glance],
    sections: Sequence[PageSection],
    *,
    synthetic: bool,
    over: str = "Calibration report",
) -> str:
    """Return a page as HTML.

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
        Markup(files("pa10cal.reports").joinpath(f"templates/page.{ending}").read_text("utf-8"))
        for ending in ("css", "js")
    )

    def draws(blocks: Iterable[PageBlock]) -> bool:
        return any(
            isinstance(block, Drawing | Beside)
            or (isinstance(block, Folded) and draws(block.blocks))
            for block in blocks
        )

    text: str = environment.get_template("page.html.j2").render(
        campaign=title,
        over=over,
        synthetic=SYNTHETIC if synthetic else None,
        glances=glances,
        sections=sections,
        style=style,
        script=script,
        library=packed_library() if any(draws(each.blocks) for each in sections) else None,
        packed_figure=packed_figure,
        version=version("pa10cal"),
    )
    return text


# The page of a fleet: arms that need attention first, then every campaign.

#: What a reader is told of each kind of attention, in the order of urgency.
ATTENTION = {
    "no_result": "no result",
    "input": "check the data",
    "moved": "the arm has changed",
    "incomplete": "an effect is missing",
    "none": "none",
}


def fleet_page_text(fleet: FleetRecord) -> str:
    """Return the page as HTML, everything in it that it needs."""
    urgent = [arm for arm in fleet.arms if arm.attention != "none"]
    rows = [(arm.arm, arm.last, ATTENTION[arm.attention], arm.why) for arm in urgent]
    header = ("arm", "last campaign", "attention", "why")
    first = grid("The most urgent first", header, rows)
    sections = [
        PageSection(
            "attention",
            "Arms that need attention",
            (first if urgent else Paragraph("No arm needs attention.", lead=True),),
        )
    ]
    often: Counter[str] = Counter(arm.attention for arm in urgent)
    kinds = [f"{often[kind]} {words}" for kind, words in ATTENTION.items() if often[kind]]
    glances = [
        Glance("Arms", str(len(fleet.arms)), f"{count(len(fleet.campaigns), 'campaign')} of them."),
        Glance("Need attention", str(len(urgent)), f"{', '.join(kinds) or 'None of them'}."),
    ]
    if fleet.by_accuracy:
        drawing = fleet_drawing(fleet.by_accuracy)
        sections.append(PageSection("errors", "Errors before and after", (drawing,)))
        before, after = (
            median(getattr(campaign.became, name) for campaign in fleet.by_accuracy)
            for name in ("before_mm", "after_mm")
        )
        glances.append(
            Glance(
                "Mean position error",
                f"{mm(before)} → {mm(after)} mm",
                "Median over the last campaigns of the arms, uncalibrated and with the final "
                "model.",
            )
        )
    sections.append(PageSection("campaigns", "Every campaign", tuple(_campaigns(fleet.campaigns))))
    synthetic = any(is_synthetic(each.became.provenance or "") for each in fleet.campaigns)
    return _rendered("Fleet", glances, sections, synthetic=synthetic, over="Fleet report")


def _campaigns(campaigns: Sequence[FleetCampaign]) -> Iterator[PageBlock]:
    lost = [each.campaign for each in campaigns if each.became.status != "done"]
    if lost:
        names = f"{', '.join(lost[:10])}{' …' * (len(lost) > 10)}"
        yield Callout("warning", f"{count(len(lost), 'campaign')} gave no result: {names}.")
    header = (
        *("campaign", "arm", "measured", "grade", "verdict", "effects and faults"),
        *("before", "after", "as the campaign before it"),
    )
    rows = [
        (
            *(each.campaign, each.arm, each.measured or "–", became.grade or became.status),
            *(became.verdict or "–", "; ".join(became.notes or ()) or "–"),
            *(mm(became.before_mm), mm(became.after_mm)),
            {None: "–", True: "agrees", False: "differs"}[each.agrees],
        )
        for each in campaigns
        for became in [each.became]
    ]
    table = grid("Mean position errors [mm]", header, rows, (6, 7))
    yield folded(table, "The table, one row a campaign")
    changed = [
        (each.campaign, each.arm, str(each.moved))
        for each in campaigns
        if each.moved and each.agrees is not True
    ]
    if changed:
        title = "Campaigns whose model differs from the one before it"
        yield grid(title, ("campaign", "arm", "what was found"), changed)
