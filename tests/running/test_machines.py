"""The real command with users without a home, full disks, and runs beside each other."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pa10cal.running.run_lock import WORK_FOLDER

EXAMPLE = Path(__file__).parents[2] / "examples/irb120-points"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder of campaigns that everybody may read, and the results of undisturbed runs."""
    folder = tmp_path_factory.mktemp("machines")
    for name in ("a", "b"):
        raw = shutil.copytree(EXAMPLE, folder / "raw" / name)
        text = (raw / "campaign.yaml").read_text("utf-8")
        (raw / "campaign.yaml").write_text(text.replace("name: irb120-points", f"name: {name}"))
    for above in (folder, *folder.parents):
        if above.stat().st_uid == os.getuid() and above != Path("/"):
            above.chmod(above.stat().st_mode | 0o055)
    assert ended(start(folder, "a", "whole"))[0] == 0
    return folder


def start(place, campaign, out, *wrapped, **more):
    """Start the run of a campaign, within a command that a test wraps it in."""
    words = [sys.executable, "-m", "pa10cal", "run", place / "raw" / campaign, "--out", out]
    words = [*wrapped, *words, "--cores", "1"]
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(words, cwd=place, **piped, **more)


def ended(run):
    """Wait for a run; return its exit code and what it printed."""
    out, error = run.communicate()
    return run.returncode, out, error


def contents(results):
    """Return the bytes of all results of a campaign by their paths; logs are none."""
    paths = (path for path in results.rglob("*") if path.is_file())
    found = {path.relative_to(results): path.read_bytes() for path in paths}
    return {path: content for path, content in found.items() if path.parts[0] != "logs"}


NOBODY = {"user": "nobody", "group": 65534, "extra_groups": []}


def why_not_nobody():
    """Say why no process of the user nobody can be tried."""
    if os.getuid() != 0:
        return "only root may run a process as another user"
    try:
        code = "import pa10cal.settings"
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, **NOBODY)
    except (OSError, LookupError, subprocess.CalledProcessError):
        return "nobody may not read this installation, or is no user"
    return ""


# Not even root can make a folder in /proc.
@pytest.mark.parametrize("home", ["/nonexistent", "/proc/nonexistent"], ids=["nobody", "home"])
def test_a_user_without_home_has_the_same_results(place, tmp_path, home):
    if home == "/nonexistent" and (reason := why_not_nobody()):
        pytest.skip(reason)
    who = NOBODY if home == "/nonexistent" else {}
    tmp_path.chmod(0o777)
    env = {"HOME": home, "PATH": os.defpath}
    code, _, said = ended(start(place, "a", tmp_path / "out", env=env, **who))
    assert (code, said) == (0, "")
    assert contents(tmp_path / "out/a") == contents(place / "whole/a")
    assert list((tmp_path / "out" / WORK_FOLDER / "cache").iterdir())


def test_campaigns_of_one_folder_run_at_once_and_one_campaign_does_not(place, tmp_path):
    out = tmp_path / "out"
    one, other = start(place, "a", out), start(place, "b", out)
    until(lambda: (out / WORK_FOLDER / "raw_dirs/a/a").exists())
    code, _, said = ended(start(place, "a", out))
    assert code == 2
    assert f"{out}/a: another run is at work on these results (got 'process {one.pid} on" in said
    assert [ended(run)[0] for run in (one, other)] == [0, 0]
    assert contents(out / "a") == contents(place / "whole/a")
    assert len(contents(out / "b")) == len(contents(out / "a"))
    assert ended(start(place, "a", out))[0] == 0


def test_a_run_that_is_killed_harms_no_other_of_its_folder(place, tmp_path):
    out = tmp_path / "out"
    one, other = start(place, "a", out), start(place, "b", out)
    until(lambda: (out / "a/seed").exists())
    os.kill(one.pid, signal.SIGKILL)
    ended(one)
    assert [ended(run)[0] for run in (start(place, "a", out), other)] == [0, 0]
    assert contents(out / "a") == contents(place / "whole/a")
    assert list((out / WORK_FOLDER / "runs").iterdir()) == []


def until(found, seconds=60.0):
    """Wait until a function finds something."""
    end = time.monotonic() + seconds
    while not found() and time.monotonic() < end:
        time.sleep(0.02)
    assert found()


#: A file system of some size in a space of its own; then there is room, and what came is kept.
SMALL_DISK = """
size="$1" disk="$2" kept="$3"; shift 3
mount -t tmpfs -o size="$size" none "$disk" || exit 99
cd "$disk"
"$@" 2> "$kept/said"; echo $? > "$kept/code"
find . -name '*.partial.*' > "$kept/left"
mount -o remount,size=100m "$disk"
"$@"; code=$?
cp -r out/a "$kept/a"; exit $code
"""


@pytest.mark.parametrize("size", ["12k", "100k", "600k", "1400k"])
def test_a_full_disk_loses_nothing(place, tmp_path, size):
    disk, kept = tmp_path / "disk", tmp_path / "kept"
    disk.mkdir()
    kept.mkdir()
    inside = ("unshare", "-rm", "sh", "-c", SMALL_DISK, "sh", size, disk, kept)
    try:
        code, _, said = ended(start(place, "a", "out", *inside))
    except FileNotFoundError:
        pytest.skip("there is no unshare")
    if not (kept / "code").exists():
        pytest.skip(f"this user may not mount: {said}")
    assert code == 0, said
    assert (kept / "code").read_text() == "2\n"
    assert "No space left on device" in (kept / "said").read_text()
    assert "make room on the disk" in (kept / "said").read_text()
    assert (kept / "left").read_text() == ""
    assert contents(kept / "a") == contents(place / "whole/a")
