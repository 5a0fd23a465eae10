"""The field: a Gaussian process over joint positions, as a term of a model."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from made_up_poses import at_rest
from pa10cal.errors import TermError
from pa10cal.terms.effects.joint import Backlash, EncoderEccentricity
from pa10cal.terms.field import Field, Nameless, embedded, well_spread
from pa10cal.terms.offsets import base_frame
from pa10cal.terms.plain import term_from_plain, term_to_plain

RNG = np.random.default_rng(4)
PLACES = RNG.uniform(-1.5, 1.5, (7, 3))
FIELD = Field(
    q=tuple(map(tuple, PLACES.tolist())),
    lever_m=(0.9, 0.6, 1.0),
    turns=(True, True, False),
    length_m=0.5,
    size_m=2e-4,
)
ROUGH = replace(FIELD, kernel="exponential")
KERNELS = pytest.mark.parametrize("field", [FIELD, ROUGH])
X = FIELD.size_m * RNG.standard_normal(len(FIELD.parameters))


def covariance_of(one, other, kernel):
    """The kernel by hand: what displacements along one axis are expected to have in common."""
    apart = [
        [np.linalg.norm(a - b) for b in embedded(other, np.array(FIELD.lever_m), TURNS)]
        for a in embedded(one, np.array(FIELD.lever_m), TURNS)
    ]
    if kernel == "exponential":
        return np.exp(-np.array(apart) / FIELD.length_m)
    return np.exp(-0.5 * np.square(apart) / FIELD.length_m**2)


TURNS = np.array(FIELD.turns)


@KERNELS
def test_at_its_places_displacements_are_expected_as_large_and_as_alike_as_the_kernel_says(field):
    features, expected = field.features(PLACES), covariance_of(PLACES, PLACES, field.kernel)
    np.testing.assert_allclose(features @ features.T, expected, atol=1e-5)


@KERNELS
@settings(deadline=None)
@given(position=st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3))
def test_nowhere_more_is_expected_than_its_size_and_far_away_nothing(field, position):
    q = np.array([position])
    expected = float(np.sum(field.features(q) ** 2))
    assert expected <= 1.0 + 1e-9
    away = q + np.array([[0.0, 0.0, 50.0]])  # along the joint that slides
    assert np.abs(field.shift(at_rest(away), X)).max() < 1e-12


def test_its_derivative_is_exact_and_it_is_proportional():
    q = RNG.uniform(-1.5, 1.5, (5, 3))
    by_x = FIELD.derivative(at_rest(q), X)
    np.testing.assert_allclose(by_x @ X, FIELD.shift(at_rest(q), X), atol=1e-15)
    step = 1e-6
    for k in (0, 6, 7, 20):
        ahead, behind = (FIELD.shift(at_rest(q), X + sign * step * (np.arange(21) == k))
                         for sign in (1.0, -1.0))  # fmt: skip
        np.testing.assert_allclose(by_x[:, :, k], (ahead - behind) / (2.0 * step), atol=1e-9)


def test_a_whole_turn_changes_nothing():
    q = RNG.uniform(-1.5, 1.5, (5, 3))
    turned = q + 2.0 * np.pi * np.array([1.0, -1.0, 0.0])
    there, here = (FIELD.shift(at_rest(at), X) for at in (turned, q))
    np.testing.assert_allclose(there, here, atol=1e-12)


@KERNELS
def test_as_plain_data_it_is_the_same(field):
    plain = term_to_plain(field)
    assert term_from_plain(plain, where="model.yaml") == field
    assert ("kernel" in plain["form"]) == (field is ROUGH)  # smooth where nothing is said


def test_a_rough_one_has_another_formula():
    assert "exp(-d_k / length_m)" in ROUGH.formula
    assert "exp(-d_k^2 / (2 length_m^2))" in FIELD.formula


def test_another_campaign_of_the_arm_starts_without_it():
    assert FIELD.elsewhere() is None


def test_places_are_spread_and_never_more_than_there_are_points():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.1, 0.0], [1.0, 0.0]])
    assert well_spread(points, 2).tolist() == [0, 1]
    assert len(well_spread(points, 9)) == 3  # two are the same


# A sum of terms without a name.

SUM = Nameless(
    (base_frame(), EncoderEccentricity("joint 2", 1.0), Backlash("joint 2")),
    (*(1e-3,) * 6, 3e-4, 3e-4, 1e-4),
)


def test_a_sum_does_what_its_terms_do_and_its_derivative_is_exact():
    at, x = replace(at_rest(PLACES), arrival=np.sign(PLACES)), RNG.standard_normal(9)
    shift = SUM.shift(at, x)
    assert SUM.coordinates == (*base_frame().coordinates, "theta_2")
    np.testing.assert_allclose(shift[:, :6], np.broadcast_to(x[:6], (7, 6)))
    _, eccentric, lost = SUM.terms
    by_hand = eccentric.shift(at, x[6:8]) + lost.shift(at, x[8:])
    np.testing.assert_allclose(shift[:, 6:], by_hand)
    np.testing.assert_allclose(SUM.derivative(at, x) @ x, shift, atol=1e-15)


def test_its_amounts_are_those_of_what_has_no_name_and_are_told_nowhere():
    assert set(SUM.roles) == {"field"}
    assert [each.scale for each in SUM.parameters] == list(SUM.sizes)
    assert len({each.name for each in SUM.parameters}) == len(SUM.sizes)
    assert SUM.report(np.ones(9)).parameters == ()
    assert SUM.elsewhere() is None


def test_a_sum_is_plain_data_and_back():
    assert term_from_plain(term_to_plain(SUM), where="here") == SUM


@pytest.mark.parametrize(
    "form", [{}, {"terms": []}, {"terms": 3, "sizes": []}, {"terms": [], "sizes": [1.0]}]
)
def test_an_incomplete_sum_is_refused(form):
    with pytest.raises(TermError, match="incomplete"):
        term_from_plain({"id": "nameless", "of": "joints", "form": form}, where="here")
