"""A small campaign whose run is killed at random moments, and then called once more.

    python -m benchmarks.kills [--trials 50] [--seed 1] [--campaign examples/irb120-points]

Each trial runs in a folder of its own until a moment drawn over the time of an undisturbed run;
then `kill -9` ends the command, Snakemake, one of all its processes, or all of them at once. The
next call must end with the bytes of the undisturbed run, with nothing left over and nothing alive
of the killed one when it has ended.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

from pa10cal.campaign.description import read_description

#: What is killed: the command, its Snakemake, one process drawn from all, all at once.
VICTIMS = ("command", "snakemake", "one", "all")
_SOON_S = 10.0


def main() -> int:
    """Run the trials and print what came of them; return 1 where one went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--campaign", type=Path, default=Path("examples/irb120-points"))
    given = parser.parse_args()
    rng = random.Random(given.seed)
    name = read_description(given.campaign).name
    wrong, killed = [], Counter[str]()
    with tempfile.TemporaryDirectory(prefix="kills-") as place:
        began = time.monotonic()
        if run(given.campaign, Path(place, "whole")).wait() != 0:
            raise SystemExit("the undisturbed run fails")
        lasts = time.monotonic() - began
        whole = contents(Path(place, "whole", name))
        for k in range(given.trials):
            victim, moment = VICTIMS[k % len(VICTIMS)], rng.uniform(0.0, lasts)
            found = trial(given.campaign, Path(place, str(k)), victim, moment, rng, whole)
            killed[victim] += 1
            wrong += [f"trial {k}: {victim} at {moment:.2f} s: {what}" for what in found]
            print(f"{k + 1} of {given.trials}: {victim} at {moment:.1f} s: {found or 'equal'}")
            shutil.rmtree(Path(place, str(k)))
    print(f"{given.trials} runs killed ({dict(killed)}), {len(wrong)} went wrong")
    print("\n".join(wrong), end="\n" if wrong else "")
    return 1 if wrong else 0


def trial(
    campaign: Path,
    out: Path,
    victim: str,
    moment: float,
    rng: random.Random,
    whole: dict[str, bytes],
) -> list[str]:
    """Kill one run and call it once more; return what is not as it should be."""
    first, ended = run(campaign, out), True
    while ended:  # a quicker run than the undisturbed one, on a machine that had more to do then
        began = time.monotonic()
        try:
            first.wait(moment)
        except subprocess.TimeoutExpired:
            ended = False
        else:
            moment = rng.uniform(0.0, time.monotonic() - began)
            shutil.rmtree(out)
            first = run(campaign, out)
    every = tree(first.pid)
    chosen = {
        "command": every[:1],
        "snakemake": every[1:2],
        "one": [rng.choice(every)] if every else [],
        "all": every,
    }[victim]
    for pid, _ in chosen:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    first.wait()
    again = run(campaign, out)
    wrong = [] if again.wait() == 0 else [f"the next run ends with {again.returncode}"]
    end = time.monotonic() + _SOON_S
    while (alive := [pid for pid, start in every if lives(pid, start)]) and time.monotonic() < end:
        time.sleep(0.1)
    wrong += [f"process {pid} lives on" for pid in alive]
    wrong += [f"left: {path}" for path in out.rglob("*.partial.*")]
    name = next(iter(whole)).split("/")[0]
    there = contents(out / name)
    wrong += [f"differs: {path}" for path in sorted(whole) if there.get(path) != whole[path]]
    return wrong + [f"more: {path}" for path in sorted(set(there) - set(whole))]


def run(campaign: Path, out: Path) -> subprocess.Popen[bytes]:
    """Start the run of a campaign, on one core and silent."""
    words = [sys.executable, "-m", "pa10cal", "run", campaign, "--out", out, "--cores", "1"]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(words, stdout=quiet, stderr=quiet)


def contents(results: Path) -> dict[str, bytes]:
    """Return the bytes of all results of a campaign by their paths; logs are none."""
    paths = (path for path in results.rglob("*") if path.is_file() and "logs" not in path.parts)
    return {str(path.relative_to(results.parent)): path.read_bytes() for path in paths}


def tree(pid: int) -> list[tuple[int, str]]:
    """Return a process and all that descend from it, itself first, each with when it began."""
    parents = {}
    for place in Path("/proc").glob("[0-9]*"):
        if found := stat(int(place.name)):
            parents[int(place.name)] = (int(found[1]), found[19])

    def below(root: int) -> list[tuple[int, str]]:
        children = [each for each, (parent, _) in parents.items() if parent == root]
        return [(root, parents[root][1]), *(each for child in children for each in below(child))]

    return below(pid) if pid in parents else []


def lives(pid: int, began: str) -> bool:
    """Return whether a process is there, no zombie and not another one of its number."""
    found = stat(pid)
    return bool(found) and found[0] != "Z" and found[19] == began


def stat(pid: int) -> list[str]:
    """Return what the system says of a process, from its state on; nothing of one that is gone."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return []
    return text.rpartition(")")[2].split()


if __name__ == "__main__":
    sys.exit(main())
