"""Changes of a folder's files, as people, programs and discs make them; and as nobody does."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Files = dict[str, bytes]
Mutation = Callable[[np.random.Generator, Files], str]

_ODD_WORDS = (
    *("", "nan", "inf", "-inf", "NaN", "null", "none", "#N/A", "-", "1e400", "-1e308", "1e-320"),
    *("0x1F", "1_000", "1,5", "1.5.2", "٣", "½", "=1+1", "@SUM(A1)", "<b>", "'; --", "\x00"),
    *("true", "99999999999999999999", "-0", "1e7", "-1e7", "360", "1000000", "../x", "  7 "),
)
_ODD_YAML = (
    *("null", "[]", "{}", "[[[[]]]]", "!!float nope", "!!python/object:os.system x", "*a", "&a 1"),
    *(".nan", ".inf", "-1", "0", "1e400", "true", "'text'", "../../etc/passwd", "2008-01-01"),
    *("'=1+1'", '"\\u0000"', "[1, 2", "{a: 1, a: 2}", "1000000000000", "[1, 2, 3, 4, 5, 6, 7, 8]"),
)


def mutated(rng: np.random.Generator, files: Files) -> tuple[Files, str]:
    """Return a copy of files with one to three changes, and what was done."""
    changed = dict(files)
    count = int(rng.choice([1, 1, 1, 2, 3]))
    done = [_one(rng, changed) for _ in range(count)]
    return changed, "; ".join(done)


def _one(rng: np.random.Generator, files: Files) -> str:
    """Change one file in place."""
    names = sorted(files)
    # Tables more often: most changes of a description are refused at once.
    weights = np.array([1.0 if name.endswith(".yaml") else 3.0 for name in names])
    name = str(rng.choice(names, p=weights / weights.sum()))
    kinds = _OF_YAML if name.endswith(".yaml") else _OF_TABLES
    change = kinds[int(rng.integers(len(kinds)))]
    before = files[name]
    if not before:
        return f"{name}: nothing to change"
    files[name] = change(rng, before)
    return f"{name}: {change.__name__.removeprefix('_')}"


def changed_bytes(rng: np.random.Generator, content: bytes) -> tuple[bytes, str]:
    """Return a file of any kind with one to three changes of its bytes, and what was done."""
    done = []
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        if not content:
            break
        change = _OF_BYTES[int(rng.integers(len(_OF_BYTES)))]
        content = change(rng, content)
        done.append(change.__name__.removeprefix("_"))
    return content, ", ".join(done)


def _lines(text: bytes) -> list[bytes]:
    return text.split(b"\n")


def _byte(rng: np.random.Generator, text: bytes) -> bytes:
    at = int(rng.integers(len(text)))
    return text[:at] + bytes([int(rng.integers(256))]) + text[at + 1 :]


def _bytes_inserted(rng: np.random.Generator, text: bytes) -> bytes:
    at = int(rng.integers(len(text)))
    return text[:at] + rng.bytes(int(rng.integers(1, 20))) + text[at:]


def _cut(rng: np.random.Generator, text: bytes) -> bytes:
    return text[: int(rng.integers(len(text)))]


def _beginning_lost(rng: np.random.Generator, text: bytes) -> bytes:
    return text[int(rng.integers(len(text))) :]


def _line_deleted(rng: np.random.Generator, text: bytes) -> bytes:
    lines = _lines(text)
    del lines[int(rng.integers(len(lines)))]
    return b"\n".join(lines)


def _line_repeated(rng: np.random.Generator, text: bytes) -> bytes:
    lines = _lines(text)
    at = int(rng.integers(len(lines)))
    return b"\n".join([*lines[:at], *[lines[at]] * int(rng.integers(2, 5)), *lines[at + 1 :]])


def _lines_exchanged(rng: np.random.Generator, text: bytes) -> bytes:
    lines = _lines(text)
    one, other = rng.integers(len(lines), size=2)
    lines[one], lines[other] = lines[other], lines[one]
    return b"\n".join(lines)


def _block_repeated(rng: np.random.Generator, text: bytes) -> bytes:
    lines = _lines(text)
    first, last = np.sort(rng.integers(len(lines), size=2))
    return b"\n".join([*lines[:last], *lines[first:]])


def _end_of_lines(rng: np.random.Generator, text: bytes) -> bytes:
    return text.replace(b"\n", [b"\r\n", b"\r", b"\n\n"][int(rng.integers(3))])


def _encoded(rng: np.random.Generator, text: bytes) -> bytes:
    words = text.decode("utf-8", "replace")
    return words.encode(("utf-16", "utf-8-sig", "utf-32")[int(rng.integers(3))])


def _separator(rng: np.random.Generator, text: bytes) -> bytes:
    return text.replace(b",", [b";", b"\t", b" "][int(rng.integers(3))])


def _table(text: bytes) -> list[list[bytes]]:
    return [line.split(b",") for line in _lines(text)]


def _text(table: list[list[bytes]]) -> bytes:
    return b"\n".join(b",".join(row) for row in table)


def _word(rng: np.random.Generator, text: bytes) -> bytes:
    table = _table(text)
    row = table[int(rng.integers(len(table)))]
    row[int(rng.integers(len(row)))] = str(rng.choice(_ODD_WORDS)).encode()
    return _text(table)


def _digit(rng: np.random.Generator, text: bytes) -> bytes:
    digits = [k for k, byte in enumerate(text) if 48 <= byte <= 57]
    if not digits:
        return text
    at = int(rng.choice(digits))
    return text[:at] + str(int(rng.integers(10))).encode() + text[at + 1 :]


def _column(rng: np.random.Generator, table: list[list[bytes]]) -> int:
    return int(rng.integers(len(table[0])))


def _column_deleted(rng: np.random.Generator, text: bytes) -> bytes:
    table = _table(text)
    at = _column(rng, table)
    return _text([row[:at] + row[at + 1 :] for row in table])


def _column_twice(rng: np.random.Generator, text: bytes) -> bytes:
    table = _table(text)
    at = _column(rng, table)
    return _text([[*row, *row[at : at + 1]] for row in table])


def _columns_exchanged(rng: np.random.Generator, text: bytes) -> bytes:
    table = _table(text)
    one, other = _column(rng, table), _column(rng, table)
    for row in table[int(rng.integers(2)) :]:  # with their names, which is right, or without
        if len(row) > max(one, other):
            row[one], row[other] = row[other], row[one]
    return _text(table)


def _column_renamed(rng: np.random.Generator, text: bytes) -> bytes:
    table = _table(text)
    at = _column(rng, table)
    table[0][at] = [table[0][at].upper(), b"", b" " + table[0][at], b"x"][int(rng.integers(4))]
    return _text(table)


def _column_scaled(rng: np.random.Generator, text: bytes) -> bytes:
    """Write a column in another unit: metres, inches, radians; or with its sign turned."""
    table = _table(text)
    at = _column(rng, table)
    factor = float(rng.choice([1e-3, 1e3, np.pi / 180, 180 / np.pi, -1.0, 25.4]))
    for row in table[1:]:
        if len(row) > at:
            try:
                row[at] = repr(float(row[at]) * factor).encode()
            except ValueError:
                continue
    return _text(table)


def _column_emptied(rng: np.random.Generator, text: bytes) -> bytes:
    table = _table(text)
    at = _column(rng, table)
    for row in table[1:]:
        if len(row) > at:
            row[at] = b""
    return _text(table)


def _rows_reversed(_: np.random.Generator, text: bytes) -> bytes:
    head, *rows = _lines(text)
    return b"\n".join([head, *rows[::-1]])


def _wide(rng: np.random.Generator, text: bytes) -> bytes:
    lines = _lines(text)
    at = int(rng.integers(len(lines)))
    lines[at] += b"," * int(rng.integers(1, 3000))
    return b"\n".join(lines)


def _long_word(rng: np.random.Generator, text: bytes) -> bytes:
    at = int(rng.integers(len(text)))
    return text[:at] + b"9" * int(rng.integers(10, 200_000)) + text[at:]


def _quote(rng: np.random.Generator, text: bytes) -> bytes:
    at = int(rng.integers(len(text)))
    return text[:at] + b'"' + text[at:]


def _value_replaced(rng: np.random.Generator, text: bytes) -> bytes:
    lines = _lines(text)
    keys = [k for k, line in enumerate(lines) if b":" in line]
    if not keys:
        return text
    at = int(rng.choice(keys))
    lines[at] = lines[at].split(b":")[0] + b": " + str(rng.choice(_ODD_YAML)).encode()
    return b"\n".join(lines)


def _key_renamed(rng: np.random.Generator, text: bytes) -> bytes:
    lines = _lines(text)
    keys = [k for k, line in enumerate(lines) if b":" in line]
    if not keys:
        return text
    at = int(rng.choice(keys))
    lines[at] = lines[at].replace(b":", b"x:", 1)
    return b"\n".join(lines)


def _indented(rng: np.random.Generator, text: bytes) -> bytes:
    lines = _lines(text)
    at = int(rng.integers(len(lines)))
    lines[at] = b"  " + lines[at]
    return b"\n".join(lines)


def _nested(rng: np.random.Generator, text: bytes) -> bytes:
    depth = int(rng.integers(5, 20_000))
    return text + b"\nextra: " + b"[" * depth + b"]" * depth + b"\n"


def _number_scaled(rng: np.random.Generator, text: bytes) -> bytes:
    """Put one digit more or less before a decimal point, or a sign."""
    points = [k for k, byte in enumerate(text) if byte == 46]
    if not points:
        return text
    at = int(rng.choice(points))
    return text[:at] + [b"000", b"e3", b"-"][int(rng.integers(3))] + text[at:]


_OF_ANY: tuple[Callable[[np.random.Generator, bytes], bytes], ...] = (
    *(_byte, _bytes_inserted, _cut, _beginning_lost, _line_deleted, _line_repeated, _digit),
    *(_lines_exchanged, _block_repeated, _end_of_lines, _encoded, _quote, _long_word),
)
_OF_BYTES = (
    _byte,
    _byte,
    _bytes_inserted,
    _cut,
    _beginning_lost,
    _line_deleted,
    _line_repeated,
    _digit,
    _word,
)
_OF_TABLES = (
    *_OF_ANY,
    *(_separator, _word, _word, _word, _column_deleted, _column_twice, _columns_exchanged),
    *(_column_renamed, _column_scaled, _column_scaled, _column_emptied, _rows_reversed, _wide),
)
_OF_YAML = (
    *_OF_ANY,
    *(_value_replaced, _value_replaced, _value_replaced, _key_renamed, _indented, _nested),
    _number_scaled,
)
