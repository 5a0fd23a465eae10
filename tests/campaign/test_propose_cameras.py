"""Poses as software of cameras and six-degree-of-freedom instruments writes them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

from made_up_sightings import is_read, sighted
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.recognise import roles_of

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
                *(("_x", "_y", "_z"), (".x", ".y", ".z"), ("[0]", "[1]", "[2]"), ("s_0", "s_1", "s_2")),
            )
        ),
        ("rx_vec ry_vec rz_vec", "tx_vec ty_vec tz_vec"),
        ("r_vec_1 r_vec_2 r_vec_3", "t_vec_1 t_vec_2 t_vec_3"),
        ("rotation_vector_x rotation_vector_y rotation_vector_z", "x y z"),
        ("rodrigues_0 rodrigues_1 rodrigues_2", "translation_0 translation_1 translation_2"),
        ("board_rvec_x_rad board_rvec_y_rad board_rvec_z_rad", "board_tvec_x_m board_tvec_y_m board_tvec_z_m"),
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


@pytest.mark.parametrize(
    "names",
    [
        "Q0 Qx Qy Qz Tx Ty Tz",
        "q0 qx qy qz tx ty tz",
        "Qr Qi Qj Qk x y z",
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
