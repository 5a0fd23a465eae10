"""Conventions that agree with the nominal arm: of orientations, axes, polar readings and joints."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import Literal, NamedTuple, cast

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.arm.coupling import CoupledJoint
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index, spread
from pa10cal.campaign.bounds import outside_bounds, unwrapped
from pa10cal.campaign.column_map import ANGLES
from pa10cal.campaign.joint_positions import in_radians
from pa10cal.campaign.nominal_fit import misfit_of, placed_by_points
from pa10cal.campaign.own_columns import Polar, RotationColumns
from pa10cal.campaign.raw_file import polar_to_xyz, quaternions
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.frame.hand_eye import Located
from pa10cal.numerics.least_squares import best_candidate
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Misfit
from pa10cal.rules import FRAMES

EulerSequence = Literal["xyz", "XYZ", "zyx", "ZYX", "zyz", "ZYZ"]

#: Sequences of Euler angles in use: capitals about the axes that turn along.
SEQUENCES: tuple[EulerSequence, ...] = ("xyz", "XYZ", "zyx", "ZYX", "zyz", "ZYZ")
#: Conventions that three columns of an orientation may follow, the commonest first.
_USUAL = ("rpy", "euler_XYZ", "euler_ZYX", "euler_ZYZ", "fixed_zyx", "rotation_vector")
_EULER = tuple(a + b + c for a in "XYZ" for b in "XYZ" for c in "XYZ" if a != b != c)
_FIXED = (f"fixed_{axes.lower()}" for axes in _EULER)
THREE = tuple(dict.fromkeys((*_USUAL, *(f"euler_{axes}" for axes in _EULER), *_FIXED)))
FOUR = ("quaternion_wxyz", "quaternion_xyzw")
#: Misfit expected of the nominal arm, base and target fitted.
EXPECTED_M, EXPECTED_RAD = 2e-3, float(np.radians(1.0))
#: A remedy puts right if it leaves at most so many times the expected misfit, and the noise.
TIMES_EXPECTED, TIMES_NOISE = 5.0, 20.0
#: In messages of a change that leaves more.
STILL_WRONG = "which is better, and still wrong"
#: Orientations agree with the nominal arm if their rms angle from it is below this.
AGREES_RAD = TIMES_EXPECTED * EXPECTED_RAD
#: Another convention must reduce the misfit by this factor.
NEARER = 5.0
#: Rows that a convention needs, and rows that are used, at most.
ENOUGH, MOST = 6, 200
#: Poses whose orientation is tried as that with which the others agree, at most.
_STARTS = 10
#: A factor of lengths is sought where it differs from 1 by at least this.
_ANOTHER_SCALE = 0.01


def puts_right(remaining: float, expected: float, noise: float = np.inf) -> bool:
    """Return whether a remedy that leaves a `remaining` error removes what is wrong.

    It does if the error is as of right data: `expected` of a nominal arm, or the readings' noise,
    all in one unit.
    """
    return bool(remaining <= min(TIMES_EXPECTED * expected, TIMES_NOISE * noise))


@dataclass(frozen=True)
class Convention:
    """A convention that explains the orientations better than the one that was read."""

    name: str  # what the columns seem to hold, in words
    remedy: str
    scatter_rad: float  # rms angle from the nominal arm, base and target fitted, as read
    would_leave_rad: float  # the same in this convention


def better_convention(
    T_base_ee: Array, T_instr_target: Array, stated: RotationColumns | None = None, key: str = ""
) -> Convention | None:
    """Return the convention in which measured orientations agree with the nominal arm.

    Orientations alone do not determine it: most orders of a quaternion differ by a constant
    rotation, as unknown base and target do. The base is therefore fitted to the positions, and only
    the target's orientation to the orientations.

    None where the orientations agree as read, or in none of the conventions that are tried, or
    where the positions do not determine the base.

    Args:
        T_base_ee: (P, 4, 4) nominal end-effector [m].
        T_instr_target: (P, 4, 4) measured target [m].
        stated: columns that campaign.yaml states; None for quaternions under the contract's names.
        key: the key that states them.
    """
    if len(T_base_ee) < ENOUGH:
        return None
    some = spread(len(T_base_ee), MOST)
    T_base_ee, T_instr_target = T_base_ee[some], T_instr_target[some]
    R_ee, R = modelled_attitudes(T_base_ee, T_instr_target[:, :3, 3]), T_instr_target[:, :3, :3]
    if R_ee is None:
        return None
    as_read_rad = attitude_scatter(R_ee, R)
    if as_read_rad < AGREES_RAD:
        return None
    others = _of_the_contract(R) if stated is None else _of_own_columns(R, stated, key)
    tried = [
        Convention(
            *(other.name, other.remedy, as_read_rad),
            attitude_scatter(R_ee, _agreeing(R_ee, other.R)),
        )
        for other in others
    ]
    # Of equal scatters the first, which is the commonest convention.
    best = min(tried, key=lambda other: round(other.would_leave_rad, 3), default=None)
    if best is None or best.would_leave_rad > min(AGREES_RAD, as_read_rad / NEARER):
        return None
    return best


class _Meant(NamedTuple):
    """What the columns of an orientation may have been meant to be."""

    name: str  # in words
    remedy: str
    # (S, P, 3, 3) the orientations, if so, by each set of numbers that gives those that were read
    R: Array


def _agreeing(R_instr_ee: Array, R_sets: Array) -> Array:
    """Return of each pose that of its orientations (S, P, 3, 3) which agrees with other poses'.

    Orientations agree whose target on the end (P, 3, 3) has about the same orientation.
    """
    if len(R_sets) == 1:
        return np.asarray(R_sets[0])
    R_ee_target = np.swapaxes(R_instr_ee, 1, 2) @ R_sets
    poses = np.arange(R_sets.shape[1])
    starts = R_ee_target[:, spread(len(poses), _STARTS)].reshape(-1, 3, 3)
    likeness = np.einsum("kij,spij->ksp", starts, R_ee_target)  # it grows as the angle falls
    best = np.argmax(np.median(likeness.max(axis=1), axis=1))
    return np.asarray(R_sets[np.argmax(likeness[best], axis=0), poses])


def _sets_of_angles(rotation: Rotation, axes: str) -> Array:
    """Return both sets of Euler angles (2, P, 3) [deg] of rotations; small letters: fixed axes."""
    sequence = cast("EulerSequence", axes)
    first = rotation.as_euler(sequence, degrees=True, suppress_warnings=True)
    middle = -first[:, 1] if axes[0] == axes[2] else 180.0 - first[:, 1]
    second = np.column_stack([first[:, 0] + 180.0, middle, first[:, 2] + 180.0])
    return np.stack([first, (second + 180.0) % 360.0 - 180.0])


def _sets_of_vectors(rotation: Rotation) -> Array:
    """Return rotation vectors (4, P, 3) [deg] of rotations: the shortest, and whole turns longer.

    Three numbers of up to a turn each are at most two turns long.
    """
    shortest = rotation.as_rotvec(degrees=True)
    length = np.linalg.norm(shortest, axis=1, keepdims=True)
    axis = np.divide(shortest, length, out=np.zeros_like(shortest), where=length > 0.0)
    return np.stack([shortest + turns * 360.0 * axis for turns in (0, -1, 1, -2)])


def _of_the_contract(R: Array) -> Iterator[_Meant]:
    """Yield what quaternions under the contract's names may be instead, the commonest first."""
    quaternion = Rotation.from_matrix(R).as_quat(scalar_first=True)

    def ordered(order: tuple[int, ...]) -> _Meant:
        """Return quaternions whose column k holds component `order[k]` of w, x, y, z."""
        held = ", ".join("wxyz"[k] for k in order)
        columns = [order.index(component) for component in range(4)]
        other = Rotation.from_quat(quaternion[:, columns], scalar_first=True)
        name = f"quaternions in the order {held} under the headers qw, qx, qy, qz"
        return _Meant(name, f"rename the columns: they hold {held}", other.as_matrix()[None])

    def mistaken() -> Iterator[_Meant]:
        yield from map(ordered, ((1, 2, 3, 0), (3, 0, 1, 2)))
        for made, meant in product(SEQUENCES, repeat=2):
            if meant != made:
                angles = _sets_of_angles(Rotation.from_matrix(R), made)
                name = f"Euler angles {_sequence(meant)}, converted as {_sequence(made)}"
                remedy = f"convert them to quaternions as angles {_sequence(meant)}"
                other = Rotation.from_euler(meant, angles.reshape(-1, 3), degrees=True)
                yield _Meant(name, remedy, other.as_matrix().reshape(2, -1, 3, 3))

    yield _Meant(
        "the inverse rotation (instrument in target)",
        "convert the orientations from target in instrument to instrument in target, or back",
        np.swapaxes(R, 1, 2)[None],
    )
    for name, remedy, other in mistaken():
        yield _Meant(name, remedy, other)
        yield _Meant(f"{name}, inverted", f"{remedy}, and invert them", np.swapaxes(other, 2, 3))
    for axes in list(permutations((1, 2, 3)))[1:]:
        yield ordered((0, *axes))


def _of_own_columns(R: Array, stated: RotationColumns, key: str) -> Iterator[_Meant]:
    """Yield what a user's own columns may be instead of what campaign.yaml states under `key`."""
    if stated.inverse == "pose":  # positions depend on the convention and show that it is right
        return
    words = {3: THREE, 4: FOUR}.get(len(stated.names), (stated.convention,))
    rotation, read_as = Rotation.from_matrix(R), stated.convention
    rotation = rotation.inv() if stated.inverse else rotation
    # Sets of numbers (S, P, k) of which one is in the columns, angles in degrees.
    if read_as == "matrix":
        values = rotation.as_matrix().reshape(1, -1, 9)
    elif read_as.startswith("quaternion"):
        values = rotation.as_quat(scalar_first=read_as.endswith("wxyz"))[None]
    elif read_as == "rotation_vector":
        values = _sets_of_vectors(rotation)
    else:
        axes = "xyz" if read_as == "rpy" else read_as.rpartition("_")[2]
        values = _sets_of_angles(rotation, axes)
    count, poses, width = values.shape
    for inverse in (stated.inverse, not stated.inverse):
        for word in (read_as, *words):
            if (word, inverse) == (read_as, stated.inverse):
                continue
            changed = {"convention": word, "inverse": inverse, "unit": "deg", "u": None}
            named, remedy = [], []
            if word != read_as:
                named.append(f"{_in_words(word)}, read as {_in_words(read_as)}")
                remedy.append(f"set {key}.convention: {word}")
            if inverse != stated.inverse:
                named.append("the inverse rotation" + " (instrument in target)" * inverse)
                remedy.append(f"set {key}.inverse: {str(inverse).lower()}")
            columns = stated.model_copy(update=changed)
            other = quaternions(values.reshape(-1, width), columns)
            R_other = Rotation.from_quat(other, scalar_first=True).as_matrix()
            R_other = R_other.reshape(count, poses, 3, 3)
            yield _Meant(", and ".join(named), " and ".join(remedy), R_other)


def _in_words(convention: str) -> str:
    """Return a convention of orientations in words."""
    kind, _, axes = convention.partition("_")
    if kind == "quaternion":
        return f"quaternions in the order {', '.join(axes)}"
    if kind in ("rotation", "matrix"):
        return "rotation vectors" if kind == "rotation" else "matrices"
    return f"Euler angles {_sequence(axes or 'xyz')}"


def _sequence(word: str) -> str:
    axes = "-".join(word.upper())
    return f"{axes} about {'moving' if word.isupper() else 'fixed'} axes"


@dataclass(frozen=True)
class OtherAxes:
    """Axes of the instrument that explain the positions better than those that were read."""

    name: str  # what the columns x, y, z seem to hold, in words
    left_m: float  # median misfit of the nominal arm as read
    would_leave_m: float  # the same with these axes
    order: tuple[int, ...]  # axis that each of the three columns holds
    turned: tuple[int, ...]  # columns with the opposite sign
    any_one: bool = False  # whether only one of `turned` has it, and which one is not known

    @property
    def puts_right(self) -> bool:
        """Return whether they leave no more than right data of a nominal arm do."""
        return puts_right(self.would_leave_m, EXPECTED_M)


def other_axes(T_base_ee: Array, p_m: Array, R: Array | None) -> OtherAxes | None:
    """Return how x, y, z of an instrument are exchanged or reversed, if that explains the rows.

    The base is fitted, so positions p_m (P, 3) of one target show only that the frame is mirrored.
    Its measured orientations R (P, 3, 3) show which axis is reversed, and which are exchanged. None
    where the axes fit as they are.
    """
    some = spread(len(p_m), MOST)
    T_base_ee, p_m = T_base_ee[some], p_m[some]
    read, mirrored = (placed_by_points(T_base_ee, seen[:, None]) for seen in (p_m, -p_m))
    if len(p_m) < ENOUGH or read is None or mirrored is None:
        return None

    def misfit_m(seen_m: Array, located: Located) -> float:
        off_m = seen_m - located.targets(T_base_ee)[:, 0, :3, 3]
        return float(np.median(np.linalg.norm(off_m, axis=1)))

    read_m, mirrored_m = misfit_m(p_m, read), misfit_m(-p_m, mirrored)
    if R is None:
        if read_m < NEARER * mirrored_m:
            return None
        name = "mirrored: a left-handed frame"
        return OtherAxes(name, read_m, mirrored_m, (0, 1, 2), (0, 1, 2), any_one=True)
    R = R[some]
    R_read, R_mirrored = (
        located.T_instr_base[:3, :3] @ T_base_ee[:, :3, :3] for located in (read, mirrored)
    )

    def changed(order: tuple[int, ...], signs: tuple[float, ...]) -> _ChangedAxes:
        axes = np.diag(signs)[:, list(order)]
        # A rotation of the frame is one of the fitted base, so two fits serve all axes.
        if np.linalg.det(axes) > 0.0:
            return _ChangedAxes(order, signs, read_m, attitude_scatter(axes @ R_read, R))
        return _ChangedAxes(order, signs, mirrored_m, attitude_scatter(-axes @ R_mirrored, R))

    every = product(permutations(range(3)), product((1.0, -1.0), repeat=3))
    as_read, *others = (changed(order, signs) for order, signs in every)
    best = min((as_read, *others), key=lambda axes: axes.rank)
    if best is as_read or best.turn_rad > AGREES_RAD or as_read.total_m < NEARER * best.total_m:
        return None
    turned = tuple(column for column, k in enumerate(best.order) if best.signs[k] < 0.0)
    held = ", ".join(f"{'-' if best.signs[k] < 0.0 else ''}{'xyz'[k]}" for k in best.order)
    name = f"{held} in place of x, y, z"
    return OtherAxes(name, read_m, best.misfit_m, best.order, turned)


@dataclass(frozen=True)
class _ChangedAxes:
    """Axes of the instrument exchanged or reversed, and how well the nominal arm then agrees."""

    order: tuple[int, ...]  # axis that each of the columns x, y, z holds
    signs: tuple[float, ...]  # of each axis, 1 or -1
    misfit_m: float  # median misfit of the positions
    turn_rad: float  # rms angle of the orientations

    @property
    def total_m(self) -> float:
        """Return the misfit of positions and orientations together, angles times a usual lever."""
        return self.misfit_m + FRAMES.lever_m * self.turn_rad

    @property
    def rank(self) -> tuple[float, bool, int, float, float]:
        """Return what ranks axes: the misfit, then how many axes are exchanged and reversed."""
        reversed_count = sum(sign < 0.0 for sign in self.signs)
        exchanged = self.order != (0, 1, 2)
        return round(self.total_m, 3), exchanged, reversed_count, self.misfit_m, self.turn_rad


@dataclass(frozen=True)
class PolarReading:
    """How polar readings count, and their misfit to the nominal arm."""

    polar: Polar
    length: str  # unit of the distance
    scatter_m: float | None  # rms misfit; None where it is not known


def read_polar(
    values: Array,
    angles: Sequence[str],
    lengths: Sequence[str],
    T_base_ee: Array | None,
    *,
    by_horizon: bool,
) -> PolarReading:
    """Return how polar readings (N, 3) count, by the misfit of the nominal arm T_base_ee (N, 4, 4).

    Where the arm is not known (None), or no way fits: the unit of angles is the largest in which
    all are within a turn, and the vertical angle counts as its name says.

    Args:
        values: horizontal angle, vertical angle and distance.
        angles: possible units of the angles.
        lengths: possible units of the distance.
        T_base_ee: the nominal end.
        by_horizon: whether the vertical angle is called one from the horizon.
    """
    usual = "horizon" if by_horizon else "zenith"
    turn = {unit: 360.0 / ANGLES[unit] for unit in angles}
    largest = float(np.nanmax(np.abs(values[:, :2]), initial=0.0))
    units = ("rad", "deg", "gon", "mrad")
    possible = [unit for unit in units if largest <= 1.05 * turn.get(unit, 0.0)] or list(angles)
    far = float(np.nanmedian(values[:, 2])) if len(values) else 0.0
    length = lengths[0] if len(lengths) == 1 else "mm" if far > 100.0 else "m"

    def counting(unit: str, way: str, up: str) -> Polar:
        return Polar.model_validate({"unit": unit, "horizontal": way, "vertical": up})

    by_name = PolarReading(counting(possible[0], "clockwise", usual), length, None)
    if T_base_ee is None:
        return by_name
    finite = np.isfinite(values).all(axis=1) & np.isfinite(T_base_ee).all(axis=(1, 2))
    rows = np.flatnonzero(finite)
    rows = rows[spread(len(rows), MOST)]
    tried = [by_name]
    for way in product(possible, ("clockwise", "counterclockwise"), ("zenith", "horizon")):
        polar = counting(*way)
        p_m = 1e-3 * polar_to_xyz(values[rows], polar, length)
        located = placed_by_points(T_base_ee[rows], p_m[:, None]) if len(rows) >= 4 else None
        if located is not None:
            tried.append(PolarReading(polar, length, located.scatter_m))
    return min(tried, key=lambda way: np.inf if way.scatter_m is None else way.scatter_m)


def modelled_attitudes(T_base_ee: Array, p_instr_m: Array) -> Array | None:
    """Return the nominal end-effector's orientations (P, 3, 3) in the instrument's frame.

    The base is fitted to the positions (P, 3) of one target; None where they do not determine it.
    """
    located = placed_by_points(T_base_ee, p_instr_m[:, None])
    return None if located is None else located.T_instr_base[:3, :3] @ T_base_ee[:, :3, :3]


def attitude_scatter(R_instr_ee: Array, R_instr_target: Array) -> float:
    """Return the rms angle [rad] of orientations from R_instr_ee R_ee_target, which is fitted."""
    R_ee_target = Rotation.from_matrix(np.swapaxes(R_instr_ee, 1, 2) @ R_instr_target)
    off = (R_ee_target * R_ee_target.mean().inv()).magnitude()
    return float(np.sqrt(np.mean(off**2)))


def attitudes_off_rad(measured: Instrument, T_base_ee: Array) -> float:
    """Return the median angle of orientations off the nominal end (P, 4, 4), frames fitted.

    0 where the poses do not determine these.
    """
    misfit = misfit_of(measured, T_base_ee)
    return 0.0 if misfit is None else float(np.median(misfit.turn_rad))


def other_scale(
    measured: Instrument, T_base_ee: Array, misfit: Misfit
) -> tuple[float, float] | None:
    """Return the factor to divide lengths by so that the nominal arm fits, and the misfit then [m].

    None where no single factor puts the readings right.
    """
    scale = measured.scale(T_base_ee)
    if scale is None or not scale > 0.0 or abs(scale - 1.0) < _ANOTHER_SCALE:
        return None
    scaled = misfit_of(measured.scaled(scale), T_base_ee)
    scaled_m = np.inf if scaled is None else float(np.nanmedian(scaled.length_m))
    as_read_m = float(np.nanmedian(misfit.length_m))
    fits = NEARER * scaled_m < as_read_m and puts_right(scaled_m, EXPECTED_M)
    return (1.0 / scale, scaled_m) if fits else None


# Logs whose joints exceed the limits of the arm, although the rows are right. Three causes are
# tested: the controller counts a joint together with another one (joint 3 to the horizontal), two
# columns are exchanged or one has the other sign, or angles are whole turns off. A cause is
# accepted only if with it the nominal arm, base and target fitted, agrees with all readings.

#: All coupled joints of an arm.
Coupled = tuple[CoupledJoint, ...]
#: Returns the nominal end (r, 4, 4) at some rows (r,) of a log.
EndsAt = Callable[[Index], Array]
#: Rows by which candidates are compared; only the best of them is fitted to all rows.
_COMPARED_ROWS = 100


def couplings_near(arm: Arm) -> Iterator[Coupled]:
    """Yield couplings that differ from the arm's in the factor (1, -1 or 0) of one pair of joints.

    Both joints of a pair slide or both turn; pairs of neighbours come first.
    """
    pairs = permutations((arm.coupling.own + 1).tolist(), 2)
    for joint, by in sorted(pairs, key=lambda pair: abs(pair[0] - pair[1])):
        if arm.prismatic[joint - 1] != arm.prismatic[by - 1]:
            continue
        others = tuple(c for c in arm.coupled if (c.joint, c.by) != (joint, by))
        stated = sum(c.factor for c in arm.coupled if (c.joint, c.by) == (joint, by))
        for factor in (1.0, -1.0, 0.0):
            if factor == stated:
                continue
            coupled = (*others, CoupledJoint(joint, by, factor)) if factor else others
            if not replace(arm.coupling, joints=coupled).singular:
                yield coupled


def coupling_that_fits(
    arm: Arm, axes: Array, measured: Instrument, among: Iterable[Coupled] | None = None
) -> tuple[Coupled, Misfit] | None:
    """Return the coupling with which the nominal arm fits all readings, and their misfit.

    None where no coupling puts the readings right, or where the coupling as described does not
    leave several times what is expected of a nominal arm.

    Args:
        arm: the arm with its coupling as described.
        axes: (P, m) positions that the controller counts [rad, m].
        measured: the P readings.
        among: candidates; None for those of `couplings_near`.
    """

    def ends_with(coupled: Coupled) -> EndsAt:
        matrix = replace(arm.coupling, joints=coupled)
        return lambda rows: Chain.of(arm).forward(matrix.to_joints(axes[rows]))

    candidates = list(couplings_near(arm) if among is None else among)
    best = _candidate_that_fits(measured, ends_with(arm.coupled), list(map(ends_with, candidates)))
    if best is None:
        return None
    number, misfit = best
    return candidates[number], misfit


def _candidate_that_fits(
    measured: Instrument, as_described: EndsAt, candidates: Sequence[EndsAt]
) -> tuple[int, Misfit] | None:
    """Return the number of the candidate that fits all that was measured, and the misfit.

    None where none puts the readings right, or where there is too little wrong `as_described`.
    """
    compared = spread(len(measured), _COMPARED_ROWS)
    few = measured.take(compared)
    described_m = few.misfit_m(as_described(compared))
    if len(compared) < measured.least_rows or described_m <= NEARER * EXPECTED_M:
        return None
    T_base_ee = [ends_at(compared) for ends_at in candidates]
    lower_bounds_m = list(map(few.least_misfit_m, T_base_ee))
    best = best_candidate(
        lower_bounds_m, lambda number: few.misfit_m(T_base_ee[number]), described_m / NEARER
    )
    if best is None:
        return None
    _, number = best
    misfit = _misfit_if_right(measured, candidates[number](np.arange(len(measured))))
    return None if misfit is None else (number, misfit)


def _misfit_if_right(measured: Instrument, T_base_ee: Array) -> Misfit | None:
    """Return the misfit of the nominal end (P, 4, 4); None where it is not as of right readings."""
    misfit = misfit_of(measured, T_base_ee)
    right = misfit is not None and puts_right(float(np.median(misfit.size_m)), EXPECTED_M)
    return misfit if right else None


def arm_of_log(raw: RawRows, q: Sequence[str], arm: Arm, measured: Instrument) -> Arm:
    """Return the arm with the limits that this log obeys.

    It has another coupling, two joints exchanged or one reversed, if only that brings all rows into
    the limits and explains the readings; else it is the arm as described. Exchanged and reversed
    joints are reported when a calibration is checked, not here.

    Args:
        raw: rows of the log.
        q: its columns of joint positions.
        arm: the arm as described.
        measured: what was measured in each row.
    """
    within_limits = [
        coupled
        for coupled in couplings_near(arm)
        if not outside_bounds(raw, q, replace(arm, coupled=coupled)).any()
    ]
    axes = in_radians(raw.numbers_of(q), arm.axes_slide)
    coupling = coupling_that_fits(arm, axes, measured, within_limits)
    if coupling is not None:
        return replace(arm, coupled=coupling[0])
    if arm.coupled:
        return arm
    slips = [
        (slipped, order, signs)
        for slipped, order, signs in _exchanged_or_reversed(arm)
        if not outside_bounds(raw, q, slipped).any()
    ]

    def ends_with(order: Index, signs: Array) -> EndsAt:
        return lambda rows: Chain.of(arm).forward(signs * axes[rows][:, order])

    as_described = ends_with(np.arange(arm.n), np.ones(arm.n))
    candidates = [ends_with(order, signs) for _, order, signs in slips]
    best = _candidate_that_fits(measured, as_described, candidates)
    return arm if best is None else slips[best[0]][0]


def _exchanged_or_reversed(arm: Arm) -> Iterator[tuple[Arm, Index, Array]]:
    """Yield arms with the limits of two joints exchanged, or of one joint reversed.

    With each come the column that holds each joint (n,), and the sign of each joint (n,).
    """
    for first, second in combinations(range(arm.n), 2):
        if arm.prismatic[first] == arm.prismatic[second]:
            order = np.arange(arm.n)
            order[[first, second]] = second, first
            yield replace(arm, limits_rad=arm.limits_rad[order]), order, np.ones(arm.n)
    for joint in range(arm.n):
        signs = np.ones(arm.n)
        signs[joint] = -1.0
        limits_rad = arm.limits_rad.copy()
        limits_rad[joint] = -limits_rad[joint, ::-1]
        yield replace(arm, limits_rad=limits_rad), np.arange(arm.n), signs


def without_turns(
    raw: RawRows, q: Sequence[str], arm: Arm, usable: Index, measured: Instrument
) -> RawRows:
    """Return a log whose joints are moved by whole turns into their limits, if that fits.

    `measured` is what was measured in the usable rows (U,); it decides.
    """
    moved = unwrapped(raw, q, arm, spread_deg=np.inf)
    if moved is raw:
        return raw
    axes = in_radians(moved.at(usable).numbers_of(q), arm.axes_slide)
    T_base_ee = Chain.of(arm).forward(arm.coupling.to_joints(axes))
    return raw if _misfit_if_right(measured, T_base_ee) is None else moved
