"""Targets on the base: read and checked, and the instrument's motion removed from the readings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.campaign.column_map import ColumnMap
from pa10cal.campaign.description import DESCRIPTION_FILE, CampaignDescription
from pa10cal.campaign.nominal_fit import misfit_of
from pa10cal.errors import RawDataError
from pa10cal.frame.base_motion import BaseMotion, common_motion
from pa10cal.frame.point_fits import by_small_motion
from pa10cal.observe.base_targets import BaseTargets, Knocked, Misread, MotionFound
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.kinds import instruments
from pa10cal.observe.observations import Observations

_COLUMN = re.compile(r"(?:u_)?(base\d+)_[xyz]_mm")
#: Two base targets nearer than this in every configuration are one.
_SAME_M = 1e-3
#: Ranges of shift and turn over a campaign from which the instrument was set up anew.
_NEW_SETUP_M, _NEW_SETUP_RAD = 0.02, 5e-3
#: Wrong readings further off than this many stated uncertainties cause a warning.
_WARNED_SIGMAS = 20.0
#: Targets whose readings scatter by more than so many times as stated cause a warning.
_WARNED_NOISE = 3.0
#: The arm fits worse where the mean gain of the correction is more than so many standard errors
#: below zero. They come from means over blocks of rows, because neighbouring rows are correlated.
_SURELY = 4.0
_BLOCKS = 10
#: Configurations that a motion needs.
_LEAST_ROWS = 20


class Corrected(NamedTuple):
    """Readings as of an instrument at rest, and what the user should know of the correction."""

    readings: Observations
    notes: tuple[str, ...] = ()  # one clause each
    warnings: tuple[str, ...] = ()  # one sentence each


def base_target_names(header: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the base targets of which a file has any column, in order."""
    matches = map(_COLUMN.fullmatch, header)
    return tuple(dict.fromkeys(match[1] for match in matches if match))


def is_base_column(name: str) -> bool:
    """Return whether a column holds a coordinate of a base target, or its uncertainty."""
    return _COLUMN.fullmatch(name) is not None


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


def without_instrument_motion(readings: Observations, where: str, T_base_ee: Array) -> Corrected:
    """Remove the motion of the instrument that base targets show from readings in order of time.

    The motion is not removed where the nominal arm, at T_base_ee (P, 4, 4), fits worse without it.

    Raises:
        RawDataError: when two base targets are one, or the instrument moved as far as if it was set
            up anew, and the readings of the arm with it.
    """
    base = readings.base
    if base is None:
        return Corrected(readings)
    _refuse_same_targets(base, where)
    if np.isfinite(base.p_instr_m[..., 0]).any(axis=1).sum() < _LEAST_ROWS:
        note = f"targets on the base are seen in fewer than {_LEAST_ROWS} configurations: not used"
        return Corrected(replace(readings, base=None), (note,))
    moved = common_motion(readings.states.time_s, base.p_instr_m, base.u_m)
    found = _motion_found(base, moved, readings)
    base = replace(base, motion=moved.motion, motion_cov=moved.cov, found=found)
    measured = readings.measured
    if found.form != "still":
        measured = measured.steadied(base)
        far = _is_far(moved.motion)
        if _fits_worse(readings.measured, measured, T_base_ee, far=far):
            warning = (
                f"targets on the base ({', '.join(base.names)}) move, and the readings of the arm "
                "do not move with them: they are not used; check what they are fixed to"
            )
            return Corrected(replace(readings, base=None), warnings=(warning,))
        if far:
            raise _moved_too_far(moved.motion, readings.pose, where)
    corrected = replace(readings, base=base, measured=measured)
    return Corrected(corrected, (_note(base, found),), _warnings_of(found, base))


def _refuse_same_targets(base: BaseTargets, where: str) -> None:
    for i, j in combinations(range(len(base.names)), 2):
        apart_m = np.linalg.norm(base.p_instr_m[:, i] - base.p_instr_m[:, j], axis=1)
        # The median, since a single wrong reading of one of them does not make them two.
        if np.isfinite(apart_m).any() and np.nanmedian(apart_m) < _SAME_M:
            raise RawDataError(
                f"{base.names[i]} and {base.names[j]} are the same target",
                where=where,
                value=f"{1e3 * np.nanmedian(apart_m):.3f} mm apart or less in half of the rows",
                allowed="every target on the base under one name",
                remedy="remove one of them, or correct its columns",
            )


def _range_of(motion: Array) -> tuple[float, float]:
    """Return the ranges of shift [m] and turn [rad] of motions (P, 6).

    A range is the diagonal of the box that holds all motions: of one jump its size, wherever in the
    campaign it is.
    """
    extent = np.ptp(motion, axis=0)
    return float(np.linalg.norm(extent[:3])), float(np.linalg.norm(extent[3:]))


def _is_far(motion: Array) -> bool:
    """Return whether motions (P, 6) range as far as after a new set-up."""
    shift_m, turn_rad = _range_of(motion)
    return shift_m >= _NEW_SETUP_M or turn_rad >= _NEW_SETUP_RAD


def _moved_too_far(motion: Array, pose: NDArray[np.str_], where: str) -> RawDataError:
    """Return the refusal of motions (P, 6), at poses (P,): by one large step, or gradually."""
    limits = np.repeat([_NEW_SETUP_M, _NEW_SETUP_RAD], 3)
    steps = np.diff(motion, axis=0)
    size = np.linalg.norm(steps / limits, axis=1)
    largest = int(size.argmax())
    shift_m, turn_rad = _range_of(motion)
    value = f"targets on the base moved by {1e3 * shift_m:.1f} mm and {1e3 * turn_rad:.2f} mrad; "
    if size[largest] >= 0.5 * np.linalg.norm(np.ptp(motion, axis=0) / limits):
        step_m, step_rad = np.linalg.norm(steps[largest].reshape(2, 3), axis=1)
        what = "the instrument was set up anew during the campaign"
        value += (
            f"the largest step ({1e3 * step_m:.1f} mm, {1e3 * step_rad:.2f} mrad) is between poses "
            f"{pose[largest]} and {pose[largest + 1]}"
        )
        remedy = "make a campaign of each set-up"
    else:
        what = "the instrument moved too far during the campaign"
        value += "they moved gradually, or in several steps"
        remedy = (
            "fix the instrument and let it warm up, then measure again; or divide the poses, in "
            "order of time, into campaigns in which it moves less"
        )
    return RawDataError(
        what,
        where=where,
        value=value,
        allowed=f"up to {1e3 * _NEW_SETUP_M:g} mm and {1e3 * _NEW_SETUP_RAD:g} mrad",
        remedy=remedy,
    )


def _warnings_of(found: MotionFound, base: BaseTargets) -> tuple[str, ...]:
    """Return warnings of targets that were knocked, read far off, or scatter more than stated."""
    warned_above_mm = 1e3 * _WARNED_SIGMAS * float(np.nanmedian(base.u_m))
    knocked = [f"a target on the base moved: {target}; it is not used" for target in found.knocked]
    misread = [
        f"a target on the base was read wrongly: {target}; such readings are not used"
        for target in found.misread
        if target.off_mm > warned_above_mm
    ]
    scattered = (
        f"targets on the base ({', '.join(base.names)}) scatter {found.noise:.1f} times as much as "
        "stated: check how firmly they are fixed, and the stated uncertainty"
    )
    return (*knocked, *misread, *([scattered] if found.noise > _WARNED_NOISE else []))


def _motion_found(base: BaseTargets, moved: BaseMotion, readings: Observations) -> MotionFound:
    """Return the motion, with targets that were knocked or misread, as results record it."""
    knocked = tuple(
        Knocked(
            tuple(base.names[k] for k in knock.targets),
            str(readings.pose[knock.row]),
            float(readings.states.time_s[knock.row]),
            1e3 * knock.shift_m,
        )
        for knock in moved.knocked
    )
    x, y, z = (1e3 * moved.about_m).tolist()
    return MotionFound(
        form=moved.form,
        about_mm=(x, y, z),
        turns=moved.turns,
        noise=moved.noise,
        knocked=knocked,
        misread=_misread(base, moved, readings),
        without=int((~moved.used.any(axis=1)).sum()),
    )


def _note(base: BaseTargets, found: MotionFound) -> str:
    """Return in words what was removed from the readings."""
    targets = f"targets on the base ({', '.join(base.names)})"
    if found.form == "still":
        scatter_mm = 1e3 * found.noise * float(np.nanmedian(base.u_m))
        return (
            f"{targets} show no motion beyond their scatter of {scatter_mm:.3f} mm: the readings "
            "are not corrected"
        )
    shift_mm = 1e3 * np.linalg.norm(base.motion[:, :3], axis=1).max()
    by = "smoothed in time" if found.form == "walk" else "configuration by configuration"
    if found.without:
        by += f", {found.without} configurations without them"
    if found.turns:
        turn_mrad = 1e3 * np.linalg.norm(base.motion[:, 3:], axis=1).max()
        return (
            f"{targets} move together by up to {shift_mm:.3f} mm and {turn_mrad:.3f} mrad "
            f"about their mean: taken out of the readings, {by}"
        )
    unknown_mrad = 1e3 * np.sqrt(base.motion_cov[:, 3:, 3:].max())
    return (
        f"{targets} move together by up to {shift_mm:.3f} mm about their mean: taken out of the "
        f"readings, {by}; a turn does not show, uncertain by {unknown_mrad:.3f} mrad"
    )


def _fits_worse(before: Instrument, after: Instrument, T_base_ee: Array, *, far: bool) -> bool:
    """Return whether the nominal arm, base and target fitted, fits significantly worse `after`.

    Of a far motion any loss is significant, unless the arm's readings jump as far themselves. In
    every row a target of the arm was observed.
    """
    uncorrected, corrected = misfit_of(before, T_base_ee), misfit_of(after, T_base_ee)
    if uncorrected is None or corrected is None:
        return False
    # Positive where the correction helps.
    gain_m = np.nanmean(uncorrected.length_m - corrected.length_m, axis=1)
    blocks = np.array([block.mean() for block in np.array_split(gain_m, _BLOCKS)])
    if far:
        off_m = [np.median(block) for block in np.array_split(uncorrected.size_m, _BLOCKS)]
        return bool(blocks.mean() < 0.0 and max(off_m) < _NEW_SETUP_M)
    return bool(blocks.mean() < -_SURELY * blocks.std(ddof=1) / np.sqrt(_BLOCKS))


def _misread(base: BaseTargets, moved: BaseMotion, readings: Observations) -> tuple[Misread, ...]:
    """Return the targets with wrong readings, each with their number and the furthest of them."""
    misread = []
    for k in np.flatnonzero(moved.wrong.any(axis=0)):
        p_m = base.p_instr_m[:, k]
        by_motion = by_small_motion(np.nanmedian(p_m, axis=0) - moved.about_m)
        p_at_rest_m = p_m - moved.motion @ by_motion.T
        used = moved.used[:, k]
        # Without a reading that was used, all of them show best where the target is.
        place_m = np.nanmedian(p_at_rest_m[used] if used.any() else p_at_rest_m, axis=0)
        wrong = np.flatnonzero(moved.wrong[:, k])
        off_m = np.linalg.norm(p_at_rest_m[wrong] - place_m, axis=1)
        furthest = int(off_m.argmax())
        pose = str(readings.pose[wrong[furthest]])
        misread.append(Misread(base.names[k], len(wrong), pose, 1e3 * float(off_m[furthest])))
    return tuple(misread)
