"""Parameters of the final model, with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pa10cal.figures.parameter_names import written
from pa10cal.reports.blocks import (
    NOT_KNOWN,
    Block,
    Callout,
    Paragraph,
    Section,
    grid,
    shown_in,
    with_interval,
)
from pa10cal.reports.gathered import Gathered
from pa10cal.reports.pictures import tolerances_drawing
from pa10cal.results.accuracy import Parameter

#: Departures of what loads the springs, and how many that poses do not identify are listed.
_WEIGHTS, _MOST_WEIGHTS = "weight_", 4

_GROUPS = (
    ("Links: departures from the arm's description", ("delta_",)),
    ("Springs of the joints", ("K_", "compliance_", "cubic_share_", "windup_")),
    ("Tool or targets, in the end-effector frame", ("tool_", "target_")),
    ("Base frame in the instrument's frame", ("base_", "gamma_")),
    ("Others", ("",)),
)


def parameters(found: Gathered) -> Section:
    """Return the parameters of the model that is exported."""
    return Section("parameters", "Parameters", tuple(_blocks(found)))


def _blocks(found: Gathered) -> Iterator[Block]:
    if found.calibration is None:
        yield Callout("missing", found.why_absent(f"calibration/{found.load_case}.json"))
        return
    shown: Mapping[str, Parameter] = found.calibration.parameters
    of = "calibrated model"
    if found.extended is not None and found.extended.named:
        shown, of = found.extended.parameters, "model with the effects found"
    yield Paragraph(
        f"Parameters of the {of}, with 95 % intervals. An interval holds what the noise of the "
        "measurement leaves open; it holds no effect that the model lacks. A tolerance is what a "
        "maker is expected to keep."
    )
    drawing = tolerances_drawing(shown)
    if drawing is not None:
        yield drawing
    remaining = dict(shown)
    for title, begins in _GROUPS:
        names = [name for name in remaining if name.startswith(begins)]
        group = {name: remaining.pop(name) for name in names}
        weights = [n for n, each in group.items() if _WEIGHTS in n and not each.identifiable]
        if len(weights) > _MOST_WEIGHTS:
            group = {name: each for name, each in group.items() if name not in weights}
            yield Paragraph(
                f"Weights: {len(weights)} departures of masses, of their moments and of the "
                "base's level stay near the values described, within what a description is "
                "usually off. The poses fitted do not identify them."
            )
        if group:
            header = ("parameter", "value, 95 % interval", "unit", "tolerance", "remark")
            rows = [_row(name, each) for name, each in group.items()]
            yield grid(title, header, rows, (1, 3))


def _row(name: str, found: Parameter) -> tuple[str, ...]:
    unit, scale = shown_in(found.unit, found.value)
    tolerance = NOT_KNOWN if found.tolerance is None else f"{scale * found.tolerance:g}"
    if not found.identifiable:
        return written(name), NOT_KNOWN, unit, tolerance, "not identifiable from these poses"
    std = None if found.std is None else scale * found.std
    remark = "at the end of its physical range" if getattr(found, "at_bound", False) else ""
    if not remark and found.std == 0.0:
        remark = "not fitted"
    if not remark and found.tolerance and abs(found.value) > 3.0 * found.tolerance:
        remark = f"{abs(found.value) / found.tolerance:.0f} tolerances"
    return written(name), with_interval(scale * found.value, std), unit, tolerance, remark
