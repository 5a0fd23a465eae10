"""Faults of single readings and poses, and what the verdict makes of them."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.observe.test_joined import joined

from made_up_arm import REPEATS, forced
from made_up_poses import at_rest, measured_poses, shifted
from made_up_survey import observe
from pa10cal.campaign.raw_rows import quarantined
from pa10cal.campaign.read import wrong_rows
from pa10cal.campaign.screens import OFF_REPEATS
from pa10cal.campaign.target_labels import EXCHANGED
from pa10cal.discovery import discover as search
from pa10cal.discovery import row_faults as faults_of_rows
from pa10cal.discovery.evidence.confirmation import confirm
from pa10cal.discovery.gross_errors import gross_errors, off_in_words
from pa10cal.discovery.log_faults import fault_of_influential_pose, fault_of_quarantined
from pa10cal.discovery.preparation import complete
from pa10cal.discovery.row_faults import held_out_faults, row_faults, true_loads
from pa10cal.discovery.rules import JUDGING
from pa10cal.fit.tails import Tails, far_from_prediction
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Touched
from pa10cal.results.calibration import InputFinding
from pa10cal.results.discovery import Unexplained


def with_loads(readings, load_N):
    return readings.with_states(replace(readings.states, load_N=load_N))


def exchanged_at(readings, pose, repeats=None):
    """Return readings with the two loads of a pose exchanged, at all repeats or some."""
    load_N = readings.states.load_N.copy()
    first, second = np.unique(load_N)[:2]
    here = readings.pose == pose
    if repeats is not None:
        here &= np.isin(readings.repeat, repeats)
    load_N[here] = first + second - load_N[here]
    return with_loads(readings, load_N), here


class TestLoads:
    def found(self, made, readings):
        return true_loads(readings, made.baseline, made.setup.payload, "logged")

    @pytest.mark.parametrize("name", ["null", pytest.param("rubbing", marks=pytest.mark.slow)])
    def test_right_ones_are_left_alone_whatever_the_torques_do(self, name, request):
        made = request.getfixturevalue(name)
        told_N, _ = self.found(made, made.readings)
        np.testing.assert_array_equal(told_N, made.readings.states.load_N)

    def test_an_exchange_at_one_pose_is_found(self, null):
        wrong, here = exchanged_at(null.readings, null.readings.pose[40])
        told_N, gain = self.found(null, wrong)
        np.testing.assert_array_equal(told_N, null.readings.states.load_N)
        assert here.any()
        assert gain[here].sum() > 0.5

    def test_a_load_that_is_always_another_is_no_slip_of_a_row(self, null):
        load_N = null.readings.states.load_N
        first, second = np.unique(load_N)[:2]
        _, gain = self.found(null, with_loads(null.readings, first + second - load_N))
        np.testing.assert_array_equal(gain, 0.0)


class TestShownLoads:
    """Loads by made-up deviations, in poses that are measured under each load in turn."""

    def told(self, monkeypatch, loads_N, written_N, repeats=1, poses=20):
        """Return the loads told of the readings of pose 3, of which others were written down."""
        true_N = np.tile(np.repeat(loads_N, repeats), poses).astype(float)
        pose = np.repeat(np.arange(poses), repeats * len(loads_N))
        stated_N = true_N.copy()
        stated_N[pose == 3] = written_N
        rng = np.random.default_rng(5)
        by_load = np.column_stack([np.ones(len(pose)), rng.uniform(0.5, 1.5, (len(pose), 2))])
        deviation = by_load * (true_N - stated_N)[:, None] + 0.5 * rng.normal(size=by_load.shape)
        monkeypatch.setattr(faults_of_rows, "_load_rows", lambda *_: (deviation, by_load))
        states = at_rest(np.zeros((len(pose), 6)), load_N=stated_N)
        still = np.tile(np.eye(4), (len(pose), 1, 1))
        cov = np.tile(np.eye(6), (len(pose), 1, 1))
        readings = measured_poses(pose.astype(str), states, still, cov)
        readings = replace(readings, repeat=np.tile(np.arange(repeats), poses * len(loads_N)))
        told_N, gain = true_loads(readings, None, "a payload", "logged")
        assert not gain[told_N == stated_N].any()
        np.testing.assert_array_equal(told_N[pose != 3], stated_N[pose != 3])
        faults = list(faults_of_rows._load_faults(readings, told_N, gain))
        return told_N[pose == 3].tolist(), faults

    @pytest.mark.parametrize(
        ("loads_N", "written_N"),
        [
            ((0, 80, 100), (80, 0, 100)),  # 100 N is near what the first reading shows
            ((0, 50, 60), (50, 0, 60)),
            ((0, 80, 100), (100, 80, 0)),
            ((0, 22, 44), (22, 0, 44)),
        ],
    )
    def test_those_exchanged_are_found(self, monkeypatch, loads_N, written_N):
        told_N, (fault,) = self.told(monkeypatch, loads_N, written_N)
        assert told_N == list(loads_N)
        changed = [load for load in loads_N if loads_N.index(load) != written_N.index(load)]
        assert fault.where == "pose 3, " + " and ".join(f"{load} N" for load in changed)
        assert fault.what.startswith("the loads seem exchanged: ")
        assert 0.5 < fault.gain < 1.0

    @pytest.mark.parametrize(
        ("poses", "wrong", "reported"),
        [(8, 1, True), (12, 2, True), (30, 4, True), (12, 12, False)],
    )
    def test_some_of_few_poses_may_be_exchanged(self, poses, wrong, reported):
        stated_N = np.tile([0.0, 44.0], poses)
        pose = np.repeat(np.arange(poses), 2)
        readings = SimpleNamespace(pose=pose, states=SimpleNamespace(load_N=stated_N))
        assert faults_of_rows._are_no_slips(pose < wrong, readings) != reported
        in_one_repeat = np.arange(16 * poses) % 16 == 0  # of eight, at every pose
        readings = SimpleNamespace(
            pose=np.repeat(pose, 8), states=SimpleNamespace(load_N=np.repeat(stated_N, 8))
        )
        assert not faults_of_rows._are_no_slips(in_one_repeat, readings)

    def test_loads_exchanged_at_one_of_eight_poses_are_reported(self, monkeypatch):
        true_N, written_N = (0, 44), (44, 0)
        found_N, faults = self.told(monkeypatch, true_N, written_N, poses=8)
        assert found_N == list(true_N)
        assert len(faults) == 1

    @pytest.mark.parametrize("written_N", [(44, 0, 0, 0), (44, 0, 44, 44)])
    def test_those_exchanged_among_unequal_numbers_of_repeats_are_found(
        self, monkeypatch, written_N
    ):
        told_N, (fault,) = self.told(monkeypatch, (0, 44, 44, 44), written_N)
        assert told_N == [0, 44, 44, 44]
        assert fault.what.startswith("the loads seem exchanged: ")

    def test_one_that_is_alone_with_another_load_is_none(self, monkeypatch):
        told_N, faults = self.told(monkeypatch, (0, 22, 44), (22, 22, 44))
        assert (told_N, faults) == ([22, 22, 44], [])

    def test_each_load_has_its_own_repeat(self, monkeypatch):
        written_N = (22, 0, 22, 0)  # the first at 0 N and the last at 22 N
        told_N, (fault,) = self.told(monkeypatch, (0, 22), written_N, repeats=2)
        assert told_N == [0, 0, 22, 22]
        assert fault.where == "pose 3, 0 N, repeat 1 and 22 N, repeat 0"


class TestTails:
    @pytest.mark.parametrize("dof", [3, 5, 200])
    def test_right_deviates_seldom_exceed_the_largest(self, dof):
        generator = np.random.default_rng(1)
        over = 0
        for _ in range(100):
            deviates = generator.standard_t(dof, 1200)
            over += np.abs(deviates).max() > Tails.of(deviates).largest(1e-3)
        assert over <= 2

    def test_gross_errors_do_not_hide_themselves(self):
        generator = np.random.default_rng(2)
        deviates = generator.standard_normal(1000)
        deviates[:20] *= 100.0
        assert Tails.of(deviates).largest(1e-3) < 20.0

    def test_no_deviates_have_no_size(self):
        assert Tails.of(np.zeros(0)).largest(0.1) == Tails.of(np.zeros(9)).largest(0.1) == 0.0


class TestWrongRows:
    def test_configurations_are_told_once(self):
        where = ["pose P07, 22 N, repeat 4"] * 2
        rows = quarantined("cmm.csv", [7, 8], f"{EXCHANGED}: B and C", ["", ""], where)
        rows += quarantined("poses.csv", [5], EXCHANGED, ["T1 and T3"])
        rows += quarantined("poses.csv", [6], "another reason", ["x"])
        rows += quarantined("poses.csv", [9], OFF_REPEATS, ["x"], ["pose P02, 0 N, repeat 1"])
        first, second, third = wrong_rows(rows)
        assert first.where == "cmm.csv: pose P07, 22 N, repeat 4"
        assert "B and C" in first.what
        assert second.where == "poses.csv: line 5"
        assert "T1 and T3" in second.what
        assert (third.kind, third.where) == ("outlier", "poses.csv: pose P02, 0 N, repeat 1")

    @pytest.mark.parametrize(
        ("of", "kind", "decides"),
        [("target_label", "label", True), ("outlier", "outlier", False)],
    )
    def test_labels_decide(self, of, kind, decides):
        fault = fault_of_quarantined(
            InputFinding(what="what", where="where", remedy="do", kind=of, would_leave_mm=None)
        )
        assert (fault.kind, fault.where, fault.decides) == (kind, "where", decides)


class TestReadings:
    def test_a_load_exchanged_once_is_told_with_its_repeat(self, null):
        readings = complete(null.readings, null.baseline, null.setup)
        readings = replace(readings, repeat=np.arange(len(readings)) % REPEATS)
        wrong, here = exchanged_at(readings, readings.pose[40], [readings.repeat[40]])
        found = row_faults(wrong, null.baseline, null.setup.payload, "logged")
        (fault,) = found.faults
        assert (fault.kind, fault.decides) == ("load", True)
        repeat = f"repeat {readings.repeat[40]}"
        assert fault.where == f"pose {readings.pose[40]}, 0 N, {repeat} and 44 N, {repeat}"
        assert "exchanged" in fault.what
        np.testing.assert_array_equal(found.excluded, here)

    def test_a_reading_held_out_is_told_and_kept(self, null):
        held_out = complete(null.held_out, null.baseline, null.setup)
        fitted = complete(null.readings, null.baseline, null.setup)
        assert not held_out_faults(held_out, null.baseline, fitted).faults
        wrong = shifted(held_out, [0.0, 5e-3, 0.0], 4)
        found = held_out_faults(wrong, null.baseline, fitted)
        (fault,) = found.faults
        assert fault.kind == "outlier"
        assert fault.where.startswith(f"held out, pose {held_out.pose[4]}")
        assert not fault.decides
        np.testing.assert_array_equal(np.flatnonzero(found.excluded), [4])

    def test_what_is_turned_is_told_in_degrees(self, null):
        """An orientation that is wrong, of a reading among its repeats, and of a whole pose."""
        readings = complete(null.readings, null.baseline, null.setup)
        for at in ([40], readings.pose == readings.pose[40]):
            T = readings.measured.T_instr_target.copy()
            T[at, :3, :3] = (
                Rotation.from_rotvec([0.0, 5.0, 0.0], degrees=True).as_matrix() @ T[at, :3, :3]
            )
            wrong = readings.with_measured(T_instr_target=T)
            (fault,) = row_faults(wrong, null.baseline, null.setup.payload, "logged").faults
            assert fault.kind == "outlier"
            assert re.search(r"\b(4\.99|5|5\.01) deg off", fault.what)

    def test_labels_exchanged_in_a_campaign_of_a_group_are_told(self, monkeypatch):
        rng = np.random.default_rng(7)
        group, T, targets_m = joined(("points", "points"), rng)
        group = group.ideal(T, targets_m)
        names, row = group.target_names, int(np.flatnonzero(group.campaign == 1)[0])
        count = len(names) // 2
        order = [*range(count), count + 1, count, *range(count + 2, 2 * count)]
        states = at_rest(np.zeros((len(T), 6)), campaign=group.campaign)
        readings = Observations.single(np.arange(len(T)).astype(str), states, group)
        wrong = replace(readings, measured=group.in_order(order)).take([row])
        model = SimpleNamespace(compared=lambda r: r.measured.compare(T[[row]], targets_m))
        assert faults_of_rows._exchanged_labels(wrong, model) == {0: tuple(order)}
        assert faults_of_rows._exchanged_labels(readings.take([row]), model) == {}

    def test_a_pose_that_is_off_in_all_its_readings_is_told(self, null):
        readings = complete(null.readings, null.baseline, null.setup)
        here = readings.pose == readings.pose[40]
        wrong = shifted(readings, [1e-3, 0.0, 0.0], here)
        found = row_faults(wrong, null.baseline, null.setup.payload, "logged")
        (fault,) = found.faults
        assert (fault.kind, fault.where) == ("outlier", f"pose {readings.pose[40]}")
        assert not fault.decides
        np.testing.assert_array_equal(found.excluded, here)


class TestNamesThatOnePoseCarries:
    def test_an_effect_of_all_poses_has_no_carrier(self, wave):
        assert [finding.proof.influential_pose for finding in wave.discovery.findings] == [None]

    def test_one_pose_is_no_evidence(self, null, wave):
        """Of the wave one pose has its part, ten times over, and the others have none."""
        pose = wave.readings.pose[40]
        there = wave.readings.pose == pose
        T = null.readings.measured.T_instr_target.copy()
        T[there] += 10.0 * (wave.readings.measured.T_instr_target[there] - T[there])
        one = replace(null, readings=null.readings.with_measured(T_instr_target=T))
        effect = wave.discovery.findings[0].effect
        (proof,) = confirm(one.problem, forced(one, (effect,), (1,)), needed=1e9)
        assert proof.influential_pose == pose
        (proof,) = confirm(wave.problem, forced(wave, (effect,), (1,)), needed=1e9)
        assert proof.influential_pose is None

    def test_its_pose_is_left_out_and_told(self, null):
        pose = null.readings.pose[40]
        campaign = null.discovery.prepared.without_pose(
            pose, fault_of_influential_pose(pose, "an effect", 0.5)
        )
        assert pose not in campaign.trusted.pose
        (fault,) = campaign.faults
        assert fault.decides
        assert fault.where == f"pose {pose}"

    @pytest.mark.parametrize("rest_fits", [True, False])
    def test_it_is_wrong_only_if_the_rest_fits(self, rest_fits, wave, monkeypatch):
        pose, first = wave.readings.pose[40], wave.discovery
        (finding,) = first.findings
        carried = replace(
            finding, proof=finding.proof.model_copy(update={"influential_pose": pose})
        )
        unknown = Unexplained(of=None, form=None, shared_error_mm=0.1, why="no effect explains it")
        without = replace(first, findings=(), unexplained=() if rest_fits else (unknown,))
        answers = [replace(first, findings=(carried,)), without]
        looked_at = []

        def judged(campaign, *_):
            looked_at.append(campaign)
            return answers.pop(0)

        monkeypatch.setattr(search, "_judged", judged)
        monkeypatch.setattr(search, "gated", lambda found: found)
        for name in ("with_lines_named", "with_proposals"):
            monkeypatch.setattr(search, name, lambda found: found)
        found = search.discover(wave.readings, wave.baseline, wave.setup)
        assert [fault.where for fault in looked_at[1].faults] == [f"pose {pose}"]
        assert found.effects == ()
        if rest_fits:
            assert (found.train, found.faults) == (without.train, without.faults)
        else:
            assert (found.verdict, found.faults) == ("unexplained", ())
            withdrawn = found.unexplained[-1]
            assert f"pose {pose} alone carries it" in withdrawn.why
            # The error told of it is that without it.
            assert withdrawn.shared_error_mm > 2.0 * first.train.after.mean_mm

    def test_it_is_not_wrong_where_the_rest_is_too_small_to_be_judged(self, wave, monkeypatch):
        pose, first = wave.readings.pose[40], wave.discovery
        (finding,) = first.findings
        proof = finding.proof.model_copy(update={"influential_pose": pose})
        carried = replace(first, findings=(replace(finding, proof=proof),))
        few = search.not_sought(first.prepared, wave.baseline, search.HAS_MAPS)
        monkeypatch.setattr(search, "_judged", lambda *_: few)
        found = search._without_influential_poses(carried, wave.baseline)
        assert (found.effects, found.faults) == ((), ())
        assert f"pose {pose} alone carries it" in found.unexplained[-1].why

    def test_it_is_right_where_others_show_the_effect_as_well(self, wave, monkeypatch):
        first, (finding,) = wave.discovery, wave.discovery.findings
        pose = wave.readings.pose[40]
        proof = finding.proof.model_copy(update={"influential_pose": pose})
        carried = replace(first, findings=(replace(finding, proof=proof),))
        monkeypatch.setattr(search, "_judged", lambda *_: first)
        found = search._without_influential_poses(carried, wave.baseline)
        assert (found.effects, found.faults) == (carried.effects, ())

    def test_names_that_further_poses_carry_are_withdrawn(self, wave, monkeypatch):
        """So many poses are left out and no more; then the next name does not rest on one."""
        first, (finding,) = wave.discovery, wave.discovery.findings
        poses = iter(np.unique(wave.readings.pose))

        def judged(campaign, *_):
            proof = finding.proof.model_copy(update={"influential_pose": str(next(poses))})
            carried = replace(finding, proof=proof)
            return replace(first, prepared=campaign, findings=(carried,), unexplained=())

        monkeypatch.setattr(search, "_judged", judged)
        found = search._without_influential_poses(first, wave.baseline)
        assert found.effects == first.effects  # no pose carries what was found first
        found = search._without_influential_poses(judged(first.prepared), wave.baseline)
        assert len(found.faults) == JUDGING.most_carriers
        assert found.effects == ()
        assert "alone carries it" in found.unexplained[-1].why


# Which readings have a gross error.

WRONG_M = [0.0, 0.0, 8e-3]


@pytest.fixture(scope="module")
def survey():
    return observe(poses=120, held_out=0)


@pytest.fixture(scope="module")
def thrice(survey):
    """Each pose read three times, with the scatter of single readings."""
    poses = survey.survey.poses
    readings = poses.take(np.repeat(np.arange(len(poses)), 3))
    noise_m = np.random.default_rng(1).standard_normal((len(readings), 3))
    return shifted(readings, 2e-5 * noise_m)


def accused(survey, readings):
    return np.flatnonzero(gross_errors(readings, survey.baseline).accused).tolist()


def test_of_sound_readings_none_is_suspected(survey, thrice):
    assert not gross_errors(thrice, survey.baseline).excluded.any()
    assert accused(survey, thrice) == []


def test_a_reading_that_no_other_of_its_pose_confirms_is_suspected(survey, thrice, monkeypatch):
    assert accused(survey, shifted(thrice, WRONG_M, [7, 100])) == [7, 100]
    # Of two readings the one far from the model; and of a pose read once.
    pairs = thrice.take(np.arange(len(thrice)) % 3 < 2)
    assert accused(survey, shifted(pairs, WRONG_M, [9])) == [9]
    assert accused(survey, shifted(survey.survey.poses, WRONG_M, [5])) == [5]
    # Touched balls are judged by their repeats as all else is.
    monkeypatch.setattr(type(thrice.measured), "from_touches", Touched.from_touches)
    assert accused(survey, shifted(thrice, WRONG_M, [7])) == [7]


def seen_elsewhere(readings, shift_m, turn_rad, rows=slice(None)):
    """Return readings of which some are shifted, by (P, 3), and turned, by small angles (P, 3)."""
    T = readings.measured.T_instr_target.copy()
    turn = Rotation.from_rotvec(turn_rad + np.zeros((len(T[rows]), 3))).as_matrix()
    T[rows, :3, :3] = turn @ T[rows, :3, :3]
    return shifted(readings.with_measured(T_instr_target=T), shift_m, rows)


def far_held_out(survey, readings, held_out):
    """Return which held-out readings are far from their prediction."""
    far, _ = far_from_prediction(held_out, survey.baseline, readings)
    return np.flatnonzero(far).tolist()


def test_a_camera_s_depth_does_not_hide_what_is_far_off_across(survey):
    poses = survey.survey.poses
    depth_m = np.random.default_rng(3).standard_normal((2, len(poses), 1)) * [0.0, 0.0, 2e-3]
    fitted, held_out = shifted(poses, depth_m[0]), shifted(poses, depth_m[1])
    assert far_held_out(survey, fitted, held_out) == []
    assert far_held_out(survey, fitted, shifted(held_out, [0.01, 0.0, 0.0], [7])) == [7]
    # What is far for the scatter across is none beside that of the depth, and neither is a depth
    # that is off as depths are.
    assert far_held_out(survey, fitted, shifted(held_out, [2e-3, 0.0, 0.0], [7])) == []
    assert far_held_out(survey, fitted, shifted(held_out, [0.0, 0.0, 5e-3], [7])) == []


def test_position_and_orientation_that_are_both_far_off_show_a_wrong_reading(survey):
    poses, rng = survey.survey.poses, np.random.default_rng(4)
    heavy = rng.standard_t(4, (4, len(poses), 3))
    fitted = seen_elsewhere(poses, 1e-4 * heavy[0], 1e-3 * heavy[1])
    held_out = seen_elsewhere(poses, 1e-4 * heavy[2], 1e-3 * heavy[3])
    assert far_held_out(survey, fitted, held_out) == []
    off_m, off_rad = np.array([6e-3, 0.0, 0.0]), np.array([0.0, 0.06, 0.0])
    nothing = np.zeros(3)
    for shift_m, turn_rad, far in (
        (off_m, nothing, []),
        (nothing, off_rad, []),
        (off_m, off_rad, [7]),
    ):
        wrong = seen_elsewhere(held_out, shift_m, turn_rad, [7])
        assert far_held_out(survey, fitted, wrong) == far


def test_readings_that_agree_are_what_the_model_lacks(survey, thrice):
    found = gross_errors(shifted(thrice, WRONG_M, [30, 31, 32]), survey.baseline)
    assert not found.excluded.any()


def test_an_error_of_ten_times_the_scatter_of_repeats_is_found(survey, thrice):
    found = gross_errors(shifted(thrice, [2.5e-4, 0.0, 0.0], 50), survey.baseline)
    np.testing.assert_array_equal(np.flatnonzero(found.excluded), [50])
    off_mm = 1e3 * np.linalg.norm(found.apart[50, :3])
    assert off_mm == pytest.approx(0.25, abs=0.08)
    assert off_in_words(thrice.measured, found.apart[50], found.white[50]) == f"{off_mm:.3g} mm off"


def test_what_is_within_the_stated_uncertainty_is_no_gross_error(survey, thrice):
    off = shifted(thrice, [2.5e-4, 0.0, 0.0], 50)
    assert gross_errors(off, survey.baseline).excluded.any()
    stated = np.diagonal(off.measured.cov, axis1=1, axis2=2)[0]
    wider = (5e-4**2 / stated[0]) * off.measured.cov
    assert not gross_errors(off.with_measured(cov=wider), survey.baseline).excluded.any()


def test_heavy_tails_are_not_called_wrong(survey, thrice):
    heavy_m = np.random.default_rng(2).standard_t(3, (len(thrice), 3))
    found = gross_errors(shifted(thrice, 4e-5 * heavy_m), survey.baseline)
    assert not found.accused.any()
    assert 0 < found.excluded.sum() < 0.1 * len(thrice)


def test_readings_left_out_that_are_only_suspected_are_named(survey, thrice):
    heavy_m = np.random.default_rng(2).standard_t(3, (len(thrice), 3))
    found = row_faults(shifted(thrice, 4e-5 * heavy_m), survey.baseline, None, "none")
    assert found.faults == ()
    rows = np.flatnonzero(found.excluded)
    load_N = thrice.states.load_N
    assert [each.where for each in found.suspected] == [
        f"pose {thrice.pose[row]}, {load_N[row]:g} N, repeat {thrice.repeat[row]}" for row in rows
    ]
    assert all(" off, " in each.what for each in found.suspected)
    assert len(rows) > 0


@pytest.mark.parametrize("course", ["step", "warm-up"])
def test_readings_before_and_after_a_zero_that_moved_are_right(survey, thrice, course):
    """Repeats disagree, by the zero of a joint that moved once, or slowly."""
    part = (np.arange(len(thrice)) % 3 + np.arange(len(thrice)) / len(thrice)) / 3.0
    moved_rad = 6e-4 * (part > 0.5 if course == "step" else np.exp(-part / 0.2))
    q_rad = thrice.states.q_rad.copy()
    q_rad[:, 1] -= moved_rad  # not logged
    off = thrice.with_states(replace(thrice.states, q_rad=q_rad, time_s=1e4 * part))
    T, rng = off.measured.T_instr_target.copy(), np.random.default_rng(3)
    turn_rad = rng.normal(0.0, 1e-4, (len(off), 3))  # the noise that is stated
    T[:, :3, :3] = Rotation.from_rotvec(turn_rad).as_matrix() @ T[:, :3, :3]
    off = off.with_measured(T_instr_target=T)
    assert not gross_errors(off, survey.baseline).excluded.any()
    wrong = gross_errors(shifted(off, WRONG_M, [50]), survey.baseline)
    np.testing.assert_array_equal(np.flatnonzero(wrong.excluded), [50])


def test_readings_off_one_after_the_other_are_no_single_ones(survey, thrice):
    """As where the instrument stood elsewhere during the last pass over some of the poses."""
    time_s = np.arange(len(thrice)) % 3 * 1e4 + np.arange(len(thrice)) // 3
    thrice = thrice.with_states(replace(thrice.states, time_s=time_s.astype(float)))
    found = gross_errors(shifted(thrice, WRONG_M, np.arange(2, 45, 3)), survey.baseline)
    assert found.excluded.sum() < 10
    assert not found.accused.any()


@pytest.mark.parametrize(
    ("joints", "times", "are_right"), [([2], 1.0, True), ([2], 5.0, False), ([0, 2], 1.0, False)]
)
def test_readings_off_by_what_one_joint_moved_are_right(survey, thrice, joints, times, are_right):
    """As where it rests now at one side of its lost motion and now at the other."""
    rows = np.arange(4, 360, 30)
    moved_rad = np.tile([4e-4, -4e-4], 6) * np.where(np.arange(12) == 5, times, 1.0)
    q_rad = thrice.states.q_rad.copy()
    q_rad[rows, np.resize(joints, 12)] -= moved_rad  # not logged
    found = gross_errors(thrice.with_states(replace(thrice.states, q_rad=q_rad)), survey.baseline)
    assert found.excluded.any() != are_right
