"""Manufacturing tolerances of link parameters."""

from __future__ import annotations

from pydantic import Field

from pa10cal.settings_section import Positive, Section


class Tolerances(Section):
    """Manufacturing tolerances of link parameters; they scale departures (paper, Section II.C)."""

    a_m: Positive = Field(0.25e-3, description="link length")
    alpha_rad: Positive = Field(1e-3, description="twist")
    d_m: Positive = Field(0.25e-3, description="offset")
    beta_rad: Positive = Field(1e-3, description="Hayati parameter between parallel axes")
    theta_rad: Positive = Field(5e-4, description="joint zero")
