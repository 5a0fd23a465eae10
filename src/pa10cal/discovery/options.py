"""Options of the search for missing effects."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, FiniteFloat

from pa10cal.settings_section import NonNegative, Section


class DiscoveryOptions(Section):
    """The search for missing effects. Uncertainties are standard uncertainties."""

    error_rate: Annotated[FiniteFloat, Field(gt=0, lt=1)] = Field(
        0.01, description="probability allowed of a name where nothing is missing"
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
