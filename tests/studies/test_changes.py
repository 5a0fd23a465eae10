"""The study of changed arms: what it counts, and that its figures repeat."""

from __future__ import annotations

import numpy as np
import pytest

from pa10cal.cell.options import TrackerOptions
from pa10cal.files.arms import load_arm
from pa10cal.results.codec import read, write
from pa10cal.results.comparison import ChangesRecord
from pa10cal.studies.changes import HAPPENED, Change, changes_study, draw_changed
from pa10cal.studies.simulated import exact_observations


@pytest.fixture(scope="module")
def found():
    said: list[str] = []
    return changes_study("ur10", "pose", 60, 2, 5, said.append), said


@pytest.mark.slow
def test_every_kind_of_change_is_counted(found, tmp_path):
    record, said = found
    assert [rate.happened for rate in record.verdicts] == list(HAPPENED)
    for rate in record.verdicts:
        assert sum(rate.verdicts.values()) == rate.pairs == 2
        low, high = rate.interval95
        assert low <= rate.share <= high
    assert len(said) == len(HAPPENED) + len(record.adapted.poses)
    write(record, tmp_path / "changes.json")
    assert read(ChangesRecord, tmp_path / "changes.json") == record


@pytest.mark.slow
def test_more_poses_adapt_a_model_better(found):
    adapted = found[0].adapted
    assert (np.diff(adapted.poses) > 0).all()
    assert adapted.over_full[-1] < adapted.over_full[0]
    assert (adapted.over_full_95 >= adapted.over_full).all()


@pytest.mark.slow
def test_the_same_seed_gives_the_same(found):
    again = changes_study("ur10", "pose", 60, 2, 5, lambda _: None)
    assert again == found[0]


def test_a_zero_that_moved_moves_the_arm_by_as_much():
    plan = TrackerOptions(poses=10, holdout_share=0.0)
    change = Change(zero_rad=((1, 1e-3),))
    before, after = draw_changed(load_arm("ur10"), plan, change, np.random.default_rng(1))
    one, other = (
        exact_observations(robot, plan, 10, 2).measured.places_m for robot in (before, after)
    )
    base = before.T_instr_base
    axis = base[:3, :3] @ before.mechanism.placements[0][:3, 2]
    origin = base[:3, :3] @ before.mechanism.placements[0][:3, 3] + base[:3, 3]
    lever = np.cross(axis, one[:, 0] - origin)
    assert other[:, 0] - one[:, 0] == pytest.approx(1e-3 * lever, abs=2e-6)
