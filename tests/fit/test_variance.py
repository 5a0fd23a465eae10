"""Variances of positions by the few B-splines that a pose touches are those of all knots."""

import numpy as np
import pytest

from pa10cal.fit.forward import MapMotion, position_covariance
from pa10cal.terms.effects.joint_error_map import b_splines, b_splines_by_knots


@pytest.mark.parametrize("knots", [(), (12,), (36, 24)])
def test_few_splines_are_all_knots(knots):
    rng = np.random.default_rng(4)
    poses, dense, total = 30, 5, 5 + sum(knots)
    root = rng.standard_normal((total, total))
    covariance = root @ root.T
    order = rng.permutation(total)
    moved = rng.standard_normal((poses, 3, dense))
    columns, maps, first = [moved], [], dense
    for count in knots:
        q_rad, turned = rng.uniform(-9.0, 9.0, poses), rng.standard_normal((poses, 3))
        maps.append(MapMotion(order[first : first + count], q_rad, turned))
        by_knot = b_splines(count, q_rad) @ b_splines_by_knots(count)
        columns.append(turned[:, :, None] * by_knot[:, None, :])
        first += count
    whole = np.concatenate(columns, axis=2)
    expected = np.einsum("pik,kl,pjl->pij", whole, covariance[np.ix_(order, order)], whole)
    found = position_covariance(covariance, order[:dense], moved, maps)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
