"""An instrument that measures the distance of one target from a fixed point."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from pa10cal.arrays import Array
from pa10cal.cell.instruments.instrument import Streams, Truth
from pa10cal.cell.instruments.tracker import Tracker
from pa10cal.cell.robot import Robot


class Distance(Tracker):
    """The fixed point is the origin of its frame."""

    kind: ClassVar[str] = "distance"

    def readings(self, truth: Truth, streams: Streams) -> dict[str, tuple[Array, float]]:
        """Return the distances [mm]."""
        p_m = truth.robot.p_instr_targets_m(truth.rest.T_base_ee, truth.tool_shift_m)[:, 0]
        d_m = np.linalg.norm(truth.as_read(p_m), axis=1)
        d_m = d_m + 1e-3 * self.plan.position_mm * streams["position"].standard_normal(d_m.shape)
        return {"d_mm": (1e3 * d_m, self.stated_mm)}

    def read_columns(self, robot: Robot) -> dict[str, Any]:
        """Return the distance."""
        del robot
        return {"distance": {"names": "d_mm", "u": "u_d_mm"}}
