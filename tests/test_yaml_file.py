"""YAML of every broken kind is refused with the line, and never ends the process."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from pa10cal.campaign.description import read_description
from pa10cal.errors import Pa10calError, RawDataError
from pa10cal.yaml_file import MAX_DEPTH, parse_yaml, read_yaml

REFERENCES_OF_REFERENCES = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12)
)

BROKEN = {
    "deep nesting": ("[" * 900, "line 1: nested deeper than 40 levels"),
    # Beyond a thousand, newer releases of the parser say it in their own words.
    "very deep nesting": ("[" * 100_000, "nest"),
    "deep mappings": ("{a: " * 100 + "1" + "}" * 100, "nested deeper"),
    "references of references": (REFERENCES_OF_REFERENCES, "values once references are read"),
    "a list in itself": ("a: &x [1, *x]", "line 1: *x refers to what it stands in"),
    "a key twice": ("a: 1\nb: 2\na: 3\n", "line 3: the key a stands there twice, first in line 1"),
    "a key twice, further in": ("a:\n  - {x: 1, y: 2, x: 3}\n", "line 2: the key x"),
    "a reference to nothing": (
        "a: 1\nu: *u\n",
        "line 2: no &u stands before *u; write it in quotes if it is text",
    ),
    "one number twice": ("1: a\n1.0: b\n", "line 2: the key 1.0 stands there twice"),
    "one truth twice": ("true: a\nyes: b\n", "line 2: the key yes stands there twice"),
    "a key by reference": ("a: &x foo\nb: {foo: 1, *x : 2}\n", "line 2: the key foo"),
    "no number": ("b: 1\na: !!float nope", "line 2: 'nope' is no number"),
    "no whole number": ("a: !!int ''", "line 1: '' is no whole number"),
    "no hexadecimal": ("a: !!int 0x", "line 1: '0x' is no whole number"),
    "no binary": ("a: 0b_", "line 1: '0b_' is no whole number"),
    "no time": ("a: !!timestamp x", "line 1: 'x' is no date"),
    "no truth": ("a: !!bool maybe", "line 1: 'maybe' is neither true nor false"),
    "a month of thirteen": ("a: 2026-13-45", "line 1: '2026-13-45' is no date; write it in quotes"),
    "a day that is not": ("a: 1\nname: 2024-02-30", "line 2: '2024-02-30' is no date"),
    "an offset too far": ("a: 2024-01-01T00:00:00+99:99", "is no date"),
    "no truth as a key": ("!!bool maybe: 1", "line 1: 'maybe' is neither true nor false"),
    "octal": ("a: 1\nb: 010", "line 2: YAML reads 010 as 8; write a number without leading zeros"),
    "to the base of sixty": ("a: -1:30", "line 1: YAML reads -1:30 as -90"),
    "to the base of sixty with decimals": ("a: 1:30.5", "line 1: YAML reads 1:30.5 as 90.5"),
    "a list as a key": ("? [a]\n: b", "unhashable"),
    "an object": ("a: !!python/object:os.system x", "constructor"),
    "two documents": ("a: 1\n---\nb: 2\n", "another document"),
    "a bracket open": ("a: [1, 2", "line 1"),
    "zero bytes": ("a: \x00", "not allowed"),
    "a number of 5000 digits": ("a: " + "9" * 5000, "line 1: a number of 5000 digits"),
    "hexadecimal": ("a:\n- 0x" + "f" * 5000, "line 2: a number of 5002 digits"),
    "sexagesimal": ("a: 1" + ":1" * 5000, "a number of 10001 digits"),
    "sexagesimal with decimals": ("a: 1" + ":1" * 5000 + ".5", "a number of 10003 digits"),
    "underscores": ("a: 1" + "_1" * 5000, "a number of 10001 digits"),
    "decimals": ("a: 0." + "1" * 5000, "a number of 5002 digits"),
    "a time of 5000 digits": ("a: 2001-01-01T00:00:00." + "1" * 5000, "a number of 5020 digits"),
    "a number by its tag": ("a: !!int '1" + ":1" * 5000 + "'", "a number of 10001 digits"),
    "a number as a key": ("? " + "9" * 5000 + "\n: 1", "a number of 5000 digits"),
    "a hundred thousand documents": ("---\n" * 100_000, "line 2: another document"),
    "many keys": ("".join(f"k{k}: 1\n" for k in range(10_001)), "line 10001: more than 10000 keys"),
    "many values": ("a: [" + "1," * 200_001 + "]", "line 1: more than 200000 values"),
}


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("kind", BROKEN)
def test_broken_yaml_is_refused(kind: str) -> None:
    text, said = BROKEN[kind]
    with pytest.raises(ValueError, match=said.replace("*", r"\*")):
        parse_yaml(text)


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_description_is_one_message(kind: str, tmp_path: Path) -> None:
    (tmp_path / "campaign.yaml").write_text(BROKEN[kind][0], encoding="utf-8")
    with pytest.raises(RawDataError, match="description cannot be read"):
        read_description(tmp_path)


def test_what_is_no_text_or_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(b"\xff\xfe\xff")
    with pytest.raises(RawDataError, match="not UTF-8 text, as line 1 shows"):
        read_yaml(path, RawDataError, what="it cannot be read")
    path.write_text("a: 1\n" * 10, encoding="utf-8")
    monkeypatch.setattr("pa10cal.yaml_file.MAX_BYTES", 40)
    with pytest.raises(RawDataError, match="50 bytes, at most 40 bytes are read"):
        read_yaml(path, RawDataError, what="it cannot be read")


def test_only_a_tab_that_is_in_the_way_is_spoken_of() -> None:
    with pytest.raises(ValueError, match="line 4") as refused:
        parse_yaml("a: |\n  b\n  \tb\nc: [1,, 2]\n")
    assert "tabs" not in str(refused.value)


@pytest.mark.parametrize(
    "text",
    ["1: a\n'1': b", "0: 0x1F", "a: [0, -0, 0.5, 010.5, '010', '1:30', 10:75x, 2008-01-02]"],
)
def test_keys_and_numbers_that_are_clear_are_read(text: str) -> None:
    assert parse_yaml(text) == yaml.safe_load(text)


def test_references_and_merged_keys_are_read() -> None:
    text = "b: &b {x: 1, y: 2}\na:\n  <<: *b\n  x: 3\nc: [*b, *b]\n"
    assert parse_yaml(text) == yaml.safe_load(text)


_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.text("abc: -#'\"\n", max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text("abcd", min_size=1, max_size=3), inner, max_size=4)
    ),
    max_leaves=20,
)


@pytest.mark.parametrize(
    "text",
    ["9" * 64, "2008: as it was measured, " * 9, "1:" * 99 + "x", "0x" + "g" * 99, "1" * 99 + " m"],
)
def test_long_texts_that_are_no_numbers_are_read(text: str) -> None:
    assert str(parse_yaml(f'"{text}"')) == text
    assert str(parse_yaml(f"- {text}".replace(": ", " "))[0]) == text.strip().replace(": ", " ")


@given(_VALUES)
def test_whatever_is_written_is_read_as_it_was(value: object) -> None:
    assert parse_yaml(yaml.safe_dump(value)) == value


@given(st.integers(1, MAX_DEPTH))
def test_depths_that_are_meant_are_read(depth: int) -> None:
    found = parse_yaml("[" * depth + "]" * depth)
    for _ in range(depth - 1):
        (found,) = found
    assert found == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("name: ur10-pose", "name: null", "key name does not fit: nothing is stated"),
        ("name: ur10-pose", "name:", "key name does not fit: nothing is stated"),
        (
            "name: ur10-pose",
            "name: off",
            'YAML reads no, off, false .* write it in quotes, as "no"',
        ),
        ("name: ur10-pose", "name: 2026-03-01", "as a date .* write it in quotes, just as"),
        ("robot: ur10", "robot: 10", "as a number .* write it in quotes, just as it stands"),
        ("name: ur10-pose", "name: 2024_01_15", "as a number .* just as it stands in the file"),
        ("uncertainty_mm: 0.05", "uncertainty_mm: yes", "uncertainty_mm .* true .* write a number"),
        ("robot: ur10", "robot: ur10\n\ttool: 1", "line 4.* indent with spaces, not with tabs"),
    ],
)
def test_what_yaml_makes_of_a_word_is_said_with_what_to_write(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    text = Path("examples/ur10-pose/campaign.yaml").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "campaign.yaml").write_text(text.replace(old, new), encoding="utf-8")
    (tmp_path / "tracker.txt").touch()
    with pytest.raises(Pa10calError, match=said):
        read_description(tmp_path)
