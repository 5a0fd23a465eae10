"""A measured robot's sensor errors: held out, in another series, and how well intervals hold.

    PA10CAL_IPA_DATA=folder python -m benchmarks.sensor

Each of the two series of the UR10, and both as one robot, is calibrated and searched; each is
judged in the other with base and tool alone fitted there.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import pa10cal
from pa10cal.calibration.general.refit_frames import refit_frames
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.datasets.importing import import_campaigns, write_campaigns
from pa10cal.datasets.readers import dataset_named
from pa10cal.discovery.pose_scatter import share_inside
from pa10cal.discovery.preparation import setup_of
from pa10cal.discovery.verdict_records import verdict_keys
from pa10cal.evaluation.model_errors import poses_for_model
from pa10cal.fit.validity import angles_seen
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.options import DiscoveryOptions

NAMES = ("ur10-a", "ur10-c")
GROUP = "ur10"


def main() -> int:
    """Print one line a campaign and one a transfer."""
    folder = os.environ.get("PA10CAL_IPA_DATA")
    if folder is None:
        print("PA10CAL_IPA_DATA names no folder with the UR10 series")
        return 2
    raw = Path(tempfile.mkdtemp())
    series = import_campaigns(
        dataset_named("ipa-robot-accuracy"), Path(folder), max_left_out=0.05, any_version=False
    )
    write_campaigns(series, raw)
    campaigns = {name: pa10cal.read_campaign(raw / name) for name in NAMES}
    campaigns[GROUP] = pa10cal.read_group([raw / name for name in NAMES], GROUP)
    found = {}
    for name, campaign in campaigns.items():
        began = time.process_time()
        model = pa10cal.calibrate(campaign)
        calibrated, began = time.process_time() - began, time.process_time()
        verdict = pa10cal.discover(campaign, model)
        found[name] = verdict
        seconds = time.process_time() - began
        memory_GB = 1e-6 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        assert verdict.holdout is not None
        line = f"{name}: held out {verdict.holdout.after.rms_mm:.4f} mm rms"
        if (scatter := verdict_keys(verdict).scatter) is not None:
            line += f", inside 95 % intervals {scatter.inside95_train:.3f} fitted"
            line += f", {scatter.inside95_holdout:.3f} held out"
        poses = len(campaign.observations)
        took = f"{calibrated:.0f} s to calibrate {poses} poses, {seconds:.0f} s to search"
        print(f"{line}; {took}, {memory_GB:.2f} GB", flush=True)
    for source, target in (NAMES, NAMES[::-1]):
        _transfer(campaigns[target], found[source], source, target)
    return 0


def _transfer(campaign: pa10cal.Campaign, found: pa10cal.Verdict, source: str, target: str) -> None:
    """Print how a model of one campaign does in another."""
    options = CalibrationOptions(), DiscoveryOptions()
    setup = setup_of(campaign.description, campaign.arm, *options)
    every = with_arrivals(campaign.observations)[0]
    errors, inside = {}, float("nan")
    for name, model in (("calibrated", found.baseline), ("with effects", found.model)):
        moved = refit_frames(model, poses_for_model(every, "grid", model, setup))
        poses = [poses_for_model(every, kind, model, setup) for kind in ("grid", "holdout")]
        squares = np.concatenate([moved.deviations(each).distance_mm ** 2 for each in poses])
        errors[name] = float(np.sqrt(squares.mean()))
    if found.scorer.scatter is not None:
        turned = poses[1].turned(moved.R_ee_target)
        inside = share_inside(moved, found.scorer.scatter, turned)
    seen = angles_seen(found.states.q_rad, ~campaign.arm.prismatic)
    visited = np.concatenate([seen.inside(each.states.q_rad) for each in poses])
    of_visited = f"{np.sqrt(squares[visited].mean()):.3f} mm" if visited.any() else "none"
    said = ", ".join(f"{name} {error:.3f} mm" for name, error in errors.items())
    print(
        f"{source} -> {target}: {said}; inside 95 % intervals {inside:.3f}; "
        f"poses whose angles were all visited: {of_visited} ({int(visited.sum())})",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
