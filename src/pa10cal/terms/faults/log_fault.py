"""What a fault of the whole log is: a term that competes with effects, and is told in words."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from pa10cal.arrays import Array
from pa10cal.results.record import FaultKind
from pa10cal.terms.effects.effect import NamedEffect


@dataclass(frozen=True)
class FaultText:
    """A fault in words."""

    where: str  # column, joint, load, pose, row or time
    what: str  # what is wrong and by how much, one clause
    remedy: str  # what to do about it


@dataclass(frozen=True)
class LogFault(NamedEffect):
    """A fault of the whole log, such as a load that is stated wrongly."""

    kind: ClassVar[FaultKind]

    @abstractmethod
    def told(self, x: Array, std: Array) -> FaultText:
        """Return it in words, by its reported parameters and their standard uncertainties."""
