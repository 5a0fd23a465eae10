"""The parts of result files that pictures are drawn from; other keys are passed over."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, field_validator

Vector = tuple[float, float, float]
Row4 = tuple[float, float, float, float]


class Record(BaseModel):
    """A part of a result file."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class Accuracy(Record):
    """Errors over a set of configurations."""

    mean_mm: float
    peak_mm: float
    orientation_deg: float
    configurations: int


class LoadErrors(Record):
    """Errors at one load, of the nominal and of the calibrated model."""

    before: Accuracy
    after: Accuracy


class Parameter(Record):
    """A parameter with its standard uncertainty."""

    value: float
    std: float
    unit: str
    tolerance: float | None
    identifiable: bool
    at_bound: bool


class InnerDependence(Record):
    """Spread of the parameters over random choices of the inner poses."""

    choices: int
    std: dict[str, float]


class LCurvePoint(Record):
    """One weight of the tolerance terms."""

    weight: float
    misfit: float
    departure: float
    mean_mm: float


class Residual(Record):
    """Predicted minus measured position at one configuration, along the base axes."""

    pose: str
    load_N: float
    place_mm: Vector
    position_mm: Vector


class CalibrationSettingsUsed(Record):
    """What a calibration was run with."""

    epsilon: float
    epsilon_acts_on: str
    tolerance_terms: str
    inner_poses: int | str


class Calibration(Record):
    """`calibration/<load>.json`."""

    robot: str
    load: str
    loads_fitted: tuple[float, ...]
    parameters: dict[str, Parameter]
    rank: int
    unknowns: int
    null_directions: tuple[dict[str, float], ...]
    errors: dict[str, LoadErrors]
    inner_dependence: InnerDependence
    l_curve: tuple[LCurvePoint, ...]
    residuals: tuple[Residual, ...]
    settings: CalibrationSettingsUsed

    @field_validator("errors", mode="before")
    @classmethod
    def _by_newton(cls, errors: Any) -> Any:
        """Key errors by the load alone, `22` for `22N`."""
        if not isinstance(errors, dict):
            return errors
        return {str(load).removesuffix("N"): found for load, found in errors.items()}


class ToolTwist(Record):
    """A constant rotation of the tool, and the orientation error with and without it."""

    angle_deg: float
    before_deg: float
    after_deg: float


class HeldOutRow(Record):
    """Predicted minus measured at one held-out configuration."""

    pose: str
    load_N: float
    position_mm: Vector


class HeldOutModel(Accuracy):
    """One model on the held-out configurations."""

    tool_twist: ToolTwist
    rows: tuple[HeldOutRow, ...]


class HeldOut(Record):
    """`evaluation/holdout.json`."""

    calibration: str
    configurations: int
    models: dict[str, HeldOutModel]


class BaseFrame(Record):
    """`seed/base_frame.json`."""

    T_cmm_base: tuple[Row4, Row4, Row4, Row4]


class Convergence(Record):
    """Mean over all places after the first cycles at each."""

    cycles: tuple[int, ...]
    mean_mm: tuple[float, ...]
    half_width95_mm: tuple[float, ...]


class PlaneMap(Record):
    """Expected error on a grid over the plane: x, y, mean [mm]."""

    spacing_mm: float
    rows: tuple[Vector, ...]


class Plane(Record):
    """`montecarlo/z<mm>.json`."""

    robot: str
    plane_mm: int
    reach_m: tuple[float, float]
    sigma_deg: float
    cycles: int
    positions: int
    rejected_positions: int
    mean_mm: float
    std_mm: float
    std_between_mm: float
    half_width95_positions_mm: float
    closed_form_mean_mm: float
    convergence: Convergence
    map: PlaneMap
