"""Parts of a trial: an arm at a bench, the plan of its poses, and the hidden effects."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from typing_extensions import override

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import SettingsError
from pa10cal.files.arms import load_arm
from pa10cal.settings_reading import parse_section
from pa10cal_lab.cell.campaign import robot_of
from pa10cal_lab.cell.effects.effect import SimulatedEffect, Site, TorqueLogEffect
from pa10cal_lab.cell.effects.vocabulary import all_effects, places_of
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.poses import joint_bounds
from pa10cal_lab.cell.robot import Robot

Layout = Literal["grid", "wide"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)

#: Factors of the usual size, drawn evenly in their logarithm.
SINGLE_SIZES = (0.1, 3.0)
OTHER_SIZES = (0.7, 3.0)
#: Share of the trials without an effect of temperature in which temperature changes.
DRIFTING = 1.0 / 3.0

#: Touched balls: number of repeats, so that the 60 poses of the wide layout take no longer than the
#: 27 of the grid.
REPEATS: dict[Layout, int] = {"grid": 10, "wide": 4}
#: Usual distance of ball centres from the middle of the machine [m].
HALF_M: dict[Layout, float] = {"grid": 0.2, "wide": 0.8}
MACHINE_MIDDLE_M = 0.4
#: Largest seeds of orientations. For the grid, about one in ten of larger seeds has a pose out of
#: reach.
TILT_SEEDS: dict[Layout, int] = {"grid": 20, "wide": 2**31 - 1}
#: Amplitude of the hall's temperature in a trial that has one.
DRIFT_C = 2.0
#: Coulomb friction of the PA10's joints, and usual torques of joints 2 to 5, which weights load [N
#: m].
COULOMB_NM = (13.336, 23.136, 10.885, 2.301, 5.512, 1.547)
TYPICAL_NM = {2: 75.0, 3: 48.0, 4: 1.5, 5: 6.0}

#: Trackers: number of configurations of a trial, and the share held out.
TRACKED_POSES = 300
DISTANCE_POSES = 430
TRACKED_HOLDOUT = 0.3
#: Coulomb friction of these arms over the rated torque.
COULOMB_PER_RATED = 0.1
#: Bounds of values drawn evenly in the logarithm: noise of a coordinate [mm], noise of an
#: orientation [rad], duration of a configuration [s], mass of the tool [kg].
POSITION_MM = (0.015, 0.05)
ATTITUDE_RAD = (5e-5, 2e-4)
SECONDS_A_POSE = (20.0, 60.0)
TOOL_KG = (0.5, 3.0)
#: Amplitude of the hall's temperature: in these shorter campaigns it causes the same change.
TRACKED_DRIFT_C = 5.0
#: Share of a tracker's trials with loads, which alternate [N]; and numbers of targets of `points`.
LOADED = 0.5
LOADS_N = (0.0, 30.0)
TARGETS = (1, 3)
#: Least variation of the torque of a loaded joint, over the rated torque.
_LEAST_LOADED = 0.02
#: Number of poses for usual torques.
_TYPICAL_POSES = 200


@dataclass(frozen=True)
class Trial:
    """One campaign to be judged without its truth."""

    name: str  # of the campaign; it does not tell what is hidden
    kind: str  # of `trials`
    bench: str  # layout of the poses, or arm and instrument
    settings: SimulateOptions  # of the virtual cell, with the hidden effects
    sizes: tuple[float, ...]  # of each hidden effect, factor of its usual size


@dataclass(frozen=True)
class Bench:
    """An arm under a tracker, and the effects that may be hidden there."""

    robot: str  # name of an arm description
    instrument: str  # kind of the tracker
    flexible_joints: tuple[int, ...] = ()  # joints with a linear spring, of an arm with masses
    logs_torques: bool = False  # whether some of its trials log torques
    targets: int | None = None  # number of targets, if the instrument has several; None draws it
    poses: int = TRACKED_POSES  # number of configurations of a trial
    campaigns: int = 0  # number of campaigns of a trial of drives; 0 for other trials

    touched: ClassVar[bool] = False  # whether balls are touched
    drift_C: ClassVar[float] = TRACKED_DRIFT_C  # swing of the hall's temperature where it drifts

    @property
    def name(self) -> str:
        """Return arm, instrument or number of campaigns, and number of targets if it is fixed."""
        by = self.campaigns or self.instrument
        return "-".join(map(str, filter(None, (self.robot, by, self.targets))))

    @property
    def plan(self) -> dict[str, Any]:
        """Return the keys of `without_touches` that every trial has."""
        flexible = self.flexible_joints
        return {"instrument": self.instrument, "flexible_joints": flexible, "hardening": False}

    @cached_property
    def arm(self) -> Arm:
        """Return the nominal arm."""
        return load_arm(self.robot)

    @cached_property
    def built(self) -> Robot:
        """Return one individual robot."""
        plan = {"built": "drawn"} if self.touched else {"without_touches": self.plan}
        raw = {"robot": self.robot, **plan}
        return robot_of(self.arm, parse_section(SimulateOptions, raw, where=self.name))

    @cached_property
    def typical_Nm(self) -> Array:
        """Return the standard deviation of each joint's torque, (n,)."""
        q = np.random.default_rng(0).uniform(*joint_bounds(self.arm), (_TYPICAL_POSES, self.arm.n))
        torque_Nm = self.built.mechanism.statics(q, np.zeros(len(q))).torque_Nm
        return np.asarray(torque_Nm.std(axis=0))

    @property
    def coulomb_Nm(self) -> Array:
        """(n,) Coulomb friction of the joints."""
        return np.asarray(COULOMB_PER_RATED * np.nan_to_num(self.arm.torque_limit_Nm))

    @property
    def half_m(self) -> float:
        """Return the usual distance of targets from the middle of the measured volume."""
        return 0.5 * self.arm.reach_m

    def middle_m(self, robot: Robot) -> tuple[float, float, float]:
        """Return the middle of the measured volume in the instrument's frame: the base."""
        x_m, y_m, z_m = robot.T_instr_base[:3, 3].tolist()
        return x_m, y_m, z_m

    def drawn_plan(self, rng: np.random.Generator) -> tuple[bool, dict[str, Any]]:
        """Draw whether the temperature drifts, and the settings of the measurement."""
        drifts = bool(rng.random() < DRIFTING)
        has_masses = self.arm.mass_kg is not None
        plan = self.plan | {
            "logs_torques": self.logs_torques and bool(rng.random() < 0.5),
            "loads_N": LOADS_N if has_masses and rng.random() < LOADED else (0.0,),
            "position_mm": log_uniform(POSITION_MM, rng),
            "poses": self.poses,
            "holdout_share": TRACKED_HOLDOUT,
            "seconds_a_pose": log_uniform(SECONDS_A_POSE, rng),
            "tool_mass_kg": round(log_uniform(TOOL_KG, rng), 3),
            "targets": int(rng.choice(TARGETS)),
            "attitude_rad": log_uniform(ATTITUDE_RAD, rng),
        }
        if self.targets is not None:
            plan["targets"] = self.targets
        return drifts, {"without_touches": plan}

    def site(self, of: str, robot: Robot) -> Site:
        """Return the quantities that determine the size of an effect at a place of a robot."""
        rated_Nm, typical_Nm, coulomb_Nm = 0.0, 0.0, 0.0
        if of.startswith("joint "):
            joint = int(of.removeprefix("joint ")) - 1
            rated_Nm = float(np.nan_to_num(self.arm.torque_limit_Nm)[joint])
            typical_Nm, coulomb_Nm = float(self.typical_Nm[joint]), float(self.coulomb_Nm[joint])
        return Site(of, rated_Nm, typical_Nm, coulomb_Nm, self.half_m, self.middle_m(robot))

    def places(self, effect: type[SimulatedEffect]) -> list[str]:
        """Return the places at which an effect acts at this bench."""
        if effect.by_weights and self.arm.mass_kg is None:
            return []
        if issubclass(effect, TorqueLogEffect) and not self.logs_torques:
            return []
        loaded = np.flatnonzero(self.typical_Nm > _LEAST_LOADED * self.arm.torque_limit_Nm) + 1
        soft = [f"joint {joint}" for joint in self.flexible_joints]
        places = places_of(trial_places(effect), self.built, loaded.tolist())
        return [place for place in places if place in soft or not effect.by_spring]


@dataclass(frozen=True)
class TouchedBench(Bench):
    """The PA10 under touched balls, its poses in one of the layouts."""

    robot: str = "pa10_6ce"
    instrument: str = "touch_trigger_cmm"
    flexible_joints: tuple[int, ...] = (1, 2, 3, 4, 5, 6)  # the log shows torques of all of them
    logs_torques: bool = True
    layout: Layout = "grid"

    touched: ClassVar[bool] = True
    drift_C: ClassVar[float] = DRIFT_C

    @property
    def name(self) -> str:
        """Return the layout."""
        return self.layout

    @cached_property
    def typical_Nm(self) -> Array:
        """Return the usual torques of the joints, (n,)."""
        return np.array([TYPICAL_NM.get(joint, 0.0) for joint in range(1, self.arm.n + 1)])

    @property
    def coulomb_Nm(self) -> Array:
        """(n,) Coulomb friction of the joints."""
        return np.array(COULOMB_NM)

    @property
    def half_m(self) -> float:
        """Return the usual distance of ball centres from the middle of the machine."""
        return HALF_M[self.layout]

    @override
    def middle_m(self, robot: Robot) -> tuple[float, float, float]:
        return (MACHINE_MIDDLE_M,) * 3

    @override
    def drawn_plan(self, rng: np.random.Generator) -> tuple[bool, dict[str, Any]]:
        tilt_seed = int(rng.integers(1, TILT_SEEDS[self.layout], endpoint=True))
        settings = {
            "built": "drawn",
            "path": str(rng.choice(["same", "alternating"])),
            "repeats": REPEATS[self.layout],
            "poses": {"layout": self.layout, "tilt_seed": tilt_seed},
        }
        return bool(rng.random() < DRIFTING), settings


@dataclass
class Scenario:
    """A trial while it is drawn."""

    kind: str  # see `Trial`
    rng: np.random.Generator
    bench: Bench
    seed: int  # of the campaign
    settings: dict[str, Any] = field(default_factory=dict)  # further keys of `SimulateOptions`
    hidden: list[dict[str, Any]] = field(default_factory=list)  # effects: id, place, parameters
    sizes: list[float] = field(default_factory=list)  # of each, factor of its usual size

    @property
    def options(self) -> SimulateOptions:
        """Return the options of the virtual cell."""
        own = {"random_seed": self.seed, "robot": self.bench.robot, "hidden_effects": self.hidden}
        where = f"a trial of kind {self.kind}"
        return parse_section(SimulateOptions, own | self.settings, where=where)

    @cached_property
    def robot(self) -> Robot:
        """Return the robot of the campaign; its plan must be drawn before."""
        return robot_of(self.bench.arm, self.options)

    def hide(self, effect: type[SimulatedEffect], size: float, site: Site | None = None) -> None:
        """Hide an effect, unless it is hidden already at the same place.

        Args:
            size: factor of its usual size.
            site: its place; None draws one where it acts at the bench.
        """
        if effect.without_axes is not None and not self.bench.touched:
            effect = effect.without_axes
        if site is None:
            of = str(self.rng.choice(self.bench.places(effect)))
            site = self.bench.site(of, self.robot)
        parameters = effect.at_size(site, size, self.rng)
        if all((effect.id, site.of) != (other["id"], other["of"]) for other in self.hidden):
            self.put(effect.id, site.of, parameters, size)

    def put(self, id: str, of: str, parameters: dict[str, Any], size: float) -> None:
        """Hide an effect of given parameters."""
        self.hidden.append({"id": id, "of": of, "parameters": parameters})
        self.sizes.append(size)

    @property
    def effects(self) -> list[type[SimulatedEffect]]:
        """Return the classes of the hidden effects."""
        return [all_effects()[entry["id"]] for entry in self.hidden]

    def trial(self, name: str = "blind") -> Trial:
        """Return the trial; its name is that with the seed."""
        sizes = tuple(self.sizes)
        return Trial(f"{name}-{self.seed:08x}", self.kind, self.bench.name, self.options, sizes)


def trial_places(effect: type[SimulatedEffect]) -> tuple[str, ...]:
    """Return the places where trials hide an effect, as `SimulatedEffect.places` has them."""
    return effect.trial_places or effect.places


def log_uniform(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    """Draw a number evenly in its logarithm."""
    return float(np.exp(rng.uniform(*np.log(bounds))))


def idle(what: str, benches: Iterable[str], allowed: str) -> SettingsError:
    """Return that an effect or a disturbance does nothing at any of some benches."""
    return SettingsError(
        f"{what} does nothing at any of the benches",
        where="benches",
        value=", ".join(benches),
        allowed=allowed,
        remedy="add one",
    )
