"""Exports of trackers and controllers as people have them, drawn from tables of conventions."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import pandas as pd
import yaml
from scipy.spatial.transform import Rotation

#: What one millimetre and one degree are in units of a header.
LENGTHS = {"mm": 1.0, "m": 1e-3, "cm": 0.1, "µm": 1e3}
ANGLES = {
    "°": 1.0,
    "deg": 1.0,
    "grados": 1.0,
    "Grad": 1.0,
    "rad": np.pi / 180,
    "mrad": 1e3 * np.pi / 180,
}


@dataclass(frozen=True)
class Header:
    """How a maker or a language names what is measured: `{u}` stands for the unit."""

    joints: tuple[str, ...]
    place: tuple[str, ...]
    attitude: tuple[str, ...]
    convention: str
    time: str
    temperature: str
    load: str
    length: str = "mm"
    angle: str = "deg"
    turn: str = "deg"  # unit of the orientation
    note: str = "Comment"


def _header(joints: str, place, attitude, first: int = 1, **words: str) -> Header:
    """Return names by patterns, or as they are listed."""

    def by_axis(names) -> tuple[str, ...]:
        if isinstance(names, list):
            return tuple(names)
        return tuple(names.format(a=axis, A=axis.upper(), u="{u}") for axis in "xyz")

    six = tuple(joints.format(k=k, u="{u}") for k in range(first, first + 6))
    return Header(six, by_axis(place), by_axis(attitude), **words)


_TABLE = Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8")
HEADERS = {name: _header(**stated) for name, stated in yaml.safe_load(_TABLE).items()}
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "cp1252", "cp850", "mac_roman")
SEPARATORS = (";", ",", "\t", "|")
#: How times are written, by name; what a row's seconds become.
CLOCKS = {
    "iso": lambda at: at.isoformat(timespec="milliseconds"),
    "zone": lambda at: at.isoformat(timespec="milliseconds") + "+01:00",
    "day first": lambda at: at.strftime("%d.%m.%Y %H:%M:%S"),
    "comma": lambda at: at.strftime("%d.%m.%Y %H:%M:%S,") + f"{at.microsecond // 1000:03d}",
    "american": lambda at: at.strftime("%m/%d/%Y %I:%M:%S %p"),
    "british": lambda at: at.strftime("%d/%m/%Y %H:%M:%S.%f"),
    "of day": lambda at: at.strftime("%H:%M:%S"),
    "since 1970": lambda at: f"{at.timestamp():.3f}",
    "milliseconds": lambda at: f"{at.timestamp() * 1e3:.0f}",
    "serial": lambda at: f"{25569 + at.timestamp() / 86400:.9f}",
}
LAYOUTS = ("plain", "preamble", "line of units", "last separator", "thousands", "quoted")
KINDS = ("text", "text", "text", "text", "text", "xlsx", "ods")


@dataclass(frozen=True)
class Export:
    """One export: what was drawn for it."""

    header: str
    encoding: str
    separator: str
    decimal: str
    clock: str
    layout: str
    kind: str
    has_load: bool
    has_attitude: bool

    @property
    def title(self) -> str:
        """Return it in words."""
        parts = (self.header, self.kind, self.encoding, repr(self.separator), self.decimal)
        return " · ".join((*parts, self.clock, self.layout))


def drawn_exports(count: int, seed: int) -> list[Export]:
    """Draw exports: headers take their turn, all else is drawn."""
    rng = np.random.default_rng(seed)
    exports = []
    for k in range(count):
        header = list(HEADERS)[k % len(HEADERS)]
        names = HEADERS[header]
        letters = "".join((*_names(names), names.note, names.length, names.angle))
        able = [each for each in ENCODINGS if _encodes(letters, each)]
        separator = str(rng.choice(SEPARATORS))
        decimal = str(rng.choice([".", ","])) if separator != "," else "."
        exports.append(
            Export(
                header,
                str(rng.choice(able)),
                separator,
                decimal,
                # A header that states seconds has seconds below it.
                "since 1970" if "s" in names.time[-3:-1] else str(rng.choice(list(CLOCKS))),
                str(rng.choice(LAYOUTS)),
                str(rng.choice(KINDS)),
                bool(rng.random() < 0.4),
                bool(rng.random() < 0.8),
            )
        )
    return exports


def _names(header: Header) -> tuple[str, ...]:
    return (*header.joints, *header.place, *header.attitude, header.temperature, header.load)


def _encodes(text: str, encoding: str) -> bool:
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return False
    return True


def written_export(export: Export, table: pd.DataFrame, folder: Path, rng) -> Path:
    """Write a table under the contract's names as an export; return its path."""
    header = HEADERS[export.header]
    units = export.layout == "line of units"
    columns: dict[str, tuple[str, np.ndarray]] = {}

    def put(name: str, unit: str, values) -> None:
        bare = name.replace(" [{u}]", "").replace(" ({u})", "").replace(" in {u}", "")
        columns[(bare.replace("_{u}", "") if units else name).format(u=unit)] = (unit, values)

    at = pd.Timestamp("2026-03-05 09:30") + pd.to_timedelta(table["time_s"], unit="s")
    put(header.time, "", np.array([CLOCKS[export.clock](each) for each in at], dtype=object))
    put("Nr" if header.angle in ("°", "Grad") else "Row", "", np.arange(1, len(table) + 1))
    for name, k in zip(header.joints, range(1, 7), strict=True):
        put(name, header.angle, table[f"q{k}_deg"].to_numpy() * ANGLES[header.angle])
    for name, axis in zip(header.place, "xyz", strict=True):
        put(name, header.length, table[f"{axis}_mm"].to_numpy() * LENGTHS[header.length])
    if export.has_attitude:
        numbers = _attitudes(table, header)
        unit = header.turn if numbers.shape[1] == 3 else ""
        for name, values in zip(header.attitude, numbers.T, strict=True):
            put(name, unit, values)
    put(header.temperature, "°C", 20.0 + 0.01 * np.arange(len(table)))
    if export.has_load:
        kilograms = "[kg]" in header.load
        put(
            header.load,
            "kg" if kilograms else "N",
            np.where(table.index % 2, 44.0, 0.0) / (9.80665 if kilograms else 1),
        )
    put(header.note, "", np.array([str(rng.choice(["ok", "", "Ü 3"])) for _ in at], dtype=object))
    if export.kind != "text":
        return _workbook(export, columns, folder)
    rows = [list(columns)]
    rows += [[unit for unit, _ in columns.values()]] if units else []
    for k in range(len(table)):
        rows.append([_field(export, values[k]) for _, values in columns.values()])
    end = export.separator if export.layout == "last separator" else ""
    lines = [export.separator.join(_quoted(export, field) for field in row) + end for row in rows]
    if export.layout == "preamble":
        lines = ["Measurement report", "Operator: N. N.", "", *lines]
    path = folder / "export.csv"
    path.write_bytes("\r\n".join([*lines, ""]).encode(export.encoding, errors="replace"))
    return path


def _attitudes(table: pd.DataFrame, header: Header) -> np.ndarray:
    R = Rotation.from_quat(table[["qw", "qx", "qy", "qz"]], scalar_first=True)
    word, _, axes = header.convention.partition("_")
    if word == "quaternion":
        return R.as_quat(scalar_first=axes == "wxyz")
    angles = (
        R.as_rotvec(degrees=True) if word == "rotation" else R.as_euler(axes or "xyz", degrees=True)
    )
    return angles * ANGLES[header.turn]


def _field(export: Export, value: object) -> str:
    if not isinstance(value, float | np.floating):
        return str(value)
    text = (
        f"{value:,.9f}"
        if export.layout == "thousands" and export.separator != ","
        else f"{value:.9f}"
    )
    return text.translate(str.maketrans(",.", ".,")) if export.decimal == "," else text


def _quoted(export: Export, field: str) -> str:
    needed = export.separator in field
    return f'"{field}"' if needed or export.layout == "quoted" else field


def _workbook(export: Export, columns, folder: Path) -> Path:
    """Write a workbook with one sheet, by hand: numbers as numbers, all else as text."""
    length = len(next(iter(columns.values()))[1])
    rows: list[list[object]] = [list(columns)]
    if export.layout == "line of units":
        rows += [[unit for unit, _ in columns.values()]]
    rows += [[columns[name][1][k] for name in columns] for k in range(length)]
    write = {"xlsx": _xlsx, "ods": _ods}[export.kind]
    path = folder / f"export.{export.kind}"
    path.write_bytes(write(rows))
    return path


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating)


def _archive(parts: dict[str, str]) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, text in parts.items():
            archive.writestr(name, text)
    return content.getvalue()


def _xlsx(rows: list[list[object]]) -> bytes:
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    of = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006"
    lines = []
    for row in rows:
        cells = [
            f"<c><v>{float(value)!r}</v></c>"
            if _is_number(value)
            else f'<c t="inlineStr"><is><t>{escape(str(value))}</t></is></c>'
            for value in row
        ]
        lines.append(f"<row>{''.join(cells)}</row>")
    sheet = "application/vnd.openxmlformats-officedocument.spreadsheetml"
    return _archive(
        {
            "[Content_Types].xml": f'<Types xmlns="{package}/content-types">'
            '<Default Extension="rels" '
            'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
            f'<Override PartName="/xl/workbook.xml" ContentType="{sheet}.sheet.main+xml"/>'
            f'<Override PartName="/xl/s.xml" ContentType="{sheet}.worksheet+xml"/></Types>',
            "_rels/.rels": f'<Relationships xmlns="{package}/relationships">'
            f'<Relationship Id="a" Type="{of}/officeDocument" Target="xl/workbook.xml"/>'
            "</Relationships>",
            "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{of}"><sheets>'
            '<sheet name="Data" sheetId="1" r:id="b"/></sheets></workbook>',
            "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{package}/relationships">'
            f'<Relationship Id="b" Type="{of}/worksheet" Target="s.xml"/></Relationships>',
            "xl/s.xml": f'<worksheet xmlns="{main}"><sheetData>{"".join(lines)}</sheetData>'
            "</worksheet>",
        }
    )


def _ods(rows: list[list[object]]) -> bytes:
    name = "urn:oasis:names:tc:opendocument:xmlns"
    lines = []
    for row in rows:
        cells = [
            f'<table:table-cell office:value-type="float" office:value="{float(value)!r}"/>'
            if _is_number(value)
            else '<table:table-cell office:value-type="string">'
            f"<text:p>{escape(str(value))}</text:p></table:table-cell>"
            for value in row
        ]
        lines.append(f"<table:table-row>{''.join(cells)}</table:table-row>")
    content = (
        f'<office:document-content xmlns:office="{name}:office:1.0" '
        f'xmlns:table="{name}:table:1.0" xmlns:text="{name}:text:1.0"><office:body>'
        f'<office:spreadsheet><table:table table:name="Data">{"".join(lines)}</table:table>'
        "</office:spreadsheet></office:body></office:document-content>"
    )
    kind = "application/vnd.oasis.opendocument.spreadsheet"
    manifest = (
        f'<manifest:manifest xmlns:manifest="{name}:manifest:1.0"><manifest:file-entry '
        f'manifest:full-path="/" manifest:media-type="{kind}"/></manifest:manifest>'
    )
    return _archive({"mimetype": kind, "META-INF/manifest.xml": manifest, "content.xml": content})
