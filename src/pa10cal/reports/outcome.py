"""Sections of the page: errors of joints over their angle, grade and verdict, in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

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
from pa10cal.results.record import EffectName, Name
from pa10cal.terms.wording import (
    explained_or_predicted,
    headline,
    interval_text,
    percent,
    place_in_words,
    sentences,
)

#: What each grade means.
_GRADES = {
    "good": "The calibration is good.",
    "few_poses": "The poses do not determine all of the model: others, or more, would.",
    "incomplete": "The model is incomplete: its error is larger than the noise explains.",
    "suspect_input": "Something in the input is probably wrong.",
    "not_converged": "The fit did not converge.",
}
_SOME_THERE = "It has some of the effects found."
#: What a good grade means beside something without a name: a grade allows more error than a search.
_HARDLY_ABOVE = (
    "All that the model leaves is hardly more than noise, what the verdict does not explain "
    "included: a search tells less than a grade asks for."
)
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
            "it. Joints without a map showed no need of one, or could not be judged."
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
    word = "" if _is_good_but_for_more(case) else f"{health.grade.replace('_', ' ')}: "
    yield Paragraph(sentence(f"{word}{health.line}"))
    if health.grade not in UNRESERVED:
        extended, found = results.extended, health.findings
        suspect = health.grade == "suspect_input" and bool(found)
        may_be = suspect and all(each.is_departure or each.between_campaigns for each in found)
        confirmed = may_be and extended is not None and extended.grade in UNRESERVED
        yield Callout(
            "warning",
            "A model of this grade is not to be used. "
            + (
                "That with what the verdict has is: it confirms or explains what is suspected."
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
    text, good_but_for_more = _GRADES[case.health.grade], _is_good_but_for_more(case)
    if good_but_for_more:
        text = "The calibration is good; more poses would make predictions less uncertain."
    if results.verdict is None:
        return text
    if results.verdict.unexplained and (good_but_for_more or case.health.grade == "good"):
        text = f"{text} {_HARDLY_ABOVE}"
    if not results.verdict.effects:
        return text
    there = _calibrated_with(results, results.verdict)
    if not there:
        return f"{text} This is before the effects found are added."
    every = len(there) == len(results.verdict.effects)
    return f"{text} {'The effects found are in it.' if every else _SOME_THERE}"


def _is_good_but_for_more(case: CalibrationRecord) -> bool:
    """Return whether a grade `few_poses` only means that an uncertainty asked for needs more.

    The record states that by the first word of its reason alone.
    """
    return case.health.grade == "few_poses" and case.health.line.startswith("good: ")


def _calibrated_with(results: ResultsBundle, record: VerdictRecord) -> tuple[FoundEffect, ...]:
    """Return the effects found that the calibration has, as after `calibration.effects: named`."""
    if results.calibration is None:
        return ()
    there = _terms(results.calibration.fitted_model)
    return tuple(effect for effect in record.effects if effect.name in there)


def _terms(fitted_model: Mapping[str, Any]) -> dict[Name, Mapping[str, Any]]:
    """Return the terms of a fitted model, as a record holds them, by their names."""
    return {Name(term["id"], term.get("of", "")): term for term in fitted_model.get("terms", ())}


def verdict(results: ResultsBundle, record: VerdictRecord) -> Iterator[PageBlock]:
    """Yield what is missing from the model, or wrong with the log."""
    lead = record.explained
    if lead is not None:
        yield Paragraph(sentence(headline(lead)), lead=True)
        yield Items(sentences(lead))
        if interval := interval_text(lead):
            yield Paragraph(interval)
    yield Paragraph(_verdict_sentence(results, record), lead=lead is None)
    yield grid(
        "Faults of the log",
        "fault | where | what | what to do",
        (
            (fault.kind.replace("_", " "), fault.where, fault.what, fault.remedy)
            for fault in record.faults
        ),
    )
    yield grid(
        "Readings left out of the search, suspected of a gross error",
        "where | how far off the others of the pose, or off the model where there are none",
        ((each.where, each.what) for each in record.suspected_readings or ()),
    )
    head = "effect | at | size | what it adds | probability | could also be"
    if lead is not None:
        head += f" | error without → with it, over {lead.over} [mm rms] | of the error beyond noise"
    title = "Effects, those that remove most error first, with 95 % intervals"
    yield grid(title, head, _effect_rows(results, record))
    if record.unexplained is not None:
        part, predicted = "Part of the remaining error", ""
        if lead is not None:
            by_field = sum(each.share for each in lead.of if each.has_no_name)
            part = f"{percent(lead.without_a_name + by_field)} of the error beyond noise"
            if by_field:
                predicted = f", and {percent(by_field)} is predicted all the same"
        yield Callout("warning", f"{part} has no name{predicted}.")
        places = record.unexplained.all
        yield grid(
            "Unexplained: a gap without a name",
            "at | why",
            (
                ((place.of or "place not known").replace("_", " "), sentence(place.why))
                for place in places
            ),
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
    terms = {} if results.extended is None else _terms(results.extended.fitted_model)
    taken_away = {
        part.name: (f"{mm(part.before_mm)} → {mm(part.after_mm)}", percent(part.share))
        for part in (record.explained.of if record.explained else ())
    }
    for effect in record.effects_by_share:
        yield (
            effect.id.replace("_", " "),
            unbroken(effect.of.replace("_", " ")),
            _size(effect),
            str(terms.get(effect.name, {}).get("formula", NOT_KNOWN)),
            shown_probability(effect.probability),
            listed(
                (
                    f"{named(each)} ({shown_probability(each.probability)})"
                    for each in effect.alternatives
                ),
                "nothing else",
            ),
            *map(unbroken, taken_away.get(effect.name, ())),
        )


def verdict_glance(results: ResultsBundle, record: VerdictRecord) -> tuple[str, str]:
    """Return the verdict for the top of the page: how much is explained, and by what."""
    word, lead = record.verdict.replace("_", " "), record.explained
    explanations = () if lead is None else sentences(lead)
    if lead is None or not explanations:
        return word, _verdict_sentence(results, record)
    if record.verdict == "check_the_log":
        return word, f"{_verdict_sentence(results, record)} {sentence(headline(lead))}"
    parts = "Of the error beyond noise."
    if len(explanations) > 1:
        parts = sentence(headline(lead))
    return (
        f"{percent(lead.share)} {explained_or_predicted(lead)}",
        f"{parts} {explanations[0]} Verdict: {word}.",
    )


def _verdict_sentence(results: ResultsBundle, record: VerdictRecord) -> str:
    """Return the verdict in one plain sentence."""
    # Where the calibration has effects of the verdict, these were sought with one without them.
    without = _calibrated_with(results, record)
    model = "The model calibrated without effects" if without else "The calibrated model"
    lacks = f"{model} lacks {_together(record.effects)}."
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
        of = None if record.unexplained is None else record.unexplained.of
        part = f"{lacks} Besides, an" if record.effects else "An"
        return f"{part} error remains{_where(of)} that no effect of the vocabulary explains."
    return lacks


def _where(of: str | None) -> str:
    """Return a place as a sentence has it after its verb; empty where it is not known."""
    if of is None:
        return ""
    return f" in {of}" if of.startswith("the ") else f" at {place_in_words(of)}"


def _together(effects: tuple[FoundEffect, ...]) -> str:
    """Return effects as a list within a sentence; one kind at several joints is one entry.

    An entry of its own has an effect that is not at a joint, may be another one, or is not sure.
    """
    entries: dict[object, list[FoundEffect]] = {}
    for effect in effects:
        certain = effect.probability >= SURE and not effect.likely
        at_joints = certain and effect.of.startswith("joint ")
        entries.setdefault((effect.id, None if at_joints else effect.of), []).append(effect)
    names = [_at_joints(entry) if entry[1:] else _in_doubt(entry[0]) for entry in entries.values()]
    several_joints = len(next(iter(entries.values()), ())) > 1
    return ", and ".join(names) if len(names) == 2 and several_joints else listed(names)


def _at_joints(effects: list[FoundEffect]) -> str:
    """Return effects of one kind at several joints: `backlash at joints 2 and 3`."""
    joints = sorted((each.of.removeprefix("joint ") for each in effects), key=int)
    return f"{effects[0].id.replace('_', ' ')} at joints {listed(joints)}"


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
    """Return the parameters with their intervals; of many the rms alone of those of each unit."""
    parameters = effect.parameters
    if len(parameters) <= _MOST_PARAMETERS:
        return "; ".join(f"{name} = {sized(name, value)}" for name, value in parameters.items())
    by_unit: dict[str, list[float]] = {}
    for each in parameters.values():
        by_unit.setdefault(each.unit, []).append(each.value)
    return "; ".join(_summed_up(values, unit) for unit, values in by_unit.items())


def _summed_up(values: list[float], unit: str) -> str:
    """Return the number of some parameters of one unit, and their root mean square."""
    shown, scale = shown_in(unit)
    rms = scale * (sum(value**2 for value in values) / len(values)) ** 0.5
    return unbroken(f"{len(values)} values, rms {rms:.3g} {shown}")
