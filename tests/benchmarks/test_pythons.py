"""Which Pythons of the machine are tried, and what a wheel holds."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import pythons
from pa10cal.commands import doctor

ROOT = Path(__file__).parents[2]


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine with no Python, and a function that installs one of a version."""
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))

    def install(place, version):
        path = tmp_path / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"#!/bin/sh\n{version}\n")
        path.chmod(0o755)
        return path

    return install


def test_the_first_that_starts_is_taken_from_path_pyenv_or_uv(machine):
    machine("bin/python3.11", "exit 127")  # as a shim of pyenv whose version is not chosen
    pyenv = machine("pyenv/versions/3.11.9/bin/python3.11", "echo 3.11.9")
    path = machine("bin/python3.12", "echo 3.12.4")
    uv = machine("elsewhere/python3.13", "echo 3.13.1")
    machine("bin/uv", f"echo cpython-3.13.1-linux-x86_64-gnu {uv}")
    found = [pythons.find(minor) for minor in pythons.SUPPORTED]
    assert found == [(pyenv, "3.11.9"), (path, "3.12.4"), (uv, "3.13.1")]


def test_what_is_not_there_is_told_and_nothing_to_try_is_no_failure(machine, capsys):
    machine(f"bin/python{sys.version_info[0]}.{sys.version_info[1]}", f"echo {sys.version[:6]}")
    assert pythons.main(["--quick"]) == 0
    shown = capsys.readouterr().out
    assert shown.count("not found on this machine") == len(pythons.SUPPORTED) - 1
    assert "nothing is tried" in shown


def test_a_step_that_fails_is_shown_and_ends_the_trial_of_its_python(
    machine, monkeypatch, capsys, tmp_path
):
    monkeypatch.setattr(pythons, "LOGS", tmp_path / "logs")
    minor = next(each for each in pythons.SUPPORTED if each != sys.version_info[:2])
    version = "{}.{}.0".format(*minor)
    # It tells its version, and makes no environment.
    name = "bin/python{}.{}".format(*minor)
    machine(name, f'[ "$1" = -c ] && echo {version} || {{ echo no room; exit 3; }}')
    assert pythons.main(["--quick"]) == 1
    shown = capsys.readouterr().out
    assert "FAILED (exit code 3)\nno room\n" in shown
    assert "wheel" not in shown
    assert f"failed: {version}" in shown


def test_tools_of_the_quick_trial_are_those_of_the_lock():
    lock = (ROOT / "requirements.lock").read_text("utf-8")
    pins = pythons.pins_of(pythons.TEST_TOOLS, lock)
    pinned = [line for line in pins.splitlines() if line[0] not in " #"]
    assert [line.partition("==")[0] for line in pinned] == [*pythons.TEST_TOOLS]
    assert pins.count("--hash=sha256:") >= len(pinned)


@pytest.mark.slow
def test_a_wheel_holds_what_a_run_and_the_doctor_need(tmp_path, monkeypatch):
    build = [sys.executable, "-m", "pip", "--quiet", "wheel", str(ROOT), "--no-deps"]
    build += ["--no-build-isolation", "--no-index", "--wheel-dir", str(tmp_path)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.name.endswith("-py3-none-any.whl")
    place = tmp_path / "installed"
    subprocess.run([sys.executable, "-m", "zipfile", "-e", wheel, place], check=True)
    packages = {path.parent.name for path in (ROOT / "src").glob("*/__init__.py")}
    assert packages <= {path.name for path in place.iterdir()}
    patient = "from pa10cal.commands import doctor; doctor.LIMIT_S = 300; doctor.doctor()"
    done = subprocess.run(
        [sys.executable, "-c", patient],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(place)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    assert str(place / "pa10cal/workflow") in done.stdout
    assert f"{doctor.CAMPAIGN.name}, raw files to model" in done.stdout
