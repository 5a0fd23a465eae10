"""Outputs are whole or not there."""

import errno
import fcntl
import os
import resource
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import strategies as st

from pa10cal.errors import OutputError
from pa10cal.files.output import folder_beside, remove_partials, whole_file, whole_files, write_text


def no_locks(*_):
    raise OSError(errno.ENOLCK, "no locks")


def write_half(path):
    with whole_file(path) as beside:
        beside.write_text("half")
        raise OSError("disk")


def test_writes_into_a_folder_that_is_not_there_yet(tmp_path):
    path = tmp_path / "a/b/result.csv"
    write_text(path, "δθ\n1\n")
    assert path.read_bytes() == "δθ\n1\n".encode()


def test_a_failure_leaves_nothing_behind(tmp_path):
    path = tmp_path / "result.json"
    with pytest.raises(OSError, match="disk"):
        write_half(path)
    assert list(tmp_path.iterdir()) == []


def test_a_failure_leaves_the_former_output_as_it_was(tmp_path):
    path = tmp_path / "result.txt"
    write_text(path, "former")
    with pytest.raises(OSError, match="disk"):
        write_half(path)
    assert path.read_text() == "former"
    assert list(tmp_path.iterdir()) == [path]


def test_the_output_is_not_seen_before_it_is_whole(tmp_path):
    path = tmp_path / "result.txt"
    with whole_file(path) as beside:
        beside.write_text("half")
        assert not path.exists()
        assert beside.suffix == path.suffix
    assert path.read_text() == "half"


def test_several_outputs_appear_together(tmp_path):
    paths = tmp_path / "a.txt", tmp_path / "b" / "c.txt"
    with whole_files(*paths) as besides:
        for beside in besides:
            beside.write_text("whole")
        assert not any(path.exists() for path in paths)
    assert [path.read_text() for path in paths] == ["whole", "whole"]


@pytest.mark.parametrize("fails", [False, True])
def test_what_writes_into_an_unfinished_output_leaves_it_locked(tmp_path, fails):
    path = tmp_path / "result.json"
    with suppress(OSError), whole_file(path) as beside:
        write_text(beside, "whole")
        assert beside.read_text() == "whole"
        assert list(tmp_path.iterdir()) == [beside]
        with beside.open() as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        remove_partials(tmp_path)  # as another process does
        if fails:
            write_half(beside)
    assert list(tmp_path.iterdir()) == ([] if fails else [path])


def test_files_that_users_called_partial_are_theirs(tmp_path):
    names = "2024.partial.result.csv", ".old.partial.result.csv", ".notes.partial.result.csv.former"
    for name in names:
        (tmp_path / name).write_text("mine")
    (tmp_path / ".1.partial.result.csv").write_text("half")
    write_text(tmp_path / "result.csv", "whole")
    with folder_beside(tmp_path / "result.csv"):
        pass
    remove_partials(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"result.csv", *names}


def test_two_outputs_at_one_place_are_refused_before_anything_is_written(tmp_path):
    paths = (tmp_path / "a.json", tmp_path / "b.json", tmp_path / "sub" / ".." / "a.json")
    with pytest.raises(OutputError, match="the same path"), whole_files(*paths):
        pass
    assert not list(tmp_path.iterdir())


def test_one_place_that_is_unfit_keeps_all_outputs_back(tmp_path):
    (tmp_path / "taken").mkdir()
    (tmp_path / "file").write_text("")
    for unfit in (tmp_path / "taken", tmp_path / "file" / "b.txt", tmp_path / "file" / "c" / "d"):
        with (
            pytest.raises(OutputError, match=r"the output cannot be written \(got '"),
            whole_files(tmp_path / "a.txt", unfit),
        ):
            pytest.fail("the block must not be entered")
        assert {path.name for path in tmp_path.iterdir()} == {"taken", "file"}


@pytest.mark.parametrize("unfit", [".", "/", "..", "pipe"])
def test_a_place_of_no_file_is_refused_and_stays(tmp_path, monkeypatch, unfit):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    with pytest.raises(OutputError, match="the output cannot be written"):
        write_text(Path(unfit), "text")
    assert [path.is_fifo() for path in tmp_path.iterdir()] == [True]


def test_links_and_permissions_stay(tmp_path):
    real, link = tmp_path / "real/result.txt", tmp_path / "link.txt"
    write_text(real, "former")
    real.chmod(0o640)
    link.symlink_to(real)
    write_text(link, "new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    assert real.stat().st_mode & 0o777 == 0o640
    assert list(real.parent.iterdir()) == [real]


def test_what_a_killed_process_of_this_number_wrote_is_not_in_the_output(tmp_path, monkeypatch):
    path = tmp_path / "result.txt"
    (tmp_path / f".{os.getpid()}.partial.result.txt").write_text("much longer")
    monkeypatch.setattr("pa10cal.files.output.fcntl.flock", no_locks)
    with whole_file(path) as beside, beside.open("r+") as file:
        file.write("new")
    assert path.read_text() == "new"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_is_told_with_the_path(tmp_path, number):
    path = tmp_path / "a/result.json"
    with pytest.raises(OutputError, match=r"a/result\.json: .*make room"), whole_file(path):
        raise OSError(number, "any text")
    assert list((tmp_path / "a").iterdir()) == []


def test_a_disk_that_fills_at_the_very_end_leaves_the_former_output(tmp_path, monkeypatch):
    path = tmp_path / "result.txt"
    write_text(path, "former")

    def full(file):
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr("pa10cal.files.output.os.fsync", full)
    with pytest.raises(OutputError, match=r"result\.txt: .*No space left"):
        write_text(path, "new")
    assert path.read_text() == "former"
    assert list(tmp_path.iterdir()) == [path]


def test_a_limit_on_sizes_is_one_message(tmp_path):
    code = "import sys; from pathlib import Path; from pa10cal.files.output import write_text\n"
    code += "write_text(Path(sys.argv[1]), 'x' * 100_000)"
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "big.txt"],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000)),
        capture_output=True,
        text=True,
    )
    assert "big.txt: the output cannot be written (got 'File too large')" in done.stderr
    assert list(tmp_path.iterdir()) == []


numbers = st.floats(allow_nan=False, allow_infinity=False)


def test_a_name_that_is_too_long_is_refused(tmp_path):
    with pytest.raises(OutputError, match="File name too long"):
        write_text(tmp_path / ("x" * 300), "")
