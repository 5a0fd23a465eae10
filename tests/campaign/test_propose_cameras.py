"""Poses as software of cameras and six-degree-of-freedom instruments writes them."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

from made_up_sightings import is_read, sighted
from pa10cal.arm.chain import Chain
from pa10cal.campaign.matrices import matrix_columns, rotation_columns
from pa10cal.campaign.nominal_fit import off_computed_m
from pa10cal.campaign.own_columns import FileColumns
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.recognise import roles_of
from pa10cal.files.arms import load_arm

JOINTS = [f"j{k}" for k in range(1, 7)]


def with_joints(raw, names, *values):
    """Return a table of joints [deg] and further columns."""
    return pd.DataFrame(np.hstack([np.degrees(raw.q), *values]), columns=[*JOINTS, *names])


def vectors(T):
    """Return rotation vectors [rad] and places [m] of poses."""
    return Rotation.from_matrix(T[:, :3, :3]).as_rotvec(), T[:, :3, 3]


@pytest.mark.parametrize(
    ("rvec", "tvec"),
    [
        *(
            (f"rvec{a} rvec{b} rvec{c}", f"tvec{a} tvec{b} tvec{c}")
            for a, b, c in (
                *("xyz", "XYZ", "012", "123"),
                *(
                    ("_x", "_y", "_z"),
                    (".x", ".y", ".z"),
                    ("[0]", "[1]", "[2]"),
                    ("s_0", "s_1", "s_2"),
                ),
            )
        ),
        ("rx_vec ry_vec rz_vec", "tx_vec ty_vec tz_vec"),
        ("r_vec_1 r_vec_2 r_vec_3", "t_vec_1 t_vec_2 t_vec_3"),
        ("rotation_vector_x rotation_vector_y rotation_vector_z", "x y z"),
        ("rodrigues_0 rodrigues_1 rodrigues_2", "translation_0 translation_1 translation_2"),
        (
            "board_rvec_x_rad board_rvec_y_rad board_rvec_z_rad",
            "board_tvec_x_m board_tvec_y_m board_tvec_z_m",
        ),
    ],
)
def test_what_opencv_returns_is_a_rotation_vector_and_a_place(rvec, tvec):
    roles = roles_of([*JOINTS, *rvec.split(), *tvec.split()], 6)
    assert roles.joints == tuple(JOINTS)
    assert roles.attitude == (tuple(rvec.split()), "rotation_vector")
    assert list(roles.positions.values()) == [tuple(tvec.split())]


def test_a_camera_that_reports_rvec_and_tvec_is_read(tmp_path, proposed):
    raw = sighted(tmp_path, "pose")
    names = [f"{vector}{k}" for vector in ("rvec", "tvec") for k in range(3)]
    with_joints(raw, names, *vectors(raw.T_instr_target)).to_csv(tmp_path / "a.csv", index=False)
    out = proposed("a.csv")
    assert yaml.safe_load(out)["columns"]["poses"]["rotation"]["convention"] == "rotation_vector"
    is_read(read_campaign(tmp_path), raw.q, raw.T_instr_target)


def test_a_cameras_pose_is_read_beside_the_controllers_which_is_said(tmp_path, proposed):
    """x, y, z, rx, ry, rz are what the controller computes."""
    raw = sighted(tmp_path, "pose")
    tool = np.roll(raw.T_instr_target, 1, axis=0)
    names = [*"xyz", "rx", "ry", "rz", *(f"{v}_{axis}" for v in ("tvec", "rvec") for axis in "xyz")]
    (rotvec, place), (other_rotvec, other) = vectors(raw.T_instr_target), vectors(tool)
    table = with_joints(raw, names, other, other_rotvec, place, rotvec)
    table.to_csv(tmp_path / "a.csv", index=False)
    out = proposed("a.csv")
    assert "check position: tvec_x, tvec_y, tvec_z taken, of 2 triples" in out
    assert "rvec_z taken; rx, ry, rz seem to hold another orientation, which is not read" in out
    is_read(read_campaign(tmp_path), raw.q, raw.T_instr_target)


def computed_by_the_controller(raw, turn_deg=0.0):
    """Return the nominal flange (N, 4, 4) in its own base, turned about its axis, to 0.01 mm."""
    T = Chain.of(load_arm("ur10")).forward(raw.q)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()
    T = turn @ T
    T[:, :3, 3] = T[:, :3, 3].round(5)
    return T


@pytest.mark.parametrize(
    ("own", "others", "turn_deg"),
    [
        ("tcp_poses", "camera_poses", 0.0),
        pytest.param("T_base_ee", "T_cam_tag", 180.0, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("inverse", [False, True])
def test_matrices_that_the_controller_computes_are_no_readings(
    tmp_path, proposed, own, others, turn_deg, inverse
):
    """Files of hand-eye calibrations hold the controller's pose first, and then the camera's."""
    raw = sighted(tmp_path, "pose", noise_mm=0.3)
    seen = np.linalg.inv(raw.T_instr_target) if inverse else raw.T_instr_target
    of_arm = computed_by_the_controller(raw, turn_deg)
    np.savez(tmp_path / "a.npz", **{"joints": raw.q, own: of_arm, others: seen})
    out = proposed("a.npz")
    assert f"check position: {others}_14, {others}_24, {others}_34 taken, as {own}_14" in out
    columns = yaml.safe_load(out)["columns"]["poses"]
    assert columns["position"]["names"] == [f"{others}_{k}4" for k in (1, 2, 3)]
    assert columns["rotation"].get("inverse") == ("pose" if inverse else None)
    assert not any("computes" in warning for warning in read_campaign(tmp_path).warnings)


def test_columns_that_the_controller_computes_are_no_readings(tmp_path, proposed):
    """The letter T of the poses left out is no time."""
    raw = sighted(tmp_path, "pose", noise_mm=0.3)
    values = []
    for T in (computed_by_the_controller(raw), raw.T_instr_target):
        values += [T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_quat()]
    names = [
        f"{body}_{part}"
        for body in ("T_base_tool", "T_cam_tag")
        for part in ("x", "y", "z", "qx", "qy", "qz", "qw")
    ]
    with_joints(raw, names, *values).to_csv(tmp_path / "a.csv", index=False)
    out = proposed("a.csv")
    assert "check position: T_cam_tag_x, T_cam_tag_y, T_cam_tag_z taken, as T_base_tool_x" in out
    assert "time" not in yaml.safe_load(out)["columns"]["poses"]
    is_read(read_campaign(tmp_path), raw.q, raw.T_instr_target)


def test_the_unread_orientation_of_another_body_is_no_time():
    parts = ("x", "y", "z", "qx", "qy", "qz", "qw")
    names = [f"{body}_{part}" for body in ("T_cam_tag", "T_base_tool") for part in parts]
    assert "time" not in roles_of([*JOINTS, *names], 6).single
    assert roles_of([*JOINTS, *names, "t"], 6).single["time"] == "t"


@pytest.mark.parametrize("size", [1.0, 0.02])
def test_an_arm_that_is_built_well_for_its_size_is_no_computation(size):
    rng = np.random.default_rng(3)
    T = Chain.of(load_arm("ur10")).forward(rng.uniform(-1.5, 1.5, (40, 6)))
    T[:, :3, 3] *= size
    p_m = (T @ [0.02 * size, 0.03 * size, 0.05 * size, 1.0])[:, :3]
    for off, computed in ((1e-5, True), (1e-3, False)):
        found = off_computed_m(T, p_m + size * off * rng.normal(size=p_m.shape))
        assert (found is not None) == computed


def test_a_file_of_the_controllers_poses_alone_says_so(tmp_path, proposed):
    raw = sighted(tmp_path, "pose")
    T = computed_by_the_controller(raw)
    np.savez(tmp_path / "a.npz", joints=raw.q, tcp=T)
    assert "seem to be what a controller computes from the joints" in proposed("a.npz")
    (warning,) = read_campaign(tmp_path).warnings
    assert "what a controller computes from the joints is: they calibrate nothing" in warning


@pytest.mark.parametrize(
    ("names", "unit", "per_mm"),
    [
        ("x_dif y_dif z_dif", "", 1.0),
        ("dx dy dz", "", 1.0),
        pytest.param("\u0394X \u0394Y \u0394Z", "", 1.0, marks=pytest.mark.slow),
        ("dev_x_um dev_y_um dev_z_um", "um", 1e3),
    ],
)
def test_deviations_from_places_that_were_computed_are_added_to_them(
    tmp_path, proposed, names, unit, per_mm
):
    """A made-up log has where the controller was sent, and how far off a tracker saw it."""
    raw = sighted(tmp_path, "points")
    T = computed_by_the_controller(raw)
    stated_mm = 1e3 * T[:, :3, 3] + 1e3 * T[:, :3, :3] @ [0.0, 0.0, 0.03]
    off_mm = np.random.default_rng(3).normal(0.0, 2.0, (len(T), 3))
    columns = ["x_t", "y_t", "z_t", *names.split()]
    table = with_joints(raw, columns, stated_mm, per_mm * off_mm)
    table.to_csv(tmp_path / "a.csv", index=False)
    out = proposed("a.csv")
    assert f"so {', '.join(names.split())} are added" in out
    assert "deviation_sign: -1 if they are the reverse" in out
    described = yaml.safe_load(out)
    (place,) = described["columns"]["poses"]["targets"].values()
    assert place.get("deviation_unit", "") == unit
    for sign in (1, -1):
        place["deviation_sign"] = sign
        (tmp_path / "campaign.yaml").write_text(yaml.safe_dump(described))
        campaign = read_campaign(tmp_path)
        assert campaign.warnings == ()
        measured_mm = 1e3 * campaign.observations.measured.p_instr_m[:, 0]
        assert measured_mm == pytest.approx(stated_mm + sign * off_mm, abs=1e-6)


def test_a_deviation_that_is_no_number_is_told_by_its_own_column(tmp_path, proposed):
    raw = sighted(tmp_path, "points")
    T = computed_by_the_controller(raw)
    off_mm = np.random.default_rng(3).normal(0.0, 2.0, (len(T), 3))
    columns = ["x_t", "y_t", "z_t", "x_dif", "y_dif", "z_dif"]
    table = with_joints(raw, columns, 1e3 * T[:, :3, 3], off_mm).astype(object)
    table.loc[4, "y_dif"] = "lost"
    table.to_csv(tmp_path / "a.csv", index=False)
    proposed("a.csv")
    (row,) = read_campaign(tmp_path).quarantined
    assert (row.line, "lost" in row.value) == (6, True)


def test_deviations_beside_what_was_measured_are_not_added(tmp_path, proposed):
    raw = sighted(tmp_path, "points")
    seen_mm = 1e3 * raw.p_instr_m[:, 0]
    columns = ["x", "y", "z", "x_dif", "y_dif", "z_dif"]
    off_mm = np.random.default_rng(3).normal(0.0, 2.0, seen_mm.shape)
    with_joints(raw, columns, seen_mm, off_mm).to_csv(tmp_path / "a.csv", index=False)
    assert "deviation:" not in proposed("a.csv")


@pytest.mark.parametrize(
    "names",
    [
        "Q0 Qx Qy Qz Tx Ty Tz",
        pytest.param("q0 qx qy qz tx ty tz", marks=pytest.mark.slow),
        pytest.param("Qr Qi Qj Qk x y z", marks=pytest.mark.slow),
        pytest.param("att1 att2 att3 att4 Tx Ty Tz", id="by the numbers"),
    ],
)
def test_an_orientation_beside_a_place_is_read(tmp_path, proposed, names):
    raw = sighted(tmp_path, "pose")
    q = Rotation.from_matrix(raw.T_instr_target[:, :3, :3]).as_quat(scalar_first=True)
    table = with_joints(raw, names.split(), q, 1e3 * raw.T_instr_target[:, :3, 3])
    table.to_csv(tmp_path / "a.csv", index=False)
    out = proposed("a.csv")
    assert "which is not read" not in out
    assert yaml.safe_load(out)["columns"]["poses"]["rotation"]["names"] == names.split()[:4]
    is_read(read_campaign(tmp_path), raw.q, raw.T_instr_target)


@pytest.mark.parametrize("what", ["numbers", "words", "text", "none"])
def test_an_orientation_that_is_not_read_is_said(tmp_path, proposed, what):
    raw = sighted(tmp_path, "pose")
    place = 1e3 * raw.T_instr_target[:, :3, 3]
    table = with_joints(raw, ["x", "y", "z"], place)
    R = Rotation.from_matrix(raw.T_instr_target[:, :3, :3])
    said = {"numbers": "k1, k2, k3, k4", "words": "euler1, euler2, euler3", "text": "rvec"}
    if what == "numbers":
        table.insert(0, "frame", 0.3)
        for k, column in enumerate(R.as_quat().T):
            table.insert(k, f"k{k + 1}", column)
    elif what == "words":
        table[["euler1", "euler2", "euler3"]] = R.as_euler("zxz")
    elif what == "text":
        table["rvec"] = [str(vector) for vector in R.as_rotvec()]
    else:
        table[["quality", "residual", "level"]] = np.random.default_rng(1).random((len(place), 3))
    table.to_csv(tmp_path / "a.csv", index=False)
    out = proposed("a.csv")
    assert ("which is not read" in out) == (what != "none")
    assert f"check rotation: {said[what]} seem" in out if what in said else True


def test_a_matrix_is_one_though_the_target_was_not_seen_in_a_row():
    T = np.broadcast_to(np.eye(4), (20, 4, 4)).copy()
    T[:, :3, :3] = Rotation.random(20, rng=np.random.default_rng(1)).as_matrix()
    T[3] = np.nan
    nine, sixteen = [f"R{k}" for k in range(9)], [f"T{k}" for k in range(16)]
    assert rotation_columns(nine, T[:, :3, :3].reshape(20, 9)) == tuple(nine)
    assert [each.moves for each in matrix_columns(sixteen, T.reshape(20, 16))] == [True]


def test_numbers_in_brackets_may_be_those_of_a_quaternion(tmp_path, proposed):
    """And not of repeated names."""
    raw = sighted(tmp_path, "pose")
    q = Rotation.from_matrix(raw.T_instr_target[:, :3, :3]).as_quat()
    names = ["x", "y", "z", "level", *(f"rot ({k})" for k in range(1, 5))]
    level = np.full((len(q), 1), 0.3)
    table = with_joints(raw, names, 1e3 * raw.T_instr_target[:, :3, 3], level, q)
    table.to_csv(tmp_path / "a.csv", index=False)
    out = proposed("a.csv")
    assert "rot (1), rot (2), rot (3), rot (4) seem to hold an orientation" in out


def detection(tag, T):
    """Return what the binding of AprilTag returns for a tag at T."""
    place = T[:3, 3:].tolist()
    return {"tag_id": tag, "center": [640.0, 360.0], "pose_R": T[:3, :3].tolist(), "pose_t": place}


def detections(raw, found):
    """Return a record a line: joints, and what was detected at each pose of the target."""
    rows = zip(raw.q.tolist(), map(found, raw.T_instr_target), strict=True)
    return "\n".join(json.dumps({"joint_positions": q, "detections": each}) for q, each in rows)


def test_a_list_of_one_detected_tag_is_that_tag(tmp_path, proposed):
    raw = sighted(tmp_path, "pose")
    (tmp_path / "a.jsonl").write_text(detections(raw, lambda T: [detection(3, T)]))
    out = proposed("a.jsonl")
    names = yaml.safe_load(out)["columns"]["poses"]["position"]["names"]
    assert names == [f"detections.pose_t {axis}" for axis in "xyz"]
    is_read(read_campaign(tmp_path), raw.q, raw.T_instr_target)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("unseen", [[], None])
def test_where_no_tag_was_detected_the_row_has_no_reading(tmp_path, proposed, unseen):
    raw = sighted(tmp_path, "pose")
    seen = iter(range(len(raw.q)))
    text = detections(raw, lambda T: [detection(3, T)] if next(seen) % 10 else unseen)
    (tmp_path / "a.jsonl").write_text(text)
    proposed("a.jsonl")
    found = read_campaign(tmp_path)
    assert len(found.observations) == 36
    assert len(found.quarantined) == 4


def test_of_several_detected_tags_each_has_its_number(tmp_path, proposed):
    """In any order; the one that is read is the same in all rows."""
    raw = sighted(tmp_path, "pose")
    beside = np.eye(4)
    beside[0, 3] = 0.1
    order = iter(range(len(raw.q)))
    text = detections(
        raw, lambda T: [detection(3, T), detection(11, T @ beside)][:: 1 - 2 * (next(order) % 2)]
    )
    (tmp_path / "a.jsonl").write_text(text)
    out = proposed("a.jsonl")
    assert "check position: detections.3.pose_t x" in out
    assert "detections.11.pose_R_33 seem to hold another orientation" in out
    is_read(read_campaign(tmp_path), raw.q, raw.T_instr_target)


STAMPS = [
    ("header.stamp.secs", "header.stamp.nsecs", "ns"),
    (".header.stamp.sec", ".header.stamp.nanosec", "ns"),
    ("secs", "nsecs", "ns"),
    ("tv_sec", "tv_usec", "us"),
    ("stampSec", "stampNanosec", "ns"),
]


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(("seconds", "part", "unit"), STAMPS)
def test_seconds_and_their_part_are_one_time(tmp_path, proposed, seconds, part, unit):
    raw = sighted(tmp_path, "pose")
    time_us = 1_700_000_000_400_000 + 730_000 * np.arange(len(raw.q))
    parts = [time_us // 10**6, time_us % 10**6 * (1000 if unit == "ns" else 1)]
    q = Rotation.from_matrix(raw.T_instr_target[:, :3, :3]).as_quat(scalar_first=True)
    names = [seconds, part, "x", "y", "z", "qw", "qx", "qy", "qz"]
    table = with_joints(raw, names, np.column_stack(parts), raw.T_instr_target[:, :3, 3], q)
    table.astype({seconds: int, part: int}).to_csv(tmp_path / "a.csv", index=False)
    out = proposed("a.csv")
    assert yaml.safe_load(out)["columns"]["poses"]["time"] == {
        "names": [seconds, part],
        "unit": ["s", unit],
    }
    assert f"{part}  time, in {unit}" in " ".join(out.split()).replace(" time", "  time")
    time_s = read_campaign(tmp_path).observations.states.time_s
    np.testing.assert_allclose(time_s - time_s[0], 0.73 * np.arange(len(raw.q)), atol=1e-6)


def test_one_time_in_two_units_is_read_once(tmp_path, proposed):
    raw = sighted(tmp_path, "points", targets=1)
    time_s = 3.0 * np.arange(len(raw.q))
    names = ["t_s", "t_ms", "x", "y", "z"]
    table = with_joints(
        raw, names, np.column_stack([time_s, 1e3 * time_s]), raw.T_instr_target[:, :3, 3]
    )
    table.to_csv(tmp_path / "a.csv", index=False)
    assert yaml.safe_load(proposed("a.csv"))["columns"]["poses"]["time"] == {"names": "t_s"}


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("same", [True, False])
def test_two_logs_with_stamps_in_two_columns_are_joined(tmp_path, proposed, same):
    """Equal seconds are no labels, nor are equal numbers of both logs."""
    raw = sighted(tmp_path, "pose")
    time_s = 1_700_000_000 + np.cumsum(np.random.default_rng(1).integers(8, 14, len(raw.q)))
    q = Rotation.from_matrix(raw.T_instr_target[:, :3, :3]).as_quat()
    ns = 250_000_000 + 1000 * np.arange(len(raw.q))
    stamp = [".header.stamp.secs", ".header.stamp.nsecs"]
    joints = pd.DataFrame({stamp[0]: time_s, stamp[1]: ns})
    joints[[f".position[{k}]" for k in range(6)]] = raw.q
    tags = pd.DataFrame({stamp[0]: time_s + (not same), stamp[1]: ns + 20_000_000})
    tags[[f".pose.position.{axis}" for axis in "xyz"]] = raw.T_instr_target[:, :3, 3]
    tags[[f".pose.orientation.{axis}" for axis in "xyzw"]] = q
    joints.to_csv(tmp_path / "joints.csv", index=False)
    tags.to_csv(tmp_path / "tag.csv", index=False)
    out = proposed("joints.csv", "tag.csv")
    assert "it is refused" not in out
    columns = yaml.safe_load(out)["columns"]
    assert {key: each["time"]["names"] for key, each in columns.items()} == dict.fromkeys(
        ("joints", "readings"), stamp
    )
    assert "pose" not in columns["readings"]
    is_read(read_campaign(tmp_path), raw.q, raw.T_instr_target)


@pytest.mark.parametrize("time", [{"unit": "s"}, {"unit": ["s", "ns", "us"]}])
def test_two_columns_of_numbers_have_a_unit_each(tmp_path, time):
    FileColumns.model_validate({"time": {"names": ["a", "b"], "unit": ["s", "ns"]}})
    with pytest.raises(ValueError, match="one unit for each column"):
        FileColumns.model_validate({"time": {"names": ["a", "b"]} | time})


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("named", [True, False])
def test_rows_without_a_reading_below_the_names_are_rows(tmp_path, proposed, named):
    raw = sighted(tmp_path, "pose")
    names = [f"{vector}_{axis}" for vector in ("rvec", "tvec") for axis in "xyz"]
    table = with_joints(raw, names, *vectors(raw.T_instr_target))
    table.loc[:1, names] = np.nan
    if named:
        table.insert(0, "image", [f"img_{k:04d}.png" for k in range(len(table))])
    table.to_csv(tmp_path / "a.csv", index=False)
    proposed("a.csv")
    found = read_campaign(tmp_path)
    assert (len(found.observations), len(found.quarantined)) == (38, 2)
