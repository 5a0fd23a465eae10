"""How two fitted models differ: parameter by parameter, and where they put the robot.

Parameters of a calibration go together: two good models may differ by many standard uncertainties
in some of them and put the robot in the same places. So models are judged by their predictions.
Where the base stands, and how the target sits on the flange, is of each campaign; what a constant
motion on either side of the arm explains is taken off before models are judged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.errors import ModelError
from pa10cal.evaluation.predictions_apart import compared_frame, shared_loads, shared_postures
from pa10cal.evaluation.what_moved import what_moved
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import FLANGE, TOOL_FRAME
from pa10cal.results.comparison import ComparedFrame, ComparedModel, ComparisonRecord, ParameterRows
from pa10cal.results.health import UNRESERVED

#: Models are said to differ where chance leaves so much in fewer than one of a hundred pairs.
LEAST_CHANCE = 0.01
#: Fields of an arm that make its layout; the others do not move a rigid arm.
_LAYOUT = ("prismatic", "theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
_FRAMES = ("T_base_row1", "T_row_n_ee")
_OTHERS = ("limits_rad", "gear_ratio", "torque_limit_Nm", "mass_kg", "com_m")
#: Nominal rows closer than this are the same [m, rad]: a file may have been written with 12 digits.
_SAME = 1e-9


def compare_models(
    first: FittedModel, second: FittedModel, names: tuple[str, str] = ("first", "second")
) -> ComparisonRecord:
    """Compare two models of arms of the same layout.

    Args:
        first, second: the models.
        names: what they are called in the record and in messages.

    Raises:
        ModelError: when the arms differ in layout, or a model with springs does not know the
            weights that load them.
    """
    _refuse_other_layout(first.arm, second.arm, names)
    q = shared_postures(first, second)
    loads_N = shared_loads(first, second)
    load_N = np.resize(loads_N, len(q))
    compared = (FLANGE, TOOL_FRAME) if len(q) else ()
    frames = {frame: compared_frame(first, second, frame, q, load_N) for frame in compared}
    agree, line = _judged(frames, (first, second), names)
    return ComparisonRecord(
        first=_about(first, second, names[0]),
        second=_about(second, first, names[1]),
        described_otherwise=_described_otherwise(first, second),
        parameters=_parameters(first, second),
        postures=len(q),
        loads_N=loads_N,
        frames=frames,
        agree=agree,
        line=line,
        what_moved=what_moved(first, second),
    )


def _refuse_other_layout(one: Arm, other: Arm, names: tuple[str, str]) -> None:
    """Refuse arms whose nominal chains differ."""
    differs = [
        f"{name}: {mine!r} and {theirs!r}"
        for name, mine, theirs in (
            ("joints", one.n, other.n),
            ("convention", one.convention, other.convention),
        )
        if mine != theirs
    ]
    if not differs:
        for name in _LAYOUT:
            mine, theirs = (np.asarray(getattr(arm, name), dtype=float) for arm in (one, other))
            differs += [
                f"{name} of row {row + 1}: {mine[row]:g} and {theirs[row]:g}"
                for row in np.flatnonzero(~(np.abs(mine - theirs) <= _SAME))
            ]
        differs += [
            name
            for name in _FRAMES
            if not np.allclose(getattr(one, name), getattr(other, name), rtol=0, atol=_SAME)
        ]
    if differs:
        more = f", and {len(differs) - 3} more" if len(differs) > 3 else ""
        raise ModelError(
            "models of arms of different layouts are not compared",
            where=f"{names[0]} ({one.name}), {names[1]} ({other.name})",
            value="; ".join(differs[:3]) + more,
            allowed="two models of the same arm",
            remedy="give two models whose nominal rows are the same",
        )


def _described_otherwise(first: FittedModel, second: FittedModel) -> tuple[str, ...]:
    """Return what two descriptions say differently beside the layout."""
    pairs: list[tuple[str, object, object]] = [
        (name, getattr(first.arm, name), getattr(second.arm, name)) for name in _OTHERS
    ]
    if first.payload is None or second.payload is None:
        pairs.append(("payload", first.payload, second.payload))
    else:
        pairs += [
            (f"payload.{f.name}", getattr(first.payload, f.name), getattr(second.payload, f.name))
            for f in fields(Payload)
        ]
    return tuple(name for name, mine, theirs in pairs if not _same(mine, theirs))


def _same(mine: object, theirs: object) -> bool:
    if mine is None or theirs is None:
        return mine is theirs
    one, other = np.asarray(mine, dtype=float), np.asarray(theirs, dtype=float)
    return np.allclose(one, other, rtol=_SAME, atol=_SAME, equal_nan=True)


def _about(model: FittedModel, other: FittedModel, name: str) -> ComparedModel:
    fitted = model.fitted_to
    theirs = {(term.id, term.of) for term in other.model.terms}
    return ComparedModel(
        name=name,
        robot=model.arm.name,
        campaign=fitted.campaign if fitted else None,
        calibration=fitted.calibration if fitted else None,
        grade=model.grade or None,
        health=(fitted.health or None) if fitted else None,
        covariance=model.covariance is not None,
        only_here=tuple(
            f"{term.id} of {term.of}"
            for term in model.model.terms
            if (term.id, term.of) not in theirs
        ),
    )


#: A parameter as both models have it: value, standard uncertainty, and its typical size.
_Values = Mapping[tuple[str, str, str, str], tuple[float, float, float]]


def _parameters(first: FittedModel, second: FittedModel) -> ParameterRows:
    """Return every parameter of two models, in the order of the first."""
    mine, theirs = _values(first), _values(second)
    keys = [*mine, *(key for key in theirs if key not in mine)]
    unknown = (np.nan, np.nan, np.nan)
    one = np.array([mine.get(key, unknown) for key in keys]).reshape(-1, 3)
    other = np.array([theirs.get(key, unknown) for key in keys]).reshape(-1, 3)
    difference, u = other[:, 0] - one[:, 0], np.hypot(one[:, 1], other[:, 1])
    if not np.allclose(first.R_ee_target, second.R_ee_target, rtol=0, atol=_SAME):
        # Each counts from the attitude that its own fit began with; the frames show the whole.
        difference[[unit == "rad" and of == "tool" for _, of, _, unit in keys]] = np.nan
    # A parameter that no pose determines stays where it began, and one at the end of its range
    # there: their uncertainties are rounding.
    determined = np.all(
        [each[:, 1] > _SAME * np.maximum(each[:, 2], np.abs(each[:, 0])) for each in (one, other)],
        axis=0,
    )
    over_u = np.divide(difference, u, out=np.full(len(u), np.nan), where=determined)
    term, of, parameter, unit = np.array(keys, dtype=str).reshape(-1, 4).T
    return ParameterRows(
        term=term,
        of=of,
        parameter=parameter,
        unit=unit,
        first=one[:, 0],
        first_std=one[:, 1],
        second=other[:, 0],
        second_std=other[:, 1],
        difference=difference,
        over_u=over_u,
    )


def _values(model: FittedModel) -> _Values:
    found = {}
    for term in model.model.terms:
        report, std = model.reported(term)
        for parameter, value, sigma in zip(report.parameters, report.values, std, strict=True):
            key = term.id, term.of, parameter.name, parameter.unit
            found[key] = float(value), float(sigma), abs(parameter.scale)
    return found


def _judged(
    frames: Mapping[str, ComparedFrame],
    models: tuple[FittedModel, FittedModel],
    names: tuple[str, str],
) -> tuple[bool | None, str]:
    """Return whether two models agree, and the sentence that says so."""
    if not frames:
        return None, (
            "whether the models agree cannot be judged: there is a joint of which they have seen "
            "no common angles"
        )
    flange = frames[FLANGE]
    apart = (
        f"their flanges differ by {flange.remaining_rms_mm:.3f} mm rms "
        f"({flange.remaining_peak_mm:.3f} mm at most) and {flange.remaining_deg:.4f} deg, base and "
        "tool taken off"
    )
    if flange.chance is None:
        without = [name for name, m in zip(names, models, strict=True) if m.covariance is None]
        return None, (
            "whether the models agree cannot be judged: the covariance is missing of "
            f"{' and of '.join(without)}; {apart}"
        )
    agree = flange.chance >= LEAST_CHANCE
    verdict = (
        "the models agree within their uncertainty"
        if agree
        else "the models differ by more than their uncertainty"
    )
    doubtful = [
        f"{name} is graded {m.grade}"
        for name, m in zip(names, models, strict=True)
        if m.grade and m.grade not in UNRESERVED
    ]
    but = f"; mind that {' and '.join(doubtful)}" if doubtful else ""
    return agree, (
        f"{verdict}: {apart}, where {flange.expected_mm:.3f} mm and {flange.expected_deg:.4f} deg "
        f"are expected{but}"
    )
