"""Orientations in the usual other conventions: which of them agrees with the nominal arm?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product
from typing import Literal, cast

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.campaign.labels import placed_by_points
from pa10cal.campaign.own_columns import RotationColumns
from pa10cal.campaign.raw_file import quaternions
from pa10cal.frame.hand_eye import LEVER_M

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
    """Return whether a remedy may be offered as what puts right what is wrong.

    Args:
        left: the error that it leaves.
        expected: what is expected to be left where nothing is wrong, in the same unit.
        noise: of the readings, stated or found, where what is left should be the noise.
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
        stated: what campaign.yaml states of columns of the user's own; None for quaternions under
            the names of the contract.
        key: where it states it.
    """
    if len(T_base_ee) < ENOUGH:
        return None
    some = np.linspace(0, len(T_base_ee) - 1, min(len(T_base_ee), MOST)).astype(int)
    T_base_ee, T_instr_target = T_base_ee[some], T_instr_target[some]
    R_ee, R = modelled_attitudes(T_base_ee, T_instr_target[:, :3, 3]), T_instr_target[:, :3, :3]
    if R_ee is None:
        return None
    as_read = attitude_scatter(R_ee, R)
    if as_read < AGREES_RAD:
        return None
    others = _conventions(R) if stated is None else _other_readings(R, stated, key)
    tried = [(attitude_scatter(R_ee, other), name, remedy) for name, remedy, other in others]
    if not tried:
        return None
    # The first of equals: the plainest.
    left, name, remedy = min(tried, key=lambda each: round(each[0], 3))
    if left > min(AGREES_RAD, as_read / NEARER):
        return None
    return Convention(name, remedy, as_read, left)


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


_MIRRORED = -np.eye(3)


def other_axes(T_base_ee: Array, p_m: Array, R: Array | None) -> OtherAxes | None:
    """Return how x, y, z of an instrument are exchanged or turned, where that explains the rows.

    The base is fitted, so positions alone tell a mirrored frame and not which axis it is; measured
    orientations tell which, and exchanged axes too. None where the axes fit as they are.

    Args:
        T_base_ee: (P, 4, 4) nominal end-effector [m].
        p_m: (P, 3) positions of one target.
        R: (P, 3, 3) its orientations; None where none were measured.
    """
    some = np.linspace(0, len(p_m) - 1, min(len(p_m), MOST)).astype(int)
    T_base_ee, p_m = T_base_ee[some], p_m[some]
    as_read, mirrored = _misfit_m(T_base_ee, p_m), _misfit_m(T_base_ee, p_m @ _MIRRORED)
    if len(p_m) < ENOUGH or as_read is None or mirrored is None:
        return None
    if R is None:
        if as_read < NEARER * mirrored:
            return None
        name = "mirrored: a left-handed frame"
        return OtherAxes(name, as_read, mirrored, (0, 1, 2), (0, 1, 2), any_one=True)
    R, tried = R[some], []
    R_read = modelled_attitudes(T_base_ee, p_m)
    R_mirrored = modelled_attitudes(T_base_ee, p_m @ _MIRRORED)
    assert R_read is not None
    assert R_mirrored is not None
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            axes = np.diag(signs)[:, list(order)]
            # A turn of the frame is a turn of the base: two fits tell of all axes.
            right = np.linalg.det(axes) > 0.0
            left = as_read if right else mirrored
            turn = attitude_scatter(axes @ R_read if right else -axes @ R_mirrored, R)
            # The plainest of equals: fewest axes exchanged, fewest signs.
            plain = (list(order) != [0, 1, 2], sum(sign < 0.0 for sign in signs))
            tried.append((round(left + LEVER_M * turn, 3), plain, left, turn, order, signs))
    _, plain, left, turn, order, signs = min(tried)
    if plain == (False, 0) or turn > AGREES_RAD:
        return None
    if as_read + LEVER_M * attitude_scatter(R_read, R) < NEARER * (left + LEVER_M * turn):
        return None
    turned = tuple(column for column, k in enumerate(order) if signs[k] < 0.0)
    held = ", ".join(f"{'-' if signs[k] < 0.0 else ''}{'xyz'[k]}" for k in order)
    return OtherAxes(f"{held} in place of x, y, z", as_read, left, tuple(order), turned)


def _misfit_m(T_base_ee: Array, p_m: Array) -> float | None:
    """Return the median misfit of the nominal arm, base and target fitted; None without a fit."""
    found = placed_by_points(T_base_ee, p_m[:, None])
    if found is None:
        return None
    off_m = p_m - found.targets(T_base_ee)[:, 0, :3, 3]
    return float(np.median(np.linalg.norm(off_m, axis=1)))


def modelled_attitudes(T_base_ee: Array, p_instr_m: Array) -> Array | None:
    """Return the nominal end-effector's orientations (P, 3, 3) in the instrument's frame.

    The base is fitted to the positions (P, 3) of one target; None where they do not determine it.
    """
    found = placed_by_points(T_base_ee, p_instr_m[:, None])
    return None if found is None else found.T_instr_base[:3, :3] @ T_base_ee[:, :3, :3]


def attitude_scatter(R_instr_ee: Array, R_instr_target: Array) -> float:
    """Return the rms angle [rad] of orientations from R_instr_ee R_ee_target, which is fitted."""
    of_target = np.swapaxes(R_instr_ee, 1, 2) @ R_instr_target
    R_ee_target = _nearest_rotation(of_target.mean(axis=0))
    off = Rotation.from_matrix(of_target @ R_ee_target.T).magnitude()
    return float(np.sqrt(np.mean(off**2)))


def _conventions(R: Array) -> Iterator[tuple[str, str, Array]]:
    """Return other readings of the same numbers, the commonest first."""
    quaternion = Rotation.from_matrix(R).as_quat(scalar_first=True)
    inverted = np.swapaxes(R, 1, 2)
    transpose = (
        "convert the orientations from target in instrument to instrument in target, or back"
    )
    yield "the inverse rotation (instrument in target)", transpose, inverted
    for order, held in (((1, 2, 3, 0), "x, y, z, w"), ((3, 0, 1, 2), "z, w, x, y")):
        # Column k holds the component named in `held`; the scalar stands where `w` is.
        other = Rotation.from_quat(quaternion[:, _back(order)], scalar_first=True).as_matrix()
        name = f"quaternions in the order {held} under the headers qw, qx, qy, qz"
        remedy = f"rename the columns: they hold {held}"
        yield name, remedy, other
        yield f"{name}, inverted", f"{remedy}, and invert them", np.swapaxes(other, 1, 2)
    for made in SEQUENCES:
        angles = Rotation.from_matrix(R).as_euler(made, suppress_warnings=True)
        for meant in SEQUENCES:
            if meant == made:
                continue
            other = Rotation.from_euler(meant, angles).as_matrix()
            name = f"Euler angles {_sequence(meant)}, converted as {_sequence(made)}"
            remedy = f"convert them to quaternions as angles {_sequence(meant)}"
            yield name, remedy, other
            yield f"{name}, inverted", f"{remedy}, and invert them", np.swapaxes(other, 1, 2)
    for x, y, z in permutations((1, 2, 3)):
        if (x, y, z) == (1, 2, 3):
            continue
        held = ", ".join("wxyz"[k] for k in (0, x, y, z))
        shuffled = quaternion[:, _back((0, x, y, z))]
        other = Rotation.from_quat(shuffled, scalar_first=True).as_matrix()
        name = f"quaternions in the order {held} under the headers qw, qx, qy, qz"
        yield name, f"rename the columns: they hold {held}", other


def _other_readings(
    R: Array, stated: RotationColumns, key: str
) -> Iterator[tuple[str, str, Array]]:
    """Return other readings of a user's own columns, the commonest first, by what to state."""
    words = {3: THREE, 4: FOUR}.get(len(stated.names), (stated.convention,))
    values = _numbers(R, stated)
    for inverse in (stated.inverse, not stated.inverse):
        for word in (stated.convention, *words):
            if (word, inverse) == (stated.convention, stated.inverse):
                continue
            other = stated.model_copy(
                update={"convention": word, "inverse": inverse, "unit": "deg", "u": None}
            )
            named, remedy = [], []
            if word != stated.convention:
                named.append(f"{_in_words(word)}, read as {_in_words(stated.convention)}")
                remedy.append(f"set {key}.convention: {word}")
            if inverse != stated.inverse:
                named.append("the inverse rotation" + " (instrument in target)" * inverse)
                remedy.append(f"set {key}.inverse: {str(inverse).lower()}")
            turned = Rotation.from_quat(quaternions(values, other), scalar_first=True)
            yield ", and ".join(named), " and ".join(remedy), turned.as_matrix()


def _numbers(R: Array, stated: RotationColumns) -> Array:
    """Return the numbers (N, k) that columns of orientations hold, angles in degrees."""
    turned = Rotation.from_matrix(np.swapaxes(R, 1, 2) if stated.inverse else R)
    word = stated.convention
    if word == "matrix":
        return np.asarray(turned.as_matrix().reshape(-1, 9))
    if word.startswith("quaternion"):
        return np.asarray(turned.as_quat(scalar_first=word.endswith("wxyz")))
    if word == "rotation_vector":
        return np.asarray(turned.as_rotvec(degrees=True))
    # As SciPy has it: small letters about fixed axes.
    sequence = cast("EulerSequence", "xyz" if word == "rpy" else word.rpartition("_")[2])
    return np.asarray(turned.as_euler(sequence, degrees=True, suppress_warnings=True))


def _in_words(convention: str) -> str:
    """Return a convention of orientations in words."""
    kind, _, axes = convention.partition("_")
    if kind == "quaternion":
        return f"quaternions in the order {', '.join(axes)}"
    if kind in ("rotation", "matrix"):
        return "rotation vectors" if kind == "rotation" else "matrices"
    return f"Euler angles {_sequence(axes or 'xyz')}"


def _back(order: tuple[int, ...]) -> list[int]:
    """Return where each of w, x, y, z stands, where column k holds component `order[k]`."""
    return [order.index(component) for component in range(4)]


def _sequence(word: str) -> str:
    axes = "-".join(word.upper())
    return f"{axes} about {'moving' if word.isupper() else 'fixed'} axes"


def _nearest_rotation(matrix: Array) -> Array:
    U, _, Vt = np.linalg.svd(matrix)
    U[:, 2] *= np.linalg.det(U @ Vt)
    return np.asarray(U @ Vt)
