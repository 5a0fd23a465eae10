"""Spacing and smoothness of a map of a joint's error, in the records of discovery."""

from __future__ import annotations

from pydantic import Field

from pa10cal.results.record import Part, optional


class Fading(Part):
    """How the amplitudes of a map fade with their order."""

    size_rad: float = Field(description="standard deviation of an amplitude of low order [rad]")
    half_order: float = Field(description="order at which amplitudes are half as large")


class Band(Part):
    """How large the amplitudes of a map are in a band of orders, below it and above it."""

    slow_rad: float = Field(
        description="standard deviation of an amplitude of one or two cycles a turn [rad]"
    )
    below_rad: float = Field(description="standard deviation of an amplitude below the band [rad]")
    level_rad: float = Field(description="standard deviation of an amplitude in the band [rad]")
    first_order: float = Field(description="order at which the band begins")
    last_order: float = Field(description="order at which the band ends")
    decay: float = Field(description="power of the order by which amplitudes fall above the band")
    floor_rad: float = Field(description="size that no amplitude is expected to fall below [rad]")


class MapForm(Part):
    """Spacing and smoothness of a map that has its own."""

    knots: int = Field(description="knots a turn")
    fading: Fading | None = optional("how its amplitudes fade with their order, where they do")
    band: Band | None = optional("the band that its amplitudes have, where they do not fade")
