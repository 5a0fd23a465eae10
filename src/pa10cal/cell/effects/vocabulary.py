"""The effects the cell knows, by name, and how a settings entry becomes one of them.

An effect is known once its class is in a module of this folder.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from functools import cache

import numpy as np

from pa10cal.cell import effects
from pa10cal.cell.classes import classes_in
from pa10cal.cell.effects.effect import LONG_LINKS, Effect
from pa10cal.cell.options import HiddenEffectOptions
from pa10cal.cell.robot import Robot
from pa10cal.errors import SettingsError
from pa10cal.settings_reading import parse_section


@cache
def all_effects() -> dict[str, type[Effect]]:
    """Return every effect by its id, module by module, each in the order of its file."""
    return classes_in(effects, Effect)


def vocabulary() -> dict[str, type[Effect]]:
    """Return the effects of the vocabulary that trials draw."""
    return {name: each for name, each in _drawn().items() if each.named}


def outside() -> dict[str, type[Effect]]:
    """Return the effects without a name in the vocabulary that every kind of trial may hide."""
    return {name: each for name, each in nameless().items() if not each.wild}


def nameless() -> dict[str, type[Effect]]:
    """Return all effects that trials draw and that have no name in the vocabulary."""
    return {name: each for name, each in _drawn().items() if not each.named}


def _drawn() -> dict[str, type[Effect]]:
    return {name: each for name, each in all_effects().items() if each.drawn}


def make_effects(entries: Sequence[HiddenEffectOptions], robot: Robot) -> tuple[Effect, ...]:
    """Turn settings entries into effects of this robot.

    Raises:
        SettingsError: for an unknown effect or parameter (naming the nearest right one), a
            parameter that is missing or not finite, or a place where the effect cannot sit.
    """
    return tuple(
        _make_effect(entry, robot, f"hidden_effects[{index}]")
        for index, entry in enumerate(entries)
    )


def places_of(names: Sequence[str], robot: Robot, loaded: Sequence[int] = ()) -> list[str]:
    """Return the places in a robot that entries of `places` or `trial_places` stand for.

    Args:
        names: the entries.
        robot: as built.
        loaded: joints, from 1, that weights load.
    """
    return [place for name in names for place in _places(name, robot, loaded)]


def _make_effect(entry: HiddenEffectOptions, robot: Robot, where: str) -> Effect:
    known = all_effects()
    kind = known.get(entry.id)
    if kind is None:
        near = difflib.get_close_matches(entry.id, known, n=1, cutoff=0.0)[0]
        raise SettingsError(
            "unknown effect",
            where=f"{where}.id",
            value=entry.id,
            allowed=", ".join(known),
            remedy=f"did you mean {near!r}?",
        )
    places = places_of(kind.places, robot)
    if entry.of not in places:
        raise SettingsError(
            f"{entry.id} cannot sit there",
            where=f"{where}.of",
            value=entry.of,
            allowed=", ".join(places) or "no such place in this arm",
            remedy="correct the place",
        )
    _check_names(kind, entry, f"{where}.parameters")
    parameters = parse_section(kind, entry.parameters, where=f"{where}.parameters")
    return parameters.at(entry.of)


def _check_names(kind: type[Effect], entry: HiddenEffectOptions, where: str) -> None:
    """Refuse a parameter that the effect does not have, or one that is missing."""
    known = {name: field.description for name, field in kind.model_fields.items()}
    unknown = [name for name in entry.parameters if name not in known]
    missing = [name for name in known if name not in entry.parameters]
    allowed = "; ".join(f"{name}: {meaning}" for name, meaning in known.items())
    if unknown:
        near = difflib.get_close_matches(unknown[0], missing or known, n=1, cutoff=0.0)
        raise SettingsError(
            f"{entry.id} has no parameter {unknown[0]}",
            where=where,
            allowed=allowed,
            remedy=f"did you mean {near[0]!r}?",
        )
    if missing:
        raise SettingsError(
            f"{entry.id} lacks its parameter {missing[0]}",
            where=where,
            allowed=allowed,
            remedy=f"give {missing[0]}",
        )


def _places(name: str, robot: Robot, loaded: Sequence[int]) -> list[str]:
    """Return the places in this robot that one entry stands for."""
    if name.endswith("joint"):
        return [f"joint {joint}" for joint in _joints(name.split(), robot, loaded)]
    if name in LONG_LINKS:
        known = len(robot.mechanism.long_links)
        return [name] if LONG_LINKS.index(name) < known else []
    if name == "wrist" and (robot.arm.n < 2 or robot.arm.prismatic[-1]):
        return []
    return [name]


def _joints(words: Sequence[str], robot: Robot, loaded: Sequence[int]) -> list[int]:
    """Return the joints, from 1, that turn and are all that some words say of them."""
    arm = robot.arm
    qualities = {
        "turning": ~arm.prismatic,
        "rigid": ~robot.springs.flexible,
        "geared": np.isfinite(arm.gear_ratio),
        "rated": np.isfinite(arm.torque_limit_Nm),
        "loaded": np.isin(np.arange(1, arm.n + 1), loaded),
    }
    fits = ~arm.prismatic
    for word in words[:-1]:
        fits = fits & qualities[word]
    return (np.flatnonzero(fits) + 1).tolist()
