"""Made-up campaigns, whose missing effects are written down here and not taken from the library."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from made_up_poses import at_joint, measured_poses, nothing
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload, PoseStates, statics
from pa10cal.discovery.evidence.by_repeats import ByRepeats, discover_by_repeats
from pa10cal.discovery.evidence.candidates import split_testable
from pa10cal.discovery.evidence.fit import EvidenceFit, covariance_of, fit
from pa10cal.discovery.evidence.judge import Judgement
from pa10cal.discovery.evidence.noise_model import NO_SHARED_ERROR
from pa10cal.discovery.evidence.problem import EvidenceProblem, prepare
from pa10cal.discovery.evidence.search import EndOfSearch, ended_at
from pa10cal.discovery.model_with_effects import moved_base
from pa10cal.discovery.preparation import MeasurementSetup, Prepared
from pa10cal.discovery.verdict import Verdict
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.frame.point_fits import fit_rigid, pose_by_source
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.observe.pose import Pose
from pa10cal.options import Tolerances
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal.terms.joint_spring import baseline
from pa10cal.terms.model import Model

ARM = load_arm("pa10_6ce")
FLEXIBLE = (2, 3)
BURDEN = Payload(2.4, np.array([0, 0, 0.19]), np.array([0, 0, 0.03]), np.array([0, 0, -9.80665]))
TARGETS_M = np.array([[0.095, 0.0, 0.31], [-0.05, 0.08, 0.31], [-0.05, -0.08, 0.312]])
POSES, REPEATS = 30, 4
TARGET_NOISE_M, JOINT_NOISE_RAD, TORQUE_NOISE_NM = 5e-6, 5e-6, 0.05
#: How far joints may be from the middle pose.
SPREAD_RAD = 0.8
ERROR_RATE = 0.01


@dataclass(frozen=True)
class Missing:
    """What an arm does that the model does not know, all zero unless given.

    Attributes:
        turn: further joint angles (P, 6), of states.
        log: what the log shows too much (P, 6), of states.
        read: what the instrument reads too much (P, B, 3), of the places of its targets.
        targets_m: (B, 3) by how much the targets are elsewhere than stated.
    """

    turn: Callable = nothing
    log: Callable = nothing
    read: Callable = nothing
    targets_m: np.ndarray | float = 0.0


def harmonic(joint, order, amplitude_rad, phase_rad=0.0):
    """Return an error of so many cycles a turn of the joint."""

    def turn(states):
        angle = order * states.q_rad[:, joint - 1] + phase_rad
        return at_joint(joint, amplitude_rad * np.sin(angle))

    return turn


def bare_model() -> Model:
    model = baseline(ARM, FLEXIBLE, Tolerances(), tau_ref_Nm=np.full(6, 100.0))
    return Model(Chain.of(ARM, bends=tuple(range(1, ARM.n))), model.terms)


@dataclass
class Measured:
    """A campaign and the baseline calibrated on it."""

    readings: Observations[Pose]
    held_out: Observations[Pose]
    setup: MeasurementSetup
    baseline: FittedModel

    @cached_property
    def problem(self) -> EvidenceProblem:
        return prepare(self.readings, self.baseline, self.setup)

    @cached_property
    def start(self) -> EvidenceFit:
        return fit(self.problem, (), (), NO_SHARED_ERROR)

    @cached_property
    def every(self) -> tuple[Effect, ...]:
        return candidates(self.problem.context)

    @cached_property
    def family(self) -> tuple[Effect, ...]:
        return split_testable(self.problem, self.start, self.every)[0]

    @cached_property
    def found(self) -> EndOfSearch:
        """What the search came to, of that of the discovery."""
        return self.discovery.scorer.judgement.ended

    @cached_property
    def discovery(self) -> Verdict[ByRepeats]:
        return self.discovered()

    def discovered(self, **changes) -> Verdict[ByRepeats]:
        given = Prepared(self.readings, self.held_out, self.baseline, self.setup, "logged", False)
        return discover_by_repeats(replace(given, **changes))

    def effect(self, id_, of) -> Effect:
        (found,) = (effect for effect in self.every if (effect.id, effect.of) == (id_, of))
        return found


def forced(measured, effects, sizes, problem=None, family=None) -> EndOfSearch:
    """Return the search as if it had ended with these effects, in its own or another problem."""
    problem = measured.problem if problem is None else problem
    family = measured.family if family is None else family
    there = fit(problem, effects, sizes, NO_SHARED_ERROR)
    return ended_at(problem, there, family, np.eye(len(family), dtype=bool))


def scored(problem, extended) -> ByRepeats:
    """Return the scorer as if the search of a campaign had ended with a model."""
    family = extended.effects
    found = ended_at(problem, extended, family, np.eye(len(family), dtype=bool))
    return ByRepeats(
        problem=problem,
        start=extended,
        judgement=Judgement((), (), found),
        extended=extended,
        covariance=covariance_of(problem, extended),
    )


def measure(missing=Missing(), seed=20080427, poses=POSES, apparatus_m=5e-6, pose_m=0.0):
    """Measure a made-up arm: some poses, two loads, from either side, twice each.

    Args:
        missing: what it does beyond the model.
        seed: of everything drawn.
        poses: how many for the fit; ten more are held out.
        apparatus_m: uncertainty of the targets' places, stated.
        pose_m: size of a lawless error of each target that all readings of a pose share.
    """
    rng = np.random.default_rng(seed)
    model = bare_model()
    x = np.array([0.3 * p.scale * rng.standard_normal() for p in model.parameters])
    for k, parameter in enumerate(model.parameters):
        if parameter.name.startswith("windup"):
            x[k] = 3e-3
        elif parameter.name.startswith("cubic_share"):
            x[k] = 0.2
    T_instr_base = np.eye(4)
    T_instr_base[:3, :3] = Rotation.from_rotvec([0.01, -0.02, 1.6]).as_matrix()
    T_instr_base[:3, 3] = [0.3, 0.2, -0.15]
    setup = MeasurementSetup(BURDEN, TARGETS_M, 21.0, apparatus_m)
    single = _readings(missing, model, x, T_instr_base, (poses, (0.0, 44.0)), rng, pose_m)
    held_out = _readings(missing, model, x, T_instr_base, (10, (0.0, 22.0, 66.0)), rng, pose_m)
    nominal = FittedModel(model, np.where(x == 3e-3, 2e-3, 0.0), T_instr_base)
    found = fit(prepare(single, nominal, setup), (), (), NO_SHARED_ERROR)
    calibrated = FittedModel(model, found.x[:-6], moved_base(T_instr_base, found.x[-6:]))
    return Measured(single, average_repeats(held_out), setup, calibrated)


def _readings(missing, model, x, T_instr_base, layout, rng, pose_m) -> Observations[Pose]:
    poses, loads_N = layout
    centre = np.radians([0.0, 10.0, 100.0, 5.0, 50.0, -80.0])
    at_pose = centre + rng.uniform(-SPREAD_RAD, SPREAD_RAD, (poses, 6))
    off_m = pose_m * rng.standard_normal((poses, len(TARGETS_M), 3))
    from_side = rng.choice([-1.0, 1.0], (poses, 6))
    axes = np.meshgrid(np.arange(poses), loads_N, np.arange(REPEATS), indexing="ij")
    pose, load_N, repeat = (axis.ravel() for axis in axes)
    count = len(pose)
    states = PoseStates(
        q_rad=at_pose[pose] + rng.normal(0.0, 1e-5, (count, 6)),
        tau_Nm=np.zeros((count, 6)),
        arrival=from_side[pose] * np.where(repeat < REPEATS // 2, 1.0, -1.0)[:, None],
        load_N=load_N,
        temperature_C=np.full(count, np.nan),
        time_s=45.0 * rng.permutation(count),
    )
    q_still_rad = states.q_rad + rng.normal(0.0, JOINT_NOISE_RAD, (count, 6))
    for _ in range(3):  # springs give way to the weights, which follow the arm
        at = replace(states, q_rad=q_still_rad + missing.turn(states))
        weights = statics(model.chain, model.chain_coordinates(at, x), load_N, BURDEN)
        states = replace(states, tau_Nm=weights.joint_Nm)
    T_instr_ee = T_instr_base @ model.predict(replace(at, tau_Nm=states.tau_Nm), x)
    on_tool_m = TARGETS_M + missing.targets_m
    p_instr_m = T_instr_ee[:, None, :3, 3] + on_tool_m @ T_instr_ee[:, :3, :3].transpose(0, 2, 1)
    p_instr_m += missing.read(p_instr_m) + off_m[pose]
    p_instr_m += rng.normal(0.0, TARGET_NOISE_M, p_instr_m.shape)
    T_read = fit_rigid(TARGETS_M, p_instr_m).T
    covariances = np.tile(TARGET_NOISE_M**2 * np.eye(3), (count, 3, 1, 1))
    logged_Nm = states.tau_Nm + missing.log(states)
    return measured_poses(
        pose=np.array([f"P{k:02d}" for k in pose]),
        states=replace(states, tau_Nm=logged_Nm + rng.normal(0, TORQUE_NOISE_NM, (count, 6))),
        T_instr_ee=T_read,
        cov=_stated(T_read, p_instr_m),
        by_apparatus=pose_by_source(T_read, p_instr_m, covariances),
    )


def _stated(T_read, p_instr_m):
    """Return the covariance of poses that stated noise of their targets makes, (P, 6, 6)."""
    lever = p_instr_m - T_read[:, None, :3, 3]
    rows = np.zeros((*lever.shape, 6))
    rows[..., :3] = np.eye(3)
    rows[..., 3:] = -np.cross(np.eye(3), lever[..., None, :])
    rows = rows.reshape(len(lever), -1, 6)
    return TARGET_NOISE_M**2 * np.linalg.inv(rows.transpose(0, 2, 1) @ rows)
