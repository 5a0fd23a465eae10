"""Tooling balls of every configuration: located, checked against the tool, with covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.campaign.grouping import LEAST_TOUCHES, unusable_balls
from pa10cal.campaign.spheres import Spheres, fit_spheres, pooled_touch_sigma_mm, touch_sigma_mm
from pa10cal.campaign.strays import find_strays
from pa10cal.errors import RawDataError
from pa10cal.frame.rigid_fit import fit_rigid

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Balls further than this from where the description puts them are other balls.
TOOL_MISFIT_MM = 1.0
#: Touches further from the middle of their configuration than so many sizes of the tool are stray.
FAR_OFF = 2.0
#: Configurations from which the tool's shape is learnt rather than believed.
ENOUGH_FOR_SHAPE = 5

UNDECIDED = "the touches do not fit the tool, and no single one is to blame"


@dataclass(frozen=True)
class TouchedTool:
    """What is known of the balls and the probe.

    Attributes:
        names: names of the B balls.
        p_ee_balls_mm: (B, 3) their centres in the end-effector frame.
        radius_mm: their radius.
        centre_uncertainty_mm: standard uncertainty of one measured centre, per axis.
        stray_sigma: a touch further off than this many sigmas of one touch is a stray.
    """

    names: tuple[str, ...]
    p_ee_balls_mm: Array
    radius_mm: float
    centre_uncertainty_mm: float
    stray_sigma: float


@dataclass(frozen=True)
class LocatedBalls:
    """Ball centres of C configurations.

    Attributes:
        p_instr_mm: (C, B, 3) centres.
        cov_mm2: (C, B, 3, 3) their covariances.
        used: (C, B, T) touches used.
        stray: (C, B, T) touches found astray.
        reason: (C,) why a configuration cannot be used; "" where it can.
        touch_sigma_mm: standard uncertainty of one touch, from the instrument's statement.
        pooled_sigma_mm: standard deviation of one touch, from the residuals of all spheres.
    """

    p_instr_mm: Array
    cov_mm2: Array
    used: Mask
    stray: Mask
    reason: NDArray[np.object_]
    touch_sigma_mm: float
    pooled_sigma_mm: float


def locate_balls(p_instr_mm: Array, valid: Mask, tool: TouchedTool, where: str) -> LocatedBalls:
    """Find the centres of all balls and the touches that are astray.

    Args:
        p_instr_mm: (C, B, T, 3) touches, padded.
        valid: (C, B, T) which of them are there.
        tool: the balls and the probe.
        where: file of the touches, for messages.

    Raises:
        RawDataError: when touches in general do not lie on spheres of this radius, or the balls
            are not those of the tool.
    """
    stray = _far_off(p_instr_mm, valid, tool)
    near = valid & ~stray
    spheres = _fit(p_instr_mm, near, tool)
    _refuse_flat(spheres, where)
    reason = unusable_balls(near, spheres.coplanar.reshape(valid.shape[:2]), tool.names)
    whole = np.flatnonzero(reason == "")
    sigma_mm = pooled_mm = float("nan")
    if len(whole):
        spheres = _fit(p_instr_mm[whole], near[whole], tool)
        sigma_mm = touch_sigma_mm(spheres, tool.centre_uncertainty_mm)
        limit_mm = tool.stray_sigma * sigma_mm
        _refuse_other_radius(spheres, limit_mm, tool, where)
        shape_mm = _shape(spheres.centre_mm.reshape(len(whole), -1, 3), tool, where)
        strays = find_strays(
            p_instr_mm[whole], near[whole], shape_mm, tool.radius_mm, limit_mm, sigma_mm
        )
        stray[whole] |= strays.touch
        reason[whole[strays.undecided]] = UNDECIDED
    used = valid & ~stray
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
        stray=stray,
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
        allowed=f"within {limit_mm:.3g} mm, {tool.stray_sigma:g} sigmas of one touch",
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
        raise RawDataError(
            f"the measured balls are not placed as the description says; ball "
            f"{tool.names[int(off.argmax())]} is {off.max():.3g} mm off",
            where=where,
            allowed=f"within {TOOL_MISFIT_MM:g} mm of tool.balls_mm",
            remedy="check tool.balls_mm and the names of the balls",
        )
    return seen if len(p_instr_mm) >= ENOUGH_FOR_SHAPE else nominal
