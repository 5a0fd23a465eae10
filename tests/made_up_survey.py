"""A UR10 of the virtual cell seen by a tracker in many different poses, with what it hides."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from made_up_poses import at_joint, nothing
from pa10cal.calibration.general.as_model import fitted
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.discovery.blocked_cv.by_blocks import ByBlocks, discover_by_blocks
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.preparation import MeasurementSetup, Prepared
from pa10cal.discovery.verdict import Verdict
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal_lab.cell.campaign import measure_campaign, robot_of
from pa10cal_lab.cell.effects.effect import JointsEffect
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.simulated import observations_of, payload_of_individual

ARM = load_arm("ur10")
POSITION_M, ATTITUDE_RAD = 2e-5, 1e-4
POSES, HELD_OUT = 700, 100
ERROR_RATE = 0.01
#: Joints keep to these angles, so that there are others which no pose has seen.
LOW_RAD, HIGH_RAD = -1.8, 1.8


@dataclass(frozen=True)
class Hidden:
    """What the arm does that the model does not know, all zero unless given.

    Attributes:
        turn: further joint angles (P, 6), of how the joints came to stand (`q_rad`, `arrival`).
        twist: further small rotation of the target's orientation alone (P, 3), of the same and of
            the joints' axes (P, 3, 6) in the instrument's frame.
        noise: sizes of the noise over those stated.
    """

    turn: Callable = nothing
    twist: Callable = nothing
    noise: float = 1.0


class Turned(JointsEffect):
    """Further joint angles, any function of how the joints came to stand."""

    id: ClassVar[str] = "turned"

    by: Callable[[Any], Any]

    def added(self, motion):
        return self.by(motion) + np.zeros_like(motion.q_rad)


def rough(joint):
    """Return an error of one joint that no named form comes near, smooth over some degrees."""

    def turn(motion):
        q = motion.q_rad[:, joint - 1]
        waves = [(13, 8e-5, 0.3), (17, 6e-5, 1.0), (5, 5e-5, 2.0), (9, 5e-5, 0.0)]
        return at_joint(joint, sum(size * np.sin(order * q + at) for order, size, at in waves))

    return turn


@dataclass
class Surveyed:
    """A campaign and its calibrated model, which is right but for what is hidden."""

    readings: Observations[Pose]
    held_out: Observations[Pose]
    baseline: FittedModel
    setup: MeasurementSetup

    @cached_property
    def survey(self) -> Survey:
        return Survey.of(self.prepared)

    @cached_property
    def discovery(self) -> Verdict[ByBlocks]:
        return discover_by_blocks(self.prepared)

    @property
    def prepared(self) -> Prepared:
        held_out = self.held_out if len(self.held_out) else None
        return Prepared(self.readings, held_out, self.baseline, self.setup, "masses", False)


def measured(hidden=Hidden(), seed=20080427, poses=POSES, held_out=HELD_OUT, moved=np.asarray):
    """Let the cell measure a UR10, and return the campaign, its orientations twisted.

    The poses are uniform over the joints' angles, then `moved`: a function of angles (P, 6) [rad].
    """
    count = poses + held_out
    q_rad = moved(np.random.default_rng(seed).uniform(LOW_RAD, HIGH_RAD, (count, 6)))
    plan = TrackerOptions(
        commanded=np.degrees(q_rad).tolist(),
        holdout_share=held_out / count,
        seconds_a_pose=60.0,
        target_m=0.0,
        target_rad=0.05,
        position_mm=1e3 * hidden.noise * POSITION_M,
        attitude_rad=hidden.noise * ATTITUDE_RAD,
    )
    options = SimulateOptions(
        random_seed=seed,
        robot="ur10",
        without_touches=plan,
        stated_uncertainty_mm=1e3 * POSITION_M,
    )
    turned = Turned(by=hidden.turn).at("joint 1")
    made = measure_campaign("made-up", options, robot_of(ARM, options), (turned,))
    robot, schedule = made.truth.robot, made.truth.schedule
    axes = robot.mechanism.T_base_joints(schedule.q)[..., :3, 2].transpose(1, 2, 0)
    twist = hidden.twist(_Came(schedule.q, schedule.arrival), robot.T_instr_base[:3, :3] @ axes)
    table, names = made.tables["poses"], ["qw", "qx", "qy", "qz"]
    seen = Rotation.from_quat(table[names].to_numpy(), scalar_first=True)
    turn = Rotation.from_rotvec(twist + np.zeros((count, 3)))
    table[names] = (turn * seen).as_quat(canonical=True, scalar_first=True)
    return made


@dataclass(frozen=True)
class _Came:
    q_rad: np.ndarray
    arrival: np.ndarray


def observe(
    hidden=Hidden(), seed=20080427, poses=POSES, held_out=HELD_OUT, springs=False, moved=np.asarray
) -> Surveyed:
    """Let the cell measure a UR10 of rigid joints, and calibrate it; with springs if these help."""
    made = measured(hidden, seed, poses, held_out, moved)
    every, _ = with_arrivals(observations_of(made), ARM)
    payload = payload_of_individual(made.truth.robot)
    fit = every.take(slice(poses))
    options = CalibrationOptions() if springs else CalibrationOptions().with_springs(())
    model = fitted(calibrate_general(ARM, fit, find_start(ARM, fit), payload, options))
    setup = MeasurementSetup(payload, np.zeros((0, 3)), 20.0)
    order = np.random.default_rng(seed).permutation(poses)  # the order of rows tells nothing
    grid, rest = (model.as_modelled(every.take(rows)) for rows in (order, slice(poses, None)))
    return Surveyed(grid, rest, model.with_bends(), setup)
