"""A SCARA under another tool: what its leaning axes do at another height is no lost zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import few_poses


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    """A calibrated SCARA under a target 43 mm higher: program, base and tool alone, both errors."""
    place, rng = tmp_path_factory.mktemp("few"), np.random.default_rng([1, 39])
    before = few_poses.drawn("gx4_351s", rng)
    before = replace(before, target_m=np.array([0.068, -0.042, 0.103]))
    after = replace(before, target_m=np.array([0.079, -0.003, 0.060]))
    q = [few_poses.positions(before, count, rng) for count in (100, 12, 300)]
    folder = few_poses.written(place / "before", "gx4_351s", before, q[0], 0.03, 1)
    prior = few_poses.calibrated(folder, None)[0]
    folder = few_poses.written(place / "after", "gx4_351s", after, q[1], 0.03, 2)
    model, _, moved, grade = few_poses.calibrated(folder, prior)
    frames = few_poses.base_and_tool(folder, prior)
    errors_mm = [few_poses.error_mm(each, after, q[2]) for each in (model, frames)]
    return errors_mm, moved, grade, few_poses.error_mm(prior, before, q[2])


def test_no_zero_is_told_that_did_not_move(carried):
    _, moved, grade, _ = carried
    assert moved == []
    assert grade == "good"


def test_predictions_are_nearly_as_good_as_under_the_first_tool(carried):
    errors_mm, _, _, before_mm = carried
    assert max(errors_mm) < 2.0 * before_mm  # 2.5 times with the height held
