"""Campaign folders: by the contract, whole or not at all, the same bytes each time."""

from __future__ import annotations

import fcntl
import gzip
import os
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pa10cal.campaign.description import read_description
from pa10cal.campaign.raw_rows import Quarantined
from pa10cal.datasets.importing import ImportedCampaign, description, table_bytes, write_campaigns
from pa10cal.errors import OutputError

OWN = ["campaign.yaml", "left_out.csv", "poses.csv.gz"]


@pytest.fixture
def campaign():
    poses = pd.DataFrame({"time_s": np.arange(3.0), "kind": "grid"})
    poses["pose"], poses["load_N"], poses["repeat"] = ["P00001", "P00002", "P00003"], 0, 1
    poses["q1_deg"] = np.degrees([0.1, -0.0, 0.3])
    poses["x_mm"] = [1.0, np.nan, -2.5]
    poses["u_x_mm"] = [1.23456789e-4, 0.5, np.nan]
    poses["qw"] = [1.0, 0.5, 0.0]
    return ImportedCampaign(
        name="made-up",
        robot="ur10",
        provenance="made up: nobody measured it",
        instrument="pose",
        uncertainty_mm=0.02,
        reference_temperature_C=21.5,
        holdout={"last_fraction": 0.3},
        readings=poses,
        files=("t.csv",),
        left_out=(Quarantined("t.csv", 7, "not a finite number", "a = 'x'"),),
        notes=(),
    )


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*.*")}


def test_the_contracts_reader_takes_the_description(campaign, tmp_path):
    (folder,) = write_campaigns([campaign], tmp_path / "raw")
    described = read_description(folder)
    assert folder == tmp_path / "raw" / "made-up"
    assert (described.name, described.robot) == ("made-up", "ur10")
    assert described.provenance == campaign.provenance
    assert described.instrument.uncertainty_mm == 0.02
    assert described.holdout.last_fraction == 0.3
    assert described.gravity_m_s2 == (0.0, 0.0, -9.81)
    assert described.tool.mass_kg == 0.0
    assert described.reference_temperature_C == 21.5


def test_a_table_without_time_is_described_by_its_columns(campaign, tmp_path):
    names = "q1_mm q2_deg tau1_Nm tau2_Nm T1_x_mm T1_y_mm T1_z_mm base1_x_mm base1_y_mm base1_z_mm"
    table = pd.DataFrame(1.0, index=[0, 1], columns=[*names.split(), "x_mm", "qw"])
    found = description(replace(campaign, readings=table, holdout={"every": 4}))
    assert found["holdout"] == {"every": 4}
    assert found["columns"]["poses"] == {
        "joints": {"names": ["q1_mm", "q2_deg"]},
        "torques": {"names": ["tau1_Nm", "tau2_Nm"]},
        "position": {"names": ["x_mm", "y_mm", "z_mm"]},
        "rotation": {"names": ["qw", "qx", "qy", "qz"], "convention": "quaternion_wxyz"},
        "targets": {
            name: {"names": [f"{name}_{axis}_mm" for axis in "xyz"]} for name in ("T1", "base1")
        },
    }
    assert "columns" not in description(campaign)


def test_an_arm_of_its_own_and_a_payload_come_along(campaign, tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text("name: mine\nrows:\n  - {d_m: 0.1}\n")
    asked = replace(campaign, robot="mine", arm=own, tool_mass_kg=1.25)
    for _ in range(2):
        (folder,) = write_campaigns([asked], tmp_path / "raw")
        assert (folder / "mine.yaml").read_text() == own.read_text()
        assert read_description(folder).tool.mass_kg == 1.25
    assert sorted(path.name for path in folder.iterdir()) == sorted([*OWN, "mine.yaml"])


def test_rows_left_out_are_in_a_file(campaign, tmp_path):
    (folder,) = write_campaigns([campaign], tmp_path)
    assert (folder / "left_out.csv").read_text().splitlines() == [
        "file,line,reason,value",
        "t.csv,7,not a finite number,a = 'x'",
    ]


def test_numbers_are_written_by_their_unit_and_nan_is_empty(campaign):
    text = gzip.decompress(table_bytes(campaign.poses)).decode()
    first, second, third = text.splitlines()[1:]
    assert first == "0.0,grid,P00001,0,1,5.72957795,1.000000,0.000123457,1.0000000000"
    assert second == "1.0,grid,P00002,0,1,0.00000000,,0.5,0.5000000000"
    assert third.split(",")[6:8] == ["-2.500000", ""]
    back = pd.read_csv(StringIO(text))
    np.testing.assert_allclose(back["x_mm"], campaign.poses["x_mm"])


def test_the_same_campaign_gives_the_same_bytes(campaign, tmp_path):
    for name in ("one", "two"):
        write_campaigns([campaign], tmp_path / name)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def test_a_former_campaign_is_replaced_as_a_whole(campaign, tmp_path):
    write_campaigns([campaign], tmp_path)
    (folder,) = write_campaigns([replace(campaign, provenance="another")], tmp_path)
    assert read_description(folder).provenance == "another"
    assert sorted(path.name for path in folder.iterdir()) == OWN
    assert [path.name for path in tmp_path.iterdir()] == ["made-up"]


def test_refuses_a_place_with_something_else_in_it(campaign, tmp_path):
    (tmp_path / "made-up").mkdir()
    (tmp_path / "made-up" / "cmm.csv").write_text("mine")
    with pytest.raises(OutputError, match=r"made-up: .*holds something else \(got 'cmm\.csv'\)"):
        write_campaigns([replace(campaign, name="first"), campaign], tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["made-up"]
    assert (tmp_path / "made-up" / "cmm.csv").read_text() == "mine"


def test_refuses_a_file_in_its_place(campaign, tmp_path):
    (tmp_path / "raw").write_text("a file")
    with pytest.raises(OutputError, match="the campaign cannot be written"):
        write_campaigns([campaign], tmp_path / "raw")


def test_a_failure_leaves_the_former_campaigns(campaign, tmp_path, monkeypatch):
    write_campaigns([campaign], tmp_path)
    before = contents(tmp_path)

    def fail(self: Path, *args: object, **kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(OutputError, match="No space left"):
        write_campaigns([replace(campaign, provenance="another")], tmp_path)
    assert contents(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["made-up"]


def test_what_a_killed_import_left_is_removed_and_what_a_living_one_writes_is_not(
    campaign, tmp_path
):
    write_campaigns([campaign], tmp_path)
    for name in (".1.partial.made-up", ".2.partial.made-up", ".3.partial.made-up.former"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "poses.csv").write_text("half")
    living = os.open(tmp_path / ".2.partial.made-up", os.O_RDONLY)
    fcntl.flock(living, fcntl.LOCK_SH)
    try:
        write_campaigns([campaign], tmp_path)
    finally:
        os.close(living)
    assert {path.name for path in tmp_path.iterdir()} == {"made-up", ".2.partial.made-up"}


def test_a_failed_exchange_puts_the_former_campaign_back(campaign, tmp_path, monkeypatch):
    write_campaigns([campaign], tmp_path)
    before = contents(tmp_path)
    rename = Path.rename

    def fail(self: Path, target: Path) -> Path:
        if ".partial." in self.name and not self.name.endswith(".former"):
            raise OSError(13, "Permission denied")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(OutputError, match="Permission denied"):
        write_campaigns([replace(campaign, provenance="another")], tmp_path)
    assert contents(tmp_path) == before
