"""Errors of a model over configurations, and configuration by configuration."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pa10cal.results.record import Column, LabelColumn, Part, Table, VectorColumn


class Distances(Part):
    """Position errors over a set of configurations."""

    mean_mm: float = Field(description="mean position error, at the end-effector frame [mm]")
    peak_mm: float = Field(description="largest position error [mm]")
    rms_mm: float = Field(description="root mean square position error [mm]")


class Accuracy(Distances):
    """Errors over a set of configurations."""

    orientation_deg: float | None = Field(
        description="mean angle between predicted and measured attitude [deg]; null where the "
        "instrument measures no attitude"
    )
    configurations: int = Field(description="number of configurations")


class BeforeAfter(Part):
    """Errors of one set of configurations under two models."""

    before: Accuracy = Field(description="errors before")
    after: Accuracy = Field(description="errors after")


class ResidualRows(Table):
    """Residuals of configurations: predicted minus measured, along the base axes."""

    pose: LabelColumn = Field(description="label of the pose")
    load_N: Column = Field(description="load [N]")
    place_mm: VectorColumn = Field(description="predicted position in the base frame [mm]")
    position_mm: VectorColumn = Field(description="position residual along the base axes [mm]")
    rotation_deg: VectorColumn | None = Field(
        description="rotation residual, axis times angle, along the base axes [deg]; null where "
        "the instrument measures no attitude"
    )


class Estimate(Part):
    """A number with its standard uncertainty."""

    value: float = Field(description="value")
    std: float | None = Field(description="standard uncertainty; null where it is not known")


class EffectParameter(Part):
    """An estimated parameter of an effect."""

    value: float = Field(description="value, in `unit`")
    std: float = Field(description="standard uncertainty, in `unit`")
    unit: str = Field(description="unit of `value` and `std`")


class Parameter(Part):
    """An estimated parameter of a model."""

    value: float = Field(description="value, in `unit`")
    std: float | None = Field(
        description="standard uncertainty, in `unit`; the tolerance where the data do not identify "
        "the parameter, null where it has none"
    )
    unit: str = Field(description="unit of `value`, `std` and `tolerance`")
    tolerance: float | None = Field(
        description="manufacturing tolerance, in `unit`; null where there is none"
    )
    identifiable: bool = Field(description="whether the data identify it")


Status = Literal["converged", "not converged"]
