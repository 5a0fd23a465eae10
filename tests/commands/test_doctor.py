"""`pa10cal doctor`: what is missing on the machine."""

from __future__ import annotations

import subprocess
import sys

from pa10cal.__main__ import main
from pa10cal.commands import doctor as machine


def test_what_is_there_is_listed_and_nothing_needed_is_missing(capsys):
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    for name in ("Python", *machine.LIBRARIES, "workflow", "memory", "disk", "cores"):
        assert f" {name} " in shown
    assert "MISSING" not in shown


def test_what_is_missing_is_refused_with_what_to_do(monkeypatch, capsys):
    monkeypatch.setattr(machine, "find_spec", lambda name: None if name == "pandas" else True)
    assert main(["doctor"]) == 2
    shown = capsys.readouterr()
    assert "MISSING pandas" in shown.out
    assert "→ pip install pandas" in shown.out
    assert "pandas" in shown.err


def test_what_only_some_commands_need_is_a_note_that_names_its_extra(monkeypatch, capsys):
    monkeypatch.setattr(machine, "find_spec", lambda name: None if name == "snakemake" else True)
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    assert "note    snakemake" in shown
    assert "pa10cal run" in shown
    assert "→ pip install '.[workflow]'" in shown


def test_it_needs_no_library_to_say_that_one_is_missing():
    script = (
        "import sys\n"
        "for name in ('numpy', 'scipy', 'pandas', 'pydantic', 'yaml', 'snakemake'):\n"
        "    sys.modules[name] = None\n"
        "from pa10cal.commands.command_line import main\n"
        "sys.exit(main(['doctor']))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode in (0, 2), done.stderr
    assert "pa10cal" in done.stdout
    assert "internal fault" not in done.stderr
