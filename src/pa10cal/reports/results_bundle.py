"""Reads the results folder of a campaign: each result once, and why others are missing."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

from pa10cal.campaign.description import CampaignDescription, read_description
from pa10cal.campaign.table import read_pose_table
from pa10cal.command_settings import PictureOptions
from pa10cal.errors import RecordError, last_message
from pa10cal.input_files import is_file, read_csv, read_file, reason
from pa10cal.observe.kinds import instrument_of
from pa10cal.observe.quantities import Words
from pa10cal.results.analysis import AnalysisRecord
from pa10cal.results.calibration import (
    UNRESERVED,
    BaseFrameRecord,
    CalibrationRecord,
    GeneralCalibrationRecord,
    PaperCalibrationRecord,
)
from pa10cal.results.codec import read, schema_of
from pa10cal.results.discovery import ExtendedRecord, VerdictRecord
from pa10cal.results.evaluation import HoldoutRecord, Iso9283Record
from pa10cal.results.montecarlo import PlaneNotStudied, PlaneRecord
from pa10cal.results.outcomes import PicturesRecord
from pa10cal.results.record import CampaignRecord, MeasuredRecord, Record

if TYPE_CHECKING:
    import pandas as pd

_R = TypeVar("_R", bound=Record)

#: Larger files are neither listings of rows nor logs of a stage [bytes].
_MOST_TEXT_BYTES = 64_000_000
POSES = "ingest/poses.parquet"
MODEL = "model/model.yaml"
#: Load cases: all loads, and all loads with the general model, beside the paper's model.
COMBINED, GENERAL = "combined", "general"
#: Stands between a stage and its message, where that is why a result is missing.
REFUSED = " refused: "
#: Results of a whole run: file, in which `{}` is the load case, and the command that writes it.
_OF_A_RUN = {
    "poses": (POSES, "ingest"),
    "base_frame": (BaseFrameRecord.FILE, "seed"),
    "calibration": ("calibration/{}.json", "calibrate"),
    "verdict": (VerdictRecord.FILE, "discover"),
    "analysis": (AnalysisRecord.FILE, "discover"),
    "extended": (ExtendedRecord.FILE, "discover"),
    "held_out": (HoldoutRecord.FILE, "evaluate"),
    "iso9283": (Iso9283Record.FILE, "evaluate"),
    "model": (MODEL, "export"),
}
#: Names of the logs of commands whose rule has another name.
_LOGS = {"seed": "base_frame"}
#: Beginning of the provenance of simulated data.
_SYNTHETIC = re.compile(r"\W*(synthetic|simulated|virtual cell)\b", re.IGNORECASE)
#: Models in messages, and the remedy where a calibration is with the other model.
MODEL_NAMES = {"paper": "paper's model", "general": "general model"}
_OTHER_MODEL = {
    "paper": "draw the pictures of the general model, or calibrate with calibration.model: paper",
    "general": "run pa10cal calibrate --load general",
}


class Output(NamedTuple):
    """A file or folder of results that is meant for the reader."""

    path: str  # in the folder of results
    title: str  # as a run prints it at its end; empty where it does not
    holds: str  # what the page says that it holds; empty where it says nothing

    def has_content(self, results: Path) -> bool:
        """Return whether it is among some results: a folder with files, a table with rows."""
        path = results / self.path
        if path.is_dir():
            return any(not each.name.startswith(".") for each in path.iterdir())
        if path.suffix != ".csv" or not path.exists():
            return path.exists()
        if not is_file(path, results):
            return False
        return len(list(islice(read_csv(path, path.stat().st_size, results), 2))) > 1


_UR_DRIVER, _UR_CONTROLLER = "model/ur_kinematics.yaml", "model/ur_calibration.conf"
OUTPUTS = (
    Output("report.html", "report", ""),
    Output(MODEL, "model", "the whole model, with effects and formulas; read by the commands"),
    Output("model/model.covariance.npz", "", "how uncertain its parameters are"),
    Output("model/robot.urdf", "URDF", "the rigid part, for simulators and planners"),
    Output("model/robot_rigid_fit.urdf", "", "the best rigid model: geometry alone, fitted for it"),
    Output("model/dh.csv", "table of link parameters", "link parameters, nominal and calibrated"),
    Output(_UR_DRIVER, "kinematics of the UR driver", "the rigid part for the UR driver for ROS 2"),
    Output(_UR_CONTROLLER, "", "the rigid part for the controller of a UR"),
    Output("figures", "figures", "figures as SVG, PDF and PNG"),
    Output("tables", "tables", "tables as CSV and Markdown"),
    Output("ingest/quarantine.csv", "rows not used", "raw rows that are not used, with the reason"),
    Output("discovery/suggested_poses.csv", "poses to measure next", "poses to measure next"),
)


def is_synthetic(provenance: str) -> bool:
    """Return whether the words on the origin of data begin by saying that they are simulated."""
    return _SYNTHETIC.match(provenance) is not None


def _record(kind: type[_R], file: str | None = None) -> Callable[[ResultsBundle], _R | None]:
    """Return a function that reads a record of a results folder; None if it is not there."""

    def read_if_there(results: ResultsBundle) -> _R | None:
        there = (results.folder / (file or kind.FILE)).exists()
        return results.read(kind, file) if there else None

    return read_if_there


@dataclass(frozen=True)
class ResultsBundle:
    """The results of one campaign, each read when it is first used.

    Attributes are None where a result is not there, and hold results of any grade: the page states
    it. Methods are for pictures, which do not state it: they refuse a result that is missing, or
    that rests on a calibration that did not converge or has a grade with which it is not used.
    """

    folder: Path  # `<results_dir>/<campaign>`
    load_case: str = COMBINED  # calibration that was evaluated: `combined`, or a load
    # description of the campaign; None where the folder of its raw files is not given
    description: CampaignDescription | None = None
    # what pictures read of the settings
    settings: PictureOptions = field(default_factory=PictureOptions)
    force: bool = False  # whether calibrations are drawn whatever their grade
    _records: dict[str, Record] = field(default_factory=dict, init=False, repr=False, compare=False)

    def read(self, kind: type[_R], file: str | None = None) -> _R:
        """Return a record, which must be of the campaign described, if one is; see `codec.read`.

        Args:
            kind: its type.
            file: path in the folder; by default that of the type.
        """
        name = file or kind.FILE
        if name not in self._records:
            self._records[name] = read(kind, self.folder / name, self._described, self.folder)
        return cast(_R, self._records[name])

    @property
    def _described(self) -> str | None:
        return None if self.description is None else self.description.name

    base_frame = cached_property(_record(BaseFrameRecord))  # before calibration
    verdict = cached_property(_record(VerdictRecord))
    analysis = cached_property(_record(AnalysisRecord))  # what the search for effects saw
    extended = cached_property(_record(ExtendedRecord))  # the model with the effects found
    held_out = cached_property(_record(HoldoutRecord))  # errors of held-out poses
    iso9283 = cached_property(_record(Iso9283Record))  # accuracy and repeatability
    pictures = cached_property(_record(PicturesRecord))  # which were drawn, with their captions

    @cached_property
    def calibration(self) -> CalibrationRecord | None:
        """The calibration that was evaluated."""
        return _record(CalibrationRecord, f"calibration/{self.load_case}.json")(self)

    @cached_property
    def general_beside(self) -> GeneralCalibrationRecord | None:
        """The calibration of the general model beside that of the paper's."""
        found = _record(CalibrationRecord, f"calibration/{GENERAL}.json")(self)
        return found if isinstance(found, GeneralCalibrationRecord) else None

    @cached_property
    def planes(self) -> list[PlaneRecord]:
        """The planes of the Monte Carlo that were studied, from low to high."""
        return [plane for plane in self._planes_there if isinstance(plane, PlaneRecord)]

    @cached_property
    def planes_not_studied(self) -> list[PlaneNotStudied]:
        """Those that are not for this arm, from low to high."""
        return [plane for plane in self._planes_there if isinstance(plane, PlaneNotStudied)]

    @cached_property
    def _planes_there(self) -> list[PlaneRecord | PlaneNotStudied]:
        files = (self.folder / "montecarlo").glob("z*.json")
        planes = [self._plane(f"montecarlo/{path.name}") for path in files]
        return sorted(planes, key=lambda plane: plane.plane_mm)

    def _plane(self, file: str) -> PlaneRecord | PlaneNotStudied:
        if schema_of(self.folder / file) == PlaneNotStudied.SCHEMA:
            return self.read(PlaneNotStudied, file)
        return self.read(PlaneRecord, file)

    @cached_property
    def poses(self) -> pd.DataFrame | None:
        """The table of poses."""
        path = self.folder / POSES
        if not os.path.lexists(path):
            return None
        return read_pose_table(path, self._described, self.folder)

    @property
    def model(self) -> Path | None:
        """The model to take away."""
        path = self.folder / MODEL
        return path if path.exists() else None

    @cached_property
    def quarantined(self) -> Mapping[str, int]:
        """How many raw rows are not used, by reason, the most frequent first."""
        path = self.folder / "ingest/quarantine.csv"
        if not os.path.lexists(path):
            return {}
        counts: Counter[str] = Counter()
        try:
            rows = [row for _, row in read_csv(path, _MOST_TEXT_BYTES, self.folder)]
            header = rows[0] if rows else []
            column = header.index("reason") if "reason" in header else len(header)
            for row in rows[1:]:
                reason_given = row[column] if column < len(row) else ""
                counts[reason_given or "no reason given"] += 1
        except (OSError, ValueError) as error:
            raise RecordError(
                f"the listing of rows that are not used cannot be read: {reason(error)}",
                where=str(path),
                allowed="quarantine.csv as pa10cal ingest writes it",
                remedy="run pa10cal ingest again",
            ) from None
        return dict(counts.most_common())

    @cached_property
    def _own_records(self) -> tuple[CampaignRecord, ...]:
        every = (getattr(self, name) for name in _OF_A_RUN if name not in ("poses", "model"))
        return tuple(each for each in (*every, self.general_beside) if each is not None)

    @cached_property
    def campaign(self) -> str:
        """Return the name of the campaign that all results are of."""
        names = {record.campaign for record in self._own_records}
        names |= set() if self.poses is None else {str(self.poses.attrs["campaign"])}
        names |= set() if self.description is None else {self.description.name}
        if len(names) > 1:
            raise RecordError(
                "results of several campaigns in one folder",
                where=str(self.folder),
                value=", ".join(sorted(names)),
                allowed="the results of one campaign, and its own raw files",
                remedy="run pa10cal run again, into a folder of its own",
            )
        return names.pop() if names else self.folder.absolute().name

    @cached_property
    def provenance(self) -> str | None:
        """Where the data come from, in the campaign's words; None where no result states it."""
        for record in self._own_records:
            if isinstance(record, MeasuredRecord):
                return record.provenance
        return None if self.description is None else self.description.provenance

    @property
    def synthetic(self) -> bool:
        """Whether the campaign's own words say that its data were simulated."""
        return self.provenance is not None and is_synthetic(self.provenance)

    @property
    def sliding_joints(self) -> frozenset[int]:
        """Return the numbers, from 1, of joints that slide; none where nothing is calibrated."""
        fitted: Any = {} if self.calibration is None else self.calibration.fitted_model
        rows = fitted.get("arm", {}).get("rows", ())
        return frozenset(number for number, row in enumerate(rows, start=1) if row["prismatic"])

    @property
    def words(self) -> Words | None:
        """Return how to speak of the instrument's errors; None where it is not known."""
        kind: object = None if self.description is None else self.description.instrument_kinds
        if kind is None and self.calibration is not None:
            fitted_to = self.calibration.fitted_model.get("fitted_to")
            kind = fitted_to.get("instrument") if isinstance(fitted_to, dict) else None
        instrument = instrument_of(str(kind))
        return None if instrument is None else instrument.words

    @cached_property
    def absent(self) -> Mapping[str, str]:
        """Why each missing result of a whole run is missing, and what to do about it.

        The reason is the message of its stage, if the log of the stage has one.
        """
        reasons = {}
        for name, (pattern, command) in _OF_A_RUN.items():
            file = pattern.format(self.load_case)
            if (self.folder / file).exists():
                continue
            log = self.folder / f"logs/{_LOGS.get(command, command)}.log"
            if (message := last_message(self._text_of(log))) is not None:
                reasons[name] = f"pa10cal {command}{REFUSED}{message[1]}. Then run it again."
            else:
                reasons[name] = (
                    f"There is no {file}: pa10cal {command} was not run, or did not come to its "
                    "end. pa10cal run makes it."
                )
        return reasons

    def _text_of(self, log: Path) -> str:
        """Return what a stage printed; empty where that cannot be read."""
        try:
            return read_file(log, _MOST_TEXT_BYTES, self.folder).decode("utf-8", errors="replace")
        except OSError:
            return ""

    # What pictures are drawn from.

    def sound_calibration(self, load: str = COMBINED) -> CalibrationRecord:
        """Read `calibration/<load>.json`, whatever the model.

        Raises:
            RecordError: when one of its fits did not converge, or its grade is not to be used.
        """
        name = f"calibration/{load}.json"
        path = self.folder / name
        record = self.read(CalibrationRecord, name)
        if self.force:
            return record
        for key, fit in record.fits.items():
            if fit.status != "converged":
                where = f"{path}: {key}" if key else str(path)
                raise RecordError(
                    "the fit did not converge, so nothing is drawn of it",
                    where=where,
                    value=f"{fit.status}: {fit.reason}",
                    allowed="a calibration whose status is converged",
                    remedy="allow more steps (calibration.max_iterations), free fewer parameters "
                    "or measure more poses, and run pa10cal calibrate again",
                )
        if record.health.grade not in UNRESERVED:
            raise RecordError(
                f"nothing is drawn of a calibration of grade {record.health.grade}",
                where=f"{path}: health",
                value=record.health.line,
                allowed="good, few_poses or incomplete",
                remedy="follow the remedy in the line, or draw it with --force",
            )
        return record

    def paper_calibration(self, load: str = COMBINED) -> PaperCalibrationRecord:
        """Read `calibration/<load>.json` of the paper's model.

        Raises:
            RecordError: when it did not converge, or is of the general model.
        """
        return self._of_model(PaperCalibrationRecord, "paper", load)

    def general_calibration(self) -> GeneralCalibrationRecord:
        """Read the calibration of all loads with the general model.

        It is `calibration/combined.json`, or stands beside that of the paper's model.

        Raises:
            RecordError: when it did not converge, or is not of the general model.
        """
        combined_is_general = self.sound_calibration().model == "general"
        load = COMBINED if combined_is_general else GENERAL
        return self._of_model(GeneralCalibrationRecord, "general", load)

    def _of_model(self, kind: type[_R], model: str, load: str) -> _R:
        record = self.sound_calibration(load)
        if isinstance(record, kind):
            return record
        raise RecordError(
            f"the picture is of the {MODEL_NAMES[model]}",
            where=str(self.folder / f"calibration/{load}.json"),
            value=f"a calibration with the {MODEL_NAMES[record.model]}",
            allowed=f"a calibration with the {MODEL_NAMES[model]}",
            remedy=_OTHER_MODEL[model],
        )

    def load_cases(self) -> dict[str, PaperCalibrationRecord]:
        """Read the calibration of each single load that has one, by its key in `errors`: `22N`."""
        combined = self.paper_calibration()
        names = [f"{N:g}N" for N in combined.loads_fitted]
        left_out = combined.loads_left_out or {}
        return {name: self.paper_calibration(name) for name in names if name not in left_out}

    def sound_record(self, kind: type[_R]) -> _R:
        """Read what discovery found, of a sound calibration: the evaluated one."""
        self.sound_calibration(self.settings.evaluation.calibration)
        return self.read(kind)

    def sound_held_out(self) -> HoldoutRecord:
        """Read errors of held-out poses; without those of an extended model if none was sought."""
        record = self.read(HoldoutRecord)
        self.sound_calibration(record.calibration)
        if self.verdict is None or self.verdict.verdict != "not_sought":
            return record
        models = {name: model for name, model in record.models.items() if name != "extended"}
        return record.model_copy(update={"models": models})

    @property
    def plane_files(self) -> list[str]:
        """Return the file of every plane of the settings, from low to high."""
        return [
            f"montecarlo/z{z_mm}.json" for z_mm in sorted(set(self.settings.montecarlo.planes_mm))
        ]

    def planes_of_settings(self) -> list[PlaneRecord]:
        """Read the Monte Carlo of every plane of the settings that was studied, low to high."""
        planes = map(self._plane, self.plane_files)
        return [plane for plane in planes if isinstance(plane, PlaneRecord)]


def results_bundle(
    folder: Path, load_case: str = COMBINED, campaign_dir: Path | None = None
) -> ResultsBundle:
    """Return the results in a folder of one campaign.

    Args:
        folder: `<results_dir>/<campaign>`.
        load_case: the calibration that was evaluated.
        campaign_dir: folder of the campaign's raw files; None to do without.

    Raises:
        RecordError: when the folder holds no results of a campaign, results of several, or a file
            that cannot be read.
        RawDataError: when the folder of raw files, or the table of poses, cannot be used.
    """
    bundle = ResultsBundle(folder, load_case)
    if len(bundle.absent) == len(_OF_A_RUN):
        raise RecordError(
            "no results of a campaign",
            where=str(folder),
            value=None if folder.is_dir() else "no such folder",
            allowed="RESULTS_DIR/CAMPAIGN as pa10cal run leaves it",
            remedy="give such a folder, or run pa10cal run first",
        )
    if campaign_dir is None:
        return bundle
    return replace(bundle, description=read_description(campaign_dir))
