"""Settings of the study that calibrates a chain of links posed along curves."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, FiniteFloat

from pa10cal.settings_section import Positive, Section


class CurveStudySettings(Section):
    """Calibration of a chain of links on two-axis joints, posed along curves, in the cell."""

    random_seed: Annotated[int, Field(ge=0)] = Field(
        2008, description="draws postures, individuals and noise"
    )
    individuals: Annotated[int, Field(ge=1)] = Field(
        10, description="arms calibrated that depart by their rows, and as many in any way"
    )
    links: Annotated[int, Field(ge=2, le=50)] = Field(
        6, description="of the chain; twice as many joints"
    )
    link_m: Positive = Field(0.15, description="length of a link")
    limit_deg: Annotated[FiniteFloat, Field(ge=10, le=120)] = Field(
        75.0, description="how far every joint turns, either way"
    )
    postures: Annotated[int, Field(ge=4)] = Field(
        120, description="shapes along splines, helices and travelling waves in turn, at any roll"
    )
    holdout_share: Annotated[FiniteFloat, Field(gt=0, lt=1)] = Field(
        0.25, description="share of them held out, the last ones"
    )
    position_mm: Annotated[FiniteFloat, Field(ge=1e-5)] = Field(
        0.05, description="noise of a coordinate, stated as it is"
    )
    attitude_rad: Annotated[FiniteFloat, Field(ge=1e-8)] = Field(
        2e-4, description="noise of an attitude about each axis, stated as it is"
    )
