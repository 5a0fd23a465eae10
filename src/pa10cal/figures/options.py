"""Options of the figures."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pa10cal.evaluation.options import EvaluationOptions
from pa10cal.montecarlo.options import MonteCarloOptions
from pa10cal.settings_section import Section


class FigureOptions(Section):
    """Looks shared by all figures."""

    png_dpi: Annotated[int, Field(ge=50, le=600)] = Field(150, description="resolution of the PNG")
    film: Literal["gif", "mp4"] = Field(
        "gif", description="of a chain that moves, where mp4 needs ffmpeg"
    )


class PictureOptions(Section):
    """The settings that pictures of a campaign read."""

    figures: FigureOptions = Field(FigureOptions(), description="looks shared by all figures")
    kcub_reading: Literal["text_e7", "table_e8"] = Field(
        "text_e7", description="exponent of the paper's cubic stiffness"
    )
    montecarlo: MonteCarloOptions = Field(
        MonteCarloOptions(), description="position error from resolver uncertainty"
    )
    evaluation: EvaluationOptions = Field(
        EvaluationOptions(), description="held-out points and loads"
    )
