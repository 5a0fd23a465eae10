"""FIGAROH: errors of every joint's placement on a URDF, and three ways to choose among them."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml
from figaroh.calibration.base_calibration import (  # type: ignore[import-not-found]
    BaseCalibration,
)
from figaroh.calibration.calibration_tools import (  # type: ignore[import-not-found]
    calc_updated_fkm,
)
from figaroh.tools.robot import load_robot  # type: ignore[import-not-found]

from benchmarks.peers.adapter import Calibration, Fitted, main
from benchmarks.peers.problem import Array, Problem

_METHODS = ("structural", "excitation", "map")
#: Part of a column that others must leave for its parameter to be fitted. By default far less, and
#: with a target near the last axis the fit then goes on for minutes for nothing.
_LEAST_LEFT = 1e-2


class ByPosition(BaseCalibration):  # type: ignore[misc]
    """The package's calibration with a residual of one's own, as it asks for."""

    def cost_function(self, var: Array) -> Array:
        """Return predicted less measured coordinates [m], in the package's order."""
        predicted = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
        residual: Array = predicted - self.PEE_measured
        return residual

    def eliminate_absorbed_parameters(self, tol: float = _LEAST_LEFT) -> list[str]:
        """Leave out what frames absorb, as the package does, but what they nearly absorb too."""
        dropped: list[str] = super().eliminate_absorbed_parameters(tol)
        return dropped


class Placements:
    """One of the package's ways to choose what to estimate."""

    def __init__(self, problem: Problem, method: str) -> None:
        joints = [f"joint_{k}" for k in range(1, 7)]
        with tempfile.TemporaryDirectory() as name:
            arm, settings, readings = (
                Path(name) / file for file in ("arm.urdf", "settings.yaml", "readings.csv")
            )
            arm.write_text(problem.urdf)
            settings.write_text(yaml.safe_dump(_settings(problem, method, str(readings))))
            rows = np.hstack([problem.p_train_m, problem.q_train_rad])
            header = ",".join(["x1", "y1", "z1", *joints])
            np.savetxt(readings, rows, "%.17g", ",", header=header, comments="")
            self.fit = ByPosition(load_robot(str(arm), load_by_urdf=True), str(settings))
            # Its settings file cannot say these two.
            self.fit.calib_config["known_baseframe"] = False
            self.fit.calib_config["known_tipframe"] = False
            self.fit.load_data_set()

    def solve(self) -> Fitted:
        """Choose the parameters and fit them; it guesses base and target by itself."""
        self.fit.create_param_list()
        self.found, _ = self.fit.solve_optimisation()
        return Fitted(len(self.found.x), bool(self.found.success))

    def predict_m(self, q_rad: Array) -> Array:
        """Return positions of the target by the package's own forward kinematics."""
        settings = dict(self.fit.calib_config, NbSample=len(q_rad))
        flat = calc_updated_fkm(self.fit.model, self.fit.data, self.found.x, q_rad, settings)
        predicted: Array = flat.reshape(3, -1).T
        return predicted


def _settings(problem: Problem, method: str, readings: str) -> dict[str, object]:
    """Return the settings file; the expected sizes are those of the problem."""
    sizes = {
        "translation": problem.tolerance_m,
        "rotation": problem.tolerance_rad,
        "joint_offset": problem.tolerance_rad,
    }
    calibration = {
        "enabled": True,
        "parameters": {
            "calibration_level": "full_params",
            "estimation": {"method": method, "priors": sizes, "dependency_tol": _LEAST_LEFT},
        },
        "kinematics": {"base_frame": "universe", "tool_frame": "target"},
        "measurements": {"markers": [{"measurable_dof": [True] * 3 + [False] * 3}]},
        "data": {"source_file": readings, "number_of_samples": len(problem.q_train_rad)},
    }
    return {"robot": {"name": "ur10"}, "tasks": {"calibration": calibration}}


def _with(method: str) -> Callable[[Problem], Calibration]:
    return lambda problem: Placements(problem, method)


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    main({f"figaroh-{method}": _with(method) for method in _METHODS})
