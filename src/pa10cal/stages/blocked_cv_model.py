"""The extended model of a general calibration, read back and given what it needs to predict."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arm.state import PoseStates
from pa10cal.calibration.general.case import FittedModel
from pa10cal.discovery.operating_point import OperatingPoint
from pa10cal.discovery.preparation import MeasurementSetup, complete_about
from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.observe.averages import measured_as_poses
from pa10cal.observe.observations import Observations
from pa10cal.results.calibration import GeneralCalibrationRecord
from pa10cal.results.codec import read
from pa10cal.results.discovery import ExtendedRecord
from pa10cal.stages.extended_record import read_angles, read_extended
from pa10cal.stages.general_record import read_general
from pa10cal.stages.measurement_setup import with_bends


@dataclass(frozen=True, eq=False)
class ExtendedModel:
    """A general model with the effects that were missing.

    Attributes:
        fitted: the model, ready to predict.
        baseline: the calibrated model without them.
        seen: angles that the poses of its fit have seen; None where it was judged by repeats.
        arrival_from_order: whether directions of arrival are those of the order of poses.
    """

    fitted: FittedModel
    baseline: OperatingPoint
    seen: AnglesSeen | None
    arrival_from_order: bool

    def extrapolated(self, states: PoseStates) -> NDArray[np.bool_] | None:
        """Return which poses leave the angles seen, (P,); None where that is not known."""
        return None if self.seen is None else ~self.seen.inside(states.q_rad)

    def completed(self, observations: Observations, setup: MeasurementSetup) -> Observations:
        """Return observations whose states hold what the effects depend on.

        Args:
            observations: poses with torques, as springs need them.
            setup: what is known of their campaign besides the poses.
        """
        if not observations.measured.measures_pose:
            return observations
        poses = measured_as_poses(observations)
        about = OperatingPoint(self.fitted.model, self.fitted.x, self.fitted.T_instr_base)
        poses = complete_about(poses, self.baseline, about, setup)
        return observations.with_states(poses.states)


def extended_model(
    path: Path, calibration: GeneralCalibrationRecord, arm: Arm, calibration_path: Path
) -> ExtendedModel:
    """Read the extended model of a general calibration.

    Args:
        path: what discovery wrote.
        calibration: the calibration's record.
        arm: the nominal arm.
        calibration_path: where that was read from, for the message.

    Raises:
        RecordError: when it is of another campaign or cannot be restored.
    """
    record = read(ExtendedRecord, path, calibration.campaign)
    fitted = read_general(calibration, arm, calibration_path)
    baseline, model, x, T_instr_base = read_extended(record, with_bends(fitted.model), path)
    return ExtendedModel(
        fitted=FittedModel(model, x, T_instr_base, fitted.R_ee_target, fitted.places_m),
        baseline=baseline,
        seen=read_angles(record),
        arrival_from_order=record.arrival_from_order,
    )
