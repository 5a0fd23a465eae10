"""Robots of the virtual cell: measured at planned poses, and commanded through their models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.calibration.options import CalibrationOptions, EffectOfPlace
from pa10cal.campaign import read
from pa10cal.discovery.given import calibrate_with_effects
from pa10cal.discovery.preparation import setup_of
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import pose_difference
from pa10cal.interface import calibrate
from pa10cal.observe.kinds import TrackerKind, instruments
from pa10cal.options import DiscoveryOptions
from pa10cal.pose_plan.expected import covariance_of, expected_rows, target_rms_u_mm
from pa10cal.pose_plan.options import PlanOptions
from pa10cal.pose_plan.plan import plan_poses
from pa10cal.pose_plan.setup import PlanSetup, instrument_named
from pa10cal.terms.model import Model
from pa10cal_lab.cell.campaign import SimulatedCampaign, simulate_campaign
from pa10cal_lab.cell.effects.effect import JointState, with_added
from pa10cal_lab.cell.instruments.instrument import rest_poses
from pa10cal_lab.cell.mechanism import Departures, Mechanism
from pa10cal_lab.cell.options import CellPosesOptions, SimulateOptions, TrackerOptions
from pa10cal_lab.cell.poses import place_poses
from pa10cal_lab.cell.robot import ring_of_targets, tool_payload
from pa10cal_lab.simulated import as_read

#: Test poses in the box: grids of these parts of the paper's spacing, other orientations each.
_INNER_GRIDS = (0.35, 0.7, 1.0)
_TESTED = 200
_ROUNDING_MM = 0.1
_ROUNDING_DEG = 1e-3
_TOOL_KG, _TOOL_COM_MM = 1.0, (0.0, 0.0, 60.0)
_SEED = 1


@dataclass(frozen=True)
class Cell:
    """An arm under an instrument, and the middle of its grid."""

    robot: str  # name of the arm
    instrument: TrackerKind  # what measures
    centre_deg: tuple[float, ...]  # joint angles in the middle of the 3 x 3 x 3 grid
    loads_N: tuple[float, ...] = (0.0,)  # external loads; every pose is measured under each
    flexible_joints: tuple[int, ...] = ()  # joints with a spring
    # position_mm and attitude_rad: noise of a coordinate, and of an orientation
    position_mm: float = 0.03
    attitude_rad: float = 1e-4
    arm: Arm = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "arm", load_arm(self.robot))

    def grid(self, part: float = 1.0, seed: int = _SEED) -> Array:
        """Return the paper's grid about the middle, (27, n), its orientations drawn by a seed.

        Args:
            part: of the paper's spacing.
            seed: draws the orientations.
        """
        nominal = Mechanism.of(self.arm, Departures.none(self.arm.n), tool_payload(_TOOL_KG))
        settings = CellPosesOptions(
            centre_deg=self.centre_deg, spacing_m=(0.125 * part,) * 3, tilt_seed=seed
        )
        return place_poses(self.arm, nominal, settings, 0).grid

    @property
    def targets_mm(self) -> tuple[tuple[float, float, float], ...]:
        """Return where the targets are, as the virtual cell puts them."""
        if instrument_named(self.instrument).measures_pose:
            return ((0.0, 0.0, 0.0),)
        return tuple(map(tuple, (1e3 * ring_of_targets(3).p_ee_m).tolist()))

    def options(self, *, ranges_of_grid: bool, seed: int = 2008) -> PlanOptions:
        """Return the options of a plan whose first target stays in the box of the grid's.

        Args:
            ranges_of_grid: whether every joint stays in the range that the grid takes it through,
                too; else in all of its own.
            seed: draws the candidates.
        """
        q = self.grid()
        T = Chain.of(self.arm).forward(q)
        p_mm = 1e3 * T[:, :3, 3] + T[:, :3, :3] @ np.array(self.targets_mm[0])
        low, high = np.degrees(q.min(axis=0)), np.degrees(q.max(axis=0))
        ranges = np.column_stack([low - _ROUNDING_DEG, high + _ROUNDING_DEG])
        return PlanOptions.model_validate(
            {
                "workspace_mm": (p_mm.min(axis=0) - _ROUNDING_MM, p_mm.max(axis=0) + _ROUNDING_MM),
                "joints_deg": ranges.tolist() if ranges_of_grid else (),
                "floor_mm": None,
                "targets_mm": self.targets_mm,
                "uncertainty_mm": self.position_mm,
                "attitude_mrad": 1e3 * self.attitude_rad,
                "loads_N": self.loads_N,
                "tool_kg": _TOOL_KG,
                "tool_com_mm": _TOOL_COM_MM,
                "effects": 0.0,
                "random_seed": seed,
            }
        )

    def tested(self, options: PlanOptions) -> Array:
        """Return poses within the limits of a plan, others than its candidates, (200, n)."""
        other = options.model_copy(update={"random_seed": 77, "candidates": _TESTED})
        return PlanSetup(self.arm, instrument_named(self.instrument), other).draw(least=1).q

    def tested_like_grid(self) -> Array:
        """Return poses all over the box, with orientations as the grid has them, (81, n)."""
        grids = [self.grid(part, 11 + k) for k, part in enumerate(_INNER_GRIDS)]
        return np.concatenate(grids)

    def planned(self, poses: int, options: PlanOptions) -> Array:
        """Return the poses of a plan, (N, n)."""
        return plan_poses(self.arm, self.instrument, poses, options).q

    def expected_mm(self, q: Array, tested: Array, options: PlanOptions) -> float:
        """Return the tool's expected standard uncertainty over tested poses, rms."""
        setup = PlanSetup(self.arm, instrument_named(self.instrument), options)
        rows = expected_rows(setup, np.concatenate([q, tested]), CalibrationOptions())
        return target_rms_u_mm(rows.target_jacobian[len(q) :], covariance_of(rows.white[: len(q)]))

    def simulated_mm(self, q: Array, tests: list[Array], seed: int) -> list[float]:
        """Measure a robot of the cell at poses, calibrate it, and return the error of its tool.

        Args:
            q: (N, n) where it is measured.
            tests: poses over which the error is taken, rms each; unloaded.
            seed: draws the robot and the noise.
        """
        commanded = np.degrees(np.repeat(q, len(self.loads_N), axis=0))
        plan = TrackerOptions(
            instrument=self.instrument,
            commanded=tuple(map(tuple, commanded.tolist())),
            holdout_share=0.0,
            loads_N=self.loads_N,
            position_mm=self.position_mm,
            attitude_rad=self.attitude_rad,
            unseen_share=0.0,
            flexible_joints=self.flexible_joints,
            hardening=False,
            tool_mass_kg=_TOOL_KG,
        )
        settings = SimulateOptions(random_seed=seed, robot=self.robot, without_touches=plan)
        made, _, model = simulated_model(settings)
        errors = []
        for q_test in tests:
            T = model.T_instr_base @ model.predict(q_test, frame="tool").T
            off_m = T[:, :3, 3] - true_frame(made, q_test)[:, :3, 3]
            errors.append(1e3 * float(np.sqrt(np.mean(np.sum(off_m**2, axis=1)))))
        return errors


# A robot of the virtual cell, commanded through its calibrated model and measured again.


@dataclass(frozen=True)
class Commanded:
    """N targets, commanded through the arm as designed and through its model."""

    before_mm: Array  # (N,) distance of the true tool from the target, commanded as designed
    after_mm: Array  # (N,) the same, commanded through the model
    after_deg: Array  # (N,) angle between them then
    promised_mm: Array  # (N,) standard uncertainty that the model states
    status: NDArray[np.str_]  # (N,) what compensation says of each


def simulated_model(
    settings: SimulateOptions, effects: Sequence[EffectOfPlace] = ()
) -> tuple[SimulatedCampaign, read.Campaign, FittedModel]:
    """Measure a robot of the virtual cell and calibrate it, with effects that are known.

    Args:
        settings: robot, instrument, poses, noise, what is hidden.
        effects: what to calibrate with beyond links and springs.
    """
    made = simulate_campaign("commanded", load_arm(settings.robot), settings)
    campaign = as_read(made)
    model = calibrate(campaign)
    if effects:
        options = CalibrationOptions()
        setup = setup_of(campaign.description, campaign.arm, options, DiscoveryOptions())
        model = calibrate_with_effects(campaign.observations, model, setup, effects).model
    return made, campaign, model


def true_flange(
    made: SimulatedCampaign, q: Array, load_N: float = 0.0, arrival: Array | None = None
) -> Array:
    """Return where the flange of the true robot comes to rest, in its base, (N, 4, 4) [m].

    Args:
        made: its campaign.
        q: (N, n) joint positions commanded.
        load_N: external load.
        arrival: (N, n) direction in which each joint arrived, -1 or 1; None for none.
    """
    truth, zero = made.truth, np.zeros(len(q))
    arrived = np.zeros_like(q) if arrival is None else arrival
    motion = JointState(q, arrived, truth.robot.arm.gear_ratio)
    drive = with_added(q, "drive", truth.effects, motion)
    rest = rest_poses(truth.robot, truth.effects, drive, zero + load_N, zero, zero, arrived)
    return rest.T_base_ee


def true_frame(
    made: SimulatedCampaign,
    q: Array,
    frame: str = "tool",
    load_N: float = 0.0,
    arrival: Array | None = None,
) -> Array:
    """Return where a frame of the true robot is, in the instrument's frame, (N, 4, 4) [m]."""
    robot = made.truth.robot
    T_instr_ee: Array = robot.T_instr_base @ true_flange(made, q, load_N, arrival)
    if frame == "flange":
        return T_instr_ee
    kind = instruments()[made.instrument.kind]
    if kind.measures_pose:
        return T_instr_ee if kind.from_touches else T_instr_ee @ robot.T_ee_target
    T = np.eye(4)
    name = frame.removeprefix("target_")
    at = robot.targets.names.index(name) if name in robot.targets.names else 0
    T[:3, 3] = robot.targets.p_ee_m[at]
    return T_instr_ee @ T


def as_designed(model: FittedModel) -> FittedModel:
    """Return a model whose links and joints are as designed, with base and tool of the fit."""
    tool = tuple(term for term in model.model.terms if term.of == "tool")
    x = np.concatenate([np.zeros(0), *(model.values_of(term) for term in tool)])
    rigid = Model(model.model.chain, tool)
    return replace(model, model=rigid, x=x, covariance=None, falls_back=None)


def command(
    made: SimulatedCampaign,
    model: FittedModel,
    q: Array,
    load_N: float = 0.0,
    arrival: Array | None = None,
) -> Commanded:
    """Command the tool of a robot to where it would be as designed, and see where it comes.

    Args:
        made: the robot's campaign.
        model: its calibrated model.
        q: (N, n) joint positions of the program, as for the arm as designed.
        load_N: external load.
        arrival: (N, n) from which side each joint comes, which nobody tells the model.
    """
    wanted = as_designed(model).predict(q, frame="tool").T
    found = model.compensate(wanted, frame="tool", seed=q, load_N=load_N)
    T_instr_wanted = model.T_instr_base @ wanted
    before, after = (
        pose_difference(true_frame(made, each, load_N=load_N, arrival=arrival), T_instr_wanted)
        for each in (q, found.q)
    )
    return Commanded(
        1e3 * np.linalg.norm(before[:, :3], axis=1),
        1e3 * np.linalg.norm(after[:, :3], axis=1),
        np.degrees(np.linalg.norm(after[:, 3:], axis=1)),
        found.u_mm,
        found.status,
    )
