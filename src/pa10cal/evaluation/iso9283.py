"""Pose accuracy and repeatability after ISO 9283:1998, 7.2, of configurations that were repeated.

The standard commands a pose many times and measures what is attained. Here the command is what a
model predicts at the logged joint positions: a controller that computes with this model would have
commanded that pose. Accuracy therefore depends on the model; repeatability does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.results import evaluation as results
from pa10cal.results.record import CampaignIdentity
from pa10cal.rules import COMPARED

#: Millimetres in a metre (unit).
_MM = 1e3


def repeatability(p_m: Array, R: Array | None) -> tuple[float, Array | None]:
    """Return the repeatability of a pose attained n >= 2 times (ISO 9283, 7.2.2): RP_l [mm].

    And RP_a, RP_b, RP_c (3,) [deg]; None where no orientation is measured. RP_l = mean(l) + 3 S_l
    with l_j the distance of attained position j (n, 3) from their mean and S_l the standard
    deviation of these distances; RP_a = 3 S_a of each angle, the small rotations of attained
    orientations (n, 3, 3) from their mean, about the axes along which these are given.
    """
    distance = np.linalg.norm(p_m - p_m.mean(axis=0), axis=1)
    RP_mm = _MM * float(distance.mean() + 3.0 * distance.std(ddof=1))
    if R is None:
        return RP_mm, None
    attained = Rotation.from_matrix(R)
    angles = (attained * attained.mean().inv()).as_rotvec(degrees=True)
    return RP_mm, 3.0 * angles.std(axis=0, ddof=1)


def iso9283_record(
    campaign: CampaignIdentity,
    calibration: str,
    every: Observations,
    judged: Mapping[str, Mapping[str, results.HeldOutModel]],
    R_instr_base: Array,
    cuts_s: Sequence[float] = (),
) -> results.Iso9283Record:
    """Return accuracy under every model and repeatability of every configuration repeated enough.

    Configurations of a kind of poses have numbers by `reading_groups`, which are those of the rows
    of a `HeldOutModel`, too.

    Args:
        campaign: whose poses they are.
        calibration: load case of the calibration.
        every: single readings of all kinds.
        judged: errors of every configuration, by kind of poses and name of the model.
        R_instr_base: (3, 3); rotations are given along the axes of the base.
        cuts_s: when base or instrument moved suddenly; readings before and after such a time are
            of two configurations, in `judged` as well.

    Raises:
        ValueError: when the errors are of other configurations, or kinds were judged by different
            models.
    """
    readings = {kind: every.of_kind(kind) for kind in judged}
    groups = {kind: reading_groups(single, cuts_s) for kind, single in readings.items()}
    chosen = {kind: _repeated(readings[kind], groups[kind]) for kind in groups}
    about = {"campaign": campaign.name, "provenance": campaign.provenance}
    if note := _why_none(every, readings, groups, chosen, moved=bool(cuts_s)):
        return results.Iso9283Record(**about, calibration=calibration, note=note)
    names = _models_of_all(judged)
    for kind, models in judged.items():
        _refuse_other_configurations(models, readings[kind], groups[kind])
    arrivals = with_arrivals(every)[0]
    repeated = [
        row
        for kind, numbers in chosen.items()
        for row in _repeatability(kind, arrivals.of_kind(kind), groups[kind], numbers, R_instr_base)
    ]
    # The column cannot hold an unknown direction: it is left out where that of one row is unknown.
    if any(row["one_direction"] is None for row in repeated):
        repeated = [row | {"one_direction": None} for row in repeated]
    return results.Iso9283Record(
        **about,
        calibration=calibration,
        repeatability=results.RepeatabilityRows.model_validate(repeated),
        accuracy={
            name: _accuracy([(judged[kind][name], numbers) for kind, numbers in chosen.items()])
            for name in names
        },
    )


def _models_of_all(judged: Mapping[str, Mapping[str, results.HeldOutModel]]) -> list[str]:
    """Return the names of the models by which all kinds of poses were judged."""
    by_kind = {kind: list(models) for kind, models in judged.items()}
    names, *others = by_kind.values()
    if any(set(other) != set(names) for other in others):
        raise ValueError(f"kinds of poses were judged by different models: {by_kind}")
    return names


def _refuse_other_configurations(
    models: Mapping[str, results.HeldOutModel],
    single: Observations,
    configuration: NDArray[np.intp],
) -> None:
    """Refuse errors of other configurations than those of single readings, or in another order."""
    _, first = np.unique(configuration, return_index=True)
    poses = single.pose[first]
    for name, model in models.items():
        if not np.array_equal(model.rows.pose, poses):
            raise ValueError(
                f"errors of the model {name} are of {len(model.rows.pose)} configurations, which "
                f"are not the {len(poses)} of the readings: were both parted at the same times?"
            )


def _why_none(
    every: Observations,
    readings: Mapping[str, Observations],
    groups: Mapping[str, NDArray[np.intp]],
    chosen: Mapping[str, NDArray[np.intp]],
    *,
    moved: bool,
) -> str | None:
    """Return why there is neither accuracy nor repeatability; None where there is.

    Args:
        every: single readings of all kinds.
        readings: the same, by kind.
        groups: number of the configuration of each reading, by kind.
        chosen: numbers of those repeated enough, by kind.
        moved: whether base or instrument moved suddenly.
    """
    if not every.measured.directional:
        return "a distance alone shows neither the position nor the orientation attained"
    if any(map(len, chosen.values())):
        return None
    enough = {kind: _enough_repeats(numbers) for kind, numbers in groups.items()}
    if any(map(len, enough.values())):
        places_m = [  # of a distance the first of three components
            readings[kind].measured.places_m[np.isin(groups[kind], numbers)]
            for kind, numbers in enough.items()
        ]
        if not any(np.isfinite(each_m).all(axis=2).any() for each_m in places_m):
            return "only distances were repeated, which show no position or orientation"
        return "no target was observed in all repeats of a configuration"
    between = " between two sudden motions of base or instrument" if moved else ""
    return f"no configuration has {COMPARED.least_repeats} repeats{between}"


def _repeated(single: Observations, configuration: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the numbers of configurations with enough repeats that all see one target at least."""
    if not len(configuration) or not single.measured.directional:
        return np.zeros(0, dtype=np.intp)
    enough = _enough_repeats(configuration)
    seen = np.isfinite(single.measured.places_m)
    in_all = [k for k in enough if seen[configuration == k].all(axis=(0, 2)).any()]
    return np.array(in_all, dtype=np.intp)


def _enough_repeats(configuration: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the numbers of configurations with enough readings, by that of each reading."""
    return np.flatnonzero(np.bincount(configuration) >= COMPARED.least_repeats)


def _repeatability(
    kind: str,
    single: Observations,
    configuration: NDArray[np.intp],
    numbers: NDArray[np.intp],
    R_instr_base: Array,
) -> Iterator[dict[str, Any]]:
    """Yield the rows of configurations with these numbers, by the keys of `RepeatabilityRows`.

    Of several targets the mean of those is taken that all repeats see.
    """
    positions_m, R = single.measured.places_m, single.measured.attitudes
    if R is not None:
        R = R_instr_base.T @ R
    for number in numbers:
        at = np.flatnonzero(configuration == number)
        at = at[np.argsort(single.states.time_s[at], kind="stable")]
        p_m = positions_m[at]
        mean_of_targets_m = p_m[:, np.isfinite(p_m).all(axis=(0, 2))].mean(axis=1)
        RP_mm, RP_deg = repeatability(mean_of_targets_m, None if R is None else R[at])
        yield {
            "kind": kind,
            "pose": single.pose[at][0],
            "load_N": single.states.load_N[at][0],
            "repeats": len(at),
            "one_direction": _one_direction(single.states.arrival[at]),
            "RP_mm": RP_mm,
            "RP_deg": RP_deg,
        }


def _one_direction(arrival: Array) -> bool | None:
    """Return whether joints arrived from one side each in repeats (N, n), in order of time.

    None where the direction of a joint is known in some repeats only, or of none in any. Before the
    first reading of a campaign no move is known, so the first repeat may lack directions.
    """
    if np.any((arrival > 0.0).any(axis=0) & (arrival < 0.0).any(axis=0)):
        return False
    known = arrival != 0.0
    if not known.any() or (known.any(axis=0) & ~known[1:].all(axis=0)).any():
        return None
    return True


def _accuracy(parts: list[tuple[results.HeldOutModel, NDArray[np.intp]]]) -> results.PoseAccuracy:
    """Return the accuracy of one model, by its errors and the configurations of each kind."""

    def column(name: str) -> NDArray[Any] | None:
        columns = [(getattr(model.rows, name), numbers) for model, numbers in parts if len(numbers)]
        if any(values is None for values, _ in columns):
            return None
        return np.concatenate([values[numbers] for values, numbers in columns])

    off_mm, turned_deg = np.asarray(column("position_mm")), column("rotation_deg")
    AP_mm = np.linalg.norm(off_mm, axis=1)
    angles = None if turned_deg is None else np.linalg.norm(turned_deg, axis=1)
    return results.PoseAccuracy(
        AP_mean_mm=float(AP_mm.mean()),
        AP_largest_mm=float(AP_mm.max()),
        AP_mean_deg=None if angles is None else float(angles.mean()),
        AP_largest_deg=None if angles is None else float(angles.max()),
        rows=results.AccuracyRows(
            pose=column("pose"),
            load_N=column("load_N"),
            AP_mm=AP_mm,
            AP_xyz_mm=-off_mm,  # attained less commanded; errors are predicted less measured
            AP_deg=None if turned_deg is None else -turned_deg,
        ),
    )
