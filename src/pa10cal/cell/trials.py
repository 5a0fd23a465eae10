"""Trials: campaigns drawn at random, each with what it hides, to put a verdict to the test.

These are of touched balls with repeats, of the PA10; those of trackers are in `tracker_trials`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.cell.effects.effect import Effect, Site
from pa10cal.cell.effects.vocabulary import all_effects, outside, places_of, vocabulary
from pa10cal.cell.individual import build_robot
from pa10cal.cell.instruments.touch_trigger_cmm import UNCERTAINTY_MM
from pa10cal.cell.options import SimulateOptions
from pa10cal.cell.robot import Robot
from pa10cal.errors import SettingsError
from pa10cal.files.arms import load_arm
from pa10cal.settings_reading import parse_section

Layout = Literal["grid", "wide"]
TrialKind = Literal["null", "single", "pair", "triple", "outside", "wrong_noise", "wrong_mass"]
KINDS: tuple[TrialKind, ...] = get_args(TrialKind)
LAYOUTS: tuple[Layout, ...] = get_args(Layout)

ROBOT = "pa10_6ce"
#: Factors of the usual size, drawn evenly in their logarithm.
SINGLE_SIZES = (0.1, 3.0)
OTHER_SIZES = (0.7, 3.0)
#: Repeats, so that the 60 poses of the wide layout take no longer than the 27 of the grid.
REPEATS: dict[Layout, int] = {"grid": 10, "wide": 4}
#: How far the ball centres of a layout mostly lie from the middle of the machine [m].
HALF_M: dict[Layout, float] = {"grid": 0.2, "wide": 0.8}
MACHINE_MIDDLE_M = 0.4
#: Attitudes are drawn with seeds from 1 to these. Of the grid's, about one in ten beyond needs a
#: pose out of reach.
TILT_SEEDS: dict[Layout, int] = {"grid": 20, "wide": 2**31 - 1}
#: Swing of the hall's temperature in a trial that has one, and the part of the trials without an
#: effect of temperature that have one nevertheless.
DRIFT_C = 2.0
DRIFTING = 1.0 / 3.0
#: By what factor, up or down, a wrong statement of the instrument is wrong.
NOISE_FACTORS = (1.5, 4.0)
#: By what part, more or less, the mass of one link is wrong. The first link loads no joint.
MASS_EXCESS = (0.1, 0.3)
#: Coulomb friction of the PA10's joints, and torques under which joints 2 to 5, those that weights
#: load, usually stand [N m].
COULOMB_NM = (13.336, 23.136, 10.885, 2.301, 5.512, 1.547)
TYPICAL_NM = {2: 75.0, 3: 48.0, 4: 1.5, 5: 6.0}

MEMBERS: dict[TrialKind, int] = {"single": 1, "outside": 1, "pair": 2, "triple": 3}


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

    @property
    def size(self) -> float:
        """The smallest of `sizes`, 0 where nothing is hidden."""
        return min(self.sizes, default=0.0)


def draw_trials(
    kind: TrialKind,
    count: int,
    random_seed: int,
    layouts: Sequence[Layout] = LAYOUTS,
    size: float | None = None,
) -> tuple[Trial, ...]:
    """Draw trials of touched balls of one kind; the same arguments give the same trials.

    Every trial has a robot, a layout's attitudes and noise of its own. Singles go through the
    vocabulary in turn, trials outside of it through what it lacks; the layouts take turns as well,
    and from one round of the effects to the next, so that each effect meets every layout.
    Trials of a smaller count are the first of a larger one.

    Args:
        kind: what they hide.
        count: how many.
        random_seed: draws them.
        layouts: layouts of the poses.
        size: factor of the usual size of all effects; None draws it. It changes nothing else.

    Raises:
        SettingsError: for a kind that does not exist.
    """
    refuse_unknown(kind)
    robot = _paper_robot()
    trials = []
    for number in range(count):
        rng = np.random.default_rng([random_seed, KINDS.index(kind), number])
        turn, place = divmod(number, trials_in_turn(kind)) if takes_turns(kind) else (0, number)
        layout = layouts[(turn + place) % len(layouts)]
        trials.append(_touched(kind, number, layout, robot, size, rng))
    return tuple(trials)


def trials_in_turn(kind: TrialKind) -> int:
    """Return the number of effects that trials of a kind go through in turn, 1 of other kinds."""
    return len(hideable(kind)) if takes_turns(kind) else 1


def _touched(
    kind: TrialKind,
    number: int,
    layout: Layout,
    robot: Robot,
    size: float | None,
    rng: np.random.Generator,
) -> Trial:
    seed = int(rng.integers(2**31))
    tilt_seed = int(rng.integers(1, TILT_SEEDS[layout], endpoint=True))
    path = str(rng.choice(["same", "alternating"]))
    drifts = bool(rng.random() < DRIFTING)

    def site(of: str) -> Site:
        joint = joint_of(of)
        return Site(
            of,
            rated_Nm=float(robot.arm.torque_limit_Nm[joint - 1]) if joint else 0.0,
            typical_Nm=TYPICAL_NM.get(joint, 0.0),
            coulomb_Nm=COULOMB_NM[joint - 1] if joint else 0.0,
            half_m=HALF_M[layout],
            middle_m=(MACHINE_MIDDLE_M,) * 3,
        )

    known = hideable(kind)
    bounds = SINGLE_SIZES if kind == "single" else OTHER_SIZES
    hidden: list[dict[str, Any]] = []
    sizes: list[float] = []
    while len(hidden) < MEMBERS.get(kind, 0):
        name = in_turn(number, known) if takes_turns(kind) else str(rng.choice(list(known)))
        drawn = log_uniform(bounds, rng)
        factor = drawn if size is None else size
        places = places_of(trial_places(known[name]), robot, tuple(TYPICAL_NM))
        hide(hidden, sizes, known[name], site(str(rng.choice(places))), factor, rng)
    raw = {
        "random_seed": seed,
        "robot": ROBOT,
        "built": "drawn",
        "hidden_effects": hidden,
        "path": path,
        "repeats": REPEATS[layout],
        "temperature_drift_C": DRIFT_C if drifts or by_temperature(hidden) else 0.0,
        "poses": {"layout": layout, "tilt_seed": tilt_seed},
        **misstated(kind, robot.arm, UNCERTAINTY_MM, rng),
    }
    settings = parse_section(SimulateOptions, raw, where=f"trial {number}")
    return Trial(f"blind-{seed:08x}", kind, layout, settings, tuple(sizes))


def hideable(kind: TrialKind) -> dict[str, type[Effect]]:
    """Return the effects that trials of a kind may hide, by name."""
    return outside() if kind == "outside" else vocabulary()


def takes_turns(kind: TrialKind) -> bool:
    """Return whether trials of a kind go through their effects one after the other."""
    return kind in ("single", "outside")


def in_turn(number: int, known: dict[str, type[Effect]]) -> str:
    """Return the name of the effect whose turn it is."""
    return list(known)[number % len(known)]


def trial_places(effect: type[Effect]) -> tuple[str, ...]:
    """Return where trials put an effect, in the words of `Effect.places`."""
    return effect.trial_places or effect.places


def hide(
    hidden: list[dict[str, Any]],
    sizes: list[float],
    effect: type[Effect],
    site: Site,
    size: float,
    rng: np.random.Generator,
) -> None:
    """Hide an effect, none twice at one place."""
    parameters = effect.at_size(site, size, rng)
    if all((effect.id, site.of) != (other["id"], other["of"]) for other in hidden):
        hidden.append({"id": effect.id, "of": site.of, "parameters": parameters})
        sizes.append(size)


def joint_of(place: str) -> int:
    """Return the number of the joint that a place names, 0 of none."""
    return int(place.removeprefix("joint ")) if place.startswith("joint ") else 0


def by_temperature(hidden: Sequence[dict[str, Any]]) -> bool:
    """Return whether one of the hidden effects needs a temperature that changes."""
    return any(all_effects()[entry["id"]].by_temperature for entry in hidden)


def log_uniform(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    """Draw a number evenly in its logarithm."""
    return float(np.exp(rng.uniform(*np.log(bounds))))


def misstated(
    kind: TrialKind, arm: Arm, uncertainty_mm: float, rng: np.random.Generator
) -> dict[str, Any]:
    """Draw what a campaign of this kind states wrongly."""
    up = float(rng.choice([-1.0, 1.0]))
    if kind == "wrong_noise":
        factor = float(np.exp(up * rng.uniform(*np.log(NOISE_FACTORS))))
        return {"stated_uncertainty_mm": uncertainty_mm * factor}
    if kind == "wrong_mass" and arm.mass_kg is not None:
        factors = np.ones(arm.n)
        factors[rng.integers(1, arm.n)] += up * rng.uniform(*MASS_EXCESS)
        return {"mass_factor": factors.tolist()}
    return {}


def refuse_unknown(kind: str) -> None:
    """Refuse a kind of trial that does not exist."""
    if kind not in KINDS:
        raise SettingsError(
            "unknown kind of trial",
            where="kind",
            value=kind,
            allowed=", ".join(KINDS),
            remedy="name one of these",
        )


def _paper_robot() -> Robot:
    """Return one robot of the kind that trials of touched balls draw."""
    settings = SimulateOptions(robot=ROBOT, built="drawn")
    return build_robot(load_arm(ROBOT), settings, "text_e7", np.random.default_rng(0))
