"""The verdict: which effects are missing from the model, how sure that is, and what it is worth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.figures.registry import picture
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    legend_at,
    name_rows,
    new_figure,
    panel,
    plain_log,
    write_beside,
    write_text_at,
)
from pa10cal.figures.table import Row, Shown, Table, frame_of, shown, with_half_width
from pa10cal.results.analysis import AnalysisRecord, NamingStep
from pa10cal.results.discovery import (
    EvidenceByBlocks,
    EvidenceByRepeats,
    EvidenceOfSag,
    Fault,
    FoundEffect,
    LoadGap,
    NotTestable,
    SetGap,
    VerdictRecord,
)
from pa10cal.results.evaluation import Accuracy, BeforeAfter, EffectParameter
from pa10cal.results.explained import ExplainedEffect, ProposedFormula, percent
from pa10cal.results.record import EffectName

_HALF_WIDTH_95 = 1.96
_JOINT = "joint "
#: More joints than this in a row are written as first to last.
_MOST_LISTED = 2
_HEADER = ("kind", "effect", "of", "quantity", "value", "std", "unit", "remark")
_GAP_HEADER = (
    "poses",
    "load",
    "mean before",
    "after",
    "rms before",
    "after",
    "peak before",
    "after",
    "reduction of the mean, 95 % interval",
)
_PROPOSED = (
    "of",
    "formula",
    "parameters, with 95 % intervals",
    "does as well as",
    "part of the squared error of blocks left out that it takes away",
)
_ERROR_HEADER = ("poses", "load", "mean", "rms", "peak")
_PARTS = {"inside": "angles seen in the fit", "extrapolated": "extrapolated"}
_WITHOUT_MOTION = "the motion of the base taken out"
_WITH_RIVALS = "with what has no name, not written"
_BY_REPEATS = (
    "Evidence: log evidence lost without the effect (nats); the probability that sign flips over "
    "poses give any candidate as much (max T); and the share of the error of poses and loads held "
    "out of the fit that it explains (cross-validation)."
)
_BY_BLOCKS = (
    "Evidence: prediction of blocks of poses held out of the fit (cross-validation) without and "
    "with the effect, the number of blocks that it improves, and the gain over its standard error "
    "(z). The CSV holds all knots of a map. Extrapolated: poses with a joint at an angle that the "
    "fit has not seen."
)
_MEANINGS = {
    "none": "None: model and measurement agree within the noise.",
    "named": "Named: every effect found is distinguishable from all others.",
    "ambiguous": "Ambiguous: at least one effect cannot be distinguished from its alternatives.",
    "unexplained": "Unexplained: a gap remains that no effect of the vocabulary closes.",
    "check_the_log": "Check the log: what fits best is a fault of the data. Effects listed stand "
    "whatever becomes of it.",
    "not_sought": "Not sought: whether the model lacks an effect is not known.",
}


@picture(
    title="Verdict: effects missing from the model",
    needs=("verdict",),
    caption="""
Conclusion of discovery for ``{name}``: every effect found, its place, its parameters with
intervals, indistinguishable alternatives, and the statistics that decided it. With repeats: the
evidence lost without the effect, the probability that chance does as much under sign flips over
poses, and the share it explains of omitted poses and loads. Without repeats: the prediction of
omitted blocks of poses without and with it, and the errors inside the joint angles of the fit
and beyond. Then the gap that it closes, load by load, and effects that these poses cannot
distinguish or cannot show at all, which is a statement about the measurement, not about the
arm. Faults of the log come first, where there are any: where, what, and what to do. With too few
poses or repeats effects are not sought; the table then says what would do.
The CSV holds the same, one number a row.
""",
)
def tabulate_verdict(results: Results) -> Table:
    """Return effects with intervals, alternatives and evidence, what is not testable, the gap."""
    found = results.verdict()
    return Table(
        title="Effects missing from the model",
        data=frame_of(_HEADER, _data_rows(found)),
        shown=tuple(_shown(found)),
        notes=_notes(found),
    )


def _shown(found: VerdictRecord) -> Iterator[Shown]:
    if found.faults:
        rows = [(each.kind.replace("_", " "), *_of_fault(each)) for each in found.faults]
        yield shown(("kind", "where", "what", "what to do"), rows, "Faults of the log")
    if found.verdict == "not_sought":
        reason = [(found.why or "", found.remedy or "")]
        yield shown(("why", "what would do"), reason, "Effects not sought")
        errors = [(*row[:2], *row[2:-1:2]) for row in _gap_rows(found)]
        noise = f"noise alone leaves a mean of {found.gap.noise_floor_mm:.4f} mm"
        yield shown(_ERROR_HEADER, errors, f"Position error [mm] as calibrated; {noise}")
        return
    lead = found.explained
    if lead is not None:
        rows = [(each.of, "; ".join(each.ids), *_taken(each)) for each in lead.of]
        rows.append(("", "no name", "", percent(lead.without_a_name)))
        header = ("of", "effect", "rms before → after [mm]", "of the error beyond noise")
        yield shown(header, rows, f"{lead.headline[:1].upper()}{lead.headline[1:]}")
    yield shown(
        ("effect", "of", "parameters, with 95 % intervals", "alternatives", "evidence"),
        map(_effect_row, found.effects_by_share),
        "Effects found, those that take most away first" if lead else "Effects found",
    )
    if found.unexplained is not None:
        places = [(place.of or "not known", place.why) for place in found.unexplained.all]
        yield shown(("of", "why"), places, "Unexplained: a gap without a name")
    if found.proposed:
        formulas = map(_proposed_row, found.proposed)
        yield shown(
            _PROPOSED, formulas, "Formulas proposed for what has no name; they name nothing"
        )
    yield shown(
        _GAP_HEADER,
        _gap_rows(found),
        f"Position error [mm]; {found.gap.floor_is} alone leaves a mean of "
        f"{found.gap.noise_floor_mm:.4f} mm in the poses fitted",
    )
    if found.indistinguishable:
        groups = [(_together(group),) for group in found.indistinguishable]
        yield shown(("group",), groups, "Effects that these poses cannot distinguish")
    if found.not_testable:
        hidden = _by_effect(found.not_testable)
        yield shown(("effect", "of", "why"), hidden, "Effects that these data cannot show")
    if found.below_detection_limit:
        small = _by_effect(found.below_detection_limit)
        title = "Effects below the detection limit at their plausible size: sought all the same"
        yield shown(("effect", "of", "why"), small, title)


def _by_effect(entries: Iterable[NotTestable]) -> Iterator[Row]:
    """Yield a row an effect: where it sits, and the reasons, each with its places."""
    places: dict[str, dict[str, list[str]]] = {}
    for entry in entries:
        places.setdefault(entry.id, {}).setdefault(entry.why, []).append(entry.of)
    for effect, by_reason in places.items():
        everywhere = _places([of for each in by_reason.values() for of in each])
        if len(by_reason) == 1:
            yield effect, everywhere, next(iter(by_reason))
        else:
            reasons = (f"{_places(each)}: {why}" for why, each in by_reason.items())
            yield effect, everywhere, "; ".join(reasons)


def _places(places: Sequence[str]) -> str:
    """Return places in few words: `joints 1 to 3, 5` for the joints among them."""
    joints = sorted(int(of.removeprefix(_JOINT)) for of in places if of.startswith(_JOINT))
    others = [of for of in places if not of.startswith(_JOINT)]
    if not joints:
        return ", ".join(others)
    runs: list[list[int]] = []
    for joint in joints:
        if runs and joint == runs[-1][-1] + 1:
            runs[-1].append(joint)
        else:
            runs.append([joint])
    said = ", ".join(
        f"{run[0]} to {run[-1]}" if len(run) > _MOST_LISTED else ", ".join(map(str, run))
        for run in runs
    )
    return ", ".join([f"joint{'s' if len(joints) > 1 else ''} {said}", *others])


def _of_fault(fault: Fault) -> tuple[str, str, str]:
    return (fault.where, fault.what, fault.remedy)


def _effect_row(effect: FoundEffect) -> Row:
    parameters = _knots(effect) or _in_words(effect.parameters)
    alternatives = _together(effect.alternatives) or "none"
    return (effect.id, effect.of, parameters, alternatives, _evidence(effect.evidence))


def _taken(each: ExplainedEffect) -> tuple[str, str]:
    return (f"{each.before_mm:.4f} → {each.after_mm:.4f}", percent(each.share))


def _proposed_row(each: ProposedFormula) -> Row:
    alike = _together(each.does_as_well_as) or "noise alone"
    return (each.of, each.formula, _in_words(each.parameters), alike, f"{100 * each.gain:.0f} %")


def _in_words(parameters: Mapping[str, EffectParameter]) -> str:
    return "; ".join(
        f"{name} = {with_half_width(parameter.value, _HALF_WIDTH_95 * parameter.std)} "
        f"{parameter.unit}"
        for name, parameter in parameters.items()
    )


def _evidence(found: EvidenceByRepeats | EvidenceByBlocks | EvidenceOfSag) -> str:
    """Describe what decided about an effect, in words."""
    if isinstance(found, EvidenceOfSag):
        return found.words
    if isinstance(found, EvidenceByBlocks):
        blocks = found.cross_validation_over_blocks
        return (
            f"cross-validation over blocks: rms {blocks.rms_without_mm:.3f} mm without, "
            f"{blocks.rms_with_mm:.3f} mm with it; better in {blocks.improved} of "
            f"{blocks.blocks} blocks, z {blocks.z:.1f}"
        )
    shares = [("poses", found.cross_validation_over_poses)]
    if found.cross_validation_over_loads is not None:
        shares.append(("loads", found.cross_validation_over_loads))
    held_out = ", ".join(f"{100.0 * of.explained:.0f} % over {name}" for name, of in shares)
    return (
        f"{found.lost_without_it_nats:.3g} nats lost without it, {found.needed_nats:.3g} needed; "
        f"sign flips p {found.p_sign_flips_max_t:.2g}, at most {found.p_needed:.2g}; "
        f"cross-validation explains {held_out}"
    )


def _knots(effect: FoundEffect) -> str:
    """Sum up an effect of many knots; empty for others."""
    knots = [entry for name, entry in effect.parameters.items() if name.startswith("knot_")]
    if not knots:
        return ""
    rms = math.sqrt(sum(knot.value**2 for knot in knots) / len(knots))
    return f"{len(knots)} knots a turn, rms {rms:.3g} {knots[0].unit}"


def _statistics(evidence: dict[str, Any], of: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of the evidence, those inside others under both names."""
    for name, value in evidence.items():
        words = f"{of} {name.replace('_', ' ')}".strip()
        if isinstance(value, dict):
            yield from _statistics(value, words)
        elif isinstance(value, int | float):
            yield words, float(value)


def _together(effects: tuple[EffectName, ...]) -> str:
    return "; ".join(f"{effect.id} of {effect.of}" for effect in effects)


def _sets(found: VerdictRecord) -> list[tuple[str, SetGap]]:
    """Return the gaps there are, by what the poses are."""
    holdout = found.gap.holdout
    return [("fitted", found.gap.train)] + ([] if holdout is None else [("held out", holdout)])


def _gap_rows(found: VerdictRecord) -> Iterator[Row]:
    for poses, gap in _sets(found):
        yield _gap_row(poses, "all", gap)
        loads = gap.per_load.items() if len(gap.per_load) > 1 else ()
        for load, at_load in loads:
            yield _gap_row(poses, load, at_load)
        for part, within in _parts(gap):
            yield (f"{poses}, {_PARTS[part]}", "all", *_errors(within), "")
        if gap.without_motion is not None:
            yield (f"{poses}, {_WITHOUT_MOTION}", "all", *_errors(gap.without_motion), "")
        if gap.with_rivals is not None:
            rivals = BeforeAfter(before=gap.before, after=gap.with_rivals)
            yield (f"{poses}, {_WITH_RIVALS}", "all", *_errors(rivals), "")


def _gap_row(poses: str, load: str, gap: LoadGap) -> Row:
    low, high = gap.reduction.interval95_mm
    interval = f"{low:.4f} to {high:.4f} ({gap.reduction.poses} poses)"
    return (poses, load, *_errors(gap), interval)


def _errors(gap: BeforeAfter) -> list[str]:
    """Return mean, root mean square and peak, each before and after."""
    return [
        f"{getattr(errors, name):.4f}"
        for name in ("mean_mm", "rms_mm", "peak_mm")
        for errors in (gap.before, gap.after)
    ]


def _parts(gap: SetGap) -> list[tuple[str, BeforeAfter]]:
    """Return the gap inside the angles seen in the fit, and beyond them, where they differ."""
    if gap.inside is None or gap.outside is None:
        return []
    return [("inside", gap.inside), ("extrapolated", gap.outside)]


def _data_rows(found: VerdictRecord) -> Iterator[Row]:
    why = f"{found.why}; {found.remedy}" if found.why else ""
    yield ("verdict", "", "", "verdict", found.verdict, "", "", why)
    for effect in found.effects:
        rivals = _together(effect.alternatives)
        remark = f"alternatives: {rivals}" if rivals else "stands alone"
        for name, parameter in effect.parameters.items():
            value, std = f"{parameter.value:.8g}", f"{parameter.std:.3g}"
            yield ("effect", effect.id, effect.of, name, value, std, parameter.unit, remark)
        for name, number in _statistics(effect.evidence.model_dump()):
            yield ("evidence", effect.id, effect.of, name, f"{number:.6g}", "", "", "")
    if found.explained is not None:
        over = found.explained.over
        for each in found.explained.of:
            share = f"{each.share:.6g}"
            yield ("explained", "; ".join(each.ids), each.of, "share", share, "", "", over)
            for when, left_mm in (("before", each.before_mm), ("after", each.after_mm)):
                rms, name = f"{left_mm:.6g}", f"{when}_rms_mm"
                yield ("explained", "; ".join(each.ids), each.of, name, rms, "", "mm", over)
        share = f"{found.explained.share:.6g}"
        yield ("explained", "", "", "share", share, "", "", f"all effects, over {over}")
    for fault in found.faults:
        gain = "" if fault.gain is None else f"{fault.gain:.6g}"
        where, what, remedy = _of_fault(fault)
        yield ("fault", fault.kind, where, "gain", gain, "", "", f"{what}; {remedy}")
    for place in found.unexplained.all if found.unexplained else ():
        yield ("unexplained", "", place.of or "", "", "", "", "", place.why)
    for entry in found.not_testable:
        yield ("not_testable", entry.id, entry.of, "", "", "", "", entry.why)
    for entry in found.below_detection_limit or ():
        yield ("below_detection_limit", entry.id, entry.of, "", "", "", "", entry.why)
    for poses, gap in _sets(found):
        parts: dict[str, BeforeAfter] = {"all": gap, **gap.per_load, **dict(_parts(gap))}
        if gap.without_motion is not None:
            parts["motion taken out"] = gap.without_motion
        for load, at_load in parts.items():
            for when, errors in (("before", at_load.before), ("after", at_load.after)):
                for name in ("mean_mm", "rms_mm", "peak_mm"):
                    value = f"{getattr(errors, name):.6g}"
                    yield ("gap", "", poses, f"{when}_{name}", value, "", "mm", load)
    floor = f"{found.gap.noise_floor_mm:.6g}"
    said = f"{found.gap.floor_is} alone"
    yield ("gap", "", "", "noise_floor_mm", floor, "", "mm", said)


def _notes(found: VerdictRecord) -> tuple[str, ...]:
    meaning = _MEANINGS.get(found.verdict, found.verdict)
    if found.verdict == "not_sought":
        return (meaning, f"The noise is that of {found.gap.noise_floor_from}.")
    return (
        meaning,
        "Before: the calibrated model. After: the same with the effects found, recalibrated, and "
        "with the positions of the targets on the apparatus from that fit; without an effect the "
        "whole difference is due to them. Both are the models that are written: motion of the base "
        "that was found is in neither, and has a row of its own. Held-out poses are used for "
        "nothing else but to leave out effects that would make them worse.",
        _BY_REPEATS if found.method == "evidence of repeats" else _BY_BLOCKS,
        "The unit of the reduction's interval is the pose: loads and repeats of a pose share its "
        "errors and count once.",
        _floor(found),
    )


def _floor(found: VerdictRecord) -> str:
    """Say what the noise floor is, and why the health of the calibration has another."""
    if found.gap.noise_floor_from is not None:
        return f"The noise is that of {found.gap.noise_floor_from}."
    return (
        "Unidirectional repeatability: the mean error that the scatter of successive readings of "
        "the same pose, load and direction of arrival leaves. The noise in the health of the "
        "calibration is larger: a root mean square, over repeats from every direction and with "
        "the drift between them, or as stated. What depends on direction or time is sought here as "
        "an effect, so it is no noise here."
    )


# Remaining error as the named effects are added one by one, fitted and held out.

_ROW_MM = 11.0
_BELOW_MM, _ABOVE_MM = 30.0, 16.0
_TRAIN: dict[str, Any] = {"color": BLUE, "marker": "o"}
_HELD_OUT: dict[str, Any] = {"color": ORANGE, "marker": "^"}
_ASIDE = 0.19
_FLOOR_LINE: dict[str, Any] = {"color": BLACK, "linewidth": 0.9, "linestyle": "--"}


@picture(
    title="Gap: error as effects are named",
    needs=("analysis", "verdict"),
    caption="""
Gap between model and measurement in ``{name}`` as the effects of the verdict are added to the
model, first those without which the model with all of them loses most, all parameters fitted
again each time: blue for fitted poses, orange for held-out poses and loads. A marker is the
mean, the bar on the line the root mean square, the end of the line the largest error; the axis
is logarithmic. Dashed: the mean error that noise alone leaves, as successive readings from one
direction of arrival scatter (unidirectional repeatability) or, without repeats, as stated; an
error common to all poses, such as a target position, adds to it. Effects that mask each other
may bring little one by one and much together. Where orange falls with blue, the names hold
beyond the fitted poses.
""",
)
def draw_gap_by_step(results: Results) -> Figure:
    """Draw mean, root mean square and peak of every step, from the calibrated model downward."""
    found = results.analysis()
    steps = found.naming
    rows = _ROW_MM * len(steps)
    figure = new_figure(
        _BELOW_MM + rows + _ABOVE_MM, "Gap between model and measurement, effect by effect"
    )
    axes = panel(figure, 46.0, _BELOW_MM, 84.0, rows)
    for k, step in enumerate(steps):
        _draw_errors(axes, k - _ASIDE, step.train, _TRAIN)
        if step.holdout is not None:
            _draw_errors(axes, k + _ASIDE, step.holdout, _HELD_OUT)
    everything = [errors for step in steps for errors in (step.train, step.holdout) if errors]
    floor = found.noise_floor_mm
    lowest = min(floor, *(errors.mean_mm for errors in everything))
    plain_log(axes, "x", lowest / 1.5, max(errors.peak_mm for errors in everything) * 1.4)
    axes.axvline(floor, **_FLOOR_LINE)
    name_rows(axes, [_name(step) for step in steps], lines=False)
    axes.set_xlabel("position error [mm]: mean, rms (bar) and peak (end)")
    write_text_at(figure, 133.0, _BELOW_MM + rows + 2.0, "mean / rms / peak [mm]")
    _draw_legend(figure, steps, f"{results.verdict().gap.floor_is} alone: mean")
    write_text_at(figure, 10.0, 6.5, _beyond(found), color=GREY)
    return figure


def _beyond(found: AnalysisRecord) -> str:
    """State the errors of held-out poses inside the joint angles of the fit and beyond."""
    if len(found.naming) == 1:
        return "No effect was named: there is one step."
    held_out = found.gap.holdout
    beyond = None if held_out is None else held_out.extrapolated
    if held_out is None or beyond is None or not beyond.any():
        return ""
    error_mm = np.linalg.norm(held_out.after_mm, axis=1)
    outside_mm = np.sqrt(np.mean(error_mm[beyond] ** 2))
    if beyond.all():
        return f"Held out, last step: rms {outside_mm:.3f} mm; all poses are extrapolated."
    inside_mm = np.sqrt(np.mean(error_mm[~beyond] ** 2))
    return (
        f"Held out, last step: rms {inside_mm:.3f} mm inside the angles of the fit, "
        f"{outside_mm:.3f} mm in {beyond.sum()} of {len(beyond)} (extrapolated)."
    )


def _name(step: NamingStep) -> str:
    """Return what joined the model at a step."""
    if not step.effects:
        return "calibrated model"
    name, _, place = step.effects[-1].words.partition(", ")
    return f"+ {name}\n   {place}"


def _draw_errors(axes: Axes, y: float, errors: Accuracy, look: dict[str, Any]) -> None:
    axes.plot([errors.mean_mm, errors.peak_mm], [y, y], color=look["color"], linewidth=1.4)
    for value, size in ((errors.rms_mm, 7.0), (errors.peak_mm, 4.0)):
        axes.plot(value, y, color=look["color"], marker="|", markersize=size)
    axes.plot(errors.mean_mm, y, **look)
    said = f"{errors.mean_mm:.3f} / {errors.rms_mm:.3f} / {errors.peak_mm:.3f}"
    write_beside(axes, y, said, 1.035)


def _draw_legend(figure: Figure, steps: tuple[NamingStep, ...], floor_is: str) -> None:
    handles = [Line2D([], [], label="poses fitted", **_TRAIN)]
    if steps[0].holdout is not None:
        handles.append(Line2D([], [], label="held-out poses and loads", **_HELD_OUT))
    handles.append(Line2D([], [], label=floor_is, **_FLOOR_LINE))
    legend_at(figure, 10.0, 11.0, handles, ncols=3)
