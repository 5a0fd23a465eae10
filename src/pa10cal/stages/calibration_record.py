"""Models built again from the record of a calibration, and options from the settings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arm.tolerances import Tolerances
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.errors import RecordError
from pa10cal.results.calibration import (
    CalibrationRecord,
    GeneralCalibrationRecord,
    PaperCalibrationRecord,
)
from pa10cal.settings_reading import parse_section
from pa10cal.stages.general_record import read_general
from pa10cal.terms.baseline import baseline, solved_parameters
from pa10cal.terms.model import Model

Array = NDArray[np.float64]


def read_fit(
    record: CalibrationRecord, arm: Arm, path: Path, *, cubic: bool
) -> tuple[Model, Array, Array]:
    """Return model, parameters (k,) and T_instr_base (4, 4) of a calibration record.

    Args:
        record: what `calibration/<load>.json` holds.
        arm: the nominal arm.
        path: where it was read from, for the message.
        cubic: the fit with cubic springs, else the linear one; the general model has one.

    Raises:
        RecordError: when it lacks a parameter or was written with other settings.
    """
    if isinstance(record, GeneralCalibrationRecord):
        found = read_general(record, arm, path)
        return found.model, found.x, found.T_instr_base
    assert isinstance(record, PaperCalibrationRecord)
    settings = settings_of(record, path)
    fit = record if cubic else record.linear
    model = baseline(arm, settings.flexible_joints, settings.tolerances, cubic=cubic)
    try:
        reported = {name: parameter.value for name, parameter in fit.parameters.items()}
        x = solved_parameters(model, reported)
    except (KeyError, ValueError) as error:
        raise RecordError(
            "the record lacks a parameter of its model",
            where=str(path),
            value=str(error),
            allowed="every parameter with a value",
            remedy="run pa10cal calibrate again",
        ) from None
    return model, x, fit.T_instr_base


def settings_of(record: CalibrationRecord, path: Path) -> CalibrationOptions:
    """Return the settings that a calibration was worked out with.

    Raises:
        SettingsError: when they are none.
    """
    return parse_section(CalibrationOptions, record.settings, where=str(path))


def _tolerances(settings: CalibrationOptions) -> Tolerances:
    """Return the tolerances of the settings."""
    return settings.tolerances
