"""Section of the page: the parameters of the final model, with intervals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from pa10cal.reports import formatting
from pa10cal.reports.blocks import Grid, PageBlock, Paragraph, folded, grid
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.calibration import (
    ASSUMED,
    CalibratedParameter,
    CalibrationRecord,
    CampaignAlone,
    GeneralCalibrationRecord,
    GroupOfCampaigns,
)
from pa10cal.results.evaluation import Parameter

#: Part of a weight's name; of more weights that are not identifiable only the number is shown.
_WEIGHTS, _MOST_WEIGHTS = "weight_", 4
#: Unknowns of the search alone: without it weights are as described, and springs linear.
_ZERO_WITHOUT_SEARCH = (_WEIGHTS, "K_cub_")
#: A parameter has shifted if it moved by so many standard uncertainties.
_SHIFTED = 1.0
#: The value of a stiffness at the end of its range.
_RIGID = "rigid"
#: Tables of parameters: title, and how the names of its parameters begin.
_GROUPS = (
    ("Links: departures from the arm's description", ("delta_",)),
    ("Springs of the joints", ("K_", "compliance_")),
    ("Tool or targets, in the end-effector frame", ("tool_", "target_")),
    ("Base frame in the instrument's frame", ("base_", "gamma_")),
    ("Others", ("",)),
)


def parameters(results: ResultsBundle, case: CalibrationRecord) -> Iterator[PageBlock]:
    """Yield the parameters of the model that is exported."""
    shown: Mapping[str, Parameter] = case.parameters
    model = "calibrated model"
    if results.extended is not None and results.extended.adds_parameters:
        shown = results.extended.parameters
        model = (
            "model with the effects found"
            if results.extended.named
            else "model of the arm since the zero of a joint moved"
            if results.extended.moved_zeros
            else "model with the weights"
        )
    yield Paragraph(
        f"Parameters of the {model}, with 95 % intervals. An interval includes the noise of the "
        "measurement, but no effect that the model lacks. A tolerance is the deviation expected of "
        "a maker."
    )
    weights = [name for name, of in shown.items() if _WEIGHTS in name and not of.identifiable]
    if len(weights) > _MOST_WEIGHTS:
        shown = {name: parameter for name, parameter in shown.items() if name not in weights}
        near = "the described values, within the usual error of a description"
        if (origin := case.weights_from) in ASSUMED:
            near = f"those assumed from {ASSUMED[origin]}, as nobody stated them"
        yield Paragraph(
            f"Weights: {len(weights)} departures of masses, of their moments and of the "
            f"base's level stay near {near}. The fitted poses do not identify them."
        )
    remaining = dict(shown)
    for title, beginnings in _GROUPS:
        names = [name for name in remaining if name.startswith(beginnings)]
        yield grid(
            title,
            "parameter | value, 95 % interval | unit | tolerance | remark",
            [_parameter_row(name, remaining.pop(name)) for name in names],
        )
    if isinstance(case, GeneralCalibrationRecord):
        yield folded(_redundant_grid(case))
        if case.group is not None:
            yield from _campaign_grids(case.group)
    with_effects = results.analysis is not None and bool(results.analysis.effects)
    yield folded(_shifts_grid(case, shown if with_effects else {}))


def _redundant_grid(case: GeneralCalibrationRecord) -> Grid:
    """Return a table of the redundant parameters, and of those that stand for each."""
    rows = []
    for entry in case.redundant:
        parts = [
            f"{factor:.4g} × {formatting.display_name(name)}"
            for name, factor in entry.replaced_by.items()
        ]
        same = " + ".join(parts).replace("+ -", "− ")
        rows.append((formatting.display_name(entry.name), same or "nothing: it has no effect"))
    return grid("Omitted: redundant parameters", "omitted | the same as", rows)


def _shifts_grid(case: CalibrationRecord, with_effects: Mapping[str, Parameter]) -> Grid:
    """Return a table of the parameters that effects have shifted, by most uncertainties first."""
    shifts = []
    for name, after in with_effects.items():
        before_value = _value_without_effects(case, name)
        if before_value is None or not (after.identifiable and after.std):
            continue
        shift = _shift_in_stds(name, before_value, after, after.std)
        if abs(shift) < _SHIFTED:
            continue
        unit, scale = formatting.shown_in(after.unit, after.value)
        value, std = scale * after.value, scale * after.std
        shown_before = formatting.as_precisely(scale * before_value, value, std)
        if name in case.parameters and _is_rigid(name, case.parameters[name]):
            shown_before = _RIGID
        shown = formatting.parameter_with_interval(name, value, std)
        row = (formatting.display_name(name), shown_before, shown, unit, f"{shift:+.1f}")
        shifts.append((abs(shift), row))
    shifts.sort(key=lambda shift: -shift[0])
    return grid(
        "Parameters that the effects shifted by a standard uncertainty or more",
        "parameter | without the effects | with them, 95 % interval | unit | "
        "shift, in standard uncertainties",
        [row for _, row in shifts],
    )


def _value_without_effects(case: CalibrationRecord, name: str) -> float | None:
    """Return the calibrated value of a parameter; None where it was not determined."""
    if name in case.parameters:
        before = case.parameters[name]
        return before.value if before.identifiable else None
    return 0.0 if name.startswith(_ZERO_WITHOUT_SEARCH) else None


def _shift_in_stds(name: str, before: float, after: Parameter, std: float) -> float:
    """Return by how many standard uncertainties of its new value a parameter moved."""
    shift = after.value - before
    if after.unit == "rad":
        shift = math.remainder(shift, 2.0 * math.pi)
    if name.startswith("K_lin") and before:
        # Of a stiffness by its compliance 1 / K, of which the standard uncertainty is std / K^2.
        shift *= after.value / before
    return shift / std


def _parameter_row(name: str, parameter: Parameter) -> tuple[str, ...]:
    unit, scale = formatting.shown_in(parameter.unit, parameter.value)
    tolerance, std = formatting.NOT_KNOWN, None
    if parameter.tolerance is not None:
        tolerance = f"{scale * parameter.tolerance:g}"
    if parameter.std is not None:
        std = scale * parameter.std
    value, remark = formatting.parameter_with_interval(name, scale * parameter.value, std), ""
    if not parameter.identifiable:
        value, remark = formatting.NOT_KNOWN, "not identifiable from these poses"
    elif isinstance(parameter, CalibratedParameter) and parameter.at_bound:
        value = _RIGID if _is_rigid(name, parameter) else f"{scale * parameter.value:.4g}"
        remark = "at the end of its physical range"
    elif parameter.std == 0.0:
        remark = "not fitted"
    elif parameter.tolerance and abs(parameter.value) > 3.0 * parameter.tolerance:
        remark = f"{abs(parameter.value) / parameter.tolerance:.0f} tolerances"
    return formatting.display_name(name), value, unit, tolerance, remark


def _is_rigid(name: str, parameter: Parameter) -> bool:
    """Return whether a parameter is the stiffness of a joint that does not yield."""
    at_bound = isinstance(parameter, CalibratedParameter) and parameter.at_bound
    return at_bound and name.startswith("K_lin")


def _campaign_grids(group: GroupOfCampaigns) -> Iterator[Grid]:
    """Yield where every shared parameter comes from, and each campaign against the others.

    Parameters of springs are those solved: how far a joint yields, not its stiffness.
    """
    yield _stds_grid(group)
    yield grid(
        "Each campaign against the others: they contradict each other where chance does not "
        "explain the difference and separate parameters remove a tenth of the squared error",
        "campaign | poses | rms [mm] | alone [mm] | χ² | p | most by | contradicts",
        [_against_others_row(name, campaign) for name, campaign in group.campaigns.items()],
    )


def _stds_grid(group: GroupOfCampaigns) -> Grid:
    rows: list[tuple[str | None, ...]] = []
    for name, parameter in group.parameters.items():
        unit, scale = formatting.shown_in(parameter.unit)
        alone = (
            f"{scale * parameter.std_alone[campaign]:.4f}"
            if campaign in parameter.determined_by
            else None
            for campaign in group.campaigns
        )
        by = ", ".join(parameter.determined_by) or "all together"
        std = f"{scale * parameter.std:.4f}"
        rows.append((formatting.display_solved(name), unit, std, *alone, by))
    stds = (f"std {campaign}" for campaign in group.campaigns)
    return grid(
        "Standard uncertainty of shared parameters, by all campaigns and by each alone",
        ("parameter", "unit", "std", *stds, "determined by"),
        rows,
    )


def _against_others_row(name: str, campaign: CampaignAlone) -> tuple[str | float, ...]:
    worst = campaign.worst
    unit, scale = formatting.shown_in(worst.unit)
    difference = f"{scale * worst.value:.3g} ± {scale * worst.std:.2g} {unit}"
    return (
        *(name, campaign.poses, campaign.rms_mm, campaign.alone_rms_mm),
        f"{campaign.chi_square:.1f} for {campaign.dof:.0f}",
        f"{campaign.p_value:.2g}",
        f"{formatting.display_solved(worst.name)}: {difference}",
        campaign.contradicts,
    )
