"""What several tests look at, built once a session however many workers run it."""

from __future__ import annotations

import fcntl
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

T = TypeVar("T")


def built_once(
    tmp_path_factory: pytest.TempPathFactory, name: str, build: Callable[[Path], T]
) -> T:
    """Return what the first worker to ask for a name built; the others wait and unpickle it.

    Args:
        tmp_path_factory: of pytest; workers have folders of their own beside each other.
        name: of what is built, and of its folder.
        build: given the folder, which is there and is shared: nobody writes to it afterwards.
    """
    session = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        session = session.parent
    folder = session / "built_once" / name
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder.with_suffix(".pickle")
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if kept.exists():
            return pickle.loads(kept.read_bytes())
        built = build(folder)
        kept.write_bytes(pickle.dumps(built))
        return built
