"""Settings of the coverage study."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from pa10cal.settings_section import Section


class CoverageCaseSettings(Section):
    """An arm under an instrument, calibrated with the general model."""

    robot: str = Field(description="an arm description")
    instrument: Literal["pose", "points", "distance"] = Field(description="what it is seen with")
    targets: Annotated[int, Field(ge=1)] = Field(1, description="targets of points")
    flexible_joints: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        (), description="joints with a linear spring, of an arm with masses"
    )


class CoverageSettings(Section):
    """Do 95 % intervals hold the truth of simulated campaigns in 95 % of cases?"""

    random_seed: Annotated[int, Field(ge=0)] = Field(1, description="of the first campaign")
    campaigns: Annotated[int, Field(ge=1)] = Field(
        50, description="touched campaigns calibrated with the paper's model"
    )
    general_campaigns: Annotated[int, Field(ge=1)] = Field(
        200, description="campaigns of each case calibrated with the general model, twice over"
    )
    poses: Annotated[int, Field(ge=1)] = Field(60, description="poses in each of these")
    position_mm: Annotated[FiniteFloat, Field(ge=1e-5)] = Field(
        0.05, description="noise of a coordinate or a distance, stated as it is"
    )
    attitude_rad: Annotated[FiniteFloat, Field(ge=1e-8)] = Field(
        2e-4, description="noise of an attitude about each axis, stated as it is"
    )
    cases: tuple[CoverageCaseSettings, ...] = Field(
        (
            CoverageCaseSettings(robot="iiwa14", instrument="pose"),
            CoverageCaseSettings(robot="iiwa14", instrument="points"),
            CoverageCaseSettings(robot="iiwa14", instrument="distance"),
            CoverageCaseSettings(robot="gx4_351s", instrument="pose"),
            CoverageCaseSettings(robot="gx4_351s", instrument="points"),
            CoverageCaseSettings(robot="gx4_351s", instrument="distance"),
            CoverageCaseSettings(robot="ur10", instrument="points"),
            CoverageCaseSettings(robot="ur10", instrument="distance"),
            CoverageCaseSettings(robot="ur10", instrument="pose", flexible_joints=(2, 3, 4, 5)),
            CoverageCaseSettings(robot="irb120", instrument="points", targets=3),
        ),
        description="cases calibrated with the general model",
    )
