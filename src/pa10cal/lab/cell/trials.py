"""Trials: campaigns drawn at random, each with what it hides, to put a verdict to the test.

Every kind of trial is a `Scenario` while it is drawn: an arm at a bench, the plan of its poses,
what is hidden, disturbed or stated wrongly. Here are those of touched balls with repeats, of the
PA10, and those of arms under trackers that never come back to a pose.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from typing_extensions import override

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import SettingsError
from pa10cal.files.arms import load_arm
from pa10cal.lab.cell.campaign import robot_of
from pa10cal.lab.cell.effects.effect import Effect, Site, TorqueLogEffect
from pa10cal.lab.cell.effects.vocabulary import all_effects, outside, places_of, vocabulary
from pa10cal.lab.cell.instruments.touch_trigger_cmm import UNCERTAINTY_MM
from pa10cal.lab.cell.options import SimulateOptions
from pa10cal.lab.cell.poses import joint_bounds
from pa10cal.lab.cell.robot import Robot
from pa10cal.settings_reading import parse_section

Layout = Literal["grid", "wide"]
TrialKind = Literal["null", "single", "pair", "triple", "outside", "wrong_noise", "wrong_mass"]
KINDS: tuple[TrialKind, ...] = get_args(TrialKind)
LAYOUTS: tuple[Layout, ...] = get_args(Layout)

#: How many effects a kind hides.
MEMBERS: Mapping[str, int] = {"single": 1, "outside": 1, "pair": 2, "triple": 3}
#: Factors of the usual size, drawn evenly in their logarithm.
SINGLE_SIZES = (0.1, 3.0)
OTHER_SIZES = (0.7, 3.0)
#: Part of the trials without an effect of temperature in which it changes nevertheless.
DRIFTING = 1.0 / 3.0
#: By what factor, up or down, a wrong statement of the instrument is wrong.
NOISE_FACTORS = (1.5, 4.0)
#: By what part, more or less, the mass of one link is wrong. The first link loads no joint.
MASS_EXCESS = (0.1, 0.3)

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
#: Between the streams of two studies.
_APART = 100


@dataclass(frozen=True)
class Trial:
    """One campaign to be judged without its truth."""

    name: str  # of the campaign; gives nothing away
    # `null`: nothing hidden; `single`, `pair`, `triple`: so many effects of the vocabulary;
    # `outside`: one that has no name in it; `wrong_noise`, `wrong_mass`: nothing hidden, but the
    # campaign states a wrong uncertainty, or a link has another mass than the arm's description
    # says; or a kind of `wild_trials`
    kind: str
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
        """Return arm and instrument, or number of campaigns; and of targets that is not drawn."""
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
        raw = {"robot": self.robot, "without_touches": self.plan}
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
        plan = self.plan | {
            "logs_torques": self.logs_torques and bool(rng.random() < 0.5),
            "loads_N": LOADS_N
            if self.arm.mass_kg is not None and rng.random() < LOADED
            else (0.0,),
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

    def uncertainty_mm(self, settings: Mapping[str, Any]) -> float:
        """Return what a reading's coordinates truly scatter by, under settings that were drawn."""
        return float(settings["without_touches"]["position_mm"])

    def drawn_size(self, effect: type[Effect], kind: str, rng: np.random.Generator) -> float:
        """Draw the factor of an effect's usual size in a trial of a kind."""
        return effect.plausible_size if kind == "single" else log_uniform(OTHER_SIZES, rng)

    def site(self, of: str, robot: Robot) -> Site:
        """Return what the size of an effect at a place of a robot goes by."""
        of_joint = {}
        if of.startswith("joint "):
            joint = int(of.removeprefix("joint ")) - 1
            of_joint = {
                "rated_Nm": float(np.nan_to_num(self.arm.torque_limit_Nm[joint])),
                "typical_Nm": float(self.typical_Nm[joint]),
                "coulomb_Nm": float(self.coulomb_Nm[joint]),
            }
        return Site(of, **of_joint, half_m=self.half_m, middle_m=self.middle_m(robot))

    def places(self, effect: type[Effect]) -> list[str]:
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
    layout: Layout = "grid"

    touched: ClassVar[bool] = True
    drift_C: ClassVar[float] = DRIFT_C

    @property
    def name(self) -> str:
        """Return the layout."""
        return self.layout

    @cached_property
    def built(self) -> Robot:
        """One such robot."""
        return robot_of(self.arm, SimulateOptions(robot=self.robot, built="drawn"))

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

    @override
    def uncertainty_mm(self, settings: Mapping[str, Any]) -> float:
        return UNCERTAINTY_MM

    @override
    def drawn_size(self, effect: type[Effect], kind: str, rng: np.random.Generator) -> float:
        return log_uniform(SINGLE_SIZES if kind == "single" else OTHER_SIZES, rng)

    def places(self, effect: type[Effect]) -> list[str]:
        """Return where an effect does something at this bench."""
        return places_of(trial_places(effect), self.built, tuple(TYPICAL_NM))


def _benches(
    instrument: str, targets: int | None = None, poses: int = TRACKED_POSES
) -> tuple[Bench, ...]:
    """Return the arms of the trials under an instrument."""
    return (
        Bench("ur10", instrument, (2, 3), targets=targets, poses=poses),
        Bench("irb120", instrument, targets=targets, poses=poses),
        Bench("iiwa14", instrument, (2, 4), logs_torques=True, targets=targets, poses=poses),
    )


def _named(benches: Iterable[Bench]) -> dict[str, Bench]:
    return {bench.name: bench for bench in benches}


#: Benches of each study by their names. The last three are what most laboratories have: no
#: orientation is measured. A distance is one number a pose, which needs more of them.
STUDIES: dict[str, dict[str, Bench]] = {
    "touched": _named(TouchedBench(layout=layout) for layout in LAYOUTS),
    "tracked": _named((*_benches("pose"), *_benches("points"))),
    "points_one": _named(_benches("points", targets=1)),
    "points_three": _named(_benches("points", targets=3)),
    "distance": _named(_benches("distance", poses=DISTANCE_POSES)),
}


@dataclass
class Scenario:
    """A trial while it is drawn."""

    kind: str  # as of `Trial`
    number: int  # of the trial
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
        return parse_section(SimulateOptions, of | self.settings, where=f"trial {self.number}")

    @cached_property
    def robot(self) -> Robot:
        """The robot of the campaign, once its plan is drawn."""
        return robot_of(self.bench.arm, self.options)

    def hide(self, effect: type[Effect], size: float, site: Site | None = None) -> None:
        """Hide an effect at some times its usual size, none twice at one place.

        Args:
            size: factor of its usual size.
            site: where; None draws a place where it does something at the bench.
        """
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
    def effects(self) -> list[type[Effect]]:
        """The kinds of the hidden effects."""
        return [all_effects()[entry["id"]] for entry in self.hidden]

    def trial(self, name: str = "blind") -> Trial:
        """Return the trial, under a name that begins so."""
        sizes = tuple(self.sizes)
        return Trial(f"{name}-{self.seed:08x}", self.kind, self.bench.name, self.options, sizes)


def draw_trials(
    kind: TrialKind,
    count: int,
    random_seed: int,
    study: str = "touched",
    benches: Sequence[str] = (),
    size: float | None = None,
) -> tuple[Trial, ...]:
    """Draw trials of one kind; the same arguments give the same trials.

    Every trial has a robot, poses and noise of its own. Singles go through the vocabulary in turn,
    trials outside of it through what it lacks, each effect through the benches where it does
    something; of other kinds the benches take turns. Singles of trackers have the size that the
    vocabulary holds for plausible. Trials of a smaller count are the first of a larger one.

    Args:
        study: of `STUDIES`, each drawn apart.
        benches: names of those to use, in this order; none for all of the study.
        size: factor of the usual size of all effects; None draws it. It changes nothing else.

    Raises:
        SettingsError: for a kind or a bench that does not exist, or where the benches are none at
            which an effect does something.
    """
    refuse_unless(kind, KINDS)
    known = STUDIES[study]
    for name in sorted(set(benches)):
        refuse_unless(
            name, known, "--layouts", "no such layout of poses", remedy="correct the name"
        )
    chosen = [known[name] for name in benches or known]
    place = list(STUDIES).index(study)
    stream = KINDS.index(kind) + len(KINDS) * (place > 0) + _APART * max(0, place - 1)
    trials = []
    for number in range(count):
        rng = np.random.default_rng([random_seed, stream, number])
        trials.append(_drawn(kind, number, chosen, size, rng))
    return tuple(trials)


def _drawn(
    kind: TrialKind,
    number: int,
    benches: Sequence[Bench],
    size: float | None,
    rng: np.random.Generator,
) -> Trial:
    bench, known, in_turn = _bench_in_turn(kind, number, benches)
    scenario = Scenario(kind, number, rng, bench, int(rng.integers(2**31)))
    drifts, settings = bench.drawn_plan(rng)
    scenario.settings |= settings
    while len(scenario.hidden) < MEMBERS.get(kind, 0):
        effect = in_turn or known[str(rng.choice(list(known)))]
        drawn = bench.drawn_size(effect, kind, rng)
        scenario.hide(effect, drawn if size is None else size)
    if not bench.touched:
        plan = settings["without_touches"]
        plan["logs_torques"] |= any(issubclass(e, TorqueLogEffect) for e in scenario.effects)
    warms = drifts or any(effect.by_temperature for effect in scenario.effects)
    scenario.settings["temperature_drift_C"] = bench.drift_C if warms else 0.0
    scenario.settings |= _misstated(scenario, bench.uncertainty_mm(settings))
    return scenario.trial()


def _misstated(scenario: Scenario, uncertainty_mm: float) -> dict[str, Any]:
    """Draw what a campaign states wrongly."""
    kind, rng, arm = scenario.kind, scenario.rng, scenario.bench.arm
    up = float(rng.choice([-1.0, 1.0]))
    if kind == "wrong_noise":
        factor = float(np.exp(up * rng.uniform(*np.log(NOISE_FACTORS))))
        return {"stated_uncertainty_mm": uncertainty_mm * factor}
    if kind == "wrong_mass" and arm.mass_kg is not None:
        factors = np.ones(arm.n)
        factors[rng.integers(1, arm.n)] += up * rng.uniform(*MASS_EXCESS)
        return {"mass_factor": factors.tolist()}
    return {}


def _bench_in_turn(
    kind: TrialKind, number: int, benches: Sequence[Bench]
) -> tuple[Bench, dict[str, type[Effect]], type[Effect] | None]:
    """Return the bench of a trial, the effects that may be hidden there, and whose turn it is."""
    known = hideable(kind)
    if kind in ("single", "outside"):
        turn, place = divmod(number, len(known))
        effect = list(known.values())[place]
        fit = [bench for bench in benches if bench.places(effect)]
        if not fit:
            names = [bench.name for bench in benches]
            raise idle(effect.id, names, "an arm with masses and logged torques among them")
        # Layouts of touched balls take turns from effect to effect as well.
        return fit[(turn + place * fit[0].touched) % len(fit)], known, effect
    bench = benches[number % len(benches)]
    return bench, {name: each for name, each in known.items() if bench.places(each)}, None


def hideable(kind: TrialKind) -> dict[str, type[Effect]]:
    """Return the effects that trials of a kind may hide, by name."""
    return outside() if kind == "outside" else vocabulary()


def trial_places(effect: type[Effect]) -> tuple[str, ...]:
    """Return where trials put an effect, in the words of `Effect.places`."""
    return effect.trial_places or effect.places


def log_uniform(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    """Draw a number evenly in its logarithm."""
    return float(np.exp(rng.uniform(*np.log(bounds))))


def refuse_unless(
    value: str,
    known: Collection[str],
    where: str = "kind",
    problem: str = "unknown kind of trial",
    remedy: str = "name one of these",
) -> None:
    """Refuse a word that is none of those known.

    Raises:
        SettingsError: for such a word.
    """
    if value not in known:
        allowed = ", ".join(known)
        raise SettingsError(problem, where=where, value=value, allowed=allowed, remedy=remedy)


def idle(what: str, benches: Iterable[str], allowed: str) -> SettingsError:
    """Return that an effect or a disturbance does nothing at any of some benches."""
    return SettingsError(
        f"{what} does nothing at any of the benches",
        where="benches",
        value=", ".join(benches),
        allowed=allowed,
        remedy="add one",
    )
