"""What reading raw files has to know of an instrument: its columns, and readings that are none."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array, Mask
from pa10cal.frame.target_fit import LEVER_M


@dataclass(frozen=True)
class RawColumns:
    """Columns of `files.poses` that hold what an instrument measured."""

    # (B,) columns that place each target [mm]: three coordinates, or one distance
    targets: tuple[tuple[str, ...], ...]
    others: tuple[str, ...] = ()  # further columns, without unit
    # whether an empty field says that a target was not seen; else it is an error
    may_be_blank: bool = False

    @property
    def lengths(self) -> tuple[str, ...]:
        """Return the columns that are lengths [mm]."""
        return tuple(name for target in self.targets for name in target)

    @property
    def names(self) -> tuple[str, ...]:
        """Return all k columns."""
        return (*self.lengths, *self.others)


@dataclass(frozen=True)
class Unusable:
    """Rows whose fields, all of them numbers or blank, are no measurement."""

    rows: Mask  # (N,) which
    reason: str  # why
    values: Iterable[str]  # what was found in each of them, as text


@dataclass(frozen=True)
class Misfit:
    """How far B targets were measured from where the nominal model, fitted to them, puts them."""

    length_m: Array  # (P, B) distance, nan where a target was not seen
    turn_rad: Array  # (P,) angle between the attitudes; 0 where none is measured

    @property
    def size_m(self) -> Array:
        """Return the largest misfit of each pose (P,), a turn as far as it moves a target."""
        return np.asarray(np.hypot(np.nanmax(self.length_m, axis=1), LEVER_M * self.turn_rad))
