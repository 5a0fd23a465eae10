"""A campaign.yaml proposed for files as they are, and what is read so."""

from __future__ import annotations

import pytest

from pa10cal.__main__ import main


@pytest.fixture
def tried():
    """Have the command read the files by its proposal, for tests of what it says of that."""


@pytest.fixture
def untried(request, monkeypatch):
    """Let the command not read the files by its proposal, unless a test uses `tried`."""
    if "tried" not in request.fixturenames:
        monkeypatch.setattr("pa10cal.commands.data._comments_of_a_trial_reading", lambda *_: [])


@pytest.fixture
def columns(tmp_path, capsys, untried):
    """Propose for files of a folder, and keep it there; return code, text, and what was said."""

    def run(*names, folder=tmp_path, options=("--robot", "ur10")):
        code = main(["columns", *(str(folder / name) for name in names), *options])
        out, said = capsys.readouterr()
        (folder / "campaign.yaml").write_text(out, encoding="utf-8")
        return code, out, said

    return run


@pytest.fixture
def proposed(columns):
    """Return what is proposed for files that can be read."""

    def run(*names, **how):
        code, out, said = columns(*names, **how)
        assert code == 0, said
        return out

    return run
