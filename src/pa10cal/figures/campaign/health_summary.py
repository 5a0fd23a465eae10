"""The health of the calibrations of all loads: what to look at before one is trusted."""

from __future__ import annotations

from collections.abc import Iterator

from pa10cal.figures.parameter_names import listed, written
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import MODELS, Results
from pa10cal.figures.table import Row, Shown, Table, frame_of, shown
from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
from pa10cal.results.health import Health

PICTURE = Picture(
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

_HEADER = ("model", "quantity", "of", "value", "unit")
_UNKNOWN = "–"
#: So many poses in D-optimal order are shown; the CSV has all that were ordered.
_MOST_SHOWN = 30


def tabulate(results: Results) -> Table:
    """Return termination, rank, errors and expected uncertainty, and how many poses are needed."""
    cases = results.calibrations()
    models = [MODELS[case.model] for case in cases]
    columns = [_said(case) for case in cases]
    rows = [
        (quantity, *(column.get(quantity, _UNKNOWN) for column in columns))
        for quantity in dict.fromkeys(name for column in columns for name in column)
    ]
    return Table(
        title="Health of the calibration",
        data=frame_of(_HEADER, [row for case in cases for row in _data_rows(case)]),
        shown=(
            shown(("all loads together", *models), rows),
            _pairs([case.health for case in cases], models),
            *(_order(case.health, model) for case, model in zip(cases, models, strict=True)),
        ),
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


def _said(case: CalibrationRecord) -> dict[str, str]:
    """Return quantities and how they are written."""
    health = case.health
    poses = health.poses
    needed = f"more than {len(poses.d_optimal_order)}" if poses.needed is None else poses.needed
    found = {
        "grade": f"{health.grade}: {health.line}",
        "termination": health.ending,
        "rank": f"{health.rank} of {health.unknowns} unknowns",
        "condition number": f"{health.condition:.4g}",
        "at a bound": listed(health.at_bounds),
        "not identifiable from these poses": listed(health.not_identifiable),
        "error of the fitted poses, rms [mm]": _number(health.train_rms_mm),
        "error of the held-out poses, rms [mm]": _number(health.held_out_rms_mm),
        f"error that the {case.noise_is} explains, rms [mm]": _number(health.noise_mm),
        "expected uncertainty of a prediction [mm]": _number(poses.u_model_mm),
        "needed uncertainty [mm]": _number(poses.u_needed_mm),
        "poses measured": str(poses.measured),
        "well-chosen poses that suffice": str(needed),
    }
    if isinstance(case, GeneralCalibrationRecord):
        for of, scatter in case.scatter.items():
            unit = "mrad" if of.startswith("attitude") else "mm"
            found[f"scatter beyond the stated uncertainty, {of} [{unit}]"] = _number(1e3 * scatter)
    return found


def _pairs(healths: list[Health], models: list[str]) -> Shown:
    rows = [
        (model, *map(written, pair.parameters), f"{pair.correlation:+.4f}")
        for health, model in zip(healths, models, strict=True)
        for pair in health.correlated_pairs
    ]
    header = ("model", "parameter", "and", "correlation")
    return shown(header, rows, "Strongly correlated parameters")


def _order(health: Health, model: str) -> Shown:
    """Return the uncertainty by number of poses, and which pose comes next."""
    poses = health.poses
    rows = [
        (
            str(expected.poses),
            _number(expected.u_optimal_mm),
            _number(expected.u_measured_mm),
            poses.d_optimal_order[expected.poses - 1],
        )
        for expected in poses.expected[:_MOST_SHOWN]
    ]
    header = ("poses", "D-optimal order [mm]", "order measured [mm]", "last pose of the former")
    return shown(header, rows, f"Expected uncertainty by number of poses, {model}")


def _data_rows(case: CalibrationRecord) -> Iterator[Row]:
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


def _number(value: float | None) -> str:
    return _UNKNOWN if value is None else f"{value:.4f}"


def _plain(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
