"""Sizes by marginal likelihood: what is there keeps its amount, what is not goes to nothing."""

import numpy as np
from benchmarks.all_at_once import Rows, most_likely


def test_only_what_is_there_keeps_a_size():
    rng = np.random.default_rng(1)
    columns, own = rng.normal(size=(600, 3 + 20)), 3
    groups = tuple(np.arange(first, first + 2) for first in range(own, columns.shape[1], 2))
    true = np.zeros(columns.shape[1])
    true[:own] = 1.0, -2.0, 0.5
    true[groups[4]] = 0.3, -0.2
    data = columns @ true + 0.5 * rng.normal(size=600)
    names = tuple(map(str, range(len(groups))))
    held = rng.normal(size=(50, 3, columns.shape[1]))
    held_data = held @ true
    rows = Rows(columns, data, own, groups, names, held, held_data, np.ones((50, 3), dtype=bool))
    x, std, sizes = most_likely(rows)
    assert np.all(np.abs(x - true)[groups[4]] < 4.0 * std[groups[4]])
    assert np.argmax(sizes) == 4
    assert np.sum(sizes > 0.05) <= 3
    alone = np.linalg.lstsq(columns, data, rcond=None)[0]
    assert rows.held_out_rms_mm(x) < 0.7 * rows.held_out_rms_mm(alone)
