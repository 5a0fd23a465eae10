"""Data sets: nothing missing, the published files or an honest provenance; fetched and written."""

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

from made_up_datasets import MADE_UP, SERIES_A, SERIES_C, edit, write_irb120
from pa10cal.campaign.description import read_description
from pa10cal.campaign.raw_rows import Quarantined
from pa10cal.datasets.data_set import ImportedCampaign, Published
from pa10cal.datasets.fetching import fetch, sha256
from pa10cal.datasets.importing import description, import_campaigns, table_bytes, write_campaigns
from pa10cal.datasets.readers import dataset_named, dataset_names
from pa10cal.errors import OutputError, RawDataError


@pytest.fixture
def published(ipa_folder):
    """The data set as if the made-up folder were what is published."""
    sums = {name: sha256((ipa_folder / name).read_bytes()) for name in (SERIES_A, SERIES_C)}
    found = Published("v1", ipa_folder.as_uri() + "/", sums)
    return replace(dataset_named("ipa-robot-accuracy"), published=found)


def imported(dataset, folder, *, any_version=False):
    return import_campaigns(dataset, folder, max_left_out=0.2, any_version=any_version)


def test_the_published_files_are_taken_without_a_word(published, ipa_folder):
    campaigns = imported(published, ipa_folder)
    assert [campaign.name for campaign in campaigns] == ["ur10-a", "ur10-c"]
    assert not any("not the published" in campaign.provenance for campaign in campaigns)


def test_all_missing_files_are_named(published, ipa_folder):
    (ipa_folder / SERIES_A).unlink()
    (ipa_folder / SERIES_C).unlink()
    with pytest.raises(
        RawDataError, match=f"are missing in the folder .got '{SERIES_A}, {SERIES_C}'"
    ):
        imported(published, ipa_folder)
    with pytest.raises(RawDataError, match=r"no such folder .got '.*nowhere'"):
        imported(published, ipa_folder / "nowhere")


def test_another_checksum_is_refused_with_both(published, ipa_folder):
    edit(ipa_folder / SERIES_C, 4, "measurement_x", "391,7")
    with pytest.raises(RawDataError) as caught:
        imported(published, ipa_folder)
    message = str(caught.value)
    assert message.startswith(f"{ipa_folder / SERIES_C}: the checksum differs")
    assert sha256((ipa_folder / SERIES_C).read_bytes()) in message
    assert published.published.sha256[SERIES_C] in message
    assert "--any-version" in message


def test_two_other_checksums_are_both_named(published, ipa_folder):
    for name in (SERIES_A, SERIES_C):
        edit(ipa_folder / name, 4, "measurement_x", "391,7")
    with pytest.raises(RawDataError) as caught:
        imported(published, ipa_folder)
    for name in (SERIES_A, SERIES_C):
        assert str(ipa_folder / name) in str(caught.value)
        assert sha256((ipa_folder / name).read_bytes()) in str(caught.value)


def test_another_version_may_be_asked_for_and_is_told(published, ipa_folder):
    edit(ipa_folder / SERIES_C, 4, "measurement_x", "391,7")
    a, c = imported(published, ipa_folder, any_version=True)
    found = sha256((ipa_folder / SERIES_C).read_bytes())
    assert f"is not the published file (SHA-256 {found})" in c.provenance
    assert any("is not the published file" in note for note in c.notes)
    assert "not the published" not in a.provenance


def test_names_of_readers():
    assert dataset_names() == tuple(sorted(MADE_UP))
    for name in dataset_names():
        dataset = dataset_named(name)
        assert dataset.name == name
        assert set(dataset.files) <= set(dataset.published.sha256)
    with pytest.raises(RawDataError, match="is 'ipa-robot-accuracy' meant"):
        dataset_named("ipa-robot-acuracy")
    with pytest.raises(
        RawDataError, match=r"allowed: dlr-elastic-calibration, faro-irb120, .*; correct"
    ):
        dataset_named("x")


# Fetching: all files of the pinned version, or nothing. A folder stands in for the network.


def test_fetches_from_where_it_is_published(published, ipa_folder, tmp_path):
    assert fetch(published, tmp_path / "copy") == (SERIES_A, SERIES_C)
    for name in (SERIES_A, SERIES_C):
        assert (tmp_path / "copy" / name).read_bytes() == (ipa_folder / name).read_bytes()


def test_a_folder_or_an_address_may_be_the_source(published, ipa_folder, tmp_path):
    elsewhere = replace(
        published, published=replace(published.published, address="file:///nowhere/")
    )
    for k, source in enumerate((str(ipa_folder), f"{ipa_folder}/", ipa_folder.as_uri())):
        assert len(fetch(elsewhere, tmp_path / str(k), source)) == 2


def test_only_what_differs_is_fetched_again(published, ipa_folder, tmp_path):
    fetch(published, tmp_path / "copy")
    (tmp_path / "copy" / SERIES_C).write_bytes(b"cut short")
    assert fetch(published, tmp_path / "copy") == (SERIES_C,)
    assert fetch(published, tmp_path / "copy", "file:///nowhere") == ()


def test_a_file_that_is_not_the_published_one_leaves_nothing(published, ipa_folder, tmp_path):
    (ipa_folder / SERIES_C).write_bytes(b"another")
    with pytest.raises(RawDataError) as caught:
        fetch(published, tmp_path / "copy")
    assert sha256(b"another") in str(caught.value)
    assert published.published.sha256[SERIES_C] in str(caught.value)
    assert not (tmp_path / "copy").exists()


@pytest.mark.parametrize("source", ["nowhere", "file:///nowhere", "http://[", "no-such://x"])
def test_a_file_that_cannot_be_had_leaves_nothing(published, tmp_path, source):
    with pytest.raises(RawDataError, match=f"{SERIES_A}: the file cannot be fetched") as caught:
        fetch(published, tmp_path / "copy", source)
    assert "urlopen" not in str(caught.value)
    assert not (tmp_path / "copy").exists()


def test_names_with_blanks_are_fetched_from_an_address(tmp_path):
    source = write_irb120(tmp_path / "a b")
    dataset = dataset_named("faro-irb120")
    sums = {name: sha256((source / name).read_bytes()) for name in dataset.files}
    published = replace(dataset.published, sha256=sums)
    assert fetch(replace(dataset, published=published), tmp_path / "copy", str(source))
    assert (tmp_path / "copy" / dataset.files[0]).is_file()


def test_a_folder_that_cannot_be_made_is_refused(published, tmp_path):
    (tmp_path / "copy").write_text("a file")
    with pytest.raises(OutputError, match="cannot be written"):
        fetch(published, tmp_path / "copy")


# Campaign folders: by the contract, whole or not at all, the same bytes each time.

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
    text = gzip.decompress(table_bytes(campaign.readings)).decode()
    first, second, third = text.splitlines()[1:]
    assert first == "0.0,grid,P00001,0,1,5.72957795,1.000000,0.000123457,1.0000000000"
    assert second == "1.0,grid,P00002,0,1,0.00000000,,0.5,0.5000000000"
    assert third.split(",")[6:8] == ["-2.500000", ""]
    back = pd.read_csv(StringIO(text))
    np.testing.assert_allclose(back["x_mm"], campaign.readings["x_mm"])


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
