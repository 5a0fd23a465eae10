"""Targets on the base in a raw file, and the motion of the instrument taken out of the readings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pa10cal.campaign.description import DESCRIPTION_FILE, CampaignDescription
from pa10cal.campaign.raw_file import RawFile
from pa10cal.errors import RawDataError
from pa10cal.frame.base_motion import BaseMotion, base_motion
from pa10cal.observe.base_targets import BaseTargets, Knocked, MotionFound
from pa10cal.observe.observations import Observations
from pa10cal.observe.registry import instruments

Array = NDArray[np.float64]

_COLUMN = re.compile(r"(?:u_)?(base\d+)_[xyz]_mm")
#: Two base targets nearer than this in every configuration are one.
_SAME_M = 1e-3
#: Motions are taken to be small: beyond these the instrument was set up anew.
_LARGEST_M = 0.02
_LARGEST_RAD = 5e-3
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
    description: CampaignDescription, file: RawFile, names: Sequence[str]
) -> None:
    """Refuse base targets where the instrument cannot use them, or that are not on the base.

    Raises:
        RawDataError: saying which.
    """
    if not names:
        return
    kind = description.instrument.kind
    if not description.instrument.type.sees_base:
        able = [word for word, each in instruments().items() if each.sees_base]
        raise RawDataError(
            f"the instrument {kind} does not see targets on the base",
            where=str(file.path),
            value=", ".join(file.in_own_words(f"{name}_x_mm") for name in names),
            allowed=f"columns base1_x_mm … under {' and '.join(able)}",
            remedy="remove these columns, or correct instrument.kind",
        )
    clash = sorted(set(names) & set(description.tool.balls_mm))
    if clash:
        raise RawDataError(
            f"{', '.join(clash)} is both on the tool and on the base",
            where=f"{file.path.parent / DESCRIPTION_FILE}: tool.balls_mm",
            value=", ".join(clash),
            allowed="names base1, base2, … for targets on the base alone",
            remedy="give the target on the tool another name, in its columns too",
        )


def base_targets(names: tuple[str, ...], values: Array, u: Array, u_m: float) -> BaseTargets | None:
    """Return the base targets of N rows of a file.

    Args:
        names: (K,) of them.
        values: (N, 3 K) [mm], nan where a field is blank.
        u: (N, 3 K) standard uncertainties [mm], nan where not stated.
        u_m: what the campaign states of a coordinate.
    """
    if not names:
        return None
    shape = (len(values), len(names), 3)
    p_m = 1e-3 * values.reshape(shape)
    p_m[np.isnan(p_m).any(axis=2)] = np.nan
    return BaseTargets.read(names, p_m, np.where(np.isnan(u), u_m, 1e-3 * u).reshape(shape))


def steadied(
    every: Observations, where: str
) -> tuple[Observations, tuple[str, ...], tuple[str, ...]]:
    """Take the motion that base targets show out of readings.

    Args:
        every: single readings in order of time.
        where: file, for messages.

    Returns:
        The readings as of an instrument that stands still; notes; and warnings.

    Raises:
        RawDataError: when two base targets are one, or when the instrument was set up anew.
    """
    base = every.base
    if base is None:
        return every, (), ()
    _refuse_twins(base, where)
    time_s = every.states.time_s
    if np.isfinite(base.p_instr_m[..., 0]).any(axis=1).sum() < _LEAST_ROWS:
        note = f"targets on the base are seen in fewer than {_LEAST_ROWS} configurations: not used"
        return replace(every, base=None), (note,), ()
    moved = base_motion(time_s, base.p_instr_m, base.u_m)
    _refuse_new_set_up(moved, every, where)
    knocked = tuple(
        Knocked(
            tuple(base.names[k] for k in each.targets),
            str(every.pose[each.row]),
            float(time_s[each.row]),
            1e3 * each.shift_m,
        )
        for each in moved.knocked
    )
    without = int((~moved.used.any(axis=1)).sum())
    x, y, z = (1e3 * moved.about_m).tolist()
    found = MotionFound(moved.form, (x, y, z), moved.turns, moved.noise, knocked, without)
    base = replace(base, motion=moved.motion, motion_cov=moved.cov, found=found)
    measured = every.measured if found.form == "still" else every.measured.steadied(base)
    still = replace(every, base=base, measured=measured)
    warnings = tuple(f"a target on the base moved: {each}; it is left out" for each in knocked)
    return still, (_said(base, found),), warnings


def _said(base: BaseTargets, found: MotionFound) -> str:
    """Return in one clause what the base targets show."""
    names = ", ".join(base.names)
    if found.form == "still":
        return f"targets on the base ({names}) stand still"
    shift_mm = 1e3 * np.linalg.norm(base.motion[:, :3], axis=1)
    turn_mrad = 1e3 * np.linalg.norm(base.motion[:, 3:], axis=1)
    turned = f" and {turn_mrad.max():.3f} mrad" if found.turns else ""
    by = "smoothed in time" if found.form == "walk" else "configuration by configuration"
    lost = f", {found.without} configurations without them" if found.without else ""
    return (
        f"targets on the base ({names}) move together by up to {shift_mm.max():.3f} mm{turned} "
        f"about their mean: taken out of the readings, {by}{lost}"
    )


def _refuse_twins(base: BaseTargets, where: str) -> None:
    for i, j in combinations(range(len(base.names)), 2):
        apart = np.linalg.norm(base.p_instr_m[:, i] - base.p_instr_m[:, j], axis=1)
        if np.isfinite(apart).any() and np.nanmax(apart) < _SAME_M:
            raise RawDataError(
                f"{base.names[i]} and {base.names[j]} are the same target",
                where=where,
                value=f"no more than {1e3 * np.nanmax(apart):.3f} mm apart in any row",
                allowed="every target on the base under one name",
                remedy="remove one of them, or correct its columns",
            )


def _refuse_new_set_up(moved: BaseMotion, every: Observations, where: str) -> None:
    shift_m = np.linalg.norm(moved.motion[:, :3], axis=1)
    turn_rad = np.linalg.norm(moved.motion[:, 3:], axis=1)
    if shift_m.max() < _LARGEST_M and turn_rad.max() < _LARGEST_RAD:
        return
    step = np.linalg.norm(np.diff(moved.motion[:, :3], axis=0), axis=1)
    at = int(step.argmax()) + 1
    raise RawDataError(
        "the instrument was set up anew while the campaign lasted",
        where=where,
        value=f"targets on the base moved by {1e3 * shift_m.max():.1f} mm and "
        f"{1e3 * turn_rad.max():.2f} mrad; most of it before pose {every.pose[at]}",
        allowed=f"up to {1e3 * _LARGEST_M:g} mm and {1e3 * _LARGEST_RAD:g} mrad",
        remedy="make a campaign of each set-up",
    )
