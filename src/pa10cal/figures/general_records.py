"""The parts of a general model's calibration that pictures are drawn from."""

from __future__ import annotations

from typing import Annotated, Literal

from pa10cal.figures.records import (
    BY_NEWTON,
    Accuracy,
    AnyCalibration,
    Fit,
    LoadErrors,
    Record,
)


class GeneralParameter(Record):
    """A parameter with its standard uncertainty, None where the data leave it open."""

    value: float
    std: float | None
    unit: str
    tolerance: float | None
    identifiable: bool
    at_bound: bool


class GeneralErrors(LoadErrors):
    """Errors at one load, also of the model without springs."""

    geometry: Accuracy


class Redundant(Record):
    """A parameter left out, and those that say the same."""

    name: str
    said_by: dict[str, float]


class SuspectedOutlier(Record):
    """A pose far outside the scatter of the others."""

    pose: str
    load_N: float
    distance: float
    weight: float
    why: str


class Solved(Record):
    """What restores the model: the places of its targets, one after the other."""

    places_m: tuple[float, ...]


class GeneralCalibration(AnyCalibration):
    """`calibration/<load>.json` of the general model."""

    model: Literal["general"]
    parameters: dict[str, GeneralParameter]
    errors: Annotated[dict[str, GeneralErrors], BY_NEWTON]
    springs: tuple[int, ...]
    torques_from: str
    scatter: dict[str, float]
    redundant: tuple[Redundant, ...]
    suspected_outliers: tuple[SuspectedOutlier, ...]
    before_is: str
    geometry: Fit
    nominal: Fit
    solved: Solved

    @property
    def fits(self) -> dict[str, Fit]:
        """Return the whole fit, that without springs, and that of the frames alone."""
        return {"": self, "geometry": self.geometry, "nominal": self.nominal}
