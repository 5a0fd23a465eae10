"""Conventions that agree with the nominal arm: of orientations, axes and polar readings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Literal, NamedTuple, cast

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, spread
from pa10cal.campaign.column_map import ANGLES
from pa10cal.campaign.nominal_fit import misfit_of, placed_at_least_distances
from pa10cal.campaign.own_columns import Polar, RotationColumns
from pa10cal.campaign.raw_file import polar_to_xyz, quaternions
from pa10cal.frame.hand_eye import Located
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
#: Orientations agree with the nominal arm if half of them are off by less than this angle.
AGREES_RAD = TIMES_EXPECTED * EXPECTED_RAD
#: Another convention must reduce the misfit by this factor.
NEARER = 5.0
#: Rows that a convention needs, and rows that are used, at most.
ENOUGH, MOST = 6, 200
#: Reweighted means towards the least sum of angles; angles below this weigh the same [rad].
_MEANS, _ALIKE_RAD = 6, 1e-3
#: Poses whose orientation is tried as that with which the others agree, at most.
_STARTS = 10
#: Rows of polar readings that are compared with the arm, at least.
_POLAR_ROWS = 4
#: Angles of up to so many turns are within one: software may count on over a full turn.
_A_TURN = 1.05
#: A factor of lengths is sought where it differs from 1 by at least this.
_ANOTHER_SCALE = 0.01


def puts_right(remaining: float, expected: float, noise: float = np.inf) -> bool:
    """Return whether a remedy that leaves a `remaining` error removes what is wrong.

    It does if the error is as of right data by both measures: not far above `expected` of a nominal
    arm, nor far above the readings' noise, where that is known; all in one unit.
    """
    return bool(remaining <= min(TIMES_EXPECTED * expected, TIMES_NOISE * noise))


@dataclass(frozen=True)
class Convention:
    """A convention that explains the orientations better than the one that was read."""

    name: str  # what the columns seem to hold, in words
    remedy: str
    off_rad: float  # mean angle from the nominal arm, base and target fitted, as read
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
    as_read = attitude_misfit(R_ee, R)
    if as_read.rms_rad < AGREES_RAD:
        return None
    others = _of_the_contract(R) if stated is None else _of_own_columns(R, stated, key)
    tried = [(other, attitude_misfit(R_ee, _agreeing(R_ee, other.R))) for other in others]
    if not tried:
        return None
    # Of equal misfits the first, which is the commonest convention.
    best, left = min(tried, key=lambda each: round(each[1].mean_rad, 3))
    if left.median_rad > AGREES_RAD or NEARER * left.mean_rad > as_read.mean_rad:
        return None
    return Convention(best.name, best.remedy, as_read.mean_rad, left.mean_rad)


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
    fits = [placed_at_least_distances(T_base_ee, seen[:, None]) for seen in (p_m, -p_m)]
    read, mirrored = fits
    if len(p_m) < ENOUGH or read is None or mirrored is None:
        return None

    read_m, mirrored_m = (
        _median_m(seen_m, located, T_base_ee) for seen_m, located in ((p_m, read), (-p_m, mirrored))
    )
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
            return _ChangedAxes(order, signs, read_m, attitude_misfit(axes @ R_read, R))
        return _ChangedAxes(order, signs, mirrored_m, attitude_misfit(-axes @ R_mirrored, R))

    every = product(permutations(range(3)), product((1.0, -1.0), repeat=3))
    as_read, *others = (changed(order, signs) for order, signs in every)
    best = min((as_read, *others), key=lambda axes: axes.rank)
    agrees = best.attitudes.median_rad <= AGREES_RAD
    if best is as_read or not agrees or as_read.total_m < NEARER * best.total_m:
        return None
    turned = tuple(column for column, k in enumerate(best.order) if best.signs[k] < 0.0)
    held = ", ".join(f"{'-' if best.signs[k] < 0.0 else ''}{'xyz'[k]}" for k in best.order)
    name = f"{held} in place of x, y, z"
    return OtherAxes(name, read_m, best.median_m, best.order, turned)


def _median_m(p_m: Array, located: Located, T_base_ee: Array) -> float:
    """Return the median distance of positions (P, 3) of one target from a fit."""
    off_m = p_m - located.targets(T_base_ee)[:, 0, :3, 3]
    return float(np.median(np.linalg.norm(off_m, axis=1)))


@dataclass(frozen=True)
class _ChangedAxes:
    """Axes of the instrument exchanged or reversed, and how well the nominal arm then agrees."""

    order: tuple[int, ...]  # axis that each of the columns x, y, z holds
    signs: tuple[float, ...]  # of each axis, 1 or -1
    median_m: float  # median misfit of the positions
    attitudes: AttitudeMisfit  # of the orientations

    @property
    def total_m(self) -> float:
        """Return the misfit of positions and orientations together, angles times a usual lever."""
        return self.median_m + FRAMES.lever_m * self.attitudes.mean_rad

    @property
    def rank(self) -> tuple[float, bool, int, float, float]:
        """Return what ranks axes: the misfit, whether some are exchanged, how many are reversed."""
        reversed_count = sum(sign < 0.0 for sign in self.signs)
        exchanged = self.order != (0, 1, 2)
        rounded_m, off_rad = round(self.total_m, 3), self.attitudes.mean_rad
        return rounded_m, exchanged, reversed_count, self.median_m, off_rad


@dataclass(frozen=True)
class PolarReading:
    """How polar readings count, and their misfit to the nominal arm."""

    polar: Polar
    length: str  # unit of the distance
    median_m: float | None  # median misfit; None where it is not known


def read_polar(
    values: Array,
    angles: Sequence[str],
    length: str | None,
    T_base_ee: Array | None,
    *,
    by_horizon: bool,
) -> PolarReading:
    """Return how polar readings (N, 3) count, by the misfit of the nominal arm T_base_ee (N, 4, 4).

    By the names the unit of angles is the largest in which all are within a turn, the horizontal
    angle counts clockwise, and the vertical one as it is called. The readings count otherwise only
    where the nominal arm is known and is several times nearer to them then.

    Args:
        values: horizontal angle, vertical angle and distance.
        angles: possible units of the angles.
        length: unit of the distance; None for metres or millimetres, by its size.
        T_base_ee: the nominal end.
        by_horizon: whether the vertical angle is called one from the horizon.
    """
    usual = "horizon" if by_horizon else "zenith"
    turn = {unit: 360.0 / ANGLES[unit] for unit in angles}
    size = np.max(np.abs(values[:, :2]), axis=1, initial=0.0)
    # Zeros, and angles of more than a turn in every unit, are no readings: none was seen.
    seen = np.isfinite(values).all(axis=1) & (values[:, 2] != 0.0)
    seen &= size <= _A_TURN * max(turn.values())
    units = ("rad", "deg", "gon", "mrad")
    largest = float(np.max(size[seen], initial=0.0))
    possible = [unit for unit in units if unit in turn and largest <= _A_TURN * turn[unit]]
    if length is None:
        length = "mm" if seen.any() and np.median(values[seen, 2]) > 100.0 else "m"

    def counting(unit: str, horizontal: str, vertical: str) -> Polar:
        words = {"unit": unit, "horizontal": horizontal, "vertical": vertical}
        return Polar.model_validate(words)

    by_name = counting(possible[0], "clockwise", usual)
    if T_base_ee is None:
        return PolarReading(by_name, length, None)
    rows = np.flatnonzero(seen & np.isfinite(T_base_ee).all(axis=(1, 2)))
    rows = rows[spread(len(rows), MOST)]
    T_seen = T_base_ee[rows]
    found: dict[Polar, float] = {}
    for words in product(possible, ("clockwise", "counterclockwise"), ("zenith", "horizon")):
        polar = counting(*words)
        p_m = 1e-3 * polar_to_xyz(values[rows], polar, length)
        enough = len(rows) >= _POLAR_ROWS
        located = placed_at_least_distances(T_seen, p_m[:, None]) if enough else None
        if located is not None:
            found[polar] = _median_m(p_m, located, T_seen)
    if not found:
        return PolarReading(by_name, length, None)
    nearest = min(found, key=lambda polar: found[polar])
    if NEARER * found[nearest] >= found.get(by_name, np.inf):
        nearest = by_name
    return PolarReading(nearest, length, found[nearest])


def modelled_attitudes(T_base_ee: Array, p_instr_m: Array) -> Array | None:
    """Return the nominal end-effector's orientations (P, 3, 3) in the instrument's frame.

    The base is fitted to the positions (P, 3) of one target; None where they do not determine it.
    """
    located = placed_at_least_distances(T_base_ee, p_instr_m[:, None])
    return None if located is None else located.T_instr_base[:3, :3] @ T_base_ee[:, :3, :3]


class AttitudeMisfit(NamedTuple):
    """How far orientations are from the nominal arm's, the target's orientation on it fitted."""

    off_rad: Array  # (P,) angle of each

    @property
    def rms_rad(self) -> float:
        """Return the rms angle, which one gross error makes large."""
        return float(np.sqrt(np.mean(self.off_rad**2)))

    @property
    def mean_rad(self) -> float:
        """Return the mean angle, which what some of the orientations have wrong makes larger."""
        return float(np.mean(self.off_rad))

    @property
    def median_rad(self) -> float:
        """Return the angle of the middle one, which no gross error changes much."""
        return float(np.median(self.off_rad))


def attitude_misfit(R_instr_ee: Array, R_instr_target: Array) -> AttitudeMisfit:
    """Return how far orientations (P, 3, 3) are from R_instr_ee R_ee_target.

    R_ee_target is fitted for the least sum of angles, so that gross errors hardly count.
    """
    R_ee_target = Rotation.from_matrix(np.swapaxes(R_instr_ee, 1, 2) @ R_instr_target)
    off_rad = np.ones(len(R_ee_target))
    for _ in range(_MEANS):
        mean = R_ee_target.mean(weights=1.0 / np.maximum(off_rad, _ALIKE_RAD))
        off_rad = np.asarray((R_ee_target * mean.inv()).magnitude())
    return AttitudeMisfit(off_rad)


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
