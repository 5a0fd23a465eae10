"""Sections of the page: errors of joints over their angle, grade and verdict, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

from pa10cal.reports.blocks import Callout, Items, PageBlock, Paragraph, SideBySide, grid
from pa10cal.reports.errors import better_general
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
from pa10cal.reports.pictures import campaigns_drawings, joint_map_drawings
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.calibration import UNRESERVED, CalibrationRecord
from pa10cal.results.discovery import FoundEffect, NamedEffect, ProposedFormula, VerdictRecord
from pa10cal.results.number_text import SURE, shown_probability
from pa10cal.results.record import EffectName
from pa10cal.terms.wording import explained_or_predicted, headline, percent, sentences

#: What each grade means.
_GRADES = {
    "good": "The calibration is good.",
    "few_poses": "The calibration is as good as its poses allow; more poses would help.",
    "incomplete": "The model is incomplete: its error is larger than the noise explains.",
    "suspect_input": "Something in the input is probably wrong.",
    "not_converged": "The fit did not converge.",
}
#: Of more parameters only a summary is shown.
_MOST_PARAMETERS = 6


def errors_by_angle(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield the error of each joint over its angle, where one was found."""
    if results.verdict is None:
        return
    if maps := tuple(joint_map_drawings(results.verdict)):
        yield Paragraph(
            "The error of each joint over a turn, as discovery found it, with a 95 % band. A "
            "constant can hardly be separated from the joint zero or the base and widens the band "
            "at all angles. Shaded: angles without fitted poses, where the model extrapolates. A "
            "map shows at which joint an error is, not whether encoder, gear or controller causes "
            "it. Joints without a map showed no need of one."
        )
        yield SideBySide(maps)
    if campaigns := tuple(campaigns_drawings(results.verdict)):
        yield Paragraph(
            "The same errors as each campaign alone has them, where it has poses, less the mean "
            "over the angles that all visited, or else its own. Where campaigns lie on top of each "
            "other the error belongs to the robot. Below, with 95 % intervals: the correlation r "
            "of the campaigns, and α, the share of the error that the motor followed, where its "
            "own ripple shows it: 0 if the gear makes the error, 1 if the sensor does."
        )
        yield SideBySide(campaigns)


def grade(results: ResultsBundle, case: CalibrationRecord) -> Iterator[PageBlock]:
    """Yield the grade with its sentence, and what is probably wrong in the input."""
    health = case.health
    yield Paragraph(grade_sentence(results, case), lead=True)
    yield Paragraph(sentence(f"{health.grade.replace('_', ' ')}: {health.line}"))
    if health.grade not in UNRESERVED:
        extended, found = results.extended, health.findings
        suspect = health.grade == "suspect_input" and bool(found)
        departs = suspect and all(each.is_departure for each in found)
        confirmed = departs and extended is not None and extended.grade in UNRESERVED
        yield Callout(
            "warning",
            "A model of this grade is not to be used. "
            + (
                "That with the effects found is: held-out poses confirm with it what is suspected."
                if confirmed
                else "The commands refuse its model without --force: mend the input first."
            ),
        )
    if better := better_general(results):
        yield Callout("warning", sentence(better))
    yield grid(
        "What is probably wrong in the input",
        "where | what | what to do | would leave [mm rms]",
        ((each.where, each.what, each.remedy, each.would_leave_mm) for each in health.findings),
    )


def grade_sentence(results: ResultsBundle, case: CalibrationRecord) -> str:
    """Return what the grade of a calibration means."""
    text = _GRADES[case.health.grade]
    if case.health.grade == "few_poses" and case.health.line.startswith("good: "):
        text = "The calibration is good; more poses would make predictions less uncertain."
    if results.verdict is not None and results.verdict.effects:
        text += " This is before the effects found are added."
    return text


def verdict(results: ResultsBundle, record: VerdictRecord) -> Iterator[PageBlock]:
    """Yield what is missing from the model, or wrong with the log."""
    lead = record.explained
    if lead is not None:
        yield Paragraph(sentence(headline(lead)), lead=True)
        yield Items(sentences(lead))
    yield Paragraph(verdict_sentence(record), lead=lead is None)
    yield grid(
        "Faults of the log",
        "fault | where | what | what to do",
        (
            (fault.kind.replace("_", " "), fault.where, fault.what, fault.remedy)
            for fault in record.faults
        ),
    )
    head = "effect | at | size | what it adds | probability | could also be"
    if lead is not None:
        head += f" | error without → with it, over {lead.over} [mm rms] | of the error beyond noise"
    title = "Effects, those that remove most error first, with 95 % intervals"
    yield grid(title, head, _effect_rows(results, record))
    if record.unexplained is not None:
        part, predicted = "Part of the remaining error", ""
        if lead is not None:
            # `joints` is given only for what is predicted without a name.
            by_field = sum(each.share for each in lead.of if each.joints is not None)
            part = f"{percent(lead.without_a_name + by_field)} of the error beyond noise"
            if by_field:
                predicted = f", and {percent(by_field)} is predicted all the same"
        yield Callout("warning", f"{part} has no name{predicted}.")
        places = record.unexplained.all
        yield grid(
            "Unexplained: a gap without a name",
            "at | why",
            ((place.of or "place not known", sentence(place.why)) for place in places),
        )
    yield grid(
        "Formulas proposed for it: they fit as well, and name no effect",
        "at | formula | size | fits as well as | removes of the squared error",
        (
            (
                unbroken(proposed.of.replace("_", " ")),
                proposed.formula,
                _size(proposed),
                listed(map(named, proposed.does_as_well_as), "noise alone"),
                percent(proposed.gain),
            )
            for proposed in record.proposed or ()
        ),
    )
    if record.falls_back is not None:
        yield Callout("warning", sentence(f"limits of the effects: {record.falls_back.why}"))


def _effect_rows(results: ResultsBundle, record: VerdictRecord) -> Iterator[tuple[str, ...]]:
    """Yield a row for each effect found, with its formula and what it takes away, if known."""
    terms = results.extended.fitted_model.get("terms") if results.extended is not None else None
    formulas = {
        (term.get("id"), term.get("of")): str(term.get("formula", NOT_KNOWN))
        for term in (terms if isinstance(terms, list) else [])
        if isinstance(term, dict)
    }
    taken_away = {
        (part.ids[0], part.of): (f"{mm(part.before_mm)} → {mm(part.after_mm)}", percent(part.share))
        for part in (record.explained.of if record.explained else ())
    }
    for effect in record.effects_by_share:
        yield (
            effect.id.replace("_", " "),
            unbroken(effect.of.replace("_", " ")),
            _size(effect),
            formulas.get((effect.id, effect.of), NOT_KNOWN),
            shown_probability(effect.probability),
            listed(
                (
                    f"{named(each)} ({shown_probability(each.probability)})"
                    for each in effect.alternatives
                ),
                "nothing else",
            ),
            *map(unbroken, taken_away.get((effect.id, effect.of), ())),
        )


def verdict_glance(record: VerdictRecord) -> tuple[str, str]:
    """Return the verdict for the top of the page: how much is explained, and by what."""
    word, lead = record.verdict.replace("_", " "), record.explained
    explanations = () if lead is None else sentences(lead)
    if lead is None or not explanations:
        return word, verdict_sentence(record)
    if record.verdict == "check_the_log":
        return word, f"{verdict_sentence(record)} {sentence(headline(lead))}"
    parts = "Of the error beyond noise."
    if len(explanations) > 1:
        parts = sentence(headline(lead))
    return (
        f"{percent(lead.share)} {explained_or_predicted(lead)}",
        f"{parts} {explanations[0]} Verdict: {word}.",
    )


def verdict_sentence(record: VerdictRecord) -> str:
    """Return the verdict in one plain sentence."""
    lacks = f"The calibrated model lacks {_together(record.effects)}."
    unexplained = record.unexplained
    if record.verdict == "none":
        return "Nothing is missing: model and measurement agree within the repeatability."
    if record.verdict == "not_sought":
        return f"Effects were not sought: {sentence(record.why or 'not known why')}"
    if record.verdict == "check_the_log":
        faults = listed(
            f"{fault.kind.replace('_', ' ')} ({fault.where})" for fault in record.faults
        )
        besides = f" Independent of that, {lacks[0].lower()}{lacks[1:]}"
        return f"Check the log first: {faults}.{besides if record.effects else ''}"
    if record.verdict == "unexplained":
        where = "" if unexplained is None or unexplained.of is None else f" at {unexplained.of}"
        part = f"{lacks} Besides, an" if record.effects else "An"
        return f"{part} error remains{where} that no effect of the vocabulary explains."
    return lacks


def _together(effects: tuple[FoundEffect, ...]) -> str:
    """Return effects as a list within a sentence; one kind at several joints is one entry.

    One that is not all but certain is an entry of its own, with its probability.
    """
    groups: dict[object, list[FoundEffect]] = {}
    for effect in effects:
        sure = effect.probability >= SURE
        alone = effect.likely or not sure or not effect.of.startswith("joint ")
        groups.setdefault((effect.id, effect.of if alone else None), []).append(effect)
    names = []
    for first, *others in groups.values():
        if others:
            joints = sorted((each.of.removeprefix("joint ") for each in (first, *others)), key=int)
            names.append(f"{first.id.replace('_', ' ')} at joints {listed(joints)}")
        else:
            names.append(_in_doubt(first))
    return ", and ".join(names) if len(names) == 2 and "and" in names[0] else listed(names)


def _in_doubt(effect: FoundEffect) -> str:
    """Return an effect or what else is likely; with its probability if not sure."""
    if effect.probability >= SURE:
        return named(effect)
    known: list[tuple[EffectName, float]] = [(effect, effect.probability)]
    known += [(rival, rival.probability) for rival in effect.likely]
    names = " or ".join(f"{named(each)} ({shown_probability(p)})" for each, p in known)
    nameless = effect.none_of_these > max(p for _, p in known)
    return f"{names} or, likelier, something without a name" if nameless else names


def _size(effect: NamedEffect | ProposedFormula) -> str:
    """Return the parameters with their intervals; of many their rms alone."""
    if len(effect.parameters) > _MOST_PARAMETERS:
        values = [parameter.value for parameter in effect.parameters.values()]
        unit, scale = shown_in(next(iter(effect.parameters.values())).unit)
        rms = scale * (sum(value**2 for value in values) / len(values)) ** 0.5
        return unbroken(f"{len(values)} values, rms {rms:.3g} {unit}")
    return "; ".join(f"{name} = {sized(name, value)}" for name, value in effect.parameters.items())
