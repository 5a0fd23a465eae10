"""Rows of one target each: by a column of targets, or by the endings of labels."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import yaml

from made_up_sightings import sighted
from pa10cal.campaign.own_columns import TargetOfRow
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.row_targets import label_endings, target_names
from pa10cal.errors import Pa10calError

Q = [f"J{j}" for j in range(1, 7)]
NAMES = ("A", "B", "C")


@pytest.fixture
def sightings(tmp_path):
    """Return a campaign of three targets, and a row for each that was seen."""
    raw = sighted(tmp_path, "points")
    rng = np.random.default_rng(4)
    rows = [
        {"Name": f"P{pose}", "Target": name, **dict(zip(Q, np.degrees(q), strict=True))}
        | dict(zip("XYZ", 1e3 * p_m, strict=True))
        for pose, (q, places_m) in enumerate(zip(raw.q, raw.p_instr_m, strict=True))
        for name, p_m in zip(NAMES, places_m, strict=True)
        if rng.random() > 0.1 and np.isfinite(p_m).all()
    ]
    return raw, pd.DataFrame(rows)


@pytest.fixture
def read(tmp_path, proposed):
    """Write tables, propose a campaign.yaml for them, and read the campaign so."""

    def run(*tables):
        folder = tmp_path / "mine"
        folder.mkdir()
        paths = [folder / f"export{k}.csv" for k in range(len(tables))]
        for path, table in zip(paths, tables, strict=True):
            table.to_csv(path, index=False)
        return proposed(*paths, folder=folder), read_campaign(folder)

    return run


def same_places(found, raw, table):
    """Compare what was read with what was measured; blanks are targets without a row."""
    every = found.observations
    assert found.quarantined == ()
    assert every.measured.target_names == NAMES
    order = np.argsort([int(pose.removeprefix("P")) for pose in every.pose])
    rows = set(zip(table["Name"], table["Target"], strict=True))
    seen = np.array([[(f"P{k}", name) in rows for name in NAMES] for k in range(len(raw.q))])
    expected = np.where(seen[..., None], raw.p_instr_m, np.nan)
    np.testing.assert_allclose(every.measured.places_m[order], expected, atol=1e-9)
    np.testing.assert_allclose(every.states.q_rad[order], raw.q, atol=1e-9)


def test_a_row_of_one_target_that_cannot_be_read_is_quarantined(sightings, read):
    _, table = sightings
    table = table.astype({"X": object})
    table.loc[5, "X"] = "lost"
    _, found = read(table)
    (row,) = found.quarantined
    assert row.line == 7
    assert "lost" in row.value


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize(
    "written",
    [
        lambda row: f"{row['Name']}_{row['Target']}",
        lambda row: f"{row['Name']}.{row['Target']}",
        lambda row: f"{row['Name']} - {row['Target']}",
        lambda row: f"{row['Name']}{row['Target']}",
        lambda row: f"{row['Name']} ({row['Target']})",
    ],
)
@pytest.mark.usefixtures("tried")
def test_rows_of_one_target_are_joined_by_their_labels(sightings, read, written):
    raw, table = sightings
    own = table.assign(Name=table.apply(written, axis=1)).drop(columns="Target")
    text, found = read(own)
    assert f"# read so: {len(raw.q)} rows can be used, 0 cannot" in text
    assert "# check target: every row is of one target, by Name: A, B, C" in text
    same_places(found, raw, table)


def test_a_column_of_targets_beside_labels(sightings, read):
    raw, table = sightings
    text, found = read(table)
    assert "which target the row is of" in text
    same_places(found, raw, table)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("labels", ["Name", "Measurement"])
@pytest.mark.usefixtures("tried")
def test_joints_in_another_log_have_the_labels_without_targets(sightings, read, labels):
    raw, table = sightings
    joints = pd.DataFrame(np.degrees(raw.q), columns=Q)
    joints.insert(0, "Name", [f"P{k}" for k in range(len(raw.q))])
    readings = table[["X", "Y", "Z"]].copy()
    readings.insert(0, labels, table["Name"] + "_" + table["Target"])
    text, found = read(joints, readings)
    assert "joined by label" in text
    assert any("rows of one target each" in note for note in found.notes)
    same_places(found, raw, table)


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("column", ["Target", "SMR no", "Reflector", "Remark"])
def test_a_row_a_pose_with_the_number_of_its_target(sightings, read, column):
    """A column that is not called after targets is found by the nominal arm."""
    raw, table = sightings
    one = table.groupby("Name", sort=False).sample(1, random_state=2).sort_index()
    number = one["Target"].map({name: k for k, name in enumerate(NAMES, start=1)})
    own = one.drop(columns=["Name", "Target"]).assign(**{column: number})
    content, found = read(own)
    stated = yaml.safe_load(content)["columns"]["poses"]["target"]
    assert stated == {"names": column, "words": {"1": "T1", "2": "T2", "3": "T3"}}
    seen = np.isfinite(found.observations.measured.places_m[..., 0])
    assert (seen.sum(axis=1) == 1).all()
    assert len(seen) == len(raw.q)
    assert not any("nominal model" in warning for warning in found.warnings)


def test_repeats_that_end_so_are_no_targets(sightings, read):
    table = sightings[1]
    one = table[table["Target"] == "A"]
    again = pd.concat([one.assign(Name=one["Name"] + f"_{k}") for k in (1, 2)])
    again[list("XYZ")] += np.random.default_rng(1).normal(0, 0.02, (len(again), 3))
    text, found = read(again.drop(columns="Target"))
    assert "every row is of one target" not in text
    assert len(found.observations) == len(again)


def test_other_labels_have_no_endings():
    p = np.random.default_rng(1).uniform(-1.0, 1.0, (12, 3))
    assert label_endings([f"P{k}" for k in range(12)], p) == []
    assert label_endings([f"Pose {k}" for k in range(12)], p) == []
    assert label_endings([""] * 12, p) == []
    assert label_endings(["P1_A"] * 12, p) == []
    assert label_endings([f"P{k // 2}_{'AB'[k % 2]}" for k in range(12)], p) == ["_A", "_B"]


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("Temperature [C]", lambda k: f"{20 + 0.1 * k:.1f}"),
        ("Humidity", lambda k: f"{43 - 0.1 * k:.1f}"),
        ("Target speed", lambda k: str((100, 250, 500)[k % 3])),
        ("Target locked", lambda k: str(k % 4 > 0)),
    ],
)
def test_what_is_no_name_is_no_target(sightings, read, column, value):
    table = sightings[1]
    one = table[table["Target"] == "A"].drop(columns="Target").reset_index(drop=True)
    one[column] = [value(k) for k in range(len(one))]
    text, found = read(one)
    assert "target" not in yaml.safe_load(text)["columns"]["poses"]
    assert found.quarantined == ()


@pytest.mark.parametrize(
    ("column", "told"), [("Target", True), ("Target speed", False), ("Target", False)]
)
def test_targets_in_the_log_of_joints_are_to_be_copied(sightings, read, column, told):
    table = sightings[1]
    one = table[table["Target"] == "A"].drop(columns="Target").reset_index(drop=True)
    words = ("1", "2", "3") if told or column != "Target" else ("1", "")
    joints = one[["Name", *Q]].assign(**{column: np.resize(words, len(one))})
    text, _ = read(joints, one[["Name", "X", "Y", "Z"]])
    assert (f"{column} of export0.csv says which target a row is of" in text) == told


@pytest.mark.parametrize("logs", [1, 2])
def test_places_of_a_grid_are_no_targets(sightings, read, logs):
    """Between them the arm moves, as it does not between targets of one pose."""
    table = sightings[1]
    one = table[table["Target"] == "A"].drop(columns="Target").reset_index(drop=True)
    one["Name"] = [f"R{k // 6}_C{k % 6}" for k in range(len(one))]
    tables = [one] if logs == 1 else [one[["Name", *Q]], one[["Name", "X", "Y", "Z"]]]
    text, found = read(*tables)
    assert "every row is of one target" not in text
    assert len(found.observations) == len(one)


def test_configurations_that_are_all_lost_are_refused(sightings, read, tmp_path):
    """Though each counts as one of many rows."""
    table = sightings[1]
    one = table[table["Target"] == "A"].drop(columns="Target").reset_index(drop=True)
    one["Name"] = [f"R{k // 6}_C{k % 6}" for k in range(len(one))]
    read(one[["Name", *Q]], one[["Name", "X", "Y", "Z"]])
    path = tmp_path / "mine" / "campaign.yaml"
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    columns = content["columns"]["readings"]
    place = columns.pop("targets", None)
    columns["position"] = columns.get("position") or next(iter(place.values()))
    columns["target"] = {"names": "Name", "endings": {f"_C{k}": f"C{k}" for k in range(6)}}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(Pa10calError, match=r"no configuration is left.*no such label"):
        read_campaign(path.parent)


@pytest.mark.parametrize("slip", ["", "t2"])
@pytest.mark.parametrize("label", [False, True])
def test_one_odd_row_is_lost_alone(sightings, read, slip, label):
    table = sightings[1].copy()
    table.loc[5, "Target"] = slip
    if label:
        table = table.assign(Name=table["Name"] + "_" + table["Target"]).drop(columns="Target")
    text, found = read(table)
    assert "every row is of one target, by" in text
    assert [row.line for row in found.quarantined] == [7]


def test_a_column_of_targets_that_is_not_used_is_told(sightings, read):
    table = sightings[1].copy()
    table.loc[::7, "Target"] = ""
    text, _ = read(table)
    assert re.search("# check target: Target is not taken for it.* 1[45]% of the rows", text)


WORDS = {"A": "A", "B": "B", "C": "C"}


@pytest.mark.parametrize(
    ("target", "says"),
    [
        ({"names": "Target", "words": WORDS}, None),
        ({"names": "Target", "words": {"A": "A", "B": "B"}}, "the row names no target"),
        ({"names": "Target"}, "words of the column, or endings"),
        ({"names": "Target", "words": WORDS, "endings": WORDS}, "words of the column, or endings"),
        ({"names": "Target", "words": {"A": "a target"}}, "target.words"),
        ({"names": "Targt", "words": WORDS}, "is it 'Target'"),
        ({"names": ["Target", "Name"], "words": WORDS}, "target.names"),
    ],
)
def test_targets_of_rows_are_stated_completely(tmp_path, sightings, target, says):
    raw, table = sightings
    folder = tmp_path / "mine"
    folder.mkdir()
    table.to_csv(folder / "export.csv", index=False)
    columns = {
        "pose": "Name",
        "joints": {"names": Q},
        "position": {"names": list("XYZ")},
        "target": target,
    }
    content = yaml.safe_load((raw.write() / "campaign.yaml").read_text(encoding="utf-8"))
    content |= {"name": "mine", "files": {"poses": "export.csv"}, "holdout": {"every": 5}}
    content |= {"columns": {"poses": columns}}
    content["tool"].pop("balls_mm", None)
    path = folder / "campaign.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    if says is None:
        same_places(read_campaign(folder), raw, table)
        return
    with pytest.raises(Pa10calError, match=says):
        read_campaign(folder)


@pytest.mark.parametrize(
    "other", [{"position": None}, {"targets": {"T1": {"names": ["X", "Y", "Z"]}}}]
)
def test_a_target_of_the_row_goes_with_one_position(tmp_path, sightings, other):
    raw = sightings[0]
    columns = {"joints": {"names": Q}, "position": {"names": list("XYZ")}}
    columns |= {"target": {"names": "Target", "words": WORDS}} | other
    folder = raw.write()
    content = yaml.safe_load((folder / "campaign.yaml").read_text(encoding="utf-8"))
    stated = {key: value for key, value in columns.items() if value is not None}
    content["columns"] = {"poses": stated}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(Pa10calError, match="target goes with position"):
        read_campaign(folder)


def test_numbers_are_words():
    stated = TargetOfRow.model_validate({"names": "SMR", "words": {1: "T1", "2": "T2"}})
    assert [stated.of(word)[1] for word in ("1", "2", "3")] == ["T1", "T2", ""]


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["A", "B"], ["A", "B"]),
        (["1", "base1"], ["T1", "Tbase1"]),
        (["", "T1"], ["T2", "T1"]),
        (["T2", "u"], ["T2", "T3"]),
        (["A1", "A-1", "T2"], ["A1", "T3", "T2"]),
    ],
)
def test_every_target_has_a_name_of_its_own(words, names):
    assert list(target_names(words).values()) == names


def test_the_longest_ending_counts():
    stated = TargetOfRow(names=("Name",), endings={"A": "A", "_BA": "B"})
    assert stated.of("P1_BA") == ("P1", "B")
    assert stated.of("P1A") == ("P1", "A")
    assert stated.of("P1C") == ("P1C", "")
