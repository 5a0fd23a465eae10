"""Judge many mutations, and print what became of them: `python -m benchmarks.fuzz --count 20000`.

Mutation k of a seed is the same whenever it is made: `--only pose:17` judges one again.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path

from pa10cal.commands.command_line import limit_threads

limit_threads()

import numpy as np  # noqa: E402 - after the threads are limited

from benchmarks.fuzz.corpus import CAMPAIGNS, Original  # noqa: E402
from benchmarks.fuzz.judge import Outcome, judged_campaign, judged_settings  # noqa: E402
from benchmarks.fuzz.mutations import mutated  # noqa: E402
from benchmarks.fuzz.readers import READERS, judged_file  # noqa: E402

SETTINGS = "settings"
_CONFIG = Path(__file__).parents[2] / "config.yaml"
#: Of five mutations one is of the settings, the others of one campaign after the other.
KINDS = (SETTINGS, *CAMPAIGNS)
#: Files that others' libraries read, asked for by name.
EVERY_KIND = (*KINDS, *READERS)


def main() -> int:
    """Judge mutations; 1 where one ends in a fault, a hang, or a wrong result graded good."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--count", type=int, default=500, help="mutations in all")
    asked.add_argument("--first", type=int, default=0, help="number of the first of each kind")
    asked.add_argument("--seed", type=int, default=2008)
    asked.add_argument("--kinds", nargs="+", choices=EVERY_KIND, default=KINDS)
    asked.add_argument("--only", help="one mutation, such as pose:17; its files go to --keep")
    asked.add_argument("--keep", type=Path, help="folder for the files of --only")
    given = asked.parse_args()
    if given.only:
        kind, number = given.only.split(":")
        return _one(kind, int(number), given.seed, given.keep)
    words: Counter[tuple[str, str]] = Counter()
    longest, bad = 0.0, 0
    for kind in given.kinds:
        original = Original.simulated(kind) if kind in CAMPAIGNS else None
        for number in range(given.first, given.first + given.count // len(given.kinds)):
            done, found = _judged(kind, number, given.seed, original)
            words[kind, found.word] += 1
            longest = max(longest, found.seconds)
            if found.bad:
                bad += 1
                print(f"{kind}:{number}: {found.word}: {done}\n{found.why}", flush=True)
    for (kind, word), count in sorted(words.items()):
        print(f"{kind:10} {word:16} {count:6}")
    print(f"{words.total()} mutations, {bad} that must not be, longest {longest:.1f} s")
    return int(bad > 0)


def _judged(kind: str, number: int, seed: int, original: Original | None) -> tuple[str, Outcome]:
    rng = np.random.default_rng([seed, EVERY_KIND.index(kind), number])
    if kind in READERS:
        return judged_file(kind, rng)
    if original is None:
        files, done = mutated(rng, {_CONFIG.name: _CONFIG.read_bytes()})
        return done, judged_settings(files[_CONFIG.name])
    files, done = mutated(rng, original.files)
    return done, judged_campaign(files, original)


def _one(kind: str, number: int, seed: int, keep: Path | None) -> int:
    original = Original.simulated(kind) if kind in CAMPAIGNS else None
    if keep is not None and original is not None:
        rng = np.random.default_rng([seed, KINDS.index(kind), number])
        keep.mkdir(parents=True, exist_ok=True)
        for name, content in mutated(rng, original.files)[0].items():
            (keep / name).write_bytes(content)
    done, found = _judged(kind, number, seed, original)
    print(f"{done}\n{found.word} {found.seconds:.2f} s\n{found.why}")
    return int(found.bad)


if __name__ == "__main__":
    sys.exit(main())
