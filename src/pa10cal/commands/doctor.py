"""Command `doctor`, which imports nothing that may be missing."""

from __future__ import annotations

import os
import platform
import re
import shutil
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
from pa10cal.running.workflow import workflow_folder

LEAST_PYTHON = (3, 11)
#: A run of the largest campaigns needs less memory than this, and leaves less on the disk [bytes].
MEMORY, DISK = 2e9, 1e9
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
    "snakemake": ("snakemake", "pa10cal run, the workflow"),
    "matplotlib": ("matplotlib", "figures"),
    "Jinja2": ("jinja2", "reports"),
    "plotly": ("plotly", "figures of reports"),
}


class Check(NamedTuple):
    """One thing that was looked at."""

    name: str
    # `ok`, `missing` where something that is needed is not there, else `note`
    state: Literal["ok", "missing", "note"]
    found: str  # what was found
    remedy: str = ""  # what to do; empty where nothing is to be done


def doctor() -> None:
    """Check this machine: what pa10cal needs, what is missing, and what to do about it.

    Exit code 2 where something that is needed is missing.

    Examples:
        pa10cal doctor
    """
    checks = list(examine())
    width = max(len(check.name) for check in checks)
    for check in checks:
        mark = check.state.replace("missing", "MISSING")
        print(f"{mark:<7} {check.name:<{width}}  {check.found}")
        if check.remedy:
            print(f"{'':<7} {'':<{width}}  → {check.remedy}")
    missing = [check.name for check in checks if check.state == "missing"]
    if missing:
        raise SettingsError(
            f"{len(missing)} of {len(checks)} checks failed",
            where="this machine",
            value=", ".join(missing),
            allowed="all of them passed",
            remedy="see the arrows above",
        )


def examine() -> Iterator[Check]:
    """Look at Python, libraries, rules, memory, disk and cores."""
    yield Check("pa10cal", "ok", f"{pa10cal.__version__}, {Path(__file__).parents[1]}")
    python, least = platform.python_version(), ".".join(map(str, LEAST_PYTHON))
    yield (
        Check("Python", "missing", python, f"install Python {least} or newer")
        if sys.version_info[:2] < LEAST_PYTHON
        else Check("Python", "ok", f"{python}, {sys.executable}")
    )
    yield from (_library(name, *what) for name, what in LIBRARIES.items())
    yield from _versions()
    try:
        yield Check("workflow", "ok", str(workflow_folder()))
    except Pa10calError as error:
        yield Check("workflow", "missing", error.what, error.remedy)
    shell, why = shutil.which("bash"), "not found; Snakemake runs the stages in it"
    yield Check("bash", "ok", shell) if shell else Check("bash", "missing", why, "install bash")
    size = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    few = size < MEMORY
    remedy = "large campaigns may need more; use --cores 1" if few else ""
    yield Check("memory", "note" if few else "ok", f"{size / 1e9:.1f} GB", remedy)
    yield _disk(Path.cwd())
    yield Check("cores", "ok", f"{len(os.sched_getaffinity(0))} may be used")
    yield Check("threads", "ok", "one for BLAS in each process, as the commands set it")


def _library(name: str, module: str, used: str) -> Check:
    try:
        if find_spec(module) is None:
            raise PackageNotFoundError(name)
        return Check(name, "ok", f"{version(name)}, for {used}")
    except PackageNotFoundError:
        why = f"not installed; it is for {used}"
        if module in EXTRAS:
            return Check(name, "note", why, how_to_install(module))
        return Check(name, "missing", why, f"pip install {name}")


def _versions() -> Iterator[Check]:
    """Compare what is installed with requirements.lock, where there is one beside the package."""
    lock = Path(__file__).parents[3] / "requirements.lock"
    if not lock.is_file():
        return
    # Names as an index compares them; of those that are pinned twice, by platform, none is judged.
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
    if free < DISK:
        return Check("disk", "note", f"{free / 1e9:.1f} GB free in {here}", "make room")
    return Check("disk", "ok", f"{free / 1e9:.0f} GB free in {here}")
