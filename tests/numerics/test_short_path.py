"""Short paths through points, by laws."""

import numpy as np

from pa10cal.numerics.short_path import path_length, short_path


def test_a_short_path_is_no_longer_than_the_order_given():
    for seed in range(5):
        q = np.random.default_rng(seed).normal(size=(30, 6))
        order = short_path(q)
        assert sorted(order) == list(range(30))
        assert path_length(q[order]) < 0.7 * path_length(q)
