"""Which convention agrees with the arm: of orientations, axes, polar readings, encoder counts?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Literal, cast

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, spread
from pa10cal.campaign.bounds import BEYOND_LIMITS
from pa10cal.campaign.nominal_fit import misfit_of, placed_by_points
from pa10cal.campaign.own_columns import Polar, RotationColumns
from pa10cal.campaign.raw_file import polar_to_xyz, quaternions
from pa10cal.campaign.raw_rows import ANGLES_OF_POLAR
from pa10cal.frame.rigid_fit import Located
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
#: So near are nominal arm and measurement expected to be, base and target fitted.
EXPECTED_M, EXPECTED_RAD = 2e-3, float(np.radians(1.0))
#: What puts right what is wrong leaves no more than so many times what is expected, and the noise.
TIMES_EXPECTED, TIMES_NOISE = 5.0, 20.0
#: What is said of a change that leaves more.
STILL_WRONG = "which is better, and still wrong"
#: Orientations that agree with the nominal arm scatter by less than this about it.
AGREES_RAD = TIMES_EXPECTED * EXPECTED_RAD
#: Another convention must be so much nearer than the one that was read.
NEARER = 5.0
#: Orientations that show which one it is.
ENOUGH = 6
MOST = 200


def puts_right(left: float, expected: float, noise: float = np.inf) -> bool:
    """Return whether a remedy that leaves an error may be offered as what puts right what is wrong.

    Where nothing is wrong `expected` is left in the same unit, or the noise of the readings.
    """
    return bool(left <= min(TIMES_EXPECTED * expected, TIMES_NOISE * noise))


@dataclass(frozen=True)
class Convention:
    """A convention that explains the orientations better than the one that was read."""

    name: str  # what the columns seem to hold
    remedy: str  # what to do about it
    # scatter_rad and would_leave_rad: root mean square angle from the nominal arm, base and target
    # fitted, as read and in this convention
    scatter_rad: float
    would_leave_rad: float


def better_convention(
    T_base_ee: Array,
    T_instr_target: Array,
    stated: RotationColumns | None = None,
    key: str = "",
) -> Convention | None:
    """Return the convention in which measured orientations agree with the nominal arm.

    Orientations alone do not tell: most orders of a quaternion differ by constant turns, as base
    and target do. The base is therefore fitted to the positions, and the target's orientation alone
    to the orientations.

    None where they agree as they were read, in no convention that is tried, or where the positions
    do not determine the base.

    Args:
        T_base_ee: (P, 4, 4) nominal end-effector [m].
        T_instr_target: (P, 4, 4) measured target [m].
        stated: what campaign.yaml states under `key` of columns of the user's own; None for
            quaternions under the names of the contract.
    """
    if len(T_base_ee) < ENOUGH:
        return None
    some = spread(len(T_base_ee), MOST)
    T_base_ee, T_instr_target = T_base_ee[some], T_instr_target[some]
    R_ee, R = modelled_attitudes(T_base_ee, T_instr_target[:, :3, 3]), T_instr_target[:, :3, :3]
    if R_ee is None:
        return None
    as_read = attitude_scatter(R_ee, R)
    if as_read < AGREES_RAD:
        return None
    others = _of_the_contract(R) if stated is None else _of_own_columns(R, stated, key)
    tried = [(attitude_scatter(R_ee, other), name, remedy) for name, remedy, other in others]
    if not tried:
        return None
    # The first of equals: the plainest.
    scatter, name, remedy = min(tried, key=lambda other: round(other[0], 3))
    if scatter > min(AGREES_RAD, as_read / NEARER):
        return None
    return Convention(name, remedy, as_read, scatter)


def _of_the_contract(R: Array) -> Iterator[tuple[str, str, Array]]:
    """Yield other readings of quaternions under the contract's names, the commonest first."""
    quaternion = Rotation.from_matrix(R).as_quat(scalar_first=True)

    def ordered(order: tuple[int, ...]) -> tuple[str, str, Array]:
        """Return the reading whose column k holds component `order[k]` of w, x, y, z."""
        held = ", ".join("wxyz"[k] for k in order)
        columns = [order.index(component) for component in range(4)]
        other = Rotation.from_quat(quaternion[:, columns], scalar_first=True)
        name = f"quaternions in the order {held} under the headers qw, qx, qy, qz"
        return name, f"rename the columns: they hold {held}", other.as_matrix()

    def mistaken() -> Iterator[tuple[str, str, Array]]:
        yield from map(ordered, ((1, 2, 3, 0), (3, 0, 1, 2)))
        for made, meant in product(SEQUENCES, repeat=2):
            if meant != made:
                angles = Rotation.from_matrix(R).as_euler(made, suppress_warnings=True)
                name = f"Euler angles {_sequence(meant)}, converted as {_sequence(made)}"
                remedy = f"convert them to quaternions as angles {_sequence(meant)}"
                yield name, remedy, Rotation.from_euler(meant, angles).as_matrix()

    yield (
        "the inverse rotation (instrument in target)",
        "convert the orientations from target in instrument to instrument in target, or back",
        np.swapaxes(R, 1, 2),
    )
    for name, remedy, other in mistaken():
        yield name, remedy, other
        yield f"{name}, inverted", f"{remedy}, and invert them", np.swapaxes(other, 1, 2)
    for axes in list(permutations((1, 2, 3)))[1:]:
        yield ordered((0, *axes))


def _of_own_columns(
    R: Array, stated: RotationColumns, key: str
) -> Iterator[tuple[str, str, Array]]:
    """Yield other readings of a user's own columns, the commonest first, by what to state."""
    words = {3: THREE, 4: FOUR}.get(len(stated.names), (stated.convention,))
    turned, read_as = Rotation.from_matrix(R), stated.convention
    turned = turned.inv() if stated.inverse else turned
    # The numbers (N, k) that the columns hold, angles in degrees.
    if read_as == "matrix":
        values = turned.as_matrix().reshape(-1, 9)
    elif read_as.startswith("quaternion"):
        values = turned.as_quat(scalar_first=read_as.endswith("wxyz"))
    elif read_as == "rotation_vector":
        values = turned.as_rotvec(degrees=True)
    else:  # as SciPy has it: small letters about fixed axes
        axes = cast("EulerSequence", "xyz" if read_as == "rpy" else read_as.rpartition("_")[2])
        values = turned.as_euler(axes, degrees=True, suppress_warnings=True)
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
            other = quaternions(np.asarray(values), stated.model_copy(update=changed))
            R_other = Rotation.from_quat(other, scalar_first=True).as_matrix()
            yield ", and ".join(named), " and ".join(remedy), R_other


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

    name: str  # what the columns x, y, z seem to hold
    left_m: float  # median misfit of the nominal model as read
    would_leave_m: float  # and with these axes
    order: tuple[int, ...]  # which axis each of the three columns holds
    turned: tuple[int, ...]  # columns that hold it with the other sign
    any_one: bool = False  # whether any one of these may be it

    @property
    def puts_right(self) -> bool:
        """Return whether they leave no more than is expected of a nominal arm."""
        return puts_right(self.would_leave_m, EXPECTED_M)


def other_axes(T_base_ee: Array, p_m: Array, R: Array | None) -> OtherAxes | None:
    """Return how x, y, z of an instrument are exchanged or turned, where that explains the rows.

    The base is fitted, so positions p_m (P, 3) of one target alone tell a mirrored frame and not
    which axis it is; its measured orientations R (P, 3, 3) tell which, and exchanged axes too. None
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
    R, tried = R[some], []
    R_read, R_mirrored = (
        located.T_instr_base[:3, :3] @ T_base_ee[:, :3, :3] for located in (read, mirrored)
    )
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            axes = np.diag(signs)[:, list(order)]
            # A turn of the frame is a turn of the base: two fits tell of all axes.
            right = np.linalg.det(axes) > 0.0
            left_m = read_m if right else mirrored_m
            turn = attitude_scatter(axes @ R_read if right else -axes @ R_mirrored, R)
            # The plainest of equals: fewest axes exchanged, fewest signs.
            plain = (list(order) != [0, 1, 2], sum(sign < 0.0 for sign in signs))
            tried.append(
                (round(left_m + FRAMES.lever_m * turn, 3), plain, left_m, turn, order, signs)
            )
    _, plain, left_m, turn, order, signs = min(tried)
    if plain == (False, 0) or turn > AGREES_RAD:
        return None
    if read_m + FRAMES.lever_m * attitude_scatter(R_read, R) < NEARER * (
        left_m + FRAMES.lever_m * turn
    ):
        return None
    turned = tuple(column for column, k in enumerate(order) if signs[k] < 0.0)
    held = ", ".join(f"{'-' if signs[k] < 0.0 else ''}{'xyz'[k]}" for k in order)
    return OtherAxes(f"{held} in place of x, y, z", read_m, left_m, tuple(order), turned)


@dataclass(frozen=True)
class PolarReading:
    """How polar readings count, and how far that is from the nominal arm."""

    polar: Polar
    length: str  # unit of the distance
    scatter_m: float | None  # rms; None where nothing told it


def read_polar(
    values: Array,
    angles: Sequence[str],
    lengths: Sequence[str],
    T_base_ee: Array | None,
    *,
    by_horizon: bool,
) -> PolarReading:
    """Return how polar readings (N, 3) count, by the nominal arm at (N, 4, 4) where it is known.

    Without it, or where the poses do not tell: the unit of angles is the largest in which they are
    within a turn, and the vertical angle counts as its name says.
    """
    usual = "horizon" if by_horizon else "zenith"
    turn = {unit: 360.0 / ANGLES_OF_POLAR[unit] for unit in angles}
    largest = float(np.nanmax(np.abs(values[:, :2]), initial=0.0))
    able = [unit for unit in ("rad", "deg", "gon", "mrad") if largest <= 1.05 * turn.get(unit, 0.0)]
    able = able or list(angles)
    far = float(np.nanmedian(values[:, 2])) if len(values) else 0.0
    length = lengths[0] if len(lengths) == 1 else "mm" if far > 100.0 else "m"

    def counting(unit: str, way: str, up: str) -> Polar:
        return Polar.model_validate({"unit": unit, "horizontal": way, "vertical": up})

    named = PolarReading(counting(able[0], "clockwise", usual), length, None)
    if T_base_ee is None:
        return named
    finite = np.isfinite(values).all(axis=1) & np.isfinite(T_base_ee).all(axis=(1, 2))
    rows = np.flatnonzero(finite)
    rows = rows[spread(len(rows), MOST)]
    tried = [named]
    for how in product(able, ("clockwise", "counterclockwise"), ("zenith", "horizon")):
        polar = counting(*how)
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


# Lengths of another scale, as of a tag that is held for another size.

#: One factor is looked for beyond so much of 1.
_ANOTHER_SCALE = 0.01


def other_scale(
    measured: Instrument, T_base_ee: Array, misfit: Misfit
) -> tuple[float, float] | None:
    """Return by what lengths are to be divided for the nominal arm to fit, and its misfit then [m].

    None where one factor does not put right what it leaves of readings as they are.
    """
    scale = measured.scale(T_base_ee)
    if scale is None or not scale > 0.0 or abs(scale - 1.0) < _ANOTHER_SCALE:
        return None
    found = misfit_of(measured.scaled(scale), T_base_ee)
    left_m = np.inf if found is None else float(np.nanmedian(found.length_m))
    as_read_m = float(np.nanmedian(misfit.length_m))
    fits = NEARER * left_m < as_read_m and puts_right(left_m, EXPECTED_M)
    return (1.0 / scale, left_m) if fits else None


# Joint positions as counts of an encoder: how many a turn, and which count is zero.

#: Whole numbers beyond this are no degrees that anyone logs without decimals.
LARGEST_DEG = 400.0
#: Counts a turn of usual encoders: servos, powers of two, and degrees in parts.
_POWERS = tuple(2.0**k for k in range(8, 25))
_USUAL_COUNTS = (4096.0, 1024.0, *_POWERS, 3600.0, 36e3, 36e4, 1e4, 4e4, 1e5, 1e6)
#: Counts a turn, and that in the middle, of servos that turn by a part of it: 1024 counts over 300
#: deg, 1000 over 240, pulses of 500 to 2500 us over 180 or over 270.
_OF_A_PART = ((1228.8, 512.0), (1500.0, 500.0), (4000.0, 1500.0), (2e3 / 0.75, 1500.0))
#: The nominal arm agrees where it leaves no more than this part of the spread of the places.
_FITS = 0.05
#: Rows that scales are compared by, and the part of them that must lie within the joints' limits.
_COMPARED, _WITHIN = 60, 0.9
#: The nominal arm must be so many times nearer with one scale than with any other.
_CLEARER = 2.0


@dataclass(frozen=True)
class CountScale:
    """How counts are read as angles."""

    per_turn: float  # counts a turn of the joint
    zero: float  # count at which the joint is at zero
    signs: tuple[int, ...]  # (n,) direction of each joint
    misfit_m: float = np.inf  # median misfit of the nominal arm so; infinite where none was tried

    def degrees(self, counts: Array) -> Array:
        """Return angles of counts (N, n)."""
        return np.asarray(self.signs) * (counts - self.zero) * (360.0 / self.per_turn)


def looks_like_counts(values: Array) -> bool:
    """Return whether positions (N, n) of joints that turn are counts: whole numbers, and large."""
    known = values[np.isfinite(values)]
    return bool(
        len(known) and (known == np.round(known)).all() and np.abs(known).max() > LARGEST_DEG
    )


def scale_of_counts(counts: Array, arm: Arm | None, p_m: Array | None) -> CountScale:
    """Return the scale of counts (N, n) of an arm whose joints all turn.

    With positions p_m (N, 3) of a target it is that with which the nominal arm agrees, each joint
    in the direction that suits best, if it is clearly nearer than any other. Without, or where none
    is, it is the smallest power of two that holds the counts, with zero in its middle where none is
    negative.
    """
    below = np.nanmax(np.abs(counts))
    assumed = next(power for power in (*_POWERS, np.inf) if power > below)
    zero = assumed / 2.0 if np.nanmin(counts) >= 0.0 else 0.0
    fallback = CountScale(assumed, zero, (1,) * counts.shape[1])
    if arm is None or p_m is None or not np.isfinite(assumed):
        return fallback
    known = np.flatnonzero(np.isfinite(np.column_stack([counts, p_m])).all(axis=1))
    if not len(known):
        return fallback
    some = known[spread(len(known), _COMPARED)]
    tried = sorted(_scales_tried(counts[some], arm, p_m[some]), key=lambda scale: scale.misfit_m)
    if not tried:
        return fallback
    others = [scale.misfit_m for scale in tried if scale.per_turn != tried[0].per_turn]
    spread_m = float(np.linalg.norm(np.std(p_m[some], axis=0)))
    clear = tried[0].misfit_m < min(min(others, default=np.inf) / _CLEARER, _FITS * spread_m)
    return tried[0] if clear else fallback


def _scales_tried(counts: Array, arm: Arm, p_m: Array) -> Iterator[CountScale]:
    """Yield scales with which the counts lie within the limits of the joints."""
    limits_deg = np.degrees(arm.axis_limits_rad) + BEYOND_LIMITS["deg"] * np.array([-1.0, 1.0])

    def within(scale: CountScale) -> bool:
        q_deg = scale.degrees(counts)
        inside = (q_deg >= limits_deg[:, 0]) & (q_deg <= limits_deg[:, 1])
        return bool(inside.all(axis=1).mean() >= _WITHIN)

    whole = product(dict.fromkeys(_USUAL_COUNTS), (0.5, 0.0))
    for per_turn, zero in (*((turn, part * turn) for turn, part in whole), *_OF_A_PART):
        scale = CountScale(per_turn, zero, (1,) * len(limits_deg))
        if not within(scale):
            continue
        scale = _fitted(scale, counts, arm, p_m)
        for _ in limits_deg:
            turned = [
                _fitted(_reversed(scale, k), counts, arm, p_m) for k in range(len(limits_deg))
            ]
            better = min(turned, key=lambda other: other.misfit_m)
            if not within(better) or better.misfit_m >= scale.misfit_m / 1.2:
                break
            scale = better
        yield scale


def _reversed(scale: CountScale, joint: int) -> CountScale:
    signs = tuple(-sign if k == joint else sign for k, sign in enumerate(scale.signs))
    return CountScale(scale.per_turn, scale.zero, signs)


def _fitted(scale: CountScale, counts: Array, arm: Arm, p_m: Array) -> CountScale:
    """Return a scale with the misfit of the nominal arm."""
    q_rad = arm.coupling.to_joints(np.radians(scale.degrees(counts)))
    T_base_ee = Chain.of(arm).forward(q_rad)
    located = placed_by_points(T_base_ee, p_m[:, None], roughly=True)
    if located is None:
        return scale
    off_m = np.linalg.norm(p_m - located.targets(T_base_ee)[:, 0, :3, 3], axis=1)
    return CountScale(scale.per_turn, scale.zero, scale.signs, float(np.median(off_m)))
