"""One calibration problem as a file that every environment can read (numpy only)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Problem:
    """Measured positions of one target, nominal geometry, and where to start.

    Attributes:
        q_train_rad: (N, 6) joint angles of the poses to calibrate with.
        p_train_m: (N, 3) measured positions of the target in the instrument's frame.
        q_test_rad: (M, 6) joint angles of the held-out poses.
        p_test_m: (M, 3) positions there: true where simulated, measured where real.
        mdh: (6, 4) nominal modified Denavit-Hartenberg rows alpha [rad], a [m], theta [rad], d [m].
        urdf: the same geometry as URDF: links `base`, `flange` and, where the target is first
            guessed, `target`; joints `joint_1` to `joint_6`.
        T_world_base: (4, 4) first guess of the robot's base in the instrument's frame [m].
        p_flange_target_m: (3,) first guess of the target in the flange's frame.
        noise_m: stated uncertainty (1 sigma) of a measured coordinate.
        tolerance_m: expected size (1 sigma) of an error of a length.
        tolerance_rad: expected size (1 sigma) of an error of an angle.
    """

    q_train_rad: Array
    p_train_m: Array
    q_test_rad: Array
    p_test_m: Array
    mdh: Array
    urdf: str
    T_world_base: Array
    p_flange_target_m: Array
    noise_m: float
    tolerance_m: float
    tolerance_rad: float

    def write(self, path: Path) -> None:
        """Write the problem as an npz file."""
        stored = {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}
        np.savez(path, allow_pickle=False, **stored)

    @classmethod
    def read(cls, path: Path) -> Problem:
        """Read what `write` wrote."""
        with np.load(path) as stored:
            values = {field.name: stored[field.name] for field in fields(cls)}
        for name in ("urdf", "noise_m", "tolerance_m", "tolerance_rad"):
            values[name] = values[name].item()
        return cls(**values)

    def test_errors_mm(self, p_predicted_m: Array) -> Array:
        """Return the (M,) distances between predicted and given held-out positions."""
        distances: Array = 1e3 * np.linalg.norm(p_predicted_m - self.p_test_m, axis=1)
        return distances
