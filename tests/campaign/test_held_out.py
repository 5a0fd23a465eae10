"""Which poses are held out: whole places, as many as are stated and a search can spare."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from made_up_poses import measured_poses
from mended import simulated
from pa10cal.arm.statics import PoseStates
from pa10cal.campaign.description import Holdout
from pa10cal.campaign.held_out import with_held_out
from pa10cal.campaign.joint_positions import places_of
from pa10cal.campaign.read import read_campaign
from pa10cal.discovery.blocked_cv.survey import LEAST_FOR_BLOCKS
from pa10cal.discovery.rules import NOISE
from pa10cal.errors import RawDataError
from pa10cal.rules import READINGS


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize(
    ("rule", "count", "held"),
    [
        ({"every": 5}, 99, 19),  # too few for a search in any case
        ({"every": 5}, 101, 1),
        ({"every": 5}, 120, 20),
        ({"every": 5}, 126, 25),
        ({"last_fraction": 0.3}, 110, 10),
        ({"last_fraction": 0.3}, 200, 60),
    ],
)
def test_poses_held_out_leave_enough_for_a_search(tmp_path, rule, count, held):
    assert READINGS.to_search == LEAST_FOR_BLOCKS
    assert NOISE.least_repeated_share == READINGS.repeated_share
    folder = simulated(tmp_path / "c", "irb120", "points", poses=count, holdout_share=0.0)
    path = folder / "campaign.yaml"
    text = path.read_text(encoding="utf-8")
    path.write_text(f"{text}holdout: {json.dumps(rule)}\n", encoding="utf-8")
    without_kind(folder / "poses.csv")
    ingested = read_campaign(folder)
    every = ingested.observations
    assert np.count_nonzero(every.kind == "holdout") == held
    fewer = [note for note in ingested.notes if "held out and not" in note]
    assert bool(fewer) == (100 < count < 126 or count == 110)


def without_kind(path):
    table = pd.read_csv(path)
    table.drop(columns="kind", errors="ignore").to_csv(path, index=False)


def readings_at(poses, repeats, labels=None, loads_N=(0.0,)):
    """Return readings of poses of three joints drawn at random, each repeated under every load."""
    q_rad = np.random.default_rng(3).uniform(-1.0, 1.0, (poses, 3))
    pose, load, _ = (
        axis.ravel()
        for axis in np.meshgrid(
            np.arange(poses), np.array(loads_N), np.arange(repeats), indexing="ij"
        )
    )
    count = len(pose)
    states = PoseStates(
        q_rad=q_rad[pose.astype(int)],
        tau_Nm=np.zeros((count, 3)),
        arrival=np.zeros((count, 3)),
        load_N=load,
        temperature_C=np.full(count, np.nan),
        time_s=np.arange(count, dtype=float),
    )
    return measured_poses(
        pose=np.array([f"P{k}" for k in (pose if labels is None else labels)]),
        states=states,
        T_instr_ee=np.tile(np.eye(4), (count, 1, 1)),
        cov=np.tile(1e-10 * np.eye(6), (count, 1, 1)),
    )


@pytest.mark.parametrize(
    ("poses", "repeats", "loads_N", "held"),
    [
        (104, 4, (0.0,), 20),  # repeats judge, and 100 readings are left besides
        (40, 3, (0.0,), 8),  # repeats judge
        (104, 1, (0.0, 22.0), 20),  # 168 readings are left
        (104, 1, (0.0,), 4),
        (60, 1, (0.0, 22.0), 10),  # 100 readings are left of 120
    ],
)
def test_fewer_are_held_out_only_where_a_search_needs_the_readings(poses, repeats, loads_N, held):
    every = readings_at(poses, repeats, loads_N=loads_N)
    places = places_of(every, np.zeros(3, dtype=bool), 0.01)
    found, notes, _ = with_held_out(every, Holdout(every=5), "holdout", places)
    assert len(set(found.pose[found.kind == "holdout"])) == held
    assert bool(notes) == (held < poses // 5)
    if notes:
        assert notes[0].startswith(f"{held} poses are held out and not {poses // 5}, so that 100")


@pytest.mark.parametrize("rule", [Holdout(every=3), Holdout(last_fraction=0.3)])
def test_readings_of_a_place_are_held_out_together_whatever_their_labels(rule):
    every = readings_at(30, 2, labels=range(60))
    every = every.take(np.random.default_rng(1).permutation(len(every)))
    every = every.with_states(replace(every.states, time_s=np.arange(len(every), dtype=float)))
    places = places_of(every, np.zeros(3, dtype=bool), 0.01)
    found, *_ = with_held_out(every, rule, "holdout", places)
    held = found.kind == "holdout"
    assert len(np.unique(places[held])) == rule.count_of(30)
    assert not np.isin(places[~held], places[held]).any()


def test_lines_at_the_place_of_a_pose_are_not_held_out():
    every = readings_at(20, 1)
    every = replace(every, kind=np.where(np.arange(20) < 4, "line_x", "grid"))
    places = np.arange(20) % 4
    found, *_ = with_held_out(every, Holdout(every=2), "holdout", places)
    assert np.array_equal(found.kind[:4], every.kind[:4])
    assert set(found.kind[4:]) == {"grid", "holdout"}


def test_without_poses_to_calibrate_with_nothing_is_held_out():
    every = readings_at(6, 1)
    every = replace(every, kind=np.full(6, "line_x"))
    found, notes, (warning,) = with_held_out(every, Holdout(every=2), "holdout", np.arange(6))
    assert set(found.kind) == {"line_x"}
    assert notes == ()
    assert "less than one of 0 poses" in warning


def test_all_poses_but_one_may_be_held_out_and_not_all():
    every, places = readings_at(3, 1), np.arange(3)
    found, *_ = with_held_out(every, Holdout(last_fraction=0.7), "holdout", places)
    assert found.kind.tolist() == ["grid", "holdout", "holdout"]
    with pytest.raises(RawDataError, match="all poses are held out"):
        with_held_out(every, Holdout(last_fraction=0.9), "holdout", places)


def test_rows_that_state_it_are_taken_as_they_are():
    """A warning says where a held-out pose is at the place of another."""
    every, places = readings_at(4, 1), np.arange(4)
    every = replace(every, kind=np.array(["grid", "holdout", "grid", "grid"]))
    assert with_held_out(every, None, "holdout", places) == (every, (), ())
    _, _, (warning,) = with_held_out(every, None, "holdout", np.array([0, 1, 1, 2]))
    assert "held-out poses at joint positions of calibration poses: 1, the first P1" in warning
