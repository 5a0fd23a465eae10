"""Where model and data disagree: the remaining error against noise, and where it sits.

Everything is stated of cells: readings of a pose that have been averaged, or single poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.discovery.linear import by_joints, error_mm, position_m, position_noise, residual
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations

# Weighted means and slopes whose uncertainty counts poses, not rows.
#
# Rows of a pose share its errors, so what scatters from pose to pose decides (the cluster-robust
# covariance of Liang and Zeger, with the usual factor for few clusters).

#: What differs by a smaller part than this is the same.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Estimate:
    """A number with its standard uncertainty, nan where there is one pose only."""

    value: float
    std: float


def mean(values: Array, weight: Array, pose: NDArray[np.str_]) -> Estimate:
    """Return the weighted mean of (C,) values of cells at (C,) poses."""
    return _last_coefficient(np.ones((len(values), 1)), values, weight, pose)


def slope(by: Array, values: Array, weight: Array, pose: NDArray[np.str_]) -> Estimate | None:
    """Return the slope of (C,) values by (C,) another quantity, beside a constant.

    None where that quantity is the same in all of them, but for rounding, or not known.
    """
    if not np.ptp(by) > _ROUNDING * np.abs(by).max():
        return None
    columns = np.column_stack([np.ones(len(by)), by - by.mean()])
    return _last_coefficient(columns, values, weight, pose)


def _last_coefficient(
    columns: Array, values: Array, weight: Array, pose: NDArray[np.str_]
) -> Estimate:
    weighted = columns * weight[:, None]
    inverse = np.linalg.inv(columns.T @ weighted)
    found = inverse @ (weighted.T @ values)
    _, cluster = np.unique(pose, return_inverse=True)
    count = int(cluster.max()) + 1
    if count < 2:
        return Estimate(float(found[-1]), np.nan)
    scores = np.zeros((count, columns.shape[1]))
    np.add.at(scores, cluster, weighted * (values - columns @ found)[:, None])
    covariance = inverse @ (scores.T @ scores) @ inverse * count / (count - 1)
    return Estimate(float(found[-1]), float(np.sqrt(covariance[-1, -1])))


# Residuals of the model as errors of joint angles, and how they depend on each joint's angle.
#
# A picture of where to look, not a test: the angles of one cell are found from six numbers, so an
# error that no joint makes shows in several of them.

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


AXES = ("x", "y", "z")
#: Of more cells only so many, spread evenly over time, stand for all where each is looked at.
MOST_CELLS = 1200
_HOUR_S = 3600.0


@dataclass(frozen=True)
class PureErrorTest:
    """Remaining error against pure error: Fisher's F."""

    chi_square: float  # sum of squares in units of the pure error's variance
    dof: float  # rows less what the parameters took of them
    pure_dof: int  # behind the pure error, from repeats

    @property
    def ratio(self) -> float:
        """Return F, near one where the model lacks nothing."""
        return self.chi_square / self.dof

    @property
    def p_value(self) -> float:
        """Return the probability of so large an F where the model lacks nothing."""
        return float(fdtrc(self.dof, self.pure_dof, self.ratio))


@dataclass(frozen=True)
class ChannelTest:
    """Lack of fit of one channel, row by row; the verdict rests on poses, not on this."""

    # what the cells of a pose share, by load, direction and time; None without such rows
    shared: PureErrorTest | None
    unshared: PureErrorTest | None  # what differs among them beyond that; None without such rows
    # of an error that the cells of a pose share and that would explain the residuals, in variances
    # of one reading
    shared_variance: float


@dataclass(frozen=True)
class Part:
    """Position error over some cells, or along one axis."""

    of: str  # which: `22 N`, a pose's label, or `x`, `y`, `z` of the instrument
    cells: int  # how many
    rms_mm: float  # root mean square of the error
    floor_mm: float  # what the noise of these cells alone would leave


@dataclass(frozen=True)
class Arrival:
    """Mean over the cells at which a joint arrived from one side."""

    direction: int  # +1 or -1
    cells: int  # how many
    mean: Estimate  # of the joint's angle error [rad] or of its torque left [N m]


@dataclass(frozen=True)
class JointPart:
    """Angle error of one joint."""

    joint: int  # 1 … n
    rms_rad: float  # root mean square, cells weighted by their information on the joint
    floor_rad: float  # what noise alone would leave
    arrivals: tuple[Arrival, ...]  # by direction of arrival
    # by the joint's angle, None for a prismatic joint or hardly turned
    periodogram: Periodogram | None


@dataclass(frozen=True)
class TorquePart:
    """Torque of one joint minus that of the weights."""

    joint: int  # 1 … n
    rms_Nm: float  # root mean square
    noise_Nm: float  # what the noise of the cells alone would leave
    arrivals: tuple[Arrival, ...]  # by direction of arrival


@dataclass(frozen=True)
class Drift:
    """Slope of the measured less the predicted position along one axis of the instrument."""

    axis: str  # `x`, `y` or `z`
    # with time; None where the cells have the same mean time, as with a way there and back
    mm_per_h: Estimate | None
    mm_per_K: Estimate | None  # with temperature, None where it was not logged or did not change


@dataclass(frozen=True)
class LackOfFit:
    """Where a fit and the data disagree."""

    pose: ChannelTest | None  # lack of fit of the poses against pure error; None without repeats
    # of the torques; None where they or the weights are not known, or without repeats
    torque: ChannelTest | None
    # rms_mm and floor_mm: position error over all cells, and what noise alone would leave
    rms_mm: float
    floor_mm: float
    # by_load, by_pose and by_axis: the same by part; no poses where each is measured once
    by_load: tuple[Part, ...]
    by_pose: tuple[Part, ...]
    by_axis: tuple[Part, ...]
    by_joint: tuple[JointPart, ...]  # in joint space
    by_torque: tuple[TorquePart, ...]  # torques left, none where they are not known
    drifts: tuple[Drift, ...]  # along the instrument's axes
    # C cells; of many poses so many as a picture shows, spread evenly over time
    cells: Observations
    position_mm: Array  # (C, 3) measured less predicted, along the instrument's axes
    joints: JointErrors  # in joint space, cell by cell
    torque_left_Nm: Array | None  # (C, n) logged less predicted, None where it is not known


@dataclass(frozen=True)
class CellResiduals:
    """Residuals of C cells about a model."""

    at: FittedModel  # the model
    cells: Observations  # the cells, complete
    components: Array  # (C, b) measured minus predicted [m, rad]
    cov: Array  # (C, b, b) covariance of the cells' noise
    screws: Array  # (C, b, n) how the components follow the joints

    @classmethod
    def about(cls, at: FittedModel, poses: Observations, cov: Array) -> CellResiduals:
        """Return the residuals of complete poses, whose components have a covariance (P, b, b)."""
        joints = range(1, poses.states.n + 1)
        return cls(at, poses, -residual(at, poses), cov, by_joints(at, poses, joints))


@dataclass(frozen=True)
class TorqueResiduals:
    """Logged torques minus those of weights and model."""

    torque_Nm: Array  # (C, n) logged minus predicted
    noise_Nm: Array  # (n,) standard deviation of one reading


def lack_of_fit(
    left: CellResiduals,
    tests: tuple[ChannelTest | None, ChannelTest | None] = (None, None),
    torques: TorqueResiduals | None = None,
) -> LackOfFit:
    """Compute where a model and the data disagree.

    Args:
        left: what the model leaves.
        tests: of poses and of torques against pure error; None without repeats.
        torques: what it leaves of the torques; None where that is not known.
    """
    cells, n = left.cells, left.cells.states.n
    squares = error_mm(cells.measured, left.components) ** 2
    noise = 1e6 * np.trace(position_noise(cells.measured, left.cov), axis1=1, axis2=2)
    found_m, found_m2 = position_m(left.at, cells, left.components, left.cov)
    position_mm, noise_mm2 = 1e3 * found_m, 1e6 * found_m2
    last, most = len(cells) - 1, min(len(cells), MOST_CELLS)
    shown = np.unique(np.linspace(0, last, most).round().astype(int))
    some = cells.take(shown)
    white = np.linalg.inv(np.linalg.cholesky(left.cov[shown]))
    joints = joint_errors(white @ left.screws[shown], white @ left.components[shown, :, None])
    arm = left.at.model.chain.arm
    return LackOfFit(
        pose=tests[0],
        torque=tests[1],
        rms_mm=_root_mean(squares),
        floor_mm=_root_mean(noise),
        by_load=_parts([f"{load:g} N" for load in cells.states.load_N], squares, noise),
        by_pose=() if tests[0] is None else _parts(cells.pose.tolist(), squares, noise),
        by_axis=tuple(
            Part(axis, len(cells), _root_mean(position_mm[:, k] ** 2), _root_mean(noise_mm2[:, k]))
            for k, axis in enumerate(AXES)
        ),
        by_joint=tuple(_joint_part(arm, some, joints, j) for j in range(n)),
        by_torque=()
        if torques is None
        else tuple(_torque_part(cells, torques, j) for j in range(n)),
        drifts=tuple(_drift(cells, axis, position_mm[:, k]) for k, axis in enumerate(AXES)),
        cells=some,
        position_mm=position_mm[shown],
        joints=joints,
        torque_left_Nm=None if torques is None else torques.torque_Nm[shown],
    )


def _joint_part(arm: Arm, cells: Observations, joints: JointErrors, j: int) -> JointPart:
    error, weight = joints.error_rad[:, j], joints.weight[:, j]
    share = weight / weight.sum()
    return JointPart(
        joint=j + 1,
        rms_rad=float(np.sqrt(share @ error**2)),
        floor_rad=float(np.sqrt(share @ joints.std_rad[:, j] ** 2)),
        arrivals=_arrivals(cells, error, weight, j),
        periodogram=None
        if arm.prismatic[j]
        else periodogram(cells.states.q_rad[:, j], error, weight, float(arm.gear_ratio[j])),
    )


def _torque_part(cells: Observations, torques: TorqueResiduals, j: int) -> TorquePart:
    left_Nm = torques.torque_Nm[:, j]
    return TorquePart(
        joint=j + 1,
        rms_Nm=_root_mean(left_Nm**2),
        noise_Nm=_root_mean(torques.noise_Nm[j] ** 2 / cells.readings),
        arrivals=_arrivals(cells, left_Nm, cells.readings.astype(float), j),
    )


def _arrivals(cells: Observations, values: Array, weight: Array, j: int) -> tuple[Arrival, ...]:
    """Return the mean of values over the cells at which joint j (from 0) came from each side."""
    arrival, pose = cells.states.arrival[:, j], cells.pose
    return tuple(
        Arrival(sign, int(rows.sum()), mean(values[rows], weight[rows], pose[rows]))
        for sign in (-1, 1)
        if (rows := np.sign(arrival) == sign).any()
    )


def _drift(cells: Observations, axis: str, position_mm: Array) -> Drift:
    weight = cells.readings.astype(float)
    hours, kelvin = cells.states.time_s / _HOUR_S, cells.states.temperature_C
    return Drift(
        axis=axis,
        mm_per_h=slope(hours, position_mm, weight, cells.pose),
        mm_per_K=slope(kelvin, position_mm, weight, cells.pose),
    )


def _parts(of: list[str], squares: Array, noise: Array) -> tuple[Part, ...]:
    """Return the parts of cells by a label of each, in the order in which labels first come."""
    labels, first, group = np.unique(of, return_index=True, return_inverse=True)
    count = np.bincount(group)
    rms = np.sqrt(np.bincount(group, squares) / count)
    floor = np.sqrt(np.bincount(group, noise) / count)
    return tuple(
        Part(str(labels[k]), int(count[k]), float(rms[k]), float(floor[k]))
        for k in np.argsort(first)
    )


def _root_mean(squares: Array) -> float:
    return float(np.sqrt(np.mean(squares)))
