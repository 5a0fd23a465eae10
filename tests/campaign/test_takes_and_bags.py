"""Takes of motion capture (C3D) and bags of ROS, where the packages that read them are there."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import yaml

from made_up_arrays import c3d_file, joint_state, pose_stamped, write_bag
from made_up_sightings import rows_of, sighted
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.text_lines import lines_of
from pa10cal.errors import Pa10calError

#: Joints of the arm in the order of the alphabet, as /joint_states has them, and their place.
NAMES = ["elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint"]
NAMES += [f"wrist_{k}_joint" for k in (1, 2, 3)]
ORDER = [2, 1, 0, 3, 4, 5]


def controller(raw, step_s=10.0):
    names = "t [s];" + ";".join(f"A{k} [deg]" for k in range(1, 7))
    time_s = step_s * np.arange(len(raw.q))
    return rows_of(time_s, np.degrees(raw.q), names=names, sep=";", decimals=9)


def test_markers_of_a_take_are_read(tmp_path, proposed):
    pytest.importorskip("ezc3d")
    raw = sighted(tmp_path, "pose", poses=20, noise_mm=0.02)
    flange = 1e3 * raw.T_instr_target[:, :3, 3].copy()
    flange[7] = np.nan
    base = np.tile([1200.0, 300.0, 50.0], (len(flange), 1))
    markers = {"Arm:Flange": flange, "Arm:Base": base}
    (tmp_path / "take.c3d").write_bytes(c3d_file(markers, 0.1))
    (tmp_path / "joints.csv").write_text(controller(raw))
    out = proposed("joints.csv", "take.c3d")
    assert out.startswith("# take.c3d: C3D: markers")
    targets = yaml.safe_load(out)["columns"]["readings"]["targets"]
    assert targets["Flange"] == {"names": [f"Flange {axis} [mm]" for axis in "xyz"], "unit": "mm"}
    found = read_campaign(tmp_path).observations
    assert len(found) == len(raw.q) - 1
    order = np.argsort(found.states.time_s)
    seen = np.delete(np.arange(len(raw.q)), 7)
    expected = raw.T_instr_target[seen, :3, 3]
    np.testing.assert_allclose(found.measured.places_m[order, 0], expected, atol=2e-7)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("what", ["joints", "target"])
def test_joints_and_targets_of_a_bag_are_read(tmp_path, proposed, what):
    pytest.importorskip("rosbags")
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    time_s = 1_700_000_000.0 + 10.0 * np.arange(len(raw.q))
    text = ("std_msgs/msg/String", [])
    if what == "joints":
        messages = [
            (t + 0.2, joint_state(t, NAMES, q[ORDER])) for t, q in zip(time_s, raw.q, strict=True)
        ]
        topic = ("sensor_msgs/msg/JointState", messages)
        places = 1e3 * raw.T_instr_target[:, :3, 3]
        other = rows_of(time_s, places, names="t [s];x [mm];y [mm];z [mm]", sep=";")
    else:
        messages = [
            (t, pose_stamped(t, T)) for t, T in zip(time_s, raw.T_instr_target, strict=True)
        ]
        topic, other = ("geometry_msgs/msg/PoseStamped", messages), controller(raw)
    write_bag(tmp_path / "run.db3", {"/read": topic, "/rosout": text})
    (tmp_path / "other.csv").write_text(other)
    out = proposed("run.db3", "other.csv")
    assert out.startswith("# run.db3: bag of ROS 2")
    assert "; /rosout not read" in out.splitlines()[0]
    content = yaml.safe_load(out)
    if what == "joints":
        names = [f"{NAMES[k]} [rad]" for k in np.argsort(ORDER)]
        assert content["columns"]["joints"]["joints"] == {"names": names, "unit": "rad"}
    else:
        assert content["columns"]["readings"]["rotation"]["convention"] == "quaternion_xyzw"
    found = read_campaign(tmp_path).observations
    order = np.argsort(found.states.time_s)
    np.testing.assert_allclose(found.states.q_rad[order], raw.q, atol=1e-9)


def test_bags_of_both_versions_are_read(tmp_path):
    rosbags = pytest.importorskip("rosbags.rosbag1")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    with rosbags.Writer(tmp_path / "a.bag") as bag:
        of = bag.add_connection("/joints", "sensor_msgs/msg/JointState", typestore=store)
        for k in range(5):
            stamp = types["builtin_interfaces/msg/Time"](sec=10 + k, nanosec=500_000_000)
            header = types["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="")
            values, none = np.array([0.1 * k, 0.2]), np.zeros(0)
            message = types["sensor_msgs/msg/JointState"](header, ["a", "b"], values, none, none)
            content = store.serialize_ros1(message, "sensor_msgs/msg/JointState")
            bag.write(of, 10**10 + k, content)
    text = [line.text.split("\t") for line in lines_of(tmp_path / "a.bag")]
    assert text[0] == ["Time [s]", "a [rad]", "b [rad]"]
    assert text[2] == ["11.5", "0.1", "0.2"]
    assert len(text) == 6


def test_a_bag_without_joints_or_a_target_is_refused(tmp_path):
    pytest.importorskip("rosbags")
    write_bag(tmp_path / "a.db3", {"/rosout": ("std_msgs/msg/String", [])})
    with pytest.raises(Pa10calError, match=r"neither joints nor a target \(got '/rosout"):
        list(lines_of(tmp_path / "a.db3"))


@pytest.mark.parametrize(("name", "package"), [("a.c3d", "ezc3d"), ("a.db3", "rosbags")])
def test_what_was_cut_or_cannot_be_read_is_refused(tmp_path, monkeypatch, name, package):
    markers = {"Flange": np.ones((400, 3))}
    if name == "a.c3d":
        (tmp_path / name).write_bytes(c3d_file(markers, 100.0)[:2000])
    else:
        state = [(float(k), joint_state(float(k), NAMES, np.zeros(6))) for k in range(400)]
        write_bag(tmp_path / name, {"/q": ("sensor_msgs/msg/JointState", state)})
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:9000])
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, package, None)
        extra = {"ezc3d": "c3d", "rosbags": "bags"}[package]
        told = rf"the package {package} is not installed.*pip install '\.\[{extra}\]'"
        with pytest.raises(Pa10calError, match=told):
            list(lines_of(tmp_path / name))
    pytest.importorskip(package)
    with pytest.raises(Pa10calError, match=r"cannot be read|no arrays"):
        list(lines_of(tmp_path / name))
