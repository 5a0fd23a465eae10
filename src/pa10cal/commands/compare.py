"""Command `compare`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pa10cal.results.comparison import ComparisonRecord

#: Parameters shown: those that differ by most of their uncertainty, from so many of it on.
_SHOWN, _WORTH_SHOWING = 5, 3.0


def compare(first: Path, second: Path, *, out: Path | None = None) -> None:
    """Say what differs between two models of one arm, and whether it matters.

    Models are judged by where they put the flange, over the joint angles that both have seen, once
    base and tool are taken off. docs/using-the-model.md explains the figures.

    Args:
        first: model.yaml of a calibration, or the results that hold it.
        second: model.yaml of another.
        out: every parameter and figure, to write (.json).

    Examples:
        pa10cal compare results/june/model/model.yaml results/july/model/model.yaml
        pa10cal compare june.yaml july.yaml --out compare.json
    """
    from pa10cal.evaluation.two_models import compare_models
    from pa10cal.fit.model_file import load_model
    from pa10cal.results.codec import write

    models = load_model(first), load_model(second)
    found = compare_models(*models, names=(str(first), str(second)))
    if out is not None:
        write(found, out)
    print("\n".join(_lines(found)))


def _lines(found: ComparisonRecord) -> Iterator[str]:
    """Yield what a reader is shown: models, frames, parameters that differ most, the sentence."""
    for number, model in enumerate((found.first, found.second), start=1):
        of = f"{model.calibration} of {model.campaign}" if model.campaign else "not known"
        yield f"{number}  {model.name}: {model.robot}, fit {of}, grade {model.grade or 'not known'}"
        if model.only_here:
            yield f"   only here: {', '.join(model.only_here)}"
    if found.described_otherwise:
        yield f"described otherwise: {', '.join(found.described_otherwise)}"
    if found.frames:
        yield ""
        over = f"over {found.postures} postures"
        yield f"{over:<24}{'rms mm':>9}{'peak mm':>9}{'rms deg':>10}"
        for name, each in found.frames.items():
            yield _row(f"{name}, as predicted", each.rms_mm, each.peak_mm, each.orientation_deg)
            yield _row("  base and tool explain", each.base_and_tool_mm)
            yield _row(
                "  remains", each.remaining_rms_mm, each.remaining_peak_mm, each.remaining_deg
            )
            if each.expected_mm is not None:
                yield _row("  expected to remain", each.expected_mm, None, each.expected_deg)
    rows = found.parameters
    most = sorted(
        (-abs(over_u), k) for k, over_u in enumerate(rows.over_u) if abs(over_u) >= _WORTH_SHOWING
    )
    if most:
        yield ""
        yield "parameters that differ most, in standard uncertainties of the difference"
        for _, k in most[:_SHOWN]:
            name = f"{rows.parameter[k]} ({rows.term[k]} of {rows.of[k]})"
            values = f"{rows.first[k]:.6g} and {rows.second[k]:.6g} {rows.unit[k]}"
            yield f"  {name:<44} {rows.over_u[k]:+8.1f}  {values}"
    yield ""
    yield found.line
    if found.what_moved is not None:
        yield f"between both campaigns: {found.what_moved.line}"


def _row(title: str, rms: float, peak: float | None = None, deg: float | None = None) -> str:
    peak_shown = "" if peak is None else f"{peak:.3f}"
    deg_shown = "" if deg is None else f"{deg:.4f}"
    return f"{title:<24}{rms:>9.3f}{peak_shown:>9}{deg_shown:>10}".rstrip()
