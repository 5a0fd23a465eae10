"""A campaign judged as a user judges it: command after command, in files, in one process."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pa10cal.calibration.load_case import COMBINED
from pa10cal.calibration.records import models_of
from pa10cal.commands.calibrate import calibrate
from pa10cal.commands.discover import discover
from pa10cal.commands.evaluate import evaluate
from pa10cal.commands.ingest import ingest
from pa10cal.commands.seed import seed
from pa10cal.evaluation.options import JudgingOptions
from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
from pa10cal.results.codec import read
from pa10cal.results.discovery import VerdictKeys, VerdictRecord
from pa10cal.results.trials import JudgedTrialRecord, TrialHealth
from pa10cal.terms.joint_spring import JointSpring


@dataclass(frozen=True)
class Judged:
    """What the commands made of a campaign."""

    calibration: CalibrationRecord  # with which discovery began
    verdict: VerdictRecord
    left_out: tuple[str, ...]  # poses with quarantined rows, or that are suspected outliers
    seconds: float  # of the processor that discovery and evaluation took

    def record(self, simulating: float, calibrating: float) -> JudgedTrialRecord:
        """Return the verdict on a trial.

        Args:
            simulating: time that simulating the campaign took [s].
            calibrating: time of the processor that the commands before discovery took [s].
        """
        keys = {name: getattr(self.verdict, name) for name in VerdictKeys.model_fields}
        *_, model = models_of(self.calibration, self.verdict.campaign).values()
        terms, health = model.model.terms, self.calibration.health
        return JudgedTrialRecord(
            **keys,
            campaign=self.verdict.campaign,
            springs=tuple(term.joint for term in terms if isinstance(term, JointSpring)),
            health=TrialHealth(
                grade=health.grade,
                findings=tuple(f"{each.kind} of {each.where}" for each in health.findings),
                left_out=self.left_out,
            ),
            seconds=calibrating + self.seconds,
            seconds_simulating=simulating,
        )


def calibrated_by_commands(raw: Path, out: Path, options: JudgingOptions) -> CalibrationRecord:
    """Read a campaign, locate its base and calibrate it on all its loads.

    Args:
        raw: folder of the campaign.
        out: gets the results.
        options: how to ingest and to calibrate.

    Raises:
        Pa10calError: where a command refuses.
    """
    out.mkdir(parents=True, exist_ok=True)
    with _silent():
        poses, base, case = out / "poses.parquet", out / "base_frame.json", out / "combined.json"
        ingest(
            campaign_dir=raw, out=poses, quarantine=out / "quarantine.csv", settings=options.ingest
        )
        seed(campaign_dir=raw, poses=poses, out=base)
        calibrate(
            campaign_dir=raw,
            poses=poses,
            base_frame=base,
            out=case,
            load=COMBINED,
            settings=options.calibration,
        )
    return read(CalibrationRecord, case)


def judged_by_commands(
    raw: Path, out: Path, calibration: CalibrationRecord, options: JudgingOptions
) -> Judged:
    """Judge a campaign that `calibrated_by_commands` has calibrated, in the same folders."""
    began = time.process_time()
    poses, case = out / "poses.parquet", out / "combined.json"
    verdict, extended = out / "verdict.json", out / "extended.json"
    with _silent():
        discover(
            campaign_dir=raw,
            poses=poses,
            calibration=case,
            verdict=verdict,
            analysis=out / "analysis.json",
            extended=extended,
            suggested=out / "suggested_poses.csv",
            settings=options.discovery,
        )
        evaluate(
            campaign_dir=raw,
            poses=poses,
            calibration=case,
            out=out / "holdout.json",
            extended=extended,
        )
    seconds = time.process_time() - began
    left_out = sorted({*_quarantined(raw, out / "quarantine.csv"), *_suspected(calibration)})
    return Judged(calibration, read(VerdictRecord, verdict), tuple(left_out), seconds)


@contextmanager
def _silent() -> Iterator[None]:
    """Keep what commands print from the screen of a study."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        yield


def _quarantined(raw: Path, listing: Path) -> Iterator[str]:
    """Return the poses that quarantined rows belong to."""
    rows = pd.read_csv(listing)
    for name in set(rows["file"]):
        path = raw / str(name)
        header = pd.read_csv(path, nrows=0).columns
        if "pose" not in header:
            continue
        labels = pd.read_csv(path, usecols=["pose"], dtype=str)["pose"]
        lines = rows.loc[rows["file"] == name, "line"].to_numpy() - 2
        yield from labels.iloc[lines[lines < len(labels)]]


def _suspected(calibration: CalibrationRecord) -> Iterator[str]:
    """Return the poses that the general model suspects of a gross error."""
    if isinstance(calibration, GeneralCalibrationRecord):
        yield from (outlier.pose for outlier in calibration.suspected_outliers)
