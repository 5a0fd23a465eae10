"""Touches and resolver log joined by time: balls located, joints read in dwells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.campaign import balls, nominal_fit, screens
from pa10cal.campaign.bounds import labelled, unwrapped, whole, within_bounds
from pa10cal.campaign.coupled_logs import coupling_that_fits
from pa10cal.campaign.description import CampaignDescription, exclusions_of
from pa10cal.campaign.dwells import Samples, Stations, best_clock_offset, find_dwells
from pa10cal.campaign.own_columns import refuse_too_many
from pa10cal.campaign.raw_file import RawFile, words_of
from pa10cal.campaign.raw_rows import (
    Exclusions,
    Ingested,
    Quarantined,
    RawRows,
    as_joints,
    as_logged,
    quarantined,
)
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import KINDS, JointLog, Observations
from pa10cal.observe.points import Points
from pa10cal.observe.pose import Touched
from pa10cal.observe.quantities import Misfit
from pa10cal.options import IngestOptions

#: Part of the touches that may lie outside dwells before the clocks are suspected, and the part
#: of those that may still do so under the offset that is then to blame.
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
    logged = len(np.unique(touches.configurations))
    listed: list[Quarantined] = []
    words = words_of(campaign, arm.axes_slide)

    def unused() -> tuple[Quarantined, ...]:
        return (*touches.quarantined, *log.quarantined, *listed)

    def refuse_too_many_lost() -> None:
        totals = {**touches.totals, **log.totals}
        refuse_too_many(unused(), totals, settings.max_quarantined_fraction, words)

    refuse_too_many_lost()
    last = f"q{len(arm.axes_slide)}_deg"
    # The joints' motion beside that of one ball's touches.
    one = touches["ball"] == np.bincount(touches["ball"]).argmax()
    screens.refuse_wrong_angle_unit(
        (samples.time_s, as_logged(samples.q_deg, arm)),
        (touches["time_s"][one], touches.numbers_of(_PLACE)[one]),
        arm,
        float(np.linalg.norm(campaign.p_ee_balls_mm, axis=1).max()),
        f"{resolver.path}: {words.column('q1_deg')} … {words.column(last)}",
        words,
    )

    dwells = find_dwells(samples, settings.still_speed_deg_s)
    touched = dwells.at(touches["time_s"])
    log_s = float(samples.time_s[0]), float(samples.time_s[-1])
    _check_clocks(touches, touched, dwells, log_s, str(cmm.path), str(resolver.path))
    touches = _in_one_dwell(touches, touched)
    refuse_too_many_lost()

    groups = balls.group_touches(touches, len(names))
    p_instr_mm = touches.numbers_of(_PLACE)[groups.row]
    located = balls.locate_balls(
        p_instr_mm, groups.valid, campaign, settings.stray_touch_sigma, str(cmm.path)
    )
    named = touches.at(groups.first)
    q_rad = np.radians(dwells.q_deg[named["dwell"]])
    off = screens.off_command(named.text_of("pose"), q_rad, arm.prismatic)
    reason = np.where((located.reason == "") & off, screens.OTHER_COMMAND, located.reason)
    reason = _off_the_arm(reason, located, arm, q_rad, named["kind"] == "holdout", names)
    listed += _unused_touches(touches, groups, located, reason, settings)
    refuse_too_many_lost()

    good = np.flatnonzero(reason == "")
    used, time_s = located.used[good], touches["time_s"][groups.row[good]]
    begin = np.where(used, time_s, np.inf).min(axis=(1, 2), initial=np.inf)
    end = np.where(used, time_s, -np.inf).max(axis=(1, 2), initial=-np.inf)
    named = named.at(good)
    at = named["dwell"]
    poses = Observations(
        pose=named.text_of("pose"),
        states=PoseStates(
            q_rad=q_rad[good],
            tau_Nm=dwells.tau_Nm[at],
            arrival=dwells.arrival[at],
            load_N=named["load_N"],
            temperature_C=dwells.temperature_C[at],
            time_s=0.5 * (begin + end),
        ),
        measured=Touched.of_balls(
            names,
            campaign.p_ee_balls_mm,
            located.p_instr_mm[good],
            located.cov_mm2[good],
            used.sum(axis=2),
        ),
        kind=named.text_of("kind"),
        repeat=named["repeat"],
        readings=np.ones(len(good), dtype=np.int64),
        log=JointLog(np.radians(dwells.q_u_deg[at]), dwells.tau_u_Nm[at], dwells.samples[at]),
    )
    # Samples of dwells that serve no configuration; the arm may have waited there.
    serves, seen = np.zeros(len(dwells), dtype=bool), np.zeros(len(dwells), dtype=bool)
    serves[at] = True
    seen[touched[touched >= 0]] = True
    stands, of_sample = dwells.of_sample >= 0, np.maximum(dwells.of_sample, 0)
    listed += quarantined(log.file, samples.line[stands & ~seen[of_sample]], NOT_TOUCHED)
    lost = stands & seen[of_sample] & ~serves[of_sample]
    listed += quarantined(log.file, samples.line[lost], LOST)
    notes, warnings = [*touches.notes, *log.notes], []
    if idle := int((~seen).sum()):
        notes.append(f"dwells without touches: {idle}")
    if 3 * idle > len(dwells):
        warnings.append(
            f"nothing was touched in {idle} of the {len(dwells)} dwells of the log: "
            f"{touches.file} seems cut short, {idle} configurations are missing"
        )
    counted = screens.count_warnings(campaign.configurations, logged, touches.file)
    return Ingested(poses, unused(), tuple(notes), (*counted, *warnings))


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
    """Read the resolver and torque log; samples at the time of an earlier one are quarantined.

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
    touched: Index,
    dwells: Stations,
    log_s: tuple[float, float],
    where: str,
    where_log: str,
) -> None:
    """Stop when the arm never stood still, or the touches are not in the dwells.

    That is when the log does not cover them, when most of them lie outside the dwells, or when an
    offset of the clocks would bring in nearly all of those that do.
    """
    if not len(dwells):
        raise RawDataError(
            "the arm is never at rest in the log",
            where=where_log,
            allowed="dwells, in which the touches are made",
            remedy="check time_s, or raise ingest.still_speed_deg_s above the joints' noise",
        )
    outside, time_s = touched < 0, touches["time_s"]
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
    if 2 * outside.sum() > len(touched) or explained:
        remedy = (
            "check both clocks and ingest.still_speed_deg_s; no constant offset matches"
            if not explained
            else f"the clocks seem to differ: adding {offset_s:+.1f} s to time_s would bring "
            f"{inside:.0%} of the touches into dwells"
        )
        raise RawDataError(
            f"{outside.sum()} of {len(touched)} touches lie outside any dwell of the arm",
            where=f"{where}:{touches.line[np.argmax(outside)]}",
            allowed="touches while the arm is at rest, on the clock of the resolver log",
            remedy=remedy,
        )


def _in_one_dwell(touches: RawRows, touched: Index) -> RawRows:
    """Keep the touches of each configuration that were made in one and the same dwell."""
    touches = touches.with_columns({"dwell": touched})

    def without(off: NDArray[np.bool_], why: str) -> RawRows:
        return touches.take(~off, why, [f"time_s = {value:g}" for value in touches["time_s"][off]])

    touches = without(touched < 0, OUTSIDE)
    of_touch = touches.configurations
    commonest = balls.commonest(of_touch, touches["dwell"])[of_touch]
    return without(touches["dwell"] != commonest, OTHER_DWELL)


def _off_the_arm(
    reason: NDArray[np.object_],
    located: balls.LocatedBalls,
    arm: Arm,
    q_rad: Array,
    held_out: NDArray[np.bool_],
    names: tuple[str, ...],
) -> NDArray[np.object_]:
    """Name configurations whose labels are exchanged, and those far off the nominal arm."""
    usable = np.isfinite(located.p_instr_mm).all(axis=(1, 2))
    usable &= (located.used.sum(axis=2) >= balls.LEAST_TOUCHES).all(axis=1)
    rows = np.flatnonzero(usable)
    p_m, found = 1e-3 * located.p_instr_mm[rows], reason.copy()
    modelled = nominal_fit.nominal_places(Chain.of(arm).forward(q_rad[rows]), p_m)
    if modelled is None:
        return found
    misfit = Misfit(1e-3 * nominal_fit.misfit_mm(p_m, modelled)[:, None], np.zeros(len(rows)))
    off = screens.off_model(misfit, held_out[rows])[:, 0]
    if off.any():
        centres = Points(names, p_m, np.full((*p_m.shape, 3), np.nan), None)
        coupled = coupling_that_fits(arm, arm.coupling.to_axes(q_rad[rows]), centres)
        if coupled is not None:  # these are right
            off &= screens.off_model(coupled[1], held_out[rows]).any(axis=1)
    found[rows[off & (reason[rows] == "")]] = screens.OFF_MODEL
    for row, order in zip(rows, nominal_fit.exchanged(p_m, modelled), strict=True):
        if order is not None:
            found[row] = f"{nominal_fit.EXCHANGED}: {nominal_fit.exchange_text(order, names)}"
    return found


def _unused_touches(
    touches: RawRows,
    groups: balls.TouchGroups,
    located: balls.LocatedBalls,
    reason: NDArray[np.object_],
    settings: IngestOptions,
) -> tuple[Quarantined, ...]:
    """List touches that are outliers, and touches of configurations that cannot be used."""
    off = np.zeros(len(touches), dtype=bool)
    off[groups.row[located.outlier]] = True
    why = np.where(off, "", reason[groups.of_touch]).astype(str)
    parts = (touches.text_of("pose"), touches["load_N"], touches["repeat"])
    words = [f"{pose} at {load:g} N, repeat {k}" for pose, load, k in zip(*parts, strict=True)]
    label = np.array(words, dtype=object)
    outlier = f"suspected outlier: more than {settings.stray_touch_sigma:g} sigmas off its ball"
    rows = quarantined(touches.file, touches.line[off], outlier, label[off])
    for text in np.unique(why[why != ""]).tolist():
        these = why == text
        places = [f"pose {each}" for each in label[these]]
        rows += quarantined(touches.file, touches.line[these], text, label[these], places)
    return rows
