"""Records of the Monte Carlo study: position error from resolver uncertainty in a plane."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from pa10cal.results import arrays, record


class Convergence(record.Part):
    """Mean over all places after the first cycles at each."""

    cycles: arrays.CountColumn  # cycles at each place
    mean_mm: arrays.Column  # mean position error [mm]
    half_width95_mm: arrays.Column  # half width of its 95 % interval [mm]


class Places(record.Part):
    """Every place drawn."""

    columns: tuple[str, ...]  # names of the columns
    # one row a place, in the order of the columns [mm]
    rows: Annotated[NDArray[np.float64], arrays.Shape("places", 5)]


class PlaneMap(record.Part):
    """Expected error on a grid over the plane."""

    spacing_mm: float  # distance between points of the grid [mm]
    unreachable_points: int  # points of the grid out of reach
    columns: tuple[str, ...]  # names of the columns
    # one row a point, in the order of the columns [mm]
    rows: Annotated[NDArray[np.float64], arrays.Shape("points", 3)]


@record.filed("pa10cal-montecarlo/1", "montecarlo/z<mm>.json", by="montecarlo")
class PlaneRecord(record.CampaignRecord):
    """`montecarlo/z<mm>.json`."""

    robot: str  # name of the arm
    plane_mm: int  # height of the flange above the base [mm]
    reach_m: tuple[float, float]  # shortest and longest reach [m]
    reach_is: str  # what `reach_m` measures
    attitude: str  # orientation of the flange
    sigma_deg: float  # standard uncertainty of a joint angle [deg]
    random_seed: int  # seed of the draws
    cycles: int  # cycles at each place
    positions: int  # places drawn
    rejected_positions: int  # places drawn that are out of reach
    mean_mm: float  # mean position error [mm]
    std_mm: float  # standard deviation of the position error [mm]
    std_is: str  # over what `std_mm` is taken
    std_between_mm: float  # standard deviation of the means of places [mm]
    std_total_mm: float  # standard deviation over all cycles and places [mm]
    half_width95_cycles_mm: float  # half width of the mean's 95 % interval, the places given [mm]
    # half width of the mean's 95 % interval, the places drawn [mm]
    half_width95_positions_mm: float
    closed_form_mean_mm: float  # mean position error in closed form [mm]
    closed_form_std_mm: float  # standard deviation in closed form [mm]
    closed_form_relative_difference: float  # mean drawn over mean in closed form, minus one
    convergence: Convergence  # mean against the number of cycles
    per_position: Places  # every place drawn
    map: PlaneMap  # expected error over the plane


@record.filed("pa10cal-montecarlo-not-studied/1", "montecarlo/z<mm>.json", by="montecarlo")
class PlaneNotStudied(record.CampaignRecord):
    """`montecarlo/z<mm>.json` of a plane that is not for this arm."""

    robot: str  # name of the arm
    plane_mm: int  # height of the flange above the base [mm]
    why: str  # why the plane was not studied, one clause
