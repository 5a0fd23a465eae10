"""Time of one calibration: exact derivatives against nested finite differences, and its growth.

Both solve the same problem from the same start in the same process; figures are ratios. The poses
are synthetic, made with the nominal chain, Table I like departures and cubic springs.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pa10cal.arm.statics import PoseStates
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.two_level_fit import random_starts, solve, tolerance_rows
from pa10cal.calibration.two_level_problem import TwoLevel, rows_of, spread_poses
from pa10cal.files.arms import load_arm
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.options import Tolerances
from pa10cal.terms.joint_spring import baseline

Array = NDArray[np.float64]

#: Precision and difference steps with which nested differences do reach the same answer: the inner
#: minimum must be much sharper than what the outer step moves it by.
_INNER = {"jac": "3-point", "diff_step": 1e-4, "ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15}
_OUTER = {"jac": "3-point", "diff_step": 1e-4, "ftol": 1e-15, "xtol": 1e-13, "gtol": 1e-15}
_SIZES = (81, 300, 1000, 3000, 10_000)


def problem(poses: int) -> TwoLevel:
    """Build a calibration of so many poses with noise of 10 um and 50 urad."""
    rng = np.random.default_rng(poses)
    tau_ref_Nm = np.array([1.0, 110.0, 75.0, 1.0, 10.0, 1.0])
    model = baseline(load_arm("pa10_6ce"), (2, 3, 5), Tolerances(), tau_ref_Nm=tau_ref_Nm)
    q_rad = np.array([0.3, 0.35, 1.4, 0.2, -0.5, 0.4]) + rng.uniform(-0.5, 0.5, (poses, 6))
    tau_Nm = rng.uniform(-0.2, 1.0, (poses, 6)) * [0.0, -110.0, -75.0, 0.0, -10.0, 0.0]
    states = PoseStates(
        q_rad, tau_Nm, np.ones((poses, 6)), np.zeros(poses), np.zeros(poses), np.arange(poses) * 1.0
    )
    x = np.concatenate(
        [
            rng.normal(scale=2.0, size=24) * model.scale[:24],
            *(
                term.solved(k, 2e7)  # type: ignore[attr-defined]
                for term, k in zip(model.terms[1:], (2e4, 1.3e4, 2.6e3), strict=True)
            ),
        ]
    )
    T = model.predict(states, x)
    T[:, :3, 3] += rng.normal(scale=1e-5, size=(poses, 3))
    noise = Rotation.from_rotvec(rng.normal(scale=5e-5, size=(poses, 3)))
    T[:, :3, :3] = noise.as_matrix() @ T[:, :3, :3]
    labels = np.array([f"P{k:05d}" for k in range(poses)])
    observations = Observations.single(labels, states, Pose.of(T, np.zeros((poses, 6, 6))))
    return TwoLevel(model, observations, rows_of(observations, spread_poses(observations, 24)))


def solve_exactly(level: TwoLevel) -> Array:
    """Solve with exact derivatives, as the pipeline does, from one start."""
    start = random_starts(level.model, 1, 0)[0]
    return solve(level, start, tolerance_rows(level, start, CalibrationOptions()), 200).x


def solve_by_differences(level: TwoLevel) -> Array:
    """Solve as the paper did: finite differences outside, and inside for every evaluation."""
    model, observations = level.model, level.observations
    start = random_starts(model, 1, 0)[0]
    terms = tolerance_rows(level, start, CalibrationOptions())
    inner = np.zeros(6)

    def place(T_base_ee: Array, psi: Array, rows: Array | slice) -> Array:
        R = Rotation.from_euler("XYZ", psi[3:]).as_matrix()
        measured = observations.measured.T_instr_target[rows]
        position = T_base_ee[rows, :3, 3] @ R.T + psi[:3] - measured[:, :3, 3]
        turned = R @ T_base_ee[rows, :3, :3] @ measured[:, :3, :3].transpose(0, 2, 1)
        chord = 2.0 * Rotation.from_matrix(turned).as_quat(canonical=True)[:, :3]
        return np.concatenate([position, chord], axis=1).ravel()

    def outer(z: Array) -> Array:
        nonlocal inner
        x = z * model.scale
        T_base_ee = model.predict(observations.states, x)
        inner = least_squares(
            lambda psi: place(T_base_ee, psi, level.inner_rows), inner, **_INNER
        ).x
        return np.concatenate([place(T_base_ee, inner, slice(None)), terms @ x])

    ends = [(p.lower, p.upper) for p in model.parameters]
    lower = np.array([-np.inf if low is None else low for low, _ in ends]) / model.scale
    upper = np.array([np.inf if high is None else high for _, high in ends]) / model.scale
    found = least_squares(
        outer, start / model.scale, bounds=(lower, upper), x_scale="jac", max_nfev=200, **_OUTER
    )
    return found.x * model.scale


def _standard_uncertainty(level: TwoLevel, x: Array) -> Array:
    """Return the standard uncertainties (k,) that the residuals imply; inf in open directions."""
    at = level.rows(x)
    jacobian = at.jacobian.reshape(-1, len(x)) * level.model.scale
    _, sizes, right = np.linalg.svd(jacobian, full_matrices=False)
    variance = np.sum(at.residual**2) / (at.residual.size - len(x))
    told = sizes > 1e-9 * sizes[0]
    spread = np.where(told, np.sqrt(variance) / np.where(told, sizes, 1.0), np.inf)
    weights = np.where(np.abs(right) > 1e-9, right, 0.0)
    with np.errstate(invalid="ignore"):
        shares = np.where(weights != 0.0, weights * spread[:, None], 0.0)
    total: Array = level.model.scale * np.sqrt(np.sum(shares**2, axis=0))
    return total


def seconds(function: Callable[[], object], repeats: int) -> float:
    """Return the median time of a call."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def rows() -> list[tuple[str, float, str, str]]:
    """Measure; return what, value, unit and bar of each figure."""
    level = problem(81)
    exact, differenced = solve_exactly(level), solve_by_differences(level)
    apart = float(np.abs((exact - differenced) / _standard_uncertainty(level, exact)).max())
    ratio = seconds(lambda: solve_by_differences(level), 1) / seconds(
        lambda: solve_exactly(level), 9
    )
    # A step costs the same work whatever the start, so the growth is that of a step.
    step = []
    for poses in _SIZES:
        grown = problem(poses)
        x = random_starts(grown.model, 1, 0)[0]
        step.append(seconds(lambda grown=grown, x=x: grown.rows(x), 9))
    exponent = float(np.polyfit(np.log(_SIZES[2:]), np.log(step[2:]), 1)[0])
    whole = seconds(lambda: solve_exactly(problem(10_000)), 1)
    return [
        ("calibration of 81 poses, faster than nested finite differences by", ratio, "x", ">= 30"),
        ("largest difference of the two answers, over its uncertainty", apart, "", "same answer"),
        ("growth of a step from 1000 to 10000 poses, exponent", exponent, "", "about 1"),
        ("calibration of 10000 poses", whole, "s", ""),
    ]


if __name__ == "__main__":
    for what, value, unit, bar in rows():
        print(f"{what}: {value:.4g} {unit} (bar: {bar})")
