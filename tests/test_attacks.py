"""What people might send to do harm: refused in one line, at once, with nothing read or written."""

from __future__ import annotations

import pytest

from attacks import SECRET

# The harness itself: what it must notice.


def test_a_command_that_does_no_harm_is_harmless(attack):
    found = attack("effects", robot="pa10_6ce")
    found.harmless()
    assert found.code == 0
    assert "friction" in found.printed
    assert 20 < found.peak_mb < 500


def test_a_file_read_outside_is_noticed(attack):
    found = attack("effects", robot=attack.outside / "secret.yaml")
    assert found.code == 2
    assert found.read_outside == (str(attack.outside / "secret.yaml"),)
    with pytest.raises(AssertionError, match="secret"):
        found.refused("")


def test_a_file_read_through_a_link_is_noticed(attack):
    (attack.inside / "arm.yaml").symlink_to(attack.outside / "secret.yaml")
    assert attack("effects", robot=attack.inside / "arm.yaml").read_outside


@pytest.mark.parametrize(
    ("code", "noticed"),
    [
        (f"print('{SECRET}')", SECRET),
        ("while True: pass", "exit code -9"),
        ("b = bytearray(1_200_000_000)", r"1\d\d\d MB"),
        ("b = bytearray(4_000_000_000)", "exit code 1"),
        ("open('not-sent/new', 'w')", "not-sent/new"),
        ("import ctypes; ctypes.string_at(0)", "exit code -11"),
        ("import pyarrow.csv; pyarrow.csv.read_csv('not-sent/secret.csv')", "secret.csv"),
    ],
)
def test_harm_is_noticed(attack, code, noticed):
    with pytest.raises(AssertionError, match=noticed):
        attack("-c", code, seconds=1.0 if "while" in code else 20.0).harmless()


def test_a_file_that_is_written_is_noticed(attack):
    found = attack("-c", "open('sent/a', 'w'); open('not-sent/secret.txt', 'a').write('x')")
    assert [path.rpartition("/")[2] for path in found.written] == ["secret.txt", "a"]
