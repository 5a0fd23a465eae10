"""robotkinecal: screw axes of a product of exponentials, four parameters a joint, and the target.

It wants positions in the robot's base frame and fits no such frame, so it is given the
measurements turned into the first guess of it; what the guess is off, the axes take up.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import roboticstoolbox as rtb  # type: ignore[import-not-found]
from robotkinecal import SerialRobotKineCal  # type: ignore[import-not-found]

from benchmarks.peers.adapter import Fitted, main
from benchmarks.peers.problem import Array, Problem


class Screws:
    """The package's one method, with its own steps and tolerance."""

    def __init__(self, problem: Problem) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "arm.urdf"
            path.write_text(problem.urdf)
            robot = rtb.ERobot.URDF(str(path))
        np.random.seed(0)  # noqa: NPY002 - it draws its basis of corrections from there
        self.R, self.t_m = problem.T_world_base[:3, :3], problem.T_world_base[:3, 3]
        self.solver = SerialRobotKineCal(robot, "target")
        p_base_m = (problem.p_train_m - self.t_m) @ self.R
        self.solver.set_observations(list(problem.q_train_rad), list(p_base_m))

    def solve(self) -> Fitted:
        """Calibrate; all parameters are fitted but those it finds not identifiable."""
        result = self.solver.solve()
        corrected = result.iteration_results[-1].twist_corrections
        return Fitted(int(np.count_nonzero(corrected)), bool(result.has_converged))

    def predict_m(self, q_rad: Array) -> Array:
        """Return positions of the target by the package's own forward kinematics."""
        end = self.solver.N_JOINTS + 1
        p_base_m = np.array([self.solver.forward_kinematics(end, q).t for q in q_rad])
        predicted: Array = p_base_m @ self.R.T + self.t_m
        return predicted


if __name__ == "__main__":
    main({"robotkinecal": Screws})
