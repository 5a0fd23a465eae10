"""Errors of predicted poses, their uncertainty, and the covariance of calibrated parameters.

In this order: accuracy as the paper states it, held-out errors, the covariance of the paper's
parameters (`propagate`), parameters as records hold them, and scatter of repeats against what is
stated.

A fit ends at a minimum, so an error e_i of pose i moves the estimate by an influence G_i, to first
order and through both levels of the paper's calibration (arm parameters outside, base frame
inside). Errors that repeats show are independent between poses; an error in the places of the
tooling balls on their apparatus at the end effector is the same in all poses and is added whole.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index, Mask
from pa10cal.calibration.levels import TwoLevelRows, fit_base_frame
from pa10cal.calibration.rules import GRADES
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.robust_weights import far_from_prediction
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import (
    Observations,
    average_repeats,
    reading_groups,
    with_repeat_scatter,
)
from pa10cal.observe.order import HeldOutPlaces
from pa10cal.observe.pose import Pose
from pa10cal.observe.quantities import Deviations
from pa10cal.results.calibration import CalibratedParameter, RepeatScatter
from pa10cal.results.evaluation import BETWEEN, UNSEEN, Accuracy, BeforeAfter
from pa10cal.terms.model import Model
from pa10cal.terms.term import Report

# Position and orientation error of predicted poses, as the paper states them.


def summarise(found: Deviations, rows: NDArray[np.bool_] | slice = slice(None)) -> Accuracy:
    """Summarise deviations over some rows."""
    distance, angle = found.distance_mm[rows], found.angle_deg
    return Accuracy(
        mean_mm=float(distance.mean()),
        peak_mm=float(distance.max()),
        rms_mm=float(np.sqrt(np.mean(distance**2))),
        orientation_deg=None if angle is None else float(angle[rows].mean()),
        configurations=len(distance),
    )


def summarise_by_load(found: Deviations, load_N: Array) -> dict[str, Accuracy]:
    """Summarise deviations for every load, keyed as the files are named: `0N`, `22N`, …"""
    return {f"{load:g}N": summarise(found, load_N == load) for load in np.unique(load_N)}


def summarise_trusted(
    before: Deviations, after: Deviations, load_N: Array, flagged: NDArray[np.bool_]
) -> dict[str, BeforeAfter]:
    """Summarise, for each load with flagged configurations, two models over those not flagged.

    Args:
        before, after: over P configurations.
        load_N: (P,) their loads.
        flagged: (P,) which of them have a reading far from the model.
    """
    found = {}
    for load in np.unique(load_N[flagged]):
        rows = (load_N == load) & ~flagged
        if rows.any():
            found[f"{load:g}N"] = BeforeAfter(
                before=summarise(before, rows), after=summarise(after, rows)
            )
    return found


def targets_seen(measured: Instrument) -> Array:
    """Return how many targets were seen in each pose, (P,): one at least."""
    seen = measured.components_seen[:, measured.position_columns]
    return np.asarray(np.maximum(1.0, seen.sum(axis=1) // 3))


def of_one_target(measured: Instrument, jacobian: Array) -> Array:
    """Return the position rows (P, c, k) of a derivative (P, b, k), per target.

    They are divided by the root of the number of targets seen: their norm is that of one target.
    """
    share = np.sqrt(targets_seen(measured))[:, None, None]
    return np.asarray(jacobian[:, measured.position_columns] / share)


def gram(rows: Array) -> Array:
    """Return the Gram matrix (k, k) of rows (P, b, k)."""
    flat = rows.reshape(-1, rows.shape[-1])
    return np.asarray(flat.T @ flat)


def position_noise_mm(measured: Instrument, covariance: Array) -> float:
    """Return what a covariance (P, b, b) explains of the rms position error of one target."""
    columns = measured.position_columns
    variances = np.diagonal(covariance, axis1=1, axis2=2)[:, columns]
    seen = np.where(measured.components_seen[:, columns], variances, 0.0)
    return float(1e3 * np.sqrt(np.mean(seen.sum(axis=1) / targets_seen(measured))))


def align_nominal(nominal: Model, observations: Observations[Pose]) -> Array:
    """Return T_instr_base (4, 4) that aligns the nominal model on the least loaded positions.

    This is the alignment behind the paper's errors before calibration: positions only, once, on
    the poses with the smallest load, which the paper's campaign measured unloaded.
    """
    load_N = observations.states.load_N
    least = observations.take(load_N == load_N.min())
    return fit_base_frame(
        nominal.predict(least.states, np.zeros(0)),
        least.measured.T_instr_target,
        attitude_weight_m2=0.0,
    ).T_instr_base


# Held-out poses with a reading that is wrong itself: they say nothing of a model.


@dataclass(frozen=True)
class HeldOut:
    """Remaining errors of held-out poses."""

    accuracy: Accuracy  # the errors; of poses along a path, those at unseen stretches
    u_mm: float | None = None  # standard uncertainty of the predictions there; None where not known
    repeats: float = 1.0  # readings behind a held-out pose over those behind a fitted one
    suspected: int = 0  # further held-out poses, with a suspected reading, that do not count
    where: str = ""  # where the poses lie, in words; empty where they are well apart
    between: Accuracy | None = None  # errors between measured places; None where `accuracy` has all

    @classmethod
    def of(
        cls, found: Deviations, places: HeldOutPlaces, trusted: Mask, fitted: Index, away: Index
    ) -> HeldOut:
        """Return the errors of P held-out poses, those with a suspected reading left out.

        Args:
            trusted: (P,) which of them have none.
            fitted, away: readings behind each pose fitted, and behind each held out (P,).
        """
        rows, beside = places.counted(trusted), places.between
        where = UNSEEN if places.unseen is not None else BETWEEN if beside is not None else ""
        between = None
        if where == UNSEEN and beside is not None and (beside & trusted).any():
            between = summarise(found, beside & trusted)
        return cls(
            accuracy=summarise(found, rows),
            repeats=float(np.mean(1.0 / fitted) / np.mean(1.0 / away[rows])),
            suspected=int((~trusted).sum()),
            where=where,
            between=between,
        )


def held_out_errors(
    model: FittedModel,
    every: Observations,
    fitted: Observations,
    held_out: Observations,
    position: Array,
    cov: Array,
) -> HeldOut:
    """Return the errors of held-out poses, with what they are to be compared with.

    Those with a suspected reading do not count, unless all have one.

    Args:
        fitted, held_out: averaged poses, P of them held out.
        position: (P, c, k) derivative of the predicted positions of those held out [m].
        cov: (k, k) of the parameters.
    """
    # The evaluation tells suspected readings by the same rule.
    single, used = every.of_kind("holdout"), every.of_kind("grid")
    far, _ = far_from_prediction(model.as_modelled(single), model, model.as_modelled(used))
    suspected = np.bincount(reading_groups(single), far) > 0.0
    rest = ~suspected | suspected.all()
    places = HeldOutPlaces.of(held_out, fitted)
    off = HeldOut.of(model.deviations(held_out), places, rest, fitted.readings, held_out.readings)
    position = position[places.counted(rest)]
    variance = np.einsum("pck,kl,pcl->p", position, cov, position, optimize=True)
    return replace(off, u_mm=float(1e3 * np.sqrt(np.mean(np.maximum(variance, 0.0)))))


def with_own_scatter(
    observations: Observations[Pose], readings: Observations[Pose], model: Model, x: Array
) -> Observations[Pose]:
    """Give averaged poses the covariance that single readings show about the model.

    What a reading's own joint angles and torques explain is taken off first: a servo that stops a
    little elsewhere each time is no error, while the noise of torques and resolvers is one.

    Args:
        readings: the single readings; where nothing was repeated, `observations` stay as they are.
    """
    average = average_repeats(readings)
    expected = model.predict(readings.states, x)
    at_average = model.predict(average.states, x)[reading_groups(readings)]
    explained = readings.with_measured(
        T_instr_target=readings.measured.T_instr_target @ np.linalg.inv(expected) @ at_average
    )
    return with_repeat_scatter(observations, explained)


def propagate(
    at_solution: TwoLevelRows,
    observations: Observations[Pose],
    inner_rows: NDArray[np.intp],
    tolerance_rows: Array,
    r_max_m: float,
    u_apparatus_m: float,
) -> Array:
    """Propagate the errors of the measured poses to the estimate.

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
    through = J.transpose(0, 2, 1).copy()  # (N, k, 6): what e_i does to the outer gradient
    base_influence = np.zeros((len(J), 6, 6))
    inner = by_base[inner_rows]
    hessian = np.einsum("nij,nik->jk", inner, inner)
    base_influence[inner_rows] = -np.linalg.solve(hessian, inner.transpose(0, 2, 1))
    crossed = np.einsum("nij,nik->jk", J, by_base)
    through += crossed @ base_influence
    influence = -normal_inverse @ through
    base_influence = base_influence + at_solution.base_jacobian @ influence
    unit = np.concatenate([np.full(3, 1.0 / r_max_m), np.ones(3)])
    noise = observations.measured.cov * np.outer(unit, unit)
    common = observations.measured.by_apparatus * unit[:, None]
    both = np.concatenate([influence, base_influence], axis=1)
    both[:, k : k + 3] = at_solution.T_instr_base[:3, :3].T @ both[:, k : k + 3]
    moved = u_apparatus_m * np.einsum("nai,nij->aj", both, common, optimize=True)
    covariance = np.einsum("nai,nij,nbj->ab", both, noise, both, optimize=True)
    return np.asarray(covariance + moved @ moved.T, dtype=np.float64)


# Parameters as readers know them.


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


# Does the stated uncertainty agree with what repeats scatter by?


def scatter_of_repeats(readings: Observations, model: FittedModel) -> tuple[RepeatScatter, ...]:
    """Compare successive readings of the same pose, load and direction of arrival.

    What joint positions and torques of a reading explain is taken off by the model; what drifts
    slowly or depends on the direction of arrival is no noise. The median decides, so that gross
    errors do not.

    Args:
        readings: single readings of the poses fitted.

    Returns:
        One entry a kind of components; none where too little is repeated, and none of a kind whose
        repeats agree in every digit that is written while others differ: it is rounded.
    """
    arrival = np.unique(readings.states.arrival, axis=0, return_inverse=True)[1].ravel()
    group = reading_groups(readings) * (arrival.max(initial=0) + 1) + arrival
    order = np.lexsort((readings.states.time_s, group))
    at = np.flatnonzero(group[order][1:] == group[order][:-1])
    if len(at) < GRADES.scatter_pairs:
        return ()
    poses = model.as_modelled(readings)
    measured = poses.measured
    T_instr_ee = model.T_instr_base @ model.model.predict(poses.states, model.x)
    residual = measured.compare(T_instr_ee, model.targets_m).residual
    variance = np.diagonal(measured.stated_covariance, axis1=1, axis2=2)
    first, second = order[at], order[at + 1]
    both = measured.components_seen[first] & measured.components_seen[second]
    difference, stated = residual[second] - residual[first], variance[second] + variance[first]
    found, rounded = [], measured.rounded_kinds(difference, both)
    for kind, columns in measured.component_kinds:
        if kind in rounded:
            continue
        seen = both[:, columns]
        squares = difference[:, columns][seen] ** 2
        if seen.any(axis=1).sum() < GRADES.scatter_pairs:
            continue
        size = float(np.sqrt(0.5 * np.median(stated[:, columns][seen])))
        ratio = np.sqrt(np.median(squares / stated[:, columns][seen]) / GRADES.median_square)
        found.append(
            RepeatScatter(kind=kind, found=float(ratio) * size, stated=size, pairs=len(at))
        )
    return tuple(found)
