"""What the measurement itself scatters by.

Pure error is how much one reading differs from the next of the same pose, load and direction.
Successive readings are compared, not readings with their mean: what drifts slowly, or depends on
the direction of arrival, is then no noise (von Neumann's mean square of successive differences).
Where poses come in another order each time, hardly any is reached from the same side twice: then
all repeats of a pose and load are compared, less what goes with the direction of each joint.
The scatter is attributed to its sources, joints that stop a little elsewhere and the instrument, so
that it can be stated for any pose. Without repeats, poses that are nearly the same stand for them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize, nnls
from scipy.spatial import cKDTree
from scipy.special import chdtri

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery.linear import by_every_joint, by_joints, position_m
from pa10cal.discovery.other_numbers import COMPUTING
from pa10cal.discovery.rules import NOISE
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted import TOOL_FRAME
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import Forward
from pa10cal.fit.loads import statics_of
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.results.record import HALF_WIDTH_95
from pa10cal.terms.term import yields


@dataclass(frozen=True)
class Noise:
    """Noise of single readings."""

    # (P, b, b) covariance of each reading's components: of a pose position [m] and small rotation
    # [rad], along the instrument's axes
    cov: Array
    differences: int  # pairs of readings behind it; 0 where it is what the instrument states
    # (n,) standard deviation of each joint that the scatter shows; none where the scatter was not
    # attributed to its sources
    joint_rad: Array = field(default_factory=lambda: np.zeros(0))
    # factor on the instrument's stated standard uncertainty that the scatter shows
    instrument: float = 1.0
    # (n,) standard deviation of a reading's torques (nan where none is logged; zero where none
    # scatters, as in a log that was calculated)
    torque_Nm: Array = field(default_factory=lambda: np.zeros(0))
    # how far apart the poses of pairs that are no repeats may be [rad; m of a prismatic joint]
    within: float = NOISE.same_pose

    @property
    def origin(self) -> str:
        """Return what noise that was not found from repeats was found from."""
        if not self.differences:
            return "the instrument's stated uncertainty: repeats do not show the noise"
        carried_on = "" if self.within == NOISE.same_pose else ", carried on to the same pose"
        return (
            f"{self.differences} pairs of poses closer than {1e3 * self.within:g} mrad in every "
            f"joint{carried_on}"
        )


def noise_of_repeats(readings: Observations, deviation: Array, screws: Array) -> Noise:
    """Find the noise of P single readings from repeats.

    By components (P, b) measured less what a model says at the reading's own joint positions and
    torques, and how they follow each joint's position (P, b, n).

    Raises:
        DiscoveryError: when too little is repeated, or repeats show no noise.
    """
    first, second = _pairs(readings)
    if len(first) < NOISE.least_differences:
        pairs = f"{len(first)} pairs of successive readings of one pose, load and direction"
        raise DiscoveryError(
            "too few repeats to determine the repeatability of the measurement",
            where="grid poses",
            value=pairs,
            allowed=f"at least {NOISE.least_differences}",
            remedy="measure poses repeatedly",
        )
    measured, states = readings.measured, readings.states
    seen, stated = measured.components_seen, measured.stated_covariance
    difference = (deviation[second] - deviation[first]) / np.sqrt(2.0)
    torque_difference = (states.tau_Nm[second] - states.tau_Nm[first]) / np.sqrt(2.0)
    turned = (states.arrival[second] - states.arrival[first]) / np.sqrt(2.0)
    if turned.any():
        # What goes with the direction of each joint is no noise.
        sizes = np.sqrt(np.diagonal(stated, axis1=1, axis2=2)[first])
        by_direction = 0.5 * (screws[first] + screws[second]) * turned[:, None, :]
        difference = difference - _along(difference, by_direction, sizes, seen[first])
        squares = np.sum(turned**2, axis=0)
        by_direction_Nm = np.sum(turned * torque_difference, axis=0) / np.where(squares, squares, 1)
        torque_difference = torque_difference - turned * by_direction_Nm
    of_sources = [np.einsum("pik,pjk->pkij", screws, screws), stated[:, None]]
    for _, at in measured.component_kinds:  # the same independent error of all of a kind
        rows, of_kind = np.arange(seen.shape[1])[at], np.zeros((len(seen), 1, *stated.shape[1:]))
        of_kind[:, 0, rows, rows] = seen[:, at]
        of_sources.append(of_kind)
    sources = np.concatenate(of_sources, axis=1)
    both = seen[first] & seen[second]
    of_pairs = np.where(
        (both[:, :, None] & both[:, None, :])[:, None],
        0.5 * (sources[first] + sources[second]),
        0.0,
    )
    try:
        variances = _variance_components(np.where(both, difference, 0.0), of_pairs, both)
    except np.linalg.LinAlgError:
        largest = f"largest difference of two readings {np.abs(difference).max():.3g} m or rad"
        if rounded := measured.rounded_kinds(difference, both):
            raise DiscoveryError(
                f"repeats of the {' and the '.join(rounded)} are the same in every digit",
                where="grid poses",
                value=largest,
                allowed="numbers with so many digits that repeats differ by the noise",
                remedy="export them with more digits",
            ) from None
        raise DiscoveryError(
            "the scatter of repeats shows no noise in some component of the readings",
            where="grid poses",
            value=largest,
            allowed="repeats that differ by the noise of joints and instrument",
            remedy="look for readings with a gross error, and for readings that were copied",
        ) from None
    # A joint whose log does not scatter, such as one that always reads zero, counts as scattering
    # by as much as the joint that scatters most: nothing else is known of it.
    n, torque_Nm = screws.shape[2], np.sqrt(np.mean(torque_difference**2, axis=0))
    quiet = torque_Nm <= NOISE.rounded_torque_share * np.abs(states.tau_Nm).max()
    return Noise(
        cov=_whole(np.einsum("k,pkij->pij", variances, sources), seen),
        differences=len(first),
        joint_rad=np.sqrt(variances[:n]),
        instrument=float(np.sqrt(variances[n])),
        torque_Nm=np.where(quiet, 0.0 if quiet.all() else torque_Nm.max(), torque_Nm),
    )


def noise_of_near_poses(poses: Observations, residual: Array) -> Noise:
    """Find the noise of readings from poses that are nearly the same; else as stated.

    What two nearly equal poses differ by, less what a model's residual (P, b) differs by, is noise;
    a wrong model says nearly the same of both. Each pose is in one pair at most; the median
    decides. Where there are too few, as along a path, pairs farther apart show it: what the model
    lacks makes them differ the more the farther apart they are.
    """
    first, second = nearly_same(poses)
    measured, within, apart = poses.measured, NOISE.same_pose, None
    seen, stated = measured.components_seen, measured.stated_covariance
    both = seen[first] & seen[second]
    if both.any(axis=1).sum() < NOISE.least_differences:
        first, second, apart = _near(poses)
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
        variance[at] = _variance(difference[:, at], here, apart)
    if not variance.all():  # readings that were copied
        return Noise(stated, 0)
    cov = np.tile(np.diag(variance), (len(poses), 1, 1))
    return Noise(cov, len(first), within=within)


def _variance(difference: Array, seen: Mask, apart: Array | None) -> float:
    """Return the variance of readings by the differences (D, c) of pairs, of those seen (D, c).

    Args:
        apart: (D,) how far apart the poses are; None where they count as the same. The variance is
            a straight line over the distance, through medians, that never falls.
    """
    if apart is None:
        return float(np.square(NOISE.median_to_sigma * np.median(difference[seen])))
    steps = np.array_split(np.argsort(apart, kind="stable"), NOISE.near_steps)
    steps = [step for step in steps if seen[step].any()]
    square = [_variance(difference[step], seen[step], None) for step in steps]
    line = np.column_stack(
        [np.ones(len(steps)), [apart[step].mean() / NOISE.near_pose for step in steps]]
    )
    return float(nnls(line, np.array(square))[0][0])


def _near(poses: Observations) -> tuple[Index, Index, Array]:
    """Return the poses of pairs of near neighbours, and how far they are apart."""
    keys = np.column_stack([poses.states.q_rad, poses.states.load_N])
    apart, other = map(np.asarray, cKDTree(keys).query(keys, NOISE.most_neighbours + 1, p=np.inf))
    first, k = np.nonzero(apart <= NOISE.near_pose)
    pairs = np.sort(np.column_stack([first, other[first, k]]), axis=1)
    pairs, at = np.unique(pairs, axis=0, return_index=True)
    apart, differ = apart[first, k][at], pairs[:, 0] != pairs[:, 1]
    return pairs[differ, 0], pairs[differ, 1], apart[differ]


def nearly_same(poses: Observations) -> tuple[Index, Index]:
    """Return the poses of pairs that are nearly the same, the nearest first, each pose once."""
    keys = np.column_stack([poses.states.q_rad, poses.states.load_N])
    pairs = cKDTree(keys).query_pairs(NOISE.same_pose, p=np.inf, output_type="ndarray")
    apart = np.abs(keys[pairs[:, 0]] - keys[pairs[:, 1]]).max(axis=1, initial=0.0)
    taken = np.zeros(len(poses), dtype=bool)
    chosen = []
    for k in np.argsort(apart, kind="stable"):
        if not taken[pairs[k]].any():
            taken[pairs[k]] = True
            chosen.append(k)
    found = pairs[np.array(chosen, dtype=np.intp)]
    return found[:, 0], found[:, 1]


def same_circumstances(readings: Observations) -> Index:
    """Return (P,) a number for every pose, load and direction of arrival, from 0."""
    _, pose = np.unique(readings.pose, return_inverse=True)
    keys = np.column_stack([pose, readings.states.load_N, readings.states.arrival])
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()


def repeated(readings: Observations) -> int:
    """Return how many readings repeat one of the same pose, load and direction of arrival.

    Of the same pose and load, where hardly any is reached from the same side twice.
    """
    return len(_pairs(readings)[0])


def repeat_groups(readings: Observations) -> Index:
    """Return (P,) a number for readings that are compared as repeats, from 0; see `repeated`."""
    same = same_circumstances(readings)
    pairs = len(readings) - len(np.unique(same))
    if pairs >= NOISE.least_repeated_share * len(readings):
        return same
    any_side = reading_groups(readings)
    return (
        any_side
        if len(readings) - len(np.unique(any_side)) > NOISE.any_side_ratio * pairs
        else same
    )


def _pairs(readings: Observations) -> tuple[Index, Index]:
    """Return readings and their next ones of the same circumstances; see `repeated`."""
    circumstances = repeat_groups(readings)
    order = np.lexsort((readings.states.time_s, circumstances))
    pairs = np.flatnonzero(np.diff(circumstances[order]) == 0)
    return order[pairs], order[pairs + 1]


def _along(difference: Array, columns: Array, sizes: Array, seen: Mask) -> Array:
    """Return what columns (D, b, n), each times a number, explain of differences (D, b)."""
    weight = np.where(seen, 1.0 / np.where(sizes > 0.0, sizes, 1.0), 0.0)
    white = (columns * weight[..., None]).reshape(-1, columns.shape[2])
    amounts = np.linalg.lstsq(white, (difference * weight).ravel(), rcond=None)[0]
    explained: Array = columns @ amounts
    return explained


def whitener_of(cov: Array) -> Array:
    """Return what makes components of covariances (P, b, b) independent and of unit size."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)), dtype=np.float64)


def mean_covariance(cov: Array, seen: Mask, code: Index) -> Array:
    """Return the covariance (G, b, b) of the means of independent readings of each group.

    By that of the readings (P, b, b), the components that each has (P, b), and the number of each
    one's group (P,), from 0, none omitted.
    """
    count = np.bincount(code)
    total, times = np.zeros((len(count), *cov.shape[1:])), np.zeros((len(count), cov.shape[1]))
    if seen.all():
        np.add.at(total, code, cov)
        return np.asarray(total / count[:, None, None] / count[:, None, None])
    np.add.at(times, code, seen)
    share = seen / np.maximum(times, 1.0)[code]
    np.add.at(total, code, share[:, :, None] * cov * share[:, None, :])
    return _whole(total, times > 0.0)


def _whole(cov: Array, seen: Mask) -> Array:
    """Return covariances (P, b, b) with one where nothing was seen: such rows are all zero."""
    here = np.where(seen[:, :, None] & seen[:, None, :], cov, 0.0)
    return here + np.eye(seen.shape[1]) * ~seen[:, :, None]


def _variance_components(difference: Array, sources: Array, seen: Mask) -> Array:
    """Fit non-negative variances of sources (D, s, b, b) to the squares of differences (D, b).

    Whitened by the covariance found before, all products of components weigh about the same.
    """
    count = sources.shape[1]
    if seen.all():
        about = np.atleast_2d(np.cov(difference.T, bias=True))
    else:
        about = np.diag(np.sum(difference**2, axis=0) / np.maximum(seen.sum(axis=0), 1))
    expected = np.broadcast_to(about, (len(difference), *about.shape))
    variances = np.zeros(count)
    for _ in range(NOISE.reweighted):
        whiten = whitener_of(_whole(expected, seen))
        white = np.einsum("pij,pj->pi", whiten, difference)
        squares = np.einsum("pi,pj->pij", white, white)
        whitened = np.einsum("pij,psjk,plk->psil", whiten, sources, whiten, optimize=True)
        rows = whitened.transpose(0, 2, 3, 1).reshape(-1, count)
        size = np.linalg.norm(rows, axis=0)
        size[size == 0.0] = 1.0
        q, triangle = np.linalg.qr(rows / size)  # a square system of the same solution
        variances = nnls(triangle, q.T @ squares.ravel())[0] / size
        expected = np.einsum("s,psij->pij", variances, sources)
    # What remains over all components is a common factor.
    whiten = whitener_of(_whole(expected, seen))
    white = np.einsum("pij,pj->pi", whiten, difference)
    return variances * float(np.sum(white**2) / seen.sum())


# Noise of logged torques where repeats do not show it: it moves predictions through springs.


def with_torque_noise(
    noise: Noise, at: FittedModel, poses: Observations, payload: Payload | None
) -> Noise:
    """Return stated noise with what the noise of logged torques adds to it by way of the springs.

    Noise found from pairs of readings holds it already. The noise of torques is what they scatter
    by about those of weights known but for factors; zero of a joint with too few poses to say. The
    poses are complete; the payload is None where the masses are not known.
    """
    springs = [term for term in at.model.terms if yields(term)]
    if noise.differences or payload is None or not springs:
        return noise
    states = poses.states
    weights = statics_of(at.model, at.x, states, payload).static_loads
    left_Nm, torque_Nm = states.tau_Nm - weights.joint_Nm, np.zeros(states.n)
    one = np.ones(len(states))
    for j in range(states.n):
        of_weights = weights.joint_Nm[:, j], weights.by_weights[:, j]
        columns = np.column_stack([one, states.arrival[:, j], states.load_N, *of_weights])
        x, _, rank, _ = np.linalg.lstsq(columns, left_Nm[:, j], rcond=COMPUTING.least_singular)
        dof = len(states) - int(rank)
        if dof >= NOISE.torques_a_weight * int(rank):
            torque_Nm[j] = np.sqrt(np.sum((left_Nm[:, j] - columns @ x) ** 2) / dof)
    turned_rad = np.zeros(states.q_rad.shape)
    for spring in springs:
        turned_rad[:, spring.joint - 1] += spring.by_torque(states, at.values_of(spring))
    moved = by_every_joint(at, poses) * (turned_rad * torque_Nm)[:, None, :]
    return replace(noise, cov=noise.cov + moved @ np.swapaxes(moved, 1, 2), torque_Nm=torque_Nm)


# Weights of poses: stated uncertainty, scatter of the residuals, and less far outside.
#
# A pose is weighted by the covariance that the instrument states, brought to the scatter that a
# model leaves: what the model lacks scatters like noise, and positions and orientations are to
# weigh by what the data really have. A pose far outside that scatter weighs less (Huber); none is
# omitted.


@dataclass(frozen=True)
class PoseWeights:
    """Whitening and weights of P poses."""

    whitener: Array  # (P, b, b) makes the residuals of each pose independent and of unit size
    weight: Array  # (P,) 1, or less far outside the scatter

    def whiteners(self, rows: Index | slice = slice(None)) -> Array:
        """Return the whiteners of all or some poses times the roots of their weights."""
        found: Array = np.sqrt(self.weight[rows])[:, None, None] * self.whitener[rows]
        return found

    def widened(self, by: Widening) -> PoseWeights:
        """Return the weights of poses whose components scatter otherwise than by their median."""
        if by == AS_FOUND:
            return self
        scale = np.full(self.whitener.shape[1], by.attitudes)
        scale[list(by.positions)] = 1.0
        return replace(self, whitener=self.whitener * (scale / by.scatter)[:, None])


@dataclass(frozen=True)
class Widening:
    """By how much components scatter otherwise than the median of what is left says."""

    scatter: float = 1.0  # of all of them, in that of the median
    # weight of what is no position, in that of its scatter: errors that go with the pose do not
    # average out, however many poses there are
    attitudes: float = 1.0
    positions: tuple[int, ...] = ()  # columns of positions


AS_FOUND = Widening()


def unweighted(measured: Instrument) -> PoseWeights:
    """Return the weights by what the instrument states alone."""
    stated = measured.stated_covariance
    return PoseWeights(whitener_of(stated), np.ones(len(stated)))


def pose_weights(residual: Array, dof: float, measured: Instrument) -> PoseWeights:
    """Weigh poses by what a model leaves of their components, (P, b).

    The residuals are smaller by the parameters that the data determine, `dof`. The instrument
    states the covariance of the components, and which were seen.
    """
    stated, seen = measured.stated_covariance, measured.components_seen
    rows = int(seen.sum())
    inflate = rows / max(rows - dof, NOISE.least_left_share * rows)
    covariance = stated.copy()
    for _, kind in measured.component_kinds:
        here = seen[:, kind]
        found = inflate * (NOISE.median_to_sigma * np.median(np.abs(residual[:, kind][here]))) ** 2
        variances = np.diagonal(stated[:, kind, kind], axis1=1, axis2=2)
        said = float(np.median(variances[here]))
        if found < said:
            shrink = max(np.sqrt(found / said), NOISE.least_shrink)
            covariance[:, kind] *= shrink
            covariance[:, :, kind] *= shrink
        else:
            at = range(residual.shape[1])[kind]
            covariance[:, at, at] += (found - said) * here
    whitener = whitener_of(covariance)
    distance = np.linalg.norm((whitener @ residual[:, :, None])[:, :, 0], axis=1)
    limit = np.sqrt(chdtri(np.maximum(seen.sum(axis=1), 1), NOISE.huber_tail))
    return PoseWeights(whitener, np.minimum(1.0, limit / np.maximum(distance, limit)))


# What single poses scatter by: where joints come to stand, and the instrument.
#
# A controller stops a joint where friction lets it, some ten microradians from where it is told,
# and all directions that the joint moves are off together. What poses are left with by a model is
# split into a scatter of every joint's position and one of every kind of component, by maximum
# likelihood. With the uncertainty of the model it makes the interval in which a measured pose is
# to be expected.


@dataclass(frozen=True, eq=False)
class PoseDeviations:
    """Standard deviations of single poses about a model."""

    joints: Array  # (n,) of joint positions [rad, m]
    kinds: Mapping[str, float]  # of each kind of component, by its name [m, rad]

    def covariance(self, at: FittedModel, poses: Observations) -> Array:
        """Return the covariance of the components of poses, (P, b, b)."""
        turned = by_joints(at, poses, range(1, at.arm.n + 1)) * self.joints
        found = turned @ np.swapaxes(turned, 1, 2)
        for name, kind in poses.measured.component_kinds:
            own = np.arange(found.shape[1])[kind]
            found[:, own, own] += self.kinds[name] ** 2
        return np.asarray(found, dtype=np.float64)


def scatter_of(at: FittedModel, poses: Observations, left: Array) -> PoseDeviations:
    """Return what complete poses of its fit scatter by about a model that leaves (P, b) of them."""
    every = max(1, len(poses) // NOISE.enough_poses)
    poses, left = poses.take(np.arange(0, len(poses), every)), left[::every]
    turned = by_joints(at, poses, range(1, at.arm.n + 1))
    parts = [own[:, :, None] * own[:, None, :] for own in np.moveaxis(turned, 2, 0)]
    seen, unit = poses.measured.components_seen, np.eye(left.shape[1])
    parts += [np.diag(unit[kind].sum(axis=0))[None] for _, kind in poses.measured.component_kinds]
    unseen = np.where(seen, 0.0, 1.0)[:, :, None] * unit
    both = seen[:, :, None] & seen[:, None, :]
    parts = [np.where(both, part, 0.0) for part in parts]
    left = np.where(seen, left, 0.0)

    def cost(logs: Array) -> tuple[float, Array]:
        sizes = np.exp(logs)
        covariance = unseen + sum(size * part for size, part in zip(sizes, parts, strict=True))
        inverse = np.linalg.inv(covariance)
        white = (inverse @ left[:, :, None])[:, :, 0]
        value = np.linalg.slogdet(covariance)[1].sum() + np.sum(white * left)
        slope = inverse - white[:, :, None] * white[:, None, :]
        by_size = np.array([np.sum(slope * part) for part in parts])
        return float(value) / len(left), sizes * by_size / len(left)

    of_kinds = {  # half the mean square of each
        name: max(float(np.mean(left[:, kind][seen[:, kind]] ** 2)) / 2.0, NOISE.variances[0])
        for name, kind in poses.measured.component_kinds
    }
    start = np.log(np.concatenate([np.full(at.arm.n, NOISE.first_variance), [*of_kinds.values()]]))
    found = minimize(
        cost,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=[(np.log(NOISE.variances[0]), np.log(NOISE.variances[1]))] * len(start),
        options={"maxiter": COMPUTING.noise_steps},
    )
    sizes = np.exp(0.5 * found.x)
    return PoseDeviations(
        sizes[: at.arm.n], dict(zip(of_kinds, sizes[at.arm.n :].tolist(), strict=True))
    )


def share_inside(
    fitted: FittedModel, scatter: PoseDeviations, poses: Observations, left: Array | None = None
) -> float:
    """Return the share of coordinates of measured positions that lie in their 95 % intervals.

    By a model with its covariance, the scatter of single poses, and predicted less measured (P, b).
    """
    left = fitted.compared(poses).residual if left is None else left
    of_poses = scatter.covariance(fitted, poses)
    off_m, variance = position_m(fitted, poses, left, of_poses)
    forward = Forward.of(fitted, TOOL_FRAME)
    R = fitted.T_instr_base[:3, :3]
    own = R @ forward.position_covariance(poses.states, forward.end(poses.states)) @ R.T
    total = variance + np.diagonal(own, axis1=1, axis2=2)
    seen = np.isfinite(off_m) & (total > 0.0)
    inside = np.abs(off_m[seen]) <= HALF_WIDTH_95 * np.sqrt(total[seen])
    return float(inside.mean())
