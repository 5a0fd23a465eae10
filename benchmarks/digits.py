"""Runs the tests that compare digits as other processors, languages and time zones would.

    python -m benchmarks.digits [--cores 2] [arguments of pytest, such as tests/montecarlo]

OpenBLAS and numpy choose their kernels by the processor; both can be told to take older ones. What
this machine cannot do is said and left out.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
#: Prints the kernels that OpenBLAS takes, then what numpy could take beyond its baseline.
ASK = """
import ctypes
import numpy.linalg
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__
names = [f"{p}openblas_get_corename{s}" for p in ("scipy_", "") for s in ("64_", "")]
core = "unknown"
for path in {line.split()[-1] for line in open("/proc/self/maps") if "openblas" in line}:
    library = ctypes.CDLL(path)
    for name in names:
        if hasattr(library, name):
            call = getattr(library, name)
            call.restype = ctypes.c_char_p
            core = call().decode()
print(core)
print(*(name for name in __cpu_dispatch__ if __cpu_features__[name]))
"""


class Other(NamedTuple):
    """Another machine, as far as this one can be it."""

    kernel: str  # of OpenBLAS
    plain: bool  # numpy without AVX2 and what came after it
    language: str
    zone: str


#: SSE, AVX and AVX2. Zen has the kernels of Haswell in builds without its own.
OTHERS = (
    Other("Nehalem", True, "de_DE", "Asia/Kolkata"),
    Other("Sandybridge", True, "C", "UTC"),
    Other("Haswell", False, "tr_TR", "Asia/Kolkata"),
    Other("Zen", False, "tr_TR", "Asia/Kolkata"),
)


def ask(**environment: str) -> tuple[str, str]:
    """Return OpenBLAS' kernels in this environment, and numpy's features beyond its baseline."""
    words, env = [sys.executable, "-c", ASK], {**os.environ, **environment}
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=True)
    core, features, *_ = [*done.stdout.splitlines(), ""]
    return core, features


def language(name: str, folder: Path) -> dict[str, str] | None:
    """Return the environment of a language, made in a folder where the machine lacks it."""
    if name == "C":
        return {"LC_ALL": "C"}
    found = {"LC_ALL": f"{name}.UTF-8"}
    words = ["locale", "-a"] if shutil.which("locale") else ["true"]
    listed = subprocess.run(words, capture_output=True, text=True, check=False).stdout.split()
    if f"{name}.utf8" in listed:
        return found
    place = folder / f"{name}.UTF-8"
    if not place.is_dir():
        if not shutil.which("localedef"):
            return None
        make = ["localedef", "-i", name, "-f", "UTF-8", str(place)]
        if subprocess.run(make, capture_output=True, check=False).returncode:
            return None
    return {**found, "LOCPATH": str(folder)}


def environments(folder: Path) -> list[tuple[str, dict[str, str]]]:
    """Return what there is to run, each with its name, and say what is left out."""
    found: list[tuple[str, dict[str, str]]] = []
    done: set[str] = set()
    for other in OTHERS:
        core, features = ask(OPENBLAS_CORETYPE=other.kernel)
        if core != other.kernel or core in done:
            why = f"OpenBLAS takes the kernels of {core} here"
            print(f"{other.kernel}: left out, {why}", flush=True)
            continue
        done.add(core)
        name, env = [other.kernel], {"OPENBLAS_CORETYPE": other.kernel}
        if other.plain:
            name.append(f"numpy without {features or 'anything beyond its baseline'}")
            env["NPY_DISABLE_CPU_FEATURES"] = features
        spoken = language(other.language, folder)
        if spoken is None:
            print(f"{other.language}: left out, no such locale and no localedef", flush=True)
        name.append(other.language if spoken else "language of the machine")
        env |= {**(spoken or {}), "TZ": other.zone}
        found.append((", ".join([*name, other.zone]), env))
    return found


def main() -> int:
    """Run the tests in every environment; 1 where one fails."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.digits", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--cores", type=int, default=2)
    chosen, more = parser.parse_known_args()
    words = [sys.executable, "-m", "pytest", "-q", "-m", "digits", "--ignore", "tests/browser"]
    words += ["-n", str(chosen.cores), "--dist", "loadfile", "--no-loadscope-reorder", *more]
    failed = []
    with tempfile.TemporaryDirectory(prefix="pa10cal-locales-") as folder:
        for name, env in environments(Path(folder)):
            print(f"{name} ...", flush=True)
            begin = time.monotonic()
            code = subprocess.run(
                words, cwd=ROOT, env={**os.environ, **env}, check=False
            ).returncode
            print(f"{name}: {'FAILED' if code else 'ok'}, {time.monotonic() - begin:.0f} s")
            failed += [name] if code else []
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
