"""From a user's own URDF to the same URDF with calibrated origins, by the commands."""

from __future__ import annotations

import csv
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml

from by_commands import calibrated, called, export, table_of
from made_up_sightings import sighted
from pa10cal.arm.chain import Chain
from pa10cal.arm.urdf_writing import urdf_text
from pa10cal.files.arms import load_arm
from pa10cal.fit.model_reading import load_model


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pose", "points"])
def test_names_stay_and_origins_are_calibrated(tmp_path, kind):
    chain = Chain.of(load_arm("ur10"))
    own = (
        urdf_text(chain, chain.nominal, "ours").replace("joint_", "axis").replace("link_", "part_")
    )
    own = own.replace('"flange"', '"mount"')
    (tmp_path / "robot.urdf").write_text(own, encoding="utf-8")
    made = sighted(tmp_path, kind, noise_mm=0.02, poses=60)
    made.description["robot"] = "mine"
    folder = made.write()
    assert called("import_arm", tmp_path / "robot.urdf", out=folder / "mine.yaml") == 0
    out = tmp_path / "out"
    out.mkdir()
    (out / "raw").symlink_to(folder)
    given = table_of(calibrated(out)) | {"extended": None, "dh": out / "dh.csv", "force": True}
    assert export(out, out, **given) == 0
    model, text = load_model(out / "model.yaml"), (out / "robot.urdf").read_text(encoding="utf-8")
    root = ElementTree.fromstring(text)
    joints = [each.get("name") for each in root.findall("joint")]
    assert joints[:7] == [*(f"axis{k}" for k in range(1, 7)), "to_flange"]
    names = {"pose": ["tool"], "points": ["target_T1", "target_T2", "target_T3"]}[kind]
    links = [each.get("name") for each in root.findall("link")]
    assert links[-len(names) - 1 :] == ["flange", *names]
    robot = pin.buildModelFromXML(text)
    data, q = robot.createData(), np.random.default_rng(1).uniform(-2, 2, (4, 6))
    for link in ("flange", "mount", *names):
        frame = link if link != "mount" else "flange"
        for positions, T in zip(q, model.predict(q, frame=frame).T, strict=True):
            pin.framesForwardKinematics(robot, data, positions)
            found = data.oMf[robot.getFrameId(link)].homogeneous
            np.testing.assert_allclose(found, T, atol=1e-9)
    assert "delta_alpha" in (out / "ur_calibration.conf").read_text(encoding="utf-8")
    kinematics = yaml.safe_load((out / "ur_kinematics.yaml").read_text())["kinematics"]
    assert kinematics["forearm"]["x"] == pytest.approx(-0.612, abs=2e-3)
    rows = list(csv.DictReader((out / "dh.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 6


def test_a_table_of_poses_without_its_campaign_is_refused(tmp_path, capsys):
    given = {"calibration": tmp_path / "c.json", "poses": tmp_path / "p.parquet"}
    assert called("export", **given, model=tmp_path / "m.yaml", urdf=tmp_path / "r.urdf") == 2
    assert "--poses together with --campaign-dir" in capsys.readouterr().err
