"""Which readings are suspected of a gross error."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_survey import observe
from pa10cal.discovery.row_faults import gross_errors
from pa10cal.observe.pose import Touched

WRONG_M = 8e-3


@pytest.fixture(scope="module")
def survey():
    return observe(poses=120, held_out=0)


@pytest.fixture
def thrice(survey):
    """Each pose read three times, with the scatter of single readings."""
    poses = survey.survey.poses
    readings = poses.take(np.repeat(np.arange(len(poses)), 3))
    T = readings.measured.T_instr_target.copy()
    T[:, :3, 3] += 2e-5 * np.random.default_rng(1).standard_normal((len(T), 3))
    return readings.with_measured(T_instr_target=T)


def moved(readings, rows):
    T = readings.measured.T_instr_target.copy()
    T[rows, 2, 3] += WRONG_M
    return readings.with_measured(T_instr_target=T)


def test_of_sound_readings_none_is_suspected(survey, thrice):
    found = gross_errors(thrice, survey.baseline)
    assert not found.excluded.any()
    assert not found.accused.any()


def test_a_reading_that_no_other_of_its_pose_confirms_is_suspected(survey, thrice):
    found = gross_errors(moved(thrice, [7, 100]), survey.baseline)
    np.testing.assert_array_equal(np.flatnonzero(found.accused), [7, 100])


def test_of_two_readings_the_one_far_from_the_model_is_suspected(survey, thrice):
    pairs = thrice.take(np.arange(len(thrice)) % 3 < 2)
    found = gross_errors(moved(pairs, [9]), survey.baseline)
    np.testing.assert_array_equal(np.flatnonzero(found.accused), [9])


def test_readings_that_agree_are_what_the_model_lacks(survey, thrice):
    assert not gross_errors(moved(thrice, [30, 31, 32]), survey.baseline).excluded.any()


def test_a_pose_read_once_is_suspected_as_in_its_calibration(survey):
    found = gross_errors(moved(survey.survey.poses, [5]), survey.baseline)
    np.testing.assert_array_equal(np.flatnonzero(found.accused), [5])


def test_touched_balls_are_judged_by_their_repeats_as_all_else_is(survey, thrice, monkeypatch):
    wrong = moved(thrice, [7])
    monkeypatch.setattr(type(wrong.measured), "from_touches", Touched.from_touches)
    found = gross_errors(wrong, survey.baseline)
    np.testing.assert_array_equal(np.flatnonzero(found.excluded), [7])


def test_an_error_of_ten_times_the_scatter_of_repeats_is_found(survey, thrice):
    T = thrice.measured.T_instr_target.copy()
    T[50, 0, 3] += 2.5e-4
    found = gross_errors(thrice.with_measured(T_instr_target=T), survey.baseline)
    np.testing.assert_array_equal(np.flatnonzero(found.excluded), [50])
    assert found.off_mm[50] == pytest.approx(0.25, abs=0.08)


def test_heavy_tails_are_not_called_wrong(survey, thrice):
    T = thrice.measured.T_instr_target.copy()
    T[:, :3, 3] += 4e-5 * np.random.default_rng(2).standard_t(3, (len(T), 3))
    found = gross_errors(thrice.with_measured(T_instr_target=T), survey.baseline)
    assert not found.accused.any()
    assert 0 < found.excluded.sum() < 0.1 * len(T)


def test_readings_off_one_after_the_other_are_no_single_ones(survey, thrice):
    """As where the instrument stood elsewhere during the last pass over some of the poses."""
    states = thrice.states
    time_s = np.arange(len(thrice)) % 3 * 1e4 + np.arange(len(thrice)) // 3
    thrice = thrice.with_states(replace(states, time_s=time_s.astype(float)))
    found = gross_errors(moved(thrice, np.arange(2, 45, 3)), survey.baseline)
    assert found.excluded.sum() < 10
    assert not found.accused.any()
