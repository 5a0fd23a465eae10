"""What is offered as a remedy leaves little enough; what leaves more is called still wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_sightings import sighted
from mended import findings
from pa10cal.arm.chain import Chain
from pa10cal.arm.coupling import CoupledJoint
from pa10cal.campaign.conventions import (
    EXPECTED_M,
    STILL_WRONG,
    TIMES_EXPECTED,
    TIMES_NOISE,
    better_convention,
    other_axes,
    puts_right,
    read_polar,
)
from pa10cal.campaign.joint_conventions import coupling_that_fits
from pa10cal.campaign.own_columns import RotationColumns
from pa10cal.campaign.raw_file import quaternions
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import Pa10calError
from pa10cal.files.arms import load_arm
from pa10cal.observe.points import Points


@pytest.mark.parametrize(
    ("left", "expected", "noise", "right"),
    [
        (TIMES_EXPECTED * 0.99, 1.0, np.inf, True),
        (TIMES_EXPECTED * 1.01, 1.0, np.inf, False),
        (TIMES_NOISE * 0.99, 100.0, 1.0, True),
        (TIMES_NOISE * 1.01, 100.0, 1.0, False),
        (TIMES_NOISE * 0.99, 1.0, 1.0, False),
    ],
)
def test_both_bounds_are_kept(left, expected, noise, right):
    assert puts_right(left, expected, noise) is right


def changed(raw, names, new) -> None:
    """Rewrite columns of every row: `new` takes and returns their numbers, and has the row."""
    at = [raw.column(name) for name in names]
    for k, line in enumerate(raw.poses[1:]):
        row = line.split(",")
        for j, value in zip(at, new(np.array([float(row[j]) for j in at]), k), strict=True):
            row[j] = f"{value:.9f}"
        raw.poses[k + 1] = ",".join(row)


PLACE = ["x_mm", "y_mm", "z_mm"]


def scattered(size_mm: float):
    """Return errors of every row of about this median size."""
    drawn = np.random.default_rng(1).normal(size=(40, 3))
    drawn *= size_mm / np.median(np.linalg.norm(drawn, axis=1))
    return drawn


@pytest.mark.parametrize(("part", "right"), [(0.7, True), (1.4, False)])
def test_axes_are_offered_where_they_leave_what_is_expected(tmp_path, part, right):
    """Mirrored, and with errors under and over five times what is expected of a nominal arm."""
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    errors = scattered(1e3 * TIMES_EXPECTED * EXPECTED_M * part)
    changed(raw, PLACE, lambda p, k: (p + errors[k]) * [1, -1, 1])
    if right:
        with pytest.raises(Pa10calError, match="turn the sign of y_mm"):
            read_campaign(raw.write())
        return
    (warning,) = [each for each in read_campaign(raw.write()).warnings if "axes" in each]
    assert STILL_WRONG in warning
    assert "turn the sign" not in warning


def test_axes_of_a_mirrored_frame_are_found_by_two_fits():
    rng = np.random.default_rng(3)
    T = Chain.of(load_arm("ur10")).forward(rng.uniform(-1.5, 1.5, (40, 6)))
    R = Rotation.random(random_state=rng).as_matrix()
    p_m = T[:, :3, 3] @ R.T + [0.4, -1.0, 2.0]
    found = other_axes(T, p_m[:, [1, 0, 2]] * [1, 1, -1], R @ T[:, :3, :3])
    assert found is not None
    assert found.name == "y, x, -z in place of x, y, z"
    assert (found.order, found.turned) == ((1, 0, 2), (2,))
    assert other_axes(T, p_m, R @ T[:, :3, :3]) is None


def test_one_gross_reading_hides_neither_axes_nor_a_coupling():
    rng = np.random.default_rng(3)
    arm, axes = load_arm("ur10"), rng.uniform(-1.5, 1.5, (40, 6))
    coupled = (CoupledJoint(5, 4, -1.0),)
    R = Rotation.random(random_state=rng).as_matrix()
    T = Chain.of(arm).forward(axes)
    p_m = T[:, :3, 3] @ R.T + [0.4, -1.0, 2.0]
    p_m[7] += [0.0, 0.5, 0.0]
    found = other_axes(T, p_m * [1, 1, -1], R @ T[:, :3, :3])
    assert found is not None
    assert found.puts_right
    assert found.would_leave_m < 1e-4
    T = Chain.of(arm).forward(replace(arm.coupling, joints=coupled).to_joints(axes))
    seen_m = T[:, :3, 3] + T[:, :3, :3] @ [0.1, 0.0, 0.1]
    seen_m[7, 1] += 0.5
    cov_m2 = np.tile(1e-8 * np.eye(3), (40, 1, 1, 1))
    measured = Points(("t",), seen_m[:, None], cov_m2, None)
    fits = coupling_that_fits(arm, axes, measured)
    assert fits is not None
    assert fits[0] == coupled


@pytest.mark.parametrize("gross", [(), (7,), (3, 11, 20, 31)])
def test_gross_orientations_hide_neither_axes_nor_a_convention(gross):
    rng = np.random.default_rng(3)
    T = Chain.of(load_arm("ur10")).forward(rng.uniform(-1.5, 1.5, (40, 6)))
    base, tool, *others = Rotation.random(2 + len(gross), random_state=rng).as_matrix()
    R, p_m = base @ T[:, :3, :3] @ tool, T[:, :3, 3] @ base.T + [0.4, -1.0, 2.0]
    for row, other in zip(gross, others, strict=True):
        R[row] = other
    found = other_axes(T, p_m * [1, -1, 1], R)
    assert found is not None
    assert found.name == "x, -y, z in place of x, y, z"
    angles = Rotation.from_matrix(R).as_euler("ZYX", degrees=True)
    read = RotationColumns(names=("a", "b", "c"), convention="euler_XYZ", unit="deg")
    seen = np.tile(np.eye(4), (40, 1, 1))
    seen[:, :3, 3] = p_m
    seen[:, :3, :3] = R
    assert better_convention(T, seen, read.model_copy(update={"convention": "euler_ZYX"})) is None
    seen[:, :3, :3] = Rotation.from_quat(quaternions(angles, read), scalar_first=True).as_matrix()
    seen[9, :3, 3] += [0.0, 50.0, 0.0]  # one position, of another place altogether
    other = better_convention(T, seen, read, "rotation")
    assert other is not None
    assert other.remedy == "set rotation.convention: euler_ZYX"


def test_orientations_drawn_at_random_are_in_no_convention():
    rng = np.random.default_rng(3)
    T = Chain.of(load_arm("ur10")).forward(rng.uniform(-1.5, 1.5, (40, 6)))
    seen = T.copy()
    seen[:, :3, :3] = Rotation.random(40, random_state=rng).as_matrix()
    assert better_convention(T, seen) is None
    assert other_axes(T, seen[:, :3, 3] * [1, -1, 1], seen[:, :3, :3]) is None


def test_rows_in_which_nothing_was_seen_say_nothing_of_units():
    rng = np.random.default_rng(3)
    T = Chain.of(load_arm("ur10")).forward(rng.uniform(-1.5, 1.5, (40, 6)))
    p_m = T[:, :3, 3] + [3.0, 0.5, -0.2]
    d_m = np.linalg.norm(p_m, axis=1)
    hz, v = -np.arctan2(p_m[:, 1], p_m[:, 0]), np.arccos(p_m[:, 2] / d_m)
    values = np.column_stack([hz, v, 1e3 * d_m])
    values[:22] = 0.0
    values[30] = [-9999.0, -9999.0, -9999.0]
    for T_known in (None, T):
        found = read_polar(values, ["deg", "rad", "gon", "mrad"], None, T_known, by_horizon=False)
        assert (found.polar.unit, found.length) == ("rad", "mm")
    nowhere = read_polar(np.zeros((40, 3)), ["deg"], None, T, by_horizon=False)
    assert (nowhere.polar.unit, nowhere.median_m) == ("deg", None)


def test_polar_readings_count_otherwise_than_named_only_where_the_arm_is_much_nearer():
    rng = np.random.default_rng(3)
    T = Chain.of(load_arm("ur10")).forward(rng.uniform(-1.5, 1.5, (40, 6)))
    p_m = T[:, :3, 3] + [3.0, 0.5, -0.2]
    d_m = np.linalg.norm(p_m, axis=1)
    hz, v = np.arctan2(p_m[:, 1], p_m[:, 0]), np.arcsin(p_m[:, 2] / d_m)
    values = np.column_stack([hz % (2.0 * np.pi) * 200.0 / np.pi, v * 200.0 / np.pi, d_m])
    values[::5] = 0.0  # nothing was seen
    given = (["deg", "gon"], "m")
    found = read_polar(values, *given, T, by_horizon=False)
    counted = found.polar.unit, found.polar.horizontal, found.polar.vertical
    assert counted == ("gon", "counterclockwise", "horizon")
    assert found.median_m == pytest.approx(0.0, abs=1e-6)
    of_other_rows = read_polar(values, *given, T[rng.permutation(40)], by_horizon=False)
    counted = of_other_rows.polar.horizontal, of_other_rows.polar.vertical
    assert counted == ("clockwise", "zenith")


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(("times_noise", "right"), [(6.0, True), (60.0, False)])
def test_a_sign_is_offered_where_it_leaves_what_the_noise_explains(tmp_path, times_noise, right):
    """A reversed joint in readings that err by less, and by more, than 20 times their noise."""
    raw = sighted(tmp_path, "pose", poses=60, noise_mm=0.0)
    stated_mm = raw.description["instrument"]["uncertainty_mm"]
    drawn = np.random.default_rng(1).normal(0.0, times_noise * stated_mm, (60, 3))
    changed(raw, PLACE, lambda p, k: p + drawn[k])
    changed(raw, ["q2_deg"], lambda q, _: -q)
    (found,) = findings(raw.write())
    assert (found.kind, found.where) == ("joint_sign", "q2")
    assert (STILL_WRONG in found.what) is not right
    assert ("set joint_signs: [1, -1, 1, 1, 1, 1]" in found.remedy) is right


def test_signs_that_are_stated_already_are_taken_along(tmp_path):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    changed(raw, ["q5_deg"], lambda q, _: -q)
    raw.description |= {"joint_signs": [1, -1, 1, 1, 1, 1], "joint_offsets_deg": [0, 0, 0, 0, 7, 0]}
    changed(raw, ["q2_deg"], lambda q, _: -q)
    changed(raw, ["q5_deg"], lambda q, _: q - 7.0)
    (found,) = findings(raw.write())
    assert "set joint_signs: [1, -1, 1, 1, -1, 1]" in found.remedy
    assert "set joint_offsets_deg: [0, 0, 0, 0, -7, 0]" in found.remedy
