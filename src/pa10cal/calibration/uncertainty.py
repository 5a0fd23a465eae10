"""Uncertainty: of readings by the scatter of their repeats, and of parameters by the readings."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import end_pose_with_screws
from pa10cal.arrays import Array, Index, Mask
from pa10cal.calibration.rules import GRADES
from pa10cal.calibration.two_level_problem import TwoLevelRows
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import (
    Observations,
    average_repeats,
    reading_groups,
    with_repeat_scatter,
)
from pa10cal.observe.pose import Pose
from pa10cal.results.calibration import CalibratedParameter, RepeatScatter
from pa10cal.rules import READINGS
from pa10cal.terms.model import Model
from pa10cal.terms.term import Report


def scatter_of_repeats(readings: Observations, model: FittedModel) -> tuple[RepeatScatter, ...]:
    """Compare the scatter of repeats with the stated uncertainty, by kind of component.

    Successive readings of the same pose, load and direction of arrival are compared, so that slow
    drift and effects of the direction do not count; the model removes what differs by joint
    positions and torques. The median is insensitive to gross errors.

    Args:
        readings: single readings of the poses fitted.

    Returns:
        One entry for each kind, stated with so much of what is stated of the joints as repeats may
        show; none where too little is repeated, and none of a rounded kind, in which repeats agree
        in all digits while other kinds differ.
    """
    first, second = _successive(readings)
    if len(first) < GRADES.scatter_pairs:
        return ()
    poses = model.as_modelled(readings)
    measured = poses.measured
    T_instr_ee = model.T_instr_base @ model.model.predict(poses.states, model.x)
    compared = measured.compare(T_instr_ee, model.targets_m)
    residual = compared.residual
    variance = np.diagonal(measured.stated_covariance, axis1=1, axis2=2)
    of_joints = np.zeros_like(variance)
    if readings.log is not None:
        of_joints = _variance_of_joints(model, poses, compared.by_end, readings.log.q_u_stated)
    without_joints = np.maximum(variance - of_joints, 0.0)
    both = measured.components_seen[first] & measured.components_seen[second]
    difference = residual[second] - residual[first]
    stated_variance = variance[second] + variance[first]
    least_variance = without_joints[second] + without_joints[first]
    rounded = measured.rounded_kinds(difference, both)
    scatter = []
    for kind, columns in measured.component_kinds:
        if kind in rounded:
            continue
        seen = both[:, columns]
        if seen.any(axis=1).sum() < GRADES.scatter_pairs:
            continue
        by_component = (
            difference[:, columns] ** 2,
            stated_variance[:, columns],
            least_variance[:, columns],
        )
        found, stated, least = _of_a_reading(*by_component, seen).tolist()
        # An error of a joint may be the same in all repeats, as by rounding, or differ in each.
        nearest = min(max(found, least), stated)
        scatter.append(RepeatScatter(kind=kind, found=found, stated=nearest, pairs=len(first)))
    return tuple(scatter)


def _of_a_reading(square: Array, variance: Array, least: Array, seen: Mask) -> Array:
    """Return found, stated and least stated scatter of a component of a single reading, (3,).

    Where it differs along the axes, as of a camera in depth, a median over all components is that
    of the better axes: it is then the root mean square over the axes.

    Args:
        square: (N, b) squared differences of two readings.
        variance: (N, b) their stated variances; `least` without those of the joints.
        seen: (N, b) which components both have.
    """

    def pooled(of: slice) -> Array:
        shown = seen[:, of]
        variances = variance[:, of][shown]
        ratio = np.median(square[:, of][shown] / variances) / GRADES.median_square
        stated, at_least = np.median(variances), np.median(least[:, of][shown])
        return np.sqrt(0.5 * np.array([ratio * stated, stated, at_least]))

    if seen.shape[1] % 3 == 0:  # x, y and z, of every target
        by_axis = np.array([pooled(slice(axis, None, 3)) for axis in range(3)])
        found_and_stated = by_axis[:, :2]
        if (
            found_and_stated.max(axis=0) > READINGS.axes_differ * found_and_stated.min(axis=0)
        ).any():
            return np.asarray(np.sqrt(np.mean(by_axis**2, axis=0)))
    return pooled(slice(None))


def _successive(readings: Observations) -> tuple[Index, Index]:
    """Return readings, and the next ones of the same pose, load and direction of arrival."""
    arrival = np.unique(readings.states.arrival, axis=0, return_inverse=True)[1].ravel()
    group = reading_groups(readings) * (arrival.max(initial=0) + 1) + arrival
    order = np.lexsort((readings.states.time_s, group))
    pairs = np.flatnonzero(group[order][1:] == group[order][:-1])
    return order[pairs], order[pairs + 1]


def _variance_of_joints(
    model: FittedModel, poses: Observations, by_end: Array, joint_u: Array
) -> Array:
    """Return the variances (P, b) of components by stated uncertainties of joint positions.

    Args:
        by_end: (P, b, 6) derivative of the components by velocities of the end.
        joint_u: (P, n) standard uncertainties [rad, m].
    """
    chain, R = model.model.chain, model.T_instr_base[:3, :3]
    at = model.model.chain_coordinates(poses.states, model.x)
    screws = end_pose_with_screws(chain, at).screws[:, :, chain.joint_columns] * joint_u[:, None]
    in_instr = np.concatenate([R @ screws[:, :3], R @ screws[:, 3:]], axis=1)
    return np.asarray(np.sum((by_end @ in_instr) ** 2, axis=2))


def with_own_scatter(
    observations: Observations[Pose], readings: Observations[Pose], model: Model, x: Array
) -> Observations[Pose]:
    """Return averaged poses with the covariance that single readings show about the model.

    Differences between repeats that the model explains by joint positions and torques are removed
    first: a servo may stop at a slightly different place each time. The noise of logged positions
    and torques remains.

    Args:
        readings: the single readings; where nothing was repeated, `observations` stay as they are.
    """
    average = average_repeats(readings)
    expected = model.predict(readings.states, x)
    at_average = model.predict(average.states, x)[reading_groups(readings)]
    at_same_state = readings.with_measured(
        T_instr_target=readings.measured.T_instr_target @ np.linalg.inv(expected) @ at_average
    )
    return with_repeat_scatter(observations, at_same_state)


def propagate(
    at_solution: TwoLevelRows,
    observations: Observations[Pose],
    inner_rows: NDArray[np.intp],
    tolerance_rows: Array,
    r_max_m: float,
    u_apparatus_m: float,
) -> Array:
    """Return the covariance of the paper's estimate, on both of its levels.

    A fit ends at a minimum, so a small error e_i of pose i moves the estimate by G_i e_i, where the
    influence G_i follows from the normal equations of the outer level (parameters of the arm) and
    of the inner one (base frame). Errors that repeats show are independent between poses: their
    covariances add. The error of the places of the tooling balls is common to all poses: its
    influences add before they are squared.

    Args:
        observations: measured poses with their covariances.
        tolerance_rows: (r, k) tolerance rows of the solve.
        u_apparatus_m: standard uncertainty of a target's place on the apparatus, per axis.

    Returns:
        Covariance (k + 6, k + 6) of the parameters and of six small motions of the base, along and
        about its own axes, as those of the chain are.
    """
    J, by_base = at_solution.jacobian, at_solution.by_base
    k = J.shape[2]
    flat = J.reshape(-1, k)
    size = np.sqrt(np.sum(flat**2, axis=0) + np.sum(tolerance_rows**2, axis=0))
    size[size == 0.0] = 1.0
    normal = (flat.T @ flat + tolerance_rows.T @ tolerance_rows) / np.outer(size, size)
    normal_inverse = np.linalg.pinv(normal, hermitian=True) / np.outer(size, size)
    outer_gradient = J.transpose(0, 2, 1).copy()  # (N, k, 6) derivative by e_i
    base_influence = np.zeros((len(J), 6, 6))
    inner = by_base[inner_rows]
    hessian = np.einsum("nij,nik->jk", inner, inner)
    base_influence[inner_rows] = -np.linalg.solve(hessian, inner.transpose(0, 2, 1))
    by_base_frame = np.einsum("nij,nik->jk", J, by_base)
    outer_gradient += by_base_frame @ base_influence
    influence = -normal_inverse @ outer_gradient
    base_influence = base_influence + at_solution.base_jacobian @ influence
    unit = np.concatenate([np.full(3, 1.0 / r_max_m), np.ones(3)])
    noise = observations.measured.cov * np.outer(unit, unit)
    common = observations.measured.by_apparatus * unit[:, None]
    both = np.concatenate([influence, base_influence], axis=1)
    both[:, k : k + 3] = at_solution.T_instr_base[:3, :3].T @ both[:, k : k + 3]
    moved = u_apparatus_m * np.einsum("nai,nij->aj", both, common, optimize=True)
    covariance = np.einsum("nai,nij,nbj->ab", both, noise, both, optimize=True)
    return np.asarray(covariance + moved @ moved.T, dtype=np.float64)


def reported_keys(
    report: Report, covariance: Array, u_scale: float = 0.0
) -> dict[str, dict[str, Any]]:
    """Return value, standard uncertainty, unit and tolerance of reported parameters, by name.

    Args:
        report: k parameters, and their derivative by the m solved ones.
        covariance: (m, m) of those solved.
        u_scale: see `Model.u_scale`.
    """
    std = np.sqrt(np.diag(report.covariance(covariance, u_scale)))
    return {
        parameter.name: {
            "value": float(value),
            "std": float(sigma),
            "unit": parameter.unit,
            "tolerance": parameter.tolerance,
        }
        for parameter, value, sigma in zip(report.parameters, report.values, std, strict=True)
    }


def calibrated_parameters(
    report: Report,
    covariance: Array,
    held: Collection[str] = (),
    at_bound: Collection[str] = (),
    u_scale: float = 0.0,
) -> dict[str, CalibratedParameter]:
    """Return reported parameters by name.

    A parameter of a direction that is not identifiable is held by its tolerance term alone, so
    its tolerance is given as its uncertainty.

    Args:
        report: k parameters, and their derivative by the m solved ones.
        covariance: (m, m) of those solved.
        u_scale: see `Model.u_scale`.
    """
    return {
        name: CalibratedParameter(
            **(keys | {"std": keys["tolerance"]} if name in held else keys),
            identifiable=name not in held,
            at_bound=name in at_bound,
        )
        for name, keys in reported_keys(report, covariance, u_scale).items()
    }
