"""Wild trials: raw folders with stressors and faults, judged as a user judges a campaign."""

from __future__ import annotations

import io
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pa10cal.arrays import Array
from pa10cal.calibration.load_case import COMBINED
from pa10cal.cell.campaign import simulate_campaign
from pa10cal.cell.disturbances.disturbance import all_disturbances
from pa10cal.cell.measured_trials import SORTED, UNSTATED, after_geometry
from pa10cal.cell.options import SimulateOptions
from pa10cal.cell.trials import Trial
from pa10cal.cell.write import Places, write_campaign
from pa10cal.errors import Pa10calError
from pa10cal.evaluation.blind_trial import WILD
from pa10cal.evaluation.options import ChainOptions, JudgingOptions
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import models_of
from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
from pa10cal.results.codec import read
from pa10cal.results.discovery import VerdictKeys, VerdictRecord
from pa10cal.results.trials import (
    FailedTrialRecord,
    JudgedTrialRecord,
    PutIn,
    TrialHealth,
    TrialTruthRecord,
    TrialVerdictRecord,
)
from pa10cal.stages.pipeline import Places as ResultPlaces
from pa10cal.stages.pipeline import Stage, stages
from pa10cal.studies.trial_records import truth_record
from pa10cal.terms.joint_spring import JointSpring


def try_wild_trial(
    trial: Trial, options: JudgingOptions, keep: Path | None = None
) -> tuple[TrialVerdictRecord, TrialTruthRecord]:
    """Return verdict and truth of a trial; a verdict may be what went wrong: none is dropped.

    Args:
        trial: as drawn.
        options: how the campaign is judged.
        keep: gets the raw folder of the trial; None for a folder of the moment.
    """
    with tempfile.TemporaryDirectory() as place:
        began = time.process_time()
        raw, out = (keep or Path(place, "raw")) / trial.name, Path(place, "results")
        places = _write(trial.name, trial.settings, raw)
        simulating = time.process_time() - began
        calibration = None
        try:
            began = time.process_time()
            calibration = calibrated_by_commands(raw, out, options)
            seconds = time.process_time() - began
            judged = judged_by_commands(raw, out, calibration, options)
            verdict: TrialVerdictRecord = judged.record(simulating, seconds)
        except Pa10calError as error:
            # What can be calibrated is not withheld, so discovery that refuses is a crash.
            refused = calibration is None
            verdict = FailedTrialRecord(campaign=trial.name, failed=str(error), refused=refused)
        except Exception as error:
            verdict = FailedTrialRecord(campaign=trial.name, failed=_crash(error))
        began = time.process_time()
        if trial.kind in (UNSTATED, SORTED):
            return verdict, _truth_after_geometry(trial)
        effects, put_in = _moved(trial, calibration, Path(place, "twin"), options)
        seconds = time.process_time() - began
    truth = truth_record(trial, effects, seconds, WILD)
    return verdict, truth.model_copy(update={"put_in": _put_in(trial, places, put_in)})


def _write(name: str, settings: SimulateOptions, raw: Path) -> Places:
    made = simulate_campaign(name, load_arm(settings.robot), settings)
    return write_campaign(made, raw)


def _crash(error: Exception) -> str:
    """Return an internal fault with the place where it happened."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return f"{text} (in {Path(last.filename).name}, line {last.lineno})"


def _put_in(trial: Trial, places: Places, moved_mm: Sequence[float | None]) -> tuple[PutIn, ...]:
    known = all_disturbances()
    return tuple(
        PutIn(
            id=entry.id,
            where=where,
            stressor=known[entry.id].stressor,
            kinds=known[entry.id].kinds,
            measured=known[entry.id].measured,
            moved_mm=moved,
        )
        for entry, where, moved in zip(trial.settings.disturbances, places, moved_mm, strict=True)
    )


def _truth_after_geometry(trial: Trial) -> TrialTruthRecord:
    """Return the truth of a trial, with what its effects leave once the geometry is fitted again.

    The calibrated model may hold springs, which follow whatever a twin without one does: how far
    it moves what that model leaves says nothing here.
    """
    began = time.process_time()
    settings, arm = trial.settings, load_arm(trial.settings.robot)
    entries = settings.hidden_effects
    twins = [
        settings.model_copy(update={"hidden_effects": (*entries[:k], *entries[k + 1 :])})
        for k in range(len(entries))
    ]
    left = after_geometry(
        simulate_campaign(trial.name, arm, settings),
        [simulate_campaign(trial.name, arm, twin) for twin in twins],
    )
    truth = truth_record(trial, left.moved_mm, time.process_time() - began, WILD)
    effects = tuple(
        effect.model_copy(update={"apart_mm": apart_mm})
        for effect, apart_mm in zip(truth.hidden_effects, left.apart_mm, strict=True)
    )
    return truth.model_copy(update={"hidden_effects": effects, "noise_mm": left.noise_mm})


def _moved(
    trial: Trial, calibration: CalibrationRecord | None, place: Path, options: JudgingOptions
) -> tuple[list[float | None], list[float | None]]:
    """Return how far each effect and disturbance moves what the calibrated model leaves [mm].

    Root mean square over the poses fitted of the difference to the same campaign, noise and all,
    without it. For the scoring alone: no verdict sees it. None where that does not measure it.
    """
    settings, known = trial.settings, all_disturbances()

    def against(key: str, number: int, *, measured: bool) -> float | None:
        if calibration is None or not measured:
            return None
        entries = getattr(settings, key)
        others = (*entries[:number], *entries[number + 1 :])
        raw = place / f"{key}{number}"
        try:
            _write(trial.name, settings.model_copy(update={key: others}), raw)
            twin = calibrated_by_commands(raw, raw.with_suffix(".results"), options)
        except Exception:
            return None
        return _distance_mm(calibration.residuals.position_mm, twin.residuals.position_mm)

    effects = [against("hidden_effects", k, measured=True) for k in range(len(trial.sizes))]
    put_in = [
        against("disturbances", k, measured=known[entry.id].measured)
        for k, entry in enumerate(settings.disturbances)
    ]
    return effects, put_in


def _distance_mm(one_mm: Array, other_mm: Array) -> float | None:
    if one_mm.shape != other_mm.shape:  # other rows were quarantined
        return None
    return float(np.sqrt(np.mean(np.sum((one_mm - other_mm) ** 2, axis=1))))


# A campaign judged as a user judges it: command after command, in files, in one process.


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
    first = _until_calibrated(raw, out, options)
    with _silent():
        for stage in first:
            stage.run()
    return read(CalibrationRecord, first[-1].writes["calibration"])


def judged_by_commands(
    raw: Path, out: Path, calibration: CalibrationRecord, options: JudgingOptions
) -> Judged:
    """Judge a campaign that `calibrated_by_commands` has calibrated, in the same folders."""
    began, at = time.process_time(), ResultPlaces(out)
    before = len(_until_calibrated(raw, out, options))
    with _silent():
        for stage in _stages(raw, out, options)[before:]:
            if stage.name != "export":
                stage.run()
    seconds = time.process_time() - began
    left_out = sorted({*_quarantined(raw, at.quarantine), *_suspected(calibration)})
    return Judged(calibration, read(VerdictRecord, at.verdict), tuple(left_out), seconds)


def _until_calibrated(raw: Path, out: Path, options: JudgingOptions) -> list[Stage]:
    """Return the stages up to the calibration that is searched."""
    every = _stages(raw, out, options)
    end = next(at for at, stage in enumerate(every, 1) if stage.command == "calibrate")
    return every[:end]


def _stages(raw: Path, out: Path, options: JudgingOptions) -> list[Stage]:
    """Return the stages of a trial, of all loads together."""
    given = {name: getattr(options, name) for name in JudgingOptions.model_fields}
    return list(stages((raw,), out, ChainOptions(**given), load=COMBINED))


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
