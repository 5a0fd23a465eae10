"""The gate of files that are read: what lies inside a folder is read, and nothing else, ever."""

from __future__ import annotations

import os
import socket
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pa10cal import input_files
from pa10cal.input_files import (
    UnfitFileError,
    is_file,
    names_beside,
    open_file,
    read_csv,
    read_file,
    reason,
)

INSIDE, OUTSIDE = b"inside", b"outside"


@pytest.fixture
def places(tmp_path):
    """A folder with a file in it and one in a folder of it, and a file outside."""
    inside, outside = tmp_path / "in", tmp_path / "out"
    for folder in (inside / "sub", outside):
        folder.mkdir(parents=True)
    for file in (inside / "a", inside / "sub/b"):
        file.write_bytes(INSIDE)
    (outside / "a").write_bytes(OUTSIDE)
    return inside, outside


def refused(path, *within):
    with pytest.raises(UnfitFileError) as caught:
        open_file(path, *within)
    assert not is_file(path, *within)
    return reason(caught.value)


GOOD = {
    "itself": lambda inside, outside: inside / "a",
    "below": lambda inside, outside: inside / "sub/b",
    "there and back": lambda inside, outside: inside / "sub/../a",
    "out and back": lambda inside, outside: inside / "../in/a",
    "absolute": lambda inside, outside: inside / (inside / "a"),
    "link": lambda inside, outside: link(inside / "l", "a"),
    "absolute link": lambda inside, outside: link(inside / "l", inside / "sub/b"),
    "link to a folder": lambda inside, outside: link(inside / "l", "sub") / "b",
    "link to itself": lambda inside, outside: link(inside / "l", inside) / "l/l/a",
    "link from outside": lambda inside, outside: link(outside / "l", inside / "a"),
}
BAD = {
    "absolute": lambda inside, outside: inside / (outside / "a"),
    "dotdot": lambda inside, outside: inside / "../out/a",
    "dotdot below": lambda inside, outside: inside / "sub/../../out/a",
    "link": lambda inside, outside: link(inside / "l", outside / "a"),
    "relative link": lambda inside, outside: link(inside / "l", "../out/a"),
    "link to a link": lambda inside, outside: link(inside / "k", link(inside / "l", "../out/a")),
    "link to a folder": lambda inside, outside: link(inside / "l", outside) / "a",
    "link and dotdot": lambda inside, outside: link(inside / "l", outside / "") / "../out/a",
    "the folder beside": lambda inside, outside: sibling(inside) / "a",
    "link to a device": lambda inside, outside: link(inside / "l", "/dev/zero"),
}
#: What is no file wherever it stands.
NO_FILES = {
    "folder": (lambda path: path.mkdir(), "a folder"),
    "pipe": (os.mkfifo, "a pipe"),
    "socket": (lambda path: bound(path), "a socket"),
}
NAMES = {
    "zero byte": "a\0b",
    "half a letter": "\udcff\udcfe\ud800",
}


def link(path, to):
    path.symlink_to(to)
    return path


def sibling(folder):
    """A folder whose path begins with that of another one."""
    other = folder.with_name(folder.name + "side")
    other.mkdir()
    (other / "a").write_bytes(OUTSIDE)
    return other


def bound(path):
    with socket.socket(socket.AF_UNIX) as of:
        here = Path.cwd()
        os.chdir(path.parent)  # names of sockets are short
        of.bind(path.name)
        os.chdir(here)


@pytest.mark.parametrize("kind", GOOD)
def test_what_lies_inside_is_read(places, kind):
    path = GOOD[kind](*places)
    assert is_file(path, places[0])
    assert read_file(path, 10, places[0]) == INSIDE
    assert read_file(path, 10) == INSIDE


@pytest.mark.parametrize("kind", BAD)
def test_what_leads_out_is_refused(places, kind):
    assert "leads out of the folder" in refused(BAD[kind](*places), places[0])


@pytest.mark.parametrize("kind", BAD)
def test_what_leads_out_of_one_folder_may_lie_in_another(places, kind):
    path = BAD[kind](*places)
    with suppress(UnfitFileError):
        assert read_file(path, 10, *places) == OUTSIDE
        assert is_file(path, *places)


@pytest.mark.parametrize("kind", NO_FILES)
@pytest.mark.parametrize("linked", [False, True])
@pytest.mark.parametrize("anywhere", [False, True])
def test_what_is_no_file_is_refused_at_once(places, kind, linked, anywhere):
    make, words = NO_FILES[kind]
    make(places[0] / "odd")
    path = link(places[0] / "l", "odd") if linked else places[0] / "odd"
    assert words in refused(path, *(() if anywhere else places[:1]))


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null", "/dev/tty"])
def test_devices_are_refused(places, device):
    assert "a device" in refused(Path(device))
    assert "a device" in refused(link(places[0] / "l", device))


@pytest.mark.parametrize("kind", NAMES)
@pytest.mark.parametrize("anywhere", [False, True])
def test_names_that_no_file_has_are_refused(places, kind, anywhere):
    within = () if anywhere else places[:1]
    assert refused(places[0] / NAMES[kind], *within) == "no file can have such a name"


@pytest.mark.parametrize("name", ["x" * 5000, "gone", "sub/gone", "a/b", "gone/../a\nb"])
@pytest.mark.parametrize("anywhere", [False, True])
def test_what_is_not_there_is_an_error_of_the_system(places, name, anywhere):
    with pytest.raises(OSError, match=r"No such|Not a directory|too long"):
        open_file(places[0] / name, *(() if anywhere else places[:1]))
    assert not is_file(places[0] / name, places[0])


def test_a_loop_of_links_ends(places):
    (places[0] / "l").symlink_to("k")
    (places[0] / "k").symlink_to("l")
    for within in ((), places[:1]):
        with pytest.raises(OSError, match="leads to itself"):
            open_file(places[0] / "l", *within)


SWAPS = {
    "a link out": lambda path, outside: (path.unlink(), path.symlink_to(outside / "a")),
    "a pipe": lambda path, outside: (path.unlink(), os.mkfifo(path)),
    "a folder that leads out": lambda path, outside: (
        path.parent.rename(path.parent.with_name("former")),
        path.parent.symlink_to(outside),
    ),
    "a device": lambda path, outside: (path.unlink(), path.symlink_to("/dev/zero")),
}


@pytest.mark.parametrize("kind", SWAPS)
@pytest.mark.parametrize("after", ["realpath", "_refuse_other_kinds"])
def test_no_swap_after_a_look_is_followed(places, monkeypatch, kind, after):
    """Whatever takes the place of a file while it is looked at is refused, or what it was."""
    inside, outside = places
    (outside / "b").write_bytes(OUTSIDE)
    path, swaps = inside / "sub/b", iter([SWAPS[kind]])
    of = os.path if after == "realpath" else input_files
    look = getattr(of, after)

    def look_and_swap(*given):
        found = look(*given)
        if swap := next(swaps, None):
            swap(path, outside)
        return found

    monkeypatch.setattr(of, after, look_and_swap)
    try:
        content = read_file(path, 10, inside)
    except OSError:
        content = b""
    assert next(swaps, None) is None, "it was never swapped"
    assert content in (b"", INSIDE)


@given(st.data())
def test_only_what_lies_inside_is_ever_read(data):
    """Links at random, in any order, and paths through them."""
    with tempfile.TemporaryDirectory() as place:
        root = Path(place).resolve()
        folders = [root / name for name in ("in", "in/p", "in/p/q", "out", "out/r")]
        for folder in folders:
            folder.mkdir()
            (folder / "a").write_bytes(
                INSIDE if root / "in" in (folder, *folder.parents) else OUTSIDE
            )
        some = st.sampled_from([*folders, *(folder / "a" for folder in folders)])
        for name in data.draw(st.lists(st.sampled_from("xyz"), max_size=3, unique=True)):
            at, to = data.draw(st.sampled_from(folders)), data.draw(some)
            relative = data.draw(st.booleans())
            (at / name).symlink_to(os.path.relpath(to, at) if relative else to)
        parts = st.sampled_from(["..", ".", "a", "p", "q", "r", "x", "y", "z", "in", "out"])
        path = (root / "in").joinpath(*data.draw(st.lists(parts, max_size=6)))
        real = Path(os.path.realpath(path))
        right = real.is_file() and real.is_relative_to(root / "in")
        assert is_file(path, root / "in") == right
        try:
            content = read_file(path, 10, root / "in")
        except OSError:
            content = b""
        assert content == (INSIDE if right else b"")


def test_no_more_is_read_than_is_allowed(places):
    path = places[0] / "a"
    assert read_file(path, len(INSIDE)) == INSIDE
    with pytest.raises(UnfitFileError, match="6 bytes, at most 5 bytes are read"):
        read_file(path, len(INSIDE) - 1)
    with pytest.raises(UnfitFileError, match="6 bytes, at most 5 bytes are read"):
        list(read_csv(path, len(INSIDE) - 1))


@pytest.mark.parametrize(
    ("size", "most", "said"),
    [
        (4 * 2**20 + 5, 4 * 2**20, "4194309 bytes, at most 4194304 bytes are read"),
        (20 * 2**20, 2**20, "21 MB, at most 1.05 MB are read"),
    ],
)
def test_a_limit_is_told_so_that_it_differs_from_the_size(places, size, most, said):
    path = places[0] / "large"
    path.touch()
    os.truncate(path, size)
    with pytest.raises(UnfitFileError) as caught:
        read_file(path, most)
    assert reason(caught.value) == said


def test_a_table_that_grows_while_it_is_read_is_refused_at_the_limit(places):
    path = places[0] / "t"
    path.write_bytes(b"1,2\n" * 100)
    rows = read_csv(path, 10_000)
    with path.open("ab") as file:
        assert next(rows) == (1, ["1", "2"])
        file.write(b"1,2\n" * 100_000)
    with pytest.raises(UnfitFileError, match="at most 10000 bytes are read"):
        list(rows)


def test_a_file_on_standard_input_is_one_and_a_pipe_is_none(places):
    """As `< file` and `cat file |` give them."""
    with (places[0] / "a").open("rb") as file:
        assert read_file(Path(f"/dev/fd/{file.fileno()}"), 10) == INSIDE
    ends = os.pipe()
    assert "a pipe" in refused(Path(f"/dev/fd/{ends[0]}"))
    for end in ends:
        os.close(end)


def test_a_file_that_does_not_know_its_size_is_not_read_for_ever():
    path = Path("/proc/self/maps")  # of size 0
    with pytest.raises(UnfitFileError, match="at most 100 bytes are read"):
        read_file(path, 100)
    with pytest.raises(UnfitFileError, match="at most 100 bytes are read"):
        list(read_csv(path, 100))


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"a,b\n\xff\n", "UTF-8"), (b'a,b\n"', "unexpected end"), (b"a" * 200_000, "field larger")],
)
def test_what_is_no_table_is_said(places, content, said):
    (places[0] / "t").write_bytes(content)
    with pytest.raises(ValueError, match=said):
        list(read_csv(places[0] / "t", 10**6, places[0]))


def test_rows_come_with_their_lines_and_blank_ones_do_not(places):
    (places[0] / "t").write_bytes(b"\xef\xbb\xbfa,b\n\n , \n1,2\n")
    assert list(read_csv(places[0] / "t", 100)) == [(1, ["a", "b"]), (4, ["1", "2"])]
    (places[0] / "t").write_bytes(b'a,"b\nc"\n1,2\n')
    assert list(read_csv(places[0] / "t", 100)) == [(1, ["a", "b\nc"]), (3, ["1", "2"])]


def test_a_file_of_names_that_leads_elsewhere_hides_none_beside(places):
    inside, outside = places
    (inside / "meta").mkdir()
    (inside / "meta/info.json").symlink_to(outside / "a")
    (inside / "info.json").write_text("{}")
    assert names_beside(inside / "data.parquet") == inside / "info.json"


def test_an_error_without_words_has_some():
    assert reason(PermissionError()) == "it is refused"


def test_a_descriptor_that_was_refused_is_closed(places):
    os.mkfifo(places[0] / "pipe")
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        refused(places[0] / "pipe", places[0])
        refused(places[0] / "sub", places[0])
    assert len(os.listdir("/proc/self/fd")) == before
