"""Installs pa10cal under every supported Python of this machine, and runs it there.

    python -m benchmarks.pythons            a wheel beside users.lock; the fast tests too
    python -m benchmarks.pythons --newest   newest releases of all dependencies, no lock
    python -m benchmarks.pythons --quick    one that is not this one, two minutes: .ci/run

What each step printed is kept in build/pythons.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
LOGS = ROOT / "build/pythons"
#: What README, SECURITY.md and pyproject.toml name.
SUPPORTED = ((3, 11), (3, 12), (3, 13))
#: What the tests of `--quick` need besides users.lock.
TEST_TOOLS = ("hypothesis", "iniconfig", "packaging", "pluggy", "pygments", "pytest")
TEST_TOOLS += ("sortedcontainers",)
#: Records, tables and models are written and read, commands are called.
QUICK_TESTS = ("tests/results", "tests/fit/test_fitted_model.py", "tests/commands/test_seed.py")
SMALLEST = "examples/irb120-points"
EXTRAS = "workflow,slurm,urdf,workbooks,build,dev,docs"
#: A tail of so many lines is shown of a step that failed.
SHOWN = 25
PIP = ("-m", "pip", "--quiet", "--disable-pip-version-check", "--no-input")
VERSION = "import ensurepip, sys, venv; print(*sys.version_info[:3], sep='.')"


class Interpreter(NamedTuple):
    """A Python of this machine."""

    path: Path
    version: str  # with its patch

    @property
    def minor(self) -> tuple[int, int]:
        """Return its version without the patch."""
        return minor_of(self.version)


class StepError(Exception):
    """A step failed; what it printed has been shown."""


def minor_of(version: str) -> tuple[int, int]:
    """Return a version's first two numbers."""
    major, minor = version.split(".")[:2]
    return int(major), int(minor)


def places(minor: tuple[int, int]) -> Iterator[Path]:
    """Say where a Python of this version may be: PATH, pyenv, uv."""
    name = "python{}.{}".format(*minor)
    for folder in os.environ.get("PATH", "").split(os.pathsep):
        yield Path(folder, name)
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    for folder in sorted(pyenv.glob("versions/{}.{}.*".format(*minor)), reverse=True):
        yield folder / "bin" / name
    if uv := shutil.which("uv"):
        words = [uv, "python", "list", "--only-installed"]
        listed = subprocess.run(words, capture_output=True, text=True, check=False).stdout
        for line in listed.splitlines():
            key, *path = line.split()
            if path and "-{}.{}.".format(*minor) in key:
                yield Path(path[0])


def find(minor: tuple[int, int]) -> Interpreter | None:
    """Return the first Python of this version that starts and can make an environment."""
    for path in places(minor):
        if not path.is_file():
            continue
        # A shim of pyenv is a file too, and fails where its version is not chosen.
        done = subprocess.run([path, "-c", VERSION], capture_output=True, text=True, check=False)
        version = done.stdout.strip()
        if done.returncode == 0 and minor_of(version) == minor:
            return Interpreter(path, version)
    return None


def pins_of(names: tuple[str, ...], lock: str) -> str:
    """Return the part of a lock that pins these packages, with their hashes."""
    parts = re.split(r"\n(?=\S)", lock.strip())
    kept = [part for part in parts if re.match(r"[\w.-]+", part)[0].lower() in names]
    return "\n".join(kept) + "\n"


class Bench:
    """A temporary environment of one Python, with what runs in it and how long that takes."""

    def __init__(self, python: Interpreter, folder: Path, label: str, cores: int) -> None:
        self.python, self.label, self.cores = python, label, cores
        self.venv, self.work = folder / "venv", folder / "work"
        self.work.mkdir()
        self.folder = folder
        self.seconds: dict[str, float] = {}
        drop = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PYENV_VERSION")
        self.environment = {key: text for key, text in os.environ.items() if key not in drop}
        self.environment["PATH"] = f"{self.venv / 'bin'}{os.pathsep}{os.environ.get('PATH', '')}"

    def step(self, name: str, *commands: list[str], cwd: Path | None = None) -> None:
        """Run commands, keep what they print, and say how it went.

        Raises:
            StepError: when one of them fails.
        """
        log = LOGS / f"{self.label}-{name.replace(' ', '-')}.log"
        log.parent.mkdir(parents=True, exist_ok=True)
        begin = time.monotonic()
        with log.open("w", encoding="utf-8") as file:
            for words in commands:
                code = subprocess.run(
                    words,
                    cwd=cwd or self.work,
                    env=self.environment,
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    check=False,
                ).returncode
                if code:
                    break
        self.seconds[name] = time.monotonic() - begin
        how = f"FAILED (exit code {code})" if code else "ok"
        print(f"{self.label:<10} {name:<10} {self.seconds[name]:6.0f} s  {how}", flush=True)
        if code:
            lines = log.read_text("utf-8", errors="replace").splitlines()
            print(*lines[-SHOWN:], f"all of it: {log}", sep="\n", flush=True)
            raise StepError

    def runs(self, *words: str | Path) -> list[str]:
        """Return a command of the environment's Python."""
        return [str(self.venv / "bin/python"), *map(str, words)]

    def pip(self, *words: str | Path) -> list[str]:
        """Return a command of the environment's pip."""
        return self.runs(*PIP, *words)

    def install_locked(self, *more: str) -> None:
        """Make the environment, empty but for users.lock."""
        lock = ROOT / "users.lock"
        self.step(
            "install",
            [str(self.python.path), "-m", "venv", str(self.venv)],
            self.pip("install", *more, "--require-hashes", "--requirement", lock),
        )

    def install_newest(self) -> None:
        """Make the environment from the newest releases."""
        self.step(
            "install",
            [str(self.python.path), "-m", "venv", str(self.venv)],
            self.pip("install", f"{ROOT}[{EXTRAS}]"),
            self.runs("-m", "pip", "list", "--format", "freeze"),
        )

    def install_wheel(self) -> None:
        """Build a wheel as a user may, and install it beside the locked packages."""
        wheels = self.folder / "wheels"
        words = ["wheel", ROOT, "--no-deps", "--no-build-isolation", "--wheel-dir", wheels]
        install = ["install", "--no-deps", "--no-index", "--find-links", wheels, "pa10cal"]
        self.step("wheel", self.pip(*words), self.pip(*install), self.runs("-m", "pip", "check"))

    def use(self) -> None:
        """Look at the machine, and run the example in a folder that is no checkout."""
        self.step("doctor", self.runs("-m", "pa10cal", "doctor"))
        shutil.copytree(ROOT / "examples", self.work / "examples")
        script = ["examples/calibrate_and_discover.py", SMALLEST, "model.yaml"]
        self.step("example", self.runs(*script))

    def run(self) -> None:
        """Run the smallest campaign from raw files to figures and report."""
        words = ["run", SMALLEST, "--out", "results", "--cores", str(self.cores)]
        self.step("run", self.runs("-m", "pa10cal", *words))

    def reproduce(self) -> None:
        """Do what `make reproduce` does, with the smallest campaign in place of three."""
        (self.work / "smallest.yaml").write_text(
            f"raw_dir: examples\ncampaigns: [{Path(SMALLEST).name}]\n", encoding="utf-8"
        )
        words = ["reproduce", "--settings", "smallest.yaml", "--cores", str(self.cores)]
        self.step("reproduce", self.runs("-m", "pa10cal", *words))

    def test_tools(self) -> None:
        """Add the tools of the lock, and the package in place, as `make tools` does."""
        lock = ROOT / "requirements.lock"
        self.step("tools", self.pip("install", "--require-hashes", "--requirement", lock))

    def fast_tests(self) -> None:
        """Run what `make test` runs."""
        place = ["install", "--no-deps", "--no-build-isolation", "--editable", ROOT]
        words = ["-n", str(self.cores), "--dist", "loadfile", "--no-loadscope-reorder"]
        words += ["-q", "--ignore", "tests/browser", "-m", "not slow", "-p", "no:cacheprovider"]
        self.step("tests", self.pip(*place), self.runs("-m", "pytest", *words), cwd=ROOT)

    def quick_tests(self) -> None:
        """Run a few tests of the wheel, with no tools but those that they need."""
        pins = self.folder / "tools.txt"
        lock = (ROOT / "requirements.lock").read_text("utf-8")
        pins.write_text(pins_of(TEST_TOOLS, lock), encoding="utf-8")
        words = ["-q", "-m", "not slow", "-p", "no:cacheprovider", *QUICK_TESTS]
        install = self.pip("install", "--require-hashes", "--requirement", pins)
        self.step("tests", install, self.runs("-m", "pytest", *words), cwd=ROOT)


def locked(bench: Bench) -> None:
    """Try everything with the pinned versions."""
    bench.install_locked()
    bench.install_wheel()
    bench.use()
    bench.run()
    bench.reproduce()
    bench.test_tools()
    bench.fast_tests()


def newest(bench: Bench) -> None:
    """Try it with the newest releases."""
    bench.install_newest()
    bench.use()
    bench.run()
    bench.fast_tests()


def quick(bench: Bench) -> None:
    """Try what breaks first; doctor calibrates, and so does the example."""
    bench.install_locked("--no-compile")
    bench.install_wheel()
    bench.use()
    bench.quick_tests()


def main(words: list[str] | None = None) -> int:
    """Find the interpreters, try each, and return 1 where one failed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pythons", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--newest", action="store_true", help="newest releases, newest Python")
    kinds.add_argument("--quick", action="store_true", help="one Python that is not this one")
    parser.add_argument("--only", action="append", metavar="3.12", help="this version alone")
    parser.add_argument("--cores", type=int, default=2)
    chosen = parser.parse_args(words)
    wanted = [minor_of(each) for each in chosen.only or ()] or list(SUPPORTED)
    found = []
    for minor in wanted:
        python = find(minor)
        found += [python] if python else []
        where = f"{python.version}, {python.path}" if python else "not found on this machine"
        print("Python {}.{}: {}".format(*minor, where), flush=True)
    way = newest if chosen.newest else quick if chosen.quick else locked
    if chosen.quick:
        found = [python for python in found if python.minor != sys.version_info[:2]]
    if way is not locked:
        found = found[-1:]
    if not found:
        print("No other supported Python is on this machine: nothing is tried.")
        return 0
    failed = []
    for python in found:
        label = python.version + ("-newest" if chosen.newest else "")
        with tempfile.TemporaryDirectory(prefix="pa10cal-python-") as folder:
            bench = Bench(python, Path(folder), label, chosen.cores)
            try:
                way(bench)
            except StepError:
                failed.append(label)
            print(f"{label:<10} {'together':<10} {sum(bench.seconds.values()):6.0f} s", flush=True)
    print(f"failed: {', '.join(failed)}" if failed else "All passed.")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
