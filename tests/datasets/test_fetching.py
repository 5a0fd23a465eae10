"""Fetching: all files of the pinned version, or nothing. A folder stands in for the network."""

from __future__ import annotations

from dataclasses import replace

import pytest

from made_up_datasets import SERIES_A, SERIES_C, write_irb120
from pa10cal.datasets.importing import Published, fetch, sha256
from pa10cal.datasets.readers import dataset_named
from pa10cal.errors import OutputError, RawDataError


@pytest.fixture
def published(ipa_folder):
    sums = {name: sha256((ipa_folder / name).read_bytes()) for name in (SERIES_A, SERIES_C)}
    found = Published("v1", ipa_folder.as_uri() + "/", sums)
    return replace(dataset_named("ipa-robot-accuracy"), published=found)


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
