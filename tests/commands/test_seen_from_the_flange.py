"""A sensor on the flange sees a fixed ball: the arm is imported from the flange to the base."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import pa10cal
from by_commands import calibrated, called, export, table_of
from pa10cal.arm.chain import Chain, end_pose
from pa10cal.arm.urdf_writing import urdf_text
from pa10cal.errors import RawDataError
from pa10cal.files.arms import arm_text, load_arm, read_arm
from pa10cal.fit.model_reading import load_model

POSES, NOISE_MM, LONGER_MM = 50, 0.03, 0.4


@pytest.fixture
def folder(tmp_path, capsys):
    """A synthetic ball, seen from the flange of an arm whose upper arm is longer than designed."""
    chain = Chain.of(load_arm("irb120"))
    (tmp_path / "robot.urdf").write_text(urdf_text(chain, chain.nominal, "cell"), encoding="utf-8")
    folder = tmp_path / "out" / "raw"
    folder.mkdir(parents=True)
    named = {"base": "flange", "tip": "base", "out": folder / "seen.yaml"}
    assert called("import_arm", tmp_path / "robot.urdf", **named) == 0
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.0, 1.0, (POSES, 6)).round(5)
    built = chain.coordinates(q)
    built[:, chain.columns(("a_2",))] += 1e-3 * LONGER_MM
    flange_base = np.linalg.inv(end_pose(chain, built))
    ball = flange_base @ [0.4, 0.1, 0.5, 1.0]
    sensor = Rotation.from_euler("xyz", [0.2, -0.1, 0.4])
    seen_mm = 1e3 * sensor.apply(ball[:, :3] - [0.0, 0.02, 0.1])
    seen_mm += rng.normal(0.0, NOISE_MM, seen_mm.shape)
    rows = [",".join(map(repr, row)) for row in np.c_[q, seen_mm].tolist()]
    text = "\n".join(["J1,J2,J3,J4,J5,J6,X,Y,Z", *rows, ""])
    (folder / "scanner.csv").write_text(text, encoding="utf-8")
    capsys.readouterr()
    assert called("columns", folder / "scanner.csv", robot=folder / "seen.yaml") == 0
    proposed = yaml.safe_load(capsys.readouterr().out) | {"name": "raw"}
    proposed["instrument"]["uncertainty_mm"] = NOISE_MM
    (folder / "campaign.yaml").write_text(yaml.safe_dump(proposed), encoding="utf-8")
    return folder


def test_joints_are_told_by_their_numbers_and_gravity_is_none(folder):
    proposed = yaml.safe_load((folder / "campaign.yaml").read_text(encoding="utf-8"))
    joints = proposed["columns"]["poses"]["joints"]
    assert joints == {"names": [f"J{k}" for k in (6, 5, 4, 3, 2, 1)], "unit": "rad"}
    assert proposed["gravity_m_s2"] == [0.0, 0.0, 0.0]
    arm = read_arm(folder / "seen.yaml")
    assert arm.base_moves
    assert "base_moves: true" in arm_text(arm)


def test_gravity_in_a_base_that_joints_carry_is_refused(folder):
    text = (folder / "campaign.yaml").read_text(encoding="utf-8")
    stated = yaml.safe_load(text) | {"gravity_m_s2": [0, 0, -9.81]}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(stated), encoding="utf-8")
    with pytest.raises(RawDataError, match=r"joints of seen carry its base.*set gravity_m_s2"):
        pa10cal.read_campaign(folder)


@pytest.mark.slow
def test_the_arm_is_calibrated_and_exported_under_names_of_its_own(folder):
    out = calibrated(folder.parent)
    given = table_of(out) | {"extended": None, "dh": out / "dh.csv", "force": True}
    assert export(out, out, **given) == 0
    text = (out / "robot.urdf").read_text(encoding="utf-8")
    assert '<link name="flange"' in text
    assert "joint_6" in text
    found = load_model(out / "model.yaml").parameters.set_index("parameter")
    longer = found.loc["delta_a_4"]  # from joint 3 to joint 2, the fourth and fifth from here
    assert 1e3 * abs(longer.value) == pytest.approx(LONGER_MM, abs=NOISE_MM)
