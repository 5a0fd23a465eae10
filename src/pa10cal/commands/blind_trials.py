"""Command `blind_trials`.

What judges is given the folder of the raw campaign and nothing else. What is hidden goes from the
trial straight into a file of its own, which the command score_trials alone reads.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, cast, get_args

from pa10cal.evaluation.options import JudgingOptions

if TYPE_CHECKING:
    from pa10cal.cell.options import SimulateOptions
    from pa10cal.cell.trials import Layout, Trial
    from pa10cal.results.trials import TrialTruthRecord, TrialVerdictRecord
    from pa10cal.stages.trial_judging import CalibratedCampaign


def blind_trials(
    *,
    kind: str,
    count: int,
    random_seed: int,
    verdicts: Path,
    truths: Path,
    first: int = 0,
    layouts: str = "grid,wide",
    size: float | None = None,
    settings: JudgingOptions = JudgingOptions(),
) -> None:
    """Hide effects in campaigns of the virtual cell, and judge these blindly.

    Args:
        kind: what the trials hide: null, single, pair, triple, outside, wrong_noise or wrong_mass.
        count: how many trials.
        random_seed: draws robots, poses, noise and hidden effects.
        verdicts: verdicts to write, one a trial (JSON lines).
        truths: what the trials hide, to write apart, one a trial (JSON lines).
        first: number of the first of them.
        layouts: layouts of the poses, in turn.
        size: factor of all effects; without it, drawn for each.
        settings: sections ingest, calibration and discovery.
    """
    from pa10cal.cell.trials import TrialKind, draw_trials
    from pa10cal.errors import DiscoveryError
    from pa10cal.files.output import whole_files
    from pa10cal.results.codec import lines
    from pa10cal.results.trials import FailedTrialRecord

    last = first + _at_least_one(count)
    trials = draw_trials(cast(TrialKind, kind), last, random_seed, _layouts(layouts), size)[first:]
    progress = _Progress(f"{kind} trials", len(trials))
    judgements, hidden = [], []
    for trial in trials:
        verdict, truth = _try(trial, settings)
        progress(verdict)
        judgements.append(verdict)
        hidden.append(truth)
    with whole_files(verdicts, truths) as (judged_beside, hidden_beside):
        judged_beside.write_text(lines(judgements), encoding="utf-8", newline="\n")
        hidden_beside.write_text(lines(hidden), encoding="utf-8", newline="\n")
    failed = [record.failed for record in judgements if isinstance(record, FailedTrialRecord)]
    if len(failed) == len(trials):
        raise DiscoveryError(
            "every trial failed",
            where=f"{kind} trials",
            value=failed[0],
            allowed="at least one verdict",
            remedy="run discover on one such campaign with --debug",
        )


def _at_least_one(count: int) -> int:
    from pa10cal.errors import SettingsError

    if count < 1:
        raise SettingsError(
            "no trial to run",
            where="--count",
            value=count,
            allowed="1 or more",
            remedy="ask for more trials",
        )
    return count


def _layouts(text: str) -> tuple[Layout, ...]:
    from pa10cal.cell.trials import Layout
    from pa10cal.errors import SettingsError

    known: tuple[Layout, ...] = get_args(Layout)
    names = text.split(",")
    if unknown := sorted(set(names) - set(known)):
        raise SettingsError(
            "no such layout of poses",
            where="--layouts",
            value=unknown[0],
            allowed=", ".join(known),
            remedy="correct the name",
        )
    return tuple(layout for name in names for layout in known if layout == name)


def _try(trial: Trial, settings: JudgingOptions) -> tuple[TrialVerdictRecord, TrialTruthRecord]:
    """Return verdict and truth of a trial; a verdict may be what went wrong: none is dropped."""
    from pa10cal.results.trials import FailedTrialRecord
    from pa10cal.stages.trial_judging import judge
    from pa10cal.stages.trial_records import truth_record

    moved_mm: list[float | None] = [None] * len(trial.sizes)
    seconds = 0.0
    try:
        began = time.perf_counter()
        known = _measured(trial, trial.settings, settings)
        simulating = time.perf_counter() - began - known.seconds
        verdict: TrialVerdictRecord = judge(known, settings, simulating)
        began = time.perf_counter()
        moved_mm = [_moved_mm(trial, number, known, settings) for number in range(len(trial.sizes))]
        seconds = time.perf_counter() - began
    except Exception as error:
        message = " ".join(f"{type(error).__name__}: {error}".split())
        verdict = FailedTrialRecord(campaign=trial.name, failed=message)
    return verdict, truth_record(trial, moved_mm, seconds)


def _measured(trial: Trial, cell: SimulateOptions, settings: JudgingOptions) -> CalibratedCampaign:
    """Write a raw campaign, throw the record of what it hides away, and calibrate with the rest."""
    from pa10cal.cell.campaign import simulate_campaign
    from pa10cal.cell.write import write_campaign
    from pa10cal.files.arms import load_arm
    from pa10cal.stages.trial_judging import calibrated

    made = simulate_campaign(trial.name, load_arm(cell.robot), cell)
    with tempfile.TemporaryDirectory() as place:
        with tempfile.TemporaryDirectory() as elsewhere:
            write_campaign(made, Path(place) / "raw", Path(elsewhere) / "truth.json")
        return calibrated(Path(place) / "raw", settings)


def _moved_mm(
    trial: Trial, number: int, known: CalibratedCampaign, settings: JudgingOptions
) -> float:
    """Return how far one of the hidden effects moves what the calibrated baseline leaves.

    Root mean square over averaged grid poses of the difference to the same campaign, noise and
    all, without this effect. For the scoring alone: no verdict sees it.
    """
    import numpy as np

    effects = trial.settings.hidden_effects
    others = (*effects[:number], *effects[number + 1 :])
    without = trial.settings.model_copy(update={"hidden_effects": others})
    moved_mm = known.left_mm - _measured(trial, without, settings).left_mm
    return float(np.sqrt(np.mean(np.sum(moved_mm**2, axis=1))))


class _Progress:
    """Prints how many trials are done, how long one takes, and how long the rest will."""

    def __init__(self, title: str, count: int) -> None:
        self._title, self._count = title, count
        self._began, self._done = time.monotonic(), 0

    def __call__(self, verdict: TrialVerdictRecord) -> None:
        self._done += 1
        seconds = (time.monotonic() - self._began) / self._done
        left = seconds * (self._count - self._done)
        print(
            f"{self._title}: {self._done} of {self._count}, {seconds:.1f} s a trial, "
            f"{left:.0f} s left; {verdict.campaign}: {verdict.word}",
            file=sys.stderr,
            flush=True,
        )
