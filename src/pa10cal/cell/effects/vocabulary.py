"""The effects the cell knows, by name, and how a settings entry becomes one of them.

`LIBRARY` is the vocabulary; what `outside.OUTSIDE` lists can be hidden too, but has no name in it.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from pa10cal.cell.built import BuiltRobot
from pa10cal.cell.effects.instrument import CmmScale, CmmSquareness, ToolSag
from pa10cal.cell.effects.joint import (
    Backlash,
    EncoderEccentricity,
    EncoderEllipticity,
    FrictionTorque,
    GearRatioError,
    JointCompliance,
    JointErrorMap,
    SoftWindup,
    TorqueGain,
    TransmissionError,
    WristCoupling,
)
from pa10cal.cell.effects.kinds import LONG_LINKS, Effect, Shape
from pa10cal.cell.effects.outside import OUTSIDE
from pa10cal.cell.effects.structure import (
    BaseCompliance,
    BaseDrift,
    LinkBending,
    LinkTorsion,
    ThermalGrowth,
)
from pa10cal.cell.mechanism import Mechanism
from pa10cal.errors import SettingsError
from pa10cal.settings import HiddenEffectSettings, parse_section

#: Every effect of the vocabulary.
LIBRARY: dict[str, type[Effect]] = {
    effect.id: effect
    for effect in (
        TransmissionError,
        EncoderEccentricity,
        EncoderEllipticity,
        JointErrorMap,
        GearRatioError,
        Backlash,
        FrictionTorque,
        TorqueGain,
        JointCompliance,
        SoftWindup,
        WristCoupling,
        LinkBending,
        LinkTorsion,
        BaseCompliance,
        BaseDrift,
        ThermalGrowth,
        ToolSag,
        CmmScale,
        CmmSquareness,
    )
}


def make_effects(entries: Sequence[HiddenEffectSettings], robot: BuiltRobot) -> tuple[Effect, ...]:
    """Turn settings entries into effects of this robot.

    Raises:
        SettingsError: for an unknown effect or parameter (naming the nearest right one), a
            parameter that is missing or not finite, or a place where the effect cannot sit.
    """
    return tuple(
        _make_effect(entry, robot, f"hidden_effects[{index}]")
        for index, entry in enumerate(entries)
    )


def _make_effect(entry: HiddenEffectSettings, robot: BuiltRobot, where: str) -> Effect:
    known = {**LIBRARY, **OUTSIDE}
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
    places = [place for name in kind.places for place in _places(name, robot)]
    if entry.of not in places:
        raise SettingsError(
            f"{entry.id} cannot sit there",
            where=f"{where}.of",
            value=entry.of,
            allowed=", ".join(places) or "no place in this arm",
            remedy="correct the place",
        )
    _check_names(kind, entry, f"{where}.parameters")
    parameters = parse_section(kind, entry.parameters, where=f"{where}.parameters")
    return parameters.at(entry.of)


def _check_names(kind: type[Effect], entry: HiddenEffectSettings, where: str) -> None:
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


def _places(name: str, robot: BuiltRobot) -> list[str]:
    """Return the places in this robot that one entry of `Effect.places` stands for."""
    if name == "joint":
        return [f"joint {joint}" for joint in range(1, robot.arm.n + 1)]
    if name == "rigid joint":
        flexible = robot.springs.flexible
        return [f"joint {joint}" for joint in range(1, robot.arm.n + 1) if not flexible[joint - 1]]
    if name in LONG_LINKS:
        known = len(Shape.of(Mechanism.nominal(robot)).long_links)
        return [name] if LONG_LINKS.index(name) < known else []
    if name == "wrist" and robot.arm.n < 2:
        return []
    return [name]
