"""The page: its head, its sections in the order of reading, and its text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

import pa10cal
from pa10cal.files.output import write_text
from pa10cal.reports.blocks import Beside, Block, Drawing, Folded, Section
from pa10cal.reports.gathered import Gathered, gather
from pa10cal.reports.looks import drawn, library
from pa10cal.reports.model_errors import headline
from pa10cal.reports.sections.accuracy import accuracy
from pa10cal.reports.sections.measured import measured
from pa10cal.reports.sections.missing import missing, next_poses
from pa10cal.reports.sections.outcome import grade, grade_sentence, verdict, verdict_glance
from pa10cal.reports.sections.parameters import parameters
from pa10cal.reports.sections.repeats import repeats
from pa10cal.reports.sections.residuals import residuals
from pa10cal.reports.sections.trust import trust
from pa10cal.reports.sections.use import use
from pa10cal.reports.written import count, mm

#: The sections, in the order of reading.
_SECTIONS = (
    measured,
    grade,
    verdict,
    accuracy,
    repeats,
    residuals,
    parameters,
    missing,
    next_poses,
    trust,
    use,
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
    """Write the page of a results folder, and return the campaign's name and the size in bytes.

    Args:
        results, load_case, campaign_dir: see `gather`.
        out: page to write.

    Raises:
        RecordError, RawDataError: as `gather`.
        OutputError: when the page cannot be written.
    """
    found = gather(results, load_case, campaign_dir)
    text = page_text(found)
    write_text(out, text)
    return found.campaign, len(text.encode())


def page_text(found: Gathered) -> str:
    """Return the page of a campaign as HTML, everything in it that it needs."""
    return rendered(
        found.campaign,
        list(_glances(found)),
        [section(found) for section in _SECTIONS],
        synthetic=found.synthetic,
    )


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
    style = files("pa10cal.reports").joinpath("templates/page.css").read_text(encoding="utf-8")
    text: str = environment.get_template("page.html.j2").render(
        campaign=title,
        over=over,
        synthetic=SYNTHETIC if synthetic else None,
        glances=glances,
        sections=sections,
        style=Markup(style),
        library=library() if _any_drawing(sections) else None,
        drawn=drawn,
        version=pa10cal.__version__,
    )
    return text


def _glances(found: Gathered) -> Iterator[Glance]:
    if found.calibration is None:
        yield Glance("Grade", "none", "There is no calibration.")
    else:
        health = found.calibration.health
        more = grade_sentence(health)
        if found.verdict is not None and found.verdict.effects:
            more += " This is before the effects found are added."
        yield Glance("Grade of the calibration", health.grade.replace("_", " "), more)
    if found.verdict is None:
        yield Glance("Verdict", "none yet", "What the model lacks was not looked for.")
    else:
        yield Glance("Verdict", *verdict_glance(found.verdict))
    ends = headline(found)
    if ends is not None:
        before, after = ends
        over = f"rms over {count(before.configurations, f'{before.kind} configuration')}"
        peaks = f"peak {mm(before.peak_mm)} to {mm(after.peak_mm)} mm"
        said = f"{mm(before.rms_mm)} → {mm(after.rms_mm)} mm"
        yield Glance("Position error", said, f"{over}; {peaks}.")


def _any_drawing(sections: Sequence[Section]) -> bool:
    return any(
        isinstance(block, Drawing | Beside) for section in sections for block in _inside(section)
    )


def _inside(part: Section | Folded) -> Iterator[Block]:
    for block in part.blocks:
        yield block
        if isinstance(block, Folded):
            yield from _inside(block)
