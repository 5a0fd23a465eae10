"""An environment of its own for every peer, with pinned versions, built once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PINS = Path(__file__).parent
PEERS = ("figaroh", "pybotics", "robotkinecal")

#: The package index is asked no more than this, so that no network is told soon.
_PATIENCE = ("--retries", "1", "--timeout", "20")


def build(peer: str, folder: Path, pinned: Path = PINS) -> tuple[Path | None, str]:
    """Build the environment of a peer unless it is there.

    Args:
        peer: name of the peer; its pins are in `<peer>.txt`.
        folder: where environments are kept, one subfolder each.
        pinned: folder of the pins.

    Returns:
        the interpreter and an empty text, or None and the reason in one line.
    """
    pins = pinned / f"{peer}.txt"
    place, stamp = folder / peer, folder / f"{peer}.installed"
    python = place / "bin" / "python"
    if stamp.is_file() and stamp.read_text() == pins.read_text() and python.exists():
        return python, ""
    print(f"{folder.name}: setting up {peer} (once) ...", flush=True)
    folder.mkdir(parents=True, exist_ok=True)
    install = ["-m", "pip", "--quiet", "--disable-pip-version-check", "--no-input", "install"]
    commands = (
        [sys.executable, "-m", "venv", "--clear", str(place)],
        [str(python), *install, *_PATIENCE, "--no-deps", "--requirement", str(pins)],
    )
    for command in commands:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            return None, _last_error(done.stderr or done.stdout)
    stamp.write_text(pins.read_text())
    return python, ""


def version(peer: str) -> str:
    """Return the pinned version of a peer."""
    for line in (PINS / f"{peer}.txt").read_text().splitlines():
        name, _, pinned = line.partition("==")
        if name.lower() == peer:
            return pinned
    raise LookupError(f"{peer}.txt does not pin {peer}")


def _last_error(said: str) -> str:
    """Return the last line that pip calls an error, without any address."""
    lines = [line for line in said.splitlines() if line.startswith("ERROR")] or said.splitlines()
    text = lines[-1].removeprefix("ERROR: ") if lines else "no reason given"
    return " ".join(word for word in text.split() if "://" not in word)[:160]
