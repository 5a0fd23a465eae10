"""The health of a calibration, as its record has it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.springs import reported_name
from pa10cal.calibration.health import Health
from pa10cal.results import health as health_parts


def health_part(health: Health, pose: NDArray[np.str_]) -> health_parts.Health:
    """Return what to look at before a calibration is trusted.

    Args:
        health: of the calibration.
        pose: (P,) labels of the poses it was fitted to.
    """
    ended, design = health.ended, health.design
    finite = np.isfinite(design.u_optimal_m)
    both = finite & np.isfinite(design.u_measured_m)
    return health_parts.Health(
        grade=health.grade,
        line=health.line,
        converged=ended.converged,
        reason=ended.reason,
        iterations=ended.iterations,
        at_bounds=tuple(map(reported_name, ended.at_bound)),
        rank=ended.identifiability.rank,
        unknowns=len(ended.parameters),
        condition=ended.identifiability.condition,
        not_identifiable=tuple(sorted(map(reported_name, ended.not_identifiable))),
        correlated_pairs=tuple(
            health_parts.CorrelatedPair(
                parameters=(pair.first, pair.second), correlation=pair.correlation
            )
            for pair in health.pairs
        ),
        train_rms_mm=health.train_rms_mm,
        held_out_rms_mm=health.held_out_rms_mm,
        noise_mm=health.noise_mm,
        error_over_noise=health.evidence.over_noise,
        held_out_over_expected=health.evidence.over_expected,
        repeats=tuple(
            health_parts.RepeatScatter(
                kind=each.kind, found=each.found, stated=each.stated, pairs=each.pairs
            )
            for each in health.evidence.repeats
        ),
        findings=tuple(
            health_parts.InputFinding(
                what=each.what,
                where=each.where,
                remedy=each.remedy,
                would_leave_mm=each.would_leave_mm,
                kind=each.kind,
            )
            for each in health.findings
        ),
        poses=health_parts.PosesNeeded(
            measured=health.poses,
            needed=health.poses_needed,
            u_needed_mm=health.u_needed_mm,
            u_model_mm=health.u_model_mm if np.isfinite(health.u_model_mm) else None,
            d_optimal_order=tuple(pose[design.order].tolist()),
            expected=tuple(
                health_parts.ExpectedUncertainty(
                    poses=int(number),
                    u_optimal_mm=1e3 * float(design.u_optimal_m[k]),
                    u_measured_mm=1e3 * float(design.u_measured_m[k]) if both[k] else None,
                )
                for k, number in enumerate(design.numbers)
                if finite[k]
            ),
        ),
    )
