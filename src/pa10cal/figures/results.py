"""The results of one campaign, read and checked for the pictures drawn from them."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from pa10cal.errors import RawDataError
from pa10cal.figures import published
from pa10cal.figures.discovery_records import Analysis, Verdict
from pa10cal.figures.records import BaseFrame, Calibration, HeldOut, Plane, Record
from pa10cal.files import schemas
from pa10cal.settings import FigureSettings, MonteCarloSettings, Section

Array = NDArray[np.float64]

_R = TypeVar("_R", bound=Record)

COMBINED = "combined"
_POSES_SCHEMA = "pa10cal-poses/1"
#: How a provenance begins that tells of no measurement.
_SYNTHETIC = re.compile(r"(synthetic|simulated|virtual cell)\b", re.IGNORECASE)


class PictureSettings(Section):
    """The settings that pictures read."""

    figures: FigureSettings = FigureSettings()
    kcub_reading: Literal["text_e7", "table_e8"] = "text_e7"
    montecarlo: MonteCarloSettings = MonteCarloSettings()


@dataclass(frozen=True)
class Poses:
    """Measured configurations in order of time.

    Attributes:
        kind, pose: (N,) kind and label.
        load_N: (N,) external load.
        repeat: (N,) number of the repeat.
        p_cmm_mm: (N, 3) end-effector in the instrument's frame.
    """

    kind: NDArray[np.str_]
    pose: NDArray[np.str_]
    load_N: Array
    repeat: NDArray[np.int64]
    p_cmm_mm: Array


@dataclass(frozen=True)
class Results:
    """The results of one campaign.

    Attributes:
        folder: `<results_dir>/<campaign>`.
        campaign: name of the campaign.
        provenance: where its data come from, in its own words.
        robot: the arm it measured.
        instrument_uncertainty_mm: standard uncertainty of a measured centre, as it states.
        settings: what the pictures read of the settings.
    """

    folder: Path
    campaign: str
    provenance: str
    robot: str
    instrument_uncertainty_mm: float
    settings: PictureSettings

    @property
    def footer(self) -> str:
        """What a picture was drawn from: the provenance in its own words."""
        said = self.provenance.strip()
        kind = " Synthetic data." if _SYNTHETIC.match(said) else ""
        return f"Campaign {self.campaign}.{kind} Provenance: {said.removesuffix('.')}."

    @property
    def is_paper_arm(self) -> bool:
        """Whether the arm is the paper's, so that parameters may stand beside its Table I."""
        return self.robot == published.ROBOT

    def published(self, parameter: str) -> float | None:
        """Return the paper's value of a parameter [SI], None where there is none to compare."""
        if not self.is_paper_arm:
            return None
        return published.parameter(parameter, self.settings.kcub_reading)

    def calibration(self, load: str = COMBINED) -> Calibration:
        """Read `calibration/<load>.json`."""
        path = self.folder / "calibration" / f"{load}.json"
        return self._read(path, Calibration, schemas.CALIBRATION, "calibrate")

    def load_cases(self) -> dict[str, Calibration]:
        """Read the calibration of each single load, by its key in `errors`: `0`, `22`, ...."""
        loads = [f"{load:g}" for load in self.calibration().loads_fitted]
        return {load: self.calibration(f"{load}N") for load in loads}

    def held_out(self) -> HeldOut:
        """Read `evaluation/holdout.json`."""
        path = self.folder / "evaluation" / "holdout.json"
        return self._read(path, HeldOut, schemas.HOLDOUT, "evaluate")

    def analysis(self) -> Analysis:
        """Read `discovery/analysis.json`."""
        path = self.folder / "discovery" / "analysis.json"
        return self._read(path, Analysis, schemas.ANALYSIS, "discover")

    def verdict(self) -> Verdict:
        """Read `discovery/verdict.json`."""
        path = self.folder / "discovery" / "verdict.json"
        return self._read(path, Verdict, schemas.VERDICT, "discover")

    def base_frame(self) -> Array:
        """Read T_cmm_base (4, 4) of `seed/base_frame.json` [m]."""
        path = self.folder / "seed" / "base_frame.json"
        return np.array(self._read(path, BaseFrame, schemas.BASE_FRAME, "seed").T_cmm_base)

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
        """Read `ingest/poses.parquet`, in order of time."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = self.folder / "ingest" / "poses.parquet"
        place = ["ee_x_mm", "ee_y_mm", "ee_z_mm"]
        columns = ["kind", "pose", "load_N", "repeat", "time_s", *place]
        if not path.is_file():
            raise _missing(path, "ingest")
        try:
            table = pq.read_table(path, columns=columns)
        except (OSError, pa.ArrowException) as error:
            raise _foreign(path, " ".join(str(error).split()), _POSES_SCHEMA, "ingest") from None
        header = {k.decode(): v.decode() for k, v in (table.schema.metadata or {}).items()}
        self._check_header(path, header, _POSES_SCHEMA, "ingest")
        if absent := set(columns) - set(table.column_names):
            raise _foreign(path, f"no column {sorted(absent)[0]}", _POSES_SCHEMA, "ingest")
        rows = table.sort_by("time_s").to_pydict()
        return Poses(
            kind=np.array(rows["kind"], dtype=np.str_),
            pose=np.array(rows["pose"], dtype=np.str_),
            load_N=np.array(rows["load_N"], dtype=np.float64),
            repeat=np.array(rows["repeat"], dtype=np.int64),
            p_cmm_mm=np.column_stack([np.array(rows[name], dtype=np.float64) for name in place]),
        )

    def _read(self, path: Path, kind: type[_R], schema: str, stage: str) -> _R:
        """Read a JSON result of this campaign.

        Raises:
            RawDataError: when it is missing, is no such result, or is another campaign's.
        """
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise _missing(path, stage) from None
        except (OSError, ValueError) as error:
            raise _foreign(path, str(error), schema, stage) from None
        self._check_header(path, content if isinstance(content, dict) else {}, schema, stage)
        try:
            return kind.model_validate(content)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"])
            raise _foreign(path, f"{key}: {first['msg']}", schema, stage) from None

    def _check_header(self, path: Path, header: dict[str, object], schema: str, stage: str) -> None:
        if header.get("schema") != schema:
            raise _foreign(path, header.get("schema", "no schema"), schema, stage)
        if header.get("campaign") != self.campaign:
            raise RawDataError(
                "the result is another campaign's",
                where=str(path),
                value=header.get("campaign"),
                allowed=self.campaign,
                remedy="give the campaign's own --results-dir, or run its stages again",
            )


def _missing(path: Path, stage: str) -> RawDataError:
    return RawDataError(
        "a result that the picture is drawn from is missing",
        where=str(path),
        allowed=f"a file that the {stage} stage wrote",
        remedy=f"run the {stage} stage first",
    )


def _foreign(path: Path, value: object, schema: str, stage: str) -> RawDataError:
    return RawDataError(
        "the result cannot be read",
        where=str(path),
        value=value,
        allowed=f"a file of schema {schema} that the {stage} stage wrote",
        remedy=f"run the {stage} stage again",
    )
