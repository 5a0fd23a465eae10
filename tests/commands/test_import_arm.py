"""The command that writes an arm's description from a URDF, called in process."""

import re

import numpy as np
import pytest
import yaml

from pa10cal.arm.chain import Chain
from pa10cal.arm.exports import urdf_text
from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.errors import ArmError
from pa10cal.files.arms import load_arm, urdf_of_arm


@pytest.fixture
def urdf(tmp_path):
    """The UR10 as a URDF, away from nominal so that no figure is round."""
    chain = Chain.of(load_arm("ur10"))
    coordinates = chain.nominal + np.random.default_rng(1).normal(0, 1e-3, len(chain.nominal))
    coordinates[chain.columns(("base.x", "base.rz"))] = 0.0
    path = tmp_path / "robot.urdf"
    path.write_text(urdf_text(chain, coordinates, "mine"), encoding="utf-8")
    return path


def test_the_description_written_is_the_arm_of_the_urdf(urdf, tmp_path, capsys):
    out = tmp_path / "campaign" / "my_ur10.yaml"
    assert run_command("import_arm", [str(urdf), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "From base to flange, joints 1 to 6: joint_1, " in said
    assert "Joints 2 and 3 are" in said
    assert "degrees from parallel: row 2 takes beta" in said
    assert "row 3 takes beta" in said
    assert "forward kinematics differs" in said
    arm = load_arm("my_ur10", out.parent)
    assert arm.hayati.tolist() == [False, True, True, False, False, False]
    back = tmp_path / "again.yaml"
    again = tmp_path / "again.urdf"
    chain = Chain.of(arm)
    again.write_text(urdf_text(chain, chain.nominal, "again"), encoding="utf-8")
    assert run_command("import_arm", [str(again), "--out", str(back)]) == 0
    q = np.random.default_rng(2).uniform(-3, 3, (20, 6))
    found = Chain.of(load_arm("again", tmp_path)).forward(q)
    np.testing.assert_allclose(found, chain.forward(q), atol=1e-12)


def test_limits_have_the_digits_that_they_need(urdf, tmp_path):
    text = urdf.read_text(encoding="utf-8")
    lower = re.search(r'lower="([^"]+)"', text)[1]
    urdf.write_text(text.replace(f'lower="{lower}"', 'lower="-2.8798"', 1), encoding="utf-8")
    out = tmp_path / "mine.yaml"
    assert run_command("import_arm", [str(urdf), "--out", str(out)]) == 0
    limits = yaml.safe_load(out.read_text(encoding="utf-8"))["rows"][0]["limits_deg"]
    assert limits[0] == -165.0003858
    assert np.radians(limits[0]) == pytest.approx(-2.8798, abs=1e-9)
    assert isinstance(limits[1], int)  # a full turn


def test_the_urdf_stays_beside_the_description(urdf, tmp_path):
    out = tmp_path / "campaign" / "mine.yaml"
    assert run_command("import_arm", [str(urdf), "--out", str(out)]) == 0
    source = urdf_of_arm("mine", out.parent)
    assert source.text == urdf.read_text(encoding="utf-8")
    assert (source.base, source.tip) == ("base", "flange")
    assert urdf_of_arm("ur10", out.parent) is None
    out.with_suffix(".urdf").unlink()
    with pytest.raises(ArmError, match=r"mine.yaml: urdf.file: .*cannot be read.*copy it there"):
        urdf_of_arm("mine", out.parent)


def test_ends_may_be_named(urdf, tmp_path):
    out = tmp_path / "part.yaml"
    assert (
        run_command(
            "import_arm", [str(urdf), "--base", "link_1", "--tip", "link_4", "--out", str(out)]
        )
        == 0
    )
    assert load_arm("part", tmp_path).n == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["{there}/gone.urdf", "--out", "{there}/a.yaml"], "gone.urdf: the URDF cannot be read"),
        (["{there}", "--out", "{there}/a.yaml"], "the URDF cannot be read"),
        (["{there}/robot.urdf", "--out", "{there}/a.txt"], "--out: the description is a YAML"),
        (["{there}/robot.urdf", "--tip", "flang", "--out", "{there}/a.yaml"], "'flange'?"),
        (["{there}/bytes.urdf", "--out", "{there}/a.yaml"], "bytes.urdf: the URDF cannot be read"),
    ],
)
def test_a_refusal_is_one_message_and_writes_nothing(urdf, tmp_path, capsys, words, message):
    (tmp_path / "bytes.urdf").write_bytes(b"\xff\xfe\x00robot")
    assert run_command("import_arm", [word.format(there=tmp_path) for word in words]) == REFUSED
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert message in said
    assert not list(tmp_path.glob("a.*"))
