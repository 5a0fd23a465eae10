"""The page: its head, its sections in the order of reading, and its text."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

import pa10cal
from pa10cal.report.blocks import Beside, Block, Drawing, Folded, Section
from pa10cal.report.gathered import Gathered
from pa10cal.report.looks import drawn, library
from pa10cal.report.model_errors import headline
from pa10cal.report.sections.accuracy import accuracy
from pa10cal.report.sections.measured import measured
from pa10cal.report.sections.missing import missing, next_poses
from pa10cal.report.sections.outcome import grade, grade_sentence, verdict, verdict_sentence
from pa10cal.report.sections.parameters import parameters
from pa10cal.report.sections.repeats import repeats
from pa10cal.report.sections.residuals import residuals
from pa10cal.report.sections.trust import trust
from pa10cal.report.sections.use import use
from pa10cal.report.written import count, mm

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
    """One of the answers at the top of the page.

    Attributes:
        question: what it answers.
        answer: in a word or a number.
        more: one sentence.
    """

    question: str
    answer: str
    more: str


def page_text(found: Gathered) -> str:
    """Return the page as HTML, everything in it that it needs."""
    sections = [section(found) for section in _SECTIONS]
    environment = Environment(
        loader=PackageLoader("pa10cal.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    style = files("pa10cal.report").joinpath("templates/page.css").read_text(encoding="utf-8")
    text: str = environment.get_template("page.html.j2").render(
        campaign=found.campaign,
        synthetic=SYNTHETIC if found.synthetic else None,
        glances=list(_glances(found)),
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
            more += " The effects found are not in it yet."
        yield Glance("Grade of the calibration", health.grade.replace("_", " "), more)
    if found.verdict is None:
        yield Glance("Verdict", "none yet", "What the model lacks was not looked for.")
    else:
        word = found.verdict.verdict.replace("_", " ")
        yield Glance("Verdict", word, verdict_sentence(found.verdict))
    ends = headline(found)
    if ends is not None:
        before, after = ends
        over = f"rms over {count(before.configurations, f'{before.kind} configuration')}"
        peaks = f"peak {mm(before.peak_mm)} to {mm(after.peak_mm)} mm"
        said = f"{mm(before.rms_mm)} → {mm(after.rms_mm)} mm"
        yield Glance("Position error", said, f"{over}; {peaks}.")


def _any_drawing(sections: list[Section]) -> bool:
    return any(
        isinstance(block, Drawing | Beside) for section in sections for block in _inside(section)
    )


def _inside(part: Section | Folded) -> Iterator[Block]:
    for block in part.blocks:
        yield block
        if isinstance(block, Folded):
            yield from _inside(block)
