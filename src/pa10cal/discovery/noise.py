"""Noise of single readings, found from repeats or near poses.

The noise is the pure error: the difference of successive readings of one pose, load and direction
of arrival. Successive readings are compared, and not readings with their mean, so that slow drifts
and dependence on the direction of arrival are no noise (von Neumann's mean square of successive
differences). If the order of the poses changes, hardly any is reached from the same side twice:
then all repeats of a pose and load are compared, less what follows the direction of each joint.
The noise is attributed to its sources, positions of joints and the instrument, so that it can be
stated for any pose. Without repeats, poses that are nearly the same stand for them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar, nnls
from scipy.spatial import cKDTree

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery.jacobians import ideal_by_joints
from pa10cal.discovery.rules import NAMES, NOISE
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.logged_torques import torque_scatter_Nm
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.terms.term import yields


@dataclass(frozen=True)
class Noise:
    """Noise of single readings."""

    # (P, b, b) covariance of each reading's components: of a pose position [m] and small rotation
    # [rad], along the instrument's axes
    cov: Array
    differences: int  # pairs of readings behind it; 0 where it is what the instrument states
    components_compared: int = 0  # of all pairs of repeats: those that both readings have
    # (n,) standard deviation of each joint's position; empty where not attributed to sources
    joint_rad: Array = field(default_factory=lambda: np.zeros(0))
    instrument: float = 1.0  # factor on the instrument's stated standard uncertainty
    # (n,) standard deviation of a reading's torques; nan where none is logged, zero where none
    # scatters, as in a log that was calculated
    torque_Nm: Array = field(default_factory=lambda: np.zeros(0))
    # share of the variance of logged torques about those of the weights that is noise; the rest is
    # of forces that nobody stated
    torque_share: float = 1.0
    # how far apart the poses of pairs that are no repeats may be [rad; m of a prismatic joint]
    within: float = NOISE.same_pose

    @property
    def origin(self) -> str:
        """Return the source of noise that was not found from repeats, in words."""
        if not self.differences:
            scatter = " and the scatter of logged torques" * bool(np.any(self.torque_Nm > 0.0))
            return f"the instrument's stated uncertainty{scatter}: repeats do not show the noise"
        carried_on = "" if self.within == NOISE.same_pose else ", carried on to the same pose"
        return (
            f"{self.differences} pairs of poses closer than {1e3 * self.within:g} mrad in every "
            f"joint{carried_on}"
        )


def noise_of_repeats(readings: Observations, deviation: Array, screws: Array) -> Noise:
    """Find the noise of P single readings from repeats.

    Args:
        deviation: (P, b) components measured less those of a model at each reading's own joint
            positions and torques.
        screws: (P, b, n) derivative of the components by the joint positions.

    Raises:
        DiscoveryError: when too little is repeated, or repeats show no noise.
    """
    first, second = _pairs(readings)
    if len(first) < NOISE.least_differences:
        raise DiscoveryError(
            "too few repeats to determine the repeatability of the measurement",
            where="grid poses",
            value=f"{len(first)} pairs of successive readings of one pose, load and direction",
            allowed=f"at least {NOISE.least_differences}",
            remedy="measure poses repeatedly",
        )
    measured, states = readings.measured, readings.states
    seen = measured.components_seen
    both = seen[first] & seen[second]
    difference = np.where(both, deviation[second] - deviation[first], 0.0) / np.sqrt(2.0)
    tau_difference_Nm = (states.tau_Nm[second] - states.tau_Nm[first]) / np.sqrt(2.0)
    turned = (states.arrival[second] - states.arrival[first]) / np.sqrt(2.0)
    if turned.any():  # what follows the direction of arrival of each joint is no noise
        sizes = np.sqrt(np.diagonal(measured.stated_covariance, axis1=1, axis2=2)[first])
        by_direction = 0.5 * (screws[first] + screws[second]) * turned[:, None, :]
        difference = np.where(
            both, difference - _explained(difference, by_direction, sizes, both), 0.0
        )
        tau_difference_Nm = _without_direction(tau_difference_Nm, turned)
    n = screws.shape[2]
    sources = _covariances_by_source(screws, measured)
    of_pairs = np.where(
        (both[:, :, None] & both[:, None, :])[:, None],
        0.5 * (sources[first] + sources[second]),
        0.0,
    )
    try:
        variances = _variance_components(difference, of_pairs, both)
        variances = likelier_variances(
            variances, np.eye(len(variances))[n], difference, of_pairs, both
        )
    except np.linalg.LinAlgError:
        raise _no_noise(measured, difference, both) from None
    return Noise(
        cov=_whole(np.einsum("k,pkij->pij", variances, sources), seen),
        differences=len(first),
        components_compared=int(both.sum()),
        joint_rad=np.sqrt(variances[:n]),
        instrument=float(np.sqrt(variances[n])),
        torque_Nm=_torque_noise_Nm(tau_difference_Nm, states.tau_Nm),
    )


def _without_direction(tau_difference_Nm: Array, turned: Array) -> Array:
    """Return differences of torques (D, n) less the part that follows the arrival of each joint."""
    logged = np.isfinite(tau_difference_Nm)
    squares = np.sum(turned**2, axis=0, where=logged)
    products = np.sum(turned * tau_difference_Nm, axis=0, where=logged)
    return np.asarray(tau_difference_Nm - turned * products / np.where(squares, squares, 1.0))


def _torque_noise_Nm(difference_Nm: Array, tau_Nm: Array) -> Array:
    """Return the noise of each joint's torque, (n,), by differences (D, n) of the torques (P, n).

    A torque whose log does not scatter, as if it always reads zero, counts as uncertain as the one
    that scatters most.
    """
    logged = np.isfinite(difference_Nm)
    count = logged.sum(axis=0)
    squares = np.sum(difference_Nm**2, axis=0, where=logged)
    noise_Nm = np.where(count > 0, np.sqrt(squares / np.maximum(count, 1)), np.nan)
    largest_Nm = np.abs(tau_Nm).max(initial=0.0, where=np.isfinite(tau_Nm))
    scatters = noise_Nm > NOISE.rounded_torque_share * largest_Nm
    quiet = (count > 0) & ~scatters
    return np.where(quiet, noise_Nm.max(initial=0.0, where=scatters), noise_Nm)


def _covariances_by_source(screws: Array, measured: Instrument) -> Array:
    """Return the covariances (P, s, b, b) of components by unit variances of s sources.

    Of each joint's position, of what the instrument states, and of an independent error of each
    kind of component.
    """
    seen, stated = measured.components_seen, measured.stated_covariance
    of_sources = [np.einsum("pik,pjk->pkij", screws, screws), stated[:, None]]
    for _, at in measured.component_kinds:
        rows, of_kind = np.arange(seen.shape[1])[at], np.zeros((len(seen), 1, *stated.shape[1:]))
        of_kind[:, 0, rows, rows] = seen[:, at]
        of_sources.append(of_kind)
    return np.concatenate(of_sources, axis=1)


def _no_noise(measured: Instrument, difference: Array, both: Mask) -> DiscoveryError:
    """Return the refusal of repeats whose differences (D, b) show no noise."""
    largest = f"largest difference of two readings {np.abs(difference).max():.3g} m or rad"
    if rounded := measured.rounded_kinds(difference, both):
        return DiscoveryError(
            f"repeats of the {' and the '.join(rounded)} are the same in every digit",
            where="grid poses",
            value=largest,
            allowed="numbers with so many digits that repeats differ by the noise",
            remedy="export them with more digits",
        )
    return DiscoveryError(
        "the scatter of repeats shows no noise in some component of the readings",
        where="grid poses",
        value=largest,
        allowed="repeats that differ by the noise of joints and instrument",
        remedy="look for readings with a gross error, and for readings that were copied",
    )


def noise_of_near_poses(poses: Observations, residual: Array) -> Noise:
    """Find the noise of readings from poses that are nearly the same; else return the stated one.

    The difference of the residuals (P, b) of two nearly equal poses is noise: a wrong model errs
    nearly alike in both. Each pose is in one pair at most; the median decides. Where there are too
    few pairs, as along a path, the noise is the nugget of a variogram of pairs farther apart.
    """
    first, second = nearly_same(poses)
    measured, within, distance = poses.measured, NOISE.same_pose, None
    seen, stated = measured.components_seen, measured.stated_covariance
    both = seen[first] & seen[second]
    if both.any(axis=1).sum() < NOISE.least_differences:
        first, second, distance = _near_neighbours(poses)
        both, within = seen[first] & seen[second], NOISE.near_pose
        if both.any(axis=1).sum() < NOISE.near_steps * NOISE.least_differences:
            return Noise(stated, 0)
    difference = np.abs(residual[first] - residual[second]) / np.sqrt(2.0)
    variance = np.zeros(residual.shape[1])
    for _, at in measured.component_kinds:
        here = both[:, at]
        if not here.any():  # a campaign of a group without poses that are nearly the same
            own = np.diagonal(stated[:, at, at], axis1=1, axis2=2)[measured.components_seen[:, at]]
            variance[at] = np.median(own)
            continue
        variance[at] = _variance(difference[:, at], here, distance)
    if not variance.all():  # readings that were copied
        return Noise(stated, 0)
    cov = np.tile(np.diag(variance), (len(poses), 1, 1))
    return Noise(cov, len(first), within=within)


def _variance(difference: Array, seen: Mask, distance: Array | None) -> float:
    """Return the variance of readings by the differences (D, c) of pairs, of those seen (D, c).

    With the distances (D,) of the poses, it is the intercept of a straight line through medians of
    steps of distance, of non-negative slope; None where poses count as the same.
    """
    if distance is None:
        return float(np.square(NOISE.median_to_sigma * np.median(difference[seen])))
    steps = np.array_split(np.argsort(distance, kind="stable"), NOISE.near_steps)
    steps = [step for step in steps if seen[step].any()]
    square = [_variance(difference[step], seen[step], None) for step in steps]
    line = np.column_stack(
        [np.ones(len(steps)), [distance[step].mean() / NOISE.near_pose for step in steps]]
    )
    return float(nnls(line, np.array(square))[0][0])


def _near_neighbours(poses: Observations) -> tuple[Index, Index, Array]:
    """Return the poses of pairs of near neighbours, and their distances."""
    keys = np.column_stack([poses.states.q_rad, poses.states.load_N])
    distance, other = map(
        np.asarray, cKDTree(keys).query(keys, NOISE.most_neighbours + 1, p=np.inf)
    )
    first, k = np.nonzero(distance <= NOISE.near_pose)
    pairs = np.sort(np.column_stack([first, other[first, k]]), axis=1)
    pairs, at = np.unique(pairs, axis=0, return_index=True)
    distance, differ = distance[first, k][at], pairs[:, 0] != pairs[:, 1]
    return pairs[differ, 0], pairs[differ, 1], distance[differ]


def nearly_same(poses: Observations) -> tuple[Index, Index]:
    """Return pairs of poses that are nearly the same, nearest first, each pose in one at most."""
    keys = np.column_stack([poses.states.q_rad, poses.states.load_N])
    pairs = cKDTree(keys).query_pairs(NOISE.same_pose, p=np.inf, output_type="ndarray")
    distance = np.abs(keys[pairs[:, 0]] - keys[pairs[:, 1]]).max(axis=1, initial=0.0)
    paired = np.zeros(len(poses), dtype=bool)
    chosen = []
    for k in np.argsort(distance, kind="stable"):
        if not paired[pairs[k]].any():
            paired[pairs[k]] = True
            chosen.append(k)
    found = pairs[np.array(chosen, dtype=np.intp)]
    return found[:, 0], found[:, 1]


def same_circumstances(readings: Observations) -> Index:
    """Return the number (P,), from 0, of each reading's pose, load and direction of arrival."""
    _, pose = np.unique(readings.pose, return_inverse=True)
    keys = np.column_stack([pose, readings.states.load_N, readings.states.arrival])
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()


def repeated(readings: Observations) -> int:
    """Return the number of readings that repeat an earlier one of their `repeat_groups`."""
    return len(_pairs(readings)[0])


def enough_repeats(readings: Observations) -> bool:
    """Return whether so many readings are repeats that these show the noise of all."""
    least = max(NOISE.least_differences, NOISE.least_repeated_share * len(readings))
    return repeated(readings) >= least


def repeat_groups(readings: Observations) -> Index:
    """Return the number (P,), from 0, of each reading's group, within which readings are repeats.

    A group is of one pose, load and direction of arrival, or of one pose and load where hardly any
    is reached from the same side twice.
    """
    same = same_circumstances(readings)
    pairs = len(readings) - len(np.unique(same))
    if pairs >= NOISE.least_repeated_share * len(readings):
        return same
    any_side = reading_groups(readings)
    pairs_of_any_side = len(readings) - len(np.unique(any_side))
    return any_side if pairs_of_any_side > NOISE.any_side_ratio * pairs else same


def _pairs(readings: Observations) -> tuple[Index, Index]:
    """Return readings and the next ones of their `repeat_groups`, with a target that both saw."""
    group = repeat_groups(readings)
    order = np.lexsort((readings.states.time_s, group))
    pairs = np.flatnonzero(np.diff(group[order]) == 0)
    first, second = order[pairs], order[pairs + 1]
    seen = readings.measured.components_seen
    both = (seen[first] & seen[second]).any(axis=1)
    return first[both], second[both]


def _explained(difference: Array, columns: Array, sizes: Array, seen: Mask) -> Array:
    """Return the least-squares fit of columns (D, b, n) to differences (D, b) of sizes (D, b)."""
    weight = np.where(seen, 1.0 / np.where(sizes > 0.0, sizes, 1.0), 0.0)
    white = (columns * weight[..., None]).reshape(-1, columns.shape[2])
    amounts = np.linalg.lstsq(white, (difference * weight).ravel(), rcond=None)[0]
    return np.asarray(columns @ amounts)


def whitener_of(cov: Array) -> Array:
    """Return matrices (P, b, b) that make components of covariances (P, b, b) white."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)), dtype=np.float64)


def mean_covariance(cov: Array, seen: Mask, group: Index) -> Array:
    """Return the covariance (G, b, b) of the means of independent readings of each group.

    Args:
        cov: (P, b, b) covariance of the readings.
        seen: (P, b) components that each reading has.
        group: (P,) number of each reading's group, from 0, none omitted.
    """
    count = np.bincount(group)
    total, times = np.zeros((len(count), *cov.shape[1:])), np.zeros((len(count), cov.shape[1]))
    if seen.all():
        np.add.at(total, group, cov)
        return np.asarray(total / count[:, None, None] / count[:, None, None])
    np.add.at(times, group, seen)
    share = seen / np.maximum(times, 1.0)[group]
    np.add.at(total, group, share[:, :, None] * cov * share[:, None, :])
    return _whole(total, times > 0.0)


def _whole(cov: Array, seen: Mask) -> Array:
    """Return covariances (P, b, b) with unit variance of components not seen, whose rows are 0."""
    here = np.where(seen[:, :, None] & seen[:, None, :], cov, 0.0)
    return here + np.eye(seen.shape[1]) * ~seen[:, :, None]


def _variance_components(difference: Array, sources: Array, seen: Mask) -> Array:
    """Fit non-negative variances of sources (D, s, b, b) to the squares of differences (D, b).

    Rows are products of components, whitened by the covariance found before so that all weigh about
    the same.
    """
    count = sources.shape[1]
    if seen.all():
        first = np.atleast_2d(np.cov(difference.T, bias=True))
    else:
        first = np.diag(np.sum(difference**2, axis=0) / np.maximum(seen.sum(axis=0), 1))
    expected = np.broadcast_to(first, (len(difference), *first.shape))
    variances = np.zeros(count)
    for _ in range(NOISE.reweighted):
        whiten = whitener_of(_whole(expected, seen))
        white = np.einsum("pij,pj->pi", whiten, difference)
        squares = np.einsum("pi,pj->pij", white, white)
        whitened = np.einsum("pij,psjk,plk->psil", whiten, sources, whiten, optimize=True)
        rows = whitened.transpose(0, 2, 3, 1).reshape(-1, count)
        size = np.linalg.norm(rows, axis=0)
        size[size == 0.0] = 1.0
        q, triangle = np.linalg.qr(rows / size)  # a small system of the same solution
        variances = nnls(triangle, q.T @ squares.ravel())[0] / size
        expected = np.einsum("s,psij->pij", variances, sources)
    return variances


def likelier_variances(
    found: Array, of_instrument: Array, difference: Array, sources: Array, seen: Mask
) -> Array:
    """Return the likelier of two sets of variances (s,), each times its best common factor.

    Where something else than noise is in the differences, as a step of the base between repeats,
    joints may seem to be all of the noise: their covariance has next to none in some directions, by
    which the common factor, and with it all the noise, came out three hundred times too large.

    Args:
        found: variances of all sources.
        of_instrument: those of the instrument as stated, alone.
    """
    sets, misfits = [], []
    for variances in (found, of_instrument):
        try:
            whiten = whitener_of(_whole(np.einsum("s,psij->pij", variances, sources), seen))
        except np.linalg.LinAlgError:
            if variances is found:
                raise
            continue
        white = np.einsum("pij,pj->pi", whiten, difference)
        factor = float(np.sum(white**2) / seen.sum())
        log_det = -2.0 * float(np.log(np.diagonal(whiten, axis1=1, axis2=2)).sum())
        sets.append(variances * factor)
        misfits.append(log_det + seen.sum() * np.log(factor))
    return sets[int(np.argmin(misfits))]


def with_torque_noise(
    noise: Noise, residual: Array, at: FittedModel, poses: Observations, payload: Payload | None
) -> Noise:
    """Return stated noise plus what the noise of logged torques adds to it through the springs.

    Noise found from pairs of readings includes it already. The noise of torques is their scatter
    about a fit by the torques of the weights; zero for a joint with too few poses. Where forces act
    that nobody stated, the log scatters by these, and the arm moves by them: residuals far below
    such noise show how much of it is any.

    Args:
        residual: (P, b) predicted less measured components, the springs carrying the logged
            torques.
        poses: P complete poses.
        payload: None where the masses are not known.
    """
    springs = [term for term in at.model.terms if yields(term)]
    if noise.differences or payload is None or not springs:
        return noise
    states = poses.states
    torque_Nm = torque_scatter_Nm(at, states, payload, NOISE.torques_a_weight)
    turned_rad = np.zeros(states.q_rad.shape)
    for spring in springs:
        turned_rad[:, spring.joint - 1] += spring.by_torque(states, at.values_of(spring))
    by_drives = at.arm.coupling.moved_by_drives(ideal_by_joints(at, poses))
    moved = by_drives * (turned_rad * torque_Nm)[:, None, :]
    by_torques = moved @ np.swapaxes(moved, 1, 2)
    share = share_that_is_noise(residual, poses.measured, noise.cov, by_torques)
    cov, torque_Nm = noise.cov + share * by_torques, np.sqrt(share) * torque_Nm
    return replace(noise, cov=cov, torque_Nm=torque_Nm, torque_share=share)


def share_that_is_noise(
    residual: Array, measured: Instrument, cov: Array, by_torques: Array
) -> float:
    """Return which share of a covariance (P, b, b) residuals bear out beside another, 0 to 1.

    It is 1 unless position errors are far smaller than both together make them.

    Args:
        residual: (P, b) predicted less measured components.
        measured: what was measured of these poses.
        cov: (P, b, b) of the noise that is certain.
        by_torques: (P, b, b) of what may be noise.
    """
    columns, seen = measured.position_columns, measured.components_seen
    of_both = np.diagonal(cov + by_torques, axis1=1, axis2=2)
    square, expected = (
        np.sum(each[:, columns], where=seen[:, columns]) for each in (residual**2, of_both)
    )
    if square > NAMES.agree_ratio**-2.0 * expected:
        return 1.0

    def misfit(root: float) -> float:
        whiten = whitener_of(cov + root**2 * by_torques)
        white = np.einsum("pij,pj->pi", whiten, np.where(seen, residual, 0.0))
        log_det = -2.0 * np.log(np.diagonal(whiten, axis1=1, axis2=2)).sum()
        return float(np.sum(white**2) + log_det)

    return float(minimize_scalar(misfit, bounds=(0.0, 1.0), method="bounded").x) ** 2
