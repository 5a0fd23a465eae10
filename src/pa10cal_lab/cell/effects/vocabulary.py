"""All simulated effects by their ids, and their construction from entries of the settings.

Every class in a module of this folder is found; nothing lists them.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from pa10cal.errors import SettingsError, remedy_for
from pa10cal.settings_reading import parse_section
from pa10cal_lab.cell import effects
from pa10cal_lab.cell.effects.effect import LONG_LINKS, SimulatedEffect
from pa10cal_lab.cell.options import HiddenEffectOptions
from pa10cal_lab.cell.robot import Robot


@cache
def all_effects() -> dict[str, type[SimulatedEffect]]:
    """Return every effect by its id, module by module, each in the order of its file."""
    return classes_in(effects, SimulatedEffect)


def vocabulary() -> dict[str, type[SimulatedEffect]]:
    """Return the effects of the vocabulary that trials draw."""
    return {name: each for name, each in all_effects().items() if each.drawn and each.named}


def nameless() -> dict[str, type[SimulatedEffect]]:
    """Return all effects that trials draw and that have no name in the vocabulary."""
    return {name: each for name, each in all_effects().items() if each.drawn and not each.named}


def outside() -> dict[str, type[SimulatedEffect]]:
    """Return those of `nameless` that every kind of trial may hide."""
    return {name: each for name, each in nameless().items() if not each.wild}


def make_effects(
    entries: Sequence[HiddenEffectOptions], robot: Robot
) -> tuple[SimulatedEffect, ...]:
    """Return the effects of a robot by the entries of its settings.

    Raises:
        SettingsError: for an unknown effect or parameter (naming the nearest right one), a
            parameter that is missing or not finite, or a place where the effect is not possible.
    """
    return tuple(
        _make_effect(entry, robot, f"hidden_effects[{index}]")
        for index, entry in enumerate(entries)
    )


def places_of(names: Sequence[str], robot: Robot, loaded: Sequence[int] = ()) -> list[str]:
    """Return the places of a robot for entries of `places` or `trial_places`.

    Args:
        loaded: joints, from 1, that weights load.
    """
    arm, places = robot.arm, []
    for name in names:
        if name.endswith("joint"):
            places += [f"joint {joint}" for joint in _joints(name.split(), robot, loaded)]
        elif name in LONG_LINKS:
            known = LONG_LINKS[: len(robot.mechanism.long_links)]
            places += [name] if name in known else []
        elif name != "wrist" or (arm.n > 1 and not arm.prismatic[-1]):
            places.append(name)
    return places


def _make_effect(entry: HiddenEffectOptions, robot: Robot, where: str) -> SimulatedEffect:
    known = all_effects()
    if entry.id not in known:
        remedy = remedy_for(entry.id, known, "correct the name")
        raise SettingsError(
            "unknown effect",
            where=f"{where}.id",
            value=entry.id,
            allowed=", ".join(known),
            remedy=remedy,
        )
    kind = known[entry.id]
    places = places_of(kind.places, robot)
    if entry.of not in places:
        allowed = ", ".join(places) or "no such place in this arm"
        raise SettingsError(
            f"{entry.id} cannot sit there",
            where=f"{where}.of",
            value=entry.of,
            allowed=allowed,
            remedy="correct the place",
        )
    return parse_section(kind, entry.parameters, where=f"{where}.parameters").at(entry.of)


def _joints(words: Sequence[str], robot: Robot, loaded: Sequence[int]) -> list[int]:
    """Return the joints, from 1, that have all qualities named by the words before `joint`.

    Only revolute joints are returned, but for the words `any` and `sliding`.
    """
    arm = robot.arm
    qualities = {
        "any": np.full(arm.n, True),
        "sliding": arm.prismatic,
        "turning": ~arm.prismatic,
        "rigid": ~robot.springs.flexible,
        "geared": np.isfinite(arm.gear_ratio),
        "rated": np.isfinite(arm.torque_limit_Nm),
        "loaded": np.isin(np.arange(1, arm.n + 1), loaded),
    }
    turning = not {"any", "sliding"} & {*words}
    fits = qualities["turning" if turning else "any"]
    for word in words[:-1]:
        fits = fits & qualities[word]
    return (np.flatnonzero(fits) + 1).tolist()


def classes_in(package: ModuleType, kind: Any, key: str = "id") -> dict[str, Any]:
    """Return every subclass of a kind that defines an id, or another key, by its value.

    They are ordered by the name of their module and by their place in it: random draws depend on
    the order.
    """
    # This is the place for it: a module that imports whole folders counts as depending on every
    # module beside it (`planning.code`), and elsewhere the workflow would repeat more jobs.
    classes = {}
    for name in sorted(module.name for module in pkgutil.iter_modules(package.__path__)):
        module = import_module(f"{package.__name__}.{name}")
        for each in vars(module).values():
            if (
                isinstance(each, type)
                and issubclass(each, kind)
                and each.__module__ == module.__name__
                and key in vars(each)
            ):
                classes[vars(each)[key]] = each
    return classes
