"""Campaigns of a touch-trigger instrument: touches and resolver log joined by time.

In each dwell of the arm the balls are located by their touches, and the joints read in the log.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.campaign import balls, screens
from pa10cal.campaign.bounds import only_labelled_rows, only_whole_numbers, unwrapped, within_bounds
from pa10cal.campaign.column_map import ColumnMap
from pa10cal.campaign.description import CampaignDescription, exclusions_of
from pa10cal.campaign.dwells import (
    Samples,
    Stations,
    best_clock_offset,
    find_dwells,
    while_loaded,
)
from pa10cal.campaign.joint_conventions import coupling_that_fits
from pa10cal.campaign.joint_positions import as_joints, as_logged
from pa10cal.campaign.nominal_fit import misfit_mm, nominal_places
from pa10cal.campaign.raw_file import RawFile, words_of
from pa10cal.campaign.raw_rows import Exclusions, Ingested, Quarantined, RawRows, quarantined
from pa10cal.campaign.screens import refuse_too_many
from pa10cal.campaign.target_labels import EXCHANGED, exchange_text, exchanged
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import KINDS, JointLog, Observations
from pa10cal.observe.points import Points
from pa10cal.observe.pose import Touched
from pa10cal.observe.quantities import Misfit
from pa10cal.options import IngestOptions

#: Part of the touches that may lie outside dwells before the clocks are suspected.
FEW_OUTSIDE = 0.05
#: A clock offset is to blame if at most this part of the touches outside stays outside under it.
STAYS_OUTSIDE = 0.2

_PLACE = ("x_mm", "y_mm", "z_mm")

OUTSIDE = "touched outside any dwell: the arm moved, or the clocks differ"
OTHER_DWELL = "touched in another dwell than the rest of its configuration"
NOT_TOUCHED = "a dwell in which nothing was touched"
LOST = "a dwell whose touches are quarantined"


def read_touched(
    campaign: CampaignDescription, arm: Arm, folder: Path, settings: IngestOptions
) -> Ingested:
    """Read a campaign of a touch-trigger instrument: one reading a configuration.

    Raises:
        RawDataError: when a file, or too much of it, cannot be used.
    """
    cmm, resolver = (
        RawFile.of(campaign, folder, key, arm.axes_slide) for key in ("cmm", "resolver")
    )
    names, words = campaign.ball_names, words_of(campaign, arm.axes_slide)
    touches_read, logged_count = _read_touches(cmm, names, arm, exclusions_of(campaign, folder))
    samples, log = _read_samples(resolver, arm)

    def refuse_too_many_lost(rows: tuple[Quarantined, ...]) -> None:
        totals = {**touches_read.totals, **log.totals}
        refuse_too_many(rows, totals, settings.max_quarantined_fraction, words)

    refuse_too_many_lost((*touches_read.quarantined, *log.quarantined))
    _refuse_wrong_angle_unit(touches_read, samples, campaign, arm, str(resolver.path), words)
    dwells = find_dwells(samples, settings.still_speed_deg_s)
    dwell_of_touch = dwells.at(touches_read["time_s"])
    touched = np.isin(np.arange(len(dwells)), dwell_of_touch)
    log_s = float(samples.time_s[0]), float(samples.time_s[-1])
    _check_clocks(touches_read, dwell_of_touch, dwells, log_s, str(cmm.path), str(resolver.path))
    touches = _in_one_dwell(touches_read, dwell_of_touch)
    quarantined_rows = (*touches.quarantined, *log.quarantined)
    refuse_too_many_lost(quarantined_rows)

    groups = balls.group_touches(touches, len(names))
    p_instr_mm = touches.numbers_of(_PLACE)[groups.row]
    configurations = touches.at(groups.first)  # (C,) by the first touch of each
    located = balls.locate_balls(
        p_instr_mm,
        groups.valid,
        campaign,
        settings.stray_touch_sigma,
        str(cmm.path),
        configurations.in_words,
    )
    q_rad = np.radians(dwells.q_deg[configurations["dwell"]])
    reason = _why_unusable(located, configurations, arm, q_rad, names)
    quarantined_rows += _unused_touches(touches, groups, located, reason, settings)
    refuse_too_many_lost(quarantined_rows)

    usable = np.flatnonzero(reason == "")
    used = configurations.at(usable)
    poses = _observations(
        campaign,
        used,
        samples,
        dwells,
        located.take(usable),
        touches["time_s"][groups.row[usable]],
    )
    # Samples of idle dwells are listed after the last refusal: an arm that waits spoils no log.
    quarantined_rows += _unused_samples(samples, log.file, dwells, touched, used["dwell"])
    idle_notes, idle_warnings = _remarks_on_idle_dwells(touched, touches.file)
    of_count = screens.count_warnings(campaign.configurations, logged_count, touches.file)
    notes = (*touches.notes, *log.notes, *idle_notes)
    warnings = (*of_count, *idle_warnings, *located.remarks)
    return Ingested(poses, quarantined_rows, notes, warnings)


def _refuse_wrong_angle_unit(
    touches: RawRows,
    samples: Samples,
    campaign: CampaignDescription,
    arm: Arm,
    where_log: str,
    words: ColumnMap,
) -> None:
    """Refuse joint positions in another unit than degrees, by the motion of one ball.

    It is the ball with the most touches. The positions are compared as the log has them, before
    coupled joints are separated, since the message is about its columns.
    """
    of_one_ball = touches["ball"] == np.bincount(touches["ball"]).argmax()
    last_column = f"q{len(arm.axes_slide)}_deg"
    screens.refuse_wrong_angle_unit(
        (samples.time_s, as_logged(samples.q_deg, arm)),
        (touches["time_s"][of_one_ball], touches.numbers_of(_PLACE)[of_one_ball]),
        arm,
        float(np.linalg.norm(campaign.p_ee_balls_mm, axis=1).max()),
        f"{where_log}: {words.column('q1_deg')} … {words.column(last_column)}",
        words,
    )


def _remarks_on_idle_dwells(touched: Mask, file: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return notes and warnings of dwells (K,) in which nothing was `touched` in a file."""
    idle_count = int((~touched).sum())
    if not idle_count:
        return (), ()
    notes = (f"dwells without touches: {idle_count}",)
    if 3 * idle_count <= len(touched):
        return notes, ()
    warning = (
        f"nothing was touched in {idle_count} of the {len(touched)} dwells of the log: {file} "
        f"seems cut short, with up to {idle_count} configurations missing, unless the arm only "
        "waited there"
    )
    return notes, (warning,)


def _observations(
    campaign: CampaignDescription,
    configurations: RawRows,
    samples: Samples,
    dwells: Stations,
    located: balls.LocatedBalls,
    touch_s: Array,
) -> Observations:
    """Return U configurations as readings.

    `configurations` is the first touch of each; its balls are `located` (U, B), touched at
    `touch_s` (U, B, T).
    """
    used = located.used
    begin_s = np.where(used, touch_s, np.inf).min(axis=(1, 2), initial=np.inf)
    end_s = np.where(used, touch_s, -np.inf).max(axis=(1, 2), initial=-np.inf)
    load_N = configurations["load_N"]
    stood = while_loaded(samples, dwells, configurations["dwell"], load_N, begin_s, end_s)
    return Observations(
        pose=configurations.text_of("pose"),
        states=PoseStates(
            q_rad=np.radians(stood.q_deg),
            tau_Nm=stood.tau_Nm,
            arrival=stood.arrival,
            load_N=load_N,
            temperature_C=stood.temperature_C,
            time_s=0.5 * (begin_s + end_s),
        ),
        measured=Touched.of_balls(
            campaign.ball_names,
            campaign.p_ee_balls_mm,
            located.p_instr_mm,
            located.cov_mm2,
            used.sum(axis=2),
        ),
        kind=configurations.text_of("kind"),
        repeat=configurations["repeat"],
        readings=np.ones(len(configurations), dtype=np.int64),
        log=JointLog(np.radians(stood.q_u_deg), stood.tau_u_Nm, stood.samples),
    )


def _unused_samples(
    samples: Samples, file: str, dwells: Stations, touched: Mask, used_dwells: Index
) -> tuple[Quarantined, ...]:
    """List samples of dwells (K,) in which nothing was `touched`, or nothing that is used.

    Samples of an arm in motion are not listed. In dwells without touches it may have waited.
    """
    serves = np.zeros(len(dwells), dtype=bool)
    serves[used_dwells] = True
    at_rest, dwell = dwells.of_sample >= 0, np.maximum(dwells.of_sample, 0)
    idle = at_rest & ~touched[dwell]
    lost = at_rest & touched[dwell] & ~serves[dwell]
    return (
        *quarantined(file, samples.line[idle], NOT_TOUCHED),
        *quarantined(file, samples.line[lost], LOST),
    )


def _read_touches(
    file: RawFile, ball_names: tuple[str, ...], arm: Arm, exclusions: Exclusions
) -> tuple[RawRows, int]:
    """Read the touches in order of time, each with the number of its ball.

    Numbers of touches are only validated; touches of a ball are known by their times.

    Returns:
        The touches, and the number of configurations in the file, those without a usable touch
        included.
    """
    raw = file.read(["time_s", "kind", "pose", "load_N", "repeat", "ball", "touch", *_PLACE])
    of_known_configuration = only_labelled_rows(raw.choices("kind", KINDS), arm)
    logged_count = len(np.unique(of_known_configuration.configurations))
    raw = exclusions.without(raw)
    exclusions.refuse_missed(raw.file)
    raw = raw.choices("kind", KINDS).choices("ball", ball_names)
    raw = raw.finite(["time_s", "load_N", *_PLACE])
    raw = within_bounds(raw, ["time_s", *_PLACE], arm)
    raw = only_labelled_rows(only_whole_numbers(raw, "touch", arm), arm)
    ball = np.argmax(raw.text_of("ball")[:, None] == np.array(ball_names), axis=1)
    return raw.with_columns({"ball": ball}).in_time(), logged_count


def _read_samples(file: RawFile, arm: Arm) -> tuple[Samples, RawRows]:
    """Read the resolver and torque log; quarantine samples that repeat the time of an earlier one.

    Returns:
        The samples in order of time, and the rows that they were read from, without columns.
    """
    axes = range(1, len(arm.axes_slide) + 1)
    q, tau = [f"q{k}_deg" for k in axes], [f"tau{k}_Nm" for k in axes]
    names = ["time_s", *q, *tau, "temperature_C"]
    raw = within_bounds(unwrapped(file.read(names).finite(names), q, arm), names, arm)
    time_s = raw["time_s"]
    order = np.argsort(time_s, kind="stable")
    is_new_time = np.ones(len(time_s), dtype=bool)
    is_new_time[order[1:]] = np.diff(time_s[order]) > 0.0
    repeated = [f"{t:g} s" for t in time_s[~is_new_time]]
    raw = raw.take(is_new_time, "another sample has this time", repeated)
    raw = raw.in_time()
    q_deg = as_joints(raw.numbers_of(q), arm)
    tau_Nm = arm.coupling.beside_joints(raw.numbers_of(tau))
    samples = Samples(raw.line, raw["time_s"], q_deg, tau_Nm, raw["temperature_C"])
    return samples, replace(raw, columns={})


def _check_clocks(
    touches: RawRows,
    dwell_of_touch: Index,
    dwells: Stations,
    log_s: tuple[float, float],
    where: str,
    where_log: str,
) -> None:
    """Refuse a log in which the arm never stands still, or whose dwells miss the touches.

    They miss them where the log does not cover the touches, where most touches lie outside dwells,
    or where one offset of the clocks would bring nearly all of those outside into dwells.

    Args:
        touches: the touches, in order of time.
        dwell_of_touch: (N,) dwell of each touch, -1 outside.
        dwells: the dwells of the log.
        log_s: times of the first and the last sample.
        where: file of the touches, in messages.
        where_log: file of the log, in messages.
    """
    if not len(dwells):
        raise RawDataError(
            "the arm is never at rest in the log",
            where=where_log,
            allowed="dwells, in which the touches are made",
            remedy="check time_s, or raise ingest.still_speed_deg_s above the joints' noise",
        )
    outside, time_s = dwell_of_touch < 0, touches["time_s"]
    if outside.mean() <= FEW_OUTSIDE:
        return

    def many_outside(remedy: str) -> RawDataError:
        return RawDataError(
            f"{outside.sum()} of {len(touches)} touches lie outside any dwell of the arm",
            where=f"{where}:{touches.line[np.argmax(outside)]}",
            allowed="touches while the arm is at rest, on the clock of the resolver log",
            remedy=remedy,
        )

    offset_s, inside = best_clock_offset(time_s, dwells)
    if 1.0 - inside <= STAYS_OUTSIDE * outside.mean():
        raise many_outside(
            f"the clocks seem to differ: adding {offset_s:+.1f} s to time_s of {touches.file} "
            f"would bring {inside:.0%} of the touches into dwells"
        )
    beyond = (time_s < log_s[0]) | (time_s > log_s[1])
    if (outside & ~beyond).sum() <= FEW_OUTSIDE * len(touches):
        numbers = touches.configurations
        value = (
            f"{len(np.unique(numbers[beyond]))} of {len(np.unique(numbers))} configurations were "
            f"touched before it begins or after it ends; it covers {log_s[0]:g} to {log_s[1]:g} s"
        )
        raise RawDataError(
            "the log does not cover the touches: it seems cut short",
            where=where_log,
            value=value,
            allowed=f"a log from {time_s[0]:g} to {time_s[-1]:g} s",
            remedy="export the whole log, or leave out the touches that it does not cover",
        )
    if 2 * outside.sum() > len(touches):
        raise many_outside(
            "check both clocks and ingest.still_speed_deg_s; no constant offset matches"
        )


def _in_one_dwell(touches: RawRows, dwell_of_touch: Index) -> RawRows:
    """Keep the touches of each configuration that were made in its dwell with most touches."""

    def without(touches: RawRows, off: Mask, why: str) -> RawRows:
        return touches.take(~off, why, [f"time_s = {value:g}" for value in touches["time_s"][off]])

    touches = touches.with_columns({"dwell": dwell_of_touch})
    touches = without(touches, dwell_of_touch < 0, OUTSIDE)
    configuration = touches.configurations  # numbered anew: some may have no touch in a dwell
    commonest = balls.commonest(configuration, touches["dwell"])[configuration]
    return without(touches, touches["dwell"] != commonest, OTHER_DWELL)


def _why_unusable(
    located: balls.LocatedBalls,
    configurations: RawRows,
    arm: Arm,
    q_rad: Array,
    names: tuple[str, ...],
) -> NDArray[np.object_]:
    """Return why configurations (C,) at joint positions (C, n) cannot be used; "" where they can.

    Their balls were not located, their joints are not at the command of their label, or the arm
    cannot have put the balls there.
    """
    not_at_command = screens.off_command(configurations.text_of("pose"), q_rad, arm.prismatic)
    reason = np.where(
        (located.reason == "") & not_at_command, screens.OTHER_COMMAND, located.reason
    )
    return _off_the_arm(reason, located, arm, q_rad, configurations["kind"] == "holdout", names)


def _off_the_arm(
    reason: NDArray[np.object_],
    located: balls.LocatedBalls,
    arm: Arm,
    q_rad: Array,
    held_out: Mask,
    names: tuple[str, ...],
) -> NDArray[np.object_]:
    """Return the reasons (C,), with those of exchanged labels and of places far off the arm."""
    all_located = np.isfinite(located.p_instr_mm).all(axis=(1, 2))
    all_located &= (located.used.sum(axis=2) >= balls.LEAST_TOUCHES).all(axis=1)
    rows = np.flatnonzero(all_located)
    p_m, reason = 1e-3 * located.p_instr_mm[rows], reason.copy()
    modelled = nominal_places(Chain.of(arm).forward(q_rad[rows]), p_m)
    if modelled is None:
        return reason
    misfit = Misfit(1e-3 * misfit_mm(p_m, modelled)[:, None], np.zeros(len(rows)))
    misplaced = screens.off_model(misfit, held_out[rows])[:, 0]
    if misplaced.any():
        centres = Points(names, p_m, np.full((*p_m.shape, 3), np.nan), None)
        coupled = coupling_that_fits(arm, arm.coupling.to_axes(q_rad[rows]), centres)
        if coupled is not None:  # rows that fit with other coupled joints are right
            misplaced &= screens.off_model(coupled[1], held_out[rows]).any(axis=1)
    reason[rows[misplaced & (reason[rows] == "")]] = screens.OFF_MODEL
    for row, order in zip(rows, exchanged(p_m, modelled), strict=True):
        if order is not None:
            reason[row] = f"{EXCHANGED}: {exchange_text(order, names)}"
    return reason


def _unused_touches(
    touches: RawRows,
    groups: balls.TouchGroups,
    located: balls.LocatedBalls,
    reason: NDArray[np.object_],
    settings: IngestOptions,
) -> tuple[Quarantined, ...]:
    """List touches that are outliers, and touches of configurations that cannot be used."""
    outlier = np.zeros(len(touches), dtype=bool)
    outlier[groups.row[located.outlier]] = True
    label = np.array(touches.in_words, dtype=object)
    outlier_reason = (
        f"suspected outlier: more than {settings.stray_touch_sigma:g} sigmas off its ball"
    )
    rows = quarantined(touches.file, touches.line[outlier], outlier_reason, label[outlier])
    why_unused = np.where(outlier, "", reason[groups.of_touch]).astype(str)
    for why in np.unique(why_unused[why_unused != ""]).tolist():
        unused = why_unused == why
        rows += quarantined(touches.file, touches.line[unused], why, label[unused], label[unused])
    return rows
