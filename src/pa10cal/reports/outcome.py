"""The grade of the calibration and the verdict on the model, each in a plain sentence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pa10cal.reports.blocks import Block, Callout, Grid, Items, Paragraph, grid
from pa10cal.reports.formatting import (
    NOT_KNOWN,
    listed,
    mm,
    named,
    sentence,
    shown_in,
    sized,
    unbroken,
)
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.discovery import FoundEffect, NamedEffect, VerdictRecord
from pa10cal.results.explained import ProposedFormula, percent
from pa10cal.results.health import UNRESERVED, Health

_GRADES = {
    "good": "The calibration is good.",
    "few_poses": "The calibration is as good as its poses allow; more poses would help.",
    "incomplete": "The model is incomplete: it leaves more error than the noise explains.",
    "suspect_input": "Something in the input is probably wrong.",
    "not_converged": "The fit did not converge.",
}
_MEANINGS = {
    "named": "Named: every effect found is distinguishable from all others.",
    "ambiguous": "Ambiguous: at least one effect cannot be distinguished from its alternatives.",
}
#: Of more parameters only a summary is shown.
_MOST_PARAMETERS = 6


def grade(results: ResultsBundle) -> Iterator[Block]:
    """Yield the grade with its sentence, and what it stands on."""
    if results.calibration is None:
        yield Callout("missing", results.why_absent(f"calibration/{results.load_case}.json"))
        return
    health = results.calibration.health
    yield Paragraph(grade_sentence(health), lead=True)
    yield Paragraph(sentence(f"{health.grade.replace('_', ' ')}: {health.line}"))
    if results.verdict is not None and results.verdict.effects:
        yield Paragraph(
            "This is the grade of the calibrated model, before the effects found joined it."
        )
    if health.grade not in UNRESERVED:
        yield Callout(
            "warning",
            "A model of this grade is not to be used: exports, predictions and compensation "
            "refuse it unless --force is given.",
        )
    if health.findings:
        yield grid(
            "What is probably wrong in the input",
            ("where", "what", "what to do", "would leave [mm rms]"),
            [
                (each.where, each.what, each.remedy, mm(each.would_leave_mm))
                for each in health.findings
            ],
            numbers=(3,),
        )


def grade_sentence(health: Health) -> str:
    """Return what a grade means."""
    if health.grade == "few_poses" and health.line.startswith("good: "):
        return "The calibration is good; more poses would make predictions less uncertain."
    return _GRADES[health.grade]


def verdict(results: ResultsBundle) -> Iterator[Block]:
    """Yield what is missing from the model, or wrong with the log."""
    record = results.verdict
    if record is None:
        yield Callout("missing", results.why_absent(VerdictRecord.FILE))
        return
    lead = record.explained
    if lead is not None:
        yield Paragraph(sentence(lead.headline), lead=True)
        if lead.sentences:
            yield Items(lead.sentences)
    yield Paragraph(verdict_sentence(record), lead=lead is None)
    faults, effects, no_name, proposed = verdict_grids(record, formulas_of(results))
    if record.faults:
        yield faults
    if record.effects:
        yield effects
    if record.verdict in _MEANINGS:
        yield Paragraph(_MEANINGS[record.verdict])
    if record.unexplained is not None:
        part = "Part of the remaining error"
        if lead is not None:
            part = f"{percent(lead.without_a_name)} of the error beyond noise"
        yield Callout("warning", f"{part} has no name.")
        yield no_name
    if record.proposed:
        yield proposed
    if record.falls_back is not None:
        yield Callout(
            "note",
            "The model leaves effects out where held-out poses are predicted worse with them: "
            "see what is not trusted below.",
        )


def verdict_grids(
    record: VerdictRecord, formulas: Mapping[tuple[str, str], str]
) -> tuple[Grid, Grid, Grid, Grid]:
    """Return faults of the log, effects, what has no name and formulas proposed for it.

    Args:
        record: the verdict.
        formulas: what effects add, by id and place.
    """
    no_name = () if record.unexplained is None else record.unexplained.all
    taken: tuple[str, ...] = ()
    if (explained := record.explained) is not None:
        taken = (f"takes away, over {explained.over} [mm rms]", "of the error beyond noise")
    return (
        grid(
            "Faults of the log",
            ("fault", "where", "what", "what to do"),
            [
                (each.kind.replace("_", " "), each.where, each.what, each.remedy)
                for each in record.faults
            ],
        ),
        grid(
            "Effects, those that take most away first, with 95 % intervals",
            ("effect", "at", "size", "what it adds", "could also be", *taken),
            [
                (
                    each.id.replace("_", " "),
                    unbroken(each.of.replace("_", " ")),
                    _size(each),
                    formulas.get((each.id, each.of), NOT_KNOWN),
                    listed(map(named, each.alternatives), "nothing else"),
                    *_taken(record, each),
                )
                for each in record.effects_by_share
            ],
        ),
        grid(
            "Unexplained: a gap without a name",
            ("at", "why"),
            [(place.of or "place not known", sentence(place.why)) for place in no_name],
        ),
        grid(
            "Formulas proposed for it: they do as well, and name nothing",
            ("at", "formula", "size", "does as well as", "takes away of the squared error"),
            [
                (
                    unbroken(each.of.replace("_", " ")),
                    each.formula,
                    _size(each),
                    listed(map(named, each.does_as_well_as), "noise alone"),
                    f"{100 * each.gain:.0f} %",
                )
                for each in record.proposed or ()
            ],
        ),
    )


def _taken(record: VerdictRecord, effect: FoundEffect) -> tuple[str, ...]:
    """Return what an effect takes away, and its share, where that is known."""
    if record.explained is None:
        return ()
    for each in record.explained.of:
        if (each.ids[0], each.of) == (effect.id, effect.of):
            fall = unbroken(f"{mm(each.before_mm)} → {mm(each.after_mm)}")
            return (fall, unbroken(percent(each.share)))
    return (NOT_KNOWN, NOT_KNOWN)


def verdict_glance(record: VerdictRecord) -> tuple[str, str]:
    """Return the verdict for the top of the page: how much is explained, and by what."""
    word, lead = record.verdict.replace("_", " "), record.explained
    if lead is None or not lead.sentences:
        return word, verdict_sentence(record)
    if record.verdict == "check_the_log":
        return word, f"{verdict_sentence(record)} {sentence(lead.headline)}"
    parts = "Of the error beyond noise." if len(lead.sentences) == 1 else sentence(lead.headline)
    return f"{lead.percent} explained", f"{parts} {lead.sentences[0]} Verdict: {word}."


def verdict_sentence(record: VerdictRecord) -> str:
    """Return the verdict in one plain sentence."""
    effects = _together(record.effects)
    lacks = f"The calibrated model lacks {effects}."
    unexplained = record.unexplained
    if record.verdict == "none":
        return "Nothing is missing: model and measurement agree within the repeatability."
    if record.verdict == "not_sought":
        return f"Effects were not sought: {sentence(record.why or 'not known why')}"
    if record.verdict == "check_the_log":
        faults = listed(f"{each.kind.replace('_', ' ')} ({each.where})" for each in record.faults)
        besides = f" Whatever becomes of that, {lacks[0].lower()}{lacks[1:]}"
        return f"Check the log first: {faults}.{besides if record.effects else ''}"
    if record.verdict == "unexplained":
        where = "" if unexplained is None or unexplained.of is None else f" at {unexplained.of}"
        part = f"{lacks} Besides, an" if record.effects else "An"
        return f"{part} error remains{where} that no effect of the vocabulary explains."
    return lacks


def _together(effects: tuple[FoundEffect, ...]) -> str:
    """Return effects as a list within a sentence, those of one kind at several joints as one."""
    joints: dict[str, list[str]] = {}
    for each in effects:
        if each.of.startswith("joint ") and not each.alternatives:
            joints.setdefault(each.id, []).append(each.of.removeprefix("joint "))
    told = []
    for each in effects:
        at = joints.get(each.id, [])
        if len(at) < 2 or each.alternatives or not each.of.startswith("joint "):
            told.append(" or ".join(map(named, (each, *each.alternatives))))
        elif each.of == f"joint {at[0]}":
            told.append(f"{each.id.replace('_', ' ')} at joints {listed(sorted(at, key=int))}")
    return ", and ".join(told) if len(told) == 2 and "and" in told[0] else listed(told)


def _size(effect: NamedEffect | ProposedFormula) -> str:
    if len(effect.parameters) > _MOST_PARAMETERS:
        values = [each.value for each in effect.parameters.values()]
        unit, scale = shown_in(next(iter(effect.parameters.values())).unit)
        rms = scale * (sum(value**2 for value in values) / len(values)) ** 0.5
        return unbroken(f"{len(values)} values, rms {rms:.3g} {unit}")
    return "; ".join(f"{name} = {sized(each)}" for name, each in effect.parameters.items())


def formulas_of(results: ResultsBundle) -> dict[tuple[str, str], str]:
    """Return formulas of terms, as the fitted model states them, by id and place."""
    terms = results.extended.fitted_model.get("terms") if results.extended is not None else None
    if not isinstance(terms, list):
        return {}
    return {
        (str(term["id"]), str(term["of"])): str(term["formula"])
        for term in terms
        if isinstance(term, dict) and {"id", "of", "formula"} <= term.keys()
    }
