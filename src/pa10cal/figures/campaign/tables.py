"""Tables of a campaign: errors, parameters, health, suspected outliers and the verdict.

What readers see of them is what the page shows; the CSV holds every number.
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import attrgetter
from typing import Any

from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.figures.results import MODELS, Results
from pa10cal.figures.table import Row, Table, frame_of
from pa10cal.reports.accuracy import errors_grids, gap_grid, parameter_grids
from pa10cal.reports.blocks import Grid, grid
from pa10cal.reports.formatting import figures, mm, shown_in, written
from pa10cal.reports.outcome import MEANINGS, formulas_of, verdict_grids
from pa10cal.reports.pictures import errors_of
from pa10cal.reports.trust import checks_grid, evidence_grid, hidden_grids, pairs_grid
from pa10cal.results.calibration import (
    CalibrationRecord,
    GeneralCalibrationRecord,
)
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.evaluation import BeforeAfter
from pa10cal.results.health import Health

# Errors of every model at the poses fitted and at those held out.

_ERRORS = ("mean_mm", "rms_mm", "peak_mm", "orientation_deg")


@picture(
    title="Accuracy of the general model",
    needs=("general_calibration", "evaluation"),
    caption="""
Errors of each model of ``{name}`` at the fitted and at the held-out poses: mean, root mean
square and peak, and the mean orientation error where the instrument measures orientation.
*Not calibrated* is the described arm with its base and its tool or targets fitted. The model with
the
discovered effects is judged separately inside the joint angles of the fitted poses and beyond
them, where it extrapolates and its accuracy is not assured.
""",
)
def tabulate_accuracy_general(results: Results) -> Table:
    """Return mean, rms and peak error and orientation, of the poses fitted and held out."""
    results.general(), results.held_out()  # refuse what is not to be drawn
    words = results.bundle.words
    assert words is not None
    every = errors_of(results.bundle)
    header = ("poses", "model", "load", "part", *_ERRORS, "configurations")
    rows = []
    for each in every:
        errors = [figures(number, 6) for number in attrgetter(*_ERRORS)(each.of)]
        rows.append((each.poses, each.name, each.load, each.part, *errors, each.of.configurations))
    return Table(
        title="Accuracy of the general model",
        data=frame_of(header, rows),
        shown=tuple(errors_grids(every)),
        notes=(
            words.of,
            "The arm that is not calibrated has its base and its tool or targets fitted to the "
            "same poses.",
            "Extrapolated: poses with a joint at an angle far from those of the fitted poses, so "
            "that an error learnt by angle is not known there.",
        ),
    )


# Parameters, of the model and of each campaign of a group.

_PARAMETER_HEADER = (
    "parameter",
    "unit",
    "value",
    "std",
    "tolerance",
    "identifiable",
    "at_bound",
    "redundant",
    "replaced_by",
)
_TORQUES = {
    "logged": "Joint springs use the logged torques.",
    "masses": "No torques were logged: joint springs use the torques of the described masses.",
    "none": "No torques are known, so there are no springs.",
}


@picture(
    title="Parameters of the general model",
    needs=("general",),
    caption="""
Every parameter of the general model of ``{name}`` with its standard uncertainty: departures of
the links from the description, joint stiffness, tool or targets, and base. The set is complete
and minimal: every direction that arm and instrument can identify is there, and a redundant
parameter is omitted; the last table says which parameters take its place. A parameter marked as
not identifiable could be identified by arm and instrument, but not from these poses. Values far
beyond their tolerance indicate a defective part, or an effect that the model lacks. The CSV
holds SI units.
""",
)
def tabulate_parameters_general(results: Results) -> Table:
    """Return every parameter with its uncertainty, and the replacement of each redundant one."""
    case = results.general()
    shown = [*parameter_grids(case.parameters)]
    if case.redundant:
        rows = []
        for entry in case.redundant:
            parts = [f"{part:.4g} × {written(name)}" for name, part in entry.replaced_by.items()]
            same = " + ".join(parts).replace("+ -", "− ")
            rows.append((written(entry.name), same or "nothing: it has no effect"))
        shown.append(grid("Omitted: redundant parameters", ("omitted", "the same as"), rows))
    return Table(
        title="Parameters of the general model",
        data=frame_of(_PARAMETER_HEADER, _parameter_rows(case)),
        shown=tuple(shown),
        notes=(
            f"Rank {case.health.rank} of {case.health.unknowns} unknowns. Intervals are from the "
            "scatter of the poses about the model; the CSV has standard uncertainties in SI units.",
            "A redundant parameter has exactly the effect of others, for this arm and instrument "
            "in any pose, and is omitted. One unit of it equals the combination beside it.",
            _TORQUES[case.torques_from],
        ),
    )


def _parameter_rows(case: GeneralCalibrationRecord) -> Iterator[tuple[object, ...]]:
    for name, found in case.parameters.items():
        numbers = (figures(found.value, 8), figures(found.std, 4), figures(found.tolerance, 6))
        words = (str(found.identifiable).lower(), str(found.at_bound).lower(), "false", "")
        yield (name, found.unit, *numbers, *words)
    for entry in case.redundant:
        by = "; ".join(f"{part:.6g} {name}" for name, part in entry.replaced_by.items())
        yield (entry.name, "", None, None, None, "", "", "true", by)


@picture(
    title="Parameters by campaign",
    needs=("general",),
    caption="""
The parameters of the robot that all campaigns of ``{name}`` share, each with its standard
uncertainty by all of them together and by each campaign alone, with base, tool and targets its
own. A parameter that one campaign leaves open may be determined by another. The second table
holds each campaign against all others: the chi-square of what they differ by, and the one
parameter that explains most of it.
""",
)
def tabulate_parameters_by_campaign(results: Results) -> Table:
    """Return where every shared parameter comes from, and each campaign against the others."""
    group = results.general().group
    if group is None:
        raise NothingToShowError("it is one campaign")
    names = tuple(group.campaigns)
    rows, cells, compared = [], [], []
    for name, found in group.parameters.items():
        unit, scale = shown_in(found.unit)
        alone = [found.std_alone[each] for each in names]
        by = ", ".join(found.determined_by) or "all together"
        rows.append((name, found.unit, figures(found.std, 4), *(figures(x, 4) for x in alone), by))
        told = [
            f"{scale * x:.4f}" if each in found.determined_by else "–"
            for each, x in zip(names, alone, strict=True)
        ]
        cells.append((written(name), unit, f"{scale * found.std:.4f}", *told, by))
    for name, each in group.campaigns.items():
        unit, scale = shown_in(each.worst.unit)
        off, u = scale * each.worst.value, scale * each.worst.std
        errors = (f"{each.rms_mm:.3f}", f"{each.alone_rms_mm:.3f}")
        test = (f"{each.chi_square:.1f} for {each.dof:.0f}", f"{each.p_value:.2g}")
        most = f"{written(each.worst.name)}: {off:.3g} ± {u:.2g} {unit}"
        contradicts = "yes" if each.contradicts else "no"
        compared.append((name, str(each.poses), *errors, *test, most, contradicts))
    header = ("parameter", "unit", "std", *(f"std {name}" for name in names), "determined by")
    against = ("campaign", "poses", "rms [mm]", "alone [mm]", "χ²", "p", "most by", "contradicts")
    return Table(
        title="Parameters by campaign",
        data=frame_of(header, rows),
        shown=(
            grid("", header, cells),
            grid("Each campaign against the others", against, compared),
        ),
        notes=(
            "std: one standard uncertainty; a dash where the campaign alone does not determine "
            "the parameter. The CSV is in SI units.",
            "Campaigns contradict each other where chance does not explain the difference and "
            "parameters of its own take away a tenth of a campaign's squared error.",
        ),
    )


# The health of the calibrations of all loads, and poses far outside the scatter of the others.

_HEALTH_HEADER = ("model", "quantity", "of", "value", "unit")
#: So many poses in D-optimal order are shown; the CSV has all that were ordered.
_MOST_SHOWN = 30
_OUTLIER_HEADER = ("pose", "load_N", "distance", "weight", "why")


@picture(
    title="Health of the calibration",
    needs=("calibration", "general"),
    caption="""
Whether the calibration of ``{name}`` is good, in one line and in the quantities behind it:
termination of the fit, rank and condition number, parameters at a bound, not identifiable or
strongly correlated, the error of fitted against held-out poses, and the uncertainty to expect
with so many poses. Where the paper's model is used, the general model stands beside it. The
poses at the head of the D-optimal order carry the most information: measured again, they are a
good check.
""",
)
def tabulate_health_summary(results: Results) -> Table:
    """Return termination, rank, errors and expected uncertainty, and how many poses are needed."""
    cases = results.calibrations()
    shown: list[Grid] = []
    for case in cases:
        shown += [checks_grid(case, MODELS[case.model]), pairs_grid(case.health)]
        shown.append(_order(case.health))
    return Table(
        title="Health of the calibration",
        data=frame_of(_HEALTH_HEADER, [row for case in cases for row in _health_rows(case)]),
        shown=tuple(shown),
        notes=(
            "Expected uncertainty: standard uncertainty of a predicted position, root mean square "
            "over the poses; with the paper's model from the scatter of repeats, with the "
            "general model from the scatter of the poses about it. Neither covers an effect that "
            "the model lacks.",
            "Scatter of all repeats: of the averaged repeats of a pose and load, from every "
            "direction of arrival and with the drift between them. Stated uncertainty: what the "
            "campaign states of its averaged readings. The grade compares with what successive "
            "readings scatter by, where they are repeated, and with the places of the targets; the "
            "verdict with the mean, not the root mean square, of the former "
            "(unidirectional repeatability).",
            "Needed: the uncertainty that adds hardly anything to the remaining error. D-optimal "
            "order: each pose increases the determinant of the information matrix most.",
        ),
    )


def _order(health: Health) -> Grid:
    """Return the uncertainty by number of poses, and which pose comes next."""
    poses = health.poses
    rows = []
    for expected in poses.expected[:_MOST_SHOWN]:
        uncertainties = (mm(expected.u_optimal_mm), mm(expected.u_measured_mm))
        last = poses.d_optimal_order[expected.poses - 1]
        rows.append((str(expected.poses), *uncertainties, last))
    header = ("poses", "D-optimal order [mm]", "order measured [mm]", "last pose of the former")
    return grid("Expected uncertainty by number of poses", header, rows, (1, 2))


def _health_rows(case: CalibrationRecord) -> Iterator[Row]:
    health, model = case.health, case.model
    poses = health.poses
    for quantity in ("grade", "line", "reason", "rank", "unknowns", "condition"):
        yield (model, quantity, "", str(getattr(health, quantity)), "")
    for quantity in ("at_bounds", "not_identifiable"):
        yield (model, quantity, "", " ".join(getattr(health, quantity)), "")
    for quantity in ("train_rms_mm", "held_out_rms_mm", "noise_mm"):
        yield (model, quantity, "", _plain(getattr(health, quantity)), "mm")
    for quantity in ("u_model_mm", "u_needed_mm"):
        yield (model, quantity, "", _plain(getattr(poses, quantity)), "mm")
    for quantity in ("measured", "needed"):
        value = getattr(poses, quantity)
        yield (model, f"poses_{quantity}", "", "" if value is None else str(value), "")
    for pair in health.correlated_pairs:
        yield (model, "correlation", " and ".join(pair.parameters), f"{pair.correlation:.6g}", "")
    for expected in poses.expected:
        for quantity in ("u_optimal_mm", "u_measured_mm"):
            value = _plain(getattr(expected, quantity))
            yield (model, quantity, f"{expected.poses} poses", value, "mm")
    for k, pose in enumerate(poses.d_optimal_order, start=1):
        yield (model, "d_optimal_order", str(k), pose, "")


def _plain(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


@picture(
    title="Suspected outliers",
    needs=("general",),
    caption="""
Poses of ``{name}`` that lie so far outside the scatter of the others that chance hardly
explains them, each with the quantity that is off and by how much. None was removed: each stayed
in the fit with a reduced weight, so that it cannot bias the other poses. A single such pose may
be a wrong reading. Several of them at neighbouring positions or joint angles are more likely an
effect that the model lacks.
""",
)
def tabulate_suspected_outliers(results: Results) -> Table:
    """Return every suspected outlier, the worst first."""
    case = results.general()
    rows = [
        (each.pose, each.load_N, round(each.distance, 2), round(each.weight, 3), each.why)
        for each in case.suspected_outliers
    ]
    cells = [
        (pose, f"{N:g}", f"{far:.2f}", f"{weight:.3f}", why) for pose, N, far, weight, why in rows
    ]
    return Table(
        title="Suspected outliers",
        data=frame_of(_OUTLIER_HEADER, rows),
        shown=(grid("", ("pose", "load [N]", "distance", "weight", "why"), cells, (1, 2, 3)),),
        notes=(
            f"{len(rows)} of {case.health.poses.measured} poses. None was removed: each stayed in "
            "the fit with the weight given, 1 being that of the others.",
            "Distance: residual over all readings of the pose, in standard deviations of the "
            "scatter. Without a wrong pose, one campaign in a hundred has a suspected outlier.",
            "A suspected outlier may be a wrong reading, or a place where the model lacks an "
            "effect.",
        ),
    )


# The verdict: which effects are missing from the model, how sure that is, and what it is worth.

_VERDICT_HEADER = ("kind", "effect", "of", "quantity", "value", "std", "unit", "remark")
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
        data=frame_of(_VERDICT_HEADER, _verdict_rows(found)),
        shown=tuple(_verdict_shown(found, formulas_of(results.bundle))),
        notes=_notes(found),
    )


def _verdict_shown(found: VerdictRecord, formulas: dict[tuple[str, str], str]) -> Iterator[Grid]:
    faults, effects, no_name, proposed = verdict_grids(found, formulas)
    if found.verdict == "not_sought":
        yield from [faults] if found.faults else ()
        reason = [(found.why or "", found.remedy or "")]
        yield grid("Effects not sought", ("why", "what would do"), reason)
        yield gap_grid(found)
        return
    evidence = evidence_grid(found)
    yield from (each for each in (faults,) if each.rows)
    yield effects
    yield from (each for each in (evidence, no_name, proposed) if each.rows)
    yield gap_grid(found)
    yield from hidden_grids(found)


def _statistics(evidence: dict[str, Any], of: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of the evidence, those inside others under both names."""
    for name, value in evidence.items():
        words = f"{of} {name.replace('_', ' ')}".strip()
        if isinstance(value, dict):
            yield from _statistics(value, words)
        elif isinstance(value, int | float):
            yield words, float(value)


def _verdict_rows(found: VerdictRecord) -> Iterator[Row]:
    why = f"{found.why}; {found.remedy}" if found.why else ""
    yield ("verdict", "", "", "verdict", found.verdict, "", "", why)
    for effect in found.effects:
        rivals = "; ".join(f"{each.id} of {each.of}" for each in effect.alternatives)
        remark = f"alternatives: {rivals}" if rivals else "stands alone"
        for name, parameter in effect.parameters.items():
            value, std = f"{parameter.value:.8g}", f"{parameter.std:.3g}"
            yield ("effect", effect.id, effect.of, name, value, std, parameter.unit, remark)
        for name, number in _statistics(effect.evidence.model_dump()):
            yield ("evidence", effect.id, effect.of, name, f"{number:.6g}", "", "", "")
    if found.explained is not None:
        over = found.explained.over
        for each in found.explained.of:
            of = ("explained", "; ".join(each.ids), each.of)
            yield (*of, "share", f"{each.share:.6g}", "", "", over)
            yield (*of, "before_rms_mm", f"{each.before_mm:.6g}", "", "mm", over)
            yield (*of, "after_rms_mm", f"{each.after_mm:.6g}", "", "mm", over)
        share = f"{found.explained.share:.6g}"
        yield ("explained", "", "", "share", share, "", "", f"all effects, over {over}")
    for fault in found.faults:
        gain = "" if fault.gain is None else f"{fault.gain:.6g}"
        where, what, remedy = fault.where, fault.what, fault.remedy
        yield ("fault", fault.kind, where, "gain", gain, "", "", f"{what}; {remedy}")
    for place in found.unexplained.all if found.unexplained else ():
        yield ("unexplained", "", place.of or "", "", "", "", "", place.why)
    for entry in found.not_testable:
        yield ("not_testable", entry.id, entry.of, "", "", "", "", entry.why)
    for entry in found.below_detection_limit or ():
        yield ("below_detection_limit", entry.id, entry.of, "", "", "", "", entry.why)
    for poses, gap in (("fitted", found.gap.train), ("held out", found.gap.holdout)):
        if gap is None:
            continue
        parts: dict[str, BeforeAfter] = {"all": gap, **gap.per_load}
        if gap.inside is not None and gap.outside is not None:
            parts |= {"inside": gap.inside, "extrapolated": gap.outside}
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
    meaning = MEANINGS[found.verdict]
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
