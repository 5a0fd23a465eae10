"""The command line `pa10cal STAGE`."""

import pytest

from pa10cal.__main__ import STAGES, main
from pa10cal.stages.command import REFUSED


@pytest.mark.parametrize(
    ("words", "code"), [(["--help"], 0), ([], REFUSED), (["calibrat"], REFUSED)]
)
def test_lists_the_stages(words, code, capsys):
    assert main(words) == code
    shown = capsys.readouterr().out
    assert all(stage in shown for stage in STAGES)


@pytest.mark.parametrize("stage", STAGES)
def test_every_stage_explains_itself(stage, capsys):
    with pytest.raises(SystemExit) as caught:
        main([stage, "--help"])
    assert caught.value.code == 0
    assert f"usage: pa10cal {stage}" in capsys.readouterr().out
