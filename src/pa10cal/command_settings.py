"""Settings of the commands `chain` and `figures`, and sections that they share with `settings`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pa10cal import options
from pa10cal.calibration.options import CalibrationOptions


class EvaluationOptions(options.Section):
    """Held-out points and loads."""

    calibration: str = Field(
        "combined",
        description="load case whose models are evaluated: combined, or a load such as 44N",
    )


class FigureOptions(options.Section):
    """Looks shared by all figures."""

    png_dpi: Annotated[int, Field(ge=50, le=600)] = Field(150, description="resolution of the PNG")
    film: Literal["gif", "mp4"] = Field(
        "gif", description="of a chain that moves, where mp4 needs ffmpeg"
    )


# Sections as fields of settings, each with its description.

KcubReading = Annotated[
    Literal["text_e7", "table_e8"],
    Field(
        description="exponent of the paper's cubic stiffness: text_e7, or table_e8 (its Table I)"
    ),
]
Ingest = Annotated[options.IngestOptions, Field(description="raw logs to a table of poses")]
BaseFrame = Annotated[
    options.BaseFrameOptions, Field(description="from the straight-line moves, equations (5)-(7)")
]
Calibration = Annotated[
    CalibrationOptions,
    Field(description="two levels, equations (1)-(4), and the general model"),
]
MonteCarlo = Annotated[
    options.MonteCarloOptions, Field(description="position error from resolver uncertainty")
]
Evaluation = Annotated[EvaluationOptions, Field(description="held-out points and loads")]
Discovery = Annotated[
    options.DiscoveryOptions,
    Field(description="the search for missing effects; standard uncertainties"),
]
Figures = Annotated[FigureOptions, Field(description="style shared by all figures")]


class PictureOptions(options.Section):
    """Settings of `figures`: what pictures of a campaign read."""

    figures: Figures = FigureOptions()
    kcub_reading: KcubReading = "text_e7"
    montecarlo: MonteCarlo = options.MonteCarloOptions()
    evaluation: Evaluation = EvaluationOptions()


class ChainOptions(options.Section):
    """Settings of `chain`: every stage from raw files to a model."""

    ingest: Ingest = options.IngestOptions()
    base_frame: BaseFrame = options.BaseFrameOptions()
    calibration: Calibration = CalibrationOptions()
    evaluation: Evaluation = EvaluationOptions()
    discovery: Discovery = options.DiscoveryOptions()
