"""Made-up folders of data sets, one a test, to read or to spoil."""

from __future__ import annotations

import pytest

from made_up_datasets import write_ipa


@pytest.fixture
def ipa_folder(tmp_path):
    return write_ipa(tmp_path / "ipa")
