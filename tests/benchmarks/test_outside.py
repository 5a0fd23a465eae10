"""What the true pattern of an effect gains, beside parameters that follow a part of it."""

import numpy as np
import pytest
from benchmarks.outside import gain_in, gain_of

from pa10cal_lab.cell.trials import draw_trials

ROWS, BLOCKS = 240, 10


def made_up(size, seed=1):
    """Return data that hold a pattern, own columns of which one is like it, and blocks."""
    rng = np.random.default_rng(seed)
    own = rng.normal(size=(ROWS, 4))
    pattern = size * (0.6 * own[:, 0] + rng.normal(size=ROWS)) / np.sqrt(ROWS)
    data = own @ [1.0, -0.5, 0.2, 0.0] + pattern + rng.normal(size=ROWS)
    return data, own, pattern, np.arange(ROWS) % BLOCKS


def test_nats_are_half_of_what_squares_fall_by():
    data, own, pattern, block = made_up(6.0)
    found = gain_of(data, own, pattern, block, 10.0)

    def least_squares(columns, y, weak):
        # With a unit prior of the own columns, and none of the amplitude.
        prior = np.diag(np.r_[np.ones(4), np.zeros(columns.shape[1] - 4)])
        matrix, target = np.vstack([columns, prior]), np.r_[y, np.zeros(len(prior))]
        x = np.linalg.lstsq(matrix, target, rcond=None)[0]
        return x, float(np.sum((target - matrix @ x) ** 2))

    both = np.column_stack([own, pattern])
    _, without = least_squares(own, data, 0)
    x, with_pattern = least_squares(both, data, 1)
    assert found.nats == pytest.approx(0.5 * (without - with_pattern))
    assert found.amplitude == pytest.approx(x[-1])
    for number in range(BLOCKS):
        here = block == number
        left = [
            np.sum(
                (data[here] - columns[here] @ least_squares(columns[~here], data[~here], 0)[0]) ** 2
            )
            for columns in (own, both)
        ]
        assert found.blocks[number] == pytest.approx(left[0] - left[1])


def test_what_is_no_evidence_is_findable_by_none():
    of_sizes = [gain_of(*made_up(size), 18.0) for size in (0.3, 4.5, 20.0)]
    first, *_, last = (each.kind for each in of_sizes)
    assert first.startswith("no evidence")
    assert last == "findable"


@pytest.mark.slow
def test_the_pattern_of_an_effect_is_that_of_its_size():
    (trial,) = draw_trials("outside", 1, 2, "tracked")
    assert trial.settings.hidden_effects[0].id == "third_harmonic"
    found = gain_in(trial)
    assert found.is_findable
    assert found.amplitude == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * found.nats))
