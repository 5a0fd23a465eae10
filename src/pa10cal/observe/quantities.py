"""Quantities exchanged with instruments: statements, comparisons, starts, table columns.

P is a number of poses, B of targets, b of measured components of a pose, and t of coordinates of
targets, 3 B. A name `by_x` is that of a derivative by x, here as elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Mask, Rows, take_rows
from pa10cal.frame.point_fits import by_small_motion
from pa10cal.rules import FRAMES

AXES = "xyz"
#: A millimetre in metres (unit).
MM = 1e-3
#: Factors that convert position [mm] and rotation [rad], as in the table of poses, to m and rad.
MM_RAD_TO_SI = np.array([MM, MM, MM, 1.0, 1.0, 1.0])


# What an instrument is, in words and by its campaign.


@dataclass(frozen=True)
class StatedByCampaign:
    """Statements of a campaign's description about its instrument."""

    uncertainty_m: float  # standard uncertainty of one measured coordinate or distance
    targets_m: Mapping[str, Array]  # by name, positions (3,) of targets in the end-effector frame
    # standard uncertainty of an orientation about each axis; None where not stated
    attitude_rad: float | None = None
    inverse_poses: bool = (
        False  # whether the instrument's poses in the target's frame were measured
    )

    def places_m(self, names: tuple[str, ...]) -> Array | None:
        """Return the positions (B, 3) of targets; None where one of them is not stated."""
        if not set(names) <= set(self.targets_m):
            return None
        return np.array([self.targets_m[name] for name in names], dtype=float).reshape(-1, 3)


@dataclass(frozen=True)
class Words:
    """Phrases for an instrument and its errors in messages and captions."""

    instrument: str
    error: str  # label of an axis: `position error`
    of: str  # definition of the errors, one sentence
    arrows: str  # definition of the arrows that show errors


# Measured columns of a campaign's own files.


@dataclass(frozen=True)
class RawColumns:
    """Columns of `files.poses` with the measurements of an instrument."""

    # (B,) of each target [mm]: three coordinates or a distance
    targets: tuple[tuple[str, ...], ...]
    others: tuple[str, ...] = ()  # further columns, without unit
    # whether an empty field means that a target was not seen; else it is an error
    may_be_blank: bool = False

    @property
    def lengths(self) -> tuple[str, ...]:
        """Return the columns that are lengths [mm]."""
        return tuple(name for target in self.targets for name in target)

    @property
    def names(self) -> tuple[str, ...]:
        """Return all k columns."""
        return (*self.lengths, *self.others)


@dataclass(frozen=True)
class Unusable:
    """Rows of readable fields that are no measurement."""

    rows: Mask  # (N,) which rows
    reason: str
    values: tuple[str, ...]  # the offending value of each of these rows


# Fits of frames and targets, and their errors.


@dataclass(frozen=True)
class Start:
    """Approximate frames and targets, from which a fit starts."""

    T_instr_base: Array  # (4, 4) base in the instrument's frame [m]
    # (3,) origin of the tool frame in the end-effector frame, where the instrument measures poses
    p_ee_target_m: Array
    # (3, 3) orientation of that frame, by which measured orientations are turned, so that the
    # tool's remaining rotation is small
    R_ee_target: Array
    # (t,) positions of targets in the end-effector frame, x, y, z of each: flat, as unknowns of the
    # fit are
    targets_m: Array
    # (3,) the same as `p_ee_target_m` for each campaign of a group, by name
    p_ee_target_by_campaign_m: Mapping[str, Array] = field(default_factory=dict)
    # whether the campaign states where the targets are
    targets_stated: bool = False


@dataclass(frozen=True)
class Comparison:
    """Predicted minus measured in P poses of b components; zero where nothing was measured."""

    # (P, b) [m], and where an orientation is measured the chord of its difference: axis times
    # 2 sin(angle / 2) [rad]
    residual: Array
    # (P, b, 6) derivative by velocity and angular velocity of the end of the chain, along the
    # instrument's axes
    by_end: Array
    # (P, b, t) derivative by coordinates of targets (t = 0 where the tool is part of the chain)
    by_targets: Array


@dataclass(frozen=True)
class Misfit:
    """Residuals of B targets in P poses about the nominal model, fitted to them."""

    length_m: Array  # (P, B) distances, nan where a target was not seen
    turn_rad: Array  # (P,) angles between orientations; 0 where not measured

    @property
    def size_m(self) -> Array:
        """Return the residual of each pose (P,).

        Root of the sum of squares of the largest distance, and of the angle times a usual lever.
        """
        return np.asarray(
            np.hypot(np.nanmax(self.length_m, axis=1), FRAMES.lever_m * self.turn_rad)
        )


@dataclass(frozen=True)
class Deviations:
    """Predicted minus measured in P configurations."""

    # (P,) position error; root mean square over the targets seen; the error of the distance itself
    # where a distance was measured
    distance_mm: Array
    # (P, 3) mean over the targets, along base axes; along the line of sight where a distance was
    # measured
    position_mm: Array
    # (P, 3) axis times angle along base axes; None where no orientation is measured
    rotation_deg: Array | None

    @property
    def angle_deg(self) -> Array | None:
        """Return the orientation errors (P,); None where no orientation is measured."""
        if self.rotation_deg is None:
            return None
        return np.asarray(np.linalg.norm(self.rotation_deg, axis=1))

    def take(self, rows: Rows) -> Deviations:
        """Return the deviations of these configurations."""
        return take_rows(self, rows)

    def replaced_where(self, rows: Mask, others: Deviations) -> Deviations:
        """Return the deviations with those of others in some of the configurations (P,).

        Without rotations where one of both has none.
        """
        rotation = None
        if self.rotation_deg is not None and others.rotation_deg is not None:
            rotation = np.where(rows[:, None], others.rotation_deg, self.rotation_deg)
        return Deviations(
            np.where(rows, others.distance_mm, self.distance_mm),
            np.where(rows[:, None], others.position_mm, self.position_mm),
            rotation,
        )


# Targets on the chain's end.


def carried_targets(T_instr_ee: Array, targets_m: Array) -> tuple[Array, Array]:
    """Return positions of targets on poses (P, 4, 4), and vectors from the end, (P, B, 3) each.

    Args:
        targets_m: (t,) coordinates of the targets; (P, t) where they differ from pose to pose.
    """
    p_ee_m = targets_m.reshape(*targets_m.shape[:-1], -1, 3)
    levers_m = p_ee_m @ T_instr_ee[:, :3, :3].transpose(0, 2, 1)
    return T_instr_ee[:, None, :3, 3] + levers_m, levers_m


def by_end_and_targets(T_instr_ee: Array, levers_m: Array) -> tuple[Array, Array]:
    """Return the derivatives of targets with vectors `levers_m` (P, B, 3) from the chain's end.

    They are by a small motion of that end (P, B, 3, 6), and by the targets' coordinates on it
    (P, B, 3, t).
    """
    count, targets = levers_m.shape[:2]
    by_targets = np.zeros((count, targets, 3, targets, 3))
    for b in range(targets):
        by_targets[:, b, :, b] = T_instr_ee[:, :3, :3]
    return by_small_motion(levers_m), by_targets.reshape(count, targets, 3, 3 * targets)


# Columns of the table of poses.


def columns_of_places(names: Iterable[str], p_m: Array) -> dict[str, NDArray[Any]]:
    """Return positions (P, B, 3) as columns of a table of poses, called <name>_<axis>_mm."""
    return {
        f"{name}_{axis}_mm": p_m[:, b, k] / MM
        for b, name in enumerate(names)
        for k, axis in enumerate(AXES)
    }


def places_of(columns: Mapping[str, NDArray[Any]], names: Iterable[str]) -> Array:
    """Return the positions (P, B, 3) in columns as of `columns_of_places`."""
    by_name = [[columns[f"{name}_{axis}_mm"] for axis in AXES] for name in names]
    return MM * np.ascontiguousarray(np.moveaxis(np.array(by_name), 2, 0))


#: Columns of the covariance that all targets and repeats of a pose share.
_SHARED = "shared_cov_{}{}"


def columns_of_covariance(
    cov: Array, template: str, labels: str = "012345", scale: Array = MM_RAD_TO_SI
) -> dict[str, NDArray[Any]]:
    """Return covariances (P, k, k) as columns of a table of poses.

    Args:
        template: name of a column, with two fields `{}` for labels.
        labels: of the k components.
        scale: (k,) factors from the units of the table to metres and radians.
    """
    in_table = cov / np.outer(scale, scale)
    pairs = combinations_with_replacement(range(len(scale)), 2)
    return {template.format(labels[i], labels[j]): in_table[:, i, j] for i, j in pairs}


def covariance_of(
    columns: Mapping[str, NDArray[Any]],
    template: str,
    labels: str = "012345",
    scale: Array = MM_RAD_TO_SI,
) -> Array:
    """Return the covariances in columns as of `columns_of_covariance` (KeyError without them)."""
    every = range(len(labels))
    elements = [
        [columns[template.format(labels[min(i, j)], labels[max(i, j)])] for j in every]
        for i in every
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(elements), 2, 0)) * np.outer(scale, scale)


def columns_of_shared(motion_cov: Array | None) -> dict[str, NDArray[Any]]:
    """Return a covariance (P, 6, 6) that all targets and repeats share as columns; {} of none."""
    return {} if motion_cov is None else columns_of_covariance(motion_cov, _SHARED)


def shared_covariance_of(columns: Mapping[str, NDArray[Any]]) -> Array | None:
    """Return the covariance in columns as of `columns_of_shared`; None without them."""
    return covariance_of(columns, _SHARED) if _SHARED.format(0, 0) in columns else None
