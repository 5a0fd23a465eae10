"""Targets carried by the end of the chain, and targets in the table of poses."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.frame.pose_error import cross_matrix

AXES = "xyz"
_MM = 1e-3


def carried_targets(T_instr_ee: Array, targets_m: Array) -> tuple[Array, Array]:
    """Return targets (t,) carried by poses (P, 4, 4): places and way from the end, (P, B, 3)."""
    arms = np.einsum("pij,bj->pbi", T_instr_ee[:, :3, :3], targets_m.reshape(-1, 3))
    return T_instr_ee[:, None, :3, 3] + arms, arms


def by_end_and_targets(T_instr_ee: Array, arms: Array) -> tuple[Array, Array]:
    """Return the derivative of carried targets by the end of the chain, and by their places.

    Args:
        T_instr_ee: (P, 4, 4) end of the chain.
        arms: (P, B, 3) way from it to the targets.

    Returns:
        (P, B, 3, 6) and (P, B, 3, 3 B).
    """
    count, targets = arms.shape[:2]
    by_end = np.zeros((count, targets, 3, 6))
    by_end[..., :3] = np.eye(3)
    by_end[..., 3:] = -cross_matrix(arms)
    by_targets = np.zeros((count, targets, 3, targets, 3))
    for b in range(targets):
        by_targets[:, b, :, b] = T_instr_ee[:, :3, :3]
    return by_end, by_targets.reshape(count, targets, 3, 3 * targets)


def names_of_columns(columns: Mapping[str, Array]) -> tuple[str, ...]:
    """Return the names of the balls or other targets whose centres a table of poses holds."""
    held = (re.fullmatch(r"ball(\w+)_x_mm", str(name)) for name in columns)
    return tuple(found.group(1) for found in held if found)


def places_of_columns(
    columns: Mapping[str, Array], names: tuple[str, ...]
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return what a table of poses holds of B targets.

    Returns:
        Centres (P, B, 3) [m], their covariances (P, B, 3, 3), and touches (P, B).
    """
    count = len(columns["time_s"])
    p_mm, cov_mm2 = np.zeros((count, len(names), 3)), np.zeros((count, len(names), 3, 3))
    touches = np.zeros((count, len(names)), dtype=np.int64)
    for b, name in enumerate(names):
        touches[:, b] = columns[f"ball{name}_touches"]
        for i in range(3):
            p_mm[:, b, i] = columns[f"ball{name}_{AXES[i]}_mm"]
            for j in range(i, 3):
                column = columns[f"ball{name}_c{AXES[i]}{AXES[j]}_mm2"]
                cov_mm2[:, b, i, j] = cov_mm2[:, b, j, i] = column
    return _MM * p_mm, _MM**2 * cov_mm2, touches


def columns_of_places(
    names: tuple[str, ...], p_m: Array, cov_m2: Array, touches: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """Return what `places_of_columns` reads back, as columns (P,)."""
    columns: dict[str, NDArray[Any]] = {}
    for b, name in enumerate(names):
        for k, axis in enumerate(AXES):
            columns[f"ball{name}_{axis}_mm"] = p_m[:, b, k] / _MM
        for i in range(3):
            for j in range(i, 3):
                columns[f"ball{name}_c{AXES[i]}{AXES[j]}_mm2"] = cov_m2[:, b, i, j] / _MM**2
        columns[f"ball{name}_touches"] = touches[:, b]
    return columns
