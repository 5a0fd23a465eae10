"""The results of one campaign, read and checked for the pictures drawn from them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.campaign.description import read_campaign
from pa10cal.errors import RecordError
from pa10cal.figures import published
from pa10cal.figures.discovery_records import Analysis, Verdict
from pa10cal.figures.general_records import GeneralCalibration
from pa10cal.figures.options import PictureOptions
from pa10cal.figures.poses import JointPositions, Poses, read_joints, read_poses
from pa10cal.figures.record_files import as_record, check_converged, read_content
from pa10cal.figures.records import BaseFrame, Calibration, HeldOut, Plane, Record
from pa10cal.files import schemas
from pa10cal.files.arms import load_arm
from pa10cal.observe.registry import instruments

Array = NDArray[np.float64]

_R = TypeVar("_R", bound=Record)
_T = TypeVar("_T")

COMBINED = "combined"
#: Where results are, by the names that pictures need them by.
_FILES = {
    "calibration": "calibration/combined.json",
    "papers_calibration": "calibration/combined.json",
    "general_calibration": "calibration/combined.json",
    "general": "calibration/combined.json",
    "poses": "ingest/poses.parquet",
    "base_frame": "seed/base_frame.json",
    "planes": "montecarlo",
    "evaluation": "evaluation/holdout.json",
    "held_out": "evaluation/holdout.json",
    "analysis": "discovery/analysis.json",
    "verdict": "discovery/verdict.json",
}
_MODELS = {"paper": "paper's model", "general": "general model"}
#: The general model beside the paper's.
GENERAL = "general"
#: Longer provenances are cut after a sentence; a single letter ends none.
_MOST_LETTERS = 400
_SENTENCE_END = re.compile(r"(?<=[\w)]{3}\.)\s+(?=[A-Z])")
#: How a provenance begins that tells of no measurement.
_SYNTHETIC = re.compile(r"(synthetic|simulated|virtual cell)\b", re.IGNORECASE)


@dataclass(frozen=True)
class Results:
    """The results of one campaign.

    Attributes:
        folder: `<results_dir>/<campaign>`.
        raw: folder of its raw files, which may describe its arm.
        campaign: name of the campaign.
        provenance: where its data come from, in its own words.
        robot: the arm it measured.
        instrument: kind of the instrument that measured it.
        instrument_uncertainty_mm: standard uncertainty of a measured centre, as it states.
        settings: what the pictures read of the settings.
    """

    folder: Path
    raw: Path
    campaign: str
    provenance: str
    robot: str
    instrument: str
    instrument_uncertainty_mm: float
    settings: PictureOptions
    _read_once: dict[object, object] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @classmethod
    def of(cls, raw: Path, folder: Path, settings: PictureOptions) -> Results:
        """Return the results in a folder, of the campaign in a folder of raw files."""
        campaign = read_campaign(raw)
        return cls(
            folder=folder,
            raw=raw,
            campaign=campaign.name,
            provenance=campaign.provenance,
            robot=campaign.robot,
            instrument=campaign.instrument.kind,
            instrument_uncertainty_mm=campaign.instrument.uncertainty_mm,
            settings=settings,
        )

    @property
    def name(self) -> str:
        """What messages call it."""
        return self.campaign

    def lacks(self, need: str) -> str | None:
        """Say why a need of a picture is not met, None where it is.

        Args:
            need: a name of a result, or a property of the campaign.
        """
        if need == "gap":  # of the poses fitted, also where no effects are sought
            return self.lacks("analysis" if self.seeks_effects else "calibration")
        path = self.folder / _FILES.get(need, "")
        if not path.exists():
            return f"there is no {_FILES[need]}"
        if need in ("papers_calibration", "general_calibration"):
            model = self.any_calibration().model
            return None if need.startswith(model) else f"calibrated with the {_MODELS[model]}"
        if need == "general" and not (self.folder / "calibration/general.json").exists():
            return self.lacks("general_calibration")
        if need == "planes" and not list(path.glob("z*.json")):
            return "there is no Monte Carlo"
        if need == "held_out" and not self.held_out().models:
            return "no configuration was held out"
        if need == "positions" and not instruments()[self.instrument].directional:
            return "a distance alone does not show where the arm is"
        return None

    @property
    def footer(self) -> str:
        """What a picture was drawn from: the provenance in its own words, the first of many."""
        said = self.provenance.strip()
        kind = " Synthetic data." if _SYNTHETIC.match(said) else ""
        return f"Campaign {self.campaign}.{kind} Provenance: {_first_sentences(said)}"

    @property
    def is_paper_arm(self) -> bool:
        """Whether the arm is the paper's, so that parameters may stand beside its Table I."""
        return self.robot == published.ROBOT

    @property
    def seeks_effects(self) -> bool:
        """Whether effects can be sought in campaigns of this instrument."""
        return instruments()[self.instrument].measures_pose

    def published(self, parameter: str) -> float | None:
        """Return the paper's value of a parameter [SI], None where there is none to compare."""
        if not self.is_paper_arm:
            return None
        return published.parameter(parameter, self.settings.kcub_reading)

    def calibration(self, load: str = COMBINED) -> Calibration:
        """Read `calibration/<load>.json` of the paper's model.

        Raises:
            RecordError: when it did not converge, or is of the general model.
        """
        found = self.any_calibration(load)
        if isinstance(found, Calibration):
            return found
        raise RecordError(
            "the picture is of the paper's model",
            where=str(self._calibration_path(load)),
            value=f"a calibration with the {found.model} model",
            allowed="a campaign calibrated with the paper's model",
            remedy="draw the pictures of the general model, or calibrate with "
            "calibration.model: paper",
        )

    def general(self) -> GeneralCalibration:
        """Read the calibration of all loads with the general model.

        It is `calibration/combined.json`, or stands beside that of the paper's model.

        Raises:
            RecordError: when it did not converge, or is not of the general model.
        """
        found = self.any_calibration()
        if not isinstance(found, GeneralCalibration):
            found = self.any_calibration(GENERAL)
        if isinstance(found, GeneralCalibration):
            return found
        raise RecordError(
            "the picture is of the general model",
            where=str(self._calibration_path(GENERAL)),
            value=f"a calibration with the {found.model}'s model",
            allowed="a calibration with the general model",
            remedy="run the calibrate stage with --load general",
        )

    def chain(self) -> Chain:
        """Return the chain of the nominal arm."""
        return Chain.of(load_arm(self.robot, self.raw))

    def any_calibration(self, load: str = COMBINED) -> Calibration | GeneralCalibration:
        """Read `calibration/<load>.json`, whatever the model.

        Raises:
            RecordError: when one of its fits did not converge.
        """
        path = self._calibration_path(load)
        found = self._once(path, lambda: self._read_calibration(path))
        check_converged(path, found)
        return found

    def _read_calibration(self, path: Path) -> Calibration | GeneralCalibration:
        schema, stage = schemas.CALIBRATION, "calibrate"
        content = read_content(path, schema, stage, self.campaign)
        if content.get("model") == "general":
            return as_record(content, GeneralCalibration, path, schema, stage)
        return as_record(content, Calibration, path, schema, stage)

    def calibrations(self) -> tuple[Calibration | GeneralCalibration, ...]:
        """Read the calibrations of all loads: one, or the paper's and the general one beside."""
        combined = self.any_calibration()
        return (combined, self.general()) if isinstance(combined, Calibration) else (combined,)

    def load_cases(self) -> dict[str, Calibration]:
        """Read the calibration of each single load, by its key in `errors`: `0`, `22`, ...."""
        loads = [f"{load:g}" for load in self.calibration().loads_fitted]
        return {load: self.calibration(f"{load}N") for load in loads}

    def held_out(self) -> HeldOut:
        """Read `evaluation/holdout.json`.

        Raises:
            RecordError: when what was evaluated did not converge.
        """
        path = self.folder / "evaluation" / "holdout.json"
        found = self._read(path, HeldOut, schemas.HOLDOUT, "evaluate")
        self.any_calibration(found.calibration)
        return found

    def analysis(self) -> Analysis:
        """Read `discovery/analysis.json`.

        Raises:
            RecordError: when the calibration it began with did not converge.
        """
        return self._discovered("analysis", Analysis, schemas.ANALYSIS)

    def verdict(self) -> Verdict:
        """Read `discovery/verdict.json`.

        Raises:
            RecordError: when the calibration it began with did not converge.
        """
        return self._discovered("verdict", Verdict, schemas.VERDICT)

    def base_frame(self) -> Array:
        """Read T_instr_base (4, 4) of `seed/base_frame.json` [m]."""
        path = self.folder / "seed" / "base_frame.json"
        return np.array(self._read(path, BaseFrame, schemas.BASE_FRAME, "seed").T_instr_base)

    def planes(self) -> list[Plane]:
        """Read `montecarlo/z<mm>.json` for every plane of the settings, from low to high."""
        return [
            self._read(
                self.folder / "montecarlo" / f"z{plane_mm}.json",
                Plane,
                schemas.MONTECARLO,
                "montecarlo",
            )
            for plane_mm in sorted(set(self.settings.montecarlo.planes_mm))
        ]

    def poses(self) -> Poses:
        """Read the end-effector's places of `ingest/poses.parquet`, in order of time."""
        return self._once("poses", lambda: read_poses(self._poses_path, self.campaign))

    def joints(self) -> JointPositions:
        """Read the joint positions of `ingest/poses.parquet`, in order of time."""
        return self._once("joints", lambda: read_joints(self._poses_path, self.campaign))

    @property
    def _poses_path(self) -> Path:
        return self.folder / "ingest" / "poses.parquet"

    def _calibration_path(self, load: str) -> Path:
        return self.folder / "calibration" / f"{load}.json"

    def _discovered(self, name: str, kind: type[_R], schema: str) -> _R:
        found = self._read(self.folder / "discovery" / f"{name}.json", kind, schema, "discover")
        self.any_calibration(self.settings.evaluation.calibration)
        return found

    def _read(self, path: Path, kind: type[_R], schema: str, stage: str) -> _R:
        def read() -> _R:
            content = read_content(path, schema, stage, self.campaign)
            return as_record(content, kind, path, schema, stage)

        return self._once(path, read)

    def _once(self, key: object, read: Callable[[], _T]) -> _T:
        """Return what was read under a key, reading it the first time."""
        if key not in self._read_once:
            self._read_once[key] = read()
        return cast(_T, self._read_once[key])


def _first_sentences(said: str) -> str:
    """Return a text that ends with a full stop, cut after a sentence where it is long."""
    if len(said) <= _MOST_LETTERS:
        return f"{said.removesuffix('.')}."
    first, *others = _SENTENCE_END.split(said)
    for sentence in others:
        if len(first) + len(sentence) > _MOST_LETTERS:
            return f"{first.removesuffix('.')}. More in its campaign.yaml."
        first = f"{first} {sentence}"
    return f"{first.removesuffix('.')}."
