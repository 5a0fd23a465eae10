"""`pa10cal import`: a data set's folder to campaigns."""

from __future__ import annotations

import pytest

from made_up_datasets import IRB120, edit, write_ipa, write_irb120, write_titan
from pa10cal.__main__ import main
from pa10cal.commands.command_line import REFUSED


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
