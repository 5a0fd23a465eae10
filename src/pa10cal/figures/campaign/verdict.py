"""The verdict: which effects are missing from the model, how sure that is, and what it is worth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.table import Grid, Row, Table
from pa10cal.results.accuracy import BeforeAfter
from pa10cal.results.discovery import (
    EffectName,
    EvidenceByBlocks,
    FoundEffect,
    LoadGap,
    SetGap,
    VerdictRecord,
)

PICTURE = Picture(
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
arm. The CSV holds the same, one number a row.
""",
)

_HALF_WIDTH_95 = 1.96
_DATA_HEADER: Row = ("kind", "effect", "of", "quantity", "value", "std", "unit", "remark")
_GAP_HEADER: Row = (
    "poses",
    "load",
    "mean before",
    "after",
    "rms before",
    "after",
    "peak before",
    "after",
    "mean less by, 95 % interval",
)
_PARTS = {"inside": "angles seen in the fit", "extrapolated": "extrapolated"}
_BY_REPEATS = (
    "Evidence: what the data would be less likely by without the effect (natural logarithm, "
    "nats); the chance that sign flips over poses give any candidate as much (max T); and what "
    "it explains of the error of poses and loads left out."
)
_BY_BLOCKS = (
    "Evidence: how blocks of poses that were left out are predicted without the effect and with "
    "it, in how many of them better, and the gain over its standard error (z). A map's knots are "
    "all in the CSV. Extrapolated: poses with a joint at an angle not seen in the fit."
)
_MEANINGS = {
    "none": "None: model and measurement agree within the measured repeatability.",
    "named": "Named: every effect found stands alone.",
    "ambiguous": "Ambiguous: at least one effect cannot be told from its alternatives.",
    "unexplained": "Unexplained: a gap remains that no effect of the vocabulary closes.",
}


def tabulate(results: Results) -> Table:
    """Return effects with intervals, alternatives and evidence, what is not testable, the gap."""
    found = results.verdict()
    return Table(
        title="What is missing from the model",
        data=Grid(_DATA_HEADER, tuple(_data_rows(found))),
        shown=tuple(_grids(found)),
        notes=_notes(found),
    )


def _grids(found: VerdictRecord) -> Iterator[Grid]:
    yield Grid(
        ("effect", "of", "parameters, with 95 % intervals", "alternatives", "evidence"),
        tuple(_effect_row(effect) for effect in found.effects) or (("none named", "", "", "", ""),),
        "Effects found",
    )
    if found.unexplained is not None:
        places = tuple((place.of or "not known", place.why) for place in found.unexplained.all)
        yield Grid(("of", "why"), places, "Without a name")
    yield Grid(
        _GAP_HEADER,
        tuple(_gap_rows(found)),
        f"Position error [mm]; repeatability alone leaves {found.gap.noise_floor_mm:.4f} mm",
    )
    if found.indistinguishable:
        groups = tuple((_together(group),) for group in found.indistinguishable)
        yield Grid(("group",), groups, "Effects that these poses could not tell apart")
    if found.not_testable:
        yield Grid(
            ("effect", "of", "why"),
            tuple((entry.id, entry.of, entry.why) for entry in found.not_testable),
            "Effects that these data cannot show",
        )


def _effect_row(effect: FoundEffect) -> Row:
    parameters = _knots(effect) or "; ".join(
        f"{name} = {parameter.value:.5g} ± {_HALF_WIDTH_95 * parameter.std:.2g} {parameter.unit}"
        for name, parameter in effect.parameters.items()
    )
    evidence = _blocks(effect) or "; ".join(
        f"{name} {value:.3g}" for name, value in _statistics(effect.evidence.model_dump())
    )
    return (effect.id, effect.of, parameters, _together(effect.alternatives) or "none", evidence)


def _blocks(effect: FoundEffect) -> str:
    """Say how blocks held out are predicted; empty where effects were judged by repeats."""
    if not isinstance(effect.evidence, EvidenceByBlocks):
        return ""
    found = effect.evidence.cross_validation_over_blocks
    return (
        f"rms of blocks left out {found.rms_without_mm:.3f} mm without, "
        f"{found.rms_with_mm:.3f} mm with it; better in {found.improved} of "
        f"{found.blocks} blocks, z {found.z:.1f}"
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
        for load, at_load in gap.per_load.items():
            yield _gap_row(poses, load, at_load)
        for part, within in _parts(gap):
            yield (f"{poses}, {_PARTS[part]}", "all", *_errors(within), "")


def _gap_row(poses: str, load: str, gap: LoadGap) -> Row:
    low, high = gap.reduction.interval95_mm
    said = f"{low:.4f} to {high:.4f} ({gap.reduction.poses} poses)"
    return (poses, load, *_errors(gap), said)


def _errors(gap: BeforeAfter) -> list[str]:
    """Return mean, root mean square and peak, each before and after."""
    return [
        f"{getattr(errors, name):.4f}"
        for name in ("mean_mm", "rms_mm", "peak_mm")
        for errors in (gap.before, gap.after)
    ]


def _parts(gap: SetGap) -> list[tuple[str, BeforeAfter]]:
    """Return the gap inside the angles seen in the fit, and beyond them, where they differ."""
    if gap.inside is None or gap.extrapolated is None:
        return []
    return [("inside", gap.inside), ("extrapolated", gap.extrapolated)]


def _data_rows(found: VerdictRecord) -> Iterator[Row]:
    yield ("verdict", "", "", "verdict", found.verdict, "", "", "")
    for effect in found.effects:
        rivals = _together(effect.alternatives)
        remark = f"alternatives: {rivals}" if rivals else "stands alone"
        for name, parameter in effect.parameters.items():
            value, std = f"{parameter.value:.8g}", f"{parameter.std:.3g}"
            yield ("effect", effect.id, effect.of, name, value, std, parameter.unit, remark)
        for name, number in _statistics(effect.evidence.model_dump()):
            yield ("evidence", effect.id, effect.of, name, f"{number:.6g}", "", "", "")
    for place in found.unexplained.all if found.unexplained else ():
        yield ("unexplained", "", place.of or "", "", "", "", "", place.why)
    for entry in found.not_testable:
        yield ("not_testable", entry.id, entry.of, "", "", "", "", entry.why)
    for poses, gap in _sets(found):
        parts: dict[str, BeforeAfter] = {"all": gap, **gap.per_load, **dict(_parts(gap))}
        for load, at_load in parts.items():
            for when, errors in (("before", at_load.before), ("after", at_load.after)):
                for name in ("mean_mm", "rms_mm", "peak_mm"):
                    value = f"{getattr(errors, name):.6g}"
                    yield ("gap", "", poses, f"{when}_{name}", value, "", "mm", load)
    floor = f"{found.gap.noise_floor_mm:.6g}"
    yield ("gap", "", "", "noise_floor_mm", floor, "", "mm", "repeatability alone")


def _notes(found: VerdictRecord) -> tuple[str, ...]:
    return (
        _MEANINGS.get(found.verdict, found.verdict),
        "Before is the calibrated model, after the same with the effects found, recalibrated, and "
        "with the places of the targets on the apparatus as that fit leaves them; with no effect "
        "the whole difference is theirs. Held-out poses are used for nothing else.",
        _BY_REPEATS if found.angles_seen is None else _BY_BLOCKS,
        "The interval of the reduction is over poses: the loads and repeats of a pose share its "
        "errors and count once.",
    )
