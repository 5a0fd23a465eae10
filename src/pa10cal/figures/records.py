"""The parts of result files that pictures are drawn from; other keys are passed over."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict

Vector = tuple[float, float, float]
Row4 = tuple[float, float, float, float]


def _without_unit(errors: Any) -> Any:
    if not isinstance(errors, dict):
        return errors
    return {str(load).removesuffix("N"): found for load, found in errors.items()}


#: Keys a mapping by the load alone, `22` for `22N`.
BY_NEWTON = BeforeValidator(_without_unit)


class Record(BaseModel):
    """A part of a result file."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class Accuracy(Record):
    """Errors over a set of configurations; the angle is None where no attitude was seen."""

    mean_mm: float
    peak_mm: float
    rms_mm: float
    orientation_deg: float | None
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
    rotation_deg: Vector | None


class CorrelatedPair(Record):
    """Two parameters that the poses can hardly tell apart."""

    parameters: tuple[str, str]
    correlation: float


class Expected(Record):
    """Uncertainty of a prediction to be expected with so many poses."""

    poses: int
    u_optimal_mm: float
    u_measured_mm: float | None


class PosesWanted(Record):
    """How many poses there are, and how many the uncertainty wants."""

    measured: int
    wanted: int | None
    u_wanted_mm: float
    u_model_mm: float | None
    d_optimal_order: tuple[str, ...]
    expected: tuple[Expected, ...]


class Health(Record):
    """Whether a calibration is good."""

    verdict: str
    line: str
    reason: str
    iterations: int
    at_bounds: tuple[str, ...]
    rank: int
    unknowns: int
    condition: float
    not_identifiable: tuple[str, ...]
    correlated_pairs: tuple[CorrelatedPair, ...]
    train_rms_mm: float
    held_out_rms_mm: float | None
    noise_mm: float | None
    poses: PosesWanted


class CalibrationSettingsUsed(Record):
    """What a calibration was run with."""

    epsilon: float
    epsilon_acts_on: str
    tolerance_terms: str
    inner_poses: int | str


class Fit(Record):
    """How one of the fits of a calibration ended."""

    status: str
    reason: str


class AnyCalibration(Fit):
    """What `calibration/<load>.json` holds whatever the model."""

    robot: str
    load: str
    model: str
    loads_fitted: tuple[float, ...]
    residuals: tuple[Residual, ...]
    health: Health

    @property
    def fits(self) -> dict[str, Fit]:
        """Return every fit that the file holds, by its key; the calibration itself has none."""
        return {"": self}


class Calibration(AnyCalibration):
    """`calibration/<load>.json` of the paper's model."""

    model: Literal["paper"]
    parameters: dict[str, Parameter]
    rank: int
    unknowns: int
    null_directions: tuple[dict[str, float], ...]
    errors: Annotated[dict[str, LoadErrors], BY_NEWTON]
    inner_dependence: InnerDependence
    l_curve: tuple[LCurvePoint, ...]
    linear: Fit
    settings: CalibrationSettingsUsed

    @property
    def fits(self) -> dict[str, Fit]:
        """Return the fit with cubic springs, and that with linear ones."""
        return {"": self, "linear": self.linear}


class ToolTwist(Record):
    """A constant rotation of the tool, and the orientation error with and without it."""

    angle_deg: float
    before_deg: float
    after_deg: float


class HeldOutRow(Record):
    """Predicted minus measured at one held-out configuration.

    `error_mm` is the length of `position_mm` where it is not stated. `extrapolated` is None where
    the model has learnt nothing that stops at the angles seen.
    """

    pose: str
    load_N: float
    position_mm: Vector
    rotation_deg: Vector | None
    error_mm: float | None = None
    extrapolated: bool | None = None


class HeldOutModel(Accuracy):
    """One model on the held-out configurations, inside the angles it was trained on and beyond."""

    tool_twist: ToolTwist | None
    inside: Accuracy | None = None
    extrapolated: Accuracy | None = None
    rows: tuple[HeldOutRow, ...]


class HeldOut(Record):
    """`evaluation/holdout.json`."""

    calibration: str
    configurations: int
    models: dict[str, HeldOutModel]


class BaseFrame(Record):
    """`seed/base_frame.json`."""

    T_instr_base: tuple[Row4, Row4, Row4, Row4]


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
