"""The model with its named effects, built again from the record of discovery."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.discovery.operating_point import OperatingPoint
from pa10cal.errors import RecordError
from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.results import discovery
from pa10cal.results.discovery import ExtendedKeys, MapForm
from pa10cal.terms.effects.effect import CandidateContext, Effect
from pa10cal.terms.effects.family import candidates
from pa10cal.terms.effects.joint_error_map import Fading, JointErrorMap
from pa10cal.terms.model import Model

Array = NDArray[np.float64]


def read_extended(
    record: ExtendedKeys, baseline_model: Model, path: Path
) -> tuple[OperatingPoint, Model, Array, Array]:
    """Return the baseline, and the extended model, its parameters and T_instr_base.

    Args:
        record: what `discovery/extended.json` holds.
        baseline_model: chain and terms of the calibrated model.
        path: where it was read from, for the message.

    Raises:
        RecordError: when an effect is not in the vocabulary, or a key is of wrong size.
    """
    context = _context(record.context, baseline_model.chain.arm)
    known = {(effect.id, effect.of): effect for effect in candidates(context)}
    try:
        effects = [_in_form(known[each.id, each.of], each.form) for each in record.effects]
    except KeyError as error:
        raise _unusable(path, f"effect {error}") from None
    model = Model(baseline_model.chain, (*baseline_model.terms, *effects))
    x = np.concatenate([record.x, *(each.x for each in record.effects)])
    own = len(baseline_model.parameters)
    if len(x) != len(model.parameters) or not len(record.x) == len(record.baseline.x) == own:
        raise _unusable(path, f"{len(x)} values of {len(model.parameters)} parameters")
    baseline = OperatingPoint(baseline_model, record.baseline.x, record.baseline.T_instr_base)
    return baseline, model, x, record.T_instr_base


def read_targets_off(record: ExtendedKeys, coordinates: int, path: Path) -> Array:
    """Return found minus stated places of the targets, of so many coordinates [m].

    Raises:
        RecordError: when they are not so many.
    """
    if len(record.targets_off_m) != coordinates:
        raise _unusable(path, f"targets_off_m of {len(record.targets_off_m)} coordinates")
    return record.targets_off_m


def read_angles(record: ExtendedKeys) -> AnglesSeen | None:
    """Return the angles that a model's poses have seen; None where the record has none."""
    if record.angles_seen is None:
        return None
    return AnglesSeen(
        tuple(joint.stretches for joint in record.angles_seen),
        tuple(joint.turns for joint in record.angles_seen),
    )


def _in_form(effect: Effect, form: MapForm | None) -> Effect:
    """Return an effect in its own form."""
    if form is None or not isinstance(effect, JointErrorMap):
        return effect
    fading = Fading(form.fading.size_rad, form.fading.half_order)
    return replace(effect, knots=form.knots, fading=fading)


def _context(found: discovery.CandidateContext, arm: Arm) -> CandidateContext:
    return CandidateContext(
        arm=arm,
        flexible_joints=found.flexible_joints,
        reference_temperature_C=found.reference_temperature_C,
        tau_span_Nm=found.tau_span_Nm,
        T_instr_base=found.T_instr_base,
        p_instr_middle_m=found.p_instr_middle_m,
        q_span_rad=found.q_span_rad,
        time_span_s=found.time_span_s,
    )


def _unusable(path: Path, value: str) -> RecordError:
    return RecordError(
        "the extended model cannot be restored",
        where=str(path),
        value=value,
        allowed="effects of the vocabulary with their parameters",
        remedy="run pa10cal discover again",
    )
