"""A campaign of any arm under an instrument that sees it without touching, in memory."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.cell.individual import refuse_unrated
from pa10cal.cell.individual_arm import IndividualArm, draw_individual
from pa10cal.cell.linkage import Rest
from pa10cal.cell.reading import as_written
from pa10cal.cell.wide import joint_bounds
from pa10cal.errors import SimulationError
from pa10cal.settings import SightedPlan

Array = NDArray[np.float64]

#: One configuration takes this long.
BLOCK_S = 10.0


@dataclass(frozen=True)
class SeenPose:
    """What a tracker of poses saw.

    Attributes:
        T_instr_target: (P, 4, 4) its target in the instrument's frame [m].
    """

    T_instr_target: Array


@dataclass(frozen=True)
class SeenTargets:
    """What an instrument of several targets saw.

    Attributes:
        p_instr_m: (P, B, 3) places of the targets; nan where one was not seen.
    """

    p_instr_m: Array


@dataclass(frozen=True)
class SeenDistance:
    """What an instrument of distances saw.

    Attributes:
        d_m: (P,) distance of the target from the instrument's origin.
    """

    d_m: Array


Seen = SeenPose | SeenTargets | SeenDistance


@dataclass(frozen=True)
class SightedTruth:
    """What a campaign hides.

    Attributes:
        individual: the arm as it is, where it stands and where its targets are.
        q_motor: (P, n) positions of the motors [rad, or m of a sliding joint].
        rest: where the links came to rest.
    """

    individual: IndividualArm
    q_motor: Array
    rest: Rest

    def forward(self, q: Array, load_N: Array | float = 0.0) -> Array:
        """Return the true T_base_ee (P, 4, 4) at any motor positions (P, n); see the individual."""
        return self.individual.forward(q, load_N)


@dataclass(frozen=True)
class SightedCampaign:
    """P measured configurations in the order of time, and what they hide.

    Attributes:
        plan: what was asked of the cell.
        random_seed: of all that was drawn.
        kind: (P,) `grid` or `holdout`.
        pose: (P,) labels; the same label is the same command.
        load_N: (P,) external load.
        repeat: (P,) from 1.
        time_s: (P,) times of the readings.
        q: (P, n) logged joint positions [rad, or m of a sliding joint].
        tau_Nm: (P, n) logged torques (forces [N] of sliding joints), or None.
        seen: what the instrument saw.
        truth: what is hidden; never written beside the rest.
    """

    plan: SightedPlan
    random_seed: int
    kind: NDArray[np.str_]
    pose: NDArray[np.str_]
    load_N: Array
    repeat: NDArray[np.int64]
    time_s: Array
    q: Array
    tau_Nm: Array | None
    seen: Seen
    truth: SightedTruth

    def __len__(self) -> int:
        return len(self.pose)


def measure_sighted(arm: Arm, plan: SightedPlan, random_seed: int) -> SightedCampaign:
    """Draw an individual of an arm and measure it; the same arguments give the same campaign.

    Args:
        arm: its description.
        plan: instrument, poses, departures, noise.
        random_seed: draws everything.

    Raises:
        SimulationError: for springs or torques of an arm that has no masses or rated torques, or
            for springs in joints that do not turn.
    """
    streams = _Streams.of(random_seed)
    return measure_individual(draw_individual(arm, plan, streams.individual), plan, random_seed)


def measure_individual(
    individual: IndividualArm, plan: SightedPlan, random_seed: int, postures: Array | None = None
) -> SightedCampaign:
    """Measure an individual that is already there; see `measure_sighted`.

    Args:
        individual: the arm, its base and its targets; `plan` is not asked for these.
        plan: instrument, poses, noise.
        random_seed: draws poses and noise.
        postures: (P, n) positions commanded [rad, or m of a sliding joint], instead of so many
            drawn as the plan asks for.
    """
    arm, streams = individual.arm, _Streams.of(random_seed)
    if postures is None:
        low, high = joint_bounds(arm)
        postures = streams.poses.uniform(low, high, (plan.poses, arm.n))
    commands = as_written(arm, postures)
    count = len(commands)
    held_out = round(plan.holdout_share * count)
    pose, repeat, kind, label = _order(count - held_out, held_out, plan.repeat_every)
    load_N = np.resize(plan.loads_N, count)[pose]
    q_motor = commands[pose]
    rest = individual.linkage.rest(q_motor, load_N)
    off = np.where(arm.prismatic, 1e-3 * plan.resolver_mm, plan.resolver_rad)
    return SightedCampaign(
        plan=plan,
        random_seed=random_seed,
        kind=kind,
        pose=label,
        load_N=load_N,
        repeat=repeat,
        time_s=BLOCK_S * np.arange(1.0, len(pose) + 1.0),
        q=as_written(arm, q_motor + off * streams.resolver.standard_normal(q_motor.shape)),
        tau_Nm=_logged_torques(arm, plan, rest.tau_Nm, streams.torque),
        seen=_see(individual, plan, rest.T_base_ee, streams),
        truth=SightedTruth(individual, q_motor, rest),
    )


@dataclass(frozen=True)
class _Streams:
    """One stream of random numbers a purpose: changing one leaves the others alone."""

    individual: np.random.Generator
    poses: np.random.Generator
    resolver: np.random.Generator
    torque: np.random.Generator
    position: np.random.Generator
    attitude: np.random.Generator
    hidden: np.random.Generator

    @classmethod
    def of(cls, seed: int) -> _Streams:
        children = np.random.SeedSequence(seed).spawn(len(fields(cls)))
        return cls(*(np.random.default_rng(child) for child in children))


def _order(
    grid: int, holdout: int, repeat_every: int
) -> tuple[NDArray[np.intp], NDArray[np.int64], NDArray[np.str_], NDArray[np.str_]]:
    """Return number of the pose, repeat, kind and label of every configuration in its turn.

    Calibration poses come first, then those of them that are repeated, then the held-out ones.
    """
    again = np.arange(repeat_every - 1, grid, repeat_every) if repeat_every else np.arange(0)
    pose = np.concatenate([np.arange(grid), again, np.arange(grid, grid + holdout)])
    repeat = np.ones(len(pose), dtype=np.int64)
    repeat[grid : grid + len(again)] = 2
    kind = np.where(pose < grid, "grid", "holdout")
    labels = np.array(
        [f"P{number:03d}" for number in range(1, grid + 1)]
        + [f"H{number:03d}" for number in range(1, holdout + 1)]
    )
    return pose, repeat, kind, labels[pose]


def _logged_torques(
    arm: Arm, plan: SightedPlan, tau_Nm: Array, rng: np.random.Generator
) -> Array | None:
    if not plan.logs_torques:
        return None
    if arm.mass_kg is None:
        raise SimulationError(
            "the arm has no masses, so its motors hold nothing",
            where=f"robot {arm.name}",
            value="logs_torques: true",
            allowed="an arm description with mass_kg and com_m, or no logged torques",
            remedy="add them to the description or set logs_torques: false",
        )
    refuse_unrated(arm, range(1, arm.n + 1), "logs_torques")
    noise_Nm = plan.torque_fraction * arm.torque_limit_Nm * rng.standard_normal(tau_Nm.shape)
    logged: Array = (tau_Nm + noise_Nm).round(3)
    return logged


def _see(individual: IndividualArm, plan: SightedPlan, T_base_ee: Array, streams: _Streams) -> Seen:
    """Return what the instrument makes of end-effector poses (P, 4, 4)."""
    noise_m = 1e-3 * plan.position_mm
    if plan.instrument == "distance":
        d_m = individual.d_m(T_base_ee)
        return SeenDistance(d_m + noise_m * streams.position.standard_normal(d_m.shape))
    if plan.instrument == "points":
        p_m = individual.p_instr_targets_m(T_base_ee)
        p_m += noise_m * streams.position.standard_normal(p_m.shape)
        p_m[_unseen(p_m.shape[:2], plan.unseen_share, streams.hidden)] = np.nan
        return SeenTargets(p_m)
    T = individual.T_instr_target(T_base_ee)
    T[:, :3, 3] += noise_m * streams.position.standard_normal((len(T), 3))
    turns = Rotation.from_rotvec(plan.attitude_rad * streams.attitude.standard_normal((len(T), 3)))
    T[:, :3, :3] = turns.as_matrix() @ T[:, :3, :3]
    return SeenPose(T)


def _unseen(shape: tuple[int, int], share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw which targets (P, B) are not seen; one of each pose always is."""
    drawn = rng.random(shape)
    unseen: NDArray[np.bool_] = drawn < share
    unseen[np.arange(len(drawn)), drawn.argmax(axis=1)] = False
    return unseen
