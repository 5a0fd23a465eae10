"""Tooling balls of every configuration: touches gathered, centres with covariance, checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index, Mask
from pa10cal.campaign.labels import exchange_text, stated_shape
from pa10cal.campaign.rows import Touches
from pa10cal.campaign.spheres import (
    Spheres,
    find_outliers,
    fit_spheres,
    pooled_touch_sigma_mm,
    touch_sigma_mm,
)
from pa10cal.errors import RawDataError
from pa10cal.frame.rigid_fit import fit_rigid

#: Touches that a ball needs.
LEAST_TOUCHES = 4

#: Balls further than this from where the description puts them are other balls.
TOOL_MISFIT_MM = 1.0
#: Touches are outliers further from the middle of their configuration than so many tool sizes.
FAR_OFF = 2.0
#: Configurations from which the tool's shape is found rather than taken as stated.
ENOUGH_FOR_SHAPE = 5

UNDECIDED = "the touches do not fit the tool, and no single touch explains it"


@dataclass(frozen=True)
class TouchedTool:
    """What is known of the balls and the probe."""

    names: tuple[str, ...]  # names of the B balls
    p_ee_balls_mm: Array  # (B, 3) their centres in the end-effector frame
    radius_mm: float  # their radius
    centre_uncertainty_mm: float  # standard uncertainty of one measured centre, per axis
    outlier_sigma: float  # a touch further off than this many sigmas of one touch is an outlier


@dataclass(frozen=True)
class LocatedBalls:
    """Ball centres of C configurations."""

    p_instr_mm: Array  # (C, B, 3) centres
    cov_mm2: Array  # (C, B, 3, 3) their covariances
    used: Mask  # (C, B, T) touches used
    outlier: Mask  # (C, B, T) touches suspected to be outliers
    reason: NDArray[np.object_]  # (C,) why a configuration cannot be used; "" where it can
    touch_sigma_mm: float  # standard uncertainty of one touch, from the instrument's statement
    pooled_sigma_mm: float  # standard deviation of one touch, from the residuals of all spheres


def locate_balls(p_instr_mm: Array, valid: Mask, tool: TouchedTool, where: str) -> LocatedBalls:
    """Find the centres of all balls and the touches that are suspected outliers.

    Args:
        p_instr_mm: (C, B, T, 3) touches, padded.
        valid: (C, B, T) which of them are there.
        tool: the balls and the probe.
        where: file of the touches, for messages.

    Raises:
        RawDataError: when touches in general do not lie on spheres of this radius, or the balls
            are not those of the tool.
    """
    outlier = _far_off(p_instr_mm, valid, tool)
    near = valid & ~outlier
    spheres = _fit(p_instr_mm, near, tool)
    _refuse_flat(spheres, where)
    reason = unusable_balls(near, spheres.coplanar.reshape(valid.shape[:2]), tool.names)
    whole = np.flatnonzero(reason == "")
    sigma_mm = pooled_mm = float("nan")
    if len(whole):
        spheres = _fit(p_instr_mm[whole], near[whole], tool)
        sigma_mm = touch_sigma_mm(spheres, tool.centre_uncertainty_mm)
        limit_mm = tool.outlier_sigma * sigma_mm
        _refuse_other_radius(spheres, limit_mm, tool, where)
        shape_mm = _shape(spheres.centre_mm.reshape(len(whole), -1, 3), tool, where)
        outliers = find_outliers(
            p_instr_mm[whole], near[whole], shape_mm, tool.radius_mm, limit_mm, sigma_mm
        )
        outlier[whole] |= outliers.touch
        reason[whole[outliers.undecided]] = UNDECIDED
    used = valid & ~outlier
    spheres = _fit(p_instr_mm, used, tool)
    without = unusable_balls(used, spheres.coplanar.reshape(valid.shape[:2]), tool.names)
    reason = np.where(reason == "", without, reason)
    fit = np.repeat(reason == "", len(tool.names))
    if fit.any():
        pooled_mm = pooled_touch_sigma_mm(spheres.take(fit))
    C, B = valid.shape[:2]
    return LocatedBalls(
        p_instr_mm=spheres.centre_mm.reshape(C, B, 3),
        cov_mm2=sigma_mm**2 * spheres.cofactor.reshape(C, B, 3, 3),
        used=used,
        outlier=outlier,
        reason=reason,
        touch_sigma_mm=sigma_mm,
        pooled_sigma_mm=pooled_mm,
    )


def _fit(p_instr_mm: Array, valid: Mask, tool: TouchedTool) -> Spheres:
    C, B, T = valid.shape
    return fit_spheres(p_instr_mm.reshape(C * B, T, 3), valid.reshape(C * B, T), tool.radius_mm)


def _far_off(p_instr_mm: Array, valid: Mask, tool: TouchedTool) -> Mask:
    """Return touches further from their configuration's median than the tool is large."""
    between = tool.p_ee_balls_mm[:, None] - tool.p_ee_balls_mm
    size_mm = float(np.linalg.norm(between, axis=2).max()) + 2.0 * tool.radius_mm
    there = np.where(valid[..., None], p_instr_mm, np.nan)
    middle = np.nanmedian(there.reshape(len(valid), -1, 3), axis=1)
    distance: Array = np.linalg.norm(p_instr_mm - middle[:, None, None, :], axis=3)
    return valid & (distance > FAR_OFF * size_mm)


def _refuse_flat(spheres: Spheres, where: str) -> None:
    """Stop when the touches on most balls are flat at the scale of their diameter."""
    enough = spheres.touches >= LEAST_TOUCHES
    flat = spheres.coplanar[enough]
    if not flat.any() or 2 * flat.sum() <= len(flat):
        return
    raise RawDataError(
        f"the touches on {flat.sum()} of {len(flat)} balls lie in one plane, seen at the scale of "
        "the stated diameter",
        where=where,
        allowed="touches all around each ball, in millimetres",
        remedy="check the unit of x_mm, y_mm, z_mm, and ball_diameter_mm",
    )


def _refuse_other_radius(spheres: Spheres, limit_mm: float, tool: TouchedTool, where: str) -> None:
    """Stop when most spheres do not fit: then it is the radius or the unit, not single touches."""
    worst = np.abs(spheres.residual_mm).max(axis=1)
    if np.median(worst) <= limit_mm:
        return
    raise RawDataError(
        "the touches do not lie on spheres of the stated diameter",
        where=where,
        value=f"typically {np.median(worst):.3g} mm off a sphere of {2 * tool.radius_mm:g} mm",
        allowed=f"within {limit_mm:.3g} mm, {tool.outlier_sigma:g} sigmas of one touch",
        remedy="check ball_diameter_mm, the unit of x_mm, y_mm, z_mm, the compensation of the "
        "probe's radius, and instrument.uncertainty_mm",
    )


def _shape(p_instr_mm: Array, tool: TouchedTool, where: str) -> Array:
    """Return the balls' places on the tool (B, 3): the median over all configurations."""
    nominal = tool.p_ee_balls_mm
    T = fit_rigid(nominal, p_instr_mm).T
    on_tool = (p_instr_mm - T[:, None, :3, 3]) @ T[:, :3, :3]
    seen = np.median(on_tool, axis=0)
    off = np.linalg.norm(seen - nominal, axis=1)
    if off.max() > TOOL_MISFIT_MM:
        shape = stated_shape(p_instr_mm, nominal)
        order = None if shape is None else shape.order
        swapped = "" if order is None else exchange_text(order, tool.names)
        raise RawDataError(
            f"the measured positions of the balls differ from the description; ball "
            f"{tool.names[int(off.argmax())]} is {off.max():.3g} mm off",
            where=where,
            allowed=f"within {TOOL_MISFIT_MM:g} mm of tool.balls_mm",
            remedy=f"balls {swapped} seem exchanged: exchange their places or their names"
            if swapped
            else "check tool.balls_mm and the names of the balls",
        )
    return seen if len(p_instr_mm) >= ENOUGH_FOR_SHAPE else nominal


@dataclass(frozen=True)
class TouchGroups:
    """Touches of C configurations on B balls, padded to T a ball."""

    of_touch: Index  # (N,) configuration of every touch
    first: Index  # (C,) first touch of every configuration, which names it
    row: Index  # (C, B, T) touch, 0 where there is none
    valid: Mask  # (C, B, T) where there is one

    def __len__(self) -> int:
        return len(self.first)


def group_touches(touches: Touches, balls: int) -> TouchGroups:
    """Gather touches, which are in order of time, by configuration and ball."""
    of_touch = touches.configurations
    count = int(of_touch.max(initial=-1)) + 1
    key = of_touch * balls + touches.ball
    order = np.argsort(key, kind="stable")
    sizes = np.bincount(key, minlength=count * balls)
    place = np.arange(len(key)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    row = np.zeros((count * balls, int(sizes.max(initial=0))), dtype=np.intp)
    valid = np.zeros(row.shape, dtype=bool)
    row[key[order], place] = order
    valid[key[order], place] = True
    first = np.unique(of_touch, return_index=True)[1]
    shape = (count, balls, row.shape[1])
    return TouchGroups(of_touch, first, row.reshape(shape), valid.reshape(shape))


def commonest(of_touch: Index, dwell: Index) -> Index:
    """Return the dwell in which each configuration has most touches (the first of equals)."""
    pairs, counts = np.unique(np.column_stack([of_touch, dwell]), axis=0, return_counts=True)
    best_last = np.lexsort((-pairs[:, 1], counts, pairs[:, 0]))
    pairs = pairs[best_last]
    last = np.append(np.diff(pairs[:, 0]) > 0, True)
    return np.asarray(pairs[last, 1], dtype=np.intp)


def unusable_balls(valid: Mask, coplanar: Mask, names: tuple[str, ...]) -> NDArray[np.object_]:
    """Return (C,) why a configuration's balls cannot all be located; "" where they can.

    Args:
        valid: (C, B, T) touches that are there.
        coplanar: (C, B) balls whose touches lie in one plane.
        names: names of the balls.
    """
    count = valid.sum(axis=2)
    bad = (count < LEAST_TOUCHES) | coplanar
    reasons = np.full(len(valid), "", dtype=object)
    for c in np.flatnonzero(bad.any(axis=1)):
        b = int(np.argmax(bad[c]))
        if count[c, b] == 0:
            reasons[c] = f"ball {names[b]} of this configuration is missing"
        elif count[c, b] < LEAST_TOUCHES:
            reasons[c] = f"ball {names[b]} of this configuration has fewer than four touches"
        else:
            reasons[c] = f"the touches on ball {names[b]} of this configuration are coplanar"
    return reasons
