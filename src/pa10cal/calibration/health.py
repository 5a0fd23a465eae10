"""Whether a calibration is good: its convergence, rank, errors and grade, and what all record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.statics import reported_name
from pa10cal.arrays import Array
from pa10cal.calibration.calibrate import Solution
from pa10cal.calibration.general.fit import Fit
from pa10cal.calibration.grade import SMALL_SHARE, Errors, Evidence, FitSummary, HeldOut, graded
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.uncertainty import summarise
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.identifiability import observability, unidentified_directions
from pa10cal.fit.model_file import model_to_plain
from pa10cal.numerics.exchange import Information, one_by_one
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Deviations
from pa10cal.results.calibration import CalibratedParameter, Covariance
from pa10cal.results.evaluation import ResidualRows
from pa10cal.results.health import CorrelatedPair, ExpectedUncertainty, Health, PosesNeeded
from pa10cal.results.record import Campaign
from pa10cal.terms.joint_spring import stiffness_by_solved

#: Correlation above which two parameters are nearly inseparable, and how many pairs to list.
_CORRELATED = 0.95
_MOST_PAIRS = 20


def health(ended: FitSummary, errors: Errors) -> Health:
    """Judge a calibration by its convergence and its remaining errors."""
    poses = poses_needed(ended, SMALL_SHARE * errors.train_rms_mm)
    u_model_mm = float("inf") if poses.u_model_mm is None else poses.u_model_mm
    evidence, away = Evidence(ended, errors, u_model_mm), errors.held_out
    grade, line, findings = graded(evidence)
    return Health(
        grade=grade,
        line=line,
        converged=ended.converged,
        reason=ended.reason,
        iterations=ended.iterations,
        at_bounds=tuple(map(reported_name, ended.at_bound)),
        rank=ended.identifiability.rank,
        unknowns=len(ended.parameters),
        condition=ended.identifiability.condition,
        not_identifiable=tuple(sorted(map(reported_name, ended.not_identifiable))),
        correlated_pairs=_correlated(ended),
        train_rms_mm=errors.train_rms_mm,
        held_out_rms_mm=None if away is None else away.accuracy.rms_mm,
        noise_mm=errors.noise_mm,
        error_over_noise=evidence.over_noise,
        held_out_over_expected=evidence.over_expected,
        repeats=errors.repeats,
        findings=findings,
        poses=poses,
    )


def held_out_errors(
    deviations: Deviations,
    fitted: Observations,
    held_out: Observations,
    position: Array,
    cov: Array,
    suspected: NDArray[np.bool_] | None = None,
) -> HeldOut:
    """Return the errors of held-out poses, with what they are to be compared with.

    Args:
        deviations: of the P poses held out.
        fitted, held_out: averaged poses.
        position: (P, c, k) derivative of the predicted positions of those held out [m].
        cov: (k, k) of the parameters.
        suspected: (P,) which of them have a suspected reading; those do not count, unless all
            have one. None for none.
    """
    if suspected is not None and suspected.any() and not suspected.all():
        rest = ~suspected
        found = held_out_errors(
            deviations.take(rest), fitted, held_out.take(rest), position[rest], cov
        )
        return replace(found, suspected=int(suspected.sum()))
    variance = np.einsum("pck,kl,pcl->p", position, cov, position, optimize=True)
    return HeldOut(
        accuracy=summarise(deviations),
        u_mm=float(1e3 * np.sqrt(np.mean(np.maximum(variance, 0.0)))),
        repeats=float(np.mean(1.0 / fitted.readings) / np.mean(1.0 / held_out.readings)),
    )


def fit_keys(
    ended: Solution | Fit,
    model: FittedModel,
    parameters: Mapping[str, CalibratedParameter],
    names: Sequence[str],
    covariance: Array,
) -> dict[str, Any]:
    """Return what a record holds of every fit.

    Args:
        ended: where it ended.
        model: the fitted model, and what it was fitted to.
        parameters: all parameters by name.
        names: of those of the covariance.
        covariance: (k, k) theirs.
    """
    return {
        "status": "converged" if ended.converged else "not converged",
        "reason": ended.reason,
        "cost": ended.cost,
        "iterations": ended.iterations,
        "parameters": parameters,
        "covariance": Covariance(names=tuple(names), matrix=covariance),
        "T_instr_base": model.T_instr_base,
        "fitted_model": model_to_plain(model),
    }


def case_keys(
    campaign: Campaign,
    load: str,
    options: CalibrationOptions,
    ended: FitSummary,
    found: Health,
    model: FittedModel,
    grid: Observations,
) -> dict[str, Any]:
    """Return what the record of a load case holds whatever the model.

    Args:
        campaign: whose it is.
        load: the load case.
        options: what it was computed with.
        ended: how the fit ended.
        found: whether it is good.
        model: the fitted model, and what it was fitted to.
        grid: grid poses of every load, as the model takes them.
    """
    identified, left = ended.identifiability, model.deviations(grid)
    return {
        "campaign": campaign.name,
        "provenance": campaign.provenance,
        "robot": campaign.robot,
        "load": load,
        "loads_fitted": () if model.fitted_to is None else model.fitted_to.loads_N,
        "rank": identified.rank,
        "unknowns": len(ended.parameters),
        "condition": identified.condition,
        "singular_values": identified.singular_values,
        "null_directions": unidentified_directions(identified, ended.parameters),
        "observability": observability(identified, len(ended.pose)),
        # place, position and rotation residual along base axes
        "residuals": ResidualRows(
            pose=grid.pose,
            load_N=grid.states.load_N,
            place_mm=1e3 * model.model.predict(grid.states, model.x)[:, :3, 3],
            position_mm=left.position_mm,
            rotation_deg=left.rotation_deg,
        ),
        "health": found,
        "seconds": None,
        "settings": options.model_dump(mode="json"),
    }


def _correlated(ended: FitSummary) -> tuple[CorrelatedPair, ...]:
    """Return pairs of reported parameters: of a spring, its stiffness."""
    solved = [parameter.name for parameter in ended.parameters]
    known = np.flatnonzero(
        (np.diag(ended.covariance) > 0)
        & np.array([name not in ended.not_identifiable for name in solved])
    )
    by_solved = stiffness_by_solved(solved, ended.x)
    covariance = by_solved @ ended.covariance @ by_solved.T
    std = np.sqrt(np.diag(covariance))
    names = list(map(reported_name, solved))
    correlation = covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    first, second = np.nonzero(np.triu(np.abs(correlation) > _CORRELATED, 1))
    sizes = correlation[first, second]
    worst = np.argsort(-np.abs(sizes))[:_MOST_PAIRS]
    return tuple(
        CorrelatedPair(
            parameters=(names[known[first[k]]], names[known[second[k]]]),
            correlation=float(sizes[k]),
        )
        for k in worst
    )


# How many poses a calibration needs: D-optimal order, and expected uncertainty by their number.
#
# A pose adds its information J^T J, whatever was read there. Taken in the order in which the
# determinant grows fastest, the measured poses show with how few of them the model would have been
# known nearly as well (D-optimality; Sun and Hollerbach, 2008, compare such criteria).

#: Poses to choose from and poses chosen at most: more would change no curve that one can see.
_POOL = 1000
_MOST = 200
#: Expected size of a parameter in its scale, which makes information definite before it is full.
_POSSIBLE_SCALES = 30.0


def poses_needed(ended: FitSummary, u_needed_mm: float) -> PosesNeeded:
    """Order the poses of a fit by their information, and tell how many an uncertainty takes.

    Args:
        ended: how the fit ended.
        u_needed_mm: standard uncertainty of a predicted position to reach, root mean square over
            all poses.
    """
    white, scale = ended.white, np.array([parameter.scale for parameter in ended.parameters])
    count, scales = len(white), np.outer(scale, scale)
    pool = np.unique(np.linspace(0, count - 1, min(count, _POOL)).round().astype(np.intp))
    information = np.eye(len(scale)) / _POSSIBLE_SCALES**2
    candidates = Information(white[pool] * scale * _POSSIBLE_SCALES)
    order = pool[one_by_one(candidates, min(len(pool), _MOST))]
    spread = _gram(ended.position) * scales / count
    enough = -(-ended.identifiability.rank // white.shape[1])

    def u_mm(of_poses: Array) -> float | None:
        if len(of_poses) < enough:
            return None
        covariance = np.linalg.inv(information + _gram(of_poses) * scales)
        u_m = float(np.sqrt(np.sum(covariance * spread)))
        return 1e3 * u_m if np.isfinite(u_m) else None

    numbers = np.unique(np.geomspace(1, len(order), 40).round().astype(np.intp)).tolist()
    expected = [
        ExpectedUncertainty(poses=n, u_optimal_mm=optimal, u_measured_mm=u_mm(white[:n]))
        for n in numbers
        if (optimal := u_mm(white[order[:n]])) is not None
    ]
    few = (each.poses for each in expected if each.u_optimal_mm <= u_needed_mm)
    return PosesNeeded(
        measured=count,
        needed=next(few, None),
        u_needed_mm=u_needed_mm,
        u_model_mm=u_mm(white),
        d_optimal_order=tuple(ended.pose[order].tolist()),
        expected=tuple(expected),
    )


def _gram(rows: Array) -> Array:
    """Return the products (k, k) of the rows (P, b, k) of all poses."""
    flat = rows.reshape(-1, rows.shape[2])
    found: Array = flat.T @ flat
    return found
