"""The pages: of a campaign, of all results and of a fleet, everything in them that they need."""

from __future__ import annotations

import os
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pa10cal.arrays import Array
from pa10cal.errors import RecordError
from pa10cal.files.output import write_text
from pa10cal.input_files import read_csv, read_file, reason
from pa10cal.reports.accuracy import accuracy, parameters, repeats
from pa10cal.reports.blocks import (
    Beside,
    Callout,
    Drawing,
    Folded,
    Image,
    Links,
    PageBlock,
    Paragraph,
    folded,
    grid,
)
from pa10cal.reports.errors import headline
from pa10cal.reports.formatting import count, mm, sentence
from pa10cal.reports.measured import measurement_section, use
from pa10cal.reports.outcome import errors_by_angle, grade, grade_sentence, verdict, verdict_glance
from pa10cal.reports.pictures import fleet_drawing
from pa10cal.reports.results_bundle import REFUSED, ResultsBundle, is_synthetic, results_bundle
from pa10cal.reports.theme import BLUE, VERMILLION, new_space, packed_figure, packed_library
from pa10cal.reports.trust import missing, next_poses, trust
from pa10cal.results.analysis import GapRows
from pa10cal.results.codec import read
from pa10cal.results.evaluation import BETWEEN
from pa10cal.results.fleet import FleetCampaign, FleetRecord, PicturesRecord

# The residual field: from every measured position, how far the prediction is off and where to.

#: The longest line is this part of what the positions span.
_LONGEST_PART = 0.25
_STEPS = np.array([1.0, 1.5, 2.0, 3.0, 5.0, 7.0])
#: Of more configurations of a kind an even selection is drawn.
_MOST_LINES = 300
_MOST_ROWS = 8
#: More configurations than this get thinner lines.
_CROWD = 150
_MARGIN_MM = 10.0
#: Pictures and tables larger than this are none that were drawn [bytes].
_MOST_PICTURE_BYTES, _MOST_TABLE_BYTES = 64_000_000, 4_000_000
_LOOKS = {"fitted": (BLUE, "circle"), "held out": (VERMILLION, "diamond")}
#: Models by the residuals that a record has of them.
_MODELS = {"before_mm": "calibrated", "after_mm": "with the effects found"}


def residuals(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield the residual field, before and after effects joined the model."""
    fields = _fields(results)
    if not fields:
        yield Callout("missing", results.absent["calibration"])
        return
    # A round number by which the longest residual fills its part of the picture.
    places = np.concatenate([field.place_mm for field in fields.values()])
    before = np.concatenate([field.before_mm for field in fields.values()])
    longest = max(float(np.linalg.norm(before, axis=1).max()), 1e-9)
    wanted = max(_LONGEST_PART * float(np.ptp(places, axis=0).max()) / longest, 1.0)
    steps = _STEPS * 10.0 ** np.floor(np.log10(wanted))
    scale = float(steps[steps <= wanted].max())
    ends = np.concatenate([places, places + scale * before])
    ranges_mm = np.stack([ends.min(axis=0) - _MARGIN_MM, ends.max(axis=0) + _MARGIN_MM], axis=1)
    words = results.words
    lines = "" if words is None else f" {words.arrows.replace('Arrows', 'Lines')}"
    yield Paragraph(
        "Residuals of every configuration in the robot's base frame: each line begins at the "
        f"position of the end-effector and shows its residual {scale:g} times enlarged, the same "
        "in every picture. Lines that agree or turn steadily from place to place show an effect "
        f"that the model lacks; noise has no common direction.{lines}"
    )
    with_effects = results.verdict is not None and bool(results.verdict.effects)
    models = list(_MODELS)[: 1 + (with_effects and results.analysis is not None)]
    drawings = tuple(_drawing(fields, model, scale, ranges_mm) for model in models)
    yield Beside(drawings) if len(drawings) > 1 else drawings[0]
    last = models[-1]
    rows = [
        (label, load_N, poses, *vector, np.linalg.norm(vector))
        for poses, field in fields.items()
        for label, load_N, vector in zip(
            field.pose, field.load_N, getattr(field, last), strict=True
        )
    ]
    rows.sort(key=lambda row: -row[-1])
    title = f"The largest residuals, {_MODELS[last]}"
    head = "pose | load [N] | poses | x [mm] | y [mm] | z [mm] | length [mm]"
    yield grid(title, head, rows[:_MOST_ROWS])


def _fields(results: ResultsBundle) -> dict[str, GapRows]:
    """Return residuals along the base's axes, of the poses fitted and of those held out."""
    if results.analysis is not None:
        gap = results.analysis.gap
        fields = {"fitted": gap.train, "held out": gap.holdout}
        return {poses: rows for poses, rows in fields.items() if rows is not None and len(rows)}
    if results.calibration is None:
        return {}
    fit = results.calibration.residuals
    of = {"pose": fit.pose, "load_N": fit.load_N, "place_mm": fit.place_mm, "extrapolated": None}
    return {"fitted": GapRows(**of, before_mm=fit.position_mm, after_mm=fit.position_mm)}


def _drawing(fields: dict[str, GapRows], model: str, scale: float, ranges_mm: Array) -> Drawing:
    figure = new_space(460, ranges_mm)
    crowded = sum(map(len, fields.values())) > _CROWD
    rms_of = []
    for poses, field in fields.items():
        color, symbol = _LOOKS[poses]
        count = len(field)
        rows = np.unique(np.linspace(0, count - 1, _MOST_LINES).round().astype(int))
        places, residual = field.place_mm[rows], getattr(field, model)[rows]
        # A line from each place to its end, nan between the lines.
        lines = np.stack([places, places + scale * residual, np.full_like(places, np.nan)], axis=1)
        figure.add_scatter3d(
            **dict(zip("xyz", lines.reshape(-1, 3).round(2).T, strict=True)),
            mode="lines",
            line={"color": color, "width": 3 if crowded else 5},
            name=f"residual, {poses}",
            hoverinfo="skip",
            showlegend=False,
        )
        some = f" ({len(rows)} of {count})" if len(rows) < count else ""
        figure.add_scatter3d(
            **dict(zip("xyz", places.round(1).T, strict=True)),
            mode="markers",
            marker={"color": color, "size": 1.8 if crowded else 2.5, "symbol": symbol},
            name=f"{poses}{some}",
            text=[
                f"{label}, {load:g} N: {np.linalg.norm(vector):.3f} mm"
                f"<br>({vector[0]:.3f}, {vector[1]:.3f}, {vector[2]:.3f})"
                for label, load, vector in zip(
                    field.pose[rows], field.load_N[rows], residual, strict=True
                )
            ],
            hoverinfo="text",
        )
        rms_mm = np.sqrt(np.mean(np.sum(getattr(field, model) ** 2, axis=1)))
        rms_of.append(f"{poses} {rms_mm:.3f} mm rms")
    shapes = "Circles: fitted; diamonds: held out. " if len(fields) > 1 else ""
    return Drawing(
        figure,
        f"Residuals, {_MODELS[model]}",
        f"{shapes}{sentence(', '.join(rms_of))} Drag to turn, point at a mark for its numbers.",
        f"residuals-{_MODELS[model].replace(' ', '-')}",
        in_space=True,
    )


class Section(NamedTuple):
    """A section of a campaign's page."""

    id: str  # in the page
    title: str  # its heading
    needs: str  # the result that it is given besides all results, and names where it is missing
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
SYNTHETIC = "Synthetic data: simulated, no robot was measured."


class PageSection(NamedTuple):
    """A section as a page shows it; one without blocks is not shown."""

    id: str  # of its element in the page
    title: str  # its heading
    blocks: tuple[PageBlock, ...]  # in the order of reading


class Glance(NamedTuple):
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

    def is_new(block: PageBlock) -> bool:
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

    sections = []
    for id, title, needs, blocks_of in SECTIONS:
        needed = () if not needs else (getattr(results, needs),)
        blocks = (
            (Callout("missing", results.absent[needs]),)
            if None in needed
            else blocks_of(results, *needed)
        )
        shown = [block for block in blocks if not block.empty and is_new(block)]
        shown += images(results.pictures, results.folder, id)
        sections.append(PageSection(id, title, tuple(shown)))
    return _rendered(results.campaign, list(_glances(results)), sections, results.synthetic)


def images(pictures: PicturesRecord | None, folder: Path, section: str) -> Iterator[Image]:
    """Yield the figures and films of a results folder that one section shows."""
    for name, of in ((pictures and pictures.captions) or {}).items():
        for kind, endings in (("svg+xml", ("svg", "png")), ("gif", ("gif",))):
            path = folder / f"figures/{name}.{endings[0]}"
            if of.section == section and os.path.lexists(path):
                content = b64encode(_picture(path, folder)).decode()
                source = f"data:image/{kind};base64,{content}"
                yield Image(source, of.title, of.text, name, endings)


def _picture(path: Path, folder: Path) -> bytes:
    try:
        return read_file(path, _MOST_PICTURE_BYTES, folder)
    except OSError as error:
        raise RecordError(
            f"a picture cannot be read: {reason(error)}",
            where=str(path),
            allowed="a file that pa10cal figures drew, in the results",
            remedy="draw it again",
        ) from None


def _glances(results: ResultsBundle) -> Iterator[Glance]:
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
    if (ends := headline(results)) is not None:
        before, after = ends
        first, last = before.counted, after.counted
        flagged, beside = after.with_flagged("rms_mm"), after.beside
        yield Glance(
            "Position error",
            f"{mm(first.rms_mm)} → {mm(last.rms_mm)} mm",
            f"rms over {count(first.configurations, f'{before.kind} configuration')}"
            f"{' ' * bool(after.where)}{after.where}; peak "
            f"{mm(first.peak_mm)} to {mm(last.peak_mm)} mm{'; ' * bool(flagged)}{flagged}"
            f"{(beside and f'; {mm(beside.rms_mm)} mm {BETWEEN}') or ''}.",
        )


def _overview_text(folder: Path, pages: Sequence[Path]) -> str:
    """Return the page of all results: a link to every page, pictures and tables of studies."""
    links = tuple((str(page.relative_to(folder)), page.parent.name) for page in pages)
    sections = [PageSection("campaigns", "Campaigns", (Links(links),))]
    for path in sorted(folder.rglob(PicturesRecord.FILE)):
        pictures = read(PicturesRecord, path, within=folder)
        if pictures.campaign is None:
            name = str(path.parent.relative_to(folder))
            blocks: list[PageBlock] = [*images(pictures, path.parent, "")]
            for table, of in (pictures.captions or {}).items():
                data = path.parent / f"tables/{table}.csv"
                if os.path.lexists(data):
                    header, *rows = _table(data, folder)
                    blocks += [grid(of.title, header, rows), Paragraph(of.text)]
            sections.append(PageSection(name, name.replace("_", " "), tuple(blocks)))
    return _rendered("All results", [], sections, False, over="Report")


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


def _rendered(
    title: str,
    glances: Sequence[Glance],
    sections: Sequence[PageSection],
    synthetic: bool,
    over: str = "Calibration report",
) -> str:
    """Return a page as HTML.

    Args:
        title: what it is of.
        glances: the answers at its top.
        sections: in the order of reading; those without blocks are not shown.
        synthetic: whether what it shows was simulated.
        over: what kind of page it is, above the title.
    """
    sections = [section for section in sections if section.blocks]
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
    often: Counter[str] = Counter(arm.attention for arm in urgent)
    kinds = [f"{often[kind]} {words}" for kind, words in ATTENTION.items() if often[kind]]
    glances = [
        Glance("Arms", str(len(fleet.arms)), f"{count(len(fleet.campaigns), 'campaign')} of them."),
        Glance("Need attention", str(len(urgent)), f"{', '.join(kinds) or 'None of them'}."),
    ]
    first: PageBlock = Paragraph("No arm needs attention.", lead=True)
    if urgent:
        first = grid("The most urgent first", "arm | last campaign | attention | why", rows)
    sections = [PageSection("attention", "Arms that need attention", (first,))]
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
    blocks = tuple(block for block in _campaigns(fleet.campaigns) if not block.empty)
    sections.append(PageSection("campaigns", "Every campaign", blocks))
    synthetic = any(is_synthetic(each.became.provenance or "") for each in fleet.campaigns)
    return _rendered("Fleet", glances, sections, synthetic, over="Fleet report")


def _campaigns(campaigns: Sequence[FleetCampaign]) -> Iterator[PageBlock]:
    lost = [each.campaign for each in campaigns if each.became.status != "done"]
    if lost:
        names = f"{', '.join(lost[:10])}{' …' * (len(lost) > 10)}"
        yield Callout("warning", f"{count(len(lost), 'campaign')} gave no result: {names}.")
    table = grid(
        "Mean position errors",
        "campaign | arm | measured | grade | verdict | effects and faults | before [mm] | "
        "after [mm] | as the campaign before it",
        (
            (
                *(each.campaign, each.arm, each.measured, outcome.grade or outcome.status),
                *(outcome.verdict, "; ".join(outcome.notes or ()) or None),
                *(outcome.before_mm, outcome.after_mm),
                {None: None, True: "agrees", False: "differs"}[each.agrees],
            )
            for each in campaigns
            for outcome in [each.became]
        ),
    )
    yield folded(table, "The table, one row a campaign")
    yield grid(
        "Campaigns whose model differs from the one before it",
        "campaign | arm | what was found",
        (
            (each.campaign, each.arm, each.moved)
            for each in campaigns
            if each.moved and each.agrees is not True
        ),
    )
