"""Whether a calibration is good: its convergence, rank and errors, and a verdict in one line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.accuracy import Accuracy
from pa10cal.calibration.design import PoseDesign, pose_design, poses_needed
from pa10cal.fit.identifiability import Identifiability
from pa10cal.terms.term import Parameter

Array = NDArray[np.float64]

#: Correlation above which two parameters are nearly inseparable, and how many pairs to list.
_CORRELATED = 0.95
_MOST_PAIRS = 20
#: Largest uncertainty of the model as part of the remaining error: it then adds 5 % to it.
_SMALL_SHARE = 0.3
#: Held-out over expected error above which the model follows its own poses, at least; with few
#: held-out poses so many standard deviations of their root mean square.
_OVERFITTED = 1.3
_BY_CHANCE = 3.0
#: Largest error of a calibrated arm as part of the spread of the measured positions.
_FITS_NOT = 0.01
#: Smallest part of the unknowns that poses must identify.
_LEAST_IDENTIFIED = 2.0 / 3.0
#: Condition number in scaled parameters above which some direction is poorly determined.
_ILL_CONDITIONED = 1e5


@dataclass(frozen=True)
class FitSummary:
    """How a fit ended, whichever fit it was.

    Attributes:
        converged: whether it stopped at a stationary point.
        reason: why it stopped.
        iterations: steps taken.
        at_bound: names of parameters at the end of their physical range.
        parameters: the k parameters it was solved in.
        covariance: (k, k) theirs.
        identifiability: rank of the rows.
        white: (P, b, k) rows of unit variance.
        position: (P, c, k) derivative of the predicted position [m].
        not_identifiable: names of those that the data do not identify.
    """

    converged: bool
    reason: str
    iterations: int
    at_bound: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    covariance: Array
    identifiability: Identifiability
    white: Array
    position: Array
    not_identifiable: frozenset[str]


@dataclass(frozen=True)
class Errors:
    """Remaining errors of a calibrated model.

    Attributes:
        train_rms_mm: root mean square position error of the poses fitted, suspected outliers
            aside.
        held_out: errors of poses held out, None where there are none.
        noise_mm: the part that the noise of readings explains, None where not known.
        spread_mm: root mean square distance of the measured positions from their mean.
        suspected_outliers: poses far outside the scatter of the others.
    """

    train_rms_mm: float
    held_out: Accuracy | None
    noise_mm: float | None
    spread_mm: float
    suspected_outliers: int = 0


@dataclass(frozen=True)
class CorrelatedPair:
    """Two parameters that the poses can hardly separate."""

    first: str
    second: str
    correlation: float


@dataclass(frozen=True)
class Health:
    """What a reader should look at before trusting a calibration.

    Attributes:
        ended: how it ended.
        verdict: `good`, `usable` (subject to the line) or `not usable`.
        line: the reason, in one sentence.
        pairs: correlated parameters, the worst first.
        train_rms_mm, held_out_rms_mm: remaining position error; None where nothing was held out.
        noise_mm: the part that the noise of the readings explains, None where not known.
        design: how many poses it needs.
        poses: how many it had.
        poses_needed: how many well-chosen ones suffice, None where more than were tried.
        u_model_mm: expected standard uncertainty of a predicted position.
        u_needed_mm: the uncertainty that counts as small here.
    """

    ended: FitSummary
    verdict: Literal["good", "usable", "not usable"]
    line: str
    pairs: tuple[CorrelatedPair, ...]
    train_rms_mm: float
    held_out_rms_mm: float | None
    noise_mm: float | None
    design: PoseDesign
    poses: int
    poses_needed: int | None
    u_model_mm: float
    u_needed_mm: float


def health(ended: FitSummary, errors: Errors) -> Health:
    """Judge a calibration by its convergence and its remaining errors."""
    design = pose_design(
        ended.white,
        ended.position,
        np.array([p.scale for p in ended.parameters]),
        ended.identifiability.rank,
    )
    u_needed_mm = _SMALL_SHARE * errors.train_rms_mm
    verdict, line = _verdict(ended, errors, design)
    return Health(
        ended=ended,
        verdict=verdict,
        line=line,
        pairs=_correlated(ended),
        train_rms_mm=errors.train_rms_mm,
        held_out_rms_mm=None if errors.held_out is None else errors.held_out.rms_mm,
        noise_mm=errors.noise_mm,
        design=design,
        poses=len(ended.white),
        poses_needed=poses_needed(design, 1e-3 * u_needed_mm),
        u_model_mm=1e3 * design.u_all_m,
        u_needed_mm=u_needed_mm,
    )


def _verdict(
    ended: FitSummary, errors: Errors, design: PoseDesign
) -> tuple[Literal["good", "usable", "not usable"], str]:
    rank, unknowns = ended.identifiability.rank, len(ended.parameters)
    if not ended.converged:
        return "not usable", f"it did not converge: {ended.reason}"
    error = f"remaining error {errors.train_rms_mm:.3f} mm rms over the poses fitted"
    if errors.held_out is not None:
        error += f", {errors.held_out.rms_mm:.3f} mm over held-out poses"
    if errors.train_rms_mm > _FITS_NOT * errors.spread_mm:
        return "not usable", (
            f"{error}: the arm as described does not fit the readings; check robot, order, signs "
            "and zeros of the joints, and units"
        )
    if rank < _LEAST_IDENTIFIED * unknowns:
        return "not usable", (
            f"{error}; but the poses identify only {rank} of {unknowns} unknowns, so predictions "
            "at other poses are unreliable"
        )
    if not np.isfinite(design.u_all_m):
        return "not usable", "too few poses to identify the unknowns"
    but = _reservations(ended, errors, design)
    if but:
        return "usable", f"{error}; but {'; '.join(but)}"
    return "good", f"{error}; all {rank} unknowns are identifiable"


def _reservations(ended: FitSummary, errors: Errors, design: PoseDesign) -> list[str]:
    """Return the reservations about a usable calibration."""
    but = []
    names = sorted(ended.not_identifiable)
    if names:
        but.append(
            f"not identifiable with these poses: {', '.join(names[:4])}"
            f"{' and others' if names[4:] else ''}"
        )
    # A linear spring at its bound is a joint as rigid as the readings can show: no fault.
    at_end = [name for name in ended.at_bound if not name.startswith("windup")]
    if at_end:
        but.append(f"{', '.join(at_end)} at the end of the physical range")
    if ended.identifiability.condition > _ILL_CONDITIONED:
        but.append(f"condition number {ended.identifiability.condition:.1e}")
    if errors.held_out is not None and errors.held_out.rms_mm > _expected_mm(
        ended, errors, errors.held_out, design
    ):
        but.append(
            "held-out poses have larger errors than expected: they differ from the poses fitted, "
            "or the model is missing an effect"
        )
    if 1e3 * design.u_all_m > _SMALL_SHARE * errors.train_rms_mm:
        but.append(
            f"predicted positions have a standard uncertainty of {1e3 * design.u_all_m:.3f} mm; "
            "measure more poses to reduce it"
        )
    if errors.noise_mm is not None and errors.train_rms_mm > 3.0 * errors.noise_mm:
        but.append(
            f"the noise of the readings explains only {errors.noise_mm:.3f} mm: the model is "
            "missing an effect"
        )
    if errors.suspected_outliers:
        many = "s are" if errors.suspected_outliers > 1 else " is"
        but.append(
            f"{errors.suspected_outliers} suspected outlier{many} excluded; "
            "see tables/suspected_outliers"
        )
    return but


def _expected_mm(
    ended: FitSummary, errors: Errors, held_out: Accuracy, design: PoseDesign
) -> float:
    """Return the largest error of held-out poses that is to be expected.

    Residuals are smaller than errors by the leverage; predictions add the fit's uncertainty.
    """
    rows = int(np.count_nonzero(np.any(ended.white != 0.0, axis=2)))
    taken_up = min(ended.identifiability.rank / max(rows, 1), 0.9)
    expected_mm = np.hypot(errors.train_rms_mm / np.sqrt(1.0 - taken_up), 1e3 * design.u_all_m)
    by_chance = 1.0 + _BY_CHANCE / np.sqrt(2.0 * held_out.configurations)
    return float(expected_mm * max(_OVERFITTED, by_chance))


def _correlated(ended: FitSummary) -> tuple[CorrelatedPair, ...]:
    std = np.sqrt(np.diag(ended.covariance))
    names = [parameter.name for parameter in ended.parameters]
    known = np.flatnonzero(
        (std > 0) & np.array([name not in ended.not_identifiable for name in names])
    )
    correlation = ended.covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    first, second = np.nonzero(np.triu(np.abs(correlation) > _CORRELATED, 1))
    sizes = correlation[first, second]
    worst = np.argsort(-np.abs(sizes))[:_MOST_PAIRS]
    return tuple(
        CorrelatedPair(names[known[first[k]]], names[known[second[k]]], float(sizes[k]))
        for k in worst
    )
