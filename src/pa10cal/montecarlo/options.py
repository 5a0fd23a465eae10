"""Options of the Monte Carlo study."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from pa10cal.settings_section import Positive, Section


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
