"""Folders of data sets: nothing missing, the published files, or an honest provenance."""

from __future__ import annotations

from dataclasses import replace

import pytest

from made_up_datasets import MADE_UP, SERIES_A, SERIES_C, edit
from pa10cal.datasets.importing import Published, import_campaigns, sha256
from pa10cal.datasets.readers import dataset_named, dataset_names
from pa10cal.errors import RawDataError


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
