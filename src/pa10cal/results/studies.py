"""Studies of simulated campaigns: how often intervals hold the truth; a chain along curves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue

from pa10cal.results.evaluation import Distances
from pa10cal.results.record import (
    CampaignRecord,
    Column,
    CountColumn,
    FlagColumn,
    Key,
    LabelColumn,
    ParameterKey,
    Part,
    Record,
    Shape,
    filed,
    optional,
)

_Settings = Mapping[Annotated[str, Key("option")], JsonValue]
_Model = Annotated[str, Key("model")]


class ParameterCoverage(Part):
    """How often the interval of one parameter holds the truth."""

    inside: float = Field(description="share inside the 95 % interval")
    rms: float = Field(description="root mean square of error over standard uncertainty")


class Coverage(ParameterCoverage):
    """How often intervals hold the truth."""

    inside_interval95: tuple[float, float] = Field(description="95 % interval of the share")


class PaperCoverage(Coverage):
    """The paper's robot under touched balls, calibrated with the paper's model."""

    campaigns: int = Field(description="campaigns simulated")
    parameters: Mapping[ParameterKey, ParameterCoverage] = Field(description="by parameter")


class ClassCoverage(Coverage):
    """Coverage of the parameters of one arm under one instrument."""

    by_class: Mapping[Annotated[str, Key("class")], Coverage] = Field(
        description="by class of parameters: `angles`, `lengths`, `base`, `tool`, ..."
    )
    by_parameter: Mapping[ParameterKey, ParameterCoverage] = Field(description="by parameter")


class FreeDeparture(Part):
    """Arms that depart in any way, which have no true parameters."""

    campaigns: int = Field(description="campaigns simulated")
    converged: float = Field(description="share of fits that converged")
    predictions: Coverage = Field(description="of predicted positions")


class CoverageCase(Part):
    """One arm under one instrument."""

    case: str = Field(description="the case in words")
    robot: str = Field(description="name of the arm")
    instrument: str = Field(description="kind of the instrument")
    targets: int = Field(description="number of targets")
    flexible_joints: tuple[int, ...] = Field(description="joints with a spring, from 1")
    campaigns: int = Field(description="campaigns simulated")
    converged: float = Field(description="share of fits that converged")
    unknowns: int = Field(description="parameters fitted")
    redundant: Mapping[ParameterKey, Mapping[ParameterKey, float]] = Field(
        description="parameters not fitted, and those that replace them"
    )
    parameters: ClassCoverage = Field(description="of parameters")
    predictions: Coverage = Field(description="of predicted positions")
    departing_in_any_way: FreeDeparture = Field(description="arms that depart in any way")


@filed("pa10cal-coverage/2", "coverage.json", by="coverage")
class CoverageRecord(Record):
    """`coverage.json`: how often intervals hold the truth of simulated campaigns."""

    provenance: str = Field(description="where the data come from")
    settings: _Settings = Field(description="settings of the study")
    paper: PaperCoverage = Field(description="the paper's model")
    cases: tuple[CoverageCase, ...] = Field(
        description="the general model, one entry an arm and instrument"
    )


class OverFloor(Part):
    """Mean errors of all individuals over the noise floor."""

    mean: float = Field(description="mean over individuals")
    largest: float = Field(description="largest of them")
    within_bar: int = Field(description="individuals within the figure to reach")


class CurveStudySummary(Part):
    """What became of all individuals that depart in the same way, with one model."""

    departs: str = Field(description="how they depart: `rows` or `any_way`")
    said: str = Field(description="the same in words")
    model: str = Field(description="the model")
    individuals: int = Field(description="number of individuals")
    converged: int = Field(description="fits that converged")
    unknowns: int = Field(description="parameters fitted")
    rank: int = Field(description="smallest rank")
    null_directions: tuple[Mapping[ParameterKey, float], ...] = Field(
        description="directions that are not identifiable"
    )
    rms_score: float | None = Field(
        description="root mean square of error over standard uncertainty; null without a truth"
    )
    fitted: OverFloor = Field(description="of poses fitted")
    held_out: OverFloor = Field(description="of held-out poses")
    held_out_true: OverFloor = Field(description="of held-out poses without noise")


class ErrorsOfModel(Part):
    """Position errors of one model of one individual."""

    fitted: Distances = Field(description="of poses fitted")
    held_out: Distances = Field(description="of held-out poses")
    held_out_true: Distances = Field(description="of held-out poses without noise")


class IndividualFit(Part):
    """A calibrated model of one individual."""

    converged: bool = Field(description="whether the fit converged")
    starts: int | None = optional("starts tried")
    starts_agreeing: int | None = optional("starts that ended in this minimum")
    unknowns: int = Field(description="parameters fitted")
    rank: int = Field(description="directions of parameter space identified")
    condition: float = Field(description="condition number over these directions")
    null_directions: tuple[Mapping[ParameterKey, float], ...] = Field(
        description="directions that are not identifiable"
    )
    redundant: Mapping[ParameterKey, Mapping[ParameterKey, float]] = Field(
        description="redundant parameters, and those that replace them"
    )
    scores: Mapping[ParameterKey, float] = Field(
        description="value minus truth, in standard uncertainties"
    )


class ErrorsByPose(Part):
    """Position error of every pose, model by model."""

    pose: LabelColumn = Field(description="label of the pose")
    held_out: FlagColumn = Field(description="whether it was held out")
    nominal_mm: Column = Field(description="nominal model [mm]")
    two_level_mm: Column = Field(description="two-level model [mm]")
    two_level_all_mm: Column = Field(description="two-level model, all poses inside [mm]")
    general_mm: Column = Field(description="general model [mm]")


class Individual(Part):
    """One arm, calibrated."""

    number: int = Field(description="number of the individual, from 1")
    departs: str = Field(description="how it departs: `rows` or `any_way`")
    said: str = Field(description="the same in words")
    errors: Mapping[_Model, ErrorsOfModel] = Field(description="errors by model")
    models: Mapping[_Model, IndividualFit] = Field(description="fits by model")
    poses: ErrorsByPose = Field(description="every pose")


class Postures(Part):
    """Where the links of the first individual join in every pose."""

    shape: LabelColumn = Field(description="kind of curve of each pose")
    p_m: Annotated[NDArray[np.float64], Shape("poses", "points", 3)] = Field(
        description="where links join, in the base frame [m]"
    )


@filed("pa10cal-curve-calibration/1", "curve/calibration.json", by="curve_calibration")
class CurveCalibrationRecord(Record):
    """`curve/calibration.json`: a chain of links, posed along curves and calibrated."""

    provenance: str = Field(description="where the data come from")
    settings: _Settings = Field(description="settings of the study")
    joints: int = Field(description="joints of the chain")
    shapes_refused: int = Field(description="curves drawn that the chain cannot follow")
    noise_floor_mm: float = Field(description="mean position error that noise leaves [mm]")
    bar: float = Field(description="mean error over the noise floor to stay within")
    summaries: tuple[CurveStudySummary, ...] = Field(description="by departure and model")
    individuals: tuple[Individual, ...] = Field(description="every individual")
    postures_of_first: Postures = Field(description="poses of the first individual")


# `curve.json`: a chain of links on a continuous curve.


class CurveShape(Part):
    """One shape of the chain."""

    time_s: float = Field(description="when it has this shape [s]")
    ending: str = Field(description="how the chain ends on the curve, in a word")
    ending_is: str = Field(description="the same in words")
    left_m: float = Field(description="length of the curve that remains beyond the chain [m]")
    gap_m: float = Field(description="distance from the chain's end to the curve's end [m]")
    touches: tuple[int, ...] = Field(description="links that only touch the curve, from 1")
    open_joints: tuple[int, ...] = Field(
        description="joints whose first turn is undetermined, from 1"
    )
    roll_deg: float = Field(description="roll of the first link [deg]")
    largest_angle_deg: float = Field(description="largest joint angle [deg]")
    chord_error: float = Field(description="largest relative error of a link's length")
    forward_kinematics_error_m: float = Field(
        description="largest distance between links laid and forward kinematics [m]"
    )


@filed("pa10cal-curve/1", "curve.json", by="curve")
class CurveRecord(Record):
    """`curve.json`."""

    link_m: float = Field(description="length of a link [m]")
    links: int = Field(description="number of links")
    order: str = Field(description="which turn of a joint comes first: `zy` or `yz`")
    largest_angle_deg: float = Field(description="largest joint angle of all shapes [deg]")
    largest_move_deg: float = Field(
        description="largest move of a joint from one shape to the next [deg]"
    )
    feasible_rolls_deg: tuple[tuple[float, float], ...] | None = Field(
        description="rolls that keep all joints within limits [deg]; null without limits"
    )
    shapes: tuple[CurveShape, ...] = Field(description="every shape")
    settings: Mapping[Annotated[str, Key("option")], JsonValue] = Field(
        description="settings of the curve"
    )

    @property
    def line(self) -> str:
        """Return in one line what was laid."""
        text = (
            f"{self.links} links of {self.link_m:.6g} m, {self.shapes[0].ending_is}; largest "
            f"joint angle {self.largest_angle_deg:.4g} degrees"
        )
        moves = self.settings["gait"] is not None
        return f"{text}, largest move {self.largest_move_deg:.3g}" if moves else text


# `montecarlo/z<mm>.json`: position error from resolver uncertainty in a horizontal plane.


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


@filed("pa10cal-montecarlo/1", "montecarlo/z<mm>.json", by="montecarlo")
class PlaneRecord(CampaignRecord):
    """`montecarlo/z<mm>.json`."""

    robot: str = Field(description="name of the arm")
    plane_mm: int = Field(description="height of the flange above the base [mm]")
    reach_m: tuple[float, float] = Field(description="shortest and longest reach [m]")
    reach_is: str = Field(description="what `reach_m` measures")
    attitude: str = Field(description="orientation of the flange")
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
