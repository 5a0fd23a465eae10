"""Targets on the base: read, checked, and the motion that they show taken out of the readings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from pa10cal.arrays import Array
from pa10cal.campaign.description import DESCRIPTION_FILE, CampaignDescription
from pa10cal.campaign.nominal_fit import misfit_of
from pa10cal.campaign.raw_rows import ColumnMap
from pa10cal.errors import RawDataError
from pa10cal.frame.base_motion import BaseMotion, common_motion
from pa10cal.observe.instrument import BaseTargets, Instrument, Knocked, Misread, MotionFound
from pa10cal.observe.kinds import instruments
from pa10cal.observe.observations import Observations

_COLUMN = re.compile(r"(?:u_)?(base\d+)_[xyz]_mm")
#: Two base targets nearer than this in every configuration are one.
_SAME_M = 1e-3
#: Motions are taken to be small: beyond these the instrument was set up anew.
_LARGEST_M = 0.02
_LARGEST_RAD = 5e-3
#: Wrong readings further off than this many stated uncertainties are worth a warning.
_GROSS = 20.0
#: The arm fits worse where it does so by so many standard errors, found from so many stretches.
_SURELY, _BLOCKS = 4.0, 10
#: Configurations from which on a motion is looked for.
_LEAST_ROWS = 20


def base_target_names(header: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the base targets of which a file has any column, in order."""
    found = (_COLUMN.fullmatch(name) for name in header)
    return tuple(dict.fromkeys(match.group(1) for match in found if match))


def base_columns(names: Sequence[str]) -> list[str]:
    """Return three columns for each base target."""
    return [f"{name}_{axis}_mm" for name in names for axis in "xyz"]


def refuse_base_targets(
    description: CampaignDescription, path: Path, words: ColumnMap, names: Sequence[str]
) -> None:
    """Refuse base targets where the instrument cannot use them, or that are not on the base."""
    kind, clash = description.instrument.kind, sorted(set(names) & set(description.tool.balls_mm))
    if names and not description.instrument.type.sees_base:
        able = " and ".join(word for word, other in instruments().items() if other.sees_base)
        columns = ", ".join(words.column(f"{name}_x_mm") for name in names)
        raise RawDataError(
            f"the instrument {kind} does not see targets on the base",
            where=str(path),
            value=columns,
            allowed=f"columns base1_x_mm … under {able}",
            remedy="remove these columns, or correct instrument.kind",
        )
    if clash:
        where = f"{path.parent / DESCRIPTION_FILE}: tool.balls_mm"
        raise RawDataError(
            f"{', '.join(clash)} is both on the tool and on the base",
            where=where,
            value=", ".join(clash),
            allowed="names base1, base2, … for targets on the base alone",
            remedy="give the target on the tool another name, in its columns too",
        )


def base_targets(names: tuple[str, ...], values: Array, u: Array, u_m: float) -> BaseTargets | None:
    """Return the base targets (K,) of N rows of a file.

    Values (N, 3 K) are nan where a field is blank, uncertainties u (N, 3 K) where not stated [mm];
    `u_m` is what the campaign states of a coordinate.
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
    """Take the motion that base targets show out of readings in order of time.

    Two base targets that are one, and an instrument that was set up anew, are refused. The nominal
    arm, at T_base_ee (P, 4, 4), must not fit worse without the motion.

    Returns:
        The readings as of an instrument that stands still; notes; and warnings.
    """
    base = every.base
    if base is None:
        return every, (), ()
    for i, j in combinations(range(len(base.names)), 2):
        apart = np.linalg.norm(base.p_instr_m[:, i] - base.p_instr_m[:, j], axis=1)
        if np.isfinite(apart).any() and np.nanmax(apart) < _SAME_M:
            value = f"no more than {1e3 * np.nanmax(apart):.3f} mm apart in any row"
            raise RawDataError(
                f"{base.names[i]} and {base.names[j]} are the same target",
                where=where,
                value=value,
                allowed="every target on the base under one name",
                remedy="remove one of them, or correct its columns",
            )
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
    knocked = tuple(
        Knocked(
            tuple(base.names[k] for k in knock.targets),
            str(every.pose[knock.row]),
            float(time_s[knock.row]),
            1e3 * knock.shift_m,
        )
        for knock in moved.knocked
    )
    without = int((~moved.used.any(axis=1)).sum())
    x, y, z = (1e3 * moved.about_m).tolist()
    misread = _misread(base, moved, every)
    found = MotionFound(moved.form, (x, y, z), moved.turns, moved.noise, knocked, misread, without)
    base = replace(base, motion=moved.motion, motion_cov=moved.cov, found=found)
    measured = every.measured if found.form == "still" else every.measured.steadied(base)
    names = ", ".join(base.names)
    if found.form != "still" and _fits_worse(every.measured, measured, T_base_ee):
        warning = (
            f"targets on the base ({names}) move, and the readings of the arm do not move with "
            "them: they are not used; check what they are fixed to"
        )
        return replace(every, base=None), (), (warning,)
    warnings = [f"a target on the base moved: {target}; it is not used" for target in knocked]
    gross_mm = 1e3 * _GROSS * float(np.nanmedian(base.u_m))
    warnings += [
        f"a target on the base was read wrongly: {target}; such readings are not used"
        for target in misread
        if target.off_mm > gross_mm
    ]
    if found.form == "still":
        note = f"targets on the base ({names}) did not move: the readings are not corrected"
    else:
        turned, open_turn = f" and {1e3 * turn_rad:.3f} mrad", ""
        if not found.turns:
            unknown_mrad = 1e3 * np.sqrt(base.motion_cov[:, 3:, 3:].max())
            turned = ""
            open_turn = f"; a turn does not show, uncertain by {unknown_mrad:.3f} mrad"
        by = "smoothed in time" if found.form == "walk" else "configuration by configuration"
        lost = f", {found.without} configurations without them" if found.without else ""
        note = (
            f"targets on the base ({names}) move together by up to {1e3 * shift_m:.3f} mm{turned} "
            f"about their mean: taken out of the readings, {by}{lost}{open_turn}"
        )
    return replace(every, base=base, measured=measured), (note,), tuple(warnings)


def _fits_worse(before: Instrument, after: Instrument, T_base_ee: Array) -> bool:
    """Return whether the nominal arm, however placed, surely fits worse without the motion."""
    uncorrected, corrected = misfit_of(before, T_base_ee), misfit_of(after, T_base_ee)
    if uncorrected is None or corrected is None:
        return False
    gain_m = np.nanmean(uncorrected.length_m - corrected.length_m, axis=1)
    blocks = np.array([block.mean() for block in np.array_split(gain_m, _BLOCKS)])
    surely = _SURELY * blocks.std(ddof=1) / np.sqrt(_BLOCKS)
    return bool(blocks.mean() < -surely)


def _misread(base: BaseTargets, moved: BaseMotion, every: Observations) -> tuple[Misread, ...]:
    """Return the targets with wrong readings, and how far the furthest of each is off."""
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
