"""Which amounts of effects rule out their names."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from made_up_poses import context_of, states_of
from pa10cal.discovery.credible_amounts import reasons_against_amounts, surely_negative
from pa10cal.discovery.refitted_verdict import finding_of, instead, too_many_others, unfit
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.joint import GearRatioError, SoftWindup
from pa10cal.terms.effects.structure import AxisWobble, BaseCompliance, LateralCompliance
from pa10cal.terms.effects.vocabulary import candidates

ARM = load_arm("pa10_6ce")
BASE = BaseCompliance("base")


def fitted(x, covariance=None):
    """Return a model that has these parameters of an effect alone."""
    x = np.asarray(x, dtype=float)
    return SimpleNamespace(
        arm=ARM,
        values_of=lambda _: x,
        model=SimpleNamespace(columns_of=lambda _: slice(0, len(x)), u_scale=0.5),
        covariance=covariance,
    )


def turned_mrad(effect, model, states):
    """Return whether reasons against amounts say that it turns too far."""
    return any("mrad" in why for why in reasons_against_amounts(effect, model, states))


@pytest.mark.parametrize(
    ("effect", "x", "std"),
    [
        (BASE, (2e-5, 1e-3), 1e-5),
        (BASE, (1e-3, 2e-5), 1e-5),
        (LateralCompliance("joint 3"), (2e-5, 1e-3), 1e-5),
        (AxisWobble("joint 4"), (1e-4, 5e-3, 0.0, 0.0, 0.0, 0.0), 1e-4),
        (AxisWobble("joint 4"), (5e-3, 1e-4, 0.0, 0.0, 0.0, 0.0), 1e-4),
    ],
    ids=["base about y", "base about x", "bearing", "sine", "cosine"],
)
def test_what_turns_too_far_is_no_name_by_whichever_parameter(effect, x, std):
    states = states_of(ARM, poses=60)
    model = fitted(x, std**2 * np.eye(len(x)))
    assert turned_mrad(effect, model, states)
    assert not turned_mrad(effect, fitted(0.001 * np.array(x), model.covariance), states)
    # As uncertain as it is large, it may be possible.
    assert not turned_mrad(effect, fitted(x, max(x) ** 2 * np.eye(len(x))), states)


@pytest.mark.parametrize("correlation", [-0.98, 0.0, 0.98])
@pytest.mark.parametrize("tilt", [1.5, 2.5])
def test_a_rotation_is_as_uncertain_as_drawn_amounts_make_it(correlation, tilt):
    """Of an axis that wobbles the parts add up in one pose, and so do their errors."""
    wobble = AxisWobble("joint 4")
    states = states_of(ARM, poses=1, q_rad=np.full((1, 6), np.pi / 4.0))
    x = tilt * 2e-3 / np.sqrt(2.0) * np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    std = 8e-4
    covariance = np.diag([std**2] * 2 + [1e-14] * 4)
    covariance[0, 1] = covariance[1, 0] = correlation * std**2
    draws = np.random.default_rng(1).multivariate_normal(x, covariance, 20000)
    # About x by b_c cos q + b_s sin q, each of which is sqrt(1/2).
    about_x = (draws[:, 0] + draws[:, 1]) / np.sqrt(2.0)
    surely = (about_x > 2e-3).mean() > 0.975
    assert turned_mrad(wobble, fitted(x, covariance), states) == surely


def test_only_what_is_negative_is_said_to_be():
    states = states_of(ARM, poses=5)
    (why,) = reasons_against_amounts(BASE, fitted([1e-6, -1e-6]), states)
    assert why == "its cy would be negative, which is not physical"
    soft = next(each for each in candidates(context_of(ARM)) if isinstance(each, SoftWindup))
    (why,) = reasons_against_amounts(soft, fitted([-1e-4, 5.0]))
    assert why == "its A would be negative, which is not physical"
    assert surely_negative(BASE, fitted([1e-6, -1e-6], np.diag([1e-14, 1e-14])))
    assert not surely_negative(BASE, fitted([1e-6, -1e-6], np.diag([1e-14, 1e-12])))
    assert not surely_negative(GearRatioError("joint 2"), fitted([-1e-3]))


@pytest.mark.parametrize(
    ("x", "covariance"),
    [
        ([np.nan, 1e-6], 1e-16 * np.eye(2)),
        ([1e-6, 1e-6], np.diag([np.inf, 1e-16])),
        ([1e-6, 1e-6], np.full((2, 2), np.nan)),
    ],
)
def test_what_a_fit_gave_no_numbers_for_is_no_name(x, covariance):
    reasons = [*reasons_against_amounts(BASE, fitted(x, covariance), states_of(ARM, poses=5))]
    assert reasons == ["the fit gave no numbers for its amounts, or no uncertainty of them"]


def test_numbers_of_an_earlier_fit_do_not_count():
    finding = SimpleNamespace(
        effect=BASE, x=np.full(2, -1.0), covariance=np.eye(2), alternatives=()
    )
    model = fitted([1e-6, 1e-6], 1e-16 * np.eye(2))
    assert [*unfit(finding, model, states_of(ARM, poses=5))] == []


def test_one_other_effect_explains_and_two_explain():
    assert too_many_others(1) == "1 other effect explains the data as well"
    assert too_many_others(2) == "2 other effects explain the data as well"


def test_a_finding_that_is_not_there_is_refused():
    found = SimpleNamespace(findings=(SimpleNamespace(effect=BASE),))
    other = SimpleNamespace(effect=LateralCompliance("joint 3"))
    with pytest.raises(ValueError, match="lateral_compliance of joint 3 is not among the findings"):
        finding_of(found, other.effect)
    with pytest.raises(ValueError, match="lateral_compliance of joint 3 is not among the findings"):
        instead(found, other)
    assert instead(found, other, BASE) == (other,)
