"""The evidence is the Gaussian density written out, and chance rarely makes much of it."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array, eye_array
from scipy.stats import multivariate_normal

from pa10cal.discovery.evidence.likelihood import (
    SHARED_VARIANCES,
    CandidateRows,
    LinearisedCandidates,
    SetEvidence,
)
from pa10cal.discovery.evidence.noise_model import NoiseModel, SharedByCells
from pa10cal.discovery.rules import EVIDENCE

CELLS, OWN = 10, 3
POSE = np.repeat(np.arange(5), 2)


def channel_of(rng, b, common):
    """Return a channel of cells that share an error two by two."""
    size, turn = np.linalg.eigh(1.0 * (POSE[:, None] == POSE))
    rotation = csr_array(np.kron(turn.T, np.eye(b)))
    shared = SharedByCells(rotation, np.repeat(np.maximum(size, 0.0), b))
    return NoiseModel.of(
        np.tile(np.eye(b), (CELLS, 1, 1)), shared, rng.normal(size=(CELLS, b, common))
    )


class Made:
    """Two channels and four candidates, one of poses, one of both, one of torques, one weak."""

    def __init__(self):
        rng = np.random.default_rng(11)
        self.pose, self.torque = channel_of(rng, 2, 2), channel_of(rng, 1, 1)
        self.own = 3.0 * rng.normal(size=(2 * CELLS, OWN))
        blocks = []
        for width, in_pose, in_torque in ((2, 1, 0), (1, 1, 1), (1, 0, 1), (1, 0.25, 0)):
            factor = np.tril(rng.normal(size=(width, width))) + 2.0 * np.eye(width)
            blocks.append(
                CandidateRows(
                    in_pose * rng.normal(size=(2 * CELLS, width)),
                    in_torque * rng.normal(size=(CELLS, width)),
                    0.3 * factor,
                )
            )
        self.blocks = tuple(blocks)

    def data(self, seed, pose_variance=0.0, torque_variance=0.0, members=(), scale=1.0):
        """Draw data from the model of the evidence."""
        rng = np.random.default_rng(seed)
        rows = []
        for channel, variance, own in self._channels(pose_variance, torque_variance):
            std = np.sqrt(1.0 + variance * channel.shared.variance)
            noise = std * rng.normal(size=len(std)) + channel.common @ rng.normal(
                size=channel.common.shape[1]
            )
            rows.append(noise + own @ rng.normal(size=own.shape[1]))
        for k in members:
            block = self.blocks[k]
            x = scale * block.factor @ np.ones(len(block.factor))
            rows[0] += block.pose @ x
            rows[1] += block.torque @ x
        return rows

    def evidence(self, data):
        return SetEvidence(
            self.pose, self.torque, LinearisedCandidates(*data, self.own, self.blocks)
        )

    def log_density(self, data, members, sizes, variances):
        """Write the density of the data out, everything Gaussian integrated out."""
        split = len(data[0])
        covariance = np.zeros((split + len(data[1]),) * 2)
        both = slice(0, split), slice(split, None)
        for at, (channel, variance, own) in zip(both, self._channels(*variances), strict=True):
            rows = np.concatenate([channel.common, own], axis=1)
            total = np.diag(1.0 + variance * channel.shared.variance)
            covariance[at, at] = total + rows @ rows.T
        for k, size in zip(members, sizes, strict=True):
            block = self.blocks[k]
            rows = np.concatenate([block.pose, block.torque]) @ block.factor * EVIDENCE.sizes[size]
            covariance += rows @ rows.T
        return float(multivariate_normal.logpdf(np.concatenate(data), cov=covariance))

    def _channels(self, pose_variance, torque_variance):
        none = np.zeros((CELLS, 0))
        return (
            (self.pose, pose_variance, self.own),
            (self.torque, torque_variance, none),
        )


@pytest.fixture(scope="module")
def made():
    return Made()


SETS = [((), ()), ((0,), (1,)), ((1,), (0,)), ((2, 0), (2, 1)), ((3, 1, 0), (1, 1, 0))]
CONSTANT = 0.5 * 3 * CELLS * np.log(2.0 * np.pi)


def penalty(members):
    """What trying so many sizes of each member costs."""
    return np.log(len(EVIDENCE.sizes)) * len(members)


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize(("members", "sizes"), SETS)
@pytest.mark.parametrize("seed", [1, 2])
def test_is_the_density_at_the_best_of_the_variances_tried(made, members, sizes, seed):
    data = made.data(seed, members=members)
    found = made.evidence(data).score(tuple(zip(members, sizes, strict=True)))
    table = {
        pair: made.log_density(data, members, sizes, SHARED_VARIANCES[list(pair)])
        for pair in product(range(len(SHARED_VARIANCES)), repeat=2)
    }
    best = max(table.values())
    assert found.grid_index == max(table, key=table.get)
    between = found.log_evidence + penalty(members) - CONSTANT - best
    if max(found.grid_index) < 2:  # nothing to lay a curve through
        assert between == pytest.approx(0.0, abs=1e-6)
        assert found.variances.pose == SHARED_VARIANCES[found.grid_index[0]]
    assert -1e-6 < between < 0.5


@pytest.mark.parametrize(("members", "sizes"), SETS)
def test_between_the_variances_tried_it_is_close_to_the_density(made, members, sizes):
    data = made.data(3, 5.0, 300.0, members)
    found = made.evidence(data).score(tuple(zip(members, sizes, strict=True)))
    variances = found.variances.pose, found.variances.torque
    assert min(found.grid_index) >= 2
    assert variances[1] > variances[0] > 0.0
    expected = made.log_density(data, members, sizes, variances) + CONSTANT - penalty(members)
    assert found.log_evidence == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize(("members", "sizes"), SETS[:4])
@pytest.mark.parametrize("variances", [(0.0, 0.0), (5.0, 300.0)])
def test_what_a_candidate_adds_is_the_difference_of_two_scores(made, members, sizes, variances):
    evidence = made.evidence(made.data(4, *variances, members))
    chosen = tuple(zip(members, sizes, strict=True))
    here = evidence.score(chosen).log_evidence
    candidates = [k for k in range(len(made.blocks)) if k not in members]
    for k, (gain, size) in zip(candidates, evidence.additions(chosen, candidates), strict=True):
        scores = [
            evidence.score((*chosen, (k, each))).log_evidence - here
            for each in range(len(EVIDENCE.sizes))
        ]
        assert gain == pytest.approx(scores[size], abs=0.3 if any(variances) else 0.02)
        assert scores[size] > max(scores) - 0.3


def test_a_candidate_may_be_what_the_shared_error_of_torques_was(made):
    evidence = made.evidence(made.data(4, members=(2,), scale=8.0))
    nothing, there = evidence.score(()), evidence.score(((2, 2),))
    assert nothing.variances.torque > 1.0 > there.variances.torque
    assert evidence.additions((), []) == []
    ((gain, size),) = evidence.additions((), [2])
    best = evidence.score(((2, size),)).log_evidence - nothing.log_evidence
    assert gain == pytest.approx(best, abs=0.5)


def test_without_torques_poses_speak_alone(made):
    pose_data = made.data(6)[0]
    blocks = tuple(
        CandidateRows(b.pose, np.zeros((0, b.pose.shape[1])), b.factor) for b in made.blocks
    )
    alone = SetEvidence(
        made.pose, None, LinearisedCandidates(pose_data, np.zeros(0), made.own, blocks[:1])
    )
    both = made.evidence([pose_data, made.data(7)[1]])
    gains = [
        evidence.score(((0, 1),)).log_evidence - evidence.score(()).log_evidence
        for evidence in (alone, both)
    ]
    assert gains[0] == pytest.approx(gains[1])
    assert alone.score(()).variances.torque == 0.0


@pytest.mark.parametrize("variance", [1.0, 4.0, 7.0, 12.0, 22.0])
def test_the_best_variance_is_found_where_hundreds_of_rows_have_a_part(variance):
    rng = np.random.default_rng(8)
    rows = 400
    shared = SharedByCells(eye_array(rows).tocsr(), rng.uniform(1.0, 4.0, rows))
    channel = NoiseModel.of(np.ones((rows, 1, 1)), shared, np.zeros((rows, 1, 0)))
    data = np.sqrt(1.0 + variance * shared.variance) * rng.normal(size=rows)
    alone = LinearisedCandidates(data, np.zeros(0), np.zeros((rows, 0)), ())
    found = SetEvidence(channel, None, alone).score(())

    def minus_log(log_variance):
        total = 1.0 + np.exp(log_variance) * shared.variance
        return 0.5 * float(np.sum(data**2 / total + np.log(total)))

    best = minimize_scalar(minus_log, bracket=(-1.0, 4.0))
    # Far less than what decides: the steps between the variances tried are wide.
    assert found.log_evidence == pytest.approx(-best.fun, abs=1.0)
    assert found.variances.pose == pytest.approx(np.exp(best.x), rel=0.1)


@pytest.mark.parametrize("variance", [7e4, 1e6, 1e8])
def test_chance_makes_no_candidate_likely_however_large_the_shared_error_is(variance):
    rng, rows = np.random.default_rng(2), 300
    shared = SharedByCells(eye_array(rows).tocsr(), np.full(rows, 4.0))
    channel = NoiseModel.of(np.ones((rows, 1, 1)), shared, np.zeros((rows, 1, 0)))
    data = np.sqrt(1.0 + 4.0 * variance) * rng.normal(size=rows)
    prior = np.array([[0.5 * np.sqrt(variance)]])
    blocks = tuple(
        CandidateRows(rng.normal(size=(rows, 1)), np.zeros((0, 1)), prior) for _ in range(20)
    )
    lin = LinearisedCandidates(data, np.zeros(0), np.zeros((rows, 0)), blocks)
    evidence = SetEvidence(channel, None, lin)
    nothing = evidence.score(())
    assert nothing.variances.pose == pytest.approx(variance, rel=0.2)
    for k, (gain, size) in enumerate(evidence.additions((), list(range(20)))):
        assert gain < 3.0
        assert evidence.score(((k, size),)).log_evidence - nothing.log_evidence < 3.0


@pytest.mark.parametrize("amounts", [(7.0, -5.0), (20.0, -10.0)])
def test_the_best_variances_are_found_where_poses_and_torques_contradict_each_other(amounts):
    """The amount is that of either channel: the other then has a large shared error."""
    rng, n = np.random.default_rng(5), 20
    shared = SharedByCells(eye_array(n).tocsr(), np.ones(n))
    channel = NoiseModel.of(np.ones((n, 1, 1)), shared, np.zeros((n, 1, 0)))
    columns = rng.normal(size=(2, n, 1))
    data = rng.normal(size=(2, n)) + np.array(amounts)[:, None] * columns[:, :, 0]
    candidate = CandidateRows(*columns, np.eye(1))
    lin = LinearisedCandidates(*data, np.zeros((n, 0)), (candidate,))
    found = SetEvidence(channel, channel, lin).score(((0, 1),))

    def log_density(pair):
        own = np.diag(np.repeat(1.0 + np.array(pair), n))
        covariance = own + columns.reshape(-1, 1) @ columns.reshape(1, -1)
        return float(multivariate_normal.logpdf(data.ravel(), cov=covariance))

    table = {
        pair: log_density(SHARED_VARIANCES[list(pair)])
        for pair in product(range(len(SHARED_VARIANCES)), repeat=2)
    }
    assert found.grid_index == max(table, key=table.get)
    there = log_density((found.variances.pose, found.variances.torque)) - penalty((0,))
    assert found.log_evidence == pytest.approx(there + n * np.log(2.0 * np.pi), abs=0.1)


TRIALS, ALPHA = 250, 0.2
#: Candidates and sizes whose mean ratio does not rest on a few rare draws.
STEADY = ((3, 1), (0, 0), (1, 0))


@pytest.fixture(scope="module")
def by_chance(made):
    """What candidates gain where there is nothing but noise: steady ones, and the best of all."""
    steady, best = [], []
    for seed in range(TRIALS):
        evidence = made.evidence(made.data(1000 + seed))
        nothing = evidence.score(()).log_evidence
        steady.append([evidence.score(((k, s),)).log_evidence - nothing for k, s in STEADY])
        best.append(evidence.additions((), list(range(len(made.blocks)))))
    return np.array(steady), np.array(best)[..., 0]


def test_under_pure_noise_the_likelihood_ratio_is_one_on_average(by_chance):
    ratio = np.exp(by_chance[0] + penalty((0,)))
    assert (ratio.std(axis=0) > 0.02).all()
    spread = ratio.std(axis=0) / np.sqrt(TRIALS)
    assert (np.abs(ratio.mean(axis=0) - 1.0) < 4.0 * spread + 0.02).all()


def test_chance_reaches_the_threshold_no_more_often_than_stated(made, by_chance):
    highest = by_chance[1].max(axis=1)
    assert np.mean(highest > np.log(len(made.blocks) / ALPHA)) <= ALPHA
    # It comes close often enough for the bound to mean something.
    assert np.mean(highest > -penalty((0,))) > 0.1


def test_what_explains_nothing_costs_the_more_the_larger_it_might_be(made):
    evidence = made.evidence(made.data(9))
    gains = [evidence.score(((0, size),)).log_evidence for size in range(len(EVIDENCE.sizes))]
    assert gains == sorted(gains, reverse=True)
    assert gains[2] < gains[0] - 2.0


def test_a_candidates_own_signal_is_found(made):
    threshold = np.log(len(made.blocks) / ALPHA)
    for k in range(3):
        evidence = made.evidence(made.data(50 + k, members=(k,), scale=5.0))
        gains = [gain for gain, _ in evidence.additions((), list(range(len(made.blocks))))]
        assert np.argmax(gains) == k
        assert gains[k] > 3.0 * threshold
