"""Position and orientation error of predicted poses, as the paper states them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.inner import fit_base_frame
from pa10cal.calibration.pose_error import angle_rad, pose_error
from pa10cal.campaign.observations import PoseObservations
from pa10cal.results.accuracy import Accuracy as Accuracy
from pa10cal.terms.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Deviations:
    """Predicted minus measured, configuration by configuration.

    Attributes:
        position_mm: (P, 3) along the base axes.
        rotation_deg: (P, 3) axis times angle, along the base axes.
    """

    position_mm: Array
    rotation_deg: Array

    @property
    def distance_mm(self) -> Array:
        """Return the position errors (P,)."""
        distance: Array = np.linalg.norm(self.position_mm, axis=1)
        return distance

    @property
    def angle_deg(self) -> Array:
        """Return the orientation errors (P,)."""
        angle: Array = np.linalg.norm(self.rotation_deg, axis=1)
        return angle


def deviations(T_base_ee: Array, T_instr_base: Array, observations: PoseObservations) -> Deviations:
    """Compare predicted with measured poses."""
    error = pose_error(T_instr_base @ T_base_ee, observations.T_instr_ee)
    angle = angle_rad(error)
    chord = 2.0 * np.sin(angle / 2.0)
    stretch = np.divide(angle, chord, out=np.ones_like(angle), where=chord > 0)
    to_base = T_instr_base[:3, :3]
    return Deviations(
        1e3 * error.position_m @ to_base,
        np.degrees(error.chord * stretch[:, None]) @ to_base,
    )


def summarise(found: Deviations, rows: NDArray[np.bool_] | slice = slice(None)) -> Accuracy:
    """Summarise deviations over some rows."""
    distance = found.distance_mm[rows]
    return Accuracy(
        mean_mm=float(distance.mean()),
        peak_mm=float(distance.max()),
        rms_mm=float(np.sqrt(np.mean(distance**2))),
        orientation_deg=float(found.angle_deg[rows].mean()),
        configurations=len(distance),
    )


def summarise_by_load(found: Deviations, load_N: Array) -> dict[float, Accuracy]:
    """Summarise deviations for every load."""
    return {float(load): summarise(found, load_N == load) for load in np.unique(load_N)}


def align_nominal(nominal: Model, observations: PoseObservations) -> Array:
    """Return T_instr_base (4, 4) that aligns the nominal model on the least loaded positions.

    This is the alignment behind the paper's errors before calibration: positions only, once, on
    the poses with the smallest load, which the paper's campaign measured unloaded.
    """
    load_N = observations.states.load_N
    least = observations.take(load_N == load_N.min())
    return fit_base_frame(
        nominal.predict(least.states, np.zeros(0)), least.T_instr_ee, attitude_weight_m2=0.0
    ).T_instr_base
