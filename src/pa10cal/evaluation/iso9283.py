"""Pose accuracy and repeatability after ISO 9283:1998, 7.2, of configurations that were repeated.

The standard commands a pose many times and measures what is attained. Here the command is what a
model predicts at the logged joint positions: a controller that computes with this model would have
commanded that pose. Accuracy therefore depends on the model; repeatability does not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.observe.observations import Observations, measured_as_poses, reading_groups
from pa10cal.results import evaluation as results
from pa10cal.results.record import Campaign

#: Repeats of a configuration below which its scatter says too little; the standard has 30.
LEAST_REPEATS = 5
_MM = 1e3


@dataclass(frozen=True)
class Repeatability:
    """Repeatability of one pose."""

    RP_mm: float  # mean distance from the mean attained position, and three standard deviations
    # (3,) three standard deviations of the rotations about x, y and z; None where no orientation is
    # measured
    RP_deg: Array | None


def repeatability(p_m: Array, R: Array | None) -> Repeatability:
    """Return the repeatability of a pose that was attained n times (ISO 9283, 7.2.2).

    RP_l = mean(l) + 3 S_l with l_j the distance of attained position j from their mean and S_l
    the standard deviation of these distances; RP_a = 3 S_a of each angle.

    Args:
        p_m: (n, 3) attained positions, n >= 2.
        R: (n, 3, 3) attained orientations; None where none are measured. Angles are the small
            rotations from their mean, about the axes along which orientations are given.
    """
    distance = np.linalg.norm(p_m - p_m.mean(axis=0), axis=1)
    RP_mm = _MM * float(distance.mean() + 3.0 * distance.std(ddof=1))
    if R is None:
        return Repeatability(RP_mm, None)
    attained = Rotation.from_matrix(R)
    angles = (attained * attained.mean().inv()).as_rotvec(degrees=True)
    return Repeatability(RP_mm, 3.0 * angles.std(axis=0, ddof=1))


def iso9283_record(
    campaign: Campaign,
    calibration: str,
    every: Observations,
    judged: Mapping[str, Mapping[str, results.HeldOutModel]],
    R_instr_base: Array,
) -> results.Iso9283Record:
    """Return accuracy under every model and repeatability of every configuration repeated enough.

    Args:
        judged: models judged on every configuration, by kind of poses and name of the model.
        R_instr_base: (3, 3) orientation of the base, along whose axes rotations are given.
    """
    readings = {kind: every.of_kind(kind) for kind in judged}
    groups = {kind: reading_groups(single) for kind, single in readings.items()}
    chosen = {kind: _repeated(readings[kind], code) for kind, code in groups.items()}
    note = _why_not(every, max((len(rows) for rows in chosen.values()), default=0))
    if note is not None:
        return results.Iso9283Record(
            campaign=campaign.name,
            provenance=campaign.provenance,
            calibration=calibration,
            note=note,
        )
    parts = [
        _repeatability(kind, readings[kind], groups[kind], rows, R_instr_base)
        for kind, rows in chosen.items()
        if len(rows)
    ]
    names = list(judged[next(kind for kind, rows in chosen.items() if len(rows))])
    return results.Iso9283Record(
        campaign=campaign.name,
        provenance=campaign.provenance,
        calibration=calibration,
        repeatability=results.RepeatabilityRows(**_joined([dict(part) for part in parts])),
        accuracy={
            name: _accuracy([(judged[kind][name], rows) for kind, rows in chosen.items()])
            for name in names
        },
    )


def _repeated(single: Observations, code: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the configurations with enough repeats that all see one target at least."""
    if not len(code) or not single.measured.directional:
        return np.zeros(0, dtype=np.intp)
    enough = np.flatnonzero(np.bincount(code) >= LEAST_REPEATS)
    if single.measured.measures_pose:
        return enough
    places_m = single.measured.places_m
    return np.array([row for row in enough if _in_all(places_m[code == row]).any()], dtype=np.intp)


def _in_all(places_m: Array) -> NDArray[np.bool_]:
    """Return which targets (B,) every reading (P, B, 3) has."""
    return np.asarray(np.isfinite(places_m).all(axis=(0, 2)))


def _why_not(every: Observations, configurations: int) -> str | None:
    if not every.measured.directional:
        return "a distance alone shows neither the position nor the orientation attained"
    if not configurations:
        return f"no configuration has {LEAST_REPEATS} repeats"
    return None


def _repeatability(
    kind: str,
    single: Observations,
    code: NDArray[np.intp],
    rows: NDArray[np.intp],
    R_instr_base: Array,
) -> results.RepeatabilityRows:
    positions, attitudes = _attained(single, R_instr_base)
    found = []
    for row in rows:
        at = code == row
        p = positions[at]
        seen = _in_all(p)
        R = None if attitudes is None else attitudes[at]
        found.append(repeatability(p[:, seen].mean(axis=1), R))
    first = np.array([int(np.flatnonzero(code == row)[0]) for row in rows])
    turns = [each.RP_deg for each in found if each.RP_deg is not None]
    return results.RepeatabilityRows(
        kind=np.full(len(rows), kind),
        pose=single.pose[first],
        load_N=single.states.load_N[first],
        repeats=np.bincount(code)[rows].astype(np.int64),
        one_direction=np.array([_one_side(single.states.arrival[code == row]) for row in rows]),
        RP_mm=np.array([each.RP_mm for each in found]),
        RP_deg=np.array(turns) if turns else None,
    )


def _attained(single: Observations, R_instr_base: Array) -> tuple[Array, Array | None]:
    """Return positions (P, B, 3) and orientations (P, 3, 3) along the base's axes."""
    if single.measured.measures_pose:
        T = measured_as_poses(single).measured.T_instr_target
        return T[:, None, :3, 3], R_instr_base.T @ T[:, :3, :3]
    return single.measured.places_m, None


def _one_side(arrival: Array) -> bool:
    """Return whether every joint arrived from the same side in all repeats, as far as known."""
    return bool((np.ptp(arrival, axis=0) == 0.0).all())


def _accuracy(parts: list[tuple[results.HeldOutModel, NDArray[np.intp]]]) -> results.PoseAccuracy:
    tables = [
        results.AccuracyRows(
            pose=model.rows.pose[rows],
            load_N=model.rows.load_N[rows],
            AP_mm=np.linalg.norm(model.rows.position_mm[rows], axis=1),
            AP_xyz_mm=-model.rows.position_mm[rows],
            AP_deg=None if model.rows.rotation_deg is None else -model.rows.rotation_deg[rows],
        )
        for model, rows in parts
        if len(rows)
    ]
    joined = results.AccuracyRows(**_joined([dict(table) for table in tables]))
    turns = None if joined.AP_deg is None else np.linalg.norm(joined.AP_deg, axis=1)
    return results.PoseAccuracy(
        AP_mean_mm=float(joined.AP_mm.mean()),
        AP_largest_mm=float(joined.AP_mm.max()),
        AP_mean_deg=None if turns is None else float(turns.mean()),
        AP_largest_deg=None if turns is None else float(turns.max()),
        rows=joined,
    )


def _joined(tables: list[dict[str, Array | None]]) -> dict[str, Array | None]:
    """Return the columns of tables below each other."""
    first = tables[0]
    return {
        name: None
        if first[name] is None
        else np.concatenate([column for table in tables if (column := table[name]) is not None])
        for name in first
    }
