"""Columns, or rows, of an unknown file that are pose matrices, recognised by their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arrays import Array, spread
from pa10cal.campaign.column_names import has_word, words_of_name
from pa10cal.campaign.recognise import Roles

#: A matrix R is a rotation if no element of R R' - I is larger.
_ORTHONORMAL = 2e-3
#: Rows that are tested for matrices, at most, and part of them that must hold one.
_LOOKED_AT, _MOST = 100, 0.9
#: The squares of a quaternion add up to 1 within this.
_UNIT_LENGTH = 2e-3
#: Components of a quaternion that change by more show a turn.
_TURNS = 0.02
#: A matrix whose elements change by less is constant.
_SAME_MATRIX = 1e-6


@dataclass(frozen=True)
class MatrixColumns:
    """Columns of the elements of a pose matrix."""

    rotation: tuple[str, ...]  # nine, row by row
    position: tuple[str, ...]  # three
    moves: bool  # whether the matrix differs from row to row of the file


def matrix_columns(names: Sequence[str], numbers: Array) -> list[MatrixColumns]:
    """Return the pose matrices among columns (N, k), first those that move and are measured.

    They have 16 elements, row by row or column by column, or 12 without the last row 0, 0, 0, 1.
    """
    some = numbers[spread(len(numbers), _LOOKED_AT)]
    found, k = [], 0
    while k + 12 <= len(names):
        for size, by_columns in ((16, False), (16, True), (12, False)):
            if k + size > len(names):
                continue
            at = np.arange(size).reshape((4, 4) if size == 16 else (3, 4))
            at = k + (at.T if by_columns else at)
            values = _whole_rows(some[:, at])
            if _are_matrices(values):
                moves = bool(np.ptp(values, axis=0).max() > _SAME_MATRIX)
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


def _whole_rows(values: Array) -> Array:
    """Return the rows (N, …) without blanks, as of a target that was not seen in the others."""
    return values[np.isfinite(values).all(axis=tuple(range(1, values.ndim)))]


def _are_matrices(values: Array) -> bool:
    """Return whether most matrices (N, 3 or 4, 3 or 4) are rotations, with places if 4 wide."""
    R = values[:, :3, :3]
    with np.errstate(invalid="ignore"):
        off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
        right = (off < _ORTHONORMAL) & (np.linalg.det(np.nan_to_num(R)) > 0.0)
        if values.shape[1] == 4:
            right &= np.abs(values[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1) < 1e-9
    return bool(right.mean() > _MOST) if len(values) else False


def rows_of_a_matrix(numbers: Array) -> int:
    """Return how many rows (N, 4) each hold a pose matrix, one below another; 0 for none."""
    for rows in (4, 3):
        if numbers.shape[1] == 4 and len(numbers) and len(numbers) % rows == 0:
            matrices = numbers.reshape(-1, rows, 4)
            if _are_matrices(matrices[spread(len(matrices), _LOOKED_AT)]):
                return rows
    return 0


def rotation_columns(names: Sequence[str], numbers: Array) -> tuple[str, ...]:
    """Return the first nine neighbouring columns that are a moving rotation; empty for none.

    Row by row or column by column they are the rotation or its inverse; which one is not decided.
    """
    some = numbers[spread(len(numbers), _LOOKED_AT)]
    for k in range(len(names) - 8):
        R = _whole_rows(some[:, k : k + 9]).reshape(-1, 3, 3)
        if _are_matrices(R) and np.ptp(R, axis=0).max() > _SAME_MATRIX:
            return tuple(names[k : k + 9])
    return ()


def quaternion_columns(names: Sequence[str], numbers: Array) -> tuple[str, ...]:
    """Return the first four neighbouring columns that are a moving quaternion; empty for none."""
    some = numbers[spread(len(numbers), _LOOKED_AT)]
    for k in range(len(names) - 3):
        four = _whole_rows(some[:, k : k + 4])
        off = np.abs(np.sum(four**2, axis=1) - 1.0)
        moving = (np.ptp(four, axis=0) > _TURNS).sum() >= 3 if len(four) else False
        if moving and np.mean(off < _UNIT_LENGTH) > _MOST:
            return tuple(names[k : k + 4])
    return ()


def _beside(names: Sequence[str], place: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the four columns behind those of a place, and the four before them."""
    at = sorted(map(names.index, place))
    sides = names[at[-1] + 1 : at[-1] + 5], names[max(at[0] - 4, 0) : at[0]]
    return [tuple(four) for four in sides if len(four) == 4]


def with_matrix(roles: Roles, names: Sequence[str], numbers: Array) -> Roles:
    """Return roles with position and orientation by a moving matrix, if there is one.

    Without one, nine neighbouring columns that are a rotation are the orientation, if there is no
    other; likewise four that are a quaternion, directly before or behind the position.
    """
    free = [name for name in names if name not in (*roles.joints, *roles.torques)]
    columns = [names.index(name) for name in free]
    matrices = [each for each in matrix_columns(free, numbers[:, columns]) if each.moves]
    if not matrices:
        taken = {name for place in roles.positions.values() for name in place}
        free = [name for name in free if name not in taken]
        nine = rotation_columns(free, numbers[:, [names.index(name) for name in free]])
        if not roles.positions or roles.attitude is not None:
            return roles
        if nine:
            return replace(roles, attitude=(nine, "matrix"))
        place = next(iter(roles.positions.values()))
        for four in _beside(names, place):
            if set(four) <= set(free) and quaternion_columns(
                four, numbers[:, list(map(names.index, four))]
            ):
                return replace(roles, attitude=(four, "quaternion_wxyz"))
        return roles
    first = matrices[0]
    taken = {name for each in matrices for name in (*each.rotation, *each.position)}
    single = {key: name for key, name in roles.single.items() if name not in taken}
    attitude = (first.rotation, "matrix")
    return replace(roles, positions={"": first.position}, attitude=attitude, single=single)
