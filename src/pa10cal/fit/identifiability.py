"""What the poses identify: rank, null directions by name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from pa10cal.arrays import Array
from pa10cal.rules import PARAMETERS
from pa10cal.terms.term import TermParameter

#: Rows that are factorised at once (computing).
_QR_ROWS = 50_000


@dataclass(frozen=True)
class Identifiability:
    """Singular values of the Jacobian in parameters divided by their scale."""

    singular_values: Array  # (k,) descending
    rank: int  # number of directions that the data identify
    null_space: Array  # (k, k - rank) orthonormal basis of the others, in scaled parameters
    condition: float  # ratio of the largest to the smallest singular value that counts


def triangle_of(rows: Array) -> Array:
    """Return R of the QR factorisation of rows (r, k), part by part: it copies what it is given.

    The Gram matrix would square the condition number; this keeps the cost linear in rows.
    """
    triangle = rows[:0]
    for first in range(0, len(rows), _QR_ROWS):
        part = np.concatenate([triangle, rows[first : first + _QR_ROWS]])
        triangle = np.asarray(np.linalg.qr(part, mode="r"))
    return triangle


def identify(jacobian: Array, scale: Array) -> Identifiability:
    """Find what a Jacobian (rows, k) identifies of parameters of given scale (k,)."""
    _, values, right = np.linalg.svd(triangle_of(jacobian * scale))
    full = np.zeros(len(scale))
    full[: len(values)] = values
    rank = int(np.count_nonzero(full > PARAMETERS.null_ratio * full[0]))
    return Identifiability(full, rank, right[rank:].T, float(full[0] / full[rank - 1]))


def unidentified_directions(
    identifiability: Identifiability, parameters: tuple[TermParameter, ...]
) -> tuple[dict[str, float], ...]:
    """Name the null directions, each by as few parameters as the null space allows.

    Returns:
        Of each the part of its parameters by name, in their own units, the first being 1 unit.
    """
    basis = identifiability.null_space
    count = basis.shape[1]
    if count == 0:
        return ()
    # Make the basis the identity on the rows that carry it best: sparse, hence nameable.
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
    """Return the names of the parameters that take part in a null direction."""
    share = np.linalg.norm(identifiability.null_space, axis=1)
    return frozenset(
        parameter.name
        for parameter, part in zip(parameters, share, strict=True)
        if part > PARAMETERS.no_part
    )
