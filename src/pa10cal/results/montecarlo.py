"""`montecarlo/z<mm>.json`: position error from resolver uncertainty in a horizontal plane."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pa10cal.results.record import CampaignRecord, Column, CountColumn, Part, Shape


class Convergence(Part):
    """Mean over all places after the first cycles at each."""

    cycles: CountColumn = Field(description="cycles at each place")
    mean_mm: Column = Field(description="mean position error [mm]")
    half_width95_mm: Column = Field(description="half width of its 95 % interval [mm]")


class Places(Part):
    """Every place drawn."""

    columns: tuple[str, ...] = Field(description="names of the columns")
    rows: Annotated[NDArray[np.float64], Shape("places", 5)] = Field(
        description="one row a place, in the order of the columns [mm]"
    )


class PlaneMap(Part):
    """Expected error on a grid over the plane."""

    spacing_mm: float = Field(description="distance between points of the grid [mm]")
    unreachable_points: int = Field(description="points of the grid out of reach")
    columns: tuple[str, ...] = Field(description="names of the columns")
    rows: Annotated[NDArray[np.float64], Shape("points", 3)] = Field(
        description="one row a point, in the order of the columns [mm]"
    )


class PlaneRecord(CampaignRecord):
    """`montecarlo/z<mm>.json`."""

    SCHEMA: ClassVar[str] = "pa10cal-montecarlo/1"
    FILE: ClassVar[str] = "montecarlo/z<mm>.json"
    COMMAND: ClassVar[str] = "montecarlo"

    robot: str = Field(description="name of the arm")
    plane_mm: int = Field(description="height of the flange above the base [mm]")
    reach_m: tuple[float, float] = Field(description="shortest and longest reach [m]")
    reach_is: str = Field(description="what `reach_m` measures")
    attitude: str = Field(description="attitude of the flange")
    sigma_deg: float = Field(description="standard uncertainty of a joint angle [deg]")
    random_seed: int = Field(description="seed of the draws")
    cycles: int = Field(description="cycles at each place")
    positions: int = Field(description="places drawn")
    rejected_positions: int = Field(description="places drawn that are out of reach")
    mean_mm: float = Field(description="mean position error [mm]")
    std_mm: float = Field(description="standard deviation of the position error [mm]")
    std_is: str = Field(description="over what `std_mm` is taken")
    std_between_mm: float = Field(description="standard deviation of the means of places [mm]")
    std_total_mm: float = Field(description="standard deviation over all cycles and places [mm]")
    half_width95_cycles_mm: float = Field(
        description="half width of the mean's 95 % interval, the places given [mm]"
    )
    half_width95_positions_mm: float = Field(
        description="half width of the mean's 95 % interval, the places drawn [mm]"
    )
    closed_form_mean_mm: float = Field(description="mean position error in closed form [mm]")
    closed_form_std_mm: float = Field(description="standard deviation in closed form [mm]")
    closed_form_relative_difference: float = Field(
        description="mean drawn over mean in closed form, minus one"
    )
    convergence: Convergence = Field(description="mean against the number of cycles")
    per_position: Places = Field(description="every place drawn")
    map: PlaneMap = Field(description="expected error over the plane")
