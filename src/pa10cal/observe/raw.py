"""What reading raw files has to know of an instrument: its columns, and readings that are none."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.frame.target_fit import LEVER_M

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class RawColumns:
    """Columns of `files.poses` that hold what an instrument measured.

    Attributes:
        targets: (B,) columns that place each target [mm]: three coordinates, or one distance.
        others: further columns, without unit.
        may_be_blank: whether an empty field says that a target was not seen; else it is an error.
    """

    targets: tuple[tuple[str, ...], ...]
    others: tuple[str, ...] = ()
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
    """Rows whose fields, all of them numbers or blank, are no measurement.

    Attributes:
        rows: (N,) which.
        reason: why.
        values: what was found in each of them, as text.
    """

    rows: Mask
    reason: str
    values: Iterable[str]


@dataclass(frozen=True)
class Misfit:
    """How far B targets were measured from where the nominal model, fitted to them, puts them.

    Attributes:
        length_m: (P, B) distance, nan where a target was not seen.
        turn_rad: (P,) angle between the attitudes; 0 where none is measured.
    """

    length_m: Array
    turn_rad: Array

    @property
    def size_m(self) -> Array:
        """Return the largest misfit of each pose (P,), a turn as far as it moves a target."""
        return np.asarray(np.hypot(np.nanmax(self.length_m, axis=1), LEVER_M * self.turn_rad))
