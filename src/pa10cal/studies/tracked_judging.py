"""From the folder of a tracker's campaign to a verdict, by the commands that a user runs."""

from __future__ import annotations

import io
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.campaign.description import read_description
from pa10cal.commands.calibrate import calibrate
from pa10cal.commands.discover import discover
from pa10cal.commands.ingest import ingest
from pa10cal.commands.seed import seed
from pa10cal.evaluation.options import JudgingOptions
from pa10cal.results.calibration import GeneralCalibrationRecord
from pa10cal.results.codec import read
from pa10cal.results.discovery import VerdictKeys, VerdictRecord
from pa10cal.results.trials import JudgedTrialRecord

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackedCampaign:
    """A campaign of a tracker, ingested and calibrated with the general model.

    Attributes:
        raw: folder of raw files.
        work: folder of what the commands wrote.
        name: of the campaign.
        seconds: that this took.
        options: by which it is judged.
    """

    raw: Path
    work: Path
    name: str
    seconds: float
    options: JudgingOptions

    @property
    def calibration(self) -> GeneralCalibrationRecord:
        """Return the calibrated model."""
        return read(GeneralCalibrationRecord, self.work / "calibration.json", self.name)

    @property
    def residual_mm(self) -> Array:
        """Return the calibrated model's residual at the poses fitted, along base axes, (C, 3)."""
        return self.calibration.residuals.position_mm

    def verdict(self, seconds_simulating: float) -> JudgedTrialRecord:
        """Return the verdict; see `TouchedCampaign.verdict`."""
        began = time.perf_counter()
        with _silent():
            discover(
                campaign_dir=self.raw,
                poses=self.work / "poses.parquet",
                calibration=self.work / "calibration.json",
                verdict=self.work / "verdict.json",
                analysis=self.work / "analysis.json",
                extended=self.work / "extended.json",
                suggested=self.work / "suggested.csv",
                settings=self.options.discovery,
            )
        found = read(VerdictRecord, self.work / "verdict.json", self.name)
        return JudgedTrialRecord(
            **{key: getattr(found, key) for key in VerdictKeys.model_fields},
            campaign=self.name,
            springs=self.calibration.springs,
            seconds=self.seconds + time.perf_counter() - began,
            seconds_simulating=seconds_simulating,
        )


@contextmanager
def tracked_campaign(raw: Path, options: JudgingOptions) -> Iterator[TrackedCampaign]:
    """Ingest a raw campaign, locate base and targets, and calibrate the general model.

    Args:
        raw: folder of the campaign.
        options: how to ingest, to calibrate and to judge.

    Raises:
        RawDataError: when the campaign cannot be read.
        CalibrationError: when it is not enough to calibrate with.
    """
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        poses, base_frame = work / "poses.parquet", work / "base_frame.json"
        with _silent():
            ingest(
                campaign_dir=raw,
                out=poses,
                quarantine=work / "quarantine.csv",
                settings=options.ingest,
            )
            seed(campaign_dir=raw, poses=poses, out=base_frame)
            calibrate(
                campaign_dir=raw,
                poses=poses,
                base_frame=base_frame,
                load="combined",
                out=work / "calibration.json",
                settings=options.calibration,
            )
        seconds = time.perf_counter() - began
        yield TrackedCampaign(raw, work, read_description(raw).name, seconds, options)


@contextmanager
def _silent() -> Iterator[None]:
    """Keep what commands print to themselves."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        yield
