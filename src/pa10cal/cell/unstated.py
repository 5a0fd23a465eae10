"""Arms of which a campaign describes the geometry alone: their lengths, and what they truly weigh.

The law of the weights is this module's own: masses fall from joint to joint, whatever the lengths
of the links, and centres of mass lie anywhere along them, or behind the joint as of a
counterbalance.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.cell.mechanism import Mechanism
from pa10cal.cell.options import UnstatedOptions
from pa10cal.cell.robot import Departures
from pa10cal.cell.tool import tool_payload
from pa10cal.errors import SimulationError

#: What campaigns call an arm that is described so.
NAME = "own_arm"
#: Reach [m], and how far the factor of a row scatters about that of the arm, in the logarithm.
REACH_M = (0.3, 3.5)
_ROW_SCATTER = 0.15
#: Mass of an arm of 1 m reach [kg], and the power of the reach with which it grows.
MASS_KG = (8.0, 60.0)
_POWER = (2.5, 3.0)
#: How the masses fall from link to link, their scatter in the logarithm, and the tool's part.
_TAPER = (0.1, 0.6)
_MASS_SCATTER = 0.35
TOOL_SHARE = (0.01, 0.08)
#: Where a link's centre is, of the way to the next joint; of some links behind their joint. It lies
#: off that line by a part of the link's length, and of the reach.
_ALONG = (0.15, 0.75)
_BEHIND = (-0.35, 0.0)
_COUNTERBALANCED = 0.2
_ASIDE = (0.08, 0.01)


def described(arm: Arm, own: UnstatedOptions) -> Arm:
    """Return the arm as the campaign describes it: other lengths, nothing of weights and drives.

    Raises:
        SimulationError: where lengths or weights are not as many as the rows.
    """
    for name in ("lengths", "mass_kg", "com_m"):
        if len(getattr(own, name)) != arm.n:
            raise SimulationError(
                f"{len(getattr(own, name))} entries for {arm.n} rows",
                where=f"without_touches.unstated.{name}",
                allowed=f"{arm.n} entries, one a row",
                remedy="give one a row",
            )
    factor = np.array(own.lengths)
    base, tool = arm.T_base_row1.copy(), arm.T_row_n_ee.copy()
    base[:3, 3] *= factor[0]
    tool[:3, 3] *= factor[-1]
    unknown = np.full(arm.n, np.nan)
    return replace(
        arm,
        name=NAME,
        title="an arm without stated masses",
        a_m=(factor * arm.a_m).round(5),
        d_m=(factor * arm.d_m).round(5),
        limits_rad=np.where(
            arm.prismatic[:, None], factor[:, None] * arm.limits_rad, arm.limits_rad
        ),
        gear_ratio=unknown,
        torque_limit_Nm=unknown,
        mass_kg=None,
        com_m=None,
        T_base_row1=base,
        T_row_n_ee=tool,
    )


def weighed(mechanism: Mechanism, own: UnstatedOptions) -> Mechanism:
    """Return a mechanism with the true weights of its links."""
    return replace(mechanism, mass_kg=np.array(own.mass_kg), com_m=np.array(own.com_m))


def nominal(arm: Arm, own: UnstatedOptions, tool_kg: float) -> Mechanism:
    """Return the arm with its true weights and the geometry that is described."""
    own_arm = described(arm, own)
    bare = Mechanism.of(own_arm, Departures.none(own_arm.n), tool_payload(tool_kg))
    return weighed(bare, own)


def draw_unstated(arm: Arm, rng: np.random.Generator) -> tuple[dict[str, Any], float]:
    """Draw lengths and weights of an arm, as `UnstatedOptions`, and the mass of its tool [kg]."""
    reach_m = float(np.exp(rng.uniform(*np.log(REACH_M))))
    rows = np.exp(rng.normal(0.0, _ROW_SCATTER, arm.n))
    no_weights = {"mass_kg": np.zeros(arm.n).tolist(), "com_m": np.zeros((arm.n, 3)).tolist()}
    scattered = described(arm, UnstatedOptions(lengths=tuple(rows), **no_weights))
    lengths = (reach_m / scattered.reach_m * rows).round(4)
    own = UnstatedOptions(lengths=tuple(lengths.tolist()), **no_weights)

    total_kg = np.exp(rng.uniform(*np.log(MASS_KG))) * reach_m ** rng.uniform(*_POWER)
    fall = np.exp(-rng.uniform(*_TAPER) * np.arange(arm.n))
    shares = fall * np.exp(rng.normal(0.0, _MASS_SCATTER, arm.n))
    mass_kg = total_kg * shares / shares.sum()

    mechanism = nominal(arm, own, 0.0)
    ends_m = np.concatenate([mechanism.placements[1:], mechanism.T_last_ee[None]])[:, :3, 3]
    behind = rng.random(arm.n) < _COUNTERBALANCED
    along = np.where(behind, rng.uniform(*_BEHIND, arm.n), rng.uniform(*_ALONG, arm.n))
    aside_m = _ASIDE[0] * np.linalg.norm(ends_m, axis=1) + _ASIDE[1] * reach_m
    com_m = along[:, None] * ends_m + aside_m[:, None] * rng.standard_normal((arm.n, 3))
    weights = {
        "lengths": lengths.tolist(),
        "mass_kg": mass_kg.round(4).tolist(),
        "com_m": com_m.round(4).tolist(),
    }
    return weights, float(total_kg * np.exp(rng.uniform(*np.log(TOOL_SHARE))))
