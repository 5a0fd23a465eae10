"""Command `blind_trials`."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Literal

from pa10cal.command_settings import ChainOptions


def blind_trials(
    *,
    kind: str,
    count: int,
    random_seed: int,
    verdicts: Path,
    truths: Path,
    first: int = 0,
    measured: Literal[
        "touched", "tracked", "points_one", "points_three", "distance", "wild", "drives"
    ] = "touched",
    layouts: str = "",
    size: float | None = None,
    settings: ChainOptions = ChainOptions(),
) -> None:
    """Hide effects in campaigns of the virtual cell, and judge these blindly.

    Trials that are finished when the command is interrupted are kept.

    Args:
        kind: what the trials hide: null, single, pair, triple, outside, wrong_noise or wrong_mass;
            of wild ones right, stressed, effect, beyond, fault, unstated_masses, sorted_rows or
            mixed; of drives sensor, gear, both or neither.
        count: how many trials.
        random_seed: draws robots, poses, noise and hidden effects.
        verdicts: verdicts to write, one a trial (JSON lines).
        truths: what the trials hide, to write apart, one a trial (JSON lines).
        first: number of the first of them.
        measured: touched: balls of the PA10, poses repeated; tracked: other arms, no pose repeated;
            points_one, points_three, distance: of these one target, three, or one distance; wild:
            either, with stressors and faults in the raw files; drives: sensors and gears that err.
        layouts: layouts of touched balls, or arms under instruments, with commas between them; all
            of them where none are given.
        size: factor of all effects; without it, drawn for each. Wild trials and drives draw their
            own in any case.
        settings: sections ingest, base_frame, calibration and discovery.

    Examples:
        pa10cal blind_trials --kind single --first 0 --count 3 --random-seed 1 --verdicts \\
          v.jsonl --truths t.jsonl
    """
    from pa10cal.errors import DiscoveryError
    from pa10cal.files.output import whole_files
    from pa10cal.results.codec import lines
    from pa10cal_lab.blind_trials import try_trial
    from pa10cal_lab.cell.trials import draw_trials
    from pa10cal_lab.trial_records import FailedTrialRecord

    benches = [name.strip() for name in layouts.split(",") if name.strip()]
    drawn = draw_trials(kind, count, random_seed, measured, benches, first=first, size=size)
    began = time.monotonic()
    tried = []
    interrupted: BaseException | None = None
    with whole_files(verdicts, truths) as (judged_beside, hidden_beside):
        try:
            for done, trial in enumerate(drawn, start=1):
                verdict, truth = try_trial(trial, settings)
                tried.append((verdict, truth))
                seconds = (time.monotonic() - began) / done
                print(
                    f"{kind} trials: {done} of {len(drawn)}, {seconds:.1f} s a trial, "
                    f"{seconds * (len(drawn) - done):.0f} s left; "
                    f"{verdict.campaign}: {verdict.word}",
                    file=sys.stderr,
                    flush=True,
                )
        except (KeyboardInterrupt, Exception) as error:
            if not tried:
                raise
            interrupted = error
        judgements, hidden = zip(*tried, strict=True)
        judged_beside.write_text(lines(judgements), encoding="utf-8", newline="\n")
        hidden_beside.write_text(lines(hidden), encoding="utf-8", newline="\n")
    if interrupted is not None:
        raise interrupted
    # A campaign that a command refuses, saying why, is a result.
    failed = [
        record.failed
        for record in judgements
        if isinstance(record, FailedTrialRecord) and not record.refused
    ]
    if len(failed) == len(drawn):
        raise DiscoveryError(
            "every trial failed",
            where=f"{kind} trials",
            value=failed[0],
            allowed="at least one verdict",
            remedy=f"repeat one with --count 1 --first {first}",
        )
