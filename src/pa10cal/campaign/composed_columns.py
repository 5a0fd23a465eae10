"""Columns that hold a place only together: polar readings, and matrices of 4 by 4."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arrays import Array, spread
from pa10cal.campaign.recognise import WORDS, Roles, has_word, words_of_name

# Polar readings: a horizontal angle, a vertical one, and the distance along the line of sight.

_POLAR = {part: frozenset(words.split()) for part, words in WORDS["polar"].items()}


def polar_columns(names: Sequence[str]) -> tuple[str, str, str] | None:
    """Return the columns of the horizontal angle, the vertical one and the distance, if any."""
    found: dict[str, str] = {}
    for part, words in _POLAR.items():
        named = [name for name in names if not words.isdisjoint(words_of_name(name))]
        named = [name for name in named if name not in found.values()]
        if not named:
            return None
        found[part] = named[0]
    horizontal, vertical, distance = found.values()
    return horizontal, vertical, distance


def from_horizon(name: str) -> bool:
    """Return whether a vertical angle is called one from the horizon, not from the zenith."""
    return not _ELEVATION.isdisjoint(words_of_name(name))


_ELEVATION = frozenset(WORDS["from horizon"].split())


def with_polar(roles: Roles, names: Sequence[str]) -> Roles:
    """Return roles in which polar readings are a position, where there is no other."""
    taken = {*roles.joints, *roles.torques, *roles.uncertain.values()}
    polar = polar_columns([name for name in names if name not in taken])
    if roles.positions or polar is None:
        return roles
    single = {key: name for key, name in roles.single.items() if name not in polar}
    return replace(roles, positions={"": polar}, attitude=None, single=single, polar=polar)


def polar_to_xyz(values: Array, rad: float, horizontal: str, vertical: str) -> Array:
    """Return places (N, 3) in the unit of the distance, x along a horizontal angle of 0, z up.

    Args:
        values: (N, 3) horizontal angle, vertical angle, distance.
        rad: one unit of the angles.
        horizontal: `clockwise` as seen from above, or `counterclockwise`.
        vertical: `zenith` for angles from there down, `horizon` for angles from there up.
    """
    turned = values[:, 0] * rad * (-1.0 if horizontal == "clockwise" else 1.0)
    down = values[:, 1] * rad
    down = 0.5 * np.pi - down if vertical == "horizon" else down
    flat = values[:, 2] * np.sin(down)
    return np.column_stack(
        [flat * np.cos(turned), flat * np.sin(turned), values[:, 2] * np.cos(down)]
    )


# Matrices of 4 by 4: 16 columns, row by row or column by column, or 12 without the last row.

#: A matrix is a rotation if no element of its product with its transpose is further off.
_ORTHONORMAL = 2e-3
#: Rows that are looked at, and what part of them has to hold a matrix.
_LOOKED_AT, _MOST = 100, 0.9
#: A matrix whose elements change by less stands still in the file.
_STILL = 1e-6


@dataclass(frozen=True)
class MatrixColumns:
    """Where the elements of matrices are."""

    rotation: tuple[str, ...]  # nine, row by row
    position: tuple[str, ...]  # three
    moves: bool  # whether it differs from row to row


def matrix_columns(names: Sequence[str], numbers: Array) -> list[MatrixColumns]:
    """Return the matrices among the columns (N, k), those of measurements that move first.

    Row by row the last four are 0, 0, 0, 1; column by column every fourth is. What is left has to
    be a rotation.
    """
    some = numbers[spread(len(numbers), _LOOKED_AT)]
    found, k = [], 0
    while k + 12 <= len(names):
        for size, by_columns in ((16, False), (16, True), (12, False)):
            if k + size > len(names):
                continue
            at = np.arange(size).reshape((4, 4) if size == 16 else (3, 4))
            at = k + (at.T if by_columns else at)
            values = some[:, at]
            if _are_matrices(values):
                moves = bool(np.nanmax(np.ptp(values, axis=0)) > _STILL)
                rotation = tuple(names[j] for j in at[:3, :3].ravel().tolist())
                position = tuple(names[j] for j in at[:3, 3].tolist())
                found.append(MatrixColumns(rotation, position, moves))
                k += size - 1
                break
        k += 1

    def later(matrix: MatrixColumns) -> tuple[bool, bool]:
        words = words_of_name(matrix.rotation[0])
        return (not matrix.moves, has_word(words, "commanded"))

    return sorted(found, key=later)


def _are_matrices(values: Array) -> bool:
    """Return whether most of some matrices (N, 3 or 4, 4) are rotations and places."""
    R = values[:, :3, :3]
    with np.errstate(invalid="ignore"):
        off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
        right = (off < _ORTHONORMAL) & (np.linalg.det(np.nan_to_num(R)) > 0.0)
        if values.shape[1] == 4:
            right &= np.abs(values[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1) < 1e-9
    return bool(right.mean() > _MOST) if len(values) else False


def rotation_columns(names: Sequence[str], numbers: Array) -> tuple[str, ...]:
    """Return the first nine columns side by side that are a rotation that moves; empty for none.

    Whether they are row by row or column by column is that of a rotation or its inverse.
    """
    some = numbers[spread(len(numbers), _LOOKED_AT)]
    for k in range(len(names) - 8):
        R = some[:, k : k + 9].reshape(-1, 3, 3)
        if _are_matrices(R) and np.ptp(R, axis=0).max() > _STILL:
            return tuple(names[k : k + 9])
    return ()


def with_matrix(roles: Roles, names: Sequence[str], numbers: Array) -> Roles:
    """Return roles in which a matrix that moves is position and orientation.

    Nine columns side by side that are a rotation are an orientation, where there is no other.
    """
    free = [name for name in names if name not in (*roles.joints, *roles.torques)]
    columns = [names.index(name) for name in free]
    matrices = [each for each in matrix_columns(free, numbers[:, columns]) if each.moves]
    if not matrices:
        taken = {name for place in roles.positions.values() for name in place}
        free = [name for name in free if name not in taken]
        nine = rotation_columns(free, numbers[:, [names.index(name) for name in free]])
        if nine and roles.positions and roles.attitude is None:
            return replace(roles, attitude=(nine, "matrix"))
        return roles
    first = matrices[0]
    taken = {name for each in matrices for name in (*each.rotation, *each.position)}
    positions: Mapping[str, tuple[str, ...]] = {"": first.position}
    single = {key: name for key, name in roles.single.items() if name not in taken}
    attitude = (first.rotation, "matrix")
    return replace(roles, positions=dict(positions), attitude=attitude, single=single)
