"""The results of one campaign, read once for all pictures drawn from them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd

from pa10cal.arrays import Array
from pa10cal.campaign.description import CampaignDescription, read_description
from pa10cal.errors import RecordError
from pa10cal.evaluation.options import PictureOptions
from pa10cal.figures import published
from pa10cal.reports.results_bundle import POSES, ResultsBundle, is_synthetic
from pa10cal.results.analysis import AnalysisRecord
from pa10cal.results.calibration import (
    BaseFrameRecord,
    CalibrationRecord,
    GeneralCalibrationRecord,
    PaperCalibrationRecord,
)
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.evaluation import HoldoutRecord
from pa10cal.results.health import UNRESERVED
from pa10cal.results.record import Record
from pa10cal.results.studies import PlaneRecord

_R = TypeVar("_R", bound=Record)

COMBINED = "combined"
#: The general model beside the paper's.
GENERAL = "general"
#: What pictures call the models.
MODELS = {"paper": "paper's model", "general": "general model"}
_REMEDIES = {
    "paper": "draw the pictures of the general model, or calibrate with calibration.model: paper",
    "general": "run pa10cal calibrate --load general",
}
#: Where results are, by the names that pictures need them by.
FILES = {
    "papers_calibration": "calibration/combined.json",
    "general": "calibration/combined.json",
    "poses": "ingest/poses.parquet",
    "base_frame": "seed/base_frame.json",
    "planes": "montecarlo",
    "evaluation": "evaluation/holdout.json",
    "held_out": "evaluation/holdout.json",
    "analysis": "discovery/analysis.json",
    "verdict": "discovery/verdict.json",
}
#: Columns of the table of poses that hold the measured position of the end-effector.
PLACE_MM = ("ee_x_mm", "ee_y_mm", "ee_z_mm")
#: Longer provenances are cut after a sentence; a single letter ends none.
_MOST_LETTERS = 400
_SENTENCE_END = re.compile(r"(?<=[\w)]{3}\.)\s+(?=[A-Z])")


@dataclass(frozen=True)
class Results:
    """The results of one campaign as pictures may show them: what is doubtful is refused."""

    bundle: ResultsBundle  # its results folder, with the description of the campaign
    settings: PictureOptions  # what the pictures read of the settings
    force: bool = False  # whether calibrations are drawn whatever their grade, every picture marked

    @classmethod
    def of(
        cls, raw: Path, folder: Path, settings: PictureOptions, *, force: bool = False
    ) -> Results:
        """Return the results in a folder, of the campaign in a folder of raw files."""
        return cls(ResultsBundle(folder, COMBINED, read_description(raw)), settings, force)

    @property
    def folder(self) -> Path:
        """The folder, `<results_dir>/<campaign>`."""
        return self.bundle.folder

    @property
    def description(self) -> CampaignDescription:
        """What the campaign says of itself."""
        assert self.bundle.description is not None
        return self.bundle.description

    def lacks(self, need: str) -> str | None:
        """Say why a need of a picture is not met, None where it is.

        Args:
            need: a name of a result, or a property of the campaign.
        """
        if need == "analysis" and (verdict := self._not_sought):
            return f"effects were not sought: {verdict.why}"
        if not (self.folder / FILES[need]).exists():
            return f"there is no {FILES[need]}"
        if need == "papers_calibration" or (
            need == "general" and not (self.folder / "calibration/general.json").exists()
        ):
            model = self.any_calibration().model
            of = "general" if need == "general" else "paper"
            return None if model == of else f"calibrated with the {MODELS[model]}"
        if need == "held_out" and not self.held_out().models:
            return "no configuration was held out"
        return None

    @property
    def footer(self) -> str:
        """What a picture was drawn from: the provenance in its own words, the first of many.

        Pictures of a calibration that is drawn because of `force` alone are marked by its grade.
        """
        text, mark = self.description.provenance.strip(), ""
        if self.force and (self.folder / FILES["papers_calibration"]).exists():
            grade = self.any_calibration().health.grade
            mark = "" if grade in UNRESERVED else f" Grade of the calibration: {grade}."
        kind = " Synthetic data." if is_synthetic(text) else ""
        campaign = f"Campaign {self.description.name}.{mark}{kind}"
        return f"{campaign} Provenance: {_first_sentences(text)}"

    @property
    def is_paper_arm(self) -> bool:
        """Whether the arm is the paper's, so that parameters may stand beside its Table I."""
        return self.description.robot == published.ROBOT

    @property
    def _not_sought(self) -> VerdictRecord | None:
        """Return the verdict where it is that effects cannot be sought."""
        if not (self.folder / FILES["verdict"]).exists():
            return None
        found = self.bundle.read(VerdictRecord)
        return found if found.verdict == "not_sought" else None

    def published(self, parameter: str) -> float | None:
        """Return the paper's value of a parameter [SI], None where there is none to compare."""
        if not self.is_paper_arm:
            return None
        return published.parameter(parameter, self.settings.kcub_reading)

    def calibration(self, load: str = COMBINED) -> PaperCalibrationRecord:
        """Read `calibration/<load>.json` of the paper's model.

        Raises:
            RecordError: when it did not converge, or is of the general model.
        """
        return self._of_model(PaperCalibrationRecord, "paper", load)

    def general(self) -> GeneralCalibrationRecord:
        """Read the calibration of all loads with the general model.

        It is `calibration/combined.json`, or stands beside that of the paper's model.

        Raises:
            RecordError: when it did not converge, or is not of the general model.
        """
        load = COMBINED if self.any_calibration().model == "general" else GENERAL
        return self._of_model(GeneralCalibrationRecord, "general", load)

    def _of_model(self, kind: type[_R], model: str, load: str) -> _R:
        found = self.any_calibration(load)
        if isinstance(found, kind):
            return found
        raise RecordError(
            f"the picture is of the {MODELS[model]}",
            where=str(self.folder / "calibration" / f"{load}.json"),
            value=f"a calibration with the {MODELS[found.model]}",
            allowed=f"a calibration with the {MODELS[model]}",
            remedy=_REMEDIES[model],
        )

    def any_calibration(self, load: str = COMBINED) -> CalibrationRecord:
        """Read `calibration/<load>.json`, whatever the model.

        Raises:
            RecordError: when one of its fits did not converge, or its input is suspect.
        """
        name = f"calibration/{load}.json"
        path = self.folder / name
        found = self.bundle.read(CalibrationRecord, name)
        if self.force:
            return found
        for key, fit in found.fits.items():
            if fit.status != "converged":
                raise RecordError(
                    "the fit did not converge, so nothing is drawn of it",
                    where=f"{path}: {key}" if key else str(path),
                    value=f"{fit.status}: {fit.reason}",
                    allowed="a calibration whose status is converged",
                    remedy="allow more steps (calibration.max_iterations), free fewer parameters "
                    "or measure more poses, and run pa10cal calibrate again",
                )
        if found.health.grade not in UNRESERVED:
            raise RecordError(
                f"nothing is drawn of a calibration of grade {found.health.grade}",
                where=f"{path}: health",
                value=found.health.line,
                allowed="good, few_poses or incomplete",
                remedy="follow the remedy in the line, or draw it with --force",
            )
        return found

    def load_cases(self) -> dict[str, PaperCalibrationRecord]:
        """Read the calibration of each single load, by its key in `errors`: `0N`, `22N`, …."""
        loads = [f"{load:g}N" for load in self.calibration().loads_fitted]
        return {load: self.calibration(load) for load in loads}

    def held_out(self) -> HoldoutRecord:
        """Read `evaluation/holdout.json`, without an extended model that is the calibrated one.

        Raises:
            RecordError: when what was evaluated did not converge.
        """
        found = self.bundle.read(HoldoutRecord)
        self.any_calibration(found.calibration)
        if self._not_sought is None:
            return found
        models = {name: model for name, model in found.models.items() if name != "extended"}
        return found.model_copy(update={"models": models})

    def analysis(self) -> AnalysisRecord:
        """Read `discovery/analysis.json`; errors are those of `verdict`."""
        self.any_calibration(self.settings.evaluation.calibration)
        return self.bundle.read(AnalysisRecord)

    def verdict(self) -> VerdictRecord:
        """Read `discovery/verdict.json`.

        Raises:
            RecordError: when the calibration it began with did not converge.
        """
        self.any_calibration(self.settings.evaluation.calibration)
        return self.bundle.read(VerdictRecord)

    def base_frame(self) -> Array:
        """Read T_instr_base (4, 4) of `seed/base_frame.json` [m]."""
        return self.bundle.read(BaseFrameRecord).T_instr_base

    def planes(self) -> list[PlaneRecord]:
        """Read `montecarlo/z<mm>.json` for every plane of the settings, from low to high."""
        heights = sorted(set(self.settings.montecarlo.planes_mm))
        return [self.bundle.read(PlaneRecord, f"montecarlo/z{height}.json") for height in heights]

    def places(self) -> pd.DataFrame:
        """Read the table of poses in order of time, with the end-effector in `PLACE_MM`.

        Raises:
            RawDataError: when it cannot be used.
            RecordError: when it is missing, or the instrument measured no end-effector.
        """
        poses = self.bundle.poses
        absent = [] if poses is None else [name for name in PLACE_MM if name not in poses]
        if poses is None or absent:
            raise RecordError(
                "the table of poses has no column" if absent else "the table of poses is missing",
                where=str(self.folder / POSES),
                value=absent[0] if absent else None,
                allowed=f"a file that pa10cal ingest wrote, with {', '.join(PLACE_MM)}",
                remedy="run pa10cal ingest first",
            )
        return poses.sort_values("time_s")

    @cached_property
    def scatter(self) -> dict[str, Scatter]:
        """The scatter of repeats at each load that has some, by load as `0N`, `22N`, …."""
        return scatter_by_load(self.places())


def _first_sentences(text: str) -> str:
    """Return a text that ends with a full stop, cut after a sentence where it is long."""
    if len(text) <= _MOST_LETTERS:
        return f"{text.removesuffix('.')}."
    first, *others = _SENTENCE_END.split(text)
    for sentence in others:
        if len(first) + len(sentence) > _MOST_LETTERS:
            return f"{first.removesuffix('.')}. More in its campaign.yaml."
        first = f"{first} {sentence}"
    return f"{first.removesuffix('.')}."


# How much the repeats of one configuration scatter: the paper's repeatability.

#: A mean error up to so many times the scatter of averaged repeats may be scatter alone.
_COMPLETE_WITHIN = 3.0


@dataclass(frozen=True)
class Scatter:
    """Standard deviation of the measured position within one grid configuration, at one load.

    That of the distance: the root of the variances along three axes together.
    """

    largest_mm: float  # over the configurations
    mean_mm: float  # over the configurations
    # that of the average of a configuration's repeats, over the configurations
    mean_of_average_mm: float

    @property
    def largest_per_axis_mm(self) -> float:
        """Return the largest along one axis, nearest to the paper's scatter of a scalar error."""
        return float(self.largest_mm / np.sqrt(3.0))


def scatter_by_load(poses: pd.DataFrame) -> dict[str, Scatter]:
    """Return the scatter at each load with repeats, by load as `0N`, `22N`, ….

    Args:
        poses: the table of poses.
    """
    grid = poses[poses["kind"] == "grid"].groupby(["load_N", "pose"])
    count = grid.size()
    variance = grid[list(PLACE_MM)].var(ddof=1).sum(axis=1, skipna=False)
    found = pd.DataFrame({"std": np.sqrt(variance), "count": count})[count > 1]
    found["of_average"] = found["std"] / np.sqrt(found["count"])
    return {
        f"{load_N:g}N": Scatter(
            largest_mm=float(at["std"].max()),
            mean_mm=float(at["std"].mean()),
            mean_of_average_mm=float(at["of_average"].mean()),
        )
        for load_N, at in found.groupby(level="load_N")
    }


def incompleteness(case: PaperCalibrationRecord, scatter: dict[str, Scatter]) -> str | None:
    """Say that a calibrated model is incomplete, None where repeats do not show that it is.

    What a general model leaves is the scatter of averaged repeats, on which it was calibrated.

    Args:
        case: the calibration.
        scatter: of repeats, by load.
    """
    loads = [load for load in case.errors if load in scatter]
    if not loads:
        return None
    left_mm = np.mean([case.errors[load].after.mean_mm for load in loads])
    repeats_mm = np.mean([scatter[load].mean_of_average_mm for load in loads])
    if left_mm <= _COMPLETE_WITHIN * repeats_mm:
        return None
    times = f"{left_mm / repeats_mm:.0f}" if repeats_mm > 0.0 else "infinitely many"
    return (
        f"The remaining error is {times} times the scatter of averaged repeats: the model is "
        "incomplete, and ± does not cover the missing effect."
    )
