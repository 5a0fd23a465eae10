"""Targets on the base: read and checked, and the instrument's motion removed from the readings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from pa10cal.arrays import Array
from pa10cal.campaign.column_map import ColumnMap
from pa10cal.campaign.description import DESCRIPTION_FILE, CampaignDescription
from pa10cal.campaign.nominal_fit import misfit_of
from pa10cal.errors import RawDataError
from pa10cal.frame.base_motion import BaseMotion, common_motion
from pa10cal.observe.base_targets import BaseTargets, Knocked, Misread, MotionFound
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.kinds import instruments
from pa10cal.observe.observations import Observations

_COLUMN = re.compile(r"(?:u_)?(base\d+)_[xyz]_mm")
#: Two base targets nearer than this in every configuration are one.
_SAME_M = 1e-3
#: A motion of this size or more means that the instrument was set up anew.
_LARGEST_M, _LARGEST_RAD = 0.02, 5e-3
#: Wrong readings further off than this many stated uncertainties cause a warning.
_GROSS = 20.0
#: The arm fits worse if the mean misfit grows by so many standard errors, by the scatter of so many
#: blocks of successive rows.
_SURELY, _BLOCKS = 4.0, 10
#: Configurations that a motion needs.
_LEAST_ROWS = 20


def base_target_names(header: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the base targets of which a file has any column, in order."""
    matches = map(_COLUMN.fullmatch, header)
    return tuple(dict.fromkeys(match[1] for match in matches if match))


def base_columns(names: Sequence[str]) -> list[str]:
    """Return three columns for each base target."""
    return [f"{name}_{axis}_mm" for name in names for axis in "xyz"]


def refuse_base_targets(
    description: CampaignDescription, path: Path, words: ColumnMap, names: Sequence[str]
) -> None:
    """Refuse base targets of an instrument that does not see any, or that are on the tool, too."""
    kind, clash = description.instrument.kind, sorted(set(names) & set(description.tool.balls_mm))
    if names and not description.instrument.type.sees_base:
        able = " and ".join(word for word, other in instruments().items() if other.sees_base)
        raise RawDataError(
            f"the instrument {kind} does not see targets on the base",
            where=str(path),
            value=", ".join(words.column(f"{name}_x_mm") for name in names),
            allowed=f"columns base1_x_mm … under {able}",
            remedy="remove these columns, or correct instrument.kind",
        )
    if clash:
        raise RawDataError(
            f"{', '.join(clash)} is both on the tool and on the base",
            where=f"{path.parent / DESCRIPTION_FILE}: tool.balls_mm",
            value=", ".join(clash),
            allowed="names base1, base2, … for targets on the base alone",
            remedy="give the target on the tool another name, in its columns too",
        )


def base_targets(names: tuple[str, ...], values: Array, u: Array, u_m: float) -> BaseTargets | None:
    """Return K base targets in N rows of a file; None without any.

    Args:
        names: the targets.
        values: (N, 3 K) coordinates [mm], nan where a field is blank.
        u: (N, 3 K) their standard uncertainties [mm], nan where not stated.
        u_m: the standard uncertainty of a coordinate that the campaign states.
    """
    if not names:
        return None
    shape = (len(values), len(names), 3)
    p_m = 1e-3 * values.reshape(shape)
    p_m[np.isnan(p_m).any(axis=2)] = np.nan
    return BaseTargets.read(names, p_m, np.where(np.isnan(u), u_m, 1e-3 * u).reshape(shape))


def steadied(
    every: Observations, where: str, T_base_ee: Array
) -> tuple[Observations, tuple[str, ...], tuple[str, ...]]:
    """Remove the motion of the instrument that base targets show from readings in order of time.

    The motion is not removed where the nominal arm, at T_base_ee (P, 4, 4), fits worse without it.

    Returns:
        The readings as of an instrument at rest; notes; and warnings.

    Raises:
        RawDataError: when two base targets are one, or the instrument was set up anew.
    """
    base = every.base
    if base is None:
        return every, (), ()
    _refuse_same_targets(base, where)
    time_s = every.states.time_s
    if np.isfinite(base.p_instr_m[..., 0]).any(axis=1).sum() < _LEAST_ROWS:
        note = f"targets on the base are seen in fewer than {_LEAST_ROWS} configurations: not used"
        return replace(every, base=None), (note,), ()
    moved = common_motion(time_s, base.p_instr_m, base.u_m)
    shift_m = float(np.linalg.norm(moved.motion[:, :3], axis=1).max())
    turn_rad = float(np.linalg.norm(moved.motion[:, 3:], axis=1).max())
    if shift_m >= _LARGEST_M or turn_rad >= _LARGEST_RAD:
        step = np.linalg.norm(np.diff(moved.motion[:, :3], axis=0), axis=1)
        value = (
            f"targets on the base moved by {1e3 * shift_m:.1f} mm and {1e3 * turn_rad:.2f} mrad; "
            f"most of it before pose {every.pose[int(step.argmax()) + 1]}"
        )
        raise RawDataError(
            "the instrument was set up anew during the campaign",
            where=where,
            value=value,
            allowed=f"up to {1e3 * _LARGEST_M:g} mm and {1e3 * _LARGEST_RAD:g} mrad",
            remedy="make a campaign of each set-up",
        )
    found = _motion_found(base, moved, every)
    base = replace(base, motion=moved.motion, motion_cov=moved.cov, found=found)
    measured = every.measured if found.form == "still" else every.measured.steadied(base)
    names = ", ".join(base.names)
    if found.form != "still" and _fits_worse(every.measured, measured, T_base_ee):
        warning = (
            f"targets on the base ({names}) move, and the readings of the arm do not move with "
            "them: they are not used; check what they are fixed to"
        )
        return replace(every, base=None), (), (warning,)
    gross_mm = 1e3 * _GROSS * float(np.nanmedian(base.u_m))
    warnings = [
        f"a target on the base moved: {target}; it is not used" for target in found.knocked
    ] + [
        f"a target on the base was read wrongly: {target}; such readings are not used"
        for target in found.misread
        if target.off_mm > gross_mm
    ]
    note = _note(base, found, 1e3 * shift_m, 1e3 * turn_rad)
    return replace(every, base=base, measured=measured), (note,), tuple(warnings)


def _refuse_same_targets(base: BaseTargets, where: str) -> None:
    for i, j in combinations(range(len(base.names)), 2):
        apart_m = np.linalg.norm(base.p_instr_m[:, i] - base.p_instr_m[:, j], axis=1)
        if np.isfinite(apart_m).any() and np.nanmax(apart_m) < _SAME_M:
            raise RawDataError(
                f"{base.names[i]} and {base.names[j]} are the same target",
                where=where,
                value=f"no more than {1e3 * np.nanmax(apart_m):.3f} mm apart in any row",
                allowed="every target on the base under one name",
                remedy="remove one of them, or correct its columns",
            )


def _motion_found(base: BaseTargets, moved: BaseMotion, every: Observations) -> MotionFound:
    """Return the motion, with targets that were knocked or misread, as results record it."""
    knocked = tuple(
        Knocked(
            tuple(base.names[k] for k in knock.targets),
            str(every.pose[knock.row]),
            float(every.states.time_s[knock.row]),
            1e3 * knock.shift_m,
        )
        for knock in moved.knocked
    )
    x, y, z = (1e3 * moved.about_m).tolist()
    misread = _misread(base, moved, every)
    without = int((~moved.used.any(axis=1)).sum())
    return MotionFound(moved.form, (x, y, z), moved.turns, moved.noise, knocked, misread, without)


def _note(base: BaseTargets, found: MotionFound, shift_mm: float, turn_mrad: float) -> str:
    """Return in words what was removed from the readings."""
    names = ", ".join(base.names)
    if found.form == "still":
        return f"targets on the base ({names}) did not move: the readings are not corrected"
    turned, unknown_turn = f" and {turn_mrad:.3f} mrad", ""
    if not found.turns:
        unknown_mrad = 1e3 * np.sqrt(base.motion_cov[:, 3:, 3:].max())
        turned = ""
        unknown_turn = f"; a turn does not show, uncertain by {unknown_mrad:.3f} mrad"
    by = "smoothed in time" if found.form == "walk" else "configuration by configuration"
    lost = f", {found.without} configurations without them" if found.without else ""
    return (
        f"targets on the base ({names}) move together by up to {shift_mm:.3f} mm{turned} "
        f"about their mean: taken out of the readings, {by}{lost}{unknown_turn}"
    )


def _fits_worse(before: Instrument, after: Instrument, T_base_ee: Array) -> bool:
    """Return whether the nominal arm, base and target fitted, fits significantly worse `after`."""
    uncorrected, corrected = misfit_of(before, T_base_ee), misfit_of(after, T_base_ee)
    if uncorrected is None or corrected is None:
        return False
    gain_m = np.nanmean(uncorrected.length_m - corrected.length_m, axis=1)
    blocks = np.array([block.mean() for block in np.array_split(gain_m, _BLOCKS)])
    return bool(blocks.mean() < -_SURELY * blocks.std(ddof=1) / np.sqrt(_BLOCKS))


def _misread(base: BaseTargets, moved: BaseMotion, every: Observations) -> tuple[Misread, ...]:
    """Return the targets with wrong readings, each with their number and the furthest of them."""
    misread = []
    for k in np.flatnonzero(moved.wrong.any(axis=0)):
        used = moved.used[:, k] | ~moved.used[:, k].any()
        place_m = np.nanmedian(base.p_instr_m[used, k], axis=0)
        off_m = np.linalg.norm(base.p_instr_m[:, k] - place_m, axis=1)
        off_m[~moved.wrong[:, k]] = 0.0
        furthest, count = int(off_m.argmax()), int(moved.wrong[:, k].sum())
        pose, off_mm = str(every.pose[furthest]), 1e3 * float(off_m[furthest])
        misread.append(Misread(base.names[k], count, pose, off_mm))
    return tuple(misread)
