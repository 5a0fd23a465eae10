"""The record of a calibration with effects: that without them, its fit replaced."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from pa10cal.calibration.accuracy import summarise_by_load
from pa10cal.calibration.base_parameters import report_base
from pa10cal.calibration.health_record import health_part
from pa10cal.calibration.records import by_load, fitted_to, reported_keys
from pa10cal.discovery.given import CalibratedWith
from pa10cal.fit.model_file import model_to_plain
from pa10cal.results.accuracy import ResidualRows
from pa10cal.results.calibration import CalibratedParameter, CalibrationRecord, Covariance
from pa10cal.results.record import Campaign
from pa10cal.terms.effects.effect import Effect

R = TypeVar("R", bound=CalibrationRecord)


def with_effects(record: R, found: CalibratedWith, campaign: Campaign) -> R:
    """Return the record of a calibration whose last fit is that with effects.

    Args:
        record: of the same load case without them.
        found: the calibration with them.
        campaign: whose it is.
    """
    about = fitted_to(found.poses, record.load, found.health, campaign)
    model = replace(found.model, fitted_to=about)
    load_N = found.poses.states.load_N
    after = by_load(summarise_by_load(found.found, load_N))
    converged = "converged" if found.converged else "not converged"
    return record.model_copy(
        update={
            "status": converged,
            "reason": found.health.ended.reason,
            "parameters": _parameters(found),
            "covariance": Covariance(
                names=(*(p.name for p in model.model.parameters), *_BASE),
                matrix=model.covariance,
            ),
            "T_instr_base": model.T_instr_base,
            "fitted_model": model_to_plain(model),
            "rank": found.health.ended.identifiability.rank,
            "unknowns": len(found.health.ended.parameters),
            "condition": found.health.ended.identifiability.condition,
            "singular_values": found.health.ended.identifiability.singular_values,
            "errors": {
                load: errors.model_copy(update={"after": after[load]}) if load in after else errors
                for load, errors in record.errors.items()
            },
            "residuals": ResidualRows(
                pose=found.poses.pose,
                load_N=load_N,
                place_mm=1e3 * model.model.predict(found.poses.states, model.x)[:, :3, 3],
                position_mm=found.found.position_mm,
                rotation_deg=found.found.rotation_deg,
            ),
            "health": health_part(found.health, found.cells),
            "warnings": () if found.health.grade == "good" else (found.health.line,),
        }
    )


_BASE = ("base_x", "base_y", "base_z", "base_rx", "base_ry", "base_rz")


def _parameters(found: CalibratedWith) -> dict[str, CalibratedParameter]:
    """Return every parameter with value, standard uncertainty and unit, effects by their place."""
    model, openly = found.model, found.health.ended.not_identifiable
    assert model.covariance is not None
    parameters = {}
    for term in model.model.terms:
        columns = model.model.columns_of(term)
        report = term.report(model.x[columns])
        solved = {parameter.name for parameter in term.parameters}
        place = f"{term.id}_{term.of.removeprefix('joint ')}_" if isinstance(term, Effect) else ""
        touched = report.jacobian != 0.0
        names = [parameter.name for parameter in term.parameters]
        for row, (name, keys) in zip(
            touched, reported_keys(report, model.covariance[columns, columns]).items(), strict=True
        ):
            held = {names[k] for k in np.flatnonzero(row)} & openly & solved
            parameters[f"{place}{name}"] = CalibratedParameter(
                **keys, identifiable=not held, at_bound=False
            )
    base = reported_keys(report_base(model.T_instr_base), model.covariance[-6:, -6:])
    return parameters | {
        name: CalibratedParameter(**keys, identifiable=True, at_bound=False)
        for name, keys in base.items()
    }
