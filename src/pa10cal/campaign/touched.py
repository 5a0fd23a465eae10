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
from pa10cal.campaign.bounds import labelled, unwrapped, whole, within_bounds
from pa10cal.campaign.coupled_logs import coupling_that_fits
from pa10cal.campaign.description import CampaignDescription, exclusions_of
from pa10cal.campaign.dwells import Samples, Stations, best_clock_offset, find_dwells
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

#: Part of the touches that may lie outside dwells before the clocks are suspected. A clock offset
#: is to blame if under it no more than `OFFSET_LEAVES` of those remain outside.
FEW_OUTSIDE = 0.05
OFFSET_LEAVES = 0.2

_PLACE = ("x_mm", "y_mm", "z_mm")

OUTSIDE = "touched outside any dwell: the arm moved, or the clocks differ"
OTHER_DWELL = "touched in another dwell than the rest of its configuration"
NOT_TOUCHED = "a dwell in which nothing was touched"
LOST = "a dwell whose configuration is quarantined"


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
    names = campaign.ball_names
    touches = _read_touches(cmm, names, arm, exclusions_of(campaign, folder))
    samples, log = _read_samples(resolver, arm)
    logged_count = len(np.unique(touches.configurations))
    listed: list[Quarantined] = []
    words = words_of(campaign, arm.axes_slide)

    def all_quarantined() -> tuple[Quarantined, ...]:
        return (*touches.quarantined, *log.quarantined, *listed)

    def refuse_too_many_lost() -> None:
        totals = {**touches.totals, **log.totals}
        refuse_too_many(all_quarantined(), totals, settings.max_quarantined_fraction, words)

    refuse_too_many_lost()
    last_column = f"q{len(arm.axes_slide)}_deg"
    # The joints' motion is compared with that of one ball, the one touched most.
    of_one_ball = touches["ball"] == np.bincount(touches["ball"]).argmax()
    screens.refuse_wrong_angle_unit(
        (samples.time_s, as_logged(samples.q_deg, arm)),
        (touches["time_s"][of_one_ball], touches.numbers_of(_PLACE)[of_one_ball]),
        arm,
        float(np.linalg.norm(campaign.p_ee_balls_mm, axis=1).max()),
        f"{resolver.path}: {words.column('q1_deg')} … {words.column(last_column)}",
        words,
    )

    dwells = find_dwells(samples, settings.still_speed_deg_s)
    dwell_of_touch = dwells.at(touches["time_s"])
    log_s = float(samples.time_s[0]), float(samples.time_s[-1])
    _check_clocks(touches, dwell_of_touch, dwells, log_s, str(cmm.path), str(resolver.path))
    touches = _in_one_dwell(touches, dwell_of_touch)
    refuse_too_many_lost()

    groups = balls.group_touches(touches, len(names))
    located = balls.locate_balls(
        touches.numbers_of(_PLACE)[groups.row],
        groups.valid,
        campaign,
        settings.stray_touch_sigma,
        str(cmm.path),
    )
    configurations = touches.at(groups.first)
    q_rad = np.radians(dwells.q_deg[configurations["dwell"]])
    off = screens.off_command(configurations.text_of("pose"), q_rad, arm.prismatic)
    reason = np.where((located.reason == "") & off, screens.OTHER_COMMAND, located.reason)
    reason = _off_the_arm(reason, located, arm, q_rad, configurations["kind"] == "holdout", names)
    listed += _unused_touches(touches, groups, located, reason, settings)
    refuse_too_many_lost()

    usable = np.flatnonzero(reason == "")
    configurations = configurations.at(usable)
    touch_s = touches["time_s"][groups.row[usable]]
    poses = _observations(campaign, configurations, q_rad[usable], dwells, located, usable, touch_s)
    touched = np.zeros(len(dwells), dtype=bool)
    touched[dwell_of_touch[dwell_of_touch >= 0]] = True
    listed += _unused_samples(samples, log.file, dwells, touched, configurations["dwell"])
    notes, warnings = [*touches.notes, *log.notes], []
    idle_count = int((~touched).sum())
    if idle_count:
        notes.append(f"dwells without touches: {idle_count}")
    if 3 * idle_count > len(dwells):
        warnings.append(
            f"nothing was touched in {idle_count} of the {len(dwells)} dwells of the log: "
            f"{touches.file} seems cut short, {idle_count} configurations are missing"
        )
    of_count = screens.count_warnings(campaign.configurations, logged_count, touches.file)
    return Ingested(poses, all_quarantined(), tuple(notes), (*of_count, *warnings))


def _observations(
    campaign: CampaignDescription,
    configurations: RawRows,
    q_rad: Array,
    dwells: Stations,
    located: balls.LocatedBalls,
    usable: Index,
    touch_s: Array,
) -> Observations:
    """Return U configurations as readings.

    `configurations` is the first touch of each, at joint positions `q_rad` (U, n); its balls are
    rows `usable` of `located`, touched at `touch_s` (U, B, T).
    """
    used, dwell = located.used[usable], configurations["dwell"]
    begin_s = np.where(used, touch_s, np.inf).min(axis=(1, 2), initial=np.inf)
    end_s = np.where(used, touch_s, -np.inf).max(axis=(1, 2), initial=-np.inf)
    return Observations(
        pose=configurations.text_of("pose"),
        states=PoseStates(
            q_rad=q_rad,
            tau_Nm=dwells.tau_Nm[dwell],
            arrival=dwells.arrival[dwell],
            load_N=configurations["load_N"],
            temperature_C=dwells.temperature_C[dwell],
            time_s=0.5 * (begin_s + end_s),
        ),
        measured=Touched.of_balls(
            campaign.ball_names,
            campaign.p_ee_balls_mm,
            located.p_instr_mm[usable],
            located.cov_mm2[usable],
            used.sum(axis=2),
        ),
        kind=configurations.text_of("kind"),
        repeat=configurations["repeat"],
        readings=np.ones(len(usable), dtype=np.int64),
        log=JointLog(
            np.radians(dwells.q_u_deg[dwell]), dwells.tau_u_Nm[dwell], dwells.samples[dwell]
        ),
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
) -> RawRows:
    """Read the touches in order of time, each with the number of its ball."""
    raw = file.read(["time_s", "kind", "pose", "load_N", "repeat", "ball", "touch", *_PLACE])
    raw = exclusions.labels(exclusions.lines(raw))
    raw = raw.choices("kind", KINDS).choices("ball", ball_names)
    raw = raw.finite(["time_s", "load_N", *_PLACE])
    raw = within_bounds(raw, ["time_s", *_PLACE], arm)
    raw = labelled(whole(raw, "touch", arm), arm)
    ball = np.argmax(raw.text_of("ball")[:, None] == np.array(ball_names), axis=1)
    return raw.with_columns({"ball": ball}).in_time()


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
    first = np.ones(len(time_s), dtype=bool)
    first[order[1:]] = np.diff(time_s[order]) > 0.0
    raw = raw.take(first, "another sample has this time", [f"{t:g} s" for t in time_s[~first]])
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
    offset_s, inside = best_clock_offset(time_s, dwells)
    explained = 1.0 - inside <= OFFSET_LEAVES * outside.mean()
    beyond = (time_s < log_s[0]) | (time_s > log_s[1])
    if not explained and (outside & ~beyond).sum() <= FEW_OUTSIDE * len(touches):
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
    if 2 * outside.sum() > len(touches) or explained:
        remedy = (
            "check both clocks and ingest.still_speed_deg_s; no constant offset matches"
            if not explained
            else f"the clocks seem to differ: adding {offset_s:+.1f} s to time_s would bring "
            f"{inside:.0%} of the touches into dwells"
        )
        raise RawDataError(
            f"{outside.sum()} of {len(touches)} touches lie outside any dwell of the arm",
            where=f"{where}:{touches.line[np.argmax(outside)]}",
            allowed="touches while the arm is at rest, on the clock of the resolver log",
            remedy=remedy,
        )


def _in_one_dwell(touches: RawRows, dwell_of_touch: Index) -> RawRows:
    """Keep the touches of each configuration that were made in its dwell with most touches."""
    touches = touches.with_columns({"dwell": dwell_of_touch})

    def without(off: Mask, why: str) -> RawRows:
        return touches.take(~off, why, [f"time_s = {value:g}" for value in touches["time_s"][off]])

    touches = without(dwell_of_touch < 0, OUTSIDE)
    configuration = touches.configurations
    commonest = balls.commonest(configuration, touches["dwell"])[configuration]
    return without(touches["dwell"] != commonest, OTHER_DWELL)


def _off_the_arm(
    reason: NDArray[np.object_],
    located: balls.LocatedBalls,
    arm: Arm,
    q_rad: Array,
    held_out: Mask,
    names: tuple[str, ...],
) -> NDArray[np.object_]:
    """Return the reasons (C,), with those of exchanged labels and of places far off the arm."""
    usable = np.isfinite(located.p_instr_mm).all(axis=(1, 2))
    usable &= (located.used.sum(axis=2) >= balls.LEAST_TOUCHES).all(axis=1)
    rows = np.flatnonzero(usable)
    p_m, reason = 1e-3 * located.p_instr_mm[rows], reason.copy()
    modelled = nominal_places(Chain.of(arm).forward(q_rad[rows]), p_m)
    if modelled is None:
        return reason
    misfit = Misfit(1e-3 * misfit_mm(p_m, modelled)[:, None], np.zeros(len(rows)))
    off = screens.off_model(misfit, held_out[rows])[:, 0]
    if off.any():
        centres = Points(names, p_m, np.full((*p_m.shape, 3), np.nan), None)
        coupled = coupling_that_fits(arm, arm.coupling.to_axes(q_rad[rows]), centres)
        if coupled is not None:  # rows that fit with other coupled joints are right
            off &= screens.off_model(coupled[1], held_out[rows]).any(axis=1)
    reason[rows[off & (reason[rows] == "")]] = screens.OFF_MODEL
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
    parts = (touches.text_of("pose"), touches["load_N"], touches["repeat"])
    words = [f"{pose} at {load:g} N, repeat {k}" for pose, load, k in zip(*parts, strict=True)]
    label = np.array(words, dtype=object)
    why = f"suspected outlier: more than {settings.stray_touch_sigma:g} sigmas off its ball"
    rows = quarantined(touches.file, touches.line[outlier], why, label[outlier])
    why_unused = np.where(outlier, "", reason[groups.of_touch]).astype(str)
    for why in np.unique(why_unused[why_unused != ""]).tolist():
        unused = why_unused == why
        places = [f"pose {text}" for text in label[unused]]
        rows += quarantined(touches.file, touches.line[unused], why, label[unused], places)
    return rows
