"""Tooling balls of every configuration: touches gathered, balls located, outliers found.

Centres are fitted by least squares. A single ball with few touches cannot show which touch is an
outlier (of two opposite touches either may be), nor that one is where it alone determines a
direction. All touches of a configuration together can: they must lie on balls of one rigid tool,
which has six unknowns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask, Rows, take_rows
from pa10cal.campaign.description import CampaignDescription
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.campaign.target_labels import exchange_text, stated_shape
from pa10cal.errors import RawDataError
from pa10cal.frame.knocked_targets import Knock, knocks_on_body
from pa10cal.frame.point_fits import Spheres, fit_rigid, fit_spheres, normals_and_residuals
from pa10cal.observe.quantities import MM

#: Touches that a ball needs.
LEAST_TOUCHES = 4
#: Balls further than this from their stated places are other balls.
TOOL_MISFIT_MM = 1.0
#: Touches further than so many tool sizes from the median of their configuration are outliers.
FAR_OFF = 2.0
#: With so many configurations the tool's shape is estimated rather than taken as stated.
ENOUGH_FOR_SHAPE = 5

#: A radius is off from so many standard errors of its mean, and by this part of a touch's standard
#: uncertainty.
RADIUS_ERRORS, RADIUS_PART = 6.0, 0.3
#: Standard error of a median over that of a mean.
MEDIAN_ERROR = 1.2533
#: A ball with less information on its radius than this, of 1 for each touch, says nothing of it.
LEAST_INFORMATION = 0.1

UNDECIDED = "the touches do not fit the tool, and no single touch explains it"


@dataclass(frozen=True)
class LocatedBalls:
    """Ball centres of C configurations."""

    p_instr_mm: Array  # (C, B, 3) centres
    cov_mm2: Array  # (C, B, 3, 3) their covariances
    used: Mask  # (C, B, T) touches used
    outlier: Mask  # (C, B, T) touches suspected to be outliers
    reason: NDArray[np.object_]  # (C,) why a configuration cannot be used; "" where it can
    remarks: tuple[str, ...]  # what the user should correct first, one sentence each

    def take(self, rows: Rows) -> LocatedBalls:
        """Return the balls of these configurations."""
        return take_rows(self, rows, "remarks")


def locate_balls(
    p_instr_mm: Array,
    valid: Mask,
    campaign: CampaignDescription,
    outlier_sigma: float,
    where: str,
    visits: Sequence[str],
) -> LocatedBalls:
    """Find the centres of all balls and the suspected outliers of touches (C, B, T, 3), padded.

    A radius that all touches show to be off is taken out, and outliers are sought with the shape
    that the tool had at that time, so that neither a wrong radius nor a knocked ball loses rows.

    Args:
        p_instr_mm: touches.
        valid: (C, B, T) which of them are no padding.
        campaign: states balls, diameter and instrument.
        outlier_sigma: a touch further off its ball than so many of its standard uncertainties is an
            outlier.
        where: the file, in messages.
        visits: (C,) the configurations in words, in order of time.

    Raises:
        RawDataError: when most touches do not lie on spheres of the stated diameter, or the balls
            are not those of the tool.
    """
    C, B, T = valid.shape
    radius_mm, names = 0.5 * float(campaign.ball_diameter_mm or np.nan), campaign.ball_names
    remarks: list[str] = []

    def fit(rows: Index | slice, touches: Mask) -> Spheres:
        p_mm, used = p_instr_mm[rows].reshape(-1, T, 3), touches[rows].reshape(-1, T)
        return fit_spheres(p_mm, used, radius_mm)

    outlier = _far_from_the_others(p_instr_mm, valid, campaign.p_ee_balls_mm, radius_mm)
    near = valid & ~outlier
    spheres = fit(slice(None), near)
    _refuse_flat(spheres, where)
    reason = unusable_balls(near, spheres.coplanar.reshape(C, B), names)
    whole = np.flatnonzero(reason == "")
    sigma_mm = float("nan")
    if len(whole):
        spheres = fit(whole, near)
        sigma_mm = touch_sigma_mm(spheres, campaign.instrument.uncertainty_mm)
        limit_mm = outlier_sigma * sigma_mm
        _refuse_other_spheres(spheres, radius_mm, limit_mm, outlier_sigma, where)
        touches_mm, touched = p_instr_mm[whole].reshape(-1, T, 3), near[whole].reshape(-1, T)
        off_mm, u_mm = _radius_off_mm(spheres, touches_mm, touched, radius_mm, sigma_mm)
        if off_mm:
            remarks.append(_radius_remark(off_mm, u_mm, radius_mm))
            radius_mm += off_mm
            spheres = fit(whole, near)
        centres_mm = spheres.centre_mm.reshape(len(whole), -1, 3)
        knocks = _knocked_balls(centres_mm, campaign.instrument.uncertainty_mm)
        knocked = tuple(_knock_remarks(knocks, names, [visits[c] for c in whole.tolist()]))
        remarks += knocked
        for part in np.split(np.arange(len(whole)), [knock.row for knock in knocks]):
            shape_mm = _shape(centres_mm[part], campaign, where, knocked)
            rows = whole[part]
            touch, undecided = find_outliers(
                p_instr_mm[rows], near[rows], shape_mm, radius_mm, limit_mm, sigma_mm
            )
            outlier[rows] |= touch
            reason[rows[undecided]] = UNDECIDED
    used = valid & ~outlier
    spheres = fit(slice(None), used)
    without = unusable_balls(used, spheres.coplanar.reshape(C, B), names)
    return LocatedBalls(
        p_instr_mm=spheres.centre_mm.reshape(C, B, 3),
        cov_mm2=sigma_mm**2 * spheres.cofactor.reshape(C, B, 3, 3),
        used=used,
        outlier=outlier,
        reason=np.where(reason == "", without, reason),
        remarks=tuple(remarks),
    )


def _far_from_the_others(p_mm: Array, valid: Mask, balls_mm: Array, radius_mm: float) -> Mask:
    """Return touches (C, B, T) further from their configuration's median than the tool is large."""
    between_mm = balls_mm[:, None] - balls_mm
    size_mm = float(np.linalg.norm(between_mm, axis=2).max()) + 2.0 * radius_mm
    touches_mm = np.where(valid[..., None], p_mm, np.nan)
    middle_mm = np.nanmedian(touches_mm.reshape(len(p_mm), -1, 3), axis=1)
    distance_mm = np.linalg.norm(p_mm - middle_mm[:, None, None, :], axis=3)
    return np.asarray(valid & (distance_mm > FAR_OFF * size_mm))


def _refuse_flat(spheres: Spheres, where: str) -> None:
    """Refuse touches that lie in one plane on most balls: their unit is a larger one."""
    flat = spheres.coplanar[spheres.touches >= LEAST_TOUCHES]
    if 2 * flat.sum() > len(flat):
        raise RawDataError(
            f"the touches on {flat.sum()} of {len(flat)} balls lie in one plane, seen at the "
            "scale of the stated diameter",
            where=where,
            allowed="touches all around each ball, in millimetres",
            remedy="check the unit of x_mm, y_mm, z_mm, and ball_diameter_mm",
        )


def _refuse_other_spheres(
    spheres: Spheres, radius_mm: float, limit_mm: float, outlier_sigma: float, where: str
) -> None:
    """Refuse touches of which so many are off that the radius or the unit is wrong."""
    worst_mm = np.median(np.abs(spheres.residual_mm).max(axis=1))
    if worst_mm > limit_mm:
        raise RawDataError(
            "the touches do not lie on spheres of the stated diameter",
            where=where,
            value=f"typically {worst_mm:.3g} mm off a sphere of {2 * radius_mm:g} mm",
            allowed=f"within {limit_mm:.3g} mm, {outlier_sigma:g} sigmas of one touch",
            remedy="check ball_diameter_mm, the unit of x_mm, y_mm, z_mm, the compensation of "
            "the probe's radius, and instrument.uncertainty_mm",
        )


def _shape(
    p_instr_mm: Array, campaign: CampaignDescription, where: str, knocked: tuple[str, ...]
) -> Array:
    """Return the balls' places on the tool (B, 3): the median over configurations, if enough.

    `knocked` are remarks on balls that were knocked, for the refusal of another tool.
    """
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
        elif knocked:
            remedy = "; ".join(knocked)
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
    """Touches of C configurations on B balls, padded to T touches a ball."""

    of_touch: Index  # (N,) configuration of every touch
    first: Index  # (C,) first touch of every configuration
    row: Index  # (C, B, T) number of the touch, 0 of padding
    valid: Mask  # (C, B, T) which are no padding


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
    """Return the dwell in which each configuration has most touches; of equals the first."""
    pairs, counts = np.unique(np.column_stack([of_touch, dwell]), axis=0, return_counts=True)
    # By configuration, then by rising count, so that the last of each configuration is the dwell.
    pairs = pairs[np.lexsort((-pairs[:, 1], counts, pairs[:, 0]))]
    last = np.append(np.diff(pairs[:, 0]) > 0, True)
    return np.asarray(pairs[last, 1], dtype=np.intp)


def unusable_balls(valid: Mask, coplanar: Mask, names: tuple[str, ...]) -> NDArray[np.object_]:
    """Return (C,) why touches (C, B, T) do not locate all balls; "" where they do."""
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


#: The fit of a rigid tool: its steps at most, the step that ends it [mm], its damping of the normal
#: matrix, and its largest step [mm, rad].
TOOL_ITERATIONS, TOOL_TOLERANCE_MM, DAMPING = 30, 1e-9, 1e-9
LARGEST_STEP = np.array([20.0, 20.0, 20.0, 0.1, 0.1, 0.1])
#: A touch of less redundancy (1 minus its leverage) cannot be judged.
LEAST_REDUNDANCY = 1e-3


def touch_sigma_mm(spheres: Spheres, centre_uncertainty_mm: float) -> float:
    """Return the standard uncertainty s of one touch that follows from that of a measured centre.

    The instrument states u, the standard uncertainty of a centre along an axis. The covariance of a
    centre is s² times its cofactor; s is such that the variance of the median ball, averaged over
    the axes, is u². A ball with few touches, or with touches on one side, is then less certain.
    """
    variance = np.median(np.trace(spheres.cofactor, axis1=1, axis2=2)) / 3.0
    return float(centre_uncertainty_mm / np.sqrt(variance))


def find_outliers(
    p_mm: Array, valid: Mask, balls_mm: Array, radius_mm: float, limit_mm: float, sigma_mm: float
) -> tuple[Mask, Mask]:
    """Find touches that do not lie on the balls of a rigid tool, omitting each in turn.

    A configuration is suspect where a touch is further off than `limit_mm`, as predicted from the
    other touches. Its outlier is the touch without which the others fit. Where they fit without one
    of two touches, chi-square must differ by more than (limit / sigma)², else it is undecided.

    Args:
        p_mm: (C, B, T, 3) touches, padded.
        valid: (C, B, T) which of them are no padding; every ball must have a determined centre.
        balls_mm: (B, 3) centres in the tool's frame.
        radius_mm: radius of the balls.
        limit_mm: largest residual of a touch.
        sigma_mm: standard uncertainty of a touch.

    Returns:
        (C, B, T) suspected outliers; (C,) undecided configurations, which do not fit the tool
        though no single touch explains it.
    """
    C, B, T = valid.shape
    fits, _ = _fits(p_mm, valid, balls_mm, radius_mm, limit_mm, sigma_mm)
    touch = np.zeros(valid.shape, dtype=bool)
    undecided = np.zeros(C, dtype=bool)
    suspects = np.flatnonzero(~fits)
    if not len(suspects):
        return touch, undecided
    suspect, omitted = np.nonzero(valid[suspects].reshape(len(suspects), B * T))
    others = valid[suspects][suspect].reshape(-1, B * T)
    others[np.arange(len(suspect)), omitted] = False
    fits, chi2 = _fits(
        p_mm[suspects][suspect], others.reshape(-1, B, T), balls_mm, radius_mm, limit_mm, sigma_mm
    )
    chi2_without = np.full((len(suspects), B * T), np.inf)
    chi2_without[suspect[fits], omitted[fits]] = chi2[fits]
    best = np.argmin(chi2_without, axis=1)
    ranked = np.sort(chi2_without, axis=1)
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
        # Far from a fit the normal matrix may be singular: damped, and the step bounded.
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
    studentised = np.abs(residual) / np.sqrt(np.where(judged, redundancy, 1.0))
    fits = np.where(judged, studentised, 0.0).max(axis=1) <= limit_mm
    return fits, np.square(residual).sum(axis=1) / sigma_mm**2


def _linearise_tool(
    p_mm: Array, weight: Array, R: Array, origin: Array, balls_mm: Array, radius_mm: float
) -> tuple[Array, Array]:
    """Return the design matrix (C, BT, 6) of a small motion (dp, w) of the tool, and residuals.

    dp moves the tool's origin, w turns it about it; a motion changes residuals (C, BT) by minus the
    design matrix times the motion.
    """
    lever = balls_mm @ np.swapaxes(R, 1, 2)
    normal, residual = normals_and_residuals(p_mm, weight, origin[:, None, :] + lever, radius_mm)
    turning = np.cross(np.broadcast_to(lever[:, :, None, :], normal.shape), normal)
    C = len(p_mm)
    return np.concatenate([normal, turning], axis=-1).reshape(C, -1, 6), residual.reshape(C, -1)


# Errors that touches share: a wrong radius of probe or balls, and balls that were knocked. Neither
# is a stray touch, so that a test of single touches gives a wrong reason for them, or none.


def _radius_off_mm(
    spheres: Spheres, p_mm: Array, touched: Mask, radius_mm: float, sigma_mm: float
) -> tuple[float, float]:
    """Return how much larger the touched spheres are than stated, and its standard error.

    It is the median over G balls of the radius that T touches show beside the centre. Zero where it
    is not significant, or small against the uncertainty of one touch.

    Args:
        spheres: the balls, fitted with the stated radius.
        p_mm: (G, T, 3) their touches, padded.
        touched: (G, T) which of them are no padding.
        radius_mm: the stated radius.
        sigma_mm: standard uncertainty of one touch.
    """
    weight = touched.astype(float)
    normals, residual_mm = normals_and_residuals(p_mm, weight, spheres.centre_mm, radius_mm)
    summed = normals.sum(axis=1)
    # A centre takes up a part of a wrong radius: what is left of it is the information.
    information = weight.sum(axis=1) - np.einsum("gi,gij,gj->g", summed, spheres.cofactor, summed)
    shows = ~spheres.coplanar & (information > LEAST_INFORMATION)
    if shows.sum() < 2:
        return 0.0, 0.0
    off_mm = residual_mm.sum(axis=1)[shows] / information[shows]
    mean_mm = float(np.median(off_mm))
    scatter_mm = MEDIAN_TO_SIGMA * float(np.median(np.abs(off_mm - mean_mm)))
    u_mm = MEDIAN_ERROR * scatter_mm / float(np.sqrt(len(off_mm)))
    if abs(mean_mm) < max(RADIUS_ERRORS * u_mm, RADIUS_PART * sigma_mm):
        return 0.0, 0.0
    return mean_mm, u_mm


def _radius_remark(off_mm: float, u_mm: float, radius_mm: float) -> str:
    """Return what is said of a wrong radius that was taken out."""
    side, small = ("outside", "small") if off_mm > 0.0 else ("inside", "large")
    return (
        f"the touches lie {abs(off_mm):.4f} ± {u_mm:.4f} mm {side} the spheres of "
        f"{2.0 * radius_mm:g} mm in the mean: ball_diameter_mm is {abs(2.0 * off_mm):.3f} mm too "
        f"{small}, or the compensation of the probe's radius {abs(off_mm):.3f} mm; spheres "
        f"of {2.0 * (radius_mm + off_mm):.3f} mm are fitted; correct ball_diameter_mm, or "
        "qualify the probe anew"
    )


def _knocked_balls(p_instr_mm: Array, uncertainty_mm: float) -> tuple[Knock, ...]:
    """Return the knocks that distances between centres (C, B, 3), in order of time, show."""
    p_m = MM * p_instr_mm
    return knocks_on_body(p_m, np.full(p_m.shape, MM * uncertainty_mm))


def _knock_remarks(
    knocks: Sequence[Knock], names: Sequence[str], visits: Sequence[str]
) -> Iterator[str]:
    """Yield what is said of knocked balls; `visits` (C,) are the configurations in words."""
    for knock in knocks:
        ball = " or ".join(names[k] for k in knock.targets)
        yield (
            f"ball {ball} moved by {1e3 * knock.shift_m:.3f} mm on the tool between "
            f"{visits[knock.row - 1]} and {visits[knock.row]}, and stayed there: its distances "
            "from the other balls changed; it was knocked. Poses are wrong by a part of that: "
            "calibrate the configurations before and after as two campaigns, with the place of the "
            "ball measured anew (tool.balls_mm)"
        )
