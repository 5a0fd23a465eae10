"""The health of a calibration as JSON."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.health import Health


def health_record(health: Health, pose: NDArray[np.str_]) -> dict[str, Any]:
    """Return what a reader should look at before trusting a calibration.

    Args:
        health: of the calibration.
        pose: (P,) labels of the poses it was fitted to.
    """
    ended, design = health.ended, health.design
    finite = np.isfinite(design.u_optimal_m)
    both = finite & np.isfinite(design.u_measured_m)
    return {
        "verdict": health.verdict,
        "line": health.line,
        "converged": ended.converged,
        "reason": ended.reason,
        "iterations": ended.iterations,
        "at_bounds": list(ended.at_bound),
        "rank": ended.identifiability.rank,
        "unknowns": len(ended.parameters),
        "condition": ended.identifiability.condition,
        "not_identifiable": sorted(ended.not_identifiable),
        "correlated_pairs": [
            {"parameters": [pair.first, pair.second], "correlation": pair.correlation}
            for pair in health.pairs
        ],
        "train_rms_mm": health.train_rms_mm,
        "held_out_rms_mm": health.held_out_rms_mm,
        "noise_mm": health.noise_mm,
        "poses": {
            "measured": health.poses,
            "wanted": health.poses_wanted,
            "u_wanted_mm": health.u_wanted_mm,
            "u_model_mm": health.u_model_mm if np.isfinite(health.u_model_mm) else None,
            "d_optimal_order": [str(label) for label in pose[design.order]],
            "expected": [
                {
                    "poses": int(number),
                    "u_optimal_mm": 1e3 * float(design.u_optimal_m[k]),
                    "u_measured_mm": 1e3 * float(design.u_measured_m[k]) if both[k] else None,
                }
                for k, number in enumerate(design.numbers)
                if finite[k]
            ],
        },
    }
