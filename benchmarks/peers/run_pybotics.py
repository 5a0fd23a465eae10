"""pybotics: modified Denavit-Hartenberg rows, target and base frame by scipy's least squares."""

from __future__ import annotations

import numpy as np
from pybotics.optimization import (  # type: ignore[import-not-found]
    OptimizationHandler,
    optimize_accuracy,
)
from pybotics.robot import Robot  # type: ignore[import-not-found]
from pybotics.tool import Tool  # type: ignore[import-not-found]
from scipy.optimize import least_squares

from benchmarks.peers.adapter import Fitted, main
from benchmarks.peers.problem import Array, Problem

#: A target nearer to the last axis than this hardly tells how that axis lies.
_OFF_AXIS_M = 1e-3


def _identifiable(p_flange_target_m: Array) -> Array:
    """Return the (6, 4) mask of alpha, a, theta, d that base frame and target leave to be found.

    The package leaves this choice to its user. The base frame takes all of row 1, the target theta
    and d of row 6, and all of it where it sits on the last axis; axes 2, 3 and 4 are parallel, so
    one d of rows 2 to 4 is enough. With more of them free, lengths along parallel axes run away.
    """
    mask = np.ones((6, 4), dtype=bool)
    mask[0] = mask[5, 2:] = mask[1:3, 3] = False
    mask[5] &= bool(np.hypot(*p_flange_target_m[:2]) > _OFF_AXIS_M)
    return mask


class ByDistance:
    """The package's own residual: the distance of every position; millimetres and radians."""

    def __init__(self, problem: Problem) -> None:
        robot = Robot.from_parameters((problem.mdh * [1.0, 1e3, 1.0, 1e3]).ravel())
        target, world = np.eye(4), problem.T_world_base.copy()
        target[:3, 3] = 1e3 * problem.p_flange_target_m
        world[:3, 3] *= 1e3
        robot.tool, robot.world_frame = Tool(matrix=target), world
        self.handler = OptimizationHandler(
            robot,
            kinematic_chain_mask=_identifiable(problem.p_flange_target_m).ravel(),
            tool_mask=[True] * 3 + [False] * 3,
            world_mask=[True] * 6,
        )
        self.q_train_rad, self.p_train_mm = problem.q_train_rad, 1e3 * problem.p_train_m

    def residual(self, vector: Array) -> Array:
        """Return one number a pose [mm]."""
        residual: Array = optimize_accuracy(vector, self.handler, self.q_train_rad, self.p_train_mm)
        return residual

    def solve(self) -> Fitted:
        """Calibrate as its examples do, but with parameters scaled by their effect."""
        start = self.handler.generate_optimization_vector()
        found = least_squares(self.residual, start, x_scale="jac")
        self.handler.apply_optimization_vector(found.x)
        rows = self.handler.robot.kinematic_chain.matrix
        return Fitted(len(start), bool(found.success), 1e-3 * float(abs(rows[:, [1, 3]]).max()))

    def predict_m(self, q_rad: Array) -> Array:
        """Return positions of the target by the package's own forward kinematics."""
        return 1e-3 * self._predict_mm(q_rad)

    def _predict_mm(self, q_rad: Array) -> Array:
        predicted: Array = np.array([self.handler.robot.fk(q)[:3, 3] for q in q_rad])
        return predicted


class ByCoordinate(ByDistance):
    """The same with three residuals a pose, through the package's kinematics."""

    def residual(self, vector: Array) -> Array:
        """Return three numbers a pose [mm]."""
        self.handler.apply_optimization_vector(vector)
        residual: Array = (self._predict_mm(self.q_train_rad) - self.p_train_mm).ravel()
        return residual


if __name__ == "__main__":
    main({"pybotics-distance": ByDistance, "pybotics-xyz": ByCoordinate})
