"""Commands for data sets, arms and effects: what they write, and refusals."""

from __future__ import annotations

import re
from importlib.resources import files as resources

import numpy as np
import pytest
import yaml

from made_up_datasets import IRB120, edit, write_ipa, write_irb120, write_titan
from pa10cal.__main__ import main
from pa10cal.arm.chain import Chain
from pa10cal.arm.urdf_writing import urdf_text
from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.errors import ArmError
from pa10cal.files.arms import arm_names, load_arm, urdf_of_arm
from pa10cal.terms.effects.vocabulary import every_effect


@pytest.fixture
def folder(tmp_path):
    return write_ipa(tmp_path / "ipa")


def run(folder, out, *options):
    return main(["import", "ipa-robot-accuracy", str(folder), "--out", str(out), *options])


def files(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*.*")}


def test_writes_both_campaigns_and_says_what_it_made_of(folder, tmp_path, capsys):
    assert run(folder, tmp_path / "raw", "--any-version") == 0
    shown = capsys.readouterr().out
    assert f"{tmp_path / 'raw/ur10-a'}: measurements_grid.csv, read as it is" in shown
    assert "measurements_grid.csv is not the published file (SHA-256" in shown
    assert sorted(files(tmp_path / "raw")) == [
        f"{name}/{file}"
        for name, own in (
            ("ur10-a", "measurements_grid.csv"),
            ("ur10-c", "measurements_random_poses.csv"),
        )
        for file in ("campaign.yaml", "left_out.csv", own)
    ]


def test_refuses_files_that_are_not_the_published_ones(folder, tmp_path, capsys):
    assert run(folder, tmp_path / "raw") == REFUSED
    assert "the checksum differs" in capsys.readouterr().err
    assert not (tmp_path / "raw").exists()


def irb120(tmp_path, *options):
    """Import the folder of text tables."""
    words = ["import", "faro-irb120", str(tmp_path / "irb"), "--out", str(tmp_path / "raw")]
    return main([*words, "--any-version", *options])


def test_shows_rows_left_out(tmp_path, capsys):
    folder = write_irb120(tmp_path / "irb")
    edit(folder / IRB120 / "measured_joints.txt", 5, 0, "?", separator=None)
    assert irb120(tmp_path) == 0
    shown = capsys.readouterr().out
    assert "irb120: 1 rows left out; 9 configurations" in shown
    assert f"left out: {IRB120}/measured_joints.txt:5: not a finite number q1_deg = '?'" in shown


def test_says_where_the_rest_of_many_is(tmp_path, capsys):
    folder = write_irb120(tmp_path / "irb")
    for table in (folder / IRB120).iterdir():
        rows = table.read_text().splitlines()
        table.write_text(
            "\n".join([*rows, *(["x"] * 12 if table.stem == "measured_joints" else rows[:1] * 12)])
        )
    assert irb120(tmp_path, "--settings", '{"max_quarantined_fraction": 0.6}') == 0
    shown = capsys.readouterr().out
    assert shown.count("  left out: ") == 10
    assert f"… and 2 more in {tmp_path / 'raw/irb120/left_out.csv'}" in shown
    listing = (tmp_path / "raw/irb120/left_out.csv").read_text().splitlines()
    assert len(listing) == 13


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["x", "."], "there is no reader of this data set (got 'x'); allowed: dlr-elastic"),
        (["faro-irb120", "."], "are missing in the folder (got '3-Full Measurement/Output"),
        (["faro-irb120", "nowhere"], "there is no such folder (got 'nowhere')"),
    ],
)
def test_refusals_are_one_line(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["import", *words, "--out", "raw"]) == REFUSED
    shown = capsys.readouterr().err
    assert shown.startswith("pa10cal import: ")
    assert message in shown
    assert shown.count("\n") == 1
    assert not (tmp_path / "raw").exists()


def test_the_second_layout(tmp_path, capsys):
    write_irb120(tmp_path / "irb")
    assert irb120(tmp_path) == 0
    assert "10 configurations, 2 places not seen" in capsys.readouterr().out


def test_one_campaign_of_several_may_be_asked_for(tmp_path, capsys):
    folder, out = write_titan(tmp_path / "titan"), tmp_path / "raw"
    words = ["import", "titan-robot-accuracy", str(folder), "--out", str(out), "--any-version"]
    assert main([*words, "--only", "titan-rail"]) == 0
    assert [path.name for path in out.iterdir()] == ["titan-rail"]
    assert (out / "titan-rail/titan_rail.yaml").is_file()
    assert main([*words, "--only", "titan"]) == REFUSED
    assert "no such campaign (got 'titan'); allowed: titan-fixed" in capsys.readouterr().err


def test_the_real_data_set_gives_the_same_bytes_each_time(ipa_data, tmp_path, capsys):
    for name in ("one", "two"):
        assert run(ipa_data, tmp_path / name) == 0
    assert "measurements_grid.csv, read as it is" in capsys.readouterr().out
    assert files(tmp_path / "one") == files(tmp_path / "two")


# `pa10cal fetch`: one data set, checked; a folder stands in for the network.


def test_fetches_no_files_but_the_published_ones(tmp_path, capsys):
    source = write_ipa(tmp_path / "ipa")
    (source / "LICENSE.md").write_text("made up")
    out = tmp_path / "copy"
    words = ["fetch", "ipa-robot-accuracy", "--out", str(out), "--source", str(source)]
    assert main(words) == REFUSED
    message = capsys.readouterr().err
    assert message.startswith("pa10cal fetch: file:")
    assert "the checksum differs" in message
    assert message.count("\n") == 1
    assert not out.exists()


def test_says_that_no_licence_is_stated_before_it_fetches(tmp_path, capsys):
    source = write_titan(tmp_path / "titan")
    out = tmp_path / "copy"
    words = ["fetch", "titan-robot-accuracy", "--out", str(out), "--source", str(source)]
    assert main(words) == REFUSED
    shown = capsys.readouterr()
    assert shown.out.startswith("BotScutters/robot_accuracy: no licence is stated by the owner")
    assert "the checksum differs" in shown.err
    assert not out.exists()


@pytest.mark.parametrize("source", [[], ["--source", ""]])
def test_fetches_nothing_where_all_is_there(ipa_data, tmp_path, capsys, source):
    out = tmp_path / "copy"
    words = ["fetch", "ipa-robot-accuracy", "--out", str(out)]
    assert main([*words, "--source", str(ipa_data)]) == 0
    assert "LICENSE.md, Series_A/measurements_grid.csv, Series_C" in capsys.readouterr().out
    assert main([*words, *source]) == 0
    assert "nothing to fetch; all checksums are right" in capsys.readouterr().out


# The command that writes an arm's description from a URDF, called in process.


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


def test_names_of_a_urdf_are_a_comment_of_the_description(urdf, tmp_path):
    """A line break in one would write keys."""
    text = urdf.read_text(encoding="utf-8").replace('"joint_2"', '"a&#10;name: b&#x202e;"')
    urdf.write_text(text, encoding="utf-8")
    out = tmp_path / "mine.yaml"
    assert run_command("import_arm", [str(urdf), "--out", str(out)]) == 0
    text = out.read_text(encoding="utf-8")
    assert yaml.safe_load(text)["name"] == "mine"
    assert r"joint_1, a name: b\u202e, joint_3" in text


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
        # Options that this kind of file does not need.
        (["{there}/robot.urdf", "--robot", "ur10", "--out", "{there}/a.yaml"], "--robot"),
        (["{there}/robot.urdf", "--xacro", "a:=b", "--out", "{there}/a.yaml"], "--xacro"),
        (["{there}/ur.conf", "--base", "base", "--out", "{there}/a.yaml"], "--base"),
        (["{there}/ur.yaml", "--tip", "tool0", "--out", "{there}/a.yaml"], "--tip"),
        (["{there}/ur.yml", "--xacro", "bad", "--out", "{there}/a.yaml"], "--xacro"),
    ],
)
def test_a_refusal_is_one_message_and_writes_nothing(urdf, tmp_path, capsys, words, message):
    (tmp_path / "bytes.urdf").write_bytes(b"\xff\xfe\x00robot")
    assert run_command("import_arm", [word.format(there=tmp_path) for word in words]) == REFUSED
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert message in said
    assert not list(tmp_path.glob("a.*"))


# The list of effects is that of the classes.


@pytest.mark.parametrize("robot", arm_names())
def test_every_effect_that_an_arm_can_have_is_listed_once(robot, capsys):
    assert run_command("effects", ["--robot", robot]) == 0
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert {len(row) for row in rows} == {6}
    assert all(all(cell.strip() for cell in row) for row in rows)
    assert not any("nan" in row[3] for row in rows)
    listed = [row[0].strip("`") for row in rows[2:]]
    named = [kind.id for kind in every_effect() if not kind.generic]
    assert listed == sorted(listed)
    assert set(listed) <= set(named)
    of_slides = {"slide_bending", "slide_error", "slide_positioning"}
    of_several = {*of_slides, "slide_scale"}
    assert robot != "pa10_6ce" or listed == [each for each in named if each not in of_several]
    assert (of_slides <= set(listed)) == load_arm(robot).prismatic[0]


def test_places_formula_and_size_stand_beside_the_name(capsys):
    run_command("effects", [])
    (row,) = (line for line in capsys.readouterr().out.splitlines() if "`backlash`" in line)
    assert "| joint 1, 2, 3, 4, 5, 6 | `theta_1 -= b s_1` | b > 0 [rad] | 0.0003 rad |" in row


def test_an_unknown_arm_is_refused(capsys):
    assert run_command("effects", ["--robot", "ur99"]) == REFUSED
    printed = capsys.readouterr()
    assert "ur99" in printed.err
    assert not printed.out


def test_an_arm_may_be_named_by_its_file(tmp_path, capsys):
    text = resources("pa10cal.files").joinpath("arms", "ur10.yaml").read_text(encoding="utf-8")
    own = tmp_path / "mine.yaml"
    own.write_text(text.replace("name: ur10", "name: mine", 1))
    assert run_command("effects", ["--robot", str(own)]) == 0
    assert "`backlash`" in capsys.readouterr().out
