"""What contradicts itself in lists given to a model: units of joints, quaternions, seeds.

Each is a warning and no refusal: the list may be meant so. It is given only where another reading
of the same numbers agrees with the model and the one taken does not.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.arrays import Array
from pa10cal.fit.fitted import Compensation, Fitted
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import T_flange_frame, pose_difference
from pa10cal.rules import LISTS

_TURN = 2.0 * np.pi
_REACHED = ("ok", "near_singular")


def of_joints(model: Fitted, q: Array) -> Iterator[str]:
    """Yield what contradicts the fit in joint positions (N, n) that a list gave in degrees."""
    as_radians = _read_as_radians(model, q)
    if as_radians is None or model.seen is None:
        return
    # A program that keeps to a few degrees about zero is within a fit that came through there.
    to_joints = model.arm.coupling.to_joints
    beyond = model.inside(to_joints(q)).mean() <= LISTS.few_share
    hardly_moves = len(q) >= LISTS.rows and np.median(np.ptp(as_radians, axis=0)) > LISTS.wide_rad
    if (beyond or hardly_moves) and model.inside(to_joints(as_radians)).mean() > LISTS.most_share:
        as_degrees = "beyond the angles of the fit" if beyond else "hardly a motion"
        yield (
            f"{_columns(model)}: the joint positions look like radians under columns in degrees: "
            f"all are within ±6.3, {as_degrees} as degrees and inside those of the fit as "
            "radians; multiply them by 57.29578 if so"
        )


def of_targets(model: Fitted, T: Array, seed: Array, frame: str) -> Iterator[str]:
    """Yield what contradicts targets (N, 4, 4) in their seeds (N, n), nan where there are none."""
    rows = np.flatnonzero(np.isfinite(seed).all(axis=1))
    if not len(rows):
        return
    T, seed, reach_m = T[rows], seed[rows], model.arm.reach_m
    T_flange = T_flange_frame(model, frame)

    def away(q: Array, wanted: Array) -> tuple[Array, Array]:
        joints = model.arm.coupling.to_joints(q)
        off = pose_difference(Chain.of(model.arm).forward(joints) @ T_flange, wanted)
        return np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)

    off_m, off_rad = away(seed, T)
    as_radians = _read_as_radians(model, seed)
    if as_radians is not None and np.median(off_m) > LISTS.near_share * reach_m:
        other_m = np.median(away(as_radians, T)[0])
        if other_m < LISTS.nearer_share * np.median(off_m):
            yield (
                f"{_columns(model)}: the seeds look like radians under columns in degrees: they "
                f"are {1e3 * np.median(off_m):.0f} mm from their targets as degrees and "
                f"{1e3 * other_m:.0f} mm as radians; multiply them by 57.29578 if so"
            )
            return
    far = off_m > LISTS.far_share * reach_m
    if far.mean() > LISTS.most_share:
        far_mm = 1e3 * LISTS.far_share * reach_m
        yield (
            f"{_columns(model)}: {far.sum()} of {len(far)} seeds contradict their targets: at "
            f"these joint positions the {frame} is more than half the reach "
            f"({far_mm:.0f} mm) from the target; check the units and the order of the "
            "joints, the frame, and that targets are in the robot's base frame"
        )
    elif np.median(off_rad) > LISTS.alike_rad:
        other_rad = np.median(away(seed, _scalar_last(T))[1])
        if other_rad < LISTS.nearer_share * np.median(off_rad):
            yield (
                f"{_ORDER}: at the seeds the {frame} is turned by {np.degrees(other_rad):.1f}° "
                f"from the targets so, and by {np.degrees(np.median(off_rad)):.0f}° as given; "
                f"{_RENAMED}"
            )


def of_answers(
    model: FittedModel, T: Array, found: Compensation, frame: str, load_N: Array
) -> Iterator[str]:
    """Yield what contradicts targets (N, 4, 4) in what became of them, as where few are reached."""
    good = _good(found)
    if good.mean() >= LISTS.most_share:
        return
    other = model.compensate(_scalar_last(T), frame=frame, load_N=load_N, extrapolate=True)
    reached = _good(other)
    if reached.mean() >= max(LISTS.nearly_all_share, LISTS.times_as_many * good.mean()):
        yield (
            f"{_ORDER}: {reached.sum()} of {len(T)} targets are then reached within the angles of "
            f"the fit, and {good.sum()} as given; {_RENAMED}"
        )


_ORDER = "qw, qx, qy, qz: the quaternions look like x, y, z, w under these names"
_RENAMED = "name the columns qx,qy,qz,qw if so"


def _columns(model: Fitted) -> str:
    """Return the columns of joint positions in a list."""
    slides = model.arm.axes_slide
    first, last = ("mm" if slides[k] else "deg" for k in (0, -1))
    return f"q1_{first} … q{len(slides)}_{last}"


def _good(found: Compensation) -> NDArray[np.bool_]:
    return np.asarray(np.isin(found.status, _REACHED) & found.inside)


def _scalar_last(T: Array) -> Array:
    """Return poses (N, 4, 4) whose quaternions, written scalar first, are read scalar last."""
    other = T.copy()
    numbers = Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True)
    other[:, :3, :3] = Rotation.from_quat(numbers).as_matrix()
    return other


def _read_as_radians(model: Fitted, q: Array) -> Array | None:
    """Return positions (N, n) of the same numbers as radians; None where they can be none."""
    turning = ~model.arm.axes_slide
    numbers = np.where(turning, np.degrees(q), q)
    within = np.abs(numbers[:, turning]) <= _TURN
    return numbers if turning.any() and within.all() and numbers.any() else None
