"""What tests of several rooms have in common, and the order in which files are tested.

Modules that import the program are imported where they are needed: the process that shares tests
out to others needs none, and the others wait for it to start.
"""

from __future__ import annotations

import os

# Before numpy is imported: its threads only get in each other's way in matrices of this size.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import gc
import inspect
import re
from bisect import bisect_left
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from functools import cache
from linecache import getlines
from pathlib import Path
from types import CodeType
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings as hypothesis_settings

from attacks import Attack, Forking
from built_once import built_once
from drawn_examples import use_few
from snakemake_calls import Snakemake

if TYPE_CHECKING:
    from made_up_mistakes import Own
    from made_up_touches import RawCampaign

# A change is judged by the same examples each time; at a desk every run looks at new ones.
hypothesis_settings.register_profile("same_examples", derandomize=True)
if os.environ.get("CI"):
    hypothesis_settings.load_profile("same_examples")

#: Files that come first: a long one at the end would keep one worker alone, and what is built once
#: a session is there when the others ask for it.
FIRST = (
    "tests/test_workflow.py",
    "tests/figures/test_discovery_pictures.py",
    "tests/discovery/evidence/test_discover.py",
    "tests/discovery/blocked_cv/test_discover.py",
    "tests/test_interface.py",
    "tests/test_examples.py",
    "tests/test_datasets_rules.py",
    "tests/running/",
)

#: Equal numbers or bytes, and tolerances of rounding: what another processor's kernels may change.
DIGITS = re.compile(r"array_equal|read_bytes\(\)|tobytes\(|1e-1[0-9]\b|finfo")


def pytest_configure(config: pytest.Config) -> None:
    """Try properties with fewer examples where slow tests are left out."""
    if config.getoption("markexpr") == "not slow":
        use_few()


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """Leave all that was collected out of garbage collection.

    Half a million objects of tests and libraries stay to the end: looking through them again and
    again takes a twelfth of the time of all tests.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files first that are named so; workers take files in the order of the items.

    Tests that compare digits get their marker here, so that none is forgotten; so do cases of a
    test that is `slow_but_one_in` some number.
    """
    for item in items:
        if (one := item.get_closest_marker("slow_but_one_in")) and not _is_one_in(item, *one.args):
            item.add_marker(pytest.mark.slow)
        function = getattr(item, "function", None)
        if function is not None:
            drawn = getattr(function, "hypothesis", None)
            written = inspect.unwrap(drawn.inner_test if drawn else function)
            if _compares_digits(written.__code__):
                item.add_marker(pytest.mark.digits)
    items.sort(key=lambda item: not item.nodeid.startswith(FIRST))


def _is_one_in(item: pytest.Item, number: int) -> bool:
    """Take the first of each so many cases of a test, whatever is selected."""
    return max(item.callspec.indices.values()) % number == 0


@cache
def _compares_digits(code: CodeType) -> bool:
    """Look at the lines of a function as they stand: asking `inspect` for them takes seconds."""
    lines = _lines_with_digits(code.co_filename)
    following = lines[bisect_left(lines, code.co_firstlineno) :][:1]
    return bool(following) and following[0] <= _last_line(code)


@cache
def _lines_with_digits(path: str) -> list[int]:
    """Return the lines of a file, from 1, that compare digits."""
    return [number for number, line in enumerate(getlines(path), 1) if DIGITS.search(line)]


def _last_line(code: CodeType) -> int:
    """Return the last line of a function, those of functions inside it too."""
    inside = (_last_line(each) for each in code.co_consts if isinstance(each, CodeType))
    ends = (end for _, end, _, _ in set(code.co_positions()) if end is not None)
    return max(*inside, *ends, code.co_firstlineno)


@pytest.fixture
def own(tmp_path_factory, tmp_path, monkeypatch) -> Own:
    """A right campaign with files of its own, in which no workflow is ever started."""
    from made_up_mistakes import own_campaign

    def never(*_):
        raise AssertionError("the workflow was started")

    monkeypatch.setattr("pa10cal.running.workflow.run_workflow", never)
    right = built_once(tmp_path_factory, "right_campaign", own_campaign)
    return right.copy(tmp_path / "zelle")


@pytest.fixture(scope="session")
def ipa_data() -> Path:
    """The public UR10 data set ipa-robot-accuracy, where there is a copy of it."""
    named = os.environ.get("PA10CAL_IPA_DATA")
    folder = Path(named or Path(__file__).parents[2] / "shared/data/ipa-robot-accuracy")
    if not folder.is_dir():
        if named:
            pytest.fail(f"PA10CAL_IPA_DATA names no folder: {named}")
        pytest.skip("no copy of ipa-robot-accuracy here: PA10CAL_IPA_DATA names none")
    return folder


@pytest.fixture(scope="session")
def call_snakemake(tmp_path_factory) -> Iterator[Snakemake]:
    """Call Snakemake, which is started once."""
    snakemake = Snakemake(tmp_path_factory.mktemp("snakemake"))
    yield snakemake
    snakemake.close()


@pytest.fixture(scope="session")
def forking(tmp_path_factory) -> Iterator[Forking]:
    """A process that forks for each attack, started once."""
    process = Forking(tmp_path_factory.mktemp("attacks"))
    yield process
    process.close()


@pytest.fixture
def attack(forking, tmp_path, request) -> Attack:
    """A folder for what an attacker sends, and commands in limited processes; see `attacks`."""
    return Attack(forking, tmp_path / "sent", tmp_path / "not-sent", request.node.name)


@pytest.fixture
def raw_campaign(tmp_path: Path, made_up_campaign: RawCampaign) -> RawCampaign:
    """Touched balls (`made_up_touches`), in files that a test may spoil."""
    return replace(deepcopy(made_up_campaign), folder=tmp_path / "made-up")


@pytest.fixture(scope="session")
def made_up_campaign() -> RawCampaign:
    """The raw campaign before a test spoils its copy."""
    from made_up_touches import touched_campaign

    return touched_campaign()
