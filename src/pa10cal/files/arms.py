"""Arm descriptions shipped with the package, one YAML file each."""

from __future__ import annotations

from importlib.resources import files
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import model_validator

from pa10cal.arm.description import Arm
from pa10cal.errors import ArmError
from pa10cal.settings import Section, parse_section


class _Row(Section):
    theta_deg: float
    d_m: float
    a_m: float
    alpha_deg: float
    hayati: bool = False
    prismatic: bool = False


class _ArmFile(Section):
    name: str
    title: str
    convention: Literal["standard", "modified"]
    rows: tuple[_Row, ...]
    limits_deg: tuple[tuple[float, float], ...]
    gear_ratio: tuple[float, ...]
    torque_limit_Nm: tuple[float, ...]
    mass_kg: tuple[float, ...] | None = None
    com_m: tuple[tuple[float, float, float], ...] | None = None

    @model_validator(mode="after")
    def _has_rows(self) -> _ArmFile:
        if not self.rows:
            raise ValueError("at least one row")
        return self


def arm_names() -> list[str]:
    """Return the names of the shipped arms."""
    folder = files("pa10cal.files").joinpath("arms")
    return sorted(
        entry.name.removesuffix(".yaml")
        for entry in folder.iterdir()
        if entry.name.endswith(".yaml")
    )


def load_arm(name: str) -> Arm:
    """Load a shipped arm.

    Raises:
        ArmError: when no arm of that name is shipped.
    """
    if name not in arm_names():
        raise ArmError(
            "unknown robot",
            where="robot",
            value=name,
            allowed=", ".join(arm_names()),
            remedy="correct the name or add a description",
        )
    text = files("pa10cal.files").joinpath("arms", f"{name}.yaml").read_text(encoding="utf-8")
    return parse_arm(yaml.safe_load(text), where=f"{name}.yaml")


def parse_arm(raw: Any, *, where: str) -> Arm:
    """Build an arm from the content of its YAML file."""
    content = parse_section(_ArmFile, raw, where=where)
    rows = content.rows
    return Arm(
        name=content.name,
        title=content.title,
        convention=content.convention,
        theta_rad=np.radians([row.theta_deg for row in rows]),
        d_m=np.array([row.d_m for row in rows]),
        a_m=np.array([row.a_m for row in rows]),
        alpha_rad=np.radians([row.alpha_deg for row in rows]),
        hayati=np.array([row.hayati for row in rows]),
        prismatic=np.array([row.prismatic for row in rows]),
        limits_rad=np.radians(content.limits_deg),
        gear_ratio=np.array(content.gear_ratio),
        torque_limit_Nm=np.array(content.torque_limit_Nm),
        mass_kg=None if content.mass_kg is None else np.array(content.mass_kg),
        com_m=None if content.com_m is None else np.array(content.com_m),
    )
