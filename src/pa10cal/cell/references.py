"""Effects at the size that robots of the PA10's kind have, to be hidden in trials.

One reference a name: where it is put, and its parameters at `size` times the reference. Amplitudes
of drives, encoders and friction are those to expect of harmonic drives of this class (errors of 10
to 30 arc seconds an order, lost motion up to 1 arc minute, motor torque off by a part of the
Coulomb band); those of structure and instrument are such as move the flange by some 0.01 to 0.1 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from pa10cal.cell.effects.kinds import LONG_LINKS
from pa10cal.files.arms import load_arm

Layout = Literal["grid", "wide"]

ROBOT = "pa10_6ce"
ARC_SECOND = np.pi / (180.0 * 3600.0)
JOINTS = tuple(f"joint {joint}" for joint in range(1, 7))
#: Joints that weights load; the axes of joints 1 and 6 point at the weights or stand upright.
LOADED_JOINTS = JOINTS[1:5]
#: Coulomb friction of the joints, and torques under which joints 2 to 5 usually stand [N m].
COULOMB_NM = dict(zip(JOINTS, (13.336, 23.136, 10.885, 2.301, 5.512, 1.547), strict=True))
TYPICAL_NM = dict(zip(LOADED_JOINTS, (75.0, 48.0, 1.5, 6.0), strict=True))
RATED_NM = dict(zip(JOINTS, load_arm(ROBOT).torque_limit_Nm.tolist(), strict=True))
#: Stiffness of a joint for each N m of its rated torque, as of the joints known to yield.
STIFFNESS_PER_RATED = 120.0
#: Swing of the hall's temperature in a trial that has one.
DRIFT_C = 2.0
#: How far the ball centres of a layout mostly lie from the middle of the machine [m].
HALF_M: dict[Layout, float] = {"grid": 0.2, "wide": 0.8}
MACHINE_MIDDLE_M = 0.4
MAP_KNOTS = 8
_MAP_ORDERS = 3


@dataclass(frozen=True)
class Site:
    """Where an effect is put, and in which campaign.

    Attributes:
        of: where it sits.
        layout: of the poses.
    """

    of: str
    layout: Layout


Draw = Callable[[Site, float, np.random.Generator], dict[str, Any]]


@dataclass(frozen=True)
class Reference:
    """How an effect is put into a trial.

    Attributes:
        places: where it may sit so that it does something.
        draw: makes its parameters of the site, the factor of the reference size, and a generator
            for phases, signs and directions.
    """

    places: tuple[str, ...]
    draw: Draw


def _harmonic(arc_seconds: float) -> Draw:
    return lambda _, size, rng: {
        "A": size * arc_seconds * ARC_SECOND,
        "phi": float(rng.uniform(-np.pi, np.pi)),
    }


def _number(name: str, amount: float) -> Draw:
    """Return a parameter whose sign physics gives."""
    return lambda _, size, __: {name: size * amount}


def _either_sign(name: str, amount: float) -> Draw:
    return lambda _, size, rng: {name: size * amount * float(rng.choice([-1.0, 1.0]))}


def _direction(name: str, amount: float) -> Draw:
    """Return three components, `amount` the length of their vector."""

    def draw(_: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        vector = rng.standard_normal(3)
        return {name: (size * amount * vector / np.linalg.norm(vector)).tolist()}

    return draw


def _error_map(_: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
    """Draw a map of the first three orders alike, whose largest knot is 30 arc seconds."""
    angle = 2.0 * np.pi * np.arange(MAP_KNOTS) / MAP_KNOTS
    phase = rng.uniform(-np.pi, np.pi, _MAP_ORDERS)
    waves = np.cos(np.outer(angle, np.arange(1, _MAP_ORDERS + 1)) + phase).sum(axis=1)
    return {"knots": (size * 30.0 * ARC_SECOND * waves / np.abs(waves).max()).tolist()}


def _friction(site: Site, size: float, _: np.random.Generator) -> dict[str, Any]:
    return {"tau_c": size * 0.15 * COULOMB_NM[site.of]}


def _compliance(site: Site, size: float, _: np.random.Generator) -> dict[str, Any]:
    return {"K": STIFFNESS_PER_RATED * RATED_NM[site.of] / size}


def _windup(site: Site, size: float, _: np.random.Generator) -> dict[str, Any]:
    return {"A": size * 1e-4, "tau0": 0.2 * TYPICAL_NM[site.of]}


def _base_compliance(_: Site, size: float, __: np.random.Generator) -> dict[str, Any]:
    return {"cx": size * 1.5e-6, "cy": size * 1.5e-6}


def _dress_pack(site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
    return {"k": size * 0.02 * RATED_NM[site.of], "q0": float(rng.uniform(-0.5, 0.5))}


def _bowed_axis(site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
    axis, along = rng.permutation(3)[:2].tolist()
    return {
        "axis": axis,
        "along": along,
        "sag": size * 2.5e-5 * float(rng.choice([-1.0, 1.0])),
        "half_m": HALF_M[site.layout],
        "centre_m": MACHINE_MIDDLE_M,
    }


#: The vocabulary, name by name.
REFERENCES: dict[str, Reference] = {
    "transmission_error": Reference(JOINTS, _harmonic(20.0)),
    "encoder_eccentricity": Reference(JOINTS, _harmonic(30.0)),
    "encoder_ellipticity": Reference(JOINTS, _harmonic(30.0)),
    "joint_error_map": Reference(JOINTS, _error_map),
    "gear_ratio_error": Reference(JOINTS, _either_sign("eps", 2e-4)),
    "backlash": Reference(JOINTS, _either_sign("b", 20.0 * ARC_SECOND)),
    "friction_torque": Reference(JOINTS, _friction),
    "torque_gain": Reference(LOADED_JOINTS, _either_sign("g", 0.04)),
    "joint_compliance": Reference(("joint 4",), _compliance),
    "soft_windup": Reference(LOADED_JOINTS, _windup),
    "wrist_coupling": Reference(("wrist",), _either_sign("c", 5e-4)),
    "link_bending": Reference(LONG_LINKS, _number("c", 2e-6)),
    "link_torsion": Reference(("forearm",), _number("c", 3e-5)),
    "base_compliance": Reference(("base",), _base_compliance),
    "base_drift": Reference(("base",), _direction("rate", 2e-5)),
    "thermal_growth": Reference(("arm",), _number("alpha", 1.2e-5)),
    "tool_sag": Reference(("tool",), _number("c", 1e-4)),
    "cmm_scale": Reference(("instrument",), _direction("s", 5e-5 * float(np.sqrt(3.0)))),
    "cmm_squareness": Reference(("instrument",), _either_sign("xy", 5e-5)),
}
#: What has no name in it.
OUTSIDE_REFERENCES: dict[str, Reference] = {
    "third_harmonic": Reference(JOINTS, _harmonic(30.0)),
    "bowed_axis": Reference(("instrument",), _bowed_axis),
    "dress_pack": Reference(JOINTS, _dress_pack),
    "hysteresis": Reference(LOADED_JOINTS, _either_sign("h", 60.0 * ARC_SECOND)),
}
