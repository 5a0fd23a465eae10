"""Identifiability of parameters: rank of the Jacobian, and its null directions by name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from pa10cal.arrays import Array
from pa10cal.rules import PARAMETERS
from pa10cal.terms.term import TermParameter

#: Number of rows factorised at once (computing).
_QR_ROWS = 50_000


@dataclass(frozen=True)
class Identifiability:
    """Singular values of the Jacobian in parameters divided by their scale."""

    singular_values: Array  # (k,) descending
    rank: int  # number of directions that the data identify
    null_space: Array  # (k, k - rank) orthonormal basis of the others, in scaled parameters
    condition: float  # ratio of the largest singular value to the smallest of those within the rank


def triangle_of(rows: Array) -> Array:
    """Return R of the QR factorisation of rows (r, k), computed in blocks to save memory.

    It has the singular values of the rows; the Gram matrix would square the condition number.
    """
    triangle = rows[:0]
    for first in range(0, len(rows), _QR_ROWS):
        part = np.concatenate([triangle, rows[first : first + _QR_ROWS]])
        triangle = np.asarray(np.linalg.qr(part, mode="r"))
    return triangle


def identify(jacobian: Array, scale: Array) -> Identifiability:
    """Return what a Jacobian (rows, k) identifies of parameters of given scale (k,)."""
    _, values, right = np.linalg.svd(triangle_of(jacobian * scale))
    full = np.zeros(len(scale))
    full[: len(values)] = values
    rank = int(np.count_nonzero(full > PARAMETERS.null_ratio * full[0]))
    return Identifiability(full, rank, right[rank:].T, float(full[0] / full[rank - 1]))


def unidentified_directions(
    identifiability: Identifiability, parameters: tuple[TermParameter, ...]
) -> tuple[dict[str, float], ...]:
    """Return the null directions, each in as few parameters as the null space allows.

    Returns:
        For each direction its components by name of the parameter, in the parameters' own units,
        relative to the first.
    """
    basis = identifiability.null_space
    count = basis.shape[1]
    if count == 0:
        return ()
    # In the basis that is the identity on the pivot rows, directions have few parameters.
    _, _, order = qr(basis.T, pivoting=True, mode="economic")
    basis = basis @ np.linalg.inv(basis[order[:count]])
    scale = np.array([parameter.scale for parameter in parameters])
    directions = []
    for column, pivot in zip(basis.T, order[:count], strict=True):
        weights = column * scale / scale[pivot]
        members = np.flatnonzero(np.abs(column) > PARAMETERS.no_part)
        ranked = sorted(members, key=lambda k: (k != pivot, -abs(column[k])))
        directions.append({parameters[k].name: float(weights[k]) for k in ranked})
    return tuple(directions)


def not_identifiable(
    identifiability: Identifiability, parameters: tuple[TermParameter, ...]
) -> frozenset[str]:
    """Return the names of the parameters with a component in some null direction."""
    share = np.linalg.norm(identifiability.null_space, axis=1)
    return frozenset(
        parameter.name
        for parameter, part in zip(parameters, share, strict=True)
        if part > PARAMETERS.no_part
    )
