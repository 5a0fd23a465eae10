"""Warnings about lists given to a model that look misread: units, quaternions, seeds.

A list is not refused, since it may be meant as it is. A warning needs that the numbers disagree
with the model as read, and mostly that they agree with it when read another way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.arrays import Array
from pa10cal.fit.fitted import Compensation, Fitted
from pa10cal.fit.forward import T_flange_frame, pose_difference
from pa10cal.rules import LISTS

_TURN = 2.0 * np.pi
_REACHED = ("ok", "near_singular")
_ORDER = "qw, qx, qy, qz: the quaternions look like x, y, z, w under these names"
_RENAMED = "name the columns qx,qy,qz,qw if so"


def of_joints(model: Fitted, q: Array) -> Iterator[str]:
    """Yield warnings about joint positions (N, n) of a list in degrees, compared with the fit."""
    as_radians = _read_as_radians(model, q)
    if as_radians is None or model.seen is None:
        return
    to_joints = model.arm.coupling.to_joints
    is_beyond = model.inside(to_joints(q)).mean() <= LISTS.few_share
    # Radians read as degrees are a few degrees about zero, which a fit may cover: there the same
    # numbers as radians have to be a wide motion.
    moves_wide = len(q) >= LISTS.rows and np.median(np.ptp(as_radians, axis=0)) > LISTS.wide_rad
    if (is_beyond or moves_wide) and model.inside(to_joints(as_radians)).mean() > LISTS.most_share:
        as_degrees = "beyond the angles of the fit" if is_beyond else "hardly a motion"
        yield (
            f"{_turning_columns(model)}: the joint positions look like radians under columns "
            f"in degrees: all are within ±6.3, {as_degrees} as degrees and inside those of the "
            "fit as radians; multiply them by 57.29578 if so"
        )


def of_targets(model: Fitted, T: Array, seed: Array, frame: str) -> Iterator[str]:
    """Yield warnings about targets (N, 4, 4) and their seeds (N, n), nan where there is none."""
    rows = np.flatnonzero(np.isfinite(seed).all(axis=1))
    if not len(rows):
        return
    T, seed, reach_m = T[rows], seed[rows], model.arm.reach_m
    T_flange = T_flange_frame(model, frame)

    def distances(q: Array, wanted: Array) -> tuple[Array, Array]:
        """Return distances and angles (N,) of the nominal frame at seeds from targets."""
        joints = model.arm.coupling.to_joints(q)
        off = pose_difference(Chain.of(model.arm).forward(joints) @ T_flange, wanted)
        return np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)

    off_m, off_rad = distances(seed, T)
    as_radians = _read_as_radians(model, seed)
    if as_radians is not None and np.median(off_m) > LISTS.near_of_reach * reach_m:
        other_m = np.median(distances(as_radians, T)[0])
        if other_m < LISTS.nearer_share * np.median(off_m):
            yield (
                f"{_turning_columns(model)}: the seeds look like radians under columns in "
                f"degrees: they are {1e3 * np.median(off_m):.0f} mm from their targets as degrees "
                f"and {1e3 * other_m:.0f} mm as radians; multiply them by 57.29578 if so"
            )
            return
    far = off_m > LISTS.far_of_reach * reach_m
    if far.mean() > LISTS.most_share:
        far_mm = 1e3 * LISTS.far_of_reach * reach_m
        yield (
            f"{_columns(model)}: {far.sum()} of {len(far)} seeds contradict their targets: at "
            f"these joint positions the {frame} is more than half the reach "
            f"({far_mm:.0f} mm) from the target; check the units and the order of the "
            "joints, the frame, and that targets are in the robot's base frame"
        )
    elif np.median(off_rad) > LISTS.alike_rad:
        other_rad = np.median(distances(seed, _scalar_last(T))[1])
        if other_rad < LISTS.nearer_share * np.median(off_rad):
            yield (
                f"{_ORDER}: at the seeds the {frame} is turned by {np.degrees(other_rad):.1f}° "
                f"from the targets so, and by {np.degrees(np.median(off_rad)):.0f}° as given; "
                f"{_RENAMED}"
            )


def of_answers(
    T: Array, found: Compensation, compensated: Callable[[Array], Compensation]
) -> Iterator[str]:
    """Yield warnings about targets (N, 4, 4) of which few are reached by their compensation.

    Args:
        found: the compensation of the targets as read.
        compensated: compensates targets (N, 4, 4) read otherwise, under the same conditions and
            from the same seeds.
    """
    reached = _reached(found)
    if reached.mean() >= LISTS.most_share:
        return
    reached_then = _reached(compensated(_scalar_last(T)))
    if reached_then.mean() >= max(LISTS.nearly_all_share, LISTS.times_as_many * reached.mean()):
        yield (
            f"{_ORDER}: {reached_then.sum()} of {len(T)} targets are then reached within the "
            f"angles of the fit, and {reached.sum()} as given; {_RENAMED}"
        )


def _columns(model: Fitted) -> str:
    """Return the names of the columns of joint positions in a list."""
    slides = model.arm.axes_slide
    first, last = ("mm" if slides[k] else "deg" for k in (0, -1))
    return f"q1_{first} … q{len(slides)}_{last}"


def _turning_columns(model: Fitted) -> str:
    """Return the names of the columns of joints that turn."""
    slides = model.arm.axes_slide
    if not slides.any():
        return _columns(model)
    return ", ".join(f"q{k + 1}_deg" for k in np.flatnonzero(~slides))


def _reached(found: Compensation) -> NDArray[np.bool_]:
    """Return which targets are reached where the fit covers the joint positions, (N,)."""
    return np.asarray(np.isin(found.status, _REACHED) & found.inside)


def _scalar_last(T: Array) -> Array:
    """Return poses (N, 4, 4) whose quaternions were read scalar first, read scalar last."""
    T_other = T.copy()
    numbers = Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True)
    T_other[:, :3, :3] = Rotation.from_quat(numbers).as_matrix()
    return T_other


def _read_as_radians(model: Fitted, q: Array) -> Array | None:
    """Return positions (N, n) with the same numbers read as radians; None where they cannot be."""
    turning = ~model.arm.axes_slide
    numbers = np.where(turning, np.degrees(q), q)
    within = np.abs(numbers[:, turning]) <= _TURN
    return numbers if turning.any() and within.all() and numbers.any() else None
