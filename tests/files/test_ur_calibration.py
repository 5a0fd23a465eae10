"""Files with a calibration by Universal Robots, and the description that is written of them."""

import numpy as np
import pytest
import yaml

from pa10cal.arm.chain import Chain
from pa10cal.arm.ur_calibration import (
    LINKS,
    ORIGIN,
    ur_deltas,
    ur_deltas_text,
    ur_kinematics,
    ur_layout,
)
from pa10cal.commands.command_line import main
from pa10cal.errors import ArmError, SettingsError
from pa10cal.files.arms import copy_description, load_arm, maker_calibration
from pa10cal.files.ur_calibration import read_ur_calibration

#: As a controller writes it.
CONF = """[mounting]
delta_theta = [ -8.2e-05, -0.103609197138685979, 0.673631891251821102, -0.57016974724960845, 0, 0]
delta_a = [ -0.00016, 0.00304003843792177708, 0.0916468555721788314, -9.6e-05, -2.9e-05, 0]
delta_d = [ 0.0005, 11.1984514757821039, -92.5270326908668181, 81.3282683520703529, -0.0002, 0]
delta_alpha = [ -0.0003, -0.00565024518540147101, -0.00378922621833689211, -0.001, 0.001, 0]
joint_checksum = [ 0x6e0f7bf, 0xa32a713f, 0xf636a50, 0x9ec2338a, 0xa1afded8, 0xb29b2979]
calibration_status = 2 # 0 == notInitialized / 1 == notLinearised / 2 == Linearised
joint_raw_offset = [ 0x31aa98, 0x324a55, 0xd4b163, 0xdd705d, 0xdce343, 0xdce0d7]
"""


def far(one, other):
    q = np.random.default_rng(5).uniform(-3, 3, (20, 6))
    return np.abs(Chain.of(one).forward(q) - Chain.of(other).forward(q)).max()


@pytest.fixture
def conf(tmp_path):
    path = tmp_path / "calibration.conf"
    path.write_text(CONF)
    return path


def test_a_controllers_file_becomes_a_description_and_goes_out_again(conf, tmp_path, capsys):
    out = tmp_path / "mine.yaml"
    assert main(["import_arm", str(conf), "--robot", "ur10", "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "mm from that of ur10 in the mean of all postures" in told
    assert "Its controller computes with these rows" in told
    arm, designed = load_arm("mine", tmp_path), load_arm("ur10")
    assert arm.remarks == ()
    assert arm.title == "Universal Robots UR10, calibrated by its maker"
    assert 1e-3 < far(arm, designed) < 2e-2
    assert maker_calibration("mine", tmp_path).designed.name == "ur10"
    assert maker_calibration("ur10", tmp_path) is None
    chain = Chain.of(arm)
    again = tmp_path / "again.conf"
    again.write_text(ur_deltas_text(ur_deltas(chain, chain.nominal, ur_layout(designed)), "made"))
    assert far(read_ur_calibration(again).arm("again", designed), arm) < 1e-8
    kinematics = tmp_path / "kinematics.yaml"
    kinematics.write_text(ur_kinematics(chain, chain.nominal))
    for words in ([], ["--robot", "ur10"]):
        out = tmp_path / "other.yaml"
        assert main(["import_arm", str(kinematics), *words, "--out", str(out)]) == 0
        assert far(load_arm("other", tmp_path), arm) < 1e-10
        stated = yaml.safe_load(out.read_text("utf-8"))["maker_calibration"]
        assert stated["hash"].startswith("calib_")
        assert ("of" in stated) == bool(words)
    assert "Limits, gear ratios and masses" not in capsys.readouterr().out.splitlines()[-2]


def test_rows_themselves_are_read(tmp_path):
    table = ur_layout(load_arm("ur10")).table
    path = tmp_path / "rows.yaml"
    names = ("dh_theta", "dh_d", "dh_a", "dh_alpha")
    path.write_text(yaml.safe_dump(dict(zip(names, table.T.tolist(), strict=True))))
    assert far(read_ur_calibration(path).arm("mine", None), load_arm("ur10")) < 1e-12


def test_the_arm_as_designed_goes_along_with_a_copy(conf, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    one.mkdir()
    text = "name: design\nrows:\n" + "".join(
        f"  - {{d_m: {d}, a_m: {a}, alpha_deg: {np.degrees(alpha)}}}\n"
        for _, d, a, alpha in ur_layout(load_arm("ur10")).table.tolist()
    )
    (one / "design.yaml").write_text(text)
    words = ["--robot", str(one / "design.yaml"), "--out", str(one / "mine.yaml")]
    assert main(["import_arm", str(conf), *words]) == 0
    copy_description("mine", one, two)
    assert maker_calibration("mine", two).designed.name == "design"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("status = 2", "status = 1", r"its calibration_status is 1 \(not linearised\)"),
        ("status = 2", "status = -1", r"its calibration_status is -1 \(unknown\)"),
        ("status = 2", 'status = "0"', r'is no whole number \("0"\)'),
        ("status = 2", "status = 2.9", r"is no whole number \(2\.9\)"),
        ("status = 2", "status =", r"is no whole number \(\)"),
        ("joint_raw_offset", "calibration_status", "calibration_status stands twice"),
        ("delta_alpha", "delta_theta", "delta_theta stands twice"),
        ("delta_d = [ 0.0005,", "delta_d = [", "delta_d is not six numbers"),
        ("delta_a = [ -0.00016", "delta_a = [ 0,00016", "delta_a is not six numbers"),
        ("delta_alpha", "alpha", "it has no delta_alpha"),
    ],
)
def test_a_controllers_file_that_cannot_be_meant_is_refused(conf, old, new, message):
    conf.write_text(CONF.replace(old, new))
    assert conf.read_text() != CONF
    with pytest.raises(ArmError, match=rf"calibration\.conf: .*{message}.*calibration_status 2"):
        read_ur_calibration(conf)


def test_a_status_may_be_hexadecimal_and_an_ending_in_capitals(tmp_path, capsys):
    path, out = tmp_path / "calibration.CONF", tmp_path / "mine.yaml"
    path.write_text(CONF.replace("status = 2", "status = 0x02"))
    assert main(["import_arm", str(path), "--robot", "ur10", "--out", str(out)]) == 0
    assert "calibration_status" not in capsys.readouterr().out


def test_a_status_that_is_not_stated_is_told(conf, tmp_path, capsys):
    """As of the project's own export."""
    conf.write_text(CONF.replace("calibration_status", "other"))
    out = tmp_path / "mine.yaml"
    assert main(["import_arm", str(conf), "--robot", "ur10", "--out", str(out)]) == 0
    assert "It does not state calibration_status" in capsys.readouterr().out
    assert "# It does not state calibration_status" in out.read_text("utf-8")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rows: []", "no key kinematics"),
        ("- 1", "no key kinematics"),
        ("kinematics: {shoulder: {x: 0}}", "missing key"),
        ("dh_theta: [1, 2]", "dh_theta"),
        ("a: [", "cannot be read"),
    ],
)
def test_other_yaml_files_are_refused(tmp_path, text, message):
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises((ArmError, SettingsError), match=rf"a\.yaml.*{message}"):
        read_ur_calibration(path)


def test_departures_need_the_model_they_are_of(conf, tmp_path):
    words = ["import_arm", str(conf), "--out", str(tmp_path / "mine.yaml")]
    with pytest.raises(ArmError, match=r"no model is named.*--robot"):
        read_ur_calibration(conf).arm("mine", None)
    with pytest.raises(ArmError, match="layout of Universal Robots"):
        read_ur_calibration(conf).arm("mine", load_arm("irb120"))
    assert main(words) == 2
    assert not (tmp_path / "mine.yaml").exists()


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ArmError, match=r"gone\.conf: .*cannot be read"):
        read_ur_calibration(tmp_path / "gone.conf")


def test_every_link_has_all_six_numbers(tmp_path):
    path = tmp_path / "a.yaml"
    kinematics = {link: dict.fromkeys(ORIGIN, 0.0) for link in LINKS}
    kinematics["wrist_3"]["z"] = "here"
    path.write_text(yaml.safe_dump({"kinematics": kinematics}))
    with pytest.raises(SettingsError, match=r"wrist_3\.z"):
        read_ur_calibration(path)
