"""Settings of a run: files, the later over the earlier, key by key."""

from __future__ import annotations

import pytest

from pa10cal.errors import SettingsError
from pa10cal.running.workflow import settings_of


def test_later_files_go_over_earlier_ones_at_every_depth(tmp_path):
    first, second = tmp_path / "a.yaml", tmp_path / "b.yaml"
    first.write_text("campaigns: [x]\ncalibration: {starts: 3, inner_poses: 5}\n")
    second.write_text("calibration: {starts: 2}\n")
    used = settings_of([first, second], {"campaigns": ["mine"]}, "here")
    assert used.campaigns == ("mine",)
    assert (used.calibration.starts, used.calibration.inner_poses) == (2, 5)
    assert settings_of([], {"campaigns": ["mine"]}, "here").results_dir == "results"


@pytest.mark.parametrize("text", ["- a list\n", "a: [\n", None])
def test_a_file_that_is_none_of_settings_is_refused(tmp_path, text):
    path = tmp_path / "s.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(SettingsError, match=r"s\.yaml: the settings cannot be read"):
        settings_of([path], {"campaigns": ["mine"]}, "here")


def test_a_wrong_key_is_named(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text("calibraton: {}\n")
    with pytest.raises(SettingsError, match="did you mean 'calibration'"):
        settings_of([path], {"campaigns": ["mine"]}, "here")
