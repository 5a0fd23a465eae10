"""Outputs of commands that would replace their inputs."""

import functools
import inspect
import re
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from pa10cal.commands import arguments
from pa10cal.commands.command_line import COMMANDS, REFUSED, command_named, run_command

JOIN = "join --name x --campaign-dir mine --base-frame b"


def test_no_input_of_several_is_replaced(tmp_path, capsys):
    june, july = (str(tmp_path / name) for name in ("june.yaml", "july.yaml"))
    Path(july).touch()
    assert run_command("drift", [june, july, "--out", july]) == REFUSED
    assert "would replace the file of models" in capsys.readouterr().err


@pytest.mark.parametrize("out", ["model.yaml", "model.covariance.npz"])
def test_the_files_of_a_model_that_is_given_as_results_are_not_replaced(tmp_path, capsys, out):
    folder = tmp_path / "june" / "model"
    folder.mkdir(parents=True)
    for name in ("model.yaml", "model.covariance.npz"):
        (folder / name).touch()
    words = ["--model", str(tmp_path / "june"), "--joints", "q.csv", "--out", str(folder / out)]
    assert run_command("predict", words) == REFUSED
    assert "would replace the file of model" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("argv", "lost"),
    [
        ("ingest --campaign-dir mine --out mine/poses.csv --quarantine q.csv", "poses.csv"),
        ("ingest --campaign-dir mine --out p.parquet --quarantine mine/poses.csv", "poses.csv"),
        ("seed --campaign-dir mine --poses p.parquet --out mine/campaign.yaml", "campaign.yaml"),
        ("seed --campaign-dir mine --poses p.parquet --out arms/own.yaml", "../arms/own.yaml"),
        ("join --name x --campaign-dir mine --poses mine/poses.csv --base-frame b --out-dir o", ""),
    ],
)
def test_no_file_of_a_campaign_is_replaced(tmp_path, monkeypatch, capsys, argv, lost):
    monkeypatch.chdir(tmp_path)
    for folder in ("mine", "arms"):
        Path(folder).mkdir()
    Path("mine/campaign.yaml").write_text("robot: own\nfiles: {poses: poses.csv}\n")
    for name in ("mine/poses.csv", "arms/own.yaml"):
        Path(name).write_text("measured")
    name, *words = argv.split()
    called = []

    @functools.wraps(command_named(name))
    def command(**given):
        called.append(given)

    code = run_command(name, words, command)
    assert (code, bool(called)) == ((REFUSED, False) if lost else (0, True))
    if lost:
        told = capsys.readouterr().err
        assert "would replace the file of campaign dir" in told
        assert words[words.index(next(w for w in words if w.endswith(Path(lost).name))) - 1] in told


@pytest.mark.parametrize(
    ("argv", "code"),
    [
        ("predict --model m.yaml --joints q.csv --frame tool --out tool", 0),
        ("predict --model m.yaml --joints q.csv --frame tool --out m.yaml", REFUSED),
        ("montecarlo --campaign tool --robot ur10 --out tool", 0),
        ("montecarlo --campaign x --robot m.yaml --out m.yaml", REFUSED),
        ("montecarlo --campaign x --robot ./tool --out tool", REFUSED),
        ("montecarlo --campaign x --robot ur10 --settings tool --out tool", REFUSED),
    ],
)
def test_a_name_is_no_file(tmp_path, monkeypatch, argv, code):
    monkeypatch.chdir(tmp_path)
    for name in ("tool", "m.yaml", "q.csv"):
        Path(name).write_text("{}")
    name, *words = argv.split()

    @functools.wraps(command_named(name))
    def command(**given):
        del given

    assert run_command(name, words, command) == code


@pytest.mark.parametrize(
    ("argv", "of"),
    [
        ("curve --points points.csv --out-dir . --settings link.yaml", "points"),
        ("curve --points measured.csv --out-dir . --settings link.yaml", ""),
        (f"{JOIN} --poses poses.parquet --out-dir mine", "campaign dir"),
        (f"{JOIN} --poses poses.parquet --out-dir .", "poses"),
        (f"{JOIN} --poses poses.parquet --out-dir arms", "campaign dir"),
        (f"{JOIN} --poses poses.parquet --out-dir new", ""),
        ("measured --campaign-dir mine --results r --out mine", "campaign dir"),
        ("calibrate --campaign-dir mine --poses p --base-frame 44N.json --out .", "base frame"),
        ("compare m.yml r --out m.covariance.npz", "first"),
    ],
)
def test_no_input_is_replaced_in_a_folder_or_beside(tmp_path, monkeypatch, capsys, argv, of):
    monkeypatch.chdir(tmp_path)
    for folder in ("mine", "arms"):
        Path(folder).mkdir()
    for name in ("poses.parquet", "mine/measured.csv", "arms/own.yaml", "44N.json", "m.yml"):
        Path(name).touch()
    for name in ("points.csv", "measured.csv", "m.covariance.npz"):
        Path(name).touch()
    Path("mine/campaign.yaml").write_text("robot: own\nfiles: {poses: measured.csv}\n")
    Path("link.yaml").write_text("link_m: 0.1\n")
    name, *words = argv.split()
    called = []

    @functools.wraps(command_named(name))
    def command(**given):
        called.append(given)

    assert run_command(name, words, command) == (REFUSED if of else 0)
    assert bool(called) == (not of)
    if of:
        assert f"would replace the file of {of}" in capsys.readouterr().err


@pytest.mark.parametrize("name", COMMANDS)
def test_every_file_that_a_command_writes_is_known_to_be_written(name):
    _, meanings, _ = arguments._parts_of(inspect.getdoc(command_named(name)))
    hints = get_type_hints(command_named(name))

    def described_as(words):
        return {
            each
            for each, meaning in meanings.items()
            if re.search(words, meaning) and Path in (hints[each], *get_args(hints[each]))
        }

    assert described_as(r"\bto write\b") <= set(arguments._OUTPUTS.get(name, ("out",)))
    # These write folders of their own names, or ask themselves whether something is there.
    if name not in ("run", "fleet", "draw_trials", "fetch", "figures", "drift"):
        folders = described_as(r"\bfolder for\b|\bgets\b")
        assert folders <= set(arguments._OUTPUTS.get(name, ("out",)))
        assert not folders or name in arguments._IN_FOLDER
