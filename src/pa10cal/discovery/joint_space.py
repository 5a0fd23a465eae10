"""Residuals of the model as errors of joint angles, and how they depend on each joint's angle.

A picture of where to look, not a test: the angles of one cell are found from six numbers, so an
error that no joint makes shows in several of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array

#: Joint error thought possible, a standard deviation: where a pose cannot separate joints (at a
#: singular wrist, or with more joints than six) it decides, and the error found is that uncertain.
POSSIBLE_RAD = 1e-3
_LEAST_ORDER = 0.5
#: Highest order of the periodogram, in gear ratios of the joint.
_MOST_RATIOS = 2.5
#: Gear ratio by which that is counted where the arm's own is not known.
_USUAL_RATIO = 100.0
#: Steps of the periodogram within the width of a peak, one over the turns that the joint made.
_STEPS_A_PEAK = 5
_LARGEST_STEP = 0.25


@dataclass(frozen=True)
class JointErrors:
    """By how much further joints stand than the model says, in C cells."""

    error_rad: Array  # (C, n) joint angle error (m for a prismatic joint)
    std_rad: Array  # (C, n) its standard deviation by the noise of the cell

    @property
    def weight(self) -> Array:
        """(C, n) by which means over cells are weighted."""
        return np.asarray(self.std_rad**-2.0)


@dataclass(frozen=True)
class Periodogram:
    """How much of a joint's error goes with a sine of its angle, order by order."""

    orders: Array  # (F,) cycles a turn of the joint
    # (F,) root mean square of the error that a sine of that order explains, a constant left free
    # (generalised Lomb-Scargle periodogram)
    explained_rad: Array
    # orders where joints are known to err: once and twice a turn of the joint, once and twice a
    # turn of the motor
    marked: tuple[float, ...]
    marked_rad: Array  # what they explain


def joint_errors(screws: Array, left: Array) -> JointErrors:
    """Turn what the model leaves at every cell into errors of the joints, by least squares.

    Args:
        screws: (C, b, n) how whitened components follow the joints.
        left: (C, b, 1) components measured less predicted, whitened by the noise of each cell.
    """
    across = screws.transpose(0, 2, 1)
    covariance = np.linalg.inv(across @ screws + np.eye(screws.shape[2]) / POSSIBLE_RAD**2)
    return JointErrors(
        error_rad=(covariance @ (across @ left))[:, :, 0],
        std_rad=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
    )


def periodogram(
    q_rad: Array, error_rad: Array, weight: Array, gear_ratio: float
) -> Periodogram | None:
    """Return the periodogram of one joint's error by its angle, None where it hardly turned.

    Args:
        q_rad: (C,) joint angle of every cell.
        error_rad: (C,) joint angle error.
        weight: (C,) by which cells are weighted.
        gear_ratio: motor turns a joint turn; nan where not known.
    """
    turns = float(np.ptp(q_rad)) / (2.0 * np.pi)
    known = (gear_ratio, 2.0 * gear_ratio) if np.isfinite(gear_ratio) else ()
    highest = _MOST_RATIOS * max(gear_ratio if known else _USUAL_RATIO, 1.0)
    # An arc that is a small part of the finest cycle contains no information on any cycle.
    if turns * highest < 1.0:
        return None
    step = min(_LARGEST_STEP, 1.0 / (_STEPS_A_PEAK * turns))
    orders = np.arange(_LEAST_ORDER, highest + step, step)
    marked = tuple(sorted({1.0, 2.0, *map(float, known)}))
    share = weight / weight.sum()
    centred = error_rad - share @ error_rad
    variance = float(share @ centred**2)
    if variance == 0.0:
        return Periodogram(orders, np.zeros(len(orders)), marked, np.zeros(len(marked)))
    from scipy.signal import lombscargle  # late: blind trials draw no periodogram

    part = lombscargle(
        q_rad,
        centred,
        np.concatenate([orders, marked]),
        weights=share,
        normalize=True,
        floating_mean=True,
    )
    explained = np.sqrt(variance * np.clip(part, 0.0, 1.0))
    return Periodogram(orders, explained[: len(orders)], marked, explained[len(orders) :])
