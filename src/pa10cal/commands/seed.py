"""Command `seed`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from pa10cal.frame.options import BaseFrameOptions

if TYPE_CHECKING:
    from pa10cal.arm.chain import Chain
    from pa10cal.campaign.description import Campaign
    from pa10cal.observe.observations import Observations
    from pa10cal.observe.pose import Pose
    from pa10cal.results.seed import BaseFrameRecord


def seed(
    *,
    campaign_dir: Path,
    poses: Path,
    out: Path,
    settings: BaseFrameOptions = BaseFrameOptions(),
) -> None:
    """Locate the base frame, and targets, from straight-line moves or the nominal arm.

    Args:
        campaign_dir: folder of raw files.
        poses: table of poses (.parquet).
        out: base frame in the instrument's frame, to write (.json).
        settings: section base_frame.
    """
    import numpy as np

    from pa10cal.arm.chain import Chain
    from pa10cal.campaign.description import read_campaign
    from pa10cal.campaign.table import read_observations
    from pa10cal.files.arms import load_arm
    from pa10cal.frame.records import summary
    from pa10cal.observe.averages import average_repeats
    from pa10cal.results.codec import write

    campaign = read_campaign(campaign_dir)
    every = read_observations(poses, campaign)
    chain = Chain.of(load_arm(campaign.robot, campaign_dir))
    kind = campaign.instrument.kind
    moved = bool(np.isin(every.kind, ("line_x", "line_y")).any())
    if kind == "touch_trigger_cmm" or (kind == "pose" and moved):
        record = _by_end_effector(every, chain, settings, poses, campaign)
    else:
        grid = average_repeats(every.of_kind("grid"))
        unloaded = grid.take(grid.states.load_N == grid.states.load_N.min())
        record = _by_targets(unloaded, chain, campaign)
    write(record, out)
    print(f"{campaign.name}: {summary(record)}")


def _by_end_effector(
    every: Observations, chain: Chain, settings: BaseFrameOptions, where: Path, campaign: Campaign
) -> BaseFrameRecord:
    """Find the base frame where straight moves show it, or of an end-effector that was touched."""
    import numpy as np

    from pa10cal.frame.hand_eye import target_on_base
    from pa10cal.frame.nominal_fit import seed_from_nominal
    from pa10cal.frame.records import line_record, nominal_record
    from pa10cal.frame.straight_lines import LineLimits, seed_from_lines
    from pa10cal.observe.averages import poses_of

    grid = poses_of(every, "grid")
    unloaded = grid.take(grid.states.load_N == grid.states.load_N.min())
    line_x, line_y = (poses_of(every, kind) for kind in ("line_x", "line_y"))
    _refuse_one_move(len(line_x), len(line_y), where)

    def positions(*kinds: Observations[Pose]) -> tuple[Any, Any]:
        """Measured and nominal positions of the end-effector."""
        measured = np.vstack([poses.measured.T_instr_target[:, :3, 3] for poses in kinds])
        nominal = np.vstack([chain.forward(poses.states.q_rad)[:, :3, 3] for poses in kinds])
        return measured, nominal

    if not len(line_x):
        return nominal_record(seed_from_nominal(*positions(unloaded)), campaign)
    limits = LineLimits(
        min_length_m=1e-3 * settings.min_length_mm,
        max_bend_m=1e-3 * settings.max_bend_mm,
        min_angle_rad=np.radians(settings.min_angle_deg),
    )
    seed = seed_from_lines(
        positions(line_x), positions(line_y), positions(line_x, line_y, unloaded), limits
    )
    T_ee_target = None
    if campaign.instrument.kind == "pose":
        T_base_ee = chain.forward(unloaded.states.q_rad)
        T_ee_target = target_on_base(seed.T_instr_base, T_base_ee, unloaded.measured.T_instr_target)
    return line_record(seed, campaign, T_ee_target)


def _by_targets(unloaded: Observations, chain: Chain, campaign: Campaign) -> BaseFrameRecord:
    """Find base frame and targets of an instrument whose targets may be anywhere."""
    from pa10cal.frame.hand_eye import hand_eye_from_points, hand_eye_from_poses
    from pa10cal.frame.ranging import range_from_distances
    from pa10cal.frame.records import points_record, poses_record, ranging_record
    from pa10cal.observe.distance import Distance
    from pa10cal.observe.points import Points
    from pa10cal.observe.pose import Pose

    seen, T_base_ee = unloaded.measured, chain.forward(unloaded.states.q_rad)
    if isinstance(seen, Pose):
        by_poses = hand_eye_from_poses(T_base_ee, seen.T_instr_target)
        return poses_record(by_poses, len(unloaded), campaign)
    if isinstance(seen, Points):
        found = hand_eye_from_points(
            T_base_ee, seen.p_instr_m, seen.p_ee_stated_m, names=seen.names
        )
        stated = seen.p_ee_stated_m is not None
        return points_record(found, seen.names, len(unloaded), campaign, stated=stated)
    assert isinstance(seen, Distance)
    names = campaign.ball_names if len(campaign.ball_names) == 1 else ("target",)
    stated_m = campaign.stated.places_m(names)
    ranged = range_from_distances(T_base_ee, seen.d_m, None if stated_m is None else stated_m[0])
    stated = stated_m is not None
    return ranging_record(ranged, names[0], len(unloaded), campaign, stated=stated)


def _refuse_one_move(points_x: int, points_y: int, poses: Path) -> None:
    """Refuse a move along one axis only, which gives no base frame."""
    from pa10cal.errors import CalibrationError

    if bool(points_x) == bool(points_y):
        return
    there, absent = ("line_x", "line_y") if points_x else ("line_y", "line_x")
    raise CalibrationError(
        f"there are {there} rows, but no {absent} rows",
        where=str(poses),
        allowed="both straight moves, or neither",
        remedy=f"add the {absent} rows to the campaign, or remove its {there} rows too: the base "
        "frame is then fitted to the nominal model",
    )
