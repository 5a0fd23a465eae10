"""Whether a calibration is good: its convergence, rank and errors, and its grade."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.statics import reported_name
from pa10cal.arrays import Array, Index
from pa10cal.calibration.grade import SMALL_SHARE, Departure, Evidence, graded
from pa10cal.calibration.uncertainty import ScatterOfRepeats, summarise
from pa10cal.fit.identifiability import Identifiability
from pa10cal.numerics.exchange import Criterion, Share, one_by_one
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Deviations
from pa10cal.results.evaluation import Accuracy
from pa10cal.results.health import (
    CorrelatedPair,
    ExpectedUncertainty,
    Health,
    InputFinding,
    PosesNeeded,
    RepeatScatter,
)
from pa10cal.terms.joint_spring import stiffness_by_solved
from pa10cal.terms.term import Parameter

#: Correlation above which two parameters are nearly inseparable, and how many pairs to list.
_CORRELATED = 0.95
_MOST_PAIRS = 20


@dataclass(frozen=True)
class FitSummary:
    """How a fit ended, whichever fit it was."""

    converged: bool  # whether it stopped at a stationary point
    reason: str  # why it stopped
    iterations: int  # steps taken
    at_bound: tuple[str, ...]  # names of parameters at the end of their physical range
    pose: NDArray[np.str_]  # (P,) labels of the poses fitted
    parameters: tuple[Parameter, ...]  # the k parameters it was solved in
    covariance: Array  # (k, k) theirs
    identifiability: Identifiability  # rank of the rows
    white: Array  # (P, b, k) rows of unit variance
    position: Array  # (P, c, k) derivative of the predicted position [m]
    not_identifiable: frozenset[str]  # names of those that the data do not identify
    x: Array  # (k,) values of the parameters
    # names of those that no pose of this instrument can determine
    hidden: frozenset[str] = frozenset()
    # names of those that the mounting of base or tool moves as well, so that they say nothing of
    # how the arm was built
    of_mounting: frozenset[str] = frozenset()


@dataclass(frozen=True)
class HeldOut:
    """Remaining errors of held-out poses."""

    accuracy: Accuracy  # the errors
    u_mm: float | None = None  # standard uncertainty of the predictions there; None where not known
    repeats: float = 1.0  # readings behind a held-out pose over those behind a fitted one
    suspected: int = 0  # further held-out poses, with a suspected reading, that do not count


@dataclass(frozen=True)
class Errors:
    """Remaining errors of a calibrated model."""

    # root mean square position error of the poses fitted, suspected outliers aside
    train_rms_mm: float
    held_out: HeldOut | None  # errors of poses held out, None where there are none
    noise_mm: float | None  # the part that the noise of readings explains, None where not known
    spread_mm: float  # root mean square distance of the measured positions from their mean
    suspected_outliers: int = 0  # poses far outside the scatter of the others
    # whether that noise is what readings scatter by, and not what is stated
    noise_is_found: bool = False
    # error that the targets' places on an apparatus leave in all poses alike
    apparatus_mm: float = 0.0
    # what repeats show of the stated uncertainty, by kind
    repeats: tuple[ScatterOfRepeats, ...] = ()
    findings: tuple[InputFinding, ...] = ()  # what checks of the input found
    # the same as `train_rms_mm` with rigid joints; None where the model has no springs
    without_springs_mm: float | None = None
    weights: str = ""  # where weights come from that nobody stated; else nothing


def health(ended: FitSummary, errors: Errors) -> Health:
    """Judge a calibration by its convergence and its remaining errors."""
    design = pose_design(
        ended.white,
        ended.position,
        np.array([p.scale for p in ended.parameters]),
        ended.identifiability.rank,
    )
    evidence = _evidence(ended, errors, design)
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
        held_out_rms_mm=evidence.held_out_rms_mm,
        noise_mm=errors.noise_mm,
        error_over_noise=evidence.over_noise,
        held_out_over_expected=evidence.over_expected,
        repeats=tuple(
            RepeatScatter(kind=each.kind, found=each.found, stated=each.stated, pairs=each.pairs)
            for each in evidence.repeats
        ),
        findings=findings,
        poses=_poses_needed(design, SMALL_SHARE * errors.train_rms_mm, ended.pose),
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


def _evidence(ended: FitSummary, errors: Errors, design: PoseDesign) -> Evidence:
    """Return what the grade rests on."""
    held_out = errors.held_out
    std = np.sqrt(np.maximum(np.diag(ended.covariance), 0.0))
    return Evidence(
        converged=ended.converged,
        reason=ended.reason,
        train_rms_mm=errors.train_rms_mm,
        held_out_rms_mm=None if held_out is None else held_out.accuracy.rms_mm,
        held_out=0 if held_out is None else held_out.accuracy.configurations,
        held_out_u_mm=None if held_out is None else held_out.u_mm,
        held_out_repeats=1.0 if held_out is None else held_out.repeats,
        held_out_suspected=0 if held_out is None else held_out.suspected,
        noise_mm=errors.noise_mm,
        repeats=errors.repeats,
        noise_is_found=errors.noise_is_found,
        apparatus_mm=errors.apparatus_mm,
        u_model_mm=1e3 * design.u_all_m,
        poses=len(ended.white),
        rows=int(np.count_nonzero(np.any(ended.white != 0.0, axis=2))),
        rank=ended.identifiability.rank,
        unknowns=len(ended.parameters),
        condition=ended.identifiability.condition,
        undetermined=tuple(sorted(ended.not_identifiable - ended.hidden)),
        at_bound=ended.at_bound,
        departures=tuple(
            Departure(each.name, float(value) / each.tolerance, float(sigma) / each.tolerance)
            for each, value, sigma in zip(ended.parameters, ended.x, std, strict=True)
            if each.tolerance
            and each.name not in ended.not_identifiable
            and each.name not in ended.of_mounting
        ),
        spread_mm=errors.spread_mm,
        suspected_outliers=errors.suspected_outliers,
        findings=errors.findings,
        without_springs_mm=errors.without_springs_mm,
        weights=errors.weights,
    )


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


@dataclass(frozen=True)
class PoseDesign:
    """Expected uncertainty of the model by the number of poses of this kind."""

    order: Index  # poses in D-optimal order, as rows, the first the most telling
    numbers: Index  # (m,) numbers of poses
    # (m,) expected standard uncertainty of a predicted position, root mean square over all poses,
    # with the first of `order`; inf where they are too few
    u_optimal_m: Array
    u_measured_m: Array  # (m,) the same with the first of the poses in the order measured
    u_all_m: float


def pose_design(white: Array, position: Array, scale: Array, unknowns: int) -> PoseDesign:
    """Order poses by their information.

    Args:
        white: (P, b, k) rows of every pose, of unit variance.
        position: (P, c, k) derivative of the predicted position [m].
        scale: (k,) typical size of each parameter.
        unknowns: parameters that all poses together identify.
    """
    count = len(white)
    scales = np.outer(scale, scale)
    pool = np.unique(np.linspace(0, count - 1, min(count, _POOL)).round().astype(np.intp))
    information = np.eye(len(scale)) / _POSSIBLE_SCALES**2
    criterion = Criterion(white[pool] * scale * _POSSIBLE_SCALES, [Share(1.0, len(scale))])
    order = pool[one_by_one(criterion, min(len(pool), _MOST))]
    spread = _gram(position) * scales / count
    numbers = np.unique(np.geomspace(1, len(order), 40).round().astype(np.intp))
    enough = -(-unknowns // white.shape[1])

    def expected(of_poses: Array) -> float:
        if len(of_poses) < enough:
            return float("inf")
        covariance = np.linalg.inv(information + _gram(of_poses) * scales)
        return float(np.sqrt(np.sum(covariance * spread)))

    return PoseDesign(
        order=order,
        numbers=numbers,
        u_optimal_m=np.array([expected(white[order[:n]]) for n in numbers]),
        u_measured_m=np.array([expected(white[:n]) for n in numbers]),
        u_all_m=expected(white),
    )


def _gram(rows: Array) -> Array:
    """Return the products (k, k) of the rows (P, b, k) of all poses."""
    flat = rows.reshape(-1, rows.shape[2])
    found: Array = flat.T @ flat
    return found


def poses_needed(design: PoseDesign, u_needed_m: float) -> int | None:
    """Return the least number of well-chosen poses with that uncertainty; None where more."""
    enough = np.flatnonzero(design.u_optimal_m <= u_needed_m)
    return int(design.numbers[enough[0]]) if len(enough) else None


def _poses_needed(design: PoseDesign, u_needed_mm: float, pose: NDArray[np.str_]) -> PosesNeeded:
    finite = np.isfinite(design.u_optimal_m)
    both = finite & np.isfinite(design.u_measured_m)
    u_model_mm = 1e3 * design.u_all_m
    return PosesNeeded(
        measured=len(pose),
        needed=poses_needed(design, 1e-3 * u_needed_mm),
        u_needed_mm=u_needed_mm,
        u_model_mm=u_model_mm if np.isfinite(u_model_mm) else None,
        d_optimal_order=tuple(pose[design.order].tolist()),
        expected=tuple(
            ExpectedUncertainty(
                poses=int(number),
                u_optimal_mm=1e3 * float(design.u_optimal_m[k]),
                u_measured_mm=1e3 * float(design.u_measured_m[k]) if both[k] else None,
            )
            for k, number in enumerate(design.numbers)
            if finite[k]
        ),
    )
