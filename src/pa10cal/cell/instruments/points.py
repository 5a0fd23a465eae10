"""A tracker of positions of several targets."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.cell.instruments.instrument import Streams, Truth
from pa10cal.cell.instruments.tracker import Tracker, xyz_columns
from pa10cal.cell.robot import Robot


class Points(Tracker):
    """Some targets are not seen in some poses."""

    kind: ClassVar[str] = "points"

    def readings(self, truth: Truth, streams: Streams) -> dict[str, tuple[Array, float]]:
        """Return the positions of the targets [mm]; nan where one was not seen."""
        p_m = truth.robot.p_instr_targets_m(truth.rest.T_base_ee, truth.tool_shift_m)
        p_m = truth.as_read(p_m)
        p_m = p_m + 1e-3 * self.plan.position_mm * streams["position"].standard_normal(p_m.shape)
        p_m[_unseen(p_m.shape[:2], self.plan.unseen_share, streams["visibility"])] = np.nan
        return {
            f"{name}_{axis}_mm": (1e3 * p_m[:, b, k], self.stated_mm)
            for b, name in enumerate(truth.robot.targets.names)
            for k, axis in enumerate("xyz")
        }

    def read_columns(self, robot: Robot) -> dict[str, Any]:
        """Return the position of each target."""
        return {"targets": {name: xyz_columns(f"{name}_") for name in robot.targets.names}}


def _unseen(shape: tuple[int, ...], share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw which targets (P, B) are not seen; one of each pose always is."""
    drawn = rng.random(shape)
    unseen: NDArray[np.bool_] = drawn < share
    unseen[np.arange(len(drawn)), drawn.argmax(axis=1)] = False
    return unseen
