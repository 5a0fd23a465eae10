"""Command `coverage`.

The truth is read here, after the estimate is made, and nowhere else.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.cell.options import SimulateOptions


def coverage(
    *,
    out: Path,
    campaigns: int = 50,
    first_seed: int = 1,
    simulate: SimulateOptions = SimulateOptions(),
    settings: CalibrationOptions = CalibrationOptions(),
) -> None:
    """Count how often intervals hold the truth of simulated campaigns, with the paper's model.

    Args:
        out: record to write (.json).
        campaigns: how many campaigns to simulate.
        first_seed: random seed of the first of them; each further one adds 1.
        simulate: an entry of section simulate.
        settings: section calibration.
    """
    import numpy as np

    from pa10cal.errors import SettingsError
    from pa10cal.evaluation.coverage import coverage as count_inside
    from pa10cal.files.output import write_json
    from pa10cal.files.schemas import COVERAGE

    if campaigns < 1:
        raise SettingsError(
            "nothing to simulate",
            where="--campaigns",
            value=campaigns,
            allowed="1 or more",
            remedy="ask for more campaigns",
        )
    seeds = range(first_seed, first_seed + campaigns)
    scores: list[dict[str, float]] = []
    for seed in seeds:
        scores.append(_scores(simulate.model_copy(update={"random_seed": seed}), settings))
        if len(scores) % max(1, len(seeds) // 10) == 0:
            print(f"coverage: {len(scores)} of {len(seeds)} campaigns", file=sys.stderr)
    names = [name for name in scores[0] if all(name in row for row in scores)]
    found = count_inside(np.array([[row[name] for name in names] for row in scores]))
    write_json(
        out,
        {
            "schema": COVERAGE,
            "provenance": "synthetic: virtual cell, no hidden effect",
            "campaigns": len(scores),
            "parameters": {
                name: {"inside": float(inside), "rms": float(rms)}
                for name, inside, rms in zip(
                    names, found.by_parameter, found.rms_by_parameter, strict=True
                )
            },
            "inside": found.inside,
            "inside_interval95": [found.inside_low, found.inside_high],
            "rms": found.rms,
        },
    )
    print(
        f"{100 * found.inside:.1f} % of {len(names)} parameters in {len(scores)} campaigns inside "
        f"their 95 % intervals ({100 * found.inside_low:.1f} to {100 * found.inside_high:.1f} %), "
        f"rms score {found.rms:.2f}"
    )


def _scores(simulate: SimulateOptions, settings: CalibrationOptions) -> dict[str, float]:
    """Simulate, ingest and calibrate one campaign; score every identifiable parameter."""
    from pa10cal.calibration.calibrate import calibrate
    from pa10cal.calibration.records import parameter_records
    from pa10cal.calibration.uncertainty import ErrorSources
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.ingest import ingest_campaign
    from pa10cal.campaign.options import IngestOptions
    from pa10cal.campaign.table import observations_of
    from pa10cal.cell.campaign import simulate_campaign
    from pa10cal.cell.write import write_campaign
    from pa10cal.files.arms import load_arm
    from pa10cal.observe.averages import average_repeats, poses_of
    from pa10cal.stages.records import read_record
    from pa10cal.terms.baseline import baseline

    arm = load_arm(simulate.robot)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = simulate_campaign("coverage", arm, simulate, "text_e7")
        write_campaign(made, folder / "raw", folder / "truth.json")
        campaign = read_campaign(folder / "raw")
        ingested = ingest_campaign(campaign, arm, folder / "raw", IngestOptions())
        truth = read_record(folder / "truth.json", "pa10cal-truth/1")["parameters"]
    readings = poses_of(observations_of(ingested.poses, campaign), average=False)
    found = calibrate(
        baseline(arm, settings.flexible_joints, settings.tolerances),
        average_repeats(readings),
        settings,
        ErrorSources(readings, 1e-3 * settings.apparatus_uncertainty_mm),
    )
    return {
        name: (parameter.value - truth[name]["value"]) / parameter.std
        for name, parameter in parameter_records(found).items()
        if parameter.identifiable and parameter.std and name in truth
    }
