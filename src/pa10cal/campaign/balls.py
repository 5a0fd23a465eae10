"""Tooling balls of every configuration: touches gathered, centres with covariance, checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, Index, Mask
from pa10cal.campaign.description import CampaignDescription
from pa10cal.campaign.nominal_fit import exchange_text, stated_shape
from pa10cal.campaign.raw_rows import RawRows
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
class LocatedBalls:
    """Ball centres of C configurations."""

    p_instr_mm: Array  # (C, B, 3) centres
    cov_mm2: Array  # (C, B, 3, 3) their covariances
    used: Mask  # (C, B, T) touches used
    outlier: Mask  # (C, B, T) touches suspected to be outliers
    reason: NDArray[np.object_]  # (C,) why a configuration cannot be used; "" where it can


def locate_balls(
    p_instr_mm: Array,
    valid: Mask,
    campaign: CampaignDescription,
    outlier_sigma: float,
    where: str,
) -> LocatedBalls:
    """Find the centres of all balls and the suspected outliers of touches (C, B, T, 3), padded.

    Touches that in general do not lie on spheres of this diameter are refused, and other balls than
    those of the tool. A touch is an outlier where it is more than `outlier_sigma` standard
    uncertainties of a touch off its ball; `where` names the file in messages.
    """
    C, B, T = valid.shape
    radius_mm, names = 0.5 * float(campaign.ball_diameter_mm or np.nan), campaign.ball_names

    def fit(rows: Index | slice, of: Mask) -> Spheres:
        return fit_spheres(p_instr_mm[rows].reshape(-1, T, 3), of[rows].reshape(-1, T), radius_mm)

    # Touches further from their configuration's median than the tool is large.
    between = campaign.p_ee_balls_mm[:, None] - campaign.p_ee_balls_mm
    size_mm = float(np.linalg.norm(between, axis=2).max()) + 2.0 * radius_mm
    there = np.where(valid[..., None], p_instr_mm, np.nan)
    middle = np.nanmedian(there.reshape(C, -1, 3), axis=1)
    distance: Array = np.linalg.norm(p_instr_mm - middle[:, None, None, :], axis=3)
    outlier = valid & (distance > FAR_OFF * size_mm)
    near = valid & ~outlier
    spheres = fit(slice(None), near)
    flat = spheres.coplanar[spheres.touches >= LEAST_TOUCHES]
    if 2 * flat.sum() > len(flat):
        raise RawDataError(
            f"the touches on {flat.sum()} of {len(flat)} balls lie in one plane, seen at the "
            "scale of the stated diameter",
            where=where,
            allowed="touches all around each ball, in millimetres",
            remedy="check the unit of x_mm, y_mm, z_mm, and ball_diameter_mm",
        )
    reason = unusable_balls(near, spheres.coplanar.reshape(C, B), names)
    whole = np.flatnonzero(reason == "")
    sigma_mm = float("nan")
    if len(whole):
        spheres = fit(whole, near)
        sigma_mm = touch_sigma_mm(spheres, campaign.instrument.uncertainty_mm)
        limit_mm = outlier_sigma * sigma_mm
        worst_mm = np.median(np.abs(spheres.residual_mm).max(axis=1))
        if worst_mm > limit_mm:  # the radius or the unit then, not single touches
            value = f"typically {worst_mm:.3g} mm off a sphere of {2 * radius_mm:g} mm"
            raise RawDataError(
                "the touches do not lie on spheres of the stated diameter",
                where=where,
                value=value,
                allowed=f"within {limit_mm:.3g} mm, {outlier_sigma:g} sigmas of one touch",
                remedy="check ball_diameter_mm, the unit of x_mm, y_mm, z_mm, the compensation of "
                "the probe's radius, and instrument.uncertainty_mm",
            )
        shape_mm = _shape(spheres.centre_mm.reshape(len(whole), -1, 3), campaign, where)
        touch, undecided = find_outliers(
            p_instr_mm[whole], near[whole], shape_mm, radius_mm, limit_mm, sigma_mm
        )
        outlier[whole] |= touch
        reason[whole[undecided]] = UNDECIDED
    used = valid & ~outlier
    spheres = fit(slice(None), used)
    without = unusable_balls(used, spheres.coplanar.reshape(C, B), names)
    return LocatedBalls(
        p_instr_mm=spheres.centre_mm.reshape(C, B, 3),
        cov_mm2=sigma_mm**2 * spheres.cofactor.reshape(C, B, 3, 3),
        used=used,
        outlier=outlier,
        reason=np.where(reason == "", without, reason),
    )


def _shape(p_instr_mm: Array, campaign: CampaignDescription, where: str) -> Array:
    """Return the balls' places on the tool (B, 3): the median over all configurations."""
    nominal, names = campaign.p_ee_balls_mm, campaign.ball_names
    T = fit_rigid(nominal, p_instr_mm).T
    on_tool = (p_instr_mm - T[:, None, :3, 3]) @ T[:, :3, :3]
    seen = np.median(on_tool, axis=0)
    off = np.linalg.norm(seen - nominal, axis=1)
    if off.max() > TOOL_MISFIT_MM:
        shape = stated_shape(p_instr_mm, nominal)
        remedy = "check tool.balls_mm and the names of the balls"
        if shape is not None and shape.order is not None:
            swapped = exchange_text(shape.order, names)
            remedy = f"balls {swapped} seem exchanged: exchange their places or their names"
        worst = names[int(off.argmax())]
        raise RawDataError(
            f"the measured positions of the balls differ from the description; ball {worst} is "
            f"{off.max():.3g} mm off",
            where=where,
            allowed=f"within {TOOL_MISFIT_MM:g} mm of tool.balls_mm",
            remedy=remedy,
        )
    return seen if len(p_instr_mm) >= ENOUGH_FOR_SHAPE else nominal


@dataclass(frozen=True)
class TouchGroups:
    """Touches of C configurations on B balls, padded to T a ball."""

    of_touch: Index  # (N,) configuration of every touch
    first: Index  # (C,) first touch of every configuration, which names it
    row: Index  # (C, B, T) touch, 0 where there is none
    valid: Mask  # (C, B, T) where there is one


def group_touches(touches: RawRows, balls: int) -> TouchGroups:
    """Gather touches, which are in order of time, by configuration and number of the ball."""
    of_touch = touches.configurations
    count = int(of_touch.max(initial=-1)) + 1
    key = of_touch * balls + touches["ball"]
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
    """Return (C,) why balls cannot all be located of touches (C, B, T); "" where they can."""
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


# Tooling balls as spheres of known radius, and single touches that cannot be on theirs.
#
# Centres are fitted by least squares, all balls at once. A single ball with few touches cannot
# show which of them is an outlier (of two opposite ones either may be), nor that one is where it
# alone fixes one direction. All touches of a configuration together can: they must lie on balls
# that sit on one rigid tool, six unknowns for all of them.

#: Touches within so small a part of the radius (rms) of one plane count as coplanar.
COPLANAR = 0.05
STEP_TOLERANCE_MM = 1e-10
MAX_ITERATIONS = 50
#: The same for the fit of a rigid tool, its damping, and its largest step [mm, rad].
TOOL_ITERATIONS = 30
TOOL_TOLERANCE_MM = 1e-9
DAMPING = 1e-9
LARGEST_STEP = np.array([20.0, 20.0, 20.0, 0.1, 0.1, 0.1])
#: A touch that others leave less than this part of its redundancy cannot be judged.
LEAST_REDUNDANCY = 1e-3


@dataclass(frozen=True)
class Spheres:
    """Spheres through the touches of G balls."""

    centre_mm: Array  # (G, 3) centres
    # (G, T) distance of each touch outside its sphere; 0 where there is no touch
    residual_mm: Array
    # (G, 3, 3) covariance of the centre for touches of unit variance, the inverse of the normal
    # matrix of the touches' normals
    cofactor: Array
    touches: NDArray[np.int64]  # (G,) touches used
    # (G,) whether the touches lie in one plane, so that the centre is not determined
    coplanar: Mask


def fit_spheres(p_mm: Array, valid: Mask, radius_mm: float) -> Spheres:
    """Fit spheres of known radius to touches (G, T, 3), padded, by least squares (Gauss-Newton).

    The start is the linear fit of a sphere of free radius, which four touches not in one plane
    determine. Where `coplanar`, centres and residuals are of no use.
    """
    weight = valid.astype(float)
    count = valid.sum(axis=1)
    mean = (weight[..., None] * p_mm).sum(axis=1) / np.maximum(count, 1)[:, None]
    offset = weight[..., None] * (p_mm - mean[:, None, :])
    scatter = np.swapaxes(offset, 1, 2) @ offset
    square = (offset**2).sum(axis=2)
    moment = (offset * square[..., None]).sum(axis=1)
    thickness = np.sqrt(np.linalg.eigvalsh(scatter)[:, 0].clip(min=0.0) / np.maximum(count, 1))
    inverse = np.linalg.pinv(scatter, rcond=1e-4, hermitian=True)
    centre = mean + 0.5 * (inverse @ moment[..., None])[..., 0]
    coplanar = thickness < COPLANAR * radius_mm
    for _ in range(MAX_ITERATIONS):
        normals, residual, cofactor = _linearise(p_mm, weight, centre, radius_mm)
        step = (cofactor @ (normals * residual[..., None]).sum(axis=1)[..., None])[..., 0]
        step[coplanar] = 0.0
        length = np.linalg.norm(step, axis=1, keepdims=True)
        centre = centre + step * np.minimum(1.0, radius_mm / np.maximum(length, 1e-12))
        if np.abs(step).max(initial=0.0) <= STEP_TOLERANCE_MM:
            break
    _, residual, cofactor = _linearise(p_mm, weight, centre, radius_mm)
    return Spheres(centre, residual, cofactor, count, coplanar)


def touch_sigma_mm(spheres: Spheres, centre_uncertainty_mm: float) -> float:
    """Return the standard uncertainty of one touch that an instrument's statement implies.

    The instrument states u, the standard uncertainty of one measured centre along an axis. Touches
    of sigma s give a centre the covariance s² times its cofactor; s is chosen so that the variance
    of the median ball, averaged over the axes, is u². A ball with fewer touches than the others, or
    with touches on one side, is thus less certain than the statement, one with more is more so.
    """
    variance = np.median(np.trace(spheres.cofactor, axis1=1, axis2=2)) / 3.0
    return float(centre_uncertainty_mm / np.sqrt(variance))


def _from_centres(
    p_mm: Array, weight: Array, centre: Array, radius_mm: float
) -> tuple[Array, Array]:
    """Return outward normals and residuals of touches; both 0 where there is none."""
    ray = p_mm - centre[..., None, :]
    distance = np.linalg.norm(ray, axis=-1)
    normals = weight[..., None] * ray / np.maximum(distance, 1e-12)[..., None]
    return normals, weight * (distance - radius_mm)


def _linearise(
    p_mm: Array, weight: Array, centre: Array, radius_mm: float
) -> tuple[Array, Array, Array]:
    """Return outward normals, residuals and the cofactor of the centre."""
    normals, residual = _from_centres(p_mm, weight, centre, radius_mm)
    normal_matrix = np.swapaxes(normals, 1, 2) @ normals
    # A touch too few or a plane makes it singular; such balls are refused by count and plane.
    inverse = np.linalg.inv(normal_matrix + 1e-12 * np.eye(3))
    return normals, residual, np.asarray(inverse, dtype=np.float64)


def find_outliers(
    p_mm: Array, valid: Mask, balls_mm: Array, radius_mm: float, limit_mm: float, sigma_mm: float
) -> tuple[Mask, Mask]:
    """Find touches that do not lie on the balls of a rigid tool, omitting each in turn.

    A configuration is suspect when a touch is further off than `limit_mm`, as judged by the other
    touches. Each of its touches is then omitted in turn: the outlier is the one without which the
    rest fits. When the rest fits without another one too, the better must be better by as many
    sigmas as the limit has, or the configuration is undecided.

    Args:
        p_mm: (C, B, T, 3) touches, padded.
        valid: (C, B, T) which of them are there; every ball must have a determined centre.
        balls_mm: (B, 3) centres in the tool's frame.
        radius_mm: radius of the balls.
        limit_mm: largest departure that noise of a touch, `sigma_mm`, is allowed.

    Returns:
        (C, B, T) suspected outliers; (C,) configurations that do not fit the tool, no one touch
        being to blame.
    """
    C, B, T = valid.shape
    fits, _ = _fits(p_mm, valid, balls_mm, radius_mm, limit_mm, sigma_mm)
    touch = np.zeros(valid.shape, dtype=bool)
    undecided = np.zeros(C, dtype=bool)
    suspects = np.flatnonzero(~fits)
    if not len(suspects):
        return touch, undecided
    owner, out = np.nonzero(valid[suspects].reshape(len(suspects), B * T))
    others = valid[suspects][owner].reshape(-1, B * T)
    others[np.arange(len(owner)), out] = False
    fits, misfit = _fits(
        p_mm[suspects][owner], others.reshape(-1, B, T), balls_mm, radius_mm, limit_mm, sigma_mm
    )
    misfits = np.full((len(suspects), B * T), np.inf)
    misfits[owner[fits], out[fits]] = misfit[fits]
    best = np.argmin(misfits, axis=1)
    ranked = np.sort(misfits, axis=1)
    found = np.isfinite(ranked[:, 0])
    found[found] = (ranked[found, 1] - ranked[found, 0]) > (limit_mm / sigma_mm) ** 2
    undecided[suspects] = ~found
    touch.reshape(C, B * T)[suspects[found], best[found]] = True
    return touch, undecided


def _fits(
    p_mm: Array, valid: Mask, balls_mm: Array, radius_mm: float, limit_mm: float, sigma_mm: float
) -> tuple[Mask, Array]:
    """Return (C,) whether every touch fits the tool, and the chi-square of the fit."""
    C, B, T = valid.shape
    spheres = fit_spheres(p_mm.reshape(C * B, T, 3), valid.reshape(C * B, T), radius_mm)
    pose = fit_rigid(balls_mm, spheres.centre_mm.reshape(C, B, 3)).T
    R, origin = pose[:, :3, :3], pose[:, :3, 3]
    weight = valid.astype(float)
    for _ in range(TOOL_ITERATIONS):
        jacobian, residual = _linearise_tool(p_mm, weight, R, origin, balls_mm, radius_mm)
        transposed = np.swapaxes(jacobian, 1, 2)
        # Far from a fit the normal matrix may be singular and the step wild: damped and bounded.
        cofactor = np.linalg.inv(transposed @ jacobian + DAMPING * np.eye(6))
        step = (cofactor @ (transposed @ residual[..., None]))[..., 0]
        step /= np.maximum(1.0, np.abs(step / LARGEST_STEP).max(axis=1, keepdims=True))
        R = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ R
        origin = origin + step[:, :3]
        if np.abs(step).max() <= TOOL_TOLERANCE_MM:
            break
    jacobian, residual = _linearise_tool(p_mm, weight, R, origin, balls_mm, radius_mm)
    redundancy = 1.0 - np.einsum("cti,cij,ctj->ct", jacobian, cofactor, jacobian)
    judged = valid.reshape(C, B * T) & (redundancy > LEAST_REDUNDANCY)
    departure = np.abs(residual) / np.sqrt(np.where(judged, redundancy, 1.0))
    fits = np.where(judged, departure, 0.0).max(axis=1) <= limit_mm
    return fits, np.square(residual).sum(axis=1) / sigma_mm**2


def _linearise_tool(
    p_mm: Array, weight: Array, R: Array, origin: Array, balls_mm: Array, radius_mm: float
) -> tuple[Array, Array]:
    """Return residuals, after their derivative (C, BT, 6) by small motions (dp, w) of the tool."""
    arm = balls_mm @ np.swapaxes(R, 1, 2)
    normal, residual = _from_centres(p_mm, weight, origin[:, None, :] + arm, radius_mm)
    turning = np.cross(np.broadcast_to(arm[:, :, None, :], normal.shape), normal)
    C = len(p_mm)
    return np.concatenate([normal, turning], axis=-1).reshape(C, -1, 6), residual.reshape(C, -1)
