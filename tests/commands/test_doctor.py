"""`pa10cal doctor`: what is missing on the machine."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from pa10cal.__main__ import main
from pa10cal.commands import doctor as machine


def test_what_is_there_is_listed_and_nothing_needed_is_missing(monkeypatch, capsys):
    monkeypatch.setattr(machine, "LIMIT_S", 300)  # tests may take all cores
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    for name in ("Python", *machine.LIBRARIES, "workflow", "memory", "disk", "cores"):
        assert f" {name} " in shown
    assert "irb120-points, raw files to model: 0.084 mm" in shown
    assert "MISSING" not in shown


def test_what_is_missing_is_refused_with_what_to_do(monkeypatch, capsys):
    monkeypatch.setattr(machine, "find_spec", lambda name: None if name == "pandas" else True)
    assert main(["doctor"]) == 2
    shown = capsys.readouterr()
    assert "MISSING pandas" in shown.out
    assert "→ pip install pandas" in shown.out
    assert "pandas" in shown.err
    assert "not tried: pandas missing" in shown.out


@pytest.mark.slow
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


def test_a_container_allows_less_than_the_machine_has(monkeypatch, tmp_path):
    monkeypatch.setattr(machine, "CGROUP", tmp_path)
    unlimited = machine._memory(), machine._cores()
    (tmp_path / "memory.max").write_text("500000000\n")
    (tmp_path / "cpu.max").write_text("50000 100000\n")
    assert machine._memory()[1:3] == ("note", "0.5 GB")
    assert machine._cores().found == "0.5 may be used"
    (tmp_path / "memory.max").write_text("max\n")
    (tmp_path / "cpu.max").write_text("max 100000\n")
    assert (machine._memory(), machine._cores()) == unlimited


def stands_in(monkeypatch, code):
    """Let another program stand where the campaign is calibrated."""
    run = subprocess.run

    def other(words, **options):
        assert words[1:4] == ["-m", "pa10cal", "chain"]
        return run([sys.executable, "-c", code, words[-1]], **options)

    monkeypatch.setattr(machine.subprocess, "run", other)


CHAIN = {"after_mm": 0.2}
WRITES = f"""
import sys, pathlib
out = pathlib.Path(sys.argv[1])
(out / "model").mkdir()
(out / "model/model.yaml").touch()
(out / "chain.json").write_text({json.dumps(CHAIN)!r})
"""
#: The command itself, with something in the place of its stages; a fork of it runs them.
STAGES = """
import os, signal, sys
from pa10cal.__main__ import main
from pa10cal.commands import chain
chain._run_stages = lambda *given: {}
sys.exit(main(["chain", "--campaign-dir", CAMPAIGN, "--results", sys.argv[1]]))
""".replace("CAMPAIGN", repr(str(Path(__file__).parents[2] / "examples/irb120-points")))
FULL = "given[-1]({'no_room': 'No space left on device'})"
KILLED = "import os, signal; os.kill(os.getpid(), signal.{})"


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(
    ("code", "why", "remedy"),
    [
        ("import sys; sys.exit('first\\nIndexError: one')", "IndexError: one", "users.lock"),
        (KILLED.format("SIGILL"), "killed by SIGILL", "not built for this processor"),
        (KILLED.format("SIGKILL"), "killed by SIGKILL", "not enough memory"),
        (KILLED.format("SIGSEGV"), "killed by SIGSEGV", "users.lock"),
        (KILLED.format("SIGRTMIN + 1"), "killed by signal 35", "users.lock"),
        (STAGES.format("os.kill(os.getpid(), signal.SIGILL)"), "by SIGILL", "this processor"),
        (STAGES.format("os.kill(os.getpid(), signal.SIGKILL)"), "by SIGKILL", "enough memory"),
        (STAGES.format(FULL), "No space left on device", "set TMPDIR"),
        ("import time; time.sleep(60)", "not done in 0.5 s", "it hangs"),
        (WRITES, "0.2 mm at held-out poses in place of 0.0841 mm", "numbers of this machine"),
        (WRITES.replace("model.yaml", "other"), "no model was written", "users.lock"),
    ],
)
def test_a_calibration_that_fails_is_told_with_its_likely_remedy(
    monkeypatch, capsys, code, why, remedy
):
    stands_in(monkeypatch, code)
    if "sleep" in code:
        monkeypatch.setattr(machine, "LIMIT_S", 0.5)
        monkeypatch.setattr(machine.os, "getloadavg", lambda: (0.0, 0.0, 0.0))
    assert main(["doctor"]) == 2
    shown = capsys.readouterr()
    failed, arrow = shown.out.splitlines()[-2:]
    assert failed.startswith("FAILED  calibration")
    assert why in failed
    assert remedy in arrow
    assert "calibration" in shown.err


def test_an_installation_without_the_campaign_is_incomplete(monkeypatch, capsys):
    monkeypatch.setattr(machine, "CAMPAIGN", Path("examples/nothing"))
    assert main(["doctor"]) == 2
    assert "install pa10cal anew" in capsys.readouterr().out


def test_a_machine_whose_cores_are_taken_is_not_blamed(monkeypatch, capsys):
    stands_in(monkeypatch, "import time; time.sleep(60)")
    monkeypatch.setattr(machine, "LIMIT_S", 0.5)
    monkeypatch.setattr(machine.os, "getloadavg", lambda: (500.0, 0.0, 0.0))
    assert main(["doctor"]) == 0
    found, arrow = capsys.readouterr().out.splitlines()[-2:]
    assert found.startswith("note    calibration")
    assert "other programs take all cores" in arrow
