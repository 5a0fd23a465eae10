"""The bands that maps were given, and what single poses scatter by, in the records of discovery."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from pa10cal.results.record import Key, ParameterKey, Part


class BandOfMap(Part):
    """How well the band of one map is known; its numbers stand with the effect, as `form.band`."""

    of: str = Field(description="joint of the map")
    log_std: Mapping[ParameterKey, float] = Field(
        description="standard uncertainty of the logarithm of each number of the band"
    )


class LeftOut(Part):
    """Weighed squared error of poses left out, before maps had a band and with it."""

    before: float = Field(description="with sizes that fade with the order")
    after: float = Field(description="with the band")


class Bands(Part):
    """Bands found by marginal likelihood."""

    shared: bool = Field(description="whether all maps have one band")
    scatter: float = Field(description="scatter of the weighed rows that goes with them")
    maps: tuple[BandOfMap, ...] = Field(description="map by map")
    of_time: LeftOut = Field(description="stretches of time left out")
    of_angles: LeftOut = Field(description="stretches of angles of one joint left out")


class PoseScatter(Part):
    """What single poses scatter by about the extended model."""

    joints: tuple[float, ...] = Field(
        description="standard deviation of each joint's position [rad, m]: where it comes to stand"
    )
    kinds: Mapping[Annotated[str, Key("kind")], float] = Field(
        description="standard deviation of each kind of component [m, rad]"
    )
    inside95_train: float = Field(
        description="part of the coordinates of positions fitted that lie in their 95 % intervals, "
        "by this scatter and the uncertainty of the model"
    )
    inside95_holdout: float | None = Field(
        description="the same of held-out poses; null where there are none"
    )
