"""Poses as if an instrument had measured them, states of an arm, and where effects may sit."""

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.statics import CarriedWeights, ObservedTargets, PoseStates, StaticLoads
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.effects.context import CandidateContext


def nothing(*values):
    return 0.0


def at_joint(joint, values):
    """Return (P, 6) values of one joint, zero at the others."""
    return np.asarray(values)[:, None] * (np.arange(1, 7) == joint)


def measured_poses(
    pose, states: PoseStates, T_instr_ee, cov, by_apparatus=None, readings=None
) -> Observations[Pose]:
    """Return poses to fit, single readings unless their number is given."""
    count = len(pose)
    apart = np.zeros((count, 6, 0)) if by_apparatus is None else by_apparatus
    ones = np.ones(count, dtype=np.int64)
    return Observations(
        np.asarray(pose),
        states,
        Pose(T_instr_ee, cov, apart),
        np.full(count, "grid"),
        ones,
        ones if readings is None else np.asarray(readings),
    )


def at_rest(q_rad, **known) -> PoseStates:
    """Return states of joint positions (P, n) in which all else is zero, but for what is given."""
    q_rad, nothing = np.asarray(q_rad), np.zeros(len(q_rad))
    usual = {"tau_Nm": np.zeros_like(q_rad), "arrival": np.zeros_like(q_rad)}
    usual |= dict.fromkeys(("load_N", "temperature_C", "time_s"), nothing)
    return PoseStates(q_rad, **usual | known)


def states_of(arm, seed=3, poses=5, **known) -> PoseStates:
    """Return states of an arm in which all effects show, drawn but for what is given."""
    rng, n = np.random.default_rng(seed), arm.n
    down = rng.normal(size=(poses, 3))
    usual = {
        "q_rad": rng.uniform(-1.5, 1.5, (poses, n)),
        "tau_Nm": rng.uniform(-30.0, 30.0, (poses, n)),
        "arrival": rng.choice([-1.0, 1.0], (poses, n)),
        "load_N": rng.choice([0.0, 44.0], poses),
        "temperature_C": rng.uniform(19.0, 27.0, poses),
        "time_s": np.sort(rng.uniform(100.0, 4e4, poses)),
        "move_share": np.linspace(-1.0, 1.0, poses * n).reshape(poses, n),
        "move_end_m": np.linspace(0.1, 1.2, poses),
        "static_loads": StaticLoads(
            joint_Nm=rng.uniform(-60.0, 60.0, (poses, n)),
            down_ee=down / np.linalg.norm(down, axis=1, keepdims=True),
            by_weights=rng.normal(size=(poses, n, 4 * n + 3)),
            by_load=rng.normal(size=(poses, n)),
            carried=CarriedWeights(
                mass_kg=rng.uniform(1.0, 30.0, (poses, n)),
                moment_kg_m=rng.normal(size=(poses, n, 3)),
                by_link=rng.normal(size=(poses, n, 4, 3)),
                com_m=rng.normal(size=(poses, n, 3)),
                by_apparatus=rng.normal(size=(poses, 3)),
                ends=np.tile(np.eye(4), (poses, n - 1, 1, 1)),
                gravity_m_s2=np.tile([0.0, 0.0, -9.81], (poses, 1)),
                by_level=rng.normal(size=(poses, 2, 3)),
            ),
        ),
        "seen": ObservedTargets(
            p_instr_targets_m=rng.uniform(0.0, 0.9, (poses, 3, 3)),
            pose_by_targets=rng.normal(size=(poses, 6, 9)),
        ),
    }
    return PoseStates(**usual | known)


def context_of(arm, **known) -> CandidateContext:
    """Return where effects of an arm may sit: anywhere, but for what is given."""
    usual = {
        "flexible_joints": (2,),
        "reference_temperature_C": 21.0,
        "largest_tau_Nm": np.full(arm.n, 30.0),
        "p_instr_middle_m": np.array([0.4, 0.5, 0.6]),
        "q_span_rad": np.tile([-1.5, 1.5], (arm.n, 1)),
        "time_span_s": (100.0, 4e4),
        "torques": "masses",
        "commanded": True,
        "lifts": (2, 5.0, -80.0),
    }
    return CandidateContext(arm, **usual | known)


def frames(rng, count, spread_m=0.8):
    """Return poses (P, 4, 4) turned any way, within so much of the origin."""
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=rng).as_matrix()
    T[:, :3, 3] = rng.uniform(-spread_m, spread_m, (count, 3))
    return T


def shifted(readings, shift_m, rows=slice(None)):
    """Return readings of which some are seen elsewhere, by (P, 3) or (3,)."""
    T = readings.measured.T_instr_target.copy()
    T[rows, :3, 3] += shift_m
    return readings.with_measured(T_instr_target=T)
