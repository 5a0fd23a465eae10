"""What several campaigns together cannot do: each is read and planned by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NoReturn, Self

from typing_extensions import override

from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Stated
from pa10cal.observe.raw import RawColumns


class OneByOne(Instrument):
    """Refuses to be read or foreseen."""

    @classmethod
    @override
    def foreseen(cls, T_instr_ee: Array, stated: Stated) -> Instrument:
        _refuse("measurements are foreseen")

    @classmethod
    @override
    def from_columns(cls, columns: Mapping[str, Array], stated: Stated) -> Self:
        _refuse("tables of poses are read")

    @classmethod
    @override
    def raw_columns(cls, header: Sequence[str]) -> RawColumns:
        _refuse("raw files are read")

    @classmethod
    @override
    def from_raw(cls, columns: RawColumns, values: Array, u: Array, stated: Stated) -> Instrument:
        _refuse("raw files are read")


def _refuse(what: str) -> NoReturn:
    raise CalibrationError(
        f"{what} campaign by campaign",
        where="a group of campaigns",
        allowed="one campaign",
        remedy="do it for each campaign of the group",
    )
