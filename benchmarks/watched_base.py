"""What targets on the base are worth: the same simulated campaigns with them and without.

An IRB 120 with three reflectors, its links off by what the model holds, under a tracker that walks
and turns a little. Link parameters are held against the truth; where base and reflectors are
depends on what the tracker did, and is not.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pa10cal.calibration.general.as_model import fitted
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.general.unknowns import choose_unknowns
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.read import read_campaign
from pa10cal.files.arms import load_arm
from pa10cal_lab.cell.campaign import measure_campaign
from pa10cal_lab.cell.individual import draw_individual
from pa10cal_lab.cell.options import DisturbanceOptions, SimulateOptions, TrackerOptions
from pa10cal_lab.cell.write import write_campaign
from pa10cal_lab.simulated import draw_by_unknowns, measure, observations_of, parameter_scores

ROBOT = "irb120"
#: Noise of a coordinate, walk of the tracker at the end, and its turn.
NOISE_MM, WALK_MM, TURN_MRAD = 0.01, 0.05, 0.01
_POSES, _HELD_OUT = 300, 0.3


@dataclass(frozen=True)
class Watched:
    """What one campaign came to."""

    scores: tuple[float, ...]  # errors of link parameters over their standard uncertainties
    errors: tuple[float, ...]  # the same errors over the parameters' scales
    held_out_mm: float  # root mean square position error of held-out poses


def campaign_of(seed: int, base_targets: int, walk_mm: float) -> Watched:
    """Simulate, read and calibrate one campaign.

    Args:
        seed: draws arm, poses, noise and walk, alike for all numbers of targets on the base.
        base_targets: how many.
        walk_mm: of the tracker at the end; 0 for one that stands still.
    """
    arm = load_arm(ROBOT)
    plan = TrackerOptions(
        instrument="points",
        poses=_POSES,
        holdout_share=_HELD_OUT,
        base_targets=base_targets,
        states_targets=False,
        unseen_share=0.0,
        position_mm=NOISE_MM,
        seconds_a_pose=30.0,
    )
    options = CalibrationOptions()
    rng = np.random.default_rng(seed)
    seen = observations_of(measure(draw_individual(arm, plan, rng), _plain(plan), seed))
    start = find_start(arm, seen)
    unknowns = choose_unknowns(arm, options.tolerances, seen.measured, start)
    robot = draw_by_unknowns(arm, plan, unknowns, np.random.default_rng(seed))
    walk = DisturbanceOptions(
        id="random_walk",
        parameters={"size_mm": walk_mm, "turn_mrad": TURN_MRAD * walk_mm / WALK_MM},
    )
    settings = SimulateOptions(
        random_seed=seed,
        robot=ROBOT,
        without_touches=plan,
        disturbances=(walk,) if walk_mm else (),
    )
    with tempfile.TemporaryDirectory() as place:
        write_campaign(measure_campaign("watched", settings, robot), Path(place) / "raw")
        campaign = read_campaign(Path(place) / "raw")
    poses, held_out = campaign.calibration, campaign.held_out
    found = calibrate_general(arm, poses, find_start(arm, poses), None, options)
    scale = {each.name: each.scale for each in unknowns.links.parameters}
    scores = {k: v for k, v in parameter_scores(found, robot).items() if k in scale}
    std = np.sqrt(np.diag(found.fit.covariance))
    sizes = {each.name: std[k] for k, each in enumerate(found.problem.parameters)}
    model = fitted(found)
    T_base_ee = model.model.predict(held_out.states, model.x)
    error_mm = held_out.measured.deviations(
        T_base_ee, model.T_instr_base, model.targets_m
    ).distance_mm
    return Watched(
        tuple(scores.values()),
        tuple(scores[name] * float(sizes[name]) / scale[name] for name in scores if name in sizes),
        float(np.sqrt(np.mean(error_mm**2))),
    )


def _plain(plan: TrackerOptions) -> TrackerOptions:
    """Return the plan without targets on the base, which only shows what can be identified."""
    return plan.model_copy(update={"base_targets": 0})
