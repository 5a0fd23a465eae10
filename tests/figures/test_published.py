"""The paper's figures are consistent with what is said about them."""

import pytest

from pa10cal.figures import published
from pa10cal.figures.published import reduction_percent


def test_its_mean_errors_fell_by_other_percentages_than_it_says():
    fell = [
        round(reduction_percent(published.BEFORE[load].mean_mm, published.AFTER[load].mean_mm))
        for load in ("0N", "22N", "44N")
    ]
    assert fell == [45, 73, 82]
    low, high = published.CLAIMED_REDUCTIONS_PERCENT
    assert fell[0] < low
    assert fell[2] > high


def test_its_peak_errors_fell_by_three_quarters_for_one_model_only():
    before = published.HELD_OUT["uncalibrated"].peak_mm
    fell = {
        name: round(reduction_percent(before, published.HELD_OUT[name].peak_mm))
        for name in ("linear", "cubic")
    }
    assert fell == {"linear": 77, "cubic": 74}
    assert fell["cubic"] < published.CLAIMED_PEAK_REDUCTION_PERCENT


def test_its_errors_are_further_from_its_minimum_than_it_says():
    apart = [
        round(errors.mean_mm - published.MONTE_CARLO_MEAN_MM, 2)
        for errors in published.AFTER.values()
    ]
    assert apart == [0.12, 0.08, 0.13]
    assert max(apart) > published.CLAIMED_DISTANCE_FROM_MINIMUM_MM


def test_table_one_is_complete():
    assert len(published.DEPARTURES) == 24
    assert len(published.K_LIN) == len(published.K_CUB["text_e7"]) == 3
    # The paper's orientation error before calibration is what its joint zeros turn the tool by.
    turn = published.DEPARTURES["delta_theta_4"] + published.DEPARTURES["delta_theta_6"]
    assert turn == pytest.approx(21.1e-3)


def test_the_two_readings_of_the_cubic_stiffness_are_a_power_of_ten_apart():
    text, table = published.K_CUB["text_e7"], published.K_CUB["table_e8"]
    for joint, value in text.items():
        assert table[joint] == pytest.approx(10 * value, rel=0.003)
    assert published.parameter("K_cub_5", "text_e7") == 3.83e7
    assert published.parameter("K_cub_5", "table_e8") == 3.84e8


@pytest.mark.parametrize("name", ["K_lin_1", "delta_d_2", "base_p_cmm_x", "gamma_z"])
def test_states_nothing_about_other_parameters(name):
    assert published.parameter(name, "text_e7") is None
