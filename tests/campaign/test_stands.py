"""Readings that were repeated while the arm stood still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import at_rest
from made_up_sightings import sighted
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.screens import OFF_STAND, STAND_DISAGREES
from pa10cal.campaign.stands import standing, with_stands_averaged
from pa10cal.errors import RawDataError
from pa10cal.observe.observations import JointLog, Observations
from pa10cal.observe.points import Distance, Points
from pa10cal.observe.pose import Pose
from pa10cal.options import IngestOptions
from spoiling import ingest

POSES, TIMES = 30, 3
STATED_M, READING_M = 2e-5, 1.25e-6


def repeated(kind="points", *, moved=False, off_m=0.0, **states):
    """Return three readings of each of 30 poses, one after the other, or round by round."""
    rng = np.random.default_rng(2)
    q = np.repeat(rng.uniform(-1.0, 1.0, (POSES, 6)), TIMES, axis=0)
    place_m = np.repeat(rng.uniform(0.5, 1.0, (POSES, 3)), TIMES, axis=0)
    place_m += rng.normal(0.0, READING_M, place_m.shape)
    place_m[1] += off_m
    time_s = np.arange(float(POSES * TIMES))
    if moved:
        time_s = np.tile(np.arange(TIMES) * float(POSES), POSES) + np.repeat(
            np.arange(POSES), TIMES
        )
    if kind == "points":
        cov_m2 = np.broadcast_to(STATED_M**2 * np.eye(3), (len(q), 1, 3, 3))
        measured = Points(("T1",), place_m[:, None], cov_m2, None)
    elif kind == "distance":
        measured = Distance(place_m[:, 0], np.full(len(q), STATED_M))
    else:
        T = np.tile(np.eye(4), (len(q), 1, 1))
        T[:, :3, 3] = place_m
        measured = Pose.of(T, np.broadcast_to(STATED_M**2 * np.eye(6), (len(q), 6, 6)))
    labels = np.array([f"P{k // TIMES:02}" for k in range(len(q))])
    return Observations.single(labels, at_rest(q, time_s=time_s, **states), measured)


def unchanged(every):
    """Return whether readings stay as they are."""
    averaged = with_stands_averaged(every)
    return averaged.readings is every and averaged.notes == () and not averaged.why_left_out.any()


@pytest.mark.parametrize("kind", ["points", "distance", "pose"])
def test_those_that_scatter_less_than_is_stated_count_as_one(kind):
    every = repeated(kind)
    averaged = with_stands_averaged(every)
    merged, notes = averaged.readings, averaged.notes
    assert len(merged) == POSES
    assert merged.readings.tolist() == [1] * POSES
    expected = every.measured.places_m.reshape(POSES, TIMES, -1).mean(axis=1)
    np.testing.assert_allclose(merged.measured.places_m.reshape(POSES, -1), expected)
    variance = np.diagonal(merged.measured.stated_covariance, axis1=1, axis2=2)
    np.testing.assert_allclose(variance, STATED_M**2)
    assert "90 readings count as 30: as far as the log shows, the arm did not move" in notes[0]
    assert "0.02 mm stated" in notes[0]


def test_those_between_which_the_arm_moved_stay_as_they_are():
    every = repeated(moved=True)
    assert len(np.unique(standing(every))) == len(every)
    assert unchanged(every)


ARRIVED = np.ones((POSES * TIMES, 6))


@pytest.mark.parametrize("shown_by", ["directions", "positions", "samples"])
def test_those_that_a_log_shows_to_be_approached_anew_stay_as_they_are(shown_by):
    """Of every dwell a log gives one mean of the joints, and how they came there."""
    every = repeated(arrival=ARRIVED)
    assert len(with_stands_averaged(every).readings) == POSES  # several of one dwell
    turns, count = np.arange(POSES * TIMES) % TIMES, POSES * TIMES
    if shown_by == "directions":
        every = repeated(arrival=np.where(turns == 1, -1.0, 1.0)[:, None] * ARRIVED)
    elif shown_by == "positions":
        q_rad = every.states.q_rad + 1e-6 * turns[:, None]
        every = every.with_states(replace(every.states, q_rad=q_rad))
        not_arrived = replace(every.states, arrival=0.0 * ARRIVED)
        assert len(with_stands_averaged(every.with_states(not_arrived)).readings) == POSES
    else:
        unknown = np.full((count, 6), np.nan)
        every = replace(every, log=JointLog(unknown, unknown, 100 + turns))
    assert unchanged(every)


def test_those_that_scatter_as_stated_stay_as_they_are():
    every = repeated()
    cov_m2 = np.full_like(every.measured.cov_m2, 0.0) + (2.0 * READING_M) ** 2 * np.eye(3)
    every = replace(every, measured=replace(every.measured, cov_m2=cov_m2))
    assert unchanged(every)


def test_the_scatter_of_rounded_readings_is_theirs():
    """Where most readings of a stand are equal, their mean difference tells the scatter.

    The factor of the median goes with it: that of a mean of normal differences gives 0.76 here.
    """
    every = repeated()
    rng, step_m = np.random.default_rng(4), 4e-6
    p_m = np.repeat(every.measured.p_instr_m[::TIMES], TIMES, axis=0).round(5)
    p_m += step_m * np.rint(rng.normal(0.0, 0.45, p_m.shape))
    every = every.with_measured(p_instr_m=p_m)
    scatter_mm = 1e3 * np.sqrt(p_m.reshape(POSES, TIMES, 3).var(axis=1, ddof=1).mean())
    (note,) = with_stands_averaged(every).notes
    told_mm = float(note.partition("their scatter of ")[2].split()[0])
    assert told_mm == pytest.approx(scatter_mm, rel=0.15)


def test_one_far_off_the_others_of_its_pose_is_left_out():
    found = with_stands_averaged(repeated(off_m=1e-3))
    right = with_stands_averaged(repeated()).readings
    off_m = found.readings.measured.places_m[0] - right.measured.places_m[0]
    assert np.abs(off_m).max() < 2.0 * READING_M
    assert "1 far off others of their stand left out" in found.notes[0]
    assert np.flatnonzero(found.why_left_out == OFF_STAND).tolist() == [1]
    assert found.off_m[1] == pytest.approx(1e-3, rel=0.01)
    kept = with_stands_averaged(repeated(off_m=5.0 * READING_M))  # within what is stated
    assert "left out" not in kept.notes[0]
    assert len(kept.readings) == POSES


@pytest.mark.parametrize("kind", ["points", "pose"])
@pytest.mark.parametrize("pose", [7, POSES - 1])
def test_a_stand_whose_readings_contradict_each_other_is_left_out_whole(kind, pose):
    """Each of the three is off along another axis: none is known to be right."""
    every = repeated(kind)
    rows = TIMES * pose + np.arange(TIMES)
    if kind == "points":
        p_m = every.measured.p_instr_m.copy()
        p_m[rows, 0] += 1e-3 * np.eye(3)
        every = every.with_measured(p_instr_m=p_m)
    else:
        T = every.measured.T_instr_target.copy()
        T[rows, :3, 3] += 1e-3 * np.eye(3)
        every = every.with_measured(T_instr_target=T)
    found = with_stands_averaged(every)
    assert np.flatnonzero(found.why_left_out == STAND_DISAGREES).tolist() == rows.tolist()
    left = [f"P{k:02}" for k in range(POSES) if k != pose]
    assert found.readings.pose.tolist() == left
    assert np.isfinite(found.readings.measured.places_m).all()


def four_of_each_pose(tmp_path, *off_mm):
    """Return raw files with four readings of each of 40 poses; those of the fifth are off in x."""
    raw = sighted(tmp_path, "points", targets=1)
    raw.description["instrument"]["uncertainty_mm"] = 0.05
    header, *rows = raw.poses
    lines, words = [], header.split(",")
    time, repeat = words.index("time_s"), words.index("repeat")
    noise_mm = np.random.default_rng(6).normal(0.0, 2e-3, (len(rows), 4, 3))
    for k, row in enumerate(rows):
        for turn in range(4):
            fields = row.split(",")
            fields[time], fields[repeat] = str(4 * k + turn), str(turn + 1)
            place_mm = np.array(fields[-3:], dtype=float) + noise_mm[k, turn]
            place_mm[0] += off_mm[turn] if k == 4 else 0.0
            fields[-3:] = [f"{value:.6f}" for value in place_mm]
            lines.append(",".join(fields))
    raw.poses[1:] = lines
    return raw


def test_readings_left_out_are_quarantined_by_line(tmp_path):
    campaign = ingest(four_of_each_pose(tmp_path, 0.0, 0.0, 9.0, 0.0))
    assert len(campaign.observations) == 40
    (row,) = campaign.quarantined
    assert (row.line, row.reason) == (20, OFF_STAND)
    assert row.value.startswith("9 mm off")
    assert campaign.wrong_rows == ()
    campaign = ingest(four_of_each_pose(tmp_path, 0.0, 0.0, 9.0, 9.0))
    assert len(campaign.observations) == 39
    assert [row.line for row in campaign.quarantined] == [18, 19, 20, 21]
    assert {row.reason for row in campaign.quarantined} == {STAND_DISAGREES}
    assert "P" in campaign.wrong_rows[0].where


def test_so_many_may_be_left_out_as_may_be_quarantined(tmp_path):
    raw = four_of_each_pose(tmp_path, 0.0, 0.0, 9.0, 9.0)
    strict = IngestOptions(max_quarantined_fraction=0.02)
    with pytest.raises(RawDataError, match=STAND_DISAGREES):
        read_campaign(raw.write(), strict)
