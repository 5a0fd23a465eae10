"""Attitudes in the usual other conventions: which of them agrees with the nominal arm?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.campaign.labels import placed_by_points
from pa10cal.frame.hand_eye import LEVER_M

EulerSequence = Literal["xyz", "XYZ", "zyx", "ZYX", "zyz", "ZYZ"]

#: Sequences of Euler angles in use: capitals about the axes that turn along.
SEQUENCES: tuple[EulerSequence, ...] = ("xyz", "XYZ", "zyx", "ZYX", "zyz", "ZYZ")
#: Attitudes that agree with the nominal arm scatter by less than this about it.
AGREES_RAD = np.radians(5.0)
#: Another convention must be so much nearer than the one that was read.
NEARER = 5.0
#: Attitudes that show which one it is.
ENOUGH = 6
MOST = 200


@dataclass(frozen=True)
class Convention:
    """A convention that explains the attitudes better than the one that was read."""

    name: str  # what the columns seem to hold
    remedy: str  # what to do about it
    # scatter_rad and would_leave_rad: root mean square angle from the nominal arm, base and target
    # fitted, as read and in this convention
    scatter_rad: float
    would_leave_rad: float


def better_convention(T_base_ee: Array, T_instr_target: Array) -> Convention | None:
    """Return the convention in which measured attitudes agree with the nominal arm.

    Attitudes alone do not tell: most orders of a quaternion differ by constant turns, as base and
    target do. The base is therefore fitted to the positions, and the target's attitude alone to
    the attitudes.

    None where they agree as they were read, in no convention that is tried, or where the positions
    do not determine the base.

    Args:
        T_base_ee: (P, 4, 4) nominal end-effector [m].
        T_instr_target: (P, 4, 4) measured target [m].
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
    tried = [
        (attitude_scatter(R_ee, other), name, remedy) for name, remedy, other in _conventions(R)
    ]
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


def other_axes(T_base_ee: Array, p_m: Array, R: Array | None) -> OtherAxes | None:
    """Return how x, y, z of an instrument are exchanged or turned, where that explains the rows.

    The base is fitted, so positions alone tell a mirrored frame and not which axis it is; measured
    attitudes tell which, and exchanged axes too. None where the axes fit as they are.

    Args:
        T_base_ee: (P, 4, 4) nominal end-effector [m].
        p_m: (P, 3) positions of one target.
        R: (P, 3, 3) its attitudes; None where none were measured.
    """
    some = np.linspace(0, len(p_m) - 1, min(len(p_m), MOST)).astype(int)
    T_base_ee, p_m = T_base_ee[some], p_m[some]
    as_read = _misfit_m(T_base_ee, p_m)
    if len(p_m) < ENOUGH or as_read is None:
        return None
    tried = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            axes = np.diag(signs)[:, list(order)]
            if R is None and np.linalg.det(axes) > 0.0:
                continue
            other_m = p_m @ axes.T
            left = _misfit_m(T_base_ee, other_m)
            R_ee = None if left is None or R is None else modelled_attitudes(T_base_ee, other_m)
            turn = 0.0 if R_ee is None or R is None else attitude_scatter(R_ee, R[some])
            if left is not None:
                # The plainest of equals: fewest axes exchanged, fewest signs.
                plain = (list(order) != [0, 1, 2], sum(sign < 0.0 for sign in signs))
                tried.append((round(left + LEVER_M * turn, 3), plain, left, turn, order, signs))
    if not tried:
        return None
    _, plain, left, turn, order, signs = min(tried)
    if plain == (False, 0) or turn > AGREES_RAD or (as_read < NEARER * left and R is None):
        return None
    R_read = None if R is None else modelled_attitudes(T_base_ee, p_m)
    turn_read = 0.0 if R is None or R_read is None else attitude_scatter(R_read, R[some])
    if as_read + LEVER_M * turn_read < NEARER * (left + LEVER_M * turn):
        return None
    if R is None:
        return OtherAxes("mirrored: a left-handed frame", as_read, left)
    held = ", ".join(f"{'-' if signs[k] < 0.0 else ''}{'xyz'[k]}" for k in order)
    return OtherAxes(f"{held} in place of x, y, z", as_read, left)


def _misfit_m(T_base_ee: Array, p_m: Array) -> float | None:
    """Return the median misfit of the nominal arm, base and target fitted; None without a fit."""
    found = placed_by_points(T_base_ee, p_m[:, None])
    if found is None:
        return None
    off_m = p_m - found.targets(T_base_ee)[:, 0, :3, 3]
    return float(np.median(np.linalg.norm(off_m, axis=1)))


def modelled_attitudes(T_base_ee: Array, p_instr_m: Array) -> Array | None:
    """Return the nominal end-effector's attitudes (P, 3, 3) in the instrument's frame.

    The base is fitted to the positions (P, 3) of one target; None where they do not determine it.
    """
    found = placed_by_points(T_base_ee, p_instr_m[:, None])
    return None if found is None else found.T_instr_base[:3, :3] @ T_base_ee[:, :3, :3]


def attitude_scatter(R_instr_ee: Array, R_instr_target: Array) -> float:
    """Return the rms angle [rad] of measured attitudes from R_instr_ee R_ee_target, that fitted."""
    of_target = np.swapaxes(R_instr_ee, 1, 2) @ R_instr_target
    R_ee_target = _nearest_rotation(of_target.mean(axis=0))
    off = Rotation.from_matrix(of_target @ R_ee_target.T).magnitude()
    return float(np.sqrt(np.mean(off**2)))


def _conventions(R: Array) -> Iterator[tuple[str, str, Array]]:
    """Return other readings of the same numbers, the commonest first."""
    quaternion = Rotation.from_matrix(R).as_quat(scalar_first=True)
    inverted = np.swapaxes(R, 1, 2)
    transpose = "convert the attitudes from target in instrument to instrument in target, or back"
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
