"""Command line: freeze what studies gave, or compare a run with what is frozen."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.goldens.compare import Comparison, Intended, compare, read_intended
from benchmarks.goldens.digest import digest_folder, read_record, write_record
from pa10cal.errors import Pa10calError

HERE = Path(__file__).parent


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; exit code 0 equal, 1 a difference that is not intended, 2 refused."""
    words = _parser().parse_args(argv)
    try:
        code: int = words.run(words)
    except Pa10calError as error:
        print(error, file=sys.stderr)
        return 2
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.goldens", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    freeze = commands.add_parser("freeze", help="write the frozen record of each study")
    freeze.set_defaults(run=_freeze)
    against = commands.add_parser("compare", help="compare results with the frozen records")
    against.set_defaults(run=_compare)
    for command in (freeze, against):
        command.add_argument(
            "studies", nargs="+", type=_study, metavar="STUDY=RESULTS_DIR", help="default=results"
        )
        command.add_argument("--records", type=Path, default=HERE, help="folder of frozen records")
    against.add_argument("--only", type=re.compile, help="regular expression of paths to compare")
    against.add_argument(
        "--partial", action="store_true", help="files that the run lacks are no difference"
    )
    against.add_argument(
        "--against", type=Path, help="compare with this results folder, not with the record"
    )
    against.add_argument(
        "--differences", type=Path, default=HERE / "differences.md", help="intended differences"
    )
    against.add_argument("--added", action="store_true", help="list added keys one by one")
    return parser


def _study(text: str) -> tuple[str, Path]:
    name, equals, folder = text.partition("=")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or not equals or not folder:
        raise argparse.ArgumentTypeError(f"{text!r}: needed: STUDY=RESULTS_DIR")
    return name, Path(folder)


def _freeze(words: argparse.Namespace) -> int:
    words.records.mkdir(parents=True, exist_ok=True)
    for study, folder in words.studies:
        digest = digest_folder(folder)
        path = words.records / f"{study}.json.gz"
        write_record(digest, path)
        keys = sum(len(file) for file in digest.values())
        print(f"{study}: {len(digest)} files, {keys} keys, {path.stat().st_size / 1e3:.0f} kB")
    return 0


def _compare(words: argparse.Namespace) -> int:
    intended = read_intended(words.differences)
    code = 0
    for study, folder in words.studies:
        if words.against:
            frozen = digest_folder(words.against)
        else:
            frozen = read_record(words.records / f"{study}.json.gz")
        run = digest_folder(folder)
        if words.only:
            run = {path: file for path, file in run.items() if words.only.search(path)}
        comparison = compare(frozen, run, intended, partial=words.partial or bool(words.only))
        _print(study, comparison, added=words.added)
        code = max(code, int(bool(comparison.differences)))
    _print_intended(intended)
    return code


def _print(study: str, comparison: Comparison, *, added: bool) -> None:
    for path, lines in comparison.differences.items():
        for line in lines:
            print(f"{study}: {path}: {line}")
    for path in comparison.added_files:
        print(f"{study}: added file {path}")
    for path, keys in comparison.added_keys.items():
        named = ", ".join(keys if added else keys[:4]) + (" ..." if keys[4:] and not added else "")
        print(f"{study}: {path}: {len(keys)} added keys: {named}")
    count = sum(len(lines) for lines in comparison.differences.values())
    print(
        f"{study}: {comparison.files} files, {comparison.keys} keys compared;"
        f" differences that are not intended: {count}"
    )


def _print_intended(intended: list[Intended]) -> None:
    for row in intended:
        if row.used:
            arrow = f" -> {row.new}" if row.new else ""
            where = f" in {row.files.pattern}" if row.files.pattern else ""
            print(
                f"intended: {row.what} {row.old.pattern}{arrow}{where} ({row.used}): {row.reason}"
            )


if __name__ == "__main__":
    sys.exit(main())
