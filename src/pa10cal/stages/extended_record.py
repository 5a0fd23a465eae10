"""The model with its named effects as JSON, written and read back."""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.calibration.base_parameters import report_base
from pa10cal.discovery.discover import Discovery
from pa10cal.discovery.evidence.fit import Fit, apparatus_m, covariance_of
from pa10cal.discovery.operating_point import OperatingPoint, possible_sizes
from pa10cal.errors import RecordError
from pa10cal.stages.records import read_pose_matrix, read_vector
from pa10cal.terms.effects.effect import CandidateContext, Effect
from pa10cal.terms.effects.family import candidates
from pa10cal.terms.effects.joint_error_map import Fading, JointErrorMap
from pa10cal.terms.model import Model
from pa10cal.terms.term import Report

Array = NDArray[np.float64]

#: A parameter known no better than this part of what is possible is not told by the data.
_TOLD = 1.0 / 3.0


def extended_record(found: Discovery) -> dict[str, Any]:
    """Return the extended model: parameters with uncertainties, effects, and what restores it."""
    extended = found.extended
    return {
        "effects": [
            {"id": effect.id, "of": effect.of, "x": extended.of(effect).tolist()}
            for effect in extended.effects
        ],
        "parameters": parameter_records(found, extended),
        "x": extended.x[extended.own_columns()][:-6].tolist(),
        "T_instr_base": base_of(extended).tolist(),
        "targets_off_m": apparatus_m(found.problem, extended).tolist(),
        "baseline": {
            "x": found.problem.baseline.x.tolist(),
            "T_instr_base": found.problem.baseline.T_instr_base.tolist(),
        },
        "context": surroundings_record(found.problem.context),
    }


def read_extended(
    record: dict[str, Any], baseline_model: Model, path: Path
) -> tuple[OperatingPoint, Model, Array, Array]:
    """Return the baseline, and the extended model, its parameters and T_instr_base.

    Args:
        record: what `extended_record` wrote.
        baseline_model: chain and terms of the calibrated model.
        path: where it was read from, for the message.

    Raises:
        RecordError: when an effect is not in the vocabulary, or a key is missing or of wrong size.
    """
    arm = baseline_model.chain.arm
    try:
        around = _surroundings(record["context"], arm)
        known = {(effect.id, effect.of): effect for effect in candidates(around)}
        effects = [_in_form(known[e["id"], e["of"]], e.get("form")) for e in record["effects"]]
        amounts = [
            read_vector(entry, "x", len(effect.parameters), path)
            for effect, entry in zip(effects, record["effects"], strict=True)
        ]
        own = len(baseline_model.parameters)
        x = np.concatenate([read_vector(record, "x", own, path), *amounts])
        baseline_x = read_vector(record["baseline"], "x", own, path)
    except (KeyError, TypeError, ValueError) as error:
        raise RecordError(
            "the extended model cannot be restored",
            where=str(path),
            value=str(error),
            allowed="effects of the vocabulary with their parameters",
            remedy="run the discover stage again",
        ) from None
    model = Model(baseline_model.chain, (*baseline_model.terms, *effects))
    baseline = OperatingPoint(
        baseline_model, baseline_x, read_pose_matrix(record["baseline"], "T_instr_base", path)
    )
    return baseline, model, x, read_pose_matrix(record, "T_instr_base", path)


def form_record(effect: Effect) -> dict[str, Any] | None:
    """Return spacing and smoothness of a map that has its own; None for every other effect."""
    if not isinstance(effect, JointErrorMap) or effect.fading is None:
        return None
    return {"knots": effect.knots, "fading": asdict(effect.fading)}


def _in_form(effect: Effect, form: dict[str, Any] | None) -> Effect:
    """Return an effect in the form that `form_record` wrote."""
    if form is None or not isinstance(effect, JointErrorMap):
        return effect
    return replace(effect, knots=int(form["knots"]), fading=Fading(**form["fading"]))


def base_of(found: Fit) -> Array:
    """Return T_instr_base (4, 4) with the fit's own small motions of the base."""
    moved = np.eye(4)
    moved[:3, 3] = found.x[-6:-3]
    moved[:3, :3] = Rotation.from_euler("XYZ", found.x[-3:]).as_matrix()
    T: Array = found.level.T_instr_base @ moved
    return T


def parameter_records(found: Discovery, extended: Fit) -> dict[str, dict[str, Any]]:
    """Return every parameter of the model in a fit, its effects aside, and the base frame."""
    covariance = covariance_of(found.problem, extended)
    own = extended.own_columns()[:-6]
    model = found.problem.baseline.model
    report = model.report(extended.x[own])
    told = np.sqrt(np.diag(covariance))[own] < _TOLD * possible_sizes(model)
    touched = report.jacobian != 0.0
    records = records_of(report, covariance[np.ix_(own, own)])
    for name, row in zip(records, touched, strict=True):
        records[name]["identifiable"] = bool(np.all(told[row]))
    base = records_of(report_base(base_of(extended)), covariance[-6:, -6:])
    for record in base.values():
        record["identifiable"] = True
    return records | base


def records_of(report: Report, covariance: Array) -> dict[str, dict[str, Any]]:
    """Return reported parameters with the uncertainty that a covariance of those solved gives."""
    std = np.sqrt(np.diag(report.jacobian @ covariance @ report.jacobian.T))
    return {
        parameter.name: {
            "value": float(value),
            "std": float(sigma),
            "unit": parameter.unit,
            "tolerance": parameter.tolerance,
        }
        for parameter, value, sigma in zip(report.parameters, report.values, std, strict=True)
    }


def surroundings_record(context: CandidateContext) -> dict[str, Any]:
    """Return what decides where effects may sit, but for the arm."""
    return {
        field.name: _plain(getattr(context, field.name))
        for field in fields(CandidateContext)
        if field.name != "arm"
    }


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [None if not np.all(np.isfinite(entry)) else entry for entry in value.tolist()]
    return list(value) if isinstance(value, tuple) else value


def _surroundings(record: dict[str, Any], arm: Arm) -> CandidateContext:
    def array(name: str) -> Array:
        return np.array([np.nan if entry is None else entry for entry in record[name]], dtype=float)

    first, last = record["time_span_s"]
    return CandidateContext(
        arm=arm,
        flexible_joints=tuple(record["flexible_joints"]),
        reference_temperature_C=float(record["reference_temperature_C"]),
        tau_span_Nm=array("tau_span_Nm"),
        T_instr_base=array("T_instr_base"),
        p_instr_middle_m=array("p_instr_middle_m"),
        q_span_rad=array("q_span_rad"),
        time_span_s=(float(first), float(last)),
    )
