"""Constant departures of chain coordinates: link parameters, base frame and tool."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import BASE, TOOL
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, homogeneous
from pa10cal.options import Tolerances
from pa10cal.terms.term import Report, Role, Term, TermParameter, Traits, identity, report_as_solved

#: Roles of chain coordinates by what their names begin with (`theta_2`, `base.rx`).
_KIND = re.compile(r"[._]")
_ROLES: dict[str, Role] = {"theta": "zero", "beta": "tilt", "base": "base", "tool": "tool"}


@dataclass(frozen=True)
class Offsets(Traits):
    """Adds each parameter to one chain coordinate, the same in every pose."""

    parameters: tuple[TermParameter, ...]  # k parameters
    coordinates: tuple[str, ...]  # the k coordinates they shift
    of: str = "links"  # `links`, `base` or `tool`
    id: ClassVar[str] = "offsets"
    formula: ClassVar[str] = (
        "each parameter is added to the coordinate of the chain at its place in the list"
    )
    constant: ClassVar[bool] = True

    @property
    def stays_with_arm(self) -> bool:
        return self.of == "links"

    @cached_property
    def roles(self) -> tuple[Role, ...]:
        return tuple(_ROLES.get(_KIND.split(name)[0], "link") for name in self.coordinates)

    def same_as(self, other: Term) -> bool:
        """Return whether another term departs the same part; those that both have compare."""
        return self.id == other.id and self.of == other.of

    def only(self, names: Collection[str]) -> Offsets:
        """Return the named parameters with their coordinates, in the order of this term."""
        kept = [k for k, parameter in enumerate(self.parameters) if parameter.name in names]
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in kept),
            coordinates=tuple(self.coordinates[k] for k in kept),
        )

    def shift(self, states: PoseStates, x: Array) -> Array:
        return x[None, :]

    def derivative(self, states: PoseStates, x: Array) -> Array:
        return identity(len(x))[None]

    def report(self, x: Array) -> Report:
        return report_as_solved(self.parameters, x)


def link_departures(arm: Arm, tolerances: Tolerances) -> Offsets:
    """Build the departures of all link parameters: a, alpha, d (or beta), theta of every row.

    Tolerances of lengths are those of arms of usual size. A row with Hayati's parameter has beta in
    place of d (paper, Table I).
    """
    kinds = {
        "a": (tolerances.a_m * arm.size_ratio, "m"),
        "alpha": (tolerances.alpha_rad, "rad"),
        "d": (tolerances.d_m * arm.size_ratio, "m"),
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
        TermParameter(f"delta_{name}", unit, tolerance, tolerance)
        for name in coordinates
        for tolerance, unit in (kinds[name.rpartition("_")[0]],)
    )
    return Offsets(parameters, coordinates)


def base_frame() -> Offsets:
    """Build the six small motions of the base from its estimated frame."""
    return _small_motions(BASE, "base")


def tool_frame() -> Offsets:
    """Build the six small motions of the tool at the end of the chain."""
    return _small_motions(TOOL, "tool")


def is_tool(term: Term) -> bool:
    """Return whether a term is the mounting of the tool; a tool that sags is another term."""
    return "tool" in term.roles and set(term.coordinates) <= set(TOOL)


def _small_motions(names: tuple[str, ...], of: str) -> Offsets:
    parameters = (
        TermParameter(name.replace(".", "_"), "rad" if ".r" in name else "m", 1e-3)
        for name in names
    )
    return Offsets(tuple(parameters), names, of=of)


def motion_of_base(small: Array) -> Array:
    """Return the poses (..., 4, 4) of six small motions of the base (..., 6)."""
    return homogeneous(Rotation.from_euler("XYZ", small[..., 3:]).as_matrix(), small[..., :3])


def small_motion(T: Array) -> Array:
    """Return the six small motions (6,) of a pose (4, 4): the inverse of `motion_of_base`."""
    turn = Rotation.from_matrix(T[:3, :3]).as_euler("XYZ")
    return np.concatenate([T[:3, 3], turn])
