"""Which campaigns are too small for a search, and what is said of them all the same."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from made_up_arm import measure
from mended import write_simulated
from pa10cal.discovery.blocked_cv.survey import least_for_blocks
from pa10cal.discovery.discover import discover
from pa10cal.discovery.evidence.channel_tests import evidence_lack_of_fit
from pa10cal.discovery.gap import errors_of
from pa10cal.discovery.log_faults import fault_of_pose
from pa10cal.discovery.not_sought import orientations_off, too_few_poses
from pa10cal.discovery.repeats import same_circumstances
from pa10cal.discovery.verdict_records import analysis_record, extended_record, verdict_record
from pa10cal.interface import calibrate, read_campaign
from pa10cal.interface import discover as discover_in
from pa10cal.observe.observations import reading_groups
from pa10cal.results.discovery import Unexplained
from pa10cal.stages.discover import verdict_lines
from pa10cal_lab.cell.options import HiddenEffectOptions, SimulateOptions, TrackerOptions


@pytest.fixture(scope="module")
def made():
    """30 poses, two loads, four readings each, in two directions."""
    return measure()


def of_poses(made, count):
    readings = made.readings
    return readings.take(np.isin(readings.pose, np.unique(readings.pose)[:count]))


def once(made):
    _, first = np.unique(made.readings.pose, return_index=True)
    return made.readings.take(first)


@pytest.mark.parametrize(
    ("some", "why", "remedy"),
    [
        (lambda made: made.readings, None, None),
        (lambda made: of_poses(made, 8), None, None),
        (
            once,
            "30 readings of calibration poses are too few to hold out blocks of them, and with 0 "
            "repeats the repeatability is not known",
            "measure at least 100 calibration poses, or repeat at least 20 readings at the same "
            "pose, load and direction of arrival, moving the arm in between",
        ),
        (lambda made: of_poses(made, 3), "with 12 repeats", "repeat at least 20 readings"),
        (
            lambda made: of_poses(made, 7),
            "7 calibration poses are too few to separate an effect from the 34",
            "measure at least 8 calibration poses",
        ),
    ],
)
def test_what_too_small_a_campaign_lacks_is_said(made, some, why, remedy):
    found = too_few_poses(some(made), made.baseline)
    assert (found is None) == (why is None)
    if found is not None:
        assert why in found.why
        assert remedy in found.remedy


@pytest.mark.parametrize(("targets", "least"), [(1, 100), (2, 100), (3, 70), (5, 70)])
def test_fewer_poses_are_enough_where_three_targets_show_each(targets, least):
    seen = np.ones((70, 3 * targets), dtype=bool)
    readings = SimpleNamespace(measured=SimpleNamespace(components_seen=seen))
    assert least_for_blocks(readings) == least


@pytest.mark.slow
@pytest.mark.parametrize(("poses", "names"), [(69, []), (80, [("backlash", "joint 3")])])
def test_what_three_targets_show_is_sought_in_seventy_poses_and_more(tmp_path, poses, names):
    plan = TrackerOptions(instrument="points", poses=poses, holdout_share=0.0, targets=3)
    lost = HiddenEffectOptions(id="backlash", of="joint 3", parameters={"b": 4e-4})
    settings = SimulateOptions(
        robot="irb120", random_seed=3, without_touches=plan, hidden_effects=(lost,)
    )
    campaign = read_campaign(write_simulated(tmp_path / "robot", settings))
    found = discover_in(campaign, calibrate(campaign))
    assert (found.verdict == "not_sought") == (not names)
    assert [(each.effect.id, each.of) for each in found.effects] == names
    assert ("at least 70 calibration poses" in (found.remedy or "")) == (not names)


def test_orientations_of_another_convention_are_said(made):
    readings = made.readings
    assert orientations_off(readings, made.baseline) is None
    T = readings.measured.T_instr_target.copy()
    T[:, :3, :3] = T[:, :3, :3].transpose(0, 2, 1)
    inverted = replace(readings, measured=replace(readings.measured, T_instr_target=T))
    assert "deg off those of the calibrated model" in orientations_off(inverted, made.baseline).why
    found = discover(inverted, made.baseline, made.setup)
    assert (found.verdict, found.effects) == ("not_sought", ())
    assert "the sense of qw, qx, qy, qz" in found.remedy


@pytest.fixture(scope="module")
def found(made):
    return discover(once(made), made.baseline, made.setup)


class TestVerdict:
    def test_it_is_the_calibrated_model(self, made, found):
        assert found.verdict == "not_sought"
        assert found.why == too_few_poses(once(made), made.baseline).why
        assert found.model is made.baseline
        assert found.effects == found.next_poses(3).poses == ()
        assert found.holdout is None
        assert found.train.before == found.train.after
        expected = errors_of(made.baseline, found.train.poses).distance_mm
        assert found.train.before.mean_mm == pytest.approx(expected.mean())

    def test_it_shows_itself_in_a_notebook(self, found):
        assert found.why in found._repr_html_()
        assert found.why in repr(found)
        assert max(len(repr(of).splitlines()) for of in (found, found.model)) <= 12
        assert "verdict: not_sought" in found._repr_html_()
        assert found.remedy in found._repr_html_()

    def test_what_it_says_is_shown_in_full_words(self, found):
        assert found.why in repr(replace(found, remedy=None))
        sought = replace(found, why=None, remedy=None)
        fault = fault_of_pose("7", "far from the others", None, decides=True)
        shown = repr(replace(sought, faults_of_rows=(fault,)))
        assert "check_the_log\nfault, pose 7: far from the others\n" in shown
        not_sought = repr(replace(found, faults_of_rows=(fault,)))
        assert f"{found.remedy}\nfault, pose 7: far from the others" in not_sought
        part = Unexplained(of="joint 3", form=None, shared_error_mm=0.1, why="more than noise")
        shown = repr(replace(sought, unexplained=(part,) * 20))
        assert "unexplained\nno name, joint 3: more than noise\n" in shown
        assert "and 12 more" in shown
        assert len(shown.splitlines()) <= 12
        effect = SimpleNamespace(id="friction", of="joint 2")
        named = (SimpleNamespace(effect=effect, parameters={}, probability=1.0),)
        for where in ("gives_way", "in_log"):
            assert "named\nfriction of joint 2" in repr(replace(sought, **{where: named}))

    def test_what_remains_is_stated_the_same_before_and_after(self, found):
        before, after = found.lack_of_fit()
        assert before is after
        assert before.pure_error is before.by_joint[0].torque_noise_Nm is None
        assert before.by_load[0].floor_mm > 0.0

    def test_repeats_say_what_the_noise_is_where_poses_are_too_few(self, made):
        found = discover(of_poses(made, 7), made.baseline, made.setup)
        assert found.verdict == "not_sought"
        assert "pairs of poses closer than 2 mrad" in found.noise_floor_from
        # Eight readings at two loads: four in each mean.
        single = discover(once(made), made.baseline, made.setup).noise_floor_mm
        assert 0.3 < found.noise_floor_mm / single < 0.9

    def test_its_records_are_whole(self, found):
        class Campaign:
            name, robot, provenance = "made up", "pa10_6ce", "made up"

        # The covariance of the made-up baseline is not known; that of a calibrated one is.
        known = found.scorer.calibrated
        known = replace(known, covariance=1e-12 * np.eye(len(known.x) + 6))
        scorer = replace(found.scorer, calibrated=known, covariance=known.covariance)
        whole = replace(found, scorer=scorer)
        record = verdict_record(whole, Campaign())
        extended = extended_record(whole, record, Campaign.robot, "combined")
        assert record.verdict == extended.verdict == "not_sought"
        assert tuple(verdict_lines(record)) == (
            f"effects were not sought: {found.why}; {found.remedy}",
        )
        assert len(analysis_record(whole, Campaign()).naming) == 1
        own = known.model.report(known.x)
        for parameter, value in zip(own.parameters, own.values, strict=True):
            assert extended.parameters[parameter.name].value == pytest.approx(value)


def there_and_back(readings, group):
    """Return readings in an order in which all groups have the same mean time."""
    time_s = np.empty(len(readings))
    for k in np.unique(group):
        rows = np.flatnonzero(group == k)
        away = 10.0 * (k + 1.0 + len(readings) * np.arange(len(rows) // 2))
        time_s[rows] = 1e4 + np.concatenate([-away, away])
    return readings.with_states(replace(readings.states, time_s=time_s))


def test_cells_of_the_same_mean_time_have_no_drift(made):
    order = there_and_back(made.readings, same_circumstances(made.readings))
    again = replace(made, readings=order)
    found = evidence_lack_of_fit(again.problem, again.start)
    assert [drift.with_time_mm for drift in found.drifts] == [None] * 3
    few = of_poses(made, 3)
    verdict = discover(there_and_back(few, reading_groups(few)), made.baseline, made.setup)
    assert verdict.verdict == "not_sought"
    assert [drift.with_time_mm for drift in verdict.lack_of_fit()[0].drifts] == [None] * 3


class TestLogsThatDoNotScatter:
    """Calculated torques in place of logged ones."""

    def searched(self, made, tau_Nm):
        readings = made.readings.with_states(replace(made.readings.states, tau_Nm=tau_Nm))
        return discover(readings, made.baseline, made.setup)

    @pytest.mark.slow
    def test_a_joint_that_always_reads_zero_tells_nothing(self, made):
        tau_Nm = made.readings.states.tau_Nm.copy()
        tau_Nm[:, 0] = 0.0
        with np.errstate(all="raise"):
            found = self.searched(made, tau_Nm)
        noise_Nm = found.scorer.problem.noise.torque_Nm
        assert noise_Nm[0] == noise_Nm.max()
        assert found.scorer.problem.torques_logged
        assert found.verdict == "none"

    def test_a_log_without_any_scatter_is_none(self, made):
        _, group = np.unique(reading_groups(made.readings), return_inverse=True)
        tau_Nm = made.readings.states.tau_Nm.copy()
        first = np.unique(group, return_index=True)[1]
        found = self.searched(
            made, tau_Nm[first][group] * (1.0 + 1e-12 * np.arange(len(group)))[:, None]
        )
        assert not found.scorer.problem.torques_logged
        assert found.scorer.problem.torque is None
        assert found.verdict == "none"


def test_readings_that_were_copied_are_no_repeats(made):
    group = reading_groups(made.readings)
    first = np.unique(group, return_index=True)[1]
    copied = made.readings.take(first[group])
    copied = copied.with_states(replace(copied.states, time_s=made.readings.states.time_s))
    found = discover(copied, made.baseline, made.setup)
    assert found.verdict == "not_sought"
    assert found.why.startswith("the scatter of repeats shows no noise in some component")
    assert "readings that were copied" in found.remedy
    assert found.noise_floor_from.startswith("the instrument's stated uncertainty")
    assert np.isfinite(found.lack_of_fit()[0].by_load[0].floor_mm)
