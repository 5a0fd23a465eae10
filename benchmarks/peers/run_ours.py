"""This package on the same problems, in its own environment: the general model."""

from __future__ import annotations

import numpy as np

from benchmarks.peers.adapter import Fitted, main
from benchmarks.peers.problem import Array, Problem
from pa10cal.arm.statics import PoseStates
from pa10cal.calibration.general.as_model import fitted
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.commands.command_line import keep_memory, limit_threads
from pa10cal.files.arms import load_arm
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import Points
from pa10cal.options import Tolerances


class Ours:
    """Parameters chosen for arm and instrument by the package itself, and its own start."""

    def __init__(self, problem: Problem) -> None:
        self.arm = load_arm("ur10")
        self.observations = _observations(problem)
        length, angle = problem.tolerance_m, problem.tolerance_rad
        self.options = CalibrationOptions(
            tolerances=Tolerances(
                a_m=length, alpha_rad=angle, d_m=length, beta_rad=angle, theta_rad=angle
            )
        )

    def solve(self) -> Fitted:
        """Find about where base and target are, choose the parameters, fit them."""
        start = find_start(self.arm, self.observations)
        self.found = calibrate_general(self.arm, self.observations, start, None, self.options)
        return Fitted(len(self.found.fit.x), self.found.fit.converged)

    def predict_m(self, q_rad: Array) -> Array:
        """Return positions of the target."""
        model = fitted(self.found)
        T = model.T_instr_base @ model.model.predict(_states(q_rad), model.x)
        predicted: Array = T[:, :3, :3] @ model.targets_m + T[:, :3, 3]
        return predicted


def _states(q_rad: Array) -> PoseStates:
    """Return states of which nothing but the joint angles is known."""
    unknown, one = np.full_like(q_rad, np.nan), np.zeros(len(q_rad))
    return PoseStates(q_rad, unknown, np.zeros_like(q_rad), one, np.full_like(one, np.nan), one)


def _observations(problem: Problem) -> Observations:
    """Return the readings as what an instrument saw of one target whose place nobody stated."""
    count = len(problem.q_train_rad)
    covariance = np.broadcast_to(problem.noise_m**2 * np.eye(3), (count, 1, 3, 3))
    seen = Points(("target",), problem.p_train_m[:, None], covariance, None)
    labels = np.array([f"P{k:05d}" for k in range(count)])
    return Observations.single(labels, _states(problem.q_train_rad), seen)


if __name__ == "__main__":
    limit_threads()
    keep_memory()
    main({"pa10cal": Ours})
