"""Options of the base frame."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from pa10cal.settings_section import Positive, Section


class BaseFrameOptions(Section):
    """Base frame from the straight-line moves, equations (5)-(7)."""

    min_length_mm: Positive = Field(50.0, description="a shorter straight move is refused")
    max_bend_mm: Positive = Field(
        5.0, description="largest rms distance from the fitted line before it counts as bent"
    )
    min_angle_deg: Annotated[float, Field(gt=0, lt=90)] = Field(
        60.0, description="a smaller angle between the x and y moves counts as parallel"
    )
