"""Command `doctor`: checks of this machine; it imports nothing that may be missing."""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, NamedTuple

import pa10cal
from pa10cal.errors import EXTRAS, Pa10calError, SettingsError, how_to_install
from pa10cal.files.output import MAKE_ROOM
from pa10cal.running.child import KILLED_BY, signal_name
from pa10cal.running.workflow import workflow_folder

LEAST_PYTHON = (3, 11)
#: Memory that a run of the largest campaigns needs at most [bytes].
MEMORY_BYTES = 2e9
#: Room on the disk that the results of such a run need at most [bytes].
DISK_BYTES = 1e9
#: Limits of a container on memory and cores (Linux, control groups version 2).
CGROUP = Path("/sys/fs/cgroup")
#: The campaign that is calibrated, in the folder of the rules.
CAMPAIGN = Path("examples/irb120-points")
#: Time that its calibration may take [s]; on an idle machine it takes three seconds.
LIMIT_S = 30
#: Its mean error over held-out poses [mm].
KNOWN_MM = 0.0841
#: How far from it rounding may lead [mm].
NEAR_MM = 0.001
LOCKED = "pip install --require-hashes --requirement users.lock installs versions that work"
FREE_SPACE = "make room, or set TMPDIR to a folder that may be written to"
#: What a signal that kills a process most often means.
REMEDY_BY_SIGNAL = {
    "SIGILL": "a library is not built for this processor: install it for this kind of machine",
    "SIGKILL": "there was likely not enough memory: make room, or allow this process more",
}
#: What each library is for, by the name of its distribution and of its module; those that come with
#: an extra are needed by some commands alone.
LIBRARIES = {
    "numpy": ("numpy", "everything"),
    "scipy": ("scipy", "everything"),
    "pandas": ("pandas", "raw files"),
    "pyarrow": ("pyarrow", "the table of poses"),
    "pydantic": ("pydantic", "settings and records"),
    "PyYAML": ("yaml", "settings and descriptions"),
    "typing_extensions": ("typing_extensions", "everything"),
    "pin": ("pinocchio", "importing a URDF"),
    "robot_descriptions": ("robot_descriptions", "arms known by name"),
    "xacrodoc": ("xacrodoc", "xacro files of arms"),
    "snakemake": ("snakemake", "pa10cal run, the workflow"),
    "matplotlib": ("matplotlib", "figures"),
    "Jinja2": ("jinja2", "reports"),
    "plotly": ("plotly", "figures of reports"),
}


class Check(NamedTuple):
    """The result of one check."""

    name: str  # what was checked
    # `ok`; `missing` where something that is needed is not there; `failed` where it does not work;
    # `note` where only some commands are affected, or it could not be checked
    state: Literal["ok", "missing", "failed", "note"]
    found: str  # what was found
    remedy: str = ""  # what to do; empty where nothing is to be done

    @property
    def is_bad(self) -> bool:
        """Return whether pa10cal does not run because of it."""
        return self.state in ("missing", "failed")


def doctor() -> None:
    """Check this machine: what pa10cal needs, what is missing, and what to do about it.

    A small campaign that comes with pa10cal is taken from raw files to a model too, in at most
    thirty seconds. Exit code 2 where something that is needed is missing, or that failed.

    Examples:
        pa10cal doctor
    """
    checks = list(examine())
    width = max(len(check.name) for check in checks)
    for check in checks:
        mark = check.state.upper() if check.is_bad else check.state
        print(f"{mark:<7} {check.name:<{width}}  {check.found}")
        if check.remedy:
            print(f"{'':<7} {'':<{width}}  → {check.remedy}")
    bad = [check.name for check in checks if check.is_bad]
    if bad:
        raise SettingsError(
            f"{len(bad)} of {len(checks)} checks failed",
            where="this machine",
            value=", ".join(bad),
            allowed="all of them passed",
            remedy="see the arrows above",
        )


def examine() -> Iterator[Check]:
    """Look at Python, libraries, rules, memory, disk and cores, and calibrate once."""
    missing = []
    for check in _requirements():
        if check.state == "missing":
            missing.append(check.name)
        yield check
    if missing:
        yield Check("calibration", "note", f"not tried: {', '.join(missing)} missing")
    else:
        yield _calibration()


def _requirements() -> Iterator[Check]:
    """Yield a check of each thing that a run needs."""
    yield Check("pa10cal", "ok", f"{pa10cal.__version__}, {Path(__file__).parents[1]}")
    python, least = platform.python_version(), ".".join(map(str, LEAST_PYTHON))
    if sys.version_info[:2] < LEAST_PYTHON:
        yield Check("Python", "missing", python, f"install Python {least} or newer")
    else:
        yield Check("Python", "ok", f"{python}, {sys.executable}")
    for name, (module, purpose) in LIBRARIES.items():
        yield _library(name, module, purpose)
    yield from _versions()
    try:
        yield Check("workflow", "ok", str(workflow_folder()))
    except Pa10calError as error:
        yield Check("workflow", "missing", error.what, error.remedy)
    if shell := shutil.which("bash"):
        yield Check("bash", "ok", shell)
    else:
        why = "not found; Snakemake runs the stages in it"
        yield Check("bash", "missing", why, "install bash")
    yield _memory()
    yield _disk(Path.cwd())
    yield _cores()


def _memory() -> Check:
    size = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with suppress(OSError, ValueError):  # no container, or `max`: no limit
        size = min(size, float(int((CGROUP / "memory.max").read_text("ascii"))))
    if size < MEMORY_BYTES:
        remedy = "large campaigns may need more; use --cores 1"
        return Check("memory", "note", f"{size / 1e9:.1f} GB", remedy)
    return Check("memory", "ok", f"{size / 1e9:.1f} GB")


def _cores() -> Check:
    cores = float(len(os.sched_getaffinity(0)))
    with suppress(OSError, ValueError):  # no container, or `max`: no limit
        quota_us, period_us = (CGROUP / "cpu.max").read_text("ascii").split()
        cores = min(cores, int(quota_us) / int(period_us))
    return Check("cores", "ok", f"{cores:g} may be used")


def _library(name: str, module: str, purpose: str) -> Check:
    try:
        if find_spec(module) is None:
            raise PackageNotFoundError(name)
        return Check(name, "ok", f"{version(name)}, for {purpose}")
    except PackageNotFoundError:
        why = f"not installed; it is for {purpose}"
        if module in EXTRAS:
            return Check(name, "note", why, how_to_install(module))
        return Check(name, "missing", why, f"pip install {name}")


def _versions() -> Iterator[Check]:
    """Compare what is installed with requirements.lock, where there is one beside the package.

    Only a copy of the repository has it: developers reproduce results to the last digit by it.
    `users.lock`, which remedies name, has what users install.
    """
    lock = Path(__file__).parents[3] / "requirements.lock"
    if not lock.is_file():
        return
    # Versions by normalised name; a package with several, by platform, is not compared.
    pins: dict[str, set[str]] = {}
    for name, pin in re.findall(r"^([\w.-]+)==(\S+)", lock.read_text("utf-8"), re.MULTILINE):
        pins.setdefault(re.sub(r"[-_.]+", "-", name).lower(), set()).add(pin)
    other = []
    for name in LIBRARIES:
        pinned = pins.get(re.sub(r"[-_.]+", "-", name).lower(), set())
        with suppress(PackageNotFoundError):
            if len(pinned) == 1 and version(name) not in pinned:
                other.append(f"{name} {version(name)} for {min(pinned)}")
    if not other:
        yield Check("versions", "ok", "those of requirements.lock")
        return
    why = f"not those of requirements.lock: {', '.join(other)}"
    remedy = "results may differ in their last digits; make setup installs the pinned versions"
    yield Check("versions", "note", why, remedy)


def _disk(here: Path) -> Check:
    free = shutil.disk_usage(here).free
    try:
        with tempfile.TemporaryFile(dir=here):
            pass
    except OSError as error:
        remedy = "work in a folder that may be written to, or give one with --out"
        return Check("disk", "note", f"{here} cannot be written to: {error.strerror}", remedy)
    if free < DISK_BYTES:
        return Check("disk", "note", f"{free / 1e9:.1f} GB free in {here}", "make room")
    return Check("disk", "ok", f"{free / 1e9:.0f} GB free in {here}")


def _calibration() -> Check:
    """Take a shipped campaign from raw files to a model, in a process that may be killed by it."""

    def failed(why: str, remedy: str) -> Check:
        return Check("calibration", "failed", why, remedy)

    folder = workflow_folder() / CAMPAIGN
    if not folder.is_dir():
        return failed(f"{folder} is not there", "install pa10cal anew: it is incomplete")
    try:
        with tempfile.TemporaryDirectory(prefix="pa10cal-doctor-") as results:
            words = ["chain", "--campaign-dir", str(folder), "--results", results]
            done = subprocess.run(
                [sys.executable, "-m", "pa10cal", *words],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=LIMIT_S,
                check=False,
            )
            if name := _killed_by(done.returncode, Path(results, "chain.json")):
                remedy = REMEDY_BY_SIGNAL.get(name, LOCKED)
                return failed(f"{CAMPAIGN.name}: killed by {name}", remedy)
            if done.returncode:
                lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
                remedy = FREE_SPACE if lines[-1].endswith(MAKE_ROOM) else LOCKED
                return failed(f"{CAMPAIGN.name}: {lines[-1][:300]}", remedy)
            outcome = json.loads(Path(results, "chain.json").read_text("utf-8"))
            if not Path(results, "model/model.yaml").is_file():
                return failed(f"{CAMPAIGN.name}: no model was written", LOCKED)
    except subprocess.TimeoutExpired:
        why = f"{CAMPAIGN.name}: not done in {LIMIT_S} s; three are usual"
        if os.getloadavg()[0] > len(os.sched_getaffinity(0)):
            return Check("calibration", "note", why, "other programs take all cores: try again")
        return failed(why, f"it hangs, or this machine is very slow: {LOCKED}")
    except OSError as error:
        return failed(f"no temporary files: {error.strerror}", FREE_SPACE)
    error_mm = outcome["after_mm"]
    if error_mm is None or not abs(error_mm - KNOWN_MM) < NEAR_MM:
        why = f"{CAMPAIGN.name}: {error_mm} mm at held-out poses in place of {KNOWN_MM} mm"
        return failed(why, f"the numbers of this machine are wrong: {LOCKED}")
    what = f"{error_mm:.3f} mm at held-out poses, as it should be"
    return Check("calibration", "ok", f"{CAMPAIGN.name}, raw files to model: {what}")


def _killed_by(code: int, outcome: Path) -> str:
    """Return the signal that killed `chain`, or the child in which it runs stages; else nothing.

    Args:
        code: its exit code, minus the number of a signal.
        outcome: `chain.json`, whose message has the signal that killed the child.
    """
    if code < 0:
        return signal_name(-code)
    with suppress(OSError, ValueError, AttributeError):  # none was written
        record = json.loads(outcome.read_text("utf-8"))
        if record.get("status") == "ended" and (found := KILLED_BY.search(record["message"])):
            return signal_name(int(found[1]))
    return ""
