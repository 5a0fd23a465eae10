"""Measured campaigns at hand: groups, models carried, one table; what fails is a row of it."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from made_up_datasets import write_titan
from pa10cal.commands.command_line import REFUSED, main
from pa10cal.datasets import known_campaigns, measured
from pa10cal.datasets.known_campaigns import (
    CAMPAIGNS,
    CARRIED,
    GROUPS,
    at_hand,
    files_of,
    groups_of,
)
from pa10cal.datasets.measured import (
    BEGIN,
    END,
    MeasuredResults,
    errors_by_model,
    markdown,
    page_text,
)
from pa10cal.datasets.measured import main as write_page
from pa10cal.errors import SettingsError
from pa10cal.results.codec import read, write
from pa10cal.results.evaluation import TransferRecord
from pa10cal.results.outcomes import (
    Carried,
    ChainRecord,
    HeldOutError,
    MeasuredRobot,
    MeasuredRobotsRecord,
)

EXAMPLE = Path(__file__).parents[2] / "examples/irb120-points"
NAMES = ("iiwa7-free", "iiwa7-0kg", "spoiled")
PAIR = NAMES[:2]


def take(*folders, results, code=0):
    words = ["chain", "--campaign-dir", *map(str, folders), "--results", str(results)]
    assert main(words) == code


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Two copies of an example under the names of measured campaigns, and one that is spoiled."""
    folder = tmp_path_factory.mktemp("measured")
    for name in NAMES:
        raw = shutil.copytree(EXAMPLE, folder / "raw" / name)
        text = (raw / "campaign.yaml").read_text()
        (raw / "campaign.yaml").write_text(text.replace("name: irb120-points", f"name: {name}"))
    (folder / "raw/spoiled/poses.csv").write_text("time_s,q9_deg\n1,2\n")
    for name in NAMES:
        code = REFUSED if name == "spoiled" else 0
        take(folder / "raw" / name, results=folder / "results" / name, code=code)
    take(*(folder / "raw" / name for name in PAIR), results=folder / "results/pair")
    return folder


@pytest.fixture(scope="module")
def table(place):
    """The record of all of them."""
    words = ["measured", "--results", str(place / "results"), "--out", str(place / "results")]
    folders = [str(place / "raw" / name) for name in NAMES]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(known_campaigns, "GROUPS", {"pair": PAIR})
        assert main([*words, "--campaign-dir", *folders]) == 0
    return read(MeasuredRobotsRecord, place / "results/measured.json")


@pytest.mark.slow
def test_a_group_is_fitted_as_one_and_stands_after_its_campaigns(place, table):
    assert [each.campaign for each in table.robots] == [*PAIR, "pair", "spoiled"]
    group = table.robots[2]
    assert (group.status, group.members, group.published) == ("done", PAIR, None)
    assert group.poses == sum(each.poses for each in table.robots[:2])
    assert group.instrument == "optical tracker, poses; torques logged"
    held_out = json.loads((place / "results/pair/evaluation/holdout.json").read_text())
    assert group.errors["effects"].rms_mm == held_out["models"]["extended"]["rms_mm"]


@pytest.mark.slow
def test_what_is_refused_is_a_row_with_its_message(table, place):
    last = table.robots[-1]
    assert (last.status, last.errors, last.verdict) == ("refused", {}, None)
    assert last.message.startswith("ingest: poses.csv")
    assert str(place) not in last.message
    rows = list(csv.DictReader((place / "results/measured.csv").read_text().splitlines()))
    assert [row["campaign"] for row in rows] == [*PAIR, PAIR[1], "pair", "spoiled"]
    assert [row["model_of"] for row in rows] == [*PAIR, PAIR[0], "pair", "spoiled"]
    assert rows[-1]["status"] == "refused"
    assert float(rows[0]["nominal_mean_mm"]) == pytest.approx(
        table.robots[0].errors["nominal"].mean_mm, abs=1e-4
    )


@pytest.mark.slow
def test_a_model_is_carried_with_base_and_tool_fitted_anew(place, table):
    (carried,) = table.robots[1].carried
    assert carried.source == "iiwa7-free"
    # The same readings: the model of the one is as good in the other.
    assert carried.errors["effects"].rms_mm == pytest.approx(
        table.robots[1].errors["effects"].rms_mm, rel=0.1
    )
    assert (place / "results/transfer/iiwa7-free_in_iiwa7-0kg.json").is_file()
    assert not any(each.carried for each in (table.robots[0], *table.robots[2:]))


@pytest.mark.slow
def test_a_model_that_cannot_be_carried_is_a_row_too(place, tmp_path, capsys):
    results = tmp_path / "results"
    for name in PAIR:
        shutil.copytree(place / "results" / name, results / name)
    path = results / "iiwa7-free/calibration/combined.json"
    record = json.loads(path.read_text())
    path.write_text(json.dumps(record | {"robot": "another"}))
    folders = [str(place / "raw" / name) for name in PAIR]
    words = ["measured", "--results", str(results), "--out", str(results)]
    assert main([*words, "--campaign-dir", *folders]) == 0
    (carried,) = read(MeasuredRobotsRecord, results / "measured.json").robots[1].carried
    assert "cannot be carried over" in carried.message
    assert not carried.errors
    assert "cannot be carried over" in capsys.readouterr().out


@pytest.mark.slow
def test_a_group_of_which_one_is_refused_is_refused(place, tmp_path):
    folders = (place / "raw" / name for name in NAMES[1:])
    take(*folders, results=tmp_path / "pair", code=REFUSED)
    found = read(ChainRecord, tmp_path / "pair/chain.json")
    assert (found.campaign, found.status, found.stage) == ("pair", "refused", "ingest")
    assert "spoiled" in found.message
    assert [path.name for path in (tmp_path / "pair").iterdir()] == ["chain.json"]


def test_a_data_set_of_another_version_is_refused_by_checksum(tmp_path):
    source, raw = write_titan(tmp_path / "titan"), tmp_path / "raw/titan-rail"
    words = ["chain", "--campaign-dir", str(raw), "--results", str(tmp_path / "results")]
    given = ["--dataset", "titan-robot-accuracy", "--source", str(source)]
    assert main([*words, *given]) == REFUSED
    found = read(ChainRecord, tmp_path / "results/chain.json")
    assert (found.status, found.stage) == ("refused", "import")
    assert "the checksum differs" in found.message
    assert "fetch the data set again" in found.message
    assert not raw.exists()


@pytest.mark.parametrize(
    ("folders", "given"),
    [
        ("a", ["--dataset", "titan-robot-accuracy"]),
        ("a", ["--source", "."]),
        ("ab", ["--dataset", "titan-robot-accuracy", "--source", "."]),
    ],
)
def test_a_data_set_needs_its_folder_and_one_campaign(tmp_path, capsys, folders, given):
    raw = [str(tmp_path / name) for name in folders]
    words = ["chain", "--campaign-dir", *raw, "--results", str(tmp_path / "results"), *given]
    assert main(words) == REFUSED
    assert "--dataset with --source and one folder" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_without_a_campaign_it_says_how_to_come_by_one(tmp_path, capsys):
    words = ["measured", "--results", str(tmp_path), "--out", str(tmp_path)]
    assert main(words) == REFUSED
    assert "no measured campaign is at hand" in capsys.readouterr().err


def test_campaigns_go_by_the_names_of_their_folders(tmp_path, monkeypatch, capsys):
    folders = [tmp_path / "a/arm", tmp_path / "b/arm"]
    for folder in folders:
        folder.mkdir(parents=True)
    words = ["measured", "--results", str(tmp_path), "--out", str(tmp_path), "--campaign-dir"]
    assert main([*words, *map(str, folders)]) == REFUSED
    assert "two folders of campaigns have one name" in capsys.readouterr().err
    refused = ChainRecord(campaign="arm", status="refused", stage="ingest", message="no rows")
    (tmp_path / "arm").mkdir()
    write(refused, tmp_path / "arm/chain.json")
    monkeypatch.chdir(folders[0])
    assert main([*words, "."]) == 0
    (row,) = read(MeasuredRobotsRecord, tmp_path / "measured.json").robots
    assert (row.campaign, row.message) == ("arm", "ingest: no rows")


def test_at_hand_are_folders_of_campaigns_and_data_sets_that_were_fetched(tmp_path):
    here, elsewhere = tmp_path / "measured", tmp_path / "elsewhere"
    for name in ("zebra", "titan-rail", "titan-robot-accuracy/x", "no-campaign"):
        (here / name).mkdir(parents=True)
    for name in ("zebra", "titan-rail"):
        (here / name / "campaign.yaml").write_text("")
    elsewhere.mkdir()
    (elsewhere / "a.csv").write_text("")
    sources = {"welding-motoman": str(elsewhere), "faro-irb120": "https://example.invalid/"}
    found = at_hand(here, sources, tmp_path / "imported")
    assert list(found) == ["titan-fixed", "titan-rail", "ma2010-0516", "ma2010-0801", "zebra"]
    assert found["titan-rail"].dataset is None
    assert found["titan-fixed"].folder == tmp_path / "imported/titan-fixed"
    assert found["titan-fixed"].source == here / "titan-robot-accuracy"
    assert list(files_of(found["ma2010-0516"])) == [elsewhere / "a.csv"]
    assert list(groups_of(found)) == ["ma2010"]


def test_a_folder_of_a_data_set_that_is_not_there_is_refused(tmp_path, monkeypatch):
    sources = {"titan-robot-accuracy": str(tmp_path / "titn")}
    with pytest.raises(SettingsError, match=r"titan-robot-accuracy: there is no such folder.*titn"):
        at_hand(tmp_path, sources, tmp_path / "imported")
    (tmp_path / "titan").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path))
    found = at_hand(tmp_path, {"titan-robot-accuracy": "~/titan"}, tmp_path / "imported")
    assert found["titan-fixed"].source == tmp_path / "titan"


def test_an_address_of_a_data_set_hides_no_folder_into_which_it_was_fetched(tmp_path):
    (tmp_path / "titan-robot-accuracy").mkdir()
    sources = {"titan-robot-accuracy": "https://example.invalid/"}
    found = at_hand(tmp_path, sources, tmp_path / "imported")
    assert found["titan-fixed"].source == tmp_path / "titan-robot-accuracy"


def test_a_carried_model_has_springs_where_its_own_calibration_has(tmp_path, monkeypatch):
    made = SimpleNamespace(mean_mm=1.0, rms_mm=2.0)
    made.by_place = {"": made}
    springs_of = {"rigid": False, "soft": True}

    def read_made(record, path, within=None):
        if record is TransferRecord:
            return SimpleNamespace(models={"uncalibrated": made, "linear": made})
        return SimpleNamespace(has_springs=springs_of[within.name])

    monkeypatch.setattr(measured, "read", read_made)
    for source, model in (("rigid", "geometry"), ("soft", "springs")):
        carried = {(source, "c"): tmp_path / "transfer.json"}
        table = MeasuredResults(tmp_path, "combined", carried)
        (one,) = table.models_carried_to("c", tmp_path / "c")
        assert list(one.errors) == ["nominal", model]


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("ingest: {0}/raw/c/poses.csv:3: bad", "ingest: poses.csv:3: bad"),
        ("{0}/raw/c: no poses", "c: no poses"),
        ("{0}/raw/c.", "c."),
        ("{0}/raw/c-2/poses.csv", "{0}/raw/c-2/poses.csv"),
        ("see other{0}/raw/c/poses.csv", "see other{0}/raw/c/poses.csv"),
        ("raw/c/poses.csv and draw/c/x", "poses.csv and draw/c/x"),
    ],
)
def test_a_message_names_files_from_their_folder(tmp_path, monkeypatch, message, expected):
    monkeypatch.chdir(tmp_path)
    for folder in (tmp_path / "raw/c", Path("raw/c")):
        if folder.is_absolute() == ("{0}" in message):
            found = measured._without_folders(message.format(tmp_path), folder)
            assert found == expected.format(tmp_path)


def test_what_is_known_names_campaigns_that_are_known():
    assert {name for members in GROUPS.values() for name in members} <= set(CAMPAIGNS)
    assert {name for pair in CARRIED for name in pair} <= set(CAMPAIGNS)


@pytest.mark.parametrize(
    ("models", "springs", "expected"),
    [
        (
            ["uncalibrated", "linear", "extended"],
            False,
            {"nominal": 0, "geometry": 1, "effects": 2},
        ),
        (["uncalibrated", "geometry"], False, {"nominal": 0, "geometry": 1}),
        (
            ["uncalibrated", "geometry", "linear", "extended"],
            True,
            {"nominal": 0, "geometry": 1, "springs": 2, "effects": 3},
        ),
        ([], True, {}),
    ],
)
def test_errors_by_model_take_what_is_there(models, springs, expected):
    class Made:
        def __init__(self, mm):
            self.mean_mm = self.rms_mm = float(mm)
            self.by_place = {"at unseen stretches": self, "between measured places": None}

    held_out = {name: Made(k) for k, name in enumerate(models)}
    found = errors_by_model(held_out, springs=springs)
    assert {model: error.mean_mm for model, error in found.items()} == expected


def robot(**keys):
    keys = {"campaign": "c", "status": "done", "names": (), "faults": (), "errors": {}} | keys
    return MeasuredRobot(**({"carried": ()} | keys))


def test_the_page_gets_its_tables_between_the_marks(tmp_path):
    error = HeldOutError(mean_mm=0.25, rms_mm=0.5)
    named = robot(
        campaign="one",
        robot="an arm",
        instrument="a | tracker",
        verdict="named",
        names=("backlash of joint 1 or arrival_error of joint 1",),
        faults=("load_label at P3",),
        errors={"nominal": error},
        poses=10,
        held_out=2,
        carried=(Carried(source="two", errors={"springs": error}),),
    )
    record = MeasuredRobotsRecord(robots=(named, robot(status="fault", message="export: oh")))
    path, page = tmp_path / "measured.json", tmp_path / "page.md"
    path.write_text(record.model_dump_json())
    page.write_text(f"# Before\n{BEGIN}\nold\n{END}\nafter\n")
    for _ in range(2):
        write_page([str(path), str(page)])
    text = page.read_text()
    assert text == page_text(text, record)
    assert text.startswith("# Before\n")
    assert text.endswith(f"{END}\nafter\n")
    assert "old" not in text
    assert (
        "| `one` | an arm, a \\| tracker | 10 (2) | 0.250 / 0.500 |  |  |  | `named`; backlash of "
        "joint 1 or arrival_error of joint 1; the log: load_label at P3 |  |"
    ) in text
    assert "| `c` |  |  |  |  |  |  | fault: export: oh |  |" in text
    assert "| `two` | `one` |  |  | 0.250 / 0.500 |  |" in text
    assert "Carried" not in markdown(MeasuredRobotsRecord(robots=(robot(),)))


@pytest.mark.parametrize("page", [None, "# No marks\n"])
def test_a_page_without_marks_or_none_is_refused(tmp_path, capsys, page):
    path, record = tmp_path / "page.md", tmp_path / "measured.json"
    record.write_text(MeasuredRobotsRecord(robots=(robot(),)).model_dump_json())
    if page is not None:
        path.write_text(page)
    with pytest.raises(SystemExit) as caught:
        write_page([str(record), str(path)])
    assert caught.value.code == 2
    assert ("page.md" if page is None else "no place for the table") in capsys.readouterr().err


def test_the_writer_of_the_page_says_how_to_call_it(capsys):
    with pytest.raises(SystemExit) as caught:
        write_page(["--help"])
    assert caught.value.code == 0
    assert "results/measured/measured.json" in capsys.readouterr().out
