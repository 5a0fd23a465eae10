"""Records of a chain of links on a continuous curve, and of the study that calibrates one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue

from pa10cal.results import arrays, record
from pa10cal.results.evaluation import Distances

_Settings = Mapping[Annotated[str, record.Key("option")], JsonValue]
_Model = Annotated[str, record.Key("model")]


class OverFloor(record.Part):
    """Mean errors of all individuals over the noise floor."""

    mean: float  # mean over individuals
    largest: float  # largest of them
    within_bar: int  # individuals within the figure to reach


class CurveStudySummary(record.Part):
    """What became of all individuals that depart in the same way, with one model."""

    departs: str  # how they depart: `rows` or `any_way`
    said: str  # the same in words
    model: str  # the model
    individuals: int  # number of individuals
    converged: int  # fits that converged
    # parameters fitted, of the individual whose rank is farthest below them
    unknowns: int
    rank: int  # rank of its fit
    # directions that are not identifiable by it
    null_directions: tuple[Mapping[record.ParameterKey, float], ...]
    # root mean square of error over standard uncertainty; null without true values
    rms_score: float | None
    fitted: OverFloor  # of poses fitted
    held_out: OverFloor  # of held-out poses
    held_out_true: OverFloor  # of held-out poses without noise


class ErrorsOfModel(record.Part):
    """Position errors of one model of one individual."""

    fitted: Distances  # of poses fitted
    held_out: Distances  # of held-out poses
    held_out_true: Distances  # of held-out poses without noise


class IndividualFit(record.Part):
    """A calibrated model of one individual."""

    converged: bool  # whether the fit converged
    starts: int | None = record.optional()  # starts tried
    starts_agreeing: int | None = record.optional()  # starts that ended in this minimum
    unknowns: int  # parameters fitted
    rank: int  # directions of parameter space identified
    condition: float  # condition number over these directions
    # directions that are not identifiable
    null_directions: tuple[Mapping[record.ParameterKey, float], ...]
    # redundant parameters, and those that replace them
    redundant: Mapping[record.ParameterKey, Mapping[record.ParameterKey, float]]
    scores: Mapping[record.ParameterKey, float]  # value minus truth, in standard uncertainties


class ErrorsByPose(record.Part):
    """Position error of every pose, model by model."""

    pose: arrays.LabelColumn  # label of the pose
    held_out: arrays.FlagColumn  # whether it was held out
    nominal_mm: arrays.Column  # nominal model [mm]
    two_level_mm: arrays.Column  # two-level model [mm]
    two_level_all_mm: arrays.Column  # two-level model, all poses inside [mm]
    general_mm: arrays.Column  # general model [mm]


class Individual(record.Part):
    """One arm, calibrated."""

    number: int  # number of the individual, from 1
    departs: str  # how it departs: `rows` or `any_way`
    said: str  # the same in words
    errors: Mapping[_Model, ErrorsOfModel]  # errors by model
    models: Mapping[_Model, IndividualFit]  # fits by model
    poses: ErrorsByPose  # every pose


class Postures(record.Part):
    """Where the links of the first individual join in every pose."""

    shape: arrays.LabelColumn  # kind of curve of each pose
    # where links join, in the base frame [m]
    p_m: Annotated[NDArray[np.float64], arrays.Shape("poses", "points", 3)]


@record.filed("pa10cal-curve-calibration/1", "curve/calibration.json", by="curve_calibration")
class CurveCalibrationRecord(record.Record):
    """`curve/calibration.json`: a chain of links, posed along curves and calibrated."""

    provenance: str  # where the data come from
    settings: _Settings  # settings of the study
    joints: int  # joints of the chain
    shapes_refused: int  # curves drawn that the chain cannot follow
    noise_floor_mm: float  # mean position error that noise leaves [mm]
    bar: float  # mean error over the noise floor to stay within
    summaries: tuple[CurveStudySummary, ...]  # by departure and model
    individuals: tuple[Individual, ...]  # every individual
    postures_of_first: Postures  # poses of the first individual


# `curve.json`: a chain of links on a continuous curve.


class CurveShape(record.Part):
    """One shape of the chain."""

    time_s: float  # when it has this shape [s]
    ending: str  # how the chain ends on the curve, in a word
    ending_is: str  # the same in words
    left_m: float  # length of the curve that remains beyond the chain [m]
    gap_m: float  # distance from the chain's end to the curve's end [m]
    # largest distance of the curve from the link over it, as far as the links go [m]
    deviation_m: float
    touches: tuple[int, ...]  # links that only touch the curve, from 1
    open_joints: tuple[int, ...]  # joints whose first turn is undetermined, from 1
    roll_deg: float  # roll of the first link [deg]
    largest_angle_deg: float  # largest joint angle [deg]
    chord_error: float  # largest relative error of a link's length
    # largest distance between links laid and forward kinematics [m]
    forward_kinematics_error_m: float


@record.filed("pa10cal-curve/1", "curve.json", by="curve")
class CurveRecord(record.Record):
    """`curve.json`."""

    link_m: float  # length of a link [m]
    links: int  # number of links
    order: str  # which turn of a joint comes first: `zy` or `yz`
    largest_angle_deg: float  # largest joint angle of all shapes [deg]
    largest_move_deg: float  # largest move of a joint from one shape to the next [deg]
    # rolls at which the first shape keeps all joints within limits [deg]; null without limits
    feasible_rolls_deg: tuple[tuple[float, float], ...] | None
    shapes: tuple[CurveShape, ...]  # every shape
    settings: _Settings  # settings of the curve

    @property
    def line(self) -> str:
        """Return in one line what was laid."""
        text = (
            f"{self.links} links of {self.link_m:.6g} m, {self.shapes[0].ending_is}; the curve is "
            f"{max(shape.deviation_m for shape in self.shapes):.3g} m from a link at most; largest "
            f"joint angle {self.largest_angle_deg:.4g} degrees"
        )
        moves = self.settings["gait"] is not None
        return f"{text}, largest move {self.largest_move_deg:.3g}" if moves else text
