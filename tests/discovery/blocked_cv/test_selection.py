"""Sets solved by block elimination against least squares written out."""

import numpy as np
import pytest

from pa10cal.discovery.blocked_cv.family import Columns, start
from pa10cal.discovery.blocked_cv.survey import Products

BLOCKS, ROWS = 5, 40


@pytest.fixture(scope="module")
def rows():
    """Columns and data of some blocks, and their products."""
    rng = np.random.default_rng(11)
    columns = rng.standard_normal((BLOCKS, ROWS, 14)) * np.geomspace(1e-3, 1e3, 14)
    data = rng.standard_normal((BLOCKS, ROWS)) + columns[:, :, 4] / 5.0
    products = Products(
        np.einsum("bri,brj->bij", columns, columns),
        np.einsum("bri,br->bi", columns, data),
        np.sum(data**2, axis=1),
    )
    return (
        columns,
        data,
        Products(products.gram, products.projection, products.squares, of_positions=products),
    )


OWN = Columns(np.arange(3), np.array([1e3, 1e3, 1e3]))
ONE = Columns(np.array([4]), np.array([2.0]))
TWO = Columns(np.array([7, 9]), np.array([0.5, 0.01]))
THREE = Columns(np.array([3, 8, 12]), np.array([10.0, 0.1, 1e-3]))


def started(rows, *members):
    """Return the set of some members, which join one after the other."""
    found = start(rows[2], OWN)
    for each in members:
        found = found.extended(each)
    return found


def by_hand(rows, members):
    """Sums of squares of blocks left out, each by its own least squares."""
    columns, data, _ = rows
    at = np.concatenate([each.at for each in members])
    prior = np.diag(1.0 / np.concatenate([each.sizes for each in members]))
    found = []
    for b in range(BLOCKS):
        rest = [other for other in range(BLOCKS) if other != b]
        matrix = np.concatenate([columns[rest][:, :, at].reshape(-1, len(at)), prior])
        target = np.concatenate([data[rest].ravel(), np.zeros(len(at))])
        x = np.linalg.lstsq(matrix, target, rcond=None)[0]
        found.append(np.sum((data[b] - columns[b][:, at] @ x) ** 2))
    return np.array(found)


def test_members_that_join_and_leave_are_as_if_solved_anew(rows):
    grown = started(rows, ONE, TWO, THREE)
    less = grown.reduced(1)
    assert less.members == (ONE, THREE)
    for state in (grown, less):
        np.testing.assert_allclose(state.squares, by_hand(rows, (OWN, *state.members)), rtol=1e-8)
        np.testing.assert_allclose(state.position_squares, state.squares)


def test_candidates_are_judged_without_joining_and_members_without_leaving(rows):
    state = started(rows, ONE, TWO)
    joined, left = started(rows, ONE).with_each([TWO, THREE]), state.without_each()
    sets = ((ONE, TWO), (ONE, THREE), (TWO,), (ONE,))
    for squares, members in zip((*joined, *left), sets, strict=True):
        np.testing.assert_allclose(squares, by_hand(rows, (OWN, *members)), rtol=1e-8)
    assert np.all(state.solution_without(1)[:, -2:] == 0.0)
