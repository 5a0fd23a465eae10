"""`pa10cal fetch`: one data set, checked; a folder stands in for the network."""

from __future__ import annotations

import pytest

from made_up_datasets import write_ipa, write_titan
from pa10cal.__main__ import main
from pa10cal.commands.command_line import REFUSED


def test_refuses_files_that_are_not_the_published_ones(tmp_path, capsys):
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
