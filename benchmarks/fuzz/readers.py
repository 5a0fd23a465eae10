"""Files that are read by others' libraries, changed at random: workbooks, Parquet, URDF, models.

What a reader makes of each is a refusal or numbers; anything else must not be.
"""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.fuzz.judge import Outcome, outcome_of
from benchmarks.fuzz.mutations import Files, changed_bytes, mutated

_CAMPAIGN = Path(__file__).parents[2] / "examples/irb120-points"
_SHEET = """<?xml version="1.0" encoding="UTF-8"?>
<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>{rows}
</sheetData></worksheet>"""
_WORKBOOK = {
    "[Content_Types].xml": """<?xml version="1.0"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="xml" ContentType="application/xml"/><Default Extension="rels"
ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Override PartName="/xl/workbook.xml" ContentType=
"application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"/></Types>""",
    "_rels/.rels": """<?xml version="1.0"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Id="rId1" Target="xl/workbook.xml" Type=
"http://schemas.openxmlformats.org/officeDocument/2006/relationships/officeDocument"/>
</Relationships>""",
    "xl/workbook.xml": """<?xml version="1.0"?>
<workbook xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main" xmlns:r=
"http://schemas.openxmlformats.org/officeDocument/2006/relationships"><sheets>
<sheet name="a" sheetId="1" r:id="rId1"/></sheets></workbook>""",
    "xl/_rels/workbook.xml.rels": """<?xml version="1.0"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Id="rId1" Target="worksheets/sheet1.xml" Type=
"http://schemas.openxmlformats.org/officeDocument/2006/relationships/worksheet"/>
</Relationships>""",
}


def _workbook() -> Files:
    rng = np.random.default_rng(0)
    rows = [["q1", "q2", "x", "y", "z"], *rng.uniform(-90.0, 90.0, (30, 5)).round(3).tolist()]
    text = ""
    for row in rows:
        cells = (
            f'<c t="inlineStr"><is><t>{each}</t></is></c>'
            if isinstance(each, str)
            else f"<c><v>{each}</v></c>"
            for each in row
        )
        text += f"<row>{''.join(cells)}</row>\n"
    parts = {**_WORKBOOK, "xl/worksheets/sheet1.xml": _SHEET.format(rows=text)}
    return {"a.xlsx": _zipped({name: part.encode() for name, part in parts.items()})}


def _zipped(parts: Files) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in parts.items():
            file.writestr(name, content)
    return packed.getvalue()


def _calibrated() -> Files:
    """Return what a small campaign comes to: its table of poses, its model and the covariance."""
    from pa10cal.commands.chain import chain

    with tempfile.TemporaryDirectory() as place, redirect_stdout(io.StringIO()):
        chain(campaign_dir=(_CAMPAIGN,), results=Path(place))
        names = ("ingest/poses.parquet", "model/model.yaml", "model/model.covariance.npz")
        return {Path(name).name: Path(place, name).read_bytes() for name in names}


@cache
def originals() -> dict[str, Files]:
    """Return the files of each kind as they are, by name."""
    found = _calibrated()
    model = {name: found[name] for name in ("model.yaml", "model.covariance.npz")}
    return {
        "workbook": _workbook(),
        "parquet": {"poses.parquet": found["poses.parquet"]},
        "urdf": {"robot.urdf": _urdf()},
        "model": model,
    }


def _urdf() -> bytes:
    joints = "".join(
        f'<link name="l{k + 1}"/><joint name="j{k + 1}" type="revolute"><parent link="l{k}"/>'
        f'<child link="l{k + 1}"/><origin xyz="0.1 0 0.2" rpy="0 0.5 0"/><axis xyz="0 0 1"/>\n'
        '<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>\n'
        for k in range(4)
    )
    return f'<robot name="r"><link name="l0"/>\n{joints}</robot>\n'.encode()


def _read_workbook(folder: Path) -> None:
    from pa10cal.campaign.sniffing import sniff

    sniff(folder / "a.xlsx")


def _read_parquet(folder: Path) -> None:
    from pa10cal.campaign.table import read_pose_table

    read_pose_table(folder / "poses.parquet")


def _read_urdf(folder: Path) -> None:
    from pa10cal.commands.data import import_arm

    with redirect_stdout(None):
        import_arm(folder / "robot.urdf", out=folder / "arm.yaml")


def _read_model(folder: Path) -> None:
    from pa10cal.fit.model_reading import load_model

    model = load_model(folder / "model.yaml")
    found = model.predict(np.zeros((2, model.arm.n)))
    if not (np.isfinite(found.T).all() and (found.u_mm >= 0.0).all()):
        raise AssertionError("a model that was read predicts what is no number")


READERS: dict[str, Callable[[Path], None]] = {
    "workbook": _read_workbook,
    "parquet": _read_parquet,
    "urdf": _read_urdf,
    "model": _read_model,
}


def judged_file(kind: str, rng: np.random.Generator) -> tuple[str, Outcome]:
    """Change a file of a kind, or what is packed in it, and read it."""
    files = dict(originals()[kind])
    name = str(rng.choice(sorted(files)))
    if zipfile.is_zipfile(io.BytesIO(files[name])) and rng.random() < 0.7:
        with zipfile.ZipFile(io.BytesIO(files[name])) as packed:
            parts = {each: packed.read(each) for each in packed.namelist()}
        part = str(rng.choice(sorted(parts)))
        parts[part], done = changed_bytes(rng, parts[part])
        files[name], done = _zipped(parts), f"{name}: {part}: {done}"
    elif name.endswith(".yaml"):
        changed, done = mutated(rng, {name: files[name]})
        files[name] = changed[name]
    else:
        files[name], done = changed_bytes(rng, files[name])
        done = f"{name}: {done}"

    def come_to() -> tuple[str, str]:
        with tempfile.TemporaryDirectory() as folder:
            for each, content in files.items():
                Path(folder, each).write_bytes(content)
            READERS[kind](Path(folder))
        return "read", ""

    return done, outcome_of(come_to)
