"""Weighed rows are independent and of unit variance, against covariances written down."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from pa10cal.discovery.evidence.noise_model import NoiseModel, SharedByCells

CELLS, B, COMMON = 7, 3, 4
POSE = np.array([0, 0, 0, 1, 1, 2, 2])
VARIANCES = (0.0, 0.3, 40.0)


class Made:
    """A channel, and the parts of its covariance in rows as measured, (C b, C b)."""

    def __init__(self):
        rng = np.random.default_rng(5)
        root = rng.normal(size=(CELLS, B, B)) + 2.0 * np.eye(B)
        shapes = rng.normal(size=(CELLS, 2))
        alike = (shapes @ shapes.T) * (POSE[:, None] == POSE)
        size, turn = np.linalg.eigh(alike)
        common = rng.normal(size=(CELLS, B, COMMON))
        rotation = csr_array(np.kron(turn.T, np.eye(B)))
        shared = SharedByCells(rotation, np.repeat(np.maximum(size, 0.0), B))
        self.channel = NoiseModel.of(np.linalg.inv(root), shared, common)
        self.noise = np.zeros((CELLS * B, CELLS * B))
        self.shared = np.zeros_like(self.noise)
        for i in range(CELLS):
            for j in range(CELLS):
                at = np.ix_(np.arange(B) + B * i, np.arange(B) + B * j)
                self.noise[at] = root[i] @ root[j].T * (i == j)
                self.shared[at] = alike[i, j] * root[i] @ root[j].T
        flat = common.reshape(CELLS * B, COMMON)
        self.common = flat @ flat.T

    def covariance(self, variance):
        return self.noise + variance * self.shared + self.common

    def whitening(self, variance):
        """Return what rows as measured are multiplied by."""
        rows = self.channel.noise_whitened(np.eye(CELLS * B).reshape(CELLS, B, CELLS * B))
        return self.channel.whitening(variance)(rows)


@pytest.fixture(scope="module")
def made():
    return Made()


@pytest.mark.parametrize("variance", VARIANCES)
def test_weighed_rows_have_unit_covariance(made, variance):
    W, V = made.whitening(variance), made.covariance(variance)
    np.testing.assert_allclose(W @ V @ W.T, np.eye(CELLS * B), atol=1e-9)
    np.testing.assert_allclose(W.T @ W, np.linalg.inv(V), rtol=1e-6, atol=1e-9)


def test_without_shared_and_common_errors_rows_are_as_whitened(made):
    channel = made.channel
    bare = NoiseModel.of(channel.whitener, channel.shared, np.zeros((CELLS, B, 0)))
    rows = np.random.default_rng(6).normal(size=(CELLS * B, 2))
    np.testing.assert_array_equal(bare.whitening(0.0)(rows), rows)
