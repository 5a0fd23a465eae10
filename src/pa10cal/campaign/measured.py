"""Measured configurations as arrays, whatever instrument they come from."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.campaign.quarantine import LeftOut

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MeasuredPoses:
    """C measured configurations of an arm with n joints, in order of time.

    Attributes:
        kind: (C,) `line_x`, `line_y`, `grid` or `holdout`.
        pose: (C,) label.
        load_N: (C,) external load.
        repeat: (C,) repeat.
        time_s: (C,) middle of the reading.
        slides: (n,) whether the joint slides.
        q_rad: (C, n) joint positions; metres for a joint that slides.
        q_u_rad: (C, n) standard uncertainty of their mean, nan where unknown.
        tau_Nm: (C, n) torques, nan where not logged; newtons for a joint that slides.
        tau_u_Nm: (C, n) standard uncertainty of their mean, nan where unknown.
        arrival: (C, n) direction of arrival: -1, 0 or +1.
        temperature_C: (C,) temperature, nan where not logged.
        dwell_samples: (C,) samples averaged; 0 where there is no log.
        ball_names: names of the B balls or other targets; none for instruments without.
        p_instr_balls_mm: (C, B, 3) their centres, nan where a target was not seen.
        cov_balls_mm2: (C, B, 3, 3) covariances of the centres.
        ball_touches: (C, B) touches used; 0 for an instrument that does not touch.
        T_instr_ee_mm: (C, 4, 4) end-effector in the instrument's frame [mm] - for a tracker its
            target on the end-effector; None for instruments that see points or distances alone.
        cov_ee_mm: (C, 6, 6) covariance of its position and of a small rotation applied on the left,
            both along the instrument's axes [mm², mm rad, rad²], as the instrument's uncertainty
            implies it.
        d_mm: (C,) distance of a target from a fixed point; None for instruments that see more.
        d_u_mm: (C,) its standard uncertainty.
    """

    kind: NDArray[np.str_]
    pose: NDArray[np.str_]
    load_N: Array
    repeat: NDArray[np.int64]
    time_s: Array
    slides: NDArray[np.bool_]
    q_rad: Array
    q_u_rad: Array
    tau_Nm: Array
    tau_u_Nm: Array
    arrival: Array
    temperature_C: Array
    dwell_samples: NDArray[np.int64]
    ball_names: tuple[str, ...]
    p_instr_balls_mm: Array
    cov_balls_mm2: Array
    ball_touches: NDArray[np.int64]
    T_instr_ee_mm: Array | None = None
    cov_ee_mm: Array | None = None
    d_mm: Array | None = None
    d_u_mm: Array | None = None

    def __len__(self) -> int:
        return len(self.kind)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> MeasuredPoses:
        """Return some of the configurations."""
        of_all = ("slides", "ball_names")
        columns = {field.name: getattr(self, field.name) for field in fields(self)}
        taken = {
            name: value[rows]
            for name, value in columns.items()
            if name not in of_all and value is not None
        }
        return replace(self, **taken)


@dataclass(frozen=True)
class Ingested:
    """A campaign's measured configurations and what was left out on the way.

    Attributes:
        poses: the configurations.
        left_out: rows left out, each once.
        notes: what the reader should know, one clause each.
        warnings: what the reader should mend before going on, one sentence each.
    """

    poses: MeasuredPoses
    left_out: tuple[LeftOut, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...] = ()
