"""`pa10cal import`: a data set's folder to campaigns."""

from __future__ import annotations

import pytest

from made_up_datasets import SERIES_A, edit, write_ipa, write_irb120
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
    assert f"{tmp_path / 'raw/ur10-a'}: 0 rows left out; 10 readings" in shown
    assert "measurements_grid.csv is not the published file (SHA-256" in shown
    assert sorted(files(tmp_path / "raw")) == [
        f"{name}/{file}"
        for name in ("ur10-a", "ur10-c")
        for file in ("campaign.yaml", "left_out.csv", "poses.csv.gz")
    ]


def test_refuses_files_that_are_not_the_published_ones(folder, tmp_path, capsys):
    assert run(folder, tmp_path / "raw") == REFUSED
    assert "the checksum differs" in capsys.readouterr().err
    assert not (tmp_path / "raw").exists()


def test_shows_rows_left_out(folder, tmp_path, capsys):
    edit(folder / SERIES_A, 5, "elbow_joint", "?")
    assert run(folder, tmp_path / "raw", "--any-version") == 0
    shown = capsys.readouterr().out
    assert "ur10-a: 1 rows left out; 9 readings" in shown
    assert f"left out: {SERIES_A}:5: not a finite number elbow_joint = '?'" in shown


def test_says_where_the_rest_of_many_is(folder, tmp_path, capsys):
    path = folder / SERIES_A
    path.write_bytes(path.read_bytes() + b"x;1\r\n" * 12)
    settings = '{"max_quarantined_fraction": 0.6}'
    assert run(folder, tmp_path / "raw", "--any-version", "--settings", settings) == 0
    shown = capsys.readouterr().out
    assert shown.count("  left out: ") == 10
    assert f"… and 2 more in {tmp_path / 'raw/ur10-a/left_out.csv'}" in shown
    listing = (tmp_path / "raw/ur10-a/left_out.csv").read_text().splitlines()
    assert len(listing) == 13


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["x", "."], "there is no reader of this data set (got 'x'); allowed: faro-irb120, ipa"),
        (["faro-irb120", "."], "are missing in the folder (got 'joints.txt, reflector_1.txt"),
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
    folder = write_irb120(tmp_path / "irb")
    assert main(["import", "faro-irb120", str(folder), "--out", str(tmp_path / "raw")]) == 0
    assert "10 configurations, 2 places not seen" in capsys.readouterr().out


def test_the_real_data_set_gives_the_same_bytes_each_time(ipa_data, tmp_path, capsys):
    for name in ("one", "two"):
        assert run(ipa_data, tmp_path / name) == 0
    assert "0 rows left out; 11911 readings, 0 of them repeats" in capsys.readouterr().out
    assert files(tmp_path / "one") == files(tmp_path / "two")
