"""A glance at a campaign never refuses; what it sees is right."""

import os
from pathlib import Path

import pytest

from pa10cal.command_settings import ChainOptions
from pa10cal.errors import OutputError
from pa10cal.planning.campaign import (
    arm_files,
    by_general_model,
    campaign_name,
    raw_files,
    refuse_files_of_others,
    robot_name,
)
from pa10cal.stages.pipeline import stages


@pytest.fixture
def campaign(tmp_path):
    def write(text):
        (tmp_path / "campaign.yaml").write_bytes(text.encode())
        return tmp_path

    return write


def test_sees_robot_and_the_files_that_are_there(campaign):
    folder = campaign(
        "\ufeffname: First\r\nrobot: other\r\nfiles:\r\n  cmm: cmm.csv\r\n  resolver: gone.csv\r\n"
    )
    (folder / "cmm.csv").touch()
    assert campaign_name(folder) == "First"
    assert robot_name(folder) == "other"
    assert raw_files(folder) == [folder / "cmm.csv"]
    assert arm_files(folder) == []
    (folder / "other.yaml").touch()
    assert arm_files(folder) == [folder / "other.yaml"]


def test_the_file_that_states_names_of_columns_is_watched_too(campaign):
    folder = campaign("files: {poses: poses.parquet}")
    (folder / "poses.parquet").touch()
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").touch()
    assert raw_files(folder) == [folder / "poses.parquet", folder / "meta" / "info.json"]


@pytest.mark.parametrize("text", ["", "- a list", "robot: [", "files: cmm.csv", "files: {cmm: 3}"])
def test_leaves_refusals_to_the_command(campaign, text):
    folder = campaign(text)
    assert robot_name(folder) == ""
    assert raw_files(folder) == []
    assert arm_files(folder) == []


@pytest.mark.parametrize("name", ["../ur10", "a" * 5000, "nul\\0", "/etc/ur10"])
def test_no_name_leads_out_of_the_folder(campaign, name):
    folder = campaign(f'robot: "{name}"\nfiles: {{poses: "{name}"}}\n')
    (folder.parent / "ur10.yaml").touch()
    assert arm_files(folder) == []
    assert raw_files(folder) == []


def test_a_campaign_that_is_not_there_has_nothing(tmp_path):
    assert robot_name(tmp_path / "gone") == ""
    assert campaign_name(tmp_path / "gone") == "gone"
    assert raw_files(tmp_path / "gone") == []


def test_a_description_that_changes_is_read_again(campaign):
    folder = campaign("robot: one")
    assert robot_name(folder) == "one"
    folder = campaign("robot: other")
    os.utime(folder / "campaign.yaml", ns=(1, 1))
    assert robot_name(folder) == "other"


@pytest.mark.parametrize("members", [("mine",), ("may", "june")])
@pytest.mark.parametrize("effects", [(), "named"])
def test_all_that_stages_write_and_their_logs_are_files_that_a_run_makes(
    tmp_path, members, effects
):
    settings = ChainOptions.model_validate({"calibration": {"effects": effects}})
    made = [*stages(tuple(map(Path, members)), tmp_path, settings)]
    written = {path for stage in made for path in stage.writes.values()}
    written |= {tmp_path / "members" / name / "logs/ingest.log" for name in members}
    written |= {tmp_path / "logs/discover.log", tmp_path / "chain.json"}
    for path in written:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text('{"schema": "pa10cal-calibration/1"}', "utf-8")
    refuse_files_of_others(tmp_path)
    (tmp_path / "discovery/notes.txt").touch()
    with pytest.raises(OutputError, match="no run made") as refused:
        refuse_files_of_others(tmp_path)
    assert refused.value.where.endswith("notes.txt")


@pytest.mark.parametrize(
    ("model", "robot", "instrument", "general"),
    [
        ("auto", "pa10_6ce", "touch_trigger_cmm", False),
        ("auto", "ur10", "touch_trigger_cmm", True),
        ("auto", "pa10_6ce", "pose", True),
        ("paper", "ur10", "touch_trigger_cmm", False),
        ("general", "pa10_6ce", "touch_trigger_cmm", True),
        ("auto", "pa10_6ce", "no_such_kind", True),
    ],
)
def test_balls_touched_on_the_papers_arm_have_its_model(model, robot, instrument, general):
    assert by_general_model(model, robot, instrument) == general
