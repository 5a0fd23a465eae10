"""Joints that stood at few positions: what is known at them, and between."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pa10cal.arm.statics import PoseStates
from pa10cal.discovery.finding import Finding, Rival
from pa10cal.discovery.other_explanations import others_of_position
from pa10cal.fit.levels import by_levels, levels_of
from pa10cal.fit.rows_about_fit import RowsAboutFit
from pa10cal.fit.validity import Discrepancy
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.terms.effects.joint import (
    Backlash,
    EncoderEccentricity,
    EncoderEllipticity,
    GearRatioError,
)
from pa10cal.terms.effects.joint_error_map import JointErrorMap

GRID = np.repeat(np.radians(np.linspace(-120.0, 120.0, 7)), 20)
NOISE_M, SIZE = 2e-5, 1e-2
ECCENTRIC, ELLIPTIC = EncoderEccentricity("joint 1", 1.0), EncoderEllipticity("joint 1", 2.0)
RATIO = GearRatioError("joint 1")


@pytest.mark.parametrize(
    ("position", "turns", "count"),
    [
        (GRID, True, 7),
        (GRID + np.pi, True, 7),  # across the end of a turn
        (np.repeat(np.linspace(0.0, 3.2, 7), 20), False, 7),
        (GRID + 1e-4 * np.sin(np.arange(len(GRID))), True, 7),  # as encoders read it
        (np.random.default_rng(0).uniform(-2.0, 2.0, 140), True, 0),
        (np.random.default_rng(0).uniform(0.0, 1.0, 40), False, 0),
        (np.linspace(-2.0, 2.0, 140), True, 0),  # swept
        (np.repeat([0.3, 0.9], 70), True, 0),  # no level between others
        (np.full(140, 0.3), True, 0),
        (1e-5 * np.arange(140) // 20, True, 0),  # counts of an encoder that stands still
    ],
)
def test_a_joint_stands_at_levels_or_everywhere(position, turns, count):
    shuffled = np.random.default_rng(1).permutation(position)
    assert len(levels_of(shuffled, turns=turns)) == count


def told(error_rad, effects):
    """Return what levels of one joint say, its end 1 m away, with effects fitted to its error."""
    measured_m = error_rad + np.random.default_rng(2).normal(0.0, NOISE_M, len(GRID))
    q, none = GRID[:, None], np.full(len(GRID), np.nan)
    states = PoseStates(q, np.full_like(q, np.nan), np.zeros_like(q), 0.0 * GRID, none, none)
    of_effects = [effect.per_unit(states).reshape(len(GRID), -1) for effect in effects]
    columns = np.hstack([*of_effects, np.ones((len(GRID), 1))])
    x = np.linalg.lstsq(columns, measured_m, rcond=None)[0]
    weight, k = 1.0 / NOISE_M, columns.shape[1]
    residual = weight * (columns @ x - measured_m)[:, None]
    ones = np.ones_like(residual)
    rows = RowsAboutFit(
        data=residual,
        residual=residual,
        weight=weight * ones,
        columns=weight * SIZE * columns[:, None, :],
        sizes=np.full(k, SIZE),
        parameter_index=np.arange(k - 1),
        of_field=np.zeros(k, dtype=bool),
        to_mm=1e3 * NOISE_M * ones,
        noise_mm2=(1e3 * NOISE_M) ** 2 * ones,
        of_parameters=1.0,
        components_factor=1.0,
        trust=ones[:, 0],
        before=Gaussian.none(k),
    )
    starts = np.cumsum([0, *(each.shape[1] for each in of_effects)])
    at = {
        each: np.arange(*ends)
        for each, ends in zip(effects, np.c_[starts[:-1], starts[1:]], strict=True)
    }
    model = SimpleNamespace(
        model=SimpleNamespace(terms=effects, parameter_indices=at.get),
        x=x[:-1],
        values_of=lambda effect: x[at[effect]],
        arm=SimpleNamespace(prismatic=np.array([False])),
    )
    levels = levels_of(GRID, turns=True)
    return by_levels(model, rows, SimpleNamespace(states=states), 0, levels)


def test_an_effect_that_is_there_is_told_by_levels_and_holds_between_them():
    odds, between_mm2 = told(2e-4 * np.sin(GRID + 0.3), (ECCENTRIC,))
    assert odds > 1e3
    assert np.sqrt(between_mm2) < 0.01


@pytest.mark.parametrize("effects", [(ECCENTRIC, ELLIPTIC, RATIO), (ECCENTRIC, ELLIPTIC)])
def test_waves_that_follow_whatever_values_the_levels_have_say_nothing_of_between(effects):
    of_level = np.random.default_rng(5).normal(0.0, 2e-4, 7)
    odds, between_mm2 = told(np.repeat(of_level, 20), effects)
    assert odds < 19.0
    assert np.sqrt(between_mm2) > 0.5e3 * np.std(of_level)


def test_where_nothing_is_hidden_levels_add_nothing():
    odds, between_mm2 = told(np.zeros(len(GRID)), ())
    assert odds == np.inf
    assert between_mm2 == 0.0


LEVELS = np.array([-1.0, 0.0, 1.0])
SOME = Discrepancy(
    q=np.array([[0.0, 0.2], [1.0, 0.3]]),
    lever_m=np.array([0.8, 1.0]),
    turns=np.array([True, False]),
    distance_m=np.array([0.1, 5.0]),
    error_mm=np.array([0.03, 0.03]),
    near_m=0.15,
    levels=(LEVELS, np.zeros(0)),
    between_mm=np.array([0.04, 0.0]),
)


def test_the_promise_holds_the_error_between_levels_and_beyond_them():
    q = np.column_stack([[0.0, 2.0 * np.pi, 0.05, 0.5, 1.5], np.full(5, 0.2)])
    expected = [0.03, 0.03, np.hypot(0.03, 0.02), 0.05, 0.05]
    assert SOME.error_at_mm(q) == pytest.approx(expected)


def test_what_may_be_lacking_between_levels_is_mixed_as_all_else():
    nothing = replace(SOME, levels=(), between_mm=np.zeros(0))
    q = np.array([[0.5, 0.2]])
    assert nothing.mixed_with(0.25, SOME).error_at_mm(q) == pytest.approx(np.hypot(0.03, 0.02))
    assert SOME.mixed_with(0.25, nothing).error_at_mm(q) == pytest.approx(0.05)


def test_levels_in_a_file_are_of_every_joint():
    plain = {name: getattr(SOME, name) for name in SOME.__dataclass_fields__}
    again = Discrepancy.from_plain(plain, 2)
    assert again.error_at_mm(SOME.q).tolist() == SOME.error_at_mm(SOME.q).tolist()
    for spoilt in ({"between_mm": [0.1]}, {"between_mm": [-0.1, 0.0]}, {"levels": [[0.0]]}):
        with pytest.raises(ValueError, match="discrepancy"):
            Discrepancy.from_plain({**plain, **spoilt}, 2)


def test_other_effects_of_the_same_position_are_what_predictions_may_be_instead():
    rivals = [
        Rival(each, np.zeros(1))
        for each in (ECCENTRIC, EncoderEccentricity("joint 2", 1.0), Backlash("joint 1"))
    ]
    rivals.append(Rival(JointErrorMap("joint 1"), np.zeros(1)))
    finding = Finding(RATIO, np.zeros(1), np.eye(1), (), object(), tuple(rivals))
    assert others_of_position(finding) == [ECCENTRIC]
