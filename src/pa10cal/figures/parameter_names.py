"""How parameters are written in figures and tables: kind, joint, symbol and unit."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from pa10cal.arm.statics import reported_name
from pa10cal.results.accuracy import Parameter

_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


@dataclass(frozen=True)
class Kind:
    """Parameters of one kind, one a joint."""

    key: str  # begins their names in results
    symbol: str  # as the paper writes it
    title: str  # in words
    unit: str  # to show them in
    scale: float  # from the unit of results to the unit shown
    digits: str  # format of a value in that unit

    def name(self, joint: int) -> str:
        """Return the name in results."""
        return f"{self.key}_{joint}"

    def written(self, joint: int) -> str:
        """Return the symbol with the joint as its index; of a spring the name in results."""
        if self.symbol == self.key:
            return self.name(joint)
        return self.symbol + str(joint).translate(_SUBSCRIPTS)


LINKS = (
    Kind("delta_a", "δa", "link lengths", "mm", 1e3, ".3f"),
    Kind("delta_alpha", "δα", "twists", "mrad", 1e3, ".3f"),
    Kind("delta_d", "δd", "offsets", "mm", 1e3, ".3f"),
    Kind("delta_beta", "δβ", "Hayati angle", "mrad", 1e3, ".3f"),
    Kind("delta_theta", "δθ", "joint zeros", "mrad", 1e3, ".3f"),
)
K_LIN = Kind("K_lin", "K_lin", "linear stiffness", "kN m/rad", 1e-3, ".2f")
K_CUB = Kind("K_cub", "K_cub", "cubic stiffness", "MN m/rad³", 1e-6, ".1f")
#: The base frame: the instrument's origin in it, and the turns to the instrument's axes.
_FRAME = {f"base_p_cmm_{axis}": f"p_{axis}" for axis in "xyz"}
_FRAME |= {f"gamma_{axis}": f"γ_{axis}" for axis in "xyz"}
KINDS = (*LINKS, K_LIN, K_CUB)


def joints_of(kind: Kind, names: list[str]) -> list[int]:
    """Return the joints that have a parameter of a kind, in order."""
    begin = f"{kind.key}_"
    return sorted(int(name.removeprefix(begin)) for name in names if name.startswith(begin))


def written(name: str) -> str:
    """Return a parameter's name as readers see it: `δa₂`, `K_lin_2`, `tool x`."""
    name = reported_name(name)
    for kind in KINDS:
        if name.startswith(f"{kind.key}_") and name.removeprefix(f"{kind.key}_").isdigit():
            joint = int(name.removeprefix(f"{kind.key}_"))
            return kind.written(joint)
    return _FRAME.get(name, name.replace("_", " "))


def listed(names: Iterable[str]) -> str:
    """Return parameters' names as readers see them, one after the other, or that there are none."""
    return ", ".join(map(written, names)) or "none"


def written_load(load: str) -> str:
    """Return a load such as `22N`, as results name it, as readers see it: `22 N`."""
    return f"{load.removesuffix('N')} N"


def std_of(parameter: Parameter) -> float:
    """Return the standard uncertainty of a parameter, nan where there is none."""
    return math.nan if parameter.std is None else parameter.std
