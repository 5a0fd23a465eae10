"""What a trial is made of: an arm at a bench, the plan of its poses, what is hidden in it."""

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
#: Part of the trials without an effect of temperature in which it changes nevertheless.
DRIFTING = 1.0 / 3.0

#: Of touched balls: repeats, so that the 60 poses of the wide layout take no longer than the 27 of
#: the grid.
REPEATS: dict[Layout, int] = {"grid": 10, "wide": 4}
#: How far the ball centres of a layout mostly lie from the middle of the machine [m].
HALF_M: dict[Layout, float] = {"grid": 0.2, "wide": 0.8}
MACHINE_MIDDLE_M = 0.4
#: Orientations are drawn with seeds from 1 to these. Of the grid's, about one in ten beyond needs a
#: pose out of reach.
TILT_SEEDS: dict[Layout, int] = {"grid": 20, "wide": 2**31 - 1}
#: Swing of the hall's temperature in a trial that has one.
DRIFT_C = 2.0
#: Coulomb friction of the PA10's joints, and torques under which joints 2 to 5, those that weights
#: load, usually stand [N m].
COULOMB_NM = (13.336, 23.136, 10.885, 2.301, 5.512, 1.547)
TYPICAL_NM = {2: 75.0, 3: 48.0, 4: 1.5, 5: 6.0}

#: Of trackers: configurations of a trial, and the share held out.
TRACKED_POSES = 300
DISTANCE_POSES = 430
TRACKED_HOLDOUT = 0.3
#: Coulomb friction of these arms, of the rated torque.
COULOMB_PER_RATED = 0.1
#: Bounds between which a tracker's trials are drawn, evenly in the logarithm: noise of a coordinate
#: [mm], noise of an orientation [rad], time a configuration takes [s], mass of the tool [kg].
POSITION_MM = (0.015, 0.05)
ATTITUDE_RAD = (5e-5, 2e-4)
SECONDS_A_POSE = (20.0, 60.0)
TOOL_KG = (0.5, 3.0)
#: Swing of the hall's temperature: over these shorter campaigns it comes to the change of the
#: others.
TRACKED_DRIFT_C = 5.0
#: Part of a tracker's trials with loads, which take turns [N]; and how many targets `points` has.
LOADED = 0.5
LOADS_N = (0.0, 30.0)
TARGETS = (1, 3)
#: A joint whose torque varies by less than this part of the rated torque is not loaded.
_LEAST_LOADED = 0.02
_TYPICAL_POSES = 200


@dataclass(frozen=True)
class Trial:
    """One campaign to be judged without its truth."""

    name: str  # of the campaign; gives nothing away
    kind: str  # of `trials`
    bench: str  # layout of the poses, or arm and instrument
    settings: SimulateOptions  # what the virtual cell is to do, with the hidden effects
    sizes: tuple[float, ...]  # one a hidden effect: factor of its usual size


@dataclass(frozen=True)
class Bench:
    """An arm under a tracker, and what may be hidden there."""

    robot: str  # name of an arm description
    instrument: str  # kind of the tracker
    flexible_joints: tuple[int, ...] = ()  # joints with a linear spring, of an arm with masses
    logs_torques: bool = False  # whether some of its trials log torques
    targets: int | None = None  # how many an instrument of several sees; None draws that
    poses: int = TRACKED_POSES  # configurations of a trial
    campaigns: int = 0  # in how many a trial of drives measures it; 0 for other trials

    touched: ClassVar[bool] = False  # whether balls are touched
    drift_C: ClassVar[float] = TRACKED_DRIFT_C  # swing of the hall's temperature where it drifts

    @property
    def name(self) -> str:
        """Arm and instrument, or number of campaigns; and of targets that is not drawn."""
        by = self.campaigns or self.instrument
        return "-".join(map(str, filter(None, (self.robot, by, self.targets))))

    @property
    def plan(self) -> dict[str, Any]:
        """Return what `without_touches` holds in every trial."""
        flexible = self.flexible_joints
        return {"instrument": self.instrument, "flexible_joints": flexible, "hardening": False}

    @cached_property
    def arm(self) -> Arm:
        """The arm as described."""
        return load_arm(self.robot)

    @cached_property
    def built(self) -> Robot:
        """One such robot."""
        plan = {"built": "drawn"} if self.touched else {"without_touches": self.plan}
        raw = {"robot": self.robot, **plan}
        return robot_of(self.arm, parse_section(SimulateOptions, raw, where=self.name))

    @cached_property
    def typical_Nm(self) -> Array:
        """(n,) torques of the joints, root mean square about their mean."""
        q = np.random.default_rng(0).uniform(*joint_bounds(self.arm), (_TYPICAL_POSES, self.arm.n))
        torque_Nm = self.built.mechanism.statics(q, np.zeros(len(q))).torque_Nm
        return np.asarray(torque_Nm.std(axis=0))

    @property
    def coulomb_Nm(self) -> Array:
        """(n,) Coulomb friction of the joints."""
        friction_Nm: Array = COULOMB_PER_RATED * np.nan_to_num(self.arm.torque_limit_Nm)
        return friction_Nm

    @property
    def half_m(self) -> float:
        """How far targets mostly lie from the middle of the measured volume."""
        return 0.5 * self.arm.reach_m

    def middle_m(self, robot: Robot) -> tuple[float, float, float]:
        """Return the middle of the measured volume in the instrument's frame: the base."""
        x_m, y_m, z_m = robot.T_instr_base[:3, 3].tolist()
        return x_m, y_m, z_m

    def drawn_plan(self, rng: np.random.Generator) -> tuple[bool, dict[str, Any]]:
        """Draw whether the temperature drifts, and the settings of how the arm is measured."""
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
        """Return what the size of an effect at a place of a robot goes by."""
        rated_Nm, typical_Nm, coulomb_Nm = 0.0, 0.0, 0.0
        if of.startswith("joint "):
            every = np.nan_to_num(self.arm.torque_limit_Nm), self.typical_Nm, self.coulomb_Nm
            joint = int(of.removeprefix("joint ")) - 1
            rated_Nm, typical_Nm, coulomb_Nm = (float(torques[joint]) for torques in every)
        return Site(of, rated_Nm, typical_Nm, coulomb_Nm, self.half_m, self.middle_m(robot))

    def places(self, effect: type[SimulatedEffect]) -> list[str]:
        """Return where an effect does something at this bench."""
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
        """(n,) torques under which the joints usually stand."""
        return np.array([TYPICAL_NM.get(joint, 0.0) for joint in range(1, self.arm.n + 1)])

    @property
    def coulomb_Nm(self) -> Array:
        """(n,) Coulomb friction of the joints."""
        return np.array(COULOMB_NM)

    @property
    def half_m(self) -> float:
        """How far ball centres mostly lie from the middle of the machine."""
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

    kind: str  # as of `Trial`
    rng: np.random.Generator  # draws it
    bench: Bench
    seed: int  # of the campaign
    settings: dict[str, Any] = field(default_factory=dict)  # what else the cell is to do
    hidden: list[dict[str, Any]] = field(default_factory=list)  # effects: id, place, parameters
    sizes: list[float] = field(default_factory=list)  # factor of the usual size of each

    @property
    def options(self) -> SimulateOptions:
        """What the virtual cell is to do."""
        of = {"random_seed": self.seed, "robot": self.bench.robot, "hidden_effects": self.hidden}
        return parse_section(
            SimulateOptions, of | self.settings, where=f"a trial of kind {self.kind}"
        )

    @cached_property
    def robot(self) -> Robot:
        """The robot of the campaign, once its plan is drawn."""
        return robot_of(self.bench.arm, self.options)

    def hide(self, effect: type[SimulatedEffect], size: float, site: Site | None = None) -> None:
        """Hide an effect at some times its usual size, none twice at one place.

        Args:
            size: factor of its usual size.
            site: where; None draws a place where it does something at the bench.
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
        """Hide an effect of known parameters."""
        self.hidden.append({"id": id, "of": of, "parameters": parameters})
        self.sizes.append(size)

    @property
    def effects(self) -> list[type[SimulatedEffect]]:
        """The kinds of the hidden effects."""
        return [all_effects()[entry["id"]] for entry in self.hidden]

    def trial(self, name: str = "blind") -> Trial:
        """Return the trial, under a name that begins so."""
        sizes = tuple(self.sizes)
        return Trial(f"{name}-{self.seed:08x}", self.kind, self.bench.name, self.options, sizes)


def trial_places(effect: type[SimulatedEffect]) -> tuple[str, ...]:
    """Return where trials put an effect, in the words of `SimulatedEffect.places`."""
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
