"""Where a fit and the data disagree, as JSON."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.clustered import Estimate
from pa10cal.discovery.evidence.pure_error import ChannelTest, PureErrorTest
from pa10cal.discovery.joint_space import Periodogram
from pa10cal.discovery.lack_of_fit import AXES, Arrival, LackOfFit, Part

Array = NDArray[np.float64]

#: Digits of what is there to be drawn.
_DIGITS = 6


def lack_of_fit_record(found: LackOfFit) -> dict[str, Any]:
    """Return the numbers of a lack of fit; what is not known is null."""
    return {
        "pose": _channel(found.pose),
        "torque": None if found.torque is None else _channel(found.torque),
        "rms_mm": found.rms_mm,
        "floor_mm": found.floor_mm,
        "by_load": [_part(part) for part in found.by_load],
        "by_pose": [_part(part) for part in found.by_pose],
        "by_axis": [_part(part) for part in found.by_axis],
        "by_joint": [
            {
                "joint": part.joint,
                "rms_rad": part.rms_rad,
                "floor_rad": part.floor_rad,
                "arrivals": [_arrival(arrival, "rad") for arrival in part.arrivals],
                "periodogram": _periodogram(part.periodogram),
            }
            for part in found.by_joint
        ],
        "by_torque": [
            {
                "joint": part.joint,
                "rms_Nm": part.rms_Nm,
                "noise_Nm": part.noise_Nm,
                "arrivals": [_arrival(arrival, "Nm") for arrival in part.arrivals],
            }
            for part in found.by_torque
        ],
        "drifts": [
            {
                "axis": drift.axis,
                "by_time_mm_per_h": _estimate(drift.mm_per_h),
                "by_temperature_mm_per_K": None
                if drift.mm_per_K is None
                else _estimate(drift.mm_per_K),
            }
            for drift in found.drifts
        ],
        "cells": _cells(found),
    }


def _cells(found: LackOfFit) -> dict[str, Any]:
    """Return the cells column by column."""
    states = found.cells.states
    torque = found.torque_left_Nm
    return {
        "pose": found.cells.pose.tolist(),
        "load_N": _numbers(states.load_N),
        "readings": found.cells.readings.tolist(),
        "time_s": _numbers(states.time_s),
        "temperature_C": _numbers(states.temperature_C),
        **{f"position_{axis}_mm": _numbers(found.position_mm[:, k]) for k, axis in enumerate(AXES)},
        "joints": [
            {
                "joint": j + 1,
                "q_rad": _numbers(states.q_rad[:, j]),
                "arrival": _numbers(states.arrival[:, j]),
                "error_rad": _numbers(found.joints.error_rad[:, j]),
                "std_rad": _numbers(found.joints.std_rad[:, j]),
                "torque_left_Nm": None if torque is None else _numbers(torque[:, j]),
            }
            for j in range(states.n)
        ],
    }


def _channel(found: ChannelTest) -> dict[str, Any]:
    return {
        "shared": _test(found.shared),
        "unshared": _test(found.unshared),
        "shared_variance_of_a_reading": found.shared_variance,
    }


def _test(found: PureErrorTest | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "chi_square": found.chi_square,
        "dof": found.dof,
        "pure_error_dof": found.pure_dof,
        "F": found.ratio,
        "p_value": found.p_value,
    }


def _part(part: Part) -> dict[str, Any]:
    return {"of": part.of, "cells": part.cells, "rms_mm": part.rms_mm, "floor_mm": part.floor_mm}


def _arrival(arrival: Arrival, unit: str) -> dict[str, Any]:
    found = _estimate(arrival.mean)
    return {
        "direction": arrival.direction,
        "cells": arrival.cells,
        f"mean_{unit}": found["value"],
        f"std_{unit}": found["std"],
    }


def _estimate(found: Estimate) -> dict[str, float | None]:
    return {"value": found.value, "std": found.std if np.isfinite(found.std) else None}


def _periodogram(found: Periodogram | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "orders": _numbers(found.orders),
        "explained_rad": _numbers(found.explained_rad),
        "marked": list(found.marked),
        "marked_rad": _numbers(found.marked_rad),
    }


def _numbers(values: Array) -> list[float | None]:
    """Return numbers rounded to what a picture shows, null where there is none."""
    return [
        float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in values.tolist()
    ]
