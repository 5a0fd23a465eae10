"""Constant departures of chain coordinates: link parameters and the base frame."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np

from pa10cal.arm.chain import BASE
from pa10cal.arm.description import Arm
from pa10cal.arm.state import PoseStates
from pa10cal.arm.tolerances import Tolerances
from pa10cal.arrays import Array
from pa10cal.terms.term import Parameter, Report, report_as_solved


@dataclass(frozen=True)
class Offsets:
    """Adds each parameter to one chain coordinate, the same in every pose."""

    parameters: tuple[Parameter, ...]  # k parameters
    coordinates: tuple[str, ...]  # the k coordinates they shift
    of: str = "links"  # `links`, `base` or `tool`
    id: ClassVar[str] = "offsets"

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return "each parameter is added to the coordinate of the chain at its place in the list"

    def only(self, names: Collection[str]) -> Offsets:
        """Return the parameters that are named, with their coordinates, in the order here."""
        kept = [k for k, parameter in enumerate(self.parameters) if parameter.name in names]
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in kept),
            coordinates=tuple(self.coordinates[k] for k in kept),
        )

    def shift(self, states: PoseStates, x: Array) -> Array:
        """Return the parameters themselves, (1, k)."""
        del states
        return x[None, :]

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the identity, (1, k, k)."""
        del states
        return identity(len(x))[None]

    def report(self, x: Array) -> Report:
        """Return the parameters as they are."""
        return report_as_solved(self.parameters, x)


@cache
def identity(size: int) -> Array:
    """Return the identity (size, size), read only."""
    matrix = np.eye(size)
    matrix.setflags(write=False)
    return matrix


def link_departures(arm: Arm, tolerances: Tolerances) -> Offsets:
    """Build the departures of all link parameters: a, alpha, d (or beta), theta of every row.

    A row with Hayati's parameter has beta in place of d (paper, Table I).
    """
    kinds = {
        "a": (tolerances.a_m, "m"),
        "alpha": (tolerances.alpha_rad, "rad"),
        "d": (tolerances.d_m, "m"),
        "beta": (tolerances.beta_rad, "rad"),
        "theta": (tolerances.theta_rad, "rad"),
    }
    coordinates = tuple(
        f"{kind}_{row}"
        for kind in kinds
        for row, hayati in enumerate(arm.hayati, start=1)
        if not (kind == "d" and hayati) and not (kind == "beta" and not hayati)
    )
    parameters = tuple(
        Parameter(f"delta_{name}", unit, tolerance, tolerance)
        for name in coordinates
        for tolerance, unit in (kinds[name.rpartition("_")[0]],)
    )
    return Offsets(parameters, coordinates)


def base_frame() -> Offsets:
    """Build the six small motions of the base away from where the chain is put."""
    parameters = tuple(
        Parameter(name.replace(".", "_"), "rad" if ".r" in name else "m", 1e-3) for name in BASE
    )
    return Offsets(parameters, BASE, of="base")
