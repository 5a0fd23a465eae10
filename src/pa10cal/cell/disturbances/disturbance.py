"""What a disturbance of a log is; its classes are found by looking through this folder.

A stressor is what ordinary logs have: a verdict must stand it. A fault is an error in the log:
somebody must be told of it, by kind and place.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any, ClassVar, Literal

import numpy as np

from pa10cal.cell import disturbances
from pa10cal.cell.classes import classes_in
from pa10cal.cell.options import DisturbanceOptions
from pa10cal.cell.raw_log import RawLog
from pa10cal.errors import SettingsError
from pa10cal.settings_reading import parse_section
from pa10cal.settings_section import Section

#: What a campaign must have for a disturbance to mean anything.
Need = Literal["loads", "masses", "springs", "repeats", "touches", "attitude", "targets", "tracker"]


class Disturbance(Section):
    """Something that changes the raw files of a campaign. Its fields are its parameters."""

    id: ClassVar[str]
    #: Whether ordinary logs have it, so that nobody need be told.
    stressor: ClassVar[bool] = False
    #: Whether it moves what the model leaves only where it is large, so that trials measure by how
    #: much; else it is far above the noise.
    measured: ClassVar[bool] = False
    #: Kinds of fault of a verdict that tell it.
    kinds: ClassVar[tuple[str, ...]] = ()
    #: What the campaign must have.
    needs: ClassVar[tuple[Need, ...]] = ()

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return parameters drawn for a trial, for an arm of so many joints."""
        del joints, rng
        return {}

    @abstractmethod
    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Change the raw files, and return where: poses, joints, loads or keys.

        Args:
            log: the raw files, changed in place.
            rng: draws what the parameters leave open.
        """


@cache
def all_disturbances() -> dict[str, type[Disturbance]]:
    """Return every disturbance by its id, module by module, each in the order of its file."""
    return classes_in(disturbances, Disturbance)


def disturb(
    log: RawLog, entries: Sequence[DisturbanceOptions], seed: int
) -> tuple[tuple[str, ...], ...]:
    """Put disturbances into raw files, one after the other, and return where each is.

    Args:
        log: the raw files, changed in place.
        entries: which, with their parameters.
        seed: of the campaign; what a disturbance draws is its own.

    Raises:
        SettingsError: for a disturbance or a parameter that does not exist.
    """
    known = all_disturbances()
    places = []
    for number, entry in enumerate(entries):
        where = f"disturbances[{number}]"
        if entry.id not in known:
            raise SettingsError(
                "unknown disturbance",
                where=f"{where}.id",
                value=entry.id,
                allowed=", ".join(known),
                remedy="correct the name",
            )
        disturbance = parse_section(known[entry.id], entry.parameters, where=f"{where}.parameters")
        rng = np.random.default_rng([seed, 1 + number, len(entry.id)])
        places.append(tuple(disturbance.put_into(log, rng)))
    return tuple(places)
