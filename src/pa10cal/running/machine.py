"""What the program needs of a machine, and what is there."""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution, version
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import pa10cal
from pa10cal.errors import Pa10calError
from pa10cal.extras import EXTRAS, how_to_install
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


@dataclass(frozen=True)
class Check:
    """One thing that was looked at."""

    name: str
    # `ok`, `missing` where something that is needed is not there, else `note`
    state: Literal["ok", "missing", "note"]
    found: str  # what was found
    remedy: str = ""  # what to do; empty where nothing is to be done

    @property
    def mark(self) -> str:
        """Return its state as it is printed."""
        return {"ok": "ok", "missing": "MISSING", "note": "note"}[self.state]


def examine() -> list[Check]:
    """Look at Python, libraries, rules, memory, disk and cores."""
    return [
        Check("pa10cal", "ok", f"{pa10cal.__version__}, {Path(__file__).parents[1]}"),
        _python(),
        *(_library(name, *what) for name, what in LIBRARIES.items()),
        *_versions(),
        _rules(),
        _shell(),
        _memory(),
        _disk(),
        Check("cores", "ok", f"{len(os.sched_getaffinity(0))} may be used"),
        _threads(),
    ]


def _python() -> Check:
    found = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info[:2] < LEAST_PYTHON:
        least = ".".join(map(str, LEAST_PYTHON))
        return Check("Python", "missing", found, f"install Python {least} or newer")
    return Check("Python", "ok", f"{found}, {sys.executable}")


def _library(name: str, module: str, used: str) -> Check:
    try:
        if find_spec(module) is None:
            raise PackageNotFoundError(name)
        return Check(name, "ok", f"{version(name)}, for {used}")
    except PackageNotFoundError:
        told = f"not installed; it is for {used}"
        if module in EXTRAS:
            return Check(name, "note", told, how_to_install(module))
        return Check(name, "missing", told, f"pip install {name}")


def _versions() -> list[Check]:
    """Compare what is installed with requirements.lock, where there is one beside the package."""
    lock = Path(__file__).parents[3] / "requirements.lock"
    if not lock.is_file():
        return []
    pinned = dict(re.findall(r"^([\w.-]+)==(\S+)", lock.read_text(encoding="utf-8"), re.MULTILINE))
    plain = {re.sub(r"[-_.]+", "-", name).lower(): pin for name, pin in pinned.items()}
    other = []
    for name in LIBRARIES:
        try:
            installed = distribution(name).version
        except PackageNotFoundError:
            continue
        pin = plain.get(re.sub(r"[-_.]+", "-", name).lower(), installed)
        if installed != pin and lock.read_text(encoding="utf-8").count(f"\n{name}==") < 2:
            other.append(f"{name} {installed} for {pin}")
    if not other:
        return [Check("versions", "ok", "those of requirements.lock")]
    remedy = "results may differ in their last digits; make setup installs the pinned versions"
    return [
        Check("versions", "note", f"not those of requirements.lock: {', '.join(other)}", remedy)
    ]


def _rules() -> Check:
    try:
        return Check("workflow", "ok", str(workflow_folder()))
    except Pa10calError as error:
        return Check("workflow", "missing", error.what, error.remedy)


def _shell() -> Check:
    found = shutil.which("bash")
    if found is None:
        return Check(
            "bash", "missing", "not found; Snakemake runs the stages in it", "install bash"
        )
    return Check("bash", "ok", found)


def _memory() -> Check:
    size = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    state: Literal["ok", "note"] = "ok" if size >= MEMORY else "note"
    remedy = "" if state == "ok" else "large campaigns may need more; use --cores 1"
    return Check("memory", state, f"{size / 1e9:.1f} GB", remedy)


def _disk() -> Check:
    here = Path.cwd()
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


def _threads() -> Check:
    return Check("threads", "ok", "one for BLAS in each process, as the commands set it")
