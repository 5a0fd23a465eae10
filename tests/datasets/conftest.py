"""Made-up folders of data sets, one a test, to read or to spoil."""

from __future__ import annotations

import pytest

from made_up_datasets import write_ipa, write_irb120


@pytest.fixture
def ipa_folder(tmp_path):
    return write_ipa(tmp_path / "ipa")


@pytest.fixture
def irb_folder(tmp_path):
    return write_irb120(tmp_path / "irb")
