"""Whether a calibration is good: what it rests on, what it leaves open, in one plain line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.design import PoseDesign, pose_design, poses_wanted
from pa10cal.calibration.identifiability import Identifiability
from pa10cal.terms.term import Parameter

Array = NDArray[np.float64]

#: Correlation above which two parameters can hardly be told apart, and how many pairs to list.
_CORRELATED = 0.95
_MOST_PAIRS = 20
#: Part of the error left that uncertainty of the model may come to: it then adds 5 % to it.
_SMALL_SHARE = 0.3
#: Held-out over training error above which the model follows its own poses.
_OVERFITTED = 1.3
#: Condition number in scaled parameters above which some direction is told badly.
_ILL_CONDITIONED = 1e5


@dataclass(frozen=True)
class Ended:
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
        open_parameters: names of those that the data leave open.
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
    open_parameters: frozenset[str]


@dataclass(frozen=True)
class CorrelatedPair:
    """Two parameters that the poses can hardly tell apart."""

    first: str
    second: str
    correlation: float


@dataclass(frozen=True)
class Health:
    """What a reader should look at before trusting a calibration.

    Attributes:
        ended: how it ended.
        verdict: `good`, `usable` (with what the line says in mind) or `not usable`.
        line: why, in one sentence.
        pairs: correlated parameters, the worst first.
        train_rms_mm, held_out_rms_mm: position error left; None where nothing was held out.
        noise_mm: what the noise of the readings explains of the former, None where not known.
        design: how many poses it wants.
        poses: how many it had.
        poses_wanted: how many well-chosen ones would do, None where more than were tried.
        u_model_mm: expected standard uncertainty of a predicted position.
        u_wanted_mm: the uncertainty that counts as small here.
    """

    ended: Ended
    verdict: Literal["good", "usable", "not usable"]
    line: str
    pairs: tuple[CorrelatedPair, ...]
    train_rms_mm: float
    held_out_rms_mm: float | None
    noise_mm: float | None
    design: PoseDesign
    poses: int
    poses_wanted: int | None
    u_model_mm: float
    u_wanted_mm: float


def health(
    ended: Ended,
    train_rms_mm: float,
    held_out_rms_mm: float | None,
    noise_mm: float | None,
    doubted: int = 0,
) -> Health:
    """Judge a calibration.

    Args:
        ended: how it ended.
        train_rms_mm: root mean square position error of the poses fitted.
        held_out_rms_mm: the same of poses held out.
        noise_mm: the same that the noise of readings explains.
        doubted: poses far outside the scatter of the others.
    """
    rank = ended.identifiability.rank
    design = pose_design(
        ended.white, ended.position, np.array([p.scale for p in ended.parameters]), rank
    )
    u_wanted_mm = _SMALL_SHARE * train_rms_mm
    verdict, line = _verdict(ended, train_rms_mm, held_out_rms_mm, noise_mm, design, doubted)
    return Health(
        ended=ended,
        verdict=verdict,
        line=line,
        pairs=_correlated(ended),
        train_rms_mm=train_rms_mm,
        held_out_rms_mm=held_out_rms_mm,
        noise_mm=noise_mm,
        design=design,
        poses=len(ended.white),
        poses_wanted=poses_wanted(design, 1e-3 * u_wanted_mm),
        u_model_mm=1e3 * design.u_all_m,
        u_wanted_mm=u_wanted_mm,
    )


def _verdict(
    ended: Ended,
    train_rms_mm: float,
    held_out_rms_mm: float | None,
    noise_mm: float | None,
    design: PoseDesign,
    doubted: int,
) -> tuple[Literal["good", "usable", "not usable"], str]:
    if not ended.converged:
        return "not usable", f"it did not converge: {ended.reason}"
    error = f"error left {train_rms_mm:.3f} mm rms over the poses fitted"
    if held_out_rms_mm is not None:
        error += f", {held_out_rms_mm:.3f} mm over those held out"
    if not np.isfinite(design.u_all_m):
        return "not usable", "too few poses for its unknowns"
    but = []
    names = sorted(ended.open_parameters)
    if names:
        but.append(
            f"these poses leave {', '.join(names[:4])}{' and others' if names[4:] else ''} open"
        )
    if ended.at_bound:
        but.append(f"{', '.join(ended.at_bound)} at the end of the physical range")
    if ended.identifiability.condition > _ILL_CONDITIONED:
        but.append(f"condition number {ended.identifiability.condition:.1e}")
    if held_out_rms_mm is not None and held_out_rms_mm > _OVERFITTED * train_rms_mm:
        but.append("poses held out are predicted worse than those fitted: too few poses, or others")
    if 1e3 * design.u_all_m > _SMALL_SHARE * train_rms_mm:
        but.append(
            f"predicted positions are uncertain by {1e3 * design.u_all_m:.3f} mm: more poses help"
        )
    if noise_mm is not None and train_rms_mm > 3.0 * noise_mm:
        but.append(
            f"the noise of the readings explains {noise_mm:.3f} mm of it: an effect is missing"
        )
    if doubted:
        but.append(f"{doubted} {'pose is' if doubted == 1 else 'poses are'} doubted, see the list")
    if but:
        return "usable", f"{error}; but {'; '.join(but)}"
    return "good", f"{error}; all {ended.identifiability.rank} unknowns are told by the poses"


def _correlated(ended: Ended) -> tuple[CorrelatedPair, ...]:
    std = np.sqrt(np.diag(ended.covariance))
    names = [parameter.name for parameter in ended.parameters]
    known = np.flatnonzero(
        (std > 0) & np.array([name not in ended.open_parameters for name in names])
    )
    correlation = ended.covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    first, second = np.nonzero(np.triu(np.abs(correlation) > _CORRELATED, 1))
    sizes = correlation[first, second]
    worst = np.argsort(-np.abs(sizes))[:_MOST_PAIRS]
    return tuple(
        CorrelatedPair(names[known[first[k]]], names[known[second[k]]], float(sizes[k]))
        for k in worst
    )
