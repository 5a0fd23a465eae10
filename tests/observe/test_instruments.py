"""Laws that every kind of instrument keeps: derivatives, columns, averages, starts."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from made_up_poses import frames
from pa10cal.arrays import take_rows
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.observe.base_targets import BaseTargets, Knocked, Misread
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.joined import Joined
from pa10cal.observe.kinds import instruments
from pa10cal.observe.points import Distance, Points
from pa10cal.observe.pose import Pose, Touched
from pa10cal.observe.quantities import StatedByCampaign, columns_of_covariance, covariance_of
from pa10cal.settings_reading import parse_section
from pa10cal_lab.cell.campaign import instrument_kinds, instrument_of, robot_of
from pa10cal_lab.cell.instruments.instrument import Truth
from pa10cal_lab.cell.options import SimulateOptions

KINDS = tuple(instruments())
TARGETS_M = np.array([[0.04, -0.03, 0.11], [-0.06, 0.02, 0.09], [0.01, 0.07, 0.05]])
seeds = st.integers(0, 2**32 - 1)


def about(T, turns_rad, shifts_m):
    """Move frames by a small rotation on the left and a shift."""
    moved = T.copy()
    moved[:, :3, :3] = Rotation.from_rotvec(turns_rad).as_matrix() @ T[:, :3, :3]
    moved[:, :3, 3] += shifts_m
    return moved


def measured(kind, T_instr_ee, rng, off=1e-3):
    """Return what an instrument measured about some poses, and the targets (t,) of its model."""
    count = len(T_instr_ee)
    seen = about(T_instr_ee, off * rng.normal(size=(count, 3)), off * rng.normal(size=(count, 3)))
    cov = 1e-10 * np.array([np.diag(rng.uniform(1, 2, 6)) for _ in range(count)])
    p_m = seen[:, None, :3, 3] + np.einsum("pij,bj->pbi", seen[:, :3, :3], TARGETS_M)
    cov_m2 = 1e-10 * rng.uniform(1, 2, (count, 3))[..., None, None] * np.eye(3)
    if kind == "pose":
        return Pose.of(seen, cov), np.zeros(0)
    if kind == "touch_trigger_cmm":
        touches = rng.integers(4, 7, (count, 3))
        found = Touched.of_balls(("A", "B", "C"), 1e3 * TARGETS_M, 1e3 * p_m, 1e6 * cov_m2, touches)
        return found, np.zeros(0)
    if kind == "points":
        hidden = rng.random((count, 3)) < 0.2
        hidden[:, 0] = False
        p_m[hidden], cov_m2[hidden] = np.nan, np.nan
        return Points(("T1", "T2", "T3"), p_m, cov_m2, None), TARGETS_M.ravel()
    if kind == "distance":
        u_m = 1e-5 * rng.uniform(1, 2, count)
        return Distance(np.linalg.norm(p_m[:, 0], axis=1), u_m), TARGETS_M[0]
    return simulated(kind, seen, rng)


def simulated(kind, T_instr_ee, rng):
    """Return what the virtual cell reads of some poses, hardly with noise, and the targets (t,)."""
    plan = {"instrument": kind, "position_mm": 1e-5, "attitude_rad": 1e-8}
    settings = parse_section(SimulateOptions, {"robot": "ur10", "without_touches": plan}, where="")
    cell = instrument_of(settings)
    robot = replace(robot_of(load_arm("ur10"), settings), T_instr_base=np.eye(4))
    rest = SimpleNamespace(T_base_ee=T_instr_ee)
    poses = range(len(T_instr_ee))
    truth = Truth(robot, (), None, poses, np.zeros(0), rest, np.zeros(0))
    read = cell.readings(truth, dict.fromkeys(cell.streams, rng))
    columns = instruments()[kind].raw_columns(list(read))
    values, u = (
        np.column_stack([read[name][k] + np.zeros(len(poses)) for name in columns.names])
        for k in (0, 1)
    )
    found = instruments()[kind].from_raw(columns, values, u, StatedByCampaign(1e-8, {}))
    return found, robot.targets.p_ee_m.ravel()[: len(found.target_parameters)]


def test_every_kind_is_registered_by_its_word_and_simulated():
    assert {"touch_trigger_cmm", "pose", "points", "distance"} <= set(KINDS)
    assert all(found.kind == kind for kind, found in instruments().items())
    assert set(instrument_kinds()) == set(KINDS)


@pytest.mark.parametrize("kind", KINDS)
@given(seed=seeds)
@examples(15)
def test_derivatives_are_those_of_the_residual(kind, seed):
    rng = np.random.default_rng(seed)
    T = frames(rng, 6)
    found, targets_m = measured(kind, T, rng)
    at = found.compare(T, targets_m)
    twist, shift = 1e-6 * rng.normal(size=(2, 6, 3))
    ahead = found.compare(about(T, twist, shift), targets_m).residual
    behind = found.compare(about(T, -twist, -shift), targets_m).residual
    expected = np.einsum("pbi,pi->pb", at.by_end, np.hstack([shift, twist]))
    np.testing.assert_allclose(0.5 * (ahead - behind), expected, atol=2e-11)
    if len(targets_m):
        step = 1e-6 * rng.normal(size=len(targets_m))
        ahead = found.compare(T, targets_m + step).residual
        behind = found.compare(T, targets_m - step).residual
        np.testing.assert_allclose(0.5 * (ahead - behind), at.by_targets @ step, atol=2e-11)
    assert at.residual.shape == found.components_seen.shape
    assert not at.residual[~found.components_seen].any()


@pytest.mark.parametrize("kind", KINDS)
def test_ideal_measurements_leave_no_residual_and_no_deviation(kind):
    rng = np.random.default_rng(3)
    T, T_instr_base = frames(rng, 5), frames(rng, 1)[0]
    found, targets_m = measured(kind, T_instr_base @ T, rng)
    ideal = found.ideal(T_instr_base @ T, targets_m)
    np.testing.assert_allclose(ideal.compare(T_instr_base @ T, targets_m).residual, 0.0, atol=1e-12)
    off = ideal.deviations(T, T_instr_base, targets_m)
    np.testing.assert_allclose(off.distance_mm, 0.0, atol=1e-9)
    assert (off.rotation_deg is None) != found.measures_pose


@pytest.mark.parametrize("kind", KINDS)
@given(seed=seeds)
@examples(10)
def test_columns_of_the_table_bring_everything_back(kind, seed):
    rng = np.random.default_rng(seed)
    found, _ = measured(kind, frames(rng, 5), rng)
    columns = found.to_columns() | {"time_s": np.arange(5.0)}
    stated = StatedByCampaign(1e-5, dict(zip("ABC", TARGETS_M, strict=True)))
    assert_same(type(found).from_columns(columns, stated), found)


def assert_same(back, found):
    for field in fields(found):
        ours, theirs = getattr(found, field.name), getattr(back, field.name)
        if isinstance(ours, np.ndarray):
            np.testing.assert_allclose(theirs, ours, rtol=1e-7, atol=1e-15)
        elif isinstance(ours, Points):
            assert_same(theirs, ours)
        else:
            assert ours == theirs


@pytest.mark.parametrize("kind", KINDS)
def test_readings_alike_average_to_themselves_with_less_variance(kind):
    rng = np.random.default_rng(5)
    found, _ = measured(kind, frames(rng, 4), rng)
    mean = found.take(np.repeat(np.arange(4), 3)).averaged(np.repeat(np.arange(4), 3))
    np.testing.assert_allclose(mean.places_m, found.places_m, rtol=1e-12)
    seen = found.components_seen
    variances = np.diagonal(found.stated_covariance, axis1=1, axis2=2)[seen]
    np.testing.assert_allclose(
        3.0 * np.diagonal(mean.stated_covariance, axis1=1, axis2=2)[seen], variances
    )


@pytest.mark.parametrize("kind", KINDS)
def test_base_and_targets_are_found_from_poses(kind):
    rng = np.random.default_rng(7)
    T_base_ee, T_instr_base = frames(rng, 60), frames(rng, 1, 2.0)[0]
    found, targets_m = measured(kind, T_instr_base @ T_base_ee, rng, off=0.0)
    start = found.find_start(T_base_ee)
    off = found.turned(start.R_ee_target).deviations(T_base_ee, start.T_instr_base, start.targets_m)
    np.testing.assert_allclose(off.distance_mm, 0.0, atol=1e-3)
    np.testing.assert_allclose(start.targets_m, targets_m, atol=1e-6)
    if found.directional:
        at = found.compare(T_instr_base @ T_base_ee, targets_m)
        along = np.any(at.by_end[:, :, :3], axis=(0, 1))  # shifts along other axes do not show
        off_m = (start.T_instr_base - T_instr_base)[:3, 3]
        np.testing.assert_allclose(off_m[along], 0.0, atol=1e-6)
        np.testing.assert_allclose(start.T_instr_base[:3, :3], T_instr_base[:3, :3], atol=1e-6)
    assert found.misfit(T_base_ee, np.arange(60), np.ones(60)).size_m[0] < 1e-6
    assert found.scale(T_base_ee) == pytest.approx(1.0, rel=0.01)


def test_targets_stand_in_the_order_of_their_names_not_of_their_columns():
    header = [f"{name}_{axis}_mm" for name in ("T10", "T2", "T1") for axis in "zyx"]
    columns = instruments()["points"].raw_columns(header)
    assert [names[0] for names in columns.targets] == ["T1_x_mm", "T2_x_mm", "T10_x_mm"]


def test_a_target_on_the_tool_that_is_called_like_the_base_is_none_on_the_base():
    names = ("base1", "base2", "base3")
    base = BaseTargets.read(names, np.zeros((4, 3, 3)), np.full((4, 3, 3), 1e-5))
    of_tool = {f"baseplate_{axis}_mm": np.ones(4) for axis in "xyz"}
    back = BaseTargets.from_columns({**of_tool, **base.to_columns()}, None)
    assert back.names == names


@pytest.mark.parametrize("kind", [*instruments().values(), Joined])
def test_whatever_differs_between_instruments_is_a_method_of_their_base(kind):
    own = {name for base in kind.__mro__ for name in vars(base) if not name.startswith("_")}
    fields_and_makers = {*kind.__dataclass_fields__, "of", "of_balls"}
    assert own - {*vars(Instrument)} - fields_and_makers == set()


def test_what_repeats_write_with_too_few_digits_shows_no_noise():
    """But copied readings, equal in everything, are not excused so."""
    rng = np.random.default_rng(0)
    pose, _ = measured("pose", frames(rng, 12), rng)
    difference, seen = 1e-4 * rng.normal(size=(12, 6)), np.ones((12, 6), dtype=bool)
    assert pose.rounded_kinds(difference, seen) == ()
    difference[:, 3:] = 0.0
    assert pose.rounded_kinds(difference, seen) == ("attitude",)
    assert pose.rounded_kinds(0.0 * difference, seen) == ()


def test_covariances_in_columns_may_have_labels_in_any_order():
    root = np.random.default_rng(1).standard_normal((4, 3, 3))
    cov = root @ root.transpose(0, 2, 1)
    labelled = "cov_{}_{}", "zxy", np.array([1e-3, 1.0, 2.0])
    assert np.allclose(covariance_of(columns_of_covariance(cov, *labelled), *labelled), cov)


@pytest.mark.parametrize("moves_m", [0.0, 0.3])
def test_positions_spread_by_what_the_arm_moves_not_by_what_is_between_targets(moves_m):
    p_m = np.zeros((40, 3, 3))
    p_m[:, 1, 0] = 1.0
    p_m[:, :, 2] += moves_m * np.resize([-1.0, 1.0], 40)[:, None]
    p_m[:10, 1] = p_m[:, 2] = np.nan  # one is seen at times, one never
    points = Points(("a", "b", "c"), p_m, np.full((40, 3, 3, 3), np.nan), None)
    assert points.spread_mm == pytest.approx(1e3 * moves_m)


@dataclass(frozen=True)
class _WithOneNumber:
    off_m: np.ndarray
    total: object


@pytest.mark.parametrize("total", [np.float64(3.0), np.array(3.0), 3.0, "three"])
def test_what_has_no_rows_is_named(total):
    record = _WithOneNumber(np.arange(4.0), total)
    with pytest.raises(TypeError, match="total of _WithOneNumber has no rows"):
        take_rows(record, np.array([0, 2]))
    assert take_rows(record, np.array([0, 2]), "total").off_m.tolist() == [0.0, 2.0]


def test_what_base_targets_did_is_told_in_full():
    knocked = Knocked(("base1",), "p7", 1714380123.0, 0.2)
    assert str(knocked).endswith("before pose p7 (1714380123 s)")
    assert "1230 mm off" in str(Misread("base1", 1, "p7", 1234.0))


def test_what_changes_a_touched_pose_changes_its_balls():
    rng = np.random.default_rng(3)
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, :3, 3] = rng.uniform(-1.0, 1.0, (5, 3))
    touched, _ = measured("touch_trigger_cmm", T, rng)
    scaled = touched.scaled(1e3)
    np.testing.assert_allclose(scaled.balls.p_instr_m, 1e3 * touched.balls.p_instr_m)
    np.testing.assert_allclose(scaled.places_m, 1e3 * touched.places_m)
    times = np.repeat(rng.uniform(2.0, 5.0, (5, 1)), 6, axis=1)
    less_certain = touched.less_certain(times)
    np.testing.assert_allclose(less_certain.cov, touched.cov * times[:, :1, None])
    of_ball_m2 = less_certain.balls.cov_m2[:, 1]
    np.testing.assert_allclose(of_ball_m2, touched.balls.cov_m2[:, 1] * times[:, :1, None])
    motion_cov = np.tile(1e-8 * np.eye(6), (5, 1, 1))
    uncertain = touched.with_end_uncertain(motion_cov, touched.places_m)
    np.testing.assert_allclose(uncertain.balls.motion_cov, motion_cov)


def test_an_orientation_is_as_uncertain_as_is_stated():
    T, values = np.tile(np.eye(4), (2, 1, 1)), np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]] * 2)
    for stated_rad, expected_rad in ((None, 1e-3), (2e-5, 2e-5), (0.0, 0.0)):
        stated = StatedByCampaign(1e-4, {}, stated_rad)
        columns = Pose.raw_columns([])
        read = Pose.from_raw(columns, values, np.full((2, 7), np.nan), stated)
        for poses in (Pose.foreseen(T, stated), read):
            np.testing.assert_allclose(poses.cov[:, 3, 3], expected_rad**2)


def test_a_machine_without_balls_is_refused(recwarn):
    with pytest.raises(CalibrationError, match="these balls do not give an orientation"):
        Touched.foreseen(np.eye(4)[None], StatedByCampaign(1e-4, {}))
    assert not recwarn.list


def test_base_targets_without_their_places_are_refused_by_column():
    motion = {f"motion_{name}": np.zeros(2) for name in ("x_mm", "y_mm", "z_mm")}
    with pytest.raises(KeyError, match="base1_x_mm"):
        BaseTargets.from_columns(motion, None)
