"""Laws of joined campaigns: each pose is that of its own campaign, wherever it was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.observe.test_instruments import KINDS, about, measured

from made_up_poses import at_rest, frames
from pa10cal.errors import CalibrationError
from pa10cal.observe.joined import Joined
from pa10cal.observe.observations import Observations, reading_checksums
from pa10cal.observe.quantities import StatedByCampaign

PAIRS = [
    ("pose", "pose"),
    ("pose", "points"),
    ("points", "distance"),
    ("touch_trigger_cmm", "pose"),
]


def joined(kinds, rng, counts=(5, 4)):
    """Return joined campaigns, their poses in any order, with poses (P, 4, 4) and targets (t,)."""
    T = [frames(rng, count) for count in counts]
    parts, targets = zip(
        *(measured(kind, each, rng) for kind, each in zip(kinds, T, strict=True)), strict=True
    )
    campaign = rng.permutation(np.repeat([0, 1], counts))
    whole = np.empty((len(campaign), 4, 4))
    for k, each in enumerate(T):
        whole[campaign == k] = each
    return Joined(("first", "second"), parts, campaign), whole, np.concatenate(targets)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_measured_does_not_go_by_the_frame(kind):
    rng = np.random.default_rng(5)
    T, moved = frames(rng, 6), frames(rng, 1)[0]
    found, targets_m = measured(kind, T, rng)
    there = found.in_frame(moved)
    before, after = found.compare(T, targets_m), there.compare(moved @ T, targets_m)
    whitener = np.linalg.inv(np.linalg.cholesky(found.stated_covariance))
    turned = np.linalg.inv(np.linalg.cholesky(there.stated_covariance))
    np.testing.assert_allclose(
        np.linalg.norm(np.einsum("pij,pj->pi", whitener, before.residual), axis=1),
        np.linalg.norm(np.einsum("pij,pj->pi", turned, after.residual), axis=1),
        rtol=1e-6,
    )
    at = found.deviations(T, np.eye(4), targets_m)
    np.testing.assert_allclose(
        there.deviations(T, moved, targets_m).position_mm, at.position_mm, atol=1e-9
    )


@pytest.mark.parametrize("kinds", PAIRS)
def test_derivatives_are_those_of_the_residual(kinds):
    rng = np.random.default_rng(1)
    found, T, targets_m = joined(kinds, rng)
    at = found.compare(T, targets_m)
    twist, shift = 1e-6 * rng.normal(size=(2, len(T), 3))
    step = 1e-6 * rng.normal(size=len(targets_m))
    ahead = found.compare(about(T, twist, shift), targets_m + step).residual
    behind = found.compare(about(T, -twist, -shift), targets_m - step).residual
    expected = np.einsum("pbi,pi->pb", at.by_end, np.hstack([shift, twist])) + at.by_targets @ step
    np.testing.assert_allclose(0.5 * (ahead - behind), expected, atol=5e-11)
    assert not at.residual[~found.components_seen].any()
    names = [parameter.name for parameter in found.target_parameters]
    assert len(set(names)) == len(names) == len(targets_m)


@pytest.mark.parametrize("kinds", PAIRS)
def test_some_poses_are_those_of_each_campaign(kinds):
    rng = np.random.default_rng(2)
    found, T, targets_m = joined(kinds, rng)
    rows = rng.permutation(len(T))[:6]
    whole, some = found.compare(T, targets_m), found.take(rows).compare(T[rows], targets_m)
    np.testing.assert_array_equal(some.residual, whole.residual[rows])
    np.testing.assert_array_equal(found.take(rows).stated_covariance, found.stated_covariance[rows])
    alone = found.take(found.campaign == 1)
    assert [kind for kind, _ in alone.component_kinds] == [
        f"{kind}@second" for kind, _ in found.parts[1].component_kinds
    ]
    own = found.deviations(T, np.eye(4), targets_m)
    split = len(found.parts[0].target_parameters)
    part = found.parts[1].deviations(T[found.campaign == 1], np.eye(4), targets_m[split:])
    np.testing.assert_array_equal(own.distance_mm[found.campaign == 1], part.distance_mm)


@pytest.mark.parametrize("kinds", PAIRS)
def test_averages_ideals_and_readouts_are_those_of_each_campaign(kinds):
    rng = np.random.default_rng(3)
    found, T, targets_m = joined(kinds, rng)
    code = np.arange(len(found)) // 2 * 2 + found.campaign
    code = np.unique(code, return_inverse=True)[1]
    means = found.averaged(code)
    first = np.unique(code, return_index=True)[1]
    np.testing.assert_array_equal(means.campaign, found.campaign[first])
    assert len(means) == code.max() + 1
    ideal = found.ideal(T, targets_m)
    np.testing.assert_allclose(ideal.compare(T, targets_m).residual, 0.0, atol=1e-12)
    assert found.readout(T, targets_m).pose_by_targets.shape[0] == len(T)
    assert found.by_stated_targets.shape[:2] == found.components_seen.shape


@pytest.mark.parametrize("kinds", PAIRS)
def test_readings_have_the_same_checksum_alone_and_in_a_group(kinds):
    rng = np.random.default_rng(6)
    found, T, _ = joined(kinds, rng)
    label = np.array([f"P{number}" for number in range(len(T))])
    states = at_rest(rng.normal(size=(len(T), 6)), campaign=found.campaign)
    group = Observations.single(label, states, found.in_frame(frames(rng, 1)[0]))
    alone = [
        reading_checksums(
            Observations.single(
                label[found.campaign == k],
                replace(states.take(found.campaign == k), campaign=None),
                part,
            )
        )
        for k, part in enumerate(found.parts)
    ]
    assert reading_checksums(group) == (*alone[0], *alone[1])
    again, _, _ = joined(kinds, rng)  # the same poses, read anew
    assert set(reading_checksums(replace(group, measured=again))).isdisjoint(alone[0] + alone[1])


def test_positions_are_those_of_every_campaign():
    found, _, _ = joined(("pose", "points"), np.random.default_rng(4))
    assert found.position_columns.tolist() == [0, 1, 2, *range(6, 15)]
    assert found.kinds == ("pose", "points")
    assert [name for name, _ in found.campaigns] == ["first", "second"]


def test_campaigns_are_read_and_planned_one_by_one():
    with pytest.raises(CalibrationError, match="campaign by campaign"):
        Joined.from_columns({}, StatedByCampaign(1e-5, {}))
    with pytest.raises(CalibrationError, match="campaign by campaign"):
        Joined.foreseen(np.eye(4)[None], StatedByCampaign(1e-5, {}))
