"""A made-up UR10 seen by a tracker in many different poses, with what it does beyond its model."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from made_up_poses import measured_poses
from pa10cal.arm.chain import Chain, long_links
from pa10cal.arm.state import PoseStates
from pa10cal.arm.statics import Payload, statics
from pa10cal.arm.tolerances import Tolerances
from pa10cal.calibration.general.unknowns import tool_frame
from pa10cal.discovery.blocked_cv.discover import VerdictByBlocks, discover_by_blocks
from pa10cal.discovery.blocked_cv.survey import Survey, survey
from pa10cal.discovery.preparation import MeasurementSetup, Prepared
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures

ARM = load_arm("ur10")
BURDEN = Payload(1.0, np.array([0.0, 0.0, 0.05]), np.zeros(3), np.array([0.0, 0.0, -9.81]))
SETUP = MeasurementSetup(BURDEN, np.zeros((0, 3)), 22.0)
POSITION_M, ATTITUDE_RAD = 2e-5, 1e-4
POSES, HELD_OUT = 700, 100
ERROR_RATE = 0.01
#: Joints keep to these angles, so that there are others which no pose has seen.
LOW_RAD, HIGH_RAD = -1.8, 1.8


def nothing(*values):
    return 0.0


@dataclass(frozen=True)
class Hidden:
    """What the arm does that the model does not know, all zero unless given.

    Attributes:
        turn: further joint angles (P, 6), of states.
        twist: further small rotation of the target's attitude alone (P, 3), of states and of the
            joints' axes (P, 3, 6), both in the instrument's frame.
        noise: sizes of the noise over those stated.
    """

    turn: Callable = nothing
    twist: Callable = nothing
    noise: float = 1.0


def at_joint(joint, values):
    """Return (P, 6) values of one joint, zero at the others."""
    return np.asarray(values)[:, None] * (np.arange(1, 7) == joint)


def rough(joint):
    """Return an error of one joint that no named form comes near, smooth over some degrees."""

    def turn(states):
        q = states.q_rad[:, joint - 1]
        waves = [(13, 8e-5, 0.3), (17, 6e-5, 1.0), (5, 5e-5, 2.0), (9, 5e-5, 0.0)]
        return at_joint(joint, sum(size * np.sin(order * q + at) for order, size, at in waves))

    return turn


@dataclass
class Surveyed:
    """A campaign and its calibrated model, which is the truth but for what is hidden."""

    readings: Observations[Pose]
    held_out: Observations[Pose]
    baseline: FittedModel

    @cached_property
    def survey(self) -> Survey:
        return survey(self.readings, self.baseline, SETUP, torques_logged=False)

    @cached_property
    def discovery(self) -> VerdictByBlocks:
        held_out = self.held_out if len(self.held_out) else None
        given = Prepared(self.readings, held_out, self.baseline, SETUP, "masses", False)
        return discover_by_blocks(given, ERROR_RATE)


def observe(hidden=Hidden(), seed=20080427, poses=POSES, held_out=HELD_OUT) -> Surveyed:
    """Let the tracker see the made-up arm."""
    rng = np.random.default_rng(seed)
    count = poses + held_out
    chain = Chain.of(ARM, bends=long_links(ARM))
    q_rad = rng.uniform(LOW_RAD, HIGH_RAD, (count, 6))
    states = PoseStates(
        q_rad=q_rad,
        tau_Nm=np.zeros((count, 6)),
        arrival=np.sign(np.diff(q_rad, axis=0, prepend=0.0)),
        load_N=np.zeros(count),
        temperature_C=np.linspace(22.0, 23.0, count),
        time_s=60.0 * np.arange(count),
    )
    weights = statics(chain, chain.coordinates(q_rad), states.load_N, BURDEN)
    states = replace(states, tau_Nm=weights.torque_Nm)
    largest_Nm = np.abs(states.tau_Nm).max(axis=0)
    springs = (JointSpring(joint, largest_Nm[joint - 1], cubic=False) for joint in (2, 3))
    model = Model(chain, (link_departures(ARM, Tolerances()), *springs, tool_frame()))
    x = np.array([0.3 * p.scale * rng.standard_normal() for p in model.parameters])
    x[[p.name.startswith("windup") for p in model.parameters]] = 3e-3
    T_instr_base = np.eye(4)
    T_instr_base[:3, :3] = Rotation.from_rotvec([0.01, -0.02, 1.6]).as_matrix()
    T_instr_base[:3, 3] = [2.0, 0.2, -0.15]
    T = T_instr_base @ model.predict(replace(states, q_rad=q_rad + hidden.turn(states)), x)
    T[:, :3, 3] += hidden.noise * POSITION_M * rng.standard_normal((count, 3))
    end = chain.forward_with_screws(q_rad)
    axes = T_instr_base[:3, :3] @ end.screws[:, 3:, chain.joint_columns]
    turned = hidden.noise * ATTITUDE_RAD * rng.standard_normal((count, 3)) + hidden.twist(
        states, axes
    )
    T[:, :3, :3] = Rotation.from_rotvec(turned).as_matrix() @ T[:, :3, :3]
    stated = np.diag([POSITION_M**2] * 3 + [ATTITUDE_RAD**2] * 3)
    seen = measured_poses(
        pose=np.array([f"P{k:04d}" for k in range(count)]),
        states=states,
        T_instr_ee=T,
        cov=np.tile(stated, (count, 1, 1)),
    )
    order = rng.permutation(poses)  # the order of rows tells nothing
    return Surveyed(
        seen.take(order), seen.take(slice(poses, None)), FittedModel(model, x, T_instr_base)
    )
