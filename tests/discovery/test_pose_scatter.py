"""What single poses scatter by is found; intervals by it and the model's uncertainty hold."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import at_rest
from pa10cal.arm.chain import Chain
from pa10cal.arrays import homogeneous
from pa10cal.discovery import pose_scatter
from pa10cal.discovery.jacobians import by_joints
from pa10cal.discovery.pose_scatter import PoseDeviations, pose_weights, scatter_of, share_inside
from pa10cal.discovery.rules import NOISE
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.joined import concatenated
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import Distance, Points
from pa10cal.observe.pose import Pose
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.terms.effects.joint_error_map import BandPrior, SensorError
from pa10cal.terms.model import Model

BAND = BandPrior(5e-5, 3e-5, 6e-5, 3.0, 8.0, 3.0, 1e-6)
TRUE = PoseDeviations(
    1e-6 * np.array([30.0, 40.0, 10.0, 80.0, 120.0, 20.0]), {"position": 3e-5, "attitude": 1e-4}
)


@pytest.fixture(name="model", scope="module")
def _model():
    terms = tuple(SensorError(f"joint {joint}", 36, BAND) for joint in (2, 3))
    covariance = np.zeros((78, 78))
    for k, term in enumerate(terms):
        at = slice(36 * k, 36 * k + 36)
        covariance[at, at] = term.prior_factor @ term.prior_factor.T
    arm = Chain.of(load_arm("ur10"))
    return FittedModel(Model(arm, terms), np.zeros(72), np.eye(4), covariance=covariance)


def seen_by(model, seed, count=1500):
    """Poses where joints and the instrument scatter as is true, and what is left of them."""
    rng = np.random.default_rng(seed)
    q_rad = rng.uniform(-2.5, 2.5, (count, 6))
    states = at_rest(q_rad)
    T = model.model.predict(states, model.x)
    poses = Observations.single(
        np.array([f"P{k}" for k in range(count)]),
        states,
        Pose.of(T, np.tile(np.eye(6), (count, 1, 1))),
    )
    turned = by_joints(model, poses, range(1, 7))
    off = (turned @ (TRUE.joints * rng.standard_normal((count, 6)))[:, :, None])[:, :, 0]
    kinds = np.repeat([*TRUE.kinds.values()], 3)
    return poses, off + kinds * rng.standard_normal((count, 6))


def test_the_scatter_drawn_is_found(model):
    poses, left = seen_by(model, 1)
    found = scatter_of(model, poses, left)
    assert found.kinds == pytest.approx(TRUE.kinds, rel=0.1)
    np.testing.assert_allclose(found.joints[[0, 1, 3, 4]], TRUE.joints[[0, 1, 3, 4]], rtol=0.2)


def test_intervals_hold_what_they_say(model):
    poses, left = seen_by(model, 2, count=600)
    by_scatter = share_inside(model, TRUE, poses, left)
    assert by_scatter > 0.99  # the maps are known to be zero here, and said to be uncertain
    rng = np.random.default_rng(3)
    shares = []
    for _ in range(10):
        x = np.concatenate(
            [term.prior_factor @ rng.standard_normal(36) for term in model.model.terms]
        )
        moved = model.model.predict(poses.states, x)[:, :3, 3]
        zero = model.model.predict(poses.states, model.x)[:, :3, 3]
        off = left.copy()
        off[:, :3] -= moved - zero
        shares.append(share_inside(model, TRUE, poses, off))
    assert np.mean(shares) == pytest.approx(0.95, abs=0.02)
    assert pytest.approx(1.96) == HALF_WIDTH_95


@pytest.mark.parametrize(
    ("sizes", "of_july"),
    [
        ((1e-5, 2e-5, 3e-5, 4e-5), {"position": 3e-5, "attitude": 4e-5}),
        ((1e-5, 2e-5), {"position": 1.0, "attitude": 1.0}),  # without its own: as stated
    ],
)
def test_poses_of_one_campaign_of_a_group_scatter_as_that_one_does(model, sizes, of_july):
    each = [seen_by(model, seed, 40)[0] for seed in (4, 5)]
    every = concatenated(each, ("june", "july"))
    names = [name for name, _ in every.measured.component_kinds]
    scatter = PoseDeviations(TRUE.joints, dict(zip(names[: len(sizes)], sizes, strict=True)))
    own = PoseDeviations(TRUE.joints, of_july).covariance(model, each[1])
    for found in (
        scatter.covariance(model, every)[40:],
        scatter.covariance(model, every.take(np.arange(40, 80))),
    ):
        np.testing.assert_allclose(found[:, 6:, 6:], own, rtol=1e-12)


def test_poses_that_suffice_are_of_all_kinds_and_of_small_campaigns(model, monkeypatch):
    monkeypatch.setattr(pose_scatter, "NOISE", replace(NOISE, enough_poses=30))
    poses, left = seen_by(model, 1, 120)
    alternating = left.copy()
    alternating[::2] *= 3.0  # every n-th would be of one kind alone
    found = scatter_of(model, poses, alternating)
    assert 1.7 < found.kinds["attitude"] / TRUE.kinds["attitude"] < 2.8  # sqrt(5) of both together
    small = seen_by(model, 6, 4)[0]
    both = concatenated([poses, small], ("large", "small"))
    assert set(pose_scatter._enough(both)) & set(range(120, 124))


def test_a_model_of_distances_is_uncertain_along_the_line_of_sight(model):
    poses, _ = seen_by(model, 7, 300)
    T_instr_base = homogeneous(np.eye(3), np.array([3.0, 0.0, 0.0]))
    covariance = np.pad(model.covariance, (0, 3))
    off_base = replace(
        model, T_instr_base=T_instr_base, targets_m=np.zeros(3), covariance=covariance
    )

    def distances_m(x):
        end = off_base.T_instr_base @ model.model.predict(poses.states, x)
        return np.linalg.norm(end[:, :3, 3], axis=1)

    seen = Distance(distances_m(model.x), np.full(300, 1e-5))
    poses = replace(poses, measured=seen)
    scatter = PoseDeviations(np.zeros(6), dict.fromkeys(dict(seen.component_kinds), 1e-5))
    rng = np.random.default_rng(8)
    shares = []
    for _ in range(30):
        x = np.concatenate([t.prior_factor @ rng.standard_normal(36) for t in model.model.terms])
        off_m = distances_m(model.x) - distances_m(x) + rng.normal(0.0, 1e-5, 300)
        shares.append(share_inside(off_base, scatter, poses, off_m[:, None]))
    assert np.mean(shares) == pytest.approx(0.95, abs=0.01)


def test_poses_of_which_nothing_was_seen_weigh_as_stated():
    unseen = Points(("T1",), np.full((4, 1, 3), np.nan), np.full((4, 1, 3, 3), np.nan), None)
    assert (pose_weights(np.zeros((4, 3)), 5.0, unseen).weight == 1.0).all()
