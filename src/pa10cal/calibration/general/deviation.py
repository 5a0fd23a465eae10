"""How far predictions are from what was seen, configuration by configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.accuracy import Accuracy
from pa10cal.calibration.general.instrument import Seen, compare
from pa10cal.campaign.seen import SeenDistances, SeenPoses

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SeenDeviations:
    """Predicted minus seen in P configurations.

    Attributes:
        distance_mm: (P,) of the target; root mean square over the targets seen; the error of the
            distance itself where a distance was measured.
        vector_mm: (P, 3) mean over the targets, along base axes; along the line of sight where a
            distance was measured.
        rotation_deg: (P, 3) axis times angle along base axes, or None where no attitude was seen.
    """

    distance_mm: Array
    vector_mm: Array
    rotation_deg: Array | None

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> SeenDeviations:
        """Return some of the configurations."""
        turned = None if self.rotation_deg is None else self.rotation_deg[rows]
        return SeenDeviations(self.distance_mm[rows], self.vector_mm[rows], turned)


def deviations_seen(
    T_base_ee: Array, T_instr_base: Array, places_m: Array, seen: Seen
) -> SeenDeviations:
    """Compare predictions with what was seen.

    Args:
        T_base_ee: (P, 4, 4) predicted end of the chain in the base frame [m].
        T_instr_base: (4, 4) base frame.
        places_m: (t,) places of the targets in the end-effector frame.
        seen: what was seen, an attitude turned to that of the end-effector.
    """
    T_instr_ee = T_instr_base @ T_base_ee
    residual = compare(T_instr_ee, places_m, seen).residual
    R = T_instr_base[:3, :3]
    if isinstance(seen, SeenPoses):
        position_mm = 1e3 * residual[:, :3]
        chord = np.linalg.norm(residual[:, 3:], axis=1)
        angle = 2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))
        stretch = np.divide(angle, chord, out=np.ones_like(angle), where=chord > 0)
        return SeenDeviations(
            np.linalg.norm(position_mm, axis=1),
            position_mm @ R,
            np.degrees(residual[:, 3:] * stretch[:, None]) @ R,
        )
    if isinstance(seen, SeenDistances):
        p_instr_m = T_instr_ee[:, :3, 3] + T_instr_ee[:, :3, :3] @ places_m
        along = p_instr_m / np.linalg.norm(p_instr_m, axis=1)[:, None]
        return SeenDeviations(1e3 * np.abs(residual[:, 0]), 1e3 * (residual * along) @ R, None)
    each_mm = 1e3 * residual.reshape(len(residual), -1, 3)
    times = np.isfinite(seen.p_instr_m[..., 0]).sum(axis=1)
    return SeenDeviations(
        np.sqrt(np.sum(each_mm**2, axis=(1, 2)) / times),
        (each_mm.sum(axis=1) / times[:, None]) @ R,
        None,
    )


def accuracy_seen(found: SeenDeviations) -> Accuracy:
    """Summarise deviations over all configurations."""
    distance = found.distance_mm
    turned = found.rotation_deg
    return Accuracy(
        mean_mm=float(distance.mean()),
        peak_mm=float(distance.max()),
        rms_mm=float(np.sqrt(np.mean(distance**2))),
        orientation_deg=(None if turned is None else float(np.linalg.norm(turned, axis=1).mean())),
        configurations=len(distance),
    )


def accuracy_by_load(found: SeenDeviations, load_N: Array) -> dict[float, Accuracy]:
    """Summarise deviations for every load."""
    return {float(load): accuracy_seen(found.take(load_N == load)) for load in np.unique(load_N)}


def spread_mm(seen: Seen) -> float:
    """Return how far the places or distances seen spread about their middle, rms."""
    if isinstance(seen, SeenPoses):
        return 1e3 * float(np.sqrt(np.sum(np.var(seen.T_instr_target[:, :3, 3], axis=0))))
    if isinstance(seen, SeenDistances):
        return 1e3 * float(np.std(seen.d_m))
    return 1e3 * float(np.sqrt(np.sum(np.nanvar(seen.p_instr_m.reshape(-1, 3), axis=0))))
