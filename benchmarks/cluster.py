"""A fleet on the Slurm that `.ci/slurm start` brings up, a worker killed in mid-run.

    .ci/slurm start && python -m benchmarks.cluster [--campaigns 60]

The fleet is run without Slurm first. Then it is run on two workers; when a part of the campaigns is
done the one with jobs is killed as if its power were cut, and comes back a minute later. Every file
of the results must have the bytes of the run without.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.fleet import ROOT, simulate
from pa10cal.commands.command_line import limit_threads

#: Part of the campaigns that are done when a worker dies, and how long it is away.
_PART, _AWAY_S = 0.3, 60.0
_WORKER = "worker1"
_KEPT = {"logs", ".snakemake", ".pa10cal"}


def main() -> int:
    """Run the fleet twice and compare; 1 where anything differs."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--campaigns", type=int, default=60)
    count = asked.parse_args().campaigns
    limit_threads()
    # Not under /tmp: what the workers see there may be another folder.
    with tempfile.TemporaryDirectory(dir=Path.home(), prefix="cluster-") as place:
        raw = Path(place, "raw")
        simulate(raw, count)
        begun = time.monotonic()
        if started(raw, Path(place, "local"), "--cores", "2").wait() != 0:
            raise SystemExit("the run without Slurm fails")
        local_s, begun = time.monotonic() - begun, time.monotonic()
        run = started(raw, Path(place, "slurm"), "--profile", "slurm")
        killed = kill_worker(Path(place, "slurm"), int(_PART * count), run)
        failed = run.wait() != 0
        slurm_s = time.monotonic() - begun
        local, slurm = (contents(Path(place, name)) for name in ("local", "slurm"))
    unlike = sorted(name for name in {*local, *slurm} if local.get(name) != slurm.get(name))
    print(f"{count} campaigns: {local_s:.0f} s without Slurm, {slurm_s:.0f} s on two workers")
    print(f"killed with {killed} campaigns done; {len(local)} files, {len(unlike)} unlike")
    print("\n".join(unlike[:20]), end="\n" if unlike else "")
    return int(failed or bool(unlike) or killed is None)


def started(raw: Path, out: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start the fleet."""
    words = [sys.executable, "-m", "pa10cal", "fleet", str(raw / "arms.csv"), *options]
    return subprocess.Popen([*words, "--raw-dir", str(raw), "--out", str(out)])


def kill_worker(out: Path, done: int, run: subprocess.Popen[bytes]) -> int | None:
    """Kill the worker once so many campaigns are done, and let it come back; None: it was late."""
    while run.poll() is None:
        there = len(list(out.glob("*/chain.json")))
        if there >= done:
            slurm("kill", _WORKER)
            time.sleep(_AWAY_S)
            slurm("revive", _WORKER)
            return there
        time.sleep(0.2)
    return None


def slurm(*words: str) -> None:
    """Call `.ci/slurm`."""
    subprocess.run([str(ROOT / ".ci/slurm"), *words], check=True)


def contents(results: Path) -> dict[str, bytes]:
    """Return every file of a results folder but logs and what is kept about the run itself."""
    return {
        str(path.relative_to(results)): path.read_bytes()
        for path in sorted(results.rglob("*"))
        if path.is_file() and not _KEPT & {*path.relative_to(results).parts}
    }


if __name__ == "__main__":
    sys.exit(main())
