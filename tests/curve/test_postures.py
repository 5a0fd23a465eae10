"""Postures of a chain's arm drawn along curves."""

import numpy as np
import pytest

from pa10cal.arm.chain import Chain, frames
from pa10cal.errors import CurveError
from pa10cal_curve.angles import chain_arm
from pa10cal_curve.postures import draw_postures

LINKS, LINK_M, LIMIT_RAD = 6, 0.15, np.radians(75.0)


@pytest.fixture(scope="module")
def postures():
    return draw_postures(LINKS, LINK_M, LIMIT_RAD, 60, np.random.default_rng(3))


def test_every_joint_is_within_its_limits_and_moves_both_ways(postures):
    assert postures.q_rad.shape == (60, 2 * LINKS)
    assert np.abs(postures.q_rad).max() <= LIMIT_RAD + 1e-12
    assert (postures.q_rad.max(axis=0) > 0.3 * LIMIT_RAD).all()
    assert (postures.q_rad.min(axis=0) < -0.3 * LIMIT_RAD).all()
    assert {str(shape) for shape in postures.shape} == {"spline", "helix", "wave"}


def test_the_arm_stands_where_the_links_join(postures):
    arm = chain_arm("chain", LINKS, LINK_M, LIMIT_RAD)
    chain = Chain.of(arm)
    along = frames(chain, chain.coordinates(postures.q_rad)).T_base_rows[1::2]
    places_m = np.swapaxes(along[:, :, :3, 3], 0, 1)
    np.testing.assert_allclose(places_m, postures.p_m[:, 1:], atol=1e-12)
    np.testing.assert_allclose(postures.p_m[:, 0], 0.0, atol=1e-15)


def test_the_same_seed_gives_the_same_postures_and_narrow_limits_refuse_some(postures):
    again = draw_postures(LINKS, LINK_M, LIMIT_RAD, 60, np.random.default_rng(3))
    assert (again.q_rad == postures.q_rad).all()
    narrow = draw_postures(LINKS, LINK_M, np.radians(40.0), 60, np.random.default_rng(3))
    assert np.abs(narrow.q_rad).max() <= np.radians(40.0) + 1e-12
    assert narrow.refused > postures.refused


@pytest.mark.slow
def test_limits_that_hardly_any_shape_keeps_are_refused():
    with pytest.raises(CurveError, match="limit_deg: hardly any shape"):
        draw_postures(LINKS, LINK_M, np.radians(2.0), 1, np.random.default_rng(3))
