"""Touches and resolver log joined by time: balls located, joints read in dwells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.campaign import screens
from pa10cal.campaign.balls import (
    LEAST_TOUCHES,
    LocatedBalls,
    TouchedTool,
    TouchGroups,
    commonest,
    group_touches,
    locate_balls,
)
from pa10cal.campaign.bounds import Bounds
from pa10cal.campaign.description import CampaignDescription, exclusions_of
from pa10cal.campaign.dwells import (
    DwellReadings,
    Dwells,
    best_clock_offset,
    dwell_readings,
    find_dwells,
)
from pa10cal.campaign.labels import EXCHANGED, exchange_text, exchanged, misfit_mm, nominal_places
from pa10cal.campaign.own_words import refuse_too_many
from pa10cal.campaign.raw_file import RawFile, words_of
from pa10cal.campaign.raw_rows import Ingested, Quarantined, quarantined
from pa10cal.campaign.rows import Samples, Touches, read_samples, read_touches
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import JointLog, Observations
from pa10cal.observe.quantities import Misfit
from pa10cal.observe.touched import Touched
from pa10cal.options import IngestOptions

#: The touches' scatter may exceed the instrument's statement by this factor without a note.
SCATTER_NOTE = 1.5
#: Part of the touches that may lie outside dwells before the clocks are suspected, and the part
#: of those that may still do so under the offset that is then to blame.
FEW_OUTSIDE = 0.05
OFFSET_LEAVES = 0.2

OUTSIDE = "touched outside any dwell: the arm moved, or the clocks differ"
OTHER_DWELL = "touched in another dwell than the rest of its configuration"
NOT_TOUCHED = "a dwell in which nothing was touched"
LOST = "a dwell whose configuration is quarantined"


def read_touched(
    campaign: CampaignDescription, arm: Arm, folder: Path, settings: IngestOptions
) -> Ingested:
    """Read a campaign of a touch-trigger instrument.

    Args:
        campaign: its description.
        arm: the nominal arm.
        folder: its folder.
        settings: the `ingest` section.

    Returns:
        One entry a configuration, and every row that is quarantined.

    Raises:
        RawDataError: when a file, or too much of it, cannot be used.
    """
    files = [RawFile.of(campaign, folder, key, arm.prismatic) for key in ("cmm", "resolver")]
    cmm, resolver = (file.path for file in files)
    touches, cmm_read = read_touches(
        files[0], campaign.ball_names, Bounds(arm), exclusions_of(campaign, folder)
    )
    samples, resolver_read = read_samples(files[1], Bounds(arm))
    logged = len(np.unique(touches.configurations))
    reads = (cmm_read, resolver_read)
    totals = {read.file: read.total for read in reads}
    listed = [*cmm_read.quarantined, *resolver_read.quarantined]
    words = words_of(campaign, arm.prismatic)
    refuse_too_many(listed, totals, settings.max_quarantined_fraction, words)
    # The joints' motion beside that of one ball's touches.
    one = touches.ball == np.bincount(touches.ball).argmax()
    screens.refuse_wrong_angle_unit(
        (samples.time_s, samples.q_deg),
        (touches.time_s[one], touches.p_instr_mm[one]),
        arm,
        float(np.linalg.norm(campaign.p_ee_balls_mm, axis=1).max()),
        f"{resolver}: {words.column('q1_deg')} … {words.column(f'q{arm.n}_deg')}",
        words,
    )

    dwells = find_dwells(samples, settings.still_speed_deg_s)
    touched = dwells.at(touches.time_s)
    log_s = float(samples.time_s[0]), float(samples.time_s[-1])
    _check_clocks(touches, touched, dwells, log_s, str(cmm), str(resolver))
    touches, dwell, outside = _in_one_dwell(touches, touched, cmm.name)
    listed += outside
    refuse_too_many(listed, totals, settings.max_quarantined_fraction, words)

    groups = group_touches(touches, len(campaign.ball_names))
    tool = TouchedTool(
        names=campaign.ball_names,
        p_ee_balls_mm=campaign.p_ee_balls_mm,
        radius_mm=0.5 * float(campaign.ball_diameter_mm or np.nan),
        centre_uncertainty_mm=campaign.instrument.uncertainty_mm,
        outlier_sigma=settings.stray_touch_sigma,
    )
    balls = locate_balls(touches.p_instr_mm[groups.row], groups.valid, tool, str(cmm))
    readings = dwell_readings(samples, dwells)
    dwell = dwell[groups.first]
    off = screens.off_command(touches.pose[groups.first], readings.q_rad[dwell], arm.prismatic)
    late = (balls.reason == "") & off
    reason = np.where(late, screens.OTHER_COMMAND, balls.reason)
    T_base_ee = Chain.of(arm).forward(readings.q_rad[dwell])
    held_out = touches.kind[groups.first] == "holdout"
    reason = _off_the_arm(reason, balls, T_base_ee, held_out, tool)
    listed += _unused_touches(touches, groups, balls, reason, cmm.name, settings)
    refuse_too_many(listed, totals, settings.max_quarantined_fraction, words)

    good = np.flatnonzero(reason == "")
    poses = _assemble(tool, touches, groups, balls, readings, dwell, good)
    idle, idle_notes = _idle_samples(samples, dwells, touched, dwell[good], resolver.name)
    notes = [note for read in reads for note in read.notes]
    if balls.pooled_sigma_mm > SCATTER_NOTE * balls.touch_sigma_mm:
        notes.append(
            f"touches scatter by {balls.pooled_sigma_mm:.4f} mm where the stated uncertainty "
            f"implies {balls.touch_sigma_mm:.4f} mm"
        )
    warnings = (
        *screens.count_warnings(campaign.configurations, logged, cmm.name),
        *_cut_touches(dwells, touched, cmm.name),
    )
    return Ingested(poses, (*listed, *idle), (*notes, *idle_notes), warnings)


def _check_clocks(
    touches: Touches,
    touched: Index,
    dwells: Dwells,
    log_s: tuple[float, float],
    where: str,
    where_log: str,
) -> None:
    """Stop when the arm never stood still, or the touches are not in the dwells.

    That is when most touches lie outside the dwells, or when an offset of the clocks would bring in
    nearly all of those that do.
    """
    if not len(dwells):
        raise RawDataError(
            "the arm is never at rest in the log",
            where=where_log,
            allowed="dwells, in which the touches are made",
            remedy="check time_s, or raise ingest.still_speed_deg_s above the joints' noise",
        )
    outside = touched < 0
    if outside.mean() <= FEW_OUTSIDE:
        return
    offset = best_clock_offset(touches.time_s, dwells)
    explained = 1.0 - offset.inside <= OFFSET_LEAVES * outside.mean()
    if not explained:
        _refuse_cut_log(touches, outside, log_s, where_log)
    if 2 * outside.sum() <= len(touched) and not explained:
        return
    raise RawDataError(
        f"{outside.sum()} of {len(touched)} touches lie outside any dwell of the arm",
        where=f"{where}:{touches.line[np.argmax(outside)]}",
        allowed="touches while the arm is at rest, on the clock of the resolver log",
        remedy=f"the clocks seem to differ: adding {offset.seconds:+.1f} s to time_s would bring "
        f"{offset.inside:.0%} of the touches into dwells"
        if explained
        else "check both clocks and ingest.still_speed_deg_s; no constant offset matches",
    )


def _refuse_cut_log(
    touches: Touches, outside: NDArray[np.bool_], log_s: tuple[float, float], where_log: str
) -> None:
    """Stop when touches lie outside dwells because the log does not cover them."""
    beyond = (touches.time_s < log_s[0]) | (touches.time_s > log_s[1])
    if (outside & ~beyond).sum() > FEW_OUTSIDE * len(touches):
        return
    numbers = touches.configurations
    missing, every = len(np.unique(numbers[beyond])), len(np.unique(numbers))
    raise RawDataError(
        "the log does not cover the touches: it seems cut short",
        where=where_log,
        value=f"{missing} of {every} configurations were touched before it begins or after it "
        f"ends; it covers {log_s[0]:g} to {log_s[1]:g} s",
        allowed=f"a log from {touches.time_s[0]:g} to {touches.time_s[-1]:g} s",
        remedy="export the whole log, or leave out the touches that it does not cover",
    )


def _in_one_dwell(
    touches: Touches, touched: Index, file: str
) -> tuple[Touches, Index, tuple[Quarantined, ...]]:
    """Keep the touches of each configuration that were made in one and the same dwell."""
    outside = touched < 0
    rows = quarantined(file, touches.line[outside], OUTSIDE, _seconds(touches.time_s[outside]))
    touches, touched = touches.take(~outside), touched[~outside]
    of_touch = touches.configurations
    other = touched != commonest(of_touch, touched)[of_touch]
    rows += quarantined(file, touches.line[other], OTHER_DWELL, _seconds(touches.time_s[other]))
    return touches.take(~other), touched[~other], rows


def _off_the_arm(
    reason: NDArray[np.object_],
    balls: LocatedBalls,
    T_base_ee: Array,
    held_out: NDArray[np.bool_],
    tool: TouchedTool,
) -> NDArray[np.object_]:
    """Name configurations whose labels are exchanged, and those far off the nominal arm."""
    located = np.isfinite(balls.p_instr_mm).all(axis=(1, 2))
    located &= (balls.used.sum(axis=2) >= LEAST_TOUCHES).all(axis=1)
    rows = np.flatnonzero(located)
    p_m, found = 1e-3 * balls.p_instr_mm[rows], reason.copy()
    modelled = nominal_places(T_base_ee[rows], p_m)
    if modelled is None:
        return found
    misfit = Misfit(1e-3 * misfit_mm(p_m, modelled)[:, None], np.zeros(len(rows)))
    off = screens.off_model(misfit, held_out[rows])[:, 0]
    found[rows[off & (reason[rows] == "")]] = screens.OFF_MODEL
    for row, order in zip(rows, exchanged(p_m, modelled), strict=True):
        if order is not None:
            found[row] = f"{EXCHANGED}: {exchange_text(order, tool.names)}"
    return found


def _unused_touches(
    touches: Touches,
    groups: TouchGroups,
    balls: LocatedBalls,
    reason: NDArray[np.object_],
    file: str,
    settings: IngestOptions,
) -> tuple[Quarantined, ...]:
    """List touches that are outliers, and touches of configurations that cannot be used."""
    off = np.zeros(len(touches), dtype=bool)
    off[groups.row[balls.outlier]] = True
    why = np.where(off, "", reason[groups.of_touch])
    lost = np.flatnonzero(why != "")
    parts = (touches.pose, touches.load_N, touches.repeat)
    words = [f"{pose} at {load:g} N, repeat {k}" for pose, load, k in zip(*parts, strict=True)]
    labels = np.array(words, dtype=object)
    where = np.array([f"pose {label}" for label in labels], dtype=object)
    outlier = f"suspected outlier: more than {settings.stray_touch_sigma:g} sigmas off its ball"
    rows = quarantined(file, touches.line[off], outlier, labels[off])
    for text in np.unique(why[lost].astype(str)):
        these = why == text
        rows += quarantined(file, touches.line[these], str(text), labels[these], where[these])
    return rows


def _assemble(
    tool: TouchedTool,
    touches: Touches,
    groups: TouchGroups,
    balls: LocatedBalls,
    readings: DwellReadings,
    dwell: Index,
    good: Index,
) -> Observations:
    """Fit the end-effector to the balls of the good configurations and gather their readings."""
    first, at = groups.first[good], dwell[good]
    used, time_s = balls.used[good], touches.time_s[groups.row[good]]
    begin = np.where(used, time_s, np.inf).min(axis=(1, 2), initial=np.inf)
    end = np.where(used, time_s, -np.inf).max(axis=(1, 2), initial=-np.inf)
    states = PoseStates(
        q_rad=readings.q_rad[at],
        tau_Nm=readings.tau_Nm[at],
        arrival=readings.arrival[at],
        load_N=touches.load_N[first],
        temperature_C=readings.temperature_C[at],
        time_s=0.5 * (begin + end),
    )
    return Observations(
        pose=touches.pose[first],
        states=states,
        measured=Touched.of_balls(
            tool.names,
            tool.p_ee_balls_mm,
            balls.p_instr_mm[good],
            balls.cov_mm2[good],
            used.sum(axis=2),
        ),
        kind=touches.kind[first],
        repeat=touches.repeat[first],
        readings=np.ones(len(good), dtype=np.int64),
        log=JointLog(readings.q_u_rad[at], readings.tau_u_Nm[at], readings.samples[at]),
    )


def _idle_samples(
    samples: Samples, dwells: Dwells, touched: Index, used: Index, file: str
) -> tuple[tuple[Quarantined, ...], list[str]]:
    """List the samples of dwells that serve no configuration; the arm may have waited there."""
    serves, seen = np.zeros(len(dwells), dtype=bool), np.zeros(len(dwells), dtype=bool)
    serves[used] = True
    seen[touched[touched >= 0]] = True
    standing = dwells.of_sample >= 0
    dwell = np.where(standing, dwells.of_sample, 0)
    lost = standing & seen[dwell] & ~serves[dwell]
    idle = standing & ~seen[dwell]
    rows = quarantined(file, samples.line[idle], NOT_TOUCHED)
    rows += quarantined(file, samples.line[lost], LOST)
    count = int((~seen).sum())
    return rows, [f"dwells without touches: {count}"] if count else []


def _cut_touches(dwells: Dwells, touched: Index, file: str) -> tuple[str, ...]:
    """Say how many configurations are missing where the arm stood in many more than these."""
    without = len(dwells) - len(np.unique(touched[touched >= 0]))
    if 3 * without <= len(dwells):
        return ()
    return (
        f"nothing was touched in {without} of the {len(dwells)} dwells of the log: {file} seems "
        f"cut short, {without} configurations are missing",
    )


def _seconds(time_s: Array) -> list[str]:
    return [f"time_s = {value:g}" for value in time_s]
