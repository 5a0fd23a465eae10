"""Poses held out of the calibration: as campaign.yaml states, or as the rows themselves do.

All readings of a place are held out together: a repeat that is left would show what the others do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from pa10cal.arrays import Array, Index
from pa10cal.campaign.description import Holdout
from pa10cal.campaign.joint_positions import repeats_among
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import Observations
from pa10cal.observe.paths import along_a_path, stretches_held_out
from pa10cal.rules import READINGS


def with_held_out(
    every: Observations, rule: Holdout | None, where: str, places: Index
) -> tuple[Observations, tuple[str, ...], tuple[str, ...]]:
    """Return readings with held-out poses marked as campaign.yaml states, notes and warnings.

    Args:
        every: readings in order of time.
        rule: which poses are held out; None where the rows themselves state it.
        where: the key, in messages.
        places: (N,) number of each reading's place, see `places_of`.

    Raises:
        RawDataError: when rows state held-out poses too, or all poses would be held out.
    """
    if rule is None:
        return every, (), tuple(_shared_places_warnings(every, places))
    every, notes = _hold_out(every, rule, where, places)
    warnings = () if "holdout" in every.kind else (_none_held_out(rule, every, places),)
    return every, notes, warnings


def _shared_places_warnings(every: Observations, places: Index) -> list[str]:
    """Return a warning of held-out poses at places (N,) of calibration poses, if there are any."""
    shared = np.isin(places, places[every.kind == "grid"]) & (every.kind == "holdout")
    if not shared.any():
        return []
    poses = pd.unique(pd.Series(every.pose[shared]))
    return [
        f"held-out poses at joint positions of calibration poses: {len(poses)}, the first "
        f"{poses[0]}: their error is too small; hold out poses with all their repeats, as "
        "holdout: {every: 5} in campaign.yaml does"
    ]


def _hold_out(
    every: Observations, rule: Holdout, where: str, places: Index
) -> tuple[Observations, tuple[str, ...]]:
    """Mark grid poses as held out: the last ones, every n-th, or stretches of a path; and notes."""
    if "holdout" in every.kind:
        raise RawDataError(
            "held-out poses are stated both here and in the rows",
            where=where,
            allowed="one of the two",
            remedy="remove the key, or the kind holdout from the rows",
        )
    grid = every.kind == "grid"
    in_time, first = np.unique(places[grid], return_index=True)
    in_time, first = in_time[np.argsort(first)], np.sort(first)
    stated_count = rule.count_of(len(in_time))
    held_count, notes = _held_count(stated_count, places[grid], every.states.load_N[grid])
    if rule.every is None:
        chosen = in_time[len(in_time) - held_count :]
    elif along_a_path(every.states.q_rad[grid][first]):
        chosen = in_time[stretches_held_out(len(in_time), held_count)]
        notes.append(
            f"rows lie along a path, where a pose is known by its neighbours: {held_count} poses "
            f"are held out in stretches, and not one row in {rule.every}"
        )
    else:
        chosen = in_time[rule.every - 1 :: rule.every]
        chosen = chosen[np.linspace(0, stated_count - 1, held_count).round().astype(np.intp)]
    if 0 < len(in_time) == len(chosen):
        raise RawDataError(
            "all poses are held out, none is left to calibrate with",
            where=f"{where}.last_fraction",
            value=rule.last_fraction,
            allowed=f"a part that leaves at least one of {len(in_time)} poses",
            remedy="hold out fewer, such as last_fraction: 0.3",
        )
    kind = every.kind.astype("U7")
    kind[grid & np.isin(places, np.asarray(chosen, dtype=np.intp))] = "holdout"
    return replace(every, kind=kind), tuple(notes)


def _none_held_out(rule: Holdout, every: Observations, places: Index) -> str:
    """Return the warning that a rule holds out no pose."""
    stated = f"every: {rule.every}" if rule.every else f"last_fraction: {rule.last_fraction:g}"
    count = len(np.unique(places[every.kind == "grid"]))
    return (
        f"no pose is held out: holdout {{{stated}}} of campaign.yaml holds out less than one of "
        f"{count} poses; hold out more, as holdout: {{every: 5}} does"
    )


def _held_count(stated_count: int, places: Index, load_N: Array) -> tuple[int, list[str]]:
    """Return how many poses to hold out where so many are stated, and notes.

    A search for effects needs its readings more than evaluation needs further held-out poses, where
    fewer leave enough. It does not where repeats judge.

    Args:
        places: (N,) of the calibration readings.
        load_N: (N,) of these.
    """
    count, readings = len(np.unique(places)), len(places)
    repeats = repeats_among(places, load_N)
    if repeats >= READINGS.repeated_share * readings:
        return stated_count, []
    spare_count = count - int(np.ceil(READINGS.to_search * count / max(readings, 1)))
    if not 0 < spare_count < stated_count:
        return stated_count, []
    are = "pose is" if spare_count == 1 else "poses are"
    note = (
        f"{spare_count} {are} held out and not {stated_count}, so that {READINGS.to_search} "
        "readings are left, which a search for effects needs: the held-out error rests on so few "
        "until more poses are measured"
    )
    return spare_count, [note]
