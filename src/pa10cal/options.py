"""What sections of the settings are made of, and the sections of stages that have few options."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, field_validator

Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]


class Section(BaseModel):
    """A part of the configuration: frozen, and closed to unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Tolerances(Section):
    """Manufacturing tolerances of link parameters; they scale departures (paper, Section II.C)."""

    a_m: Positive = Field(0.25e-3, description="link length")
    alpha_rad: Positive = Field(1e-3, description="twist")
    d_m: Positive = Field(0.25e-3, description="offset")
    beta_rad: Positive = Field(1e-3, description="Hayati parameter between parallel axes")
    theta_rad: Positive = Field(5e-4, description="joint zero")


class BaseFrameOptions(Section):
    """Base frame from the straight-line moves, equations (5)-(7)."""

    min_length_mm: Positive = Field(50.0, description="a shorter straight move is refused")
    max_bend_mm: Positive = Field(
        5.0, description="largest rms distance from the fitted line before it counts as bent"
    )
    min_angle_deg: Annotated[float, Field(gt=0, lt=90)] = Field(
        60.0, description="a smaller angle between the x and y moves counts as parallel"
    )


class IngestOptions(Section):
    """Raw logs to a table of poses."""

    stray_touch_sigma: Positive = Field(
        6.0,
        description="a touch further off its sphere than this many instrument sigmas is an outlier",
    )
    still_speed_deg_s: Positive = Field(
        0.02, description="a joint slower than this is at rest [deg/s]"
    )
    max_quarantined_fraction: Annotated[float, Field(gt=0, le=1)] = Field(
        0.2, description="a larger share of quarantined rows is refused"
    )


class DiscoveryOptions(Section):
    """The search for missing effects. Uncertainties are standard uncertainties."""

    error_rate: Annotated[FiniteFloat, Field(gt=0, lt=1)] = Field(
        0.01, description="allowed probability of a name where no effect is missing"
    )
    load_uncertainty: NonNegative = Field(0.005, description="of an external load, relative")
    load_point_uncertainty_mm: NonNegative = Field(
        2.0, description="of the point where the load hangs, per axis"
    )
    tool_com_uncertainty_mm: NonNegative = Field(
        2.0, description="of the apparatus' centre of mass, per axis"
    )
    level_uncertainty_mrad: NonNegative = Field(
        1.0, description="of the direction of gravity in the base frame"
    )
    mass_uncertainty: NonNegative = Field(0.3, description="of a link's mass, relative")
    com_uncertainty_mm: NonNegative = Field(
        30.0, description="of a link's centre of mass, per axis"
    )
    torque_zero_uncertainty: NonNegative = Field(
        0.01, description="of a torque's zero, relative to the rated torque"
    )
    suggestions: Annotated[int, Field(ge=0)] = Field(
        10, description="poses to suggest where effects are indistinguishable"
    )
    random_seed: Annotated[int, Field(ge=0)] = Field(
        20080427, description="of the poses from which suggestions are chosen"
    )


class MonteCarloOptions(Section):
    """Position error from resolver uncertainty, plane by plane."""

    planes_mm: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)] = Field(
        (300, 400, 500, 600, 700), description="heights above the base"
    )
    cycles: Annotated[int, Field(ge=2)] = Field(100_000, description="draws at each position")
    positions: Annotated[int, Field(ge=2)] = Field(
        200, description="chosen uniformly in the reachable part of the plane"
    )
    sigma_deg: Positive = Field(
        0.011, description="standard uncertainty of a resolver, the same for every joint"
    )
    reach_m: tuple[Positive, Positive] = Field(
        (0.5, 0.9), description="the reachable part of a plane: distances from the base axis"
    )
    random_seed: Annotated[int, Field(ge=0)] = Field(20080427, description="of positions and draws")
    map_spacing_mm: Positive = Field(
        50.0, description="spacing of the map of the error over the plane"
    )

    @field_validator("reach_m")
    @classmethod
    def _increasing(cls, reach_m: tuple[float, float]) -> tuple[float, float]:
        if reach_m[0] >= reach_m[1]:
            raise ValueError("two distances [m], the nearer first")
        return reach_m
