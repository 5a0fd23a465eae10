"""A fitted model for other programs: its rigid part, its rows as a table, and what these lack."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arm.chain import Chain, end_pose
from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import TARGET, TOOL_FRAME
from pa10cal.observe.observations import Observations
from pa10cal.terms.of_campaign import is_constant
from pa10cal.terms.offsets import Offsets

#: Kinds of link parameters, their factor to the unit of the table, and that unit.
_KINDS = {
    "theta": (np.degrees(1.0), "deg"),
    "d": (1e3, "mm"),
    "a": (1e3, "mm"),
    "alpha": (np.degrees(1.0), "deg"),
    "beta": (np.degrees(1.0), "deg"),
}
_WHATS = ("nominal", "departure", "calibrated", "u")


@dataclass(frozen=True)
class RigidPart:
    """What a chain of rigid links holds of a fitted model."""

    chain: Chain
    coordinates: Array  # (m,) its coordinates at zero joints, unloaded, up to the flange
    frames: dict[str, Array]  # tool or targets, and their poses (4, 4) in the flange


def rigid_part(model: FittedModel) -> RigidPart:
    """Return the rigid part of a fitted model."""
    chain, coordinates = model.rigid_part()
    names = [f"{TARGET}{name}" for name in model.target_names] or [TOOL_FRAME]
    return RigidPart(chain, coordinates, {name: model.T_flange_frame(name) for name in names})


def beyond_rigid(model: FittedModel, observations: Observations) -> str:
    """Say what a URDF cannot hold of a model, and how much that matters in measured poses."""
    beyond = [term for term in model.model.terms if not is_constant(term)]
    if not beyond:
        return "it holds all that the model has: neither springs nor effects are in it"
    listed = ", ".join(f"{term.id} of {term.of}" for term in beyond)
    try:
        rms_mm, peak_mm = beyond_rigid_mm(model, observations)
    except ModelError as error:
        return f"a URDF cannot hold {listed}; how far these move the flange: {error.what}"
    return (
        f"a URDF cannot hold {listed}; over the {len(observations)} measured poses these move the "
        f"flange by {rms_mm:.3f} mm rms, {peak_mm:.3f} mm at most"
    )


def beyond_rigid_mm(model: FittedModel, observations: Observations) -> tuple[float, float]:
    """Return how far the flange is from that of the rigid part in measured poses, rms and peak.

    Raises:
        ModelError: when the model has springs and the weights that load them are not known.
    """
    states = observations.states
    whole = model.predict(
        states.q_rad,
        load_N=states.load_N,
        arrival=states.arrival,
        temperature_C=states.temperature_C,
        time_s=states.time_s,
        extrapolate=True,
    )
    chain, coordinates = model.rigid_part()
    at = np.tile(coordinates, (len(states), 1))
    at[:, chain.joint_columns] += states.q_rad
    away = whole.T[:, :3, 3] - end_pose(chain, at)[:, :3, 3]
    off_mm = 1e3 * np.linalg.norm(away, axis=1)
    return float(np.sqrt(np.mean(off_mm**2))), float(off_mm.max())


def dh_text(model: FittedModel, mark: str) -> str:
    """Return the rows of the arm: nominal, departure, calibrated, standard uncertainty of each.

    Departures of one coordinate that several terms make are added up. The uncertainty is blank
    where the parameter was no unknown of the fit, or is not known.

    Args:
        model: the fitted model.
        mark: grade, for the last column.
    """
    chain, coordinates = model.rigid_part()
    variance = np.full(len(coordinates), np.nan)
    for term in model.model.terms:
        if isinstance(term, Offsets) and model.covariance is not None:
            own = np.diag(model.covariance)[model.model.columns_of(term)]
            variance[chain.columns(term.coordinates)] = own
    names = [f"{kind}_{what}_{unit}" for kind, (_, unit) in _KINDS.items() for what in _WHATS]
    lines = [",".join(["joint", *names, "grade"])]
    for joint in range(1, chain.arm.n + 1):
        words = [str(joint)]
        for kind, (factor, _) in _KINDS.items():
            (column,) = chain.columns((f"{kind}_{joint}",))
            nominal, found = factor * chain.nominal[column], factor * coordinates[column]
            u = factor * np.sqrt(variance[column])
            words += [f"{value:.9f}" for value in (nominal, found - nominal, found)]
            words.append("" if np.isnan(u) else f"{u:.9f}")
        lines.append(",".join([*words, mark]))
    return "\n".join(lines) + "\n"
