"""A fitted model for other programs: its rigid part, the best rigid model, what these lack."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arm.chain import Chain, end_pose, end_pose_with_screws
from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.files.table_cells import csv_text
from pa10cal.fit.fitted import FLANGE, TARGET, TOOL_FRAME, Fitted
from pa10cal.fit.forward import T_flange_frame, moves_robot, pose_difference, predicted
from pa10cal.observe.observations import Observations
from pa10cal.options import Tolerances
from pa10cal.rules import PARAMETERS
from pa10cal.terms.offsets import link_departures

#: Kinds of link parameters, their factor to the unit of the table, and that unit (unit).
_KINDS = {
    "theta": (np.degrees(1.0), "deg"),
    "d": (1e3, "mm"),
    "a": (1e3, "mm"),
    "alpha": (np.degrees(1.0), "deg"),
    "beta": (np.degrees(1.0), "deg"),
}
_WHATS = ("nominal", "departure", "calibrated", "u")

#: Steps to the nearest rigid model, and one so small that it is the last (computing).
_STEPS, _ARRIVED = 20, 1e-6


@dataclass(frozen=True)
class RigidError:
    """How far a rigid model is from the robot over the poses measured, with their loads.

    The model's own standard uncertainty is in both.
    """

    rms_mm: float
    peak_mm: float
    poses: int  # how many
    frame: str  # whose position it is

    def __str__(self) -> str:
        """Return it in words."""
        return (
            f"{_in_words(self.frame)} is off by {self.rms_mm:.3f} mm rms, "
            f"{self.peak_mm:.3f} mm at most, over the {self.poses} measured poses with their "
            "loads, the model's own uncertainty included"
        )


def _in_words(frame: str) -> str:
    """Return a frame in words: `target_T1` as target T1."""
    _, _, name = frame.partition("target_")
    return f"the {name or frame}" if name in ("", "target") else f"target {name}"


@dataclass(frozen=True)
class RigidPart:
    """A chain of rigid links that stands for a fitted model."""

    chain: Chain
    coordinates: Array  # (m,) its coordinates at zero joints, unloaded, up to the flange
    frames: dict[str, Array]  # tool or targets, and their poses (4, 4) in the flange
    fitted: bool = False  # whether the geometry was fitted to the whole model; else it is its part

    def T_base_flange(self, q: Array) -> Array:
        """Return where the flange is at joint positions (N, n), (N, 4, 4) [m]."""
        return end_pose(self.chain, self._at(q))

    def error(self, model: Fitted, observations: Observations) -> RigidError:
        """Return how far the tool (or first target) is from where the whole model has it.

        Raises:
            ModelError: when the model has springs and the weights that load them are not known.
        """
        whole = predicted(model, observations.states, TOOL_FRAME)
        frame, T_flange_frame = next(iter(self.frames.items()))
        T = self.T_base_flange(observations.states.q_rad) @ T_flange_frame
        off_mm = 1e3 * np.linalg.norm(T[:, :3, 3] - whole.T[:, :3, 3], axis=1)
        off_mm = np.hypot(off_mm, np.nan_to_num(whole.u_mm))
        rms_mm = float(np.sqrt(np.mean(off_mm**2)))
        return RigidError(rms_mm, float(off_mm.max()), len(off_mm), frame)

    def _at(self, q: Array) -> Array:
        at = np.tile(self.coordinates, (len(q), 1))
        at[:, self.chain.joint_columns] += q
        return at


def rigid_part(model: Fitted) -> RigidPart:
    """Return the rigid part of a fitted model."""
    chain, coordinates = model.rigid_part()
    targets = [f"{TARGET}{name}" for name in model.target_names]
    # `tool` is the first target where no campaign measured poses.
    on_tool = [TOOL_FRAME] if model.tools or not targets else []
    names = [*on_tool, *model.tools, *targets]
    return RigidPart(chain, coordinates, {name: T_flange_frame(model, name) for name in names})


def best_rigid_model(model: Fitted, observations: Observations) -> RigidPart:
    """Return the rigid geometry that is nearest to a fitted model over measured poses and loads.

    Least squares over all link parameters of the position of the tool (or first target) and of its
    orientation, at a lever of `PARAMETERS.rigid_lever_m`. Base and tool stay those of the model, as
    do directions of the link parameters that these poses do not determine.

    Raises:
        ModelError: when the model has springs and the weights that load them are not known.
    """
    part, q = rigid_part(model), observations.states.q_rad
    T_flange_tool = next(iter(part.frames.values()))
    T_wanted = predicted(model, observations.states, TOOL_FRAME).T
    links = link_departures(model.arm, Tolerances())
    columns = part.chain.columns(links.coordinates)
    scale = np.array([parameter.scale for parameter in links.parameters])
    weight = np.repeat([1.0, PARAMETERS.rigid_lever_m], 3)
    at = part._at(q)
    departures = np.zeros(len(scale))
    for _ in range(_STEPS):
        end = end_pose_with_screws(part.chain, at, columns.tolist())
        T, moved = end.T @ T_flange_tool, end.screws[:, :, columns]
        arm_m = (end.T[:, :3, :3] @ T_flange_tool[:3, 3])[:, :, None]
        moved[:, :3] += np.cross(moved[:, 3:], arm_m, axis=1)
        rows = (moved * weight[:, None] * scale).reshape(-1, len(scale))
        off = (pose_difference(T, T_wanted) * weight).ravel()
        step = np.linalg.lstsq(rows, off, rcond=PARAMETERS.determined_share)[0]
        departures += scale * step
        at[:, columns] += scale * step
        if np.abs(step).max() < _ARRIVED:
            break
    coordinates = part.coordinates.copy()
    coordinates[columns] += departures
    return RigidPart(part.chain, coordinates, part.frames, fitted=True)


def beyond_rigid(model: Fitted, observations: Observations) -> str:
    """Say what a URDF cannot hold of a model, and how much that matters in measured poses."""
    listed = terms_beyond_rigid(model)
    if not listed:
        return "it holds all that the model has: neither springs nor effects are in it"
    try:
        rms_mm, peak_mm = beyond_rigid_mm(model, observations)
    except ModelError as error:
        return f"a URDF cannot hold {listed}; how far these move the flange: {error.what}"
    return (
        f"a URDF cannot hold {listed}; over the {len(observations)} measured poses these move the "
        f"flange by {rms_mm:.3f} mm rms, {peak_mm:.3f} mm at most"
    )


def terms_beyond_rigid(model: Fitted) -> str:
    """Return the terms of a model that rigid links cannot hold, in words; empty where none is."""
    beyond = [term for term in model.model.terms if not term.constant and moves_robot(term)]
    return ", ".join(f"{term.id} of {term.of}" for term in beyond)


def beyond_rigid_mm(model: Fitted, observations: Observations) -> tuple[float, float]:
    """Return how far the flange is from that of the rigid part in measured poses, rms and peak.

    Raises:
        ModelError: when the model has springs and the weights that load them are not known.
    """
    whole = predicted(model, observations.states, FLANGE)
    rigid = rigid_part(model).T_base_flange(observations.states.q_rad)
    off_mm = 1e3 * np.linalg.norm(whole.T[:, :3, 3] - rigid[:, :3, 3], axis=1)
    return float(np.sqrt(np.mean(off_mm**2))), float(off_mm.max())


def dh_text(
    model: Fitted, mark: str, part: RigidPart | None = None, error: RigidError | None = None
) -> str:
    """Return the rows of the arm: nominal, departure, calibrated, standard uncertainty of each.

    Departures of one coordinate that several terms make are added up. The uncertainty is blank
    where the parameter was no unknown of the fit, or is not known, as in a rigid model fitted to
    the whole one.

    Args:
        mark: grade, for the column of that name.
        part: rigid links whose rows they are; None for the rigid part.
        error: of these, for two last columns; None where it is not known.
    """
    part = rigid_part(model) if part is None else part
    chain, coordinates = part.chain, part.coordinates
    variance = np.full(len(coordinates), np.nan)
    if model.covariance is not None and not part.fitted:
        by_parameters = np.zeros((len(coordinates), len(model.x)))
        for term in model.model.terms:
            if term.constant:
                at = chain.columns(term.coordinates), model.model.parameter_indices(term)
                by_parameters[at] = 1.0
        k, fitted = len(model.x), by_parameters.any(axis=1)
        variances = np.sum((by_parameters @ model.covariance[:k, :k]) * by_parameters, axis=1)
        variance[fitted] = np.maximum(variances[fitted], 0.0)
    names = [f"{kind}_{what}_{unit}" for kind, (_, unit) in _KINDS.items() for what in _WHATS]
    last = {"grade": mark}
    if error is not None:
        last |= {"error_rms_mm": f"{error.rms_mm:.4f}", "error_peak_mm": f"{error.peak_mm:.4f}"}
    rows: list[list[str]] = []
    for joint in range(1, chain.arm.n + 1):
        words = [str(joint)]
        for kind, (factor, _) in _KINDS.items():
            (column,) = chain.columns((f"{kind}_{joint}",))
            nominal, found = factor * chain.nominal[column], factor * coordinates[column]
            u = factor * np.sqrt(variance[column])
            words += [f"{value:.9f}" for value in (nominal, found - nominal, found)]
            words.append("" if np.isnan(u) else f"{u:.9f}")
        rows.append([*words, *last.values()])
    return csv_text(["joint", *names, *last], rows)
