"""What the stage `curve_calibration` wrote, as far as pictures are drawn from it."""

from __future__ import annotations

from pathlib import Path

from pa10cal.figures.record_files import read_study
from pa10cal.figures.records import Record, Vector
from pa10cal.files.schemas import CURVE_CALIBRATION

#: Models as pictures call them.
MODELS = {
    "two_level": "two-level (paper)",
    "two_level_all": "two-level, all poses inside",
    "general": "general",
}
#: How individuals depart, in short.
DEPARTS = {"rows": "by its rows", "any_way": "in any way"}


class AskedFor(Record):
    """The part of the settings that pictures show."""

    links: int
    link_m: float
    postures: int
    holdout_share: float
    position_mm: float
    attitude_rad: float


class OverFloor(Record):
    """Mean errors of all individuals over the noise floor."""

    mean: float
    largest: float
    within_bar: int


class Summary(Record):
    """What became of all individuals that depart alike, with one model."""

    departs: str
    model: str
    individuals: int
    converged: int
    unknowns: int
    rank: int
    null_directions: tuple[dict[str, float], ...]
    rms_score: float | None
    fitted: OverFloor
    held_out: OverFloor
    held_out_true: OverFloor


class Errors(Record):
    """Position errors over some poses."""

    mean_mm: float
    peak_mm: float
    rms_mm: float


class ErrorsOf(Record):
    """Errors of one model of one individual."""

    fitted: Errors
    held_out: Errors
    held_out_true: Errors


class Fit(Record):
    """A calibrated model of one individual."""

    scores: dict[str, float]
    left_out: dict[str, dict[str, float]]


class Poses(Record):
    """Position error of every pose, model by model [mm]."""

    held_out: tuple[bool, ...]
    nominal_mm: tuple[float, ...]
    two_level_mm: tuple[float, ...]
    general_mm: tuple[float, ...]


class Individual(Record):
    """One arm, calibrated."""

    number: int
    departs: str
    errors: dict[str, ErrorsOf]
    models: dict[str, Fit]
    poses: Poses


class Postures(Record):
    """Where the links of the first individual join in every pose, in its base frame [m]."""

    shape: tuple[str, ...]
    p_m: tuple[tuple[Vector, ...], ...]


class CurveStudy(Record):
    """The record of the study."""

    provenance: str
    settings: AskedFor
    joints: int
    noise_floor_mm: float
    bar: float
    summaries: tuple[Summary, ...]
    individuals: tuple[Individual, ...]
    postures_of_first: Postures

    @property
    def name(self) -> str:
        """What messages call it."""
        return "chain along curves"

    @property
    def footer(self) -> str:
        """What a picture was drawn from."""
        asked = self.settings
        return (
            f"{self.summaries[0].individuals} arms of {asked.links} links of {asked.link_m:g} m "
            f"each way, {asked.postures} postures each, noise {asked.position_mm:g} mm and "
            f"{1e3 * asked.attitude_rad:g} mrad. Synthetic data. Provenance: {self.provenance}."
        )


def read_curve_study(path: Path) -> CurveStudy:
    """Read the record of the study.

    Raises:
        RecordError: when the file is missing or is no such record.
    """
    return read_study(
        path, CurveStudy, CURVE_CALIBRATION, "calibration of the chain", "curve_calibration"
    )
