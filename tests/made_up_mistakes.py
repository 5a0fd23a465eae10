"""A right campaign with files of its own, to be spoilt by a mistake, and what commands say then."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from copy import deepcopy
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from scipy.spatial.transform import Rotation

from mended import simulated
from pa10cal.__main__ import main

JOINTS = [f"A{k} [°]" for k in range(1, 7)]
PLACE = ["X [mm]", "Y [mm]", "Z [mm]"]
TURN = ["A [°]", "B [°]", "C [°]"]
QUATERNION = ["Q1", "Q2", "Q3", "Q4"]
FILE = "messung.csv"


@dataclass
class Own:
    """A campaign as its user has it; what a mistake changes is changed before it is written."""

    folder: Path
    table: pd.DataFrame
    content: dict[str, Any]
    separator: str = ";"
    decimal: str = ","
    encoding: str = "utf-8"
    header: bool = True
    above: list[str] = field(default_factory=list)  # lines over the header
    more: dict[str, bytes] = field(default_factory=dict)  # further files, or in place of these
    yaml: Callable[[str], str] = str  # what becomes of the text of campaign.yaml

    @property
    def poses(self) -> dict[str, Any]:
        """Return what campaign.yaml says of the columns."""
        return self.content["columns"]["poses"]

    def text(self, table: pd.DataFrame | None = None) -> str:
        """Return the text of a file as it is written."""
        table = self.table if table is None else table
        text = table.to_csv(
            index=False, sep=self.separator, decimal=self.decimal, header=self.header
        )
        return "\n".join([*self.above, text])

    def write(self) -> Path:
        """Write the folder."""
        self.folder.mkdir(parents=True, exist_ok=True)
        text = yaml.safe_dump(self.content, sort_keys=False, allow_unicode=True)
        (self.folder / "campaign.yaml").write_text(self.yaml(text), encoding="utf-8")
        (self.folder / FILE).write_bytes(self.text().encode(self.encoding))
        for name, content in self.more.items():
            (self.folder / name).write_bytes(content)
        return self.folder

    def copy(self, folder: Path) -> Own:
        """Return it anew, for a folder of its own."""
        return Own(folder, self.table.copy(), deepcopy(self.content))


def own_campaign(folder: Path, **plan: Any) -> Own:
    """Simulate a campaign of a UR10 under a tracker, and write it as a German export is."""
    raw = simulated(folder / "raw", "ur10", "pose", **{"poses": 40, **plan})
    rows = pd.read_csv(raw / "poses.csv")
    rows = rows[rows["kind"].isin(["grid", "holdout"])].reset_index(drop=True)
    angles = Rotation.from_quat(rows[["qw", "qx", "qy", "qz"]], scalar_first=True)
    at = pd.Timestamp("2026-03-05 09:30") + pd.to_timedelta(rows["time_s"], unit="s")
    table = pd.DataFrame({"Zeit": at.dt.strftime("%d.%m.%Y %H:%M:%S"), "Punkt": rows["pose"]})
    table[JOINTS] = rows[[f"q{k}_deg" for k in range(1, 7)]]
    table[PLACE] = rows[["x_mm", "y_mm", "z_mm"]]
    table[TURN] = np.round(angles.as_euler("ZYX", degrees=True), 6)
    table["Raumtemperatur [°C]"] = 21.5
    table["Last [N]"] = rows["load_N"].astype(float)
    table["Satz"] = rows["kind"].map({"grid": "Training", "holdout": "Prüfung"})
    described = yaml.safe_load((raw / "campaign.yaml").read_text(encoding="utf-8"))
    content = described | {
        "name": "zelle",
        "files": {"poses": FILE},
        "columns": {
            "poses": {
                "separator": ";",
                "decimal": ",",
                "time": {"names": "Zeit", "format": "%d.%m.%Y %H:%M:%S"},
                "pose": "Punkt",
                "joints": {"names": JOINTS, "unit": "deg"},
                "position": {"names": PLACE, "unit": "mm"},
                "rotation": {"names": TURN, "convention": "euler_ZYX", "unit": "deg"},
                "temperature": {"names": "Raumtemperatur [°C]"},
                "load": {"names": "Last [N]"},
                "kind": {
                    "names": "Satz",
                    "words": {"Training": "grid", "Prüfung": "holdout"},
                },
            }
        },
    }
    return Own(folder / "zelle", table, content)


def with_quaternions(own: Own) -> None:
    """Give the orientations as quaternions, scalar first."""
    angles = Rotation.from_euler("ZYX", own.table[TURN], degrees=True)
    at = own.table.columns.get_loc(TURN[0])
    for k, name in enumerate(QUATERNION):
        own.table.insert(at + k, name, np.round(angles.as_quat(scalar_first=True)[:, k], 9))
    own.table = own.table.drop(columns=TURN)
    own.poses["rotation"] = {"names": QUATERNION, "convention": "quaternion_wxyz"}


# Commands, called in the process.


@dataclass(frozen=True)
class Said:
    """What a command printed, and its exit code."""

    code: int
    out: str
    err: str

    @property
    def text(self) -> str:
        """Return all that was printed."""
        return self.out + self.err


def call(*words: object) -> Said:
    """Call a command."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = main([str(word) for word in words])
        except SystemExit as left:  # of the parser of arguments
            code = int(left.code or 0)
    return Said(code, out.getvalue(), err.getvalue())


def ingest(own: Own) -> Said:
    """Ingest the campaign."""
    folder, beside = own.write(), own.folder.parent
    words = ("--out", beside / "poses.parquet", "--quarantine", beside / "quarantine.csv")
    return call("ingest", "--campaign-dir", folder, *words)


def calibrate(own: Own, *more: object) -> Said:
    """Ingest and calibrate the campaign; what the first steps say is said too."""
    beside = own.folder.parent
    said = [ingest(own)]
    of = ("--campaign-dir", own.folder, "--poses", beside / "poses.parquet")
    frame = beside / "base_frame.json"
    if not said[-1].code:
        said.append(call("seed", *of, "--out", frame))
    if not said[-1].code:
        load = ("--load", "combined", "--out", beside / "combined.json")
        said.append(call("calibrate", *of, "--base-frame", frame, *load, *more))
    out, err = ("".join(getattr(each, name) for each in said) for name in ("out", "err"))
    return Said(said[-1].code, out, err)


def columns(own: Own, *names: str) -> Said:
    """Propose a campaign.yaml for files of the campaign."""
    own.write()
    paths = [own.folder / name for name in names or (FILE,)]
    return call("columns", *paths, "--robot", "ur10")


# What a message must hold, and what it must not.

#: Remedies that messages may offer, by what they change. A message offers none but that which
#: puts its mistake right.
REMEDIES = {
    "unit of joints": r"joints\.unit: \w+|convert the columns to degrees|57\.29578",
    "unit of lengths": r"(position|targets\.\w+)\.unit: \w+|columns to millimetres|by 1000",
    "unit of orientations": r"rotation\.unit: \w+",
    "unit of loads": r"load\.unit: \w+",
    "unit of temperatures": r"temperature\.unit: \w+|subtract 273",
    "signs": r"joint_signs: \[|multiply \S+ .*by -1|reverse the axis",
    "zeros": r"joint_offsets_deg: \[",
    "order of joints": r"joints\.names: \[|exchange the columns",
    "convention": r"rotation\.convention: \w+|rename the columns: they|convert them to quat",
    "inverse": r"rotation\.inverse: \w+|convert the orientations",
    "axes": r"position\.names: \[|turn the sign of one|left-handed",
    "gravity": r"gravity_m_s2: \[|pointing down",
    "decimal": r"\bdecimal: '?[.,]|with decimal points",
    "separator": r"separator: \S+|with commas",
    "header": r"header: \d+",
    "time": r"time\.format: ",
    "mass": r"mass_kg: [\d.]+|mass is in grams",
    "uncertainty": r"uncertainty_mm: [\d.]+",
    "kind": r"instrument\.kind: \w+|kind points",
    "rows": r"a row is missing|take it out",
    "files": r"exchange files",
    "clock": r"clock_offset_s",
    "words": r"kind\.words",
    "quarantine": r"raise the setting",
    "meant": r"did you mean|is it '",
}


@dataclass(frozen=True)
class Mistake:
    """A mistake, and what is to be said of it."""

    name: str
    spoil: Callable[[Own], object]  # what is made wrong
    cause: str  # pattern of what says what is wrong
    place: str  # pattern of what says where: file, line, column in the file's own words, key
    remedy: str  # pattern of what says what to do: key and value
    offers: tuple[str, ...] = ()  # of `REMEDIES`: those that may be offered
    command: Callable[[Own], Said] = ingest
    warned: bool = False  # whether the command goes on, and says so

    def __str__(self) -> str:
        return self.name

    def judge(self, own: Own) -> None:
        """Make it in a right campaign, and fail where what is said of it is not right."""
        self.spoil(own)
        said = self.command(own)
        assert not faults(self, said), said.text


def faults(mistake: Mistake, said: Said) -> list[str]:
    """Return what is wrong in what a command says of a mistake."""
    found = []
    if (said.code == 0) != mistake.warned:
        found.append(f"exit code {said.code}")
    if "Traceback" in said.text or "internal fault" in said.text or said.code == 3:
        found.append("a fault of the program")
    told = told_of(said)
    for part in ("cause", "place", "remedy"):
        if not re.search(getattr(mistake, part), told):
            found.append(f"no {part}")
    for name, like in REMEDIES.items():
        if name not in mistake.offers and (offered := re.search(like, told)):
            found.append(f"wrong remedy: {name}: {offered[0]}")
    return found


def told_of(said: Said) -> str:
    """Return messages of a command: refusals, warnings, findings; no rows, no proposal."""
    lines = said.err.splitlines()
    marks = ("suspect_input", "incomplete:", "not_converged", "# check", "; not read of")
    marks += ("as held-out poses confirm",)
    lines += [line for line in said.out.splitlines() if any(mark in line for mark in marks)]
    return "\n".join(lines)


#: What makes a mistake, alone or with the command that is to notice it.
Made = Callable[[Own], object] | tuple[Callable[[Own], object], Callable[[Own], Said]]


def told(section: str, made: dict[str, Made]) -> list[Mistake]:
    """Return mistakes with what a section of `campaign/mistakes.yaml` has of each."""
    path = Path(__file__).parent / "campaign/mistakes.yaml"
    texts = yaml.safe_load(path.read_text(encoding="utf-8"))[section]
    assert list(texts) == list(made)
    mistakes = []
    for name, text in texts.items():
        cause, place, remedy, offers, warned = [*text.split(" | "), "", ""][:5]
        spoil, command = given if isinstance(given := made[name], tuple) else (given, ingest)
        offered = tuple(each for each in offers.split(", ") if each not in ("", "none"))
        mistakes.append(
            Mistake(name, spoil, cause, place, remedy, offered, command, warned == "warned")
        )
    return mistakes


def sequence(*changes: Callable[[Own], object]) -> Callable[[Own], None]:
    """Return changes one after the other."""

    def change(own: Own) -> None:
        for each in changes:
            each(own)

    return change


def put(key: str, value: object) -> Callable[[Own], None]:
    """Return what states a key of campaign.yaml; None takes it out."""

    def change(own: Own) -> None:
        *above, last = key.split(".")
        place = own.content
        for part in above:
            place = place[part]
        if value is None:
            del place[last]
        else:
            place[last] = value(place[last]) if callable(value) else value

    return change


def scaled(names: Sequence[str], factor: float) -> Callable[[Own], None]:
    """Return what multiplies columns."""

    def change(own: Own) -> None:
        own.table[list(names)] = np.round(own.table[list(names)] * factor, 9)

    return change


def exchanged(first: str, second: str) -> Callable[[Own], None]:
    """Return what exchanges the content of two columns."""

    def change(own: Own) -> None:
        own.table[[first, second]] = own.table[[second, first]].to_numpy()

    return change


def edited(old: str, new: str) -> Callable[[Own], None]:
    """Return what changes the text of campaign.yaml."""

    def change(own: Own) -> None:
        def text(given: str) -> str:
            assert old in given, given
            return given.replace(old, new, 1)

        own.yaml = text

    return change
