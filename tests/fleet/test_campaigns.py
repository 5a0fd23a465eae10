"""Which campaigns a fleet consists of, and how every arm of it stands."""

import csv
import io
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from pa10cal.errors import SettingsError
from pa10cal.fleet import arm_status
from pa10cal.fleet.arm_status import fleet_csv, fleet_record, forget_ended
from pa10cal.fleet.campaigns import ListedCampaign, campaigns_of, from_any_folder, in_order
from pa10cal.reports.page import fleet_page_text
from pa10cal.results.codec import write
from pa10cal.results.outcomes import ChainRecord, FleetArm, FleetCampaign, FleetRecord


@pytest.fixture
def raw(tmp_path):
    for name in ("b", "a", "2026-1", "2026-2"):
        (tmp_path / "raw" / name).mkdir(parents=True)
        (tmp_path / "raw" / name / "campaign.yaml").touch()
    (tmp_path / "raw" / "no-campaign").mkdir()
    return tmp_path / "raw"


def table(raw, text):
    path = raw.parent / "arms.csv"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_pattern_finds_campaigns_in_the_order_of_their_names(raw):
    assert [each.campaign for each in campaigns_of("*", raw)] == ["2026-1", "2026-2", "a", "b"]
    assert [each.campaign for each in campaigns_of(f"{raw}/2026-*", raw)] == ["2026-1", "2026-2"]
    assert campaigns_of("a", raw) == (ListedCampaign("a", "a"),)
    assert [each.campaign for each in campaigns_of("a, b", raw)] == ["a", "b"]
    with pytest.raises(SettingsError, match="there are no campaigns"):
        campaigns_of("", raw)


@pytest.mark.parametrize("asked", ["raw/2026-*", "./raw/2026-*", "raw/2026-*/", "{raw}/2026-*"])
@pytest.mark.parametrize("raw_dir", ["raw", "./raw", "{raw}"])
def test_folders_may_be_named_from_where_one_stands(raw, monkeypatch, asked, raw_dir):
    monkeypatch.chdir(raw.parent)
    asked, raw_dir = asked.format(raw=raw), Path(raw_dir.format(raw=raw))
    named = ["2026-1", "2026-2"]
    assert [each.campaign for each in campaigns_of(asked, raw_dir)] == named
    asked, raw_dir = from_any_folder(asked), raw_dir.absolute()
    monkeypatch.chdir("/")
    assert [each.campaign for each in campaigns_of(asked, raw_dir)] == named
    assert from_any_folder("2026-*") == "2026-*"
    assert from_any_folder("a, b") == "a, b"
    assert from_any_folder("arms.CSV") == "/arms.CSV"


def test_names_with_dots_are_found_and_hidden_folders_are_not(raw):
    for name in ("a..b", ".old"):
        (raw / name).mkdir()
        (raw / name / "campaign.yaml").touch()
    assert campaigns_of("a..b", raw) == (ListedCampaign("a..b", "a..b"),)
    assert len(campaigns_of("*", raw)) == 5


@pytest.mark.parametrize(
    ("dates", "ordered"),
    [
        (("2026-03-15", "2026-03"), False),
        (("2026-03-31", "2026-03-31"), False),
        (("2026-03-31T14:05Z", "2026-03-31 14:05"), False),
        (("2026-03", "2026-04-02", "2026"), False),
        (("2026-03", "2026-04-02", "2026-03-31T14:05"), False),
        (("2026-03-31T14:05Z", "2026-03-31T15:00"), False),
        (("2026-03-31", "2026-03-30T23:00Z"), False),
        (("2026-03-31T14:05Z", "2026-04-01T15:00"), True),
        (("2026-03-31T14:05Z", "2026-03-31T15:00Z"), True),
        (("2026-03-31", "2026-01-30T23:00Z"), True),
        (("2026-03", "2026-04-02", "2025"), True),
        (("2026-03-31 14:05", "2026-03-31T09:00"), True),
    ],
)
def test_dates_that_do_not_order_the_campaigns_of_an_arm_are_refused(raw, dates, ordered):
    rows = "".join(f"{name},left,{date}\n" for name, date in zip("abc", dates, strict=False))
    text = f"campaign,arm,measured\n{rows}d,right,{dates[0]}\n"
    if ordered:
        assert len(campaigns_of(table(raw, text), raw)) == len(dates) + 1
        return
    with pytest.raises(SettingsError, match="do not say which came first"):
        campaigns_of(table(raw, text), raw)


def test_a_pattern_finds_no_campaign_deeper_than_the_folder(raw):
    (raw / "no-campaign/deep").mkdir()
    (raw / "no-campaign/deep/campaign.yaml").touch()
    assert [each.campaign for each in campaigns_of("**", raw)] == ["2026-1", "2026-2", "a", "b"]


def test_a_time_with_seconds_is_after_the_same_minute_with_a_z():
    days = ("T14:05:30Z", "T14:05Z", "T14:05:30.5Z")
    listed = [ListedCampaign(day, "arm", f"2026-03-31{day}") for day in days]
    assert [each.campaign for each in in_order(listed)["arm"]] == [days[1], days[0], days[2]]


def test_a_table_says_arms_and_times_and_need_not_be_there(raw):
    text = "\ufeffarm, campaign ,measured\r\nleft,b,2026-02\r\n\r\n,a,\r\nleft,gone,2026-01\r\n"
    listed = campaigns_of(table(raw, text), raw)
    assert listed == (
        ListedCampaign("b", "left", "2026-02"),
        ListedCampaign("a", "a"),
        ListedCampaign("gone", "left", "2026-01"),
    )
    assert [each.campaign for each in in_order(listed)["left"]] == ["gone", "b"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no column campaign"),
        ("name\na\n", "no column campaign"),
        ("campaign;arm\na;left\n", "no column campaign.* divided by commas"),
        ("campaign,campaign\na,b\n", "a column twice"),
        ("campaign\n", "there are no campaigns"),
        ("campaign\n../a\n", r"row 2: no name of a campaign \(got '../a'\)"),
        ("campaign\na\nb\na\n", r"row 4: a campaign stands twice \(got 'a'\).*row 2"),
        ("campaign\n\na\n\nb\na\n", r"row 6: a campaign stands twice \(got 'a'\).*row 3"),
        ("arm\n,\n", "no column campaign"),
        ("campaign,arm\n,left\n", "no name of a campaign"),
        ('campaign\n"a\n', "cannot be read"),
        ("campaign,armm\na,left\n", r"line 1: .*an unknown name \(got 'armm'\)"),
        ("campaign,arm\na,left\nb\n", r"row 3: .*too few \(got 'b'\).*each of campaign, arm"),
        ("campaign,arm\na,left,2026\n", r"row 2: a row .* has too many cells"),
        ("campaign,measured\na,31.12.2025\n", r"row 2: no date .*\(got '31.12.2025'\)"),
        ("campaign,measured\na,2026-13-01\n", r"row 2: no date"),
        ("campaign,measured\na,20260331\n", r"with hyphens, such as 2026-03-31"),
        ("campaign,measured\na,2026-03-31T14:05+02:00\n", r"UTC as .*Z, no other zone"),
        ("\n\nname\na\n", r"line 3: .*no column campaign"),
        (
            "campaign,arm,measured\na,left,2026-01\nb,left,\n",
            r"row 3: some campaigns of an arm have a date, and others none",
        ),
    ],
)
def test_tables_that_cannot_be_meant_are_refused(raw, text, message):
    with pytest.raises(SettingsError, match=message):
        campaigns_of(table(raw, text), raw)


def test_what_is_not_there_is_refused(raw):
    with pytest.raises(SettingsError, match="there are no campaigns"):
        campaigns_of("2027-*", raw)
    with pytest.raises(SettingsError, match=r"cannot be read.*the file is not there"):
        campaigns_of("gone.csv", raw)
    with pytest.raises(SettingsError, match="no pattern of campaigns"):
        campaigns_of("../*", raw)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ("a,", r"^a,: no name of a campaign \(got ''\)[^\n]*correct it"),
        ("a,a", r"^a,a: a campaign stands twice \(got 'a'\); allowed: each campaign once;"),
    ],
)
def test_a_list_is_not_called_a_table(raw, asked, message):
    with pytest.raises(SettingsError) as refused:
        campaigns_of(asked, raw)
    assert re.search(message, str(refused.value)), str(refused.value)


@pytest.mark.parametrize(
    "measured", ["2026", "2026-02", "2026-02-28", "2026-02-28 23:59", "2026-02-28T23:59:59.5Z"]
)
def test_dates_and_times_are_of_iso_8601(raw, measured):
    (found,) = campaigns_of(table(raw, f"campaign,measured\na,{measured}\n"), raw)
    assert found.measured == measured


# How every arm of a fleet stands after its last campaign.


GOOD = {
    "status": "done",
    "robot": "irb120",
    "provenance": "Synthetic data",
    "grade": "good",
    "line": "as the noise explains",
    "verdict": "none",
    "notes": (),
    "before_mm": 1.0,
    "after_mm": 0.1,
    "over": "held-out poses",
}


@pytest.fixture
def fleet(tmp_path):
    """Make a fleet of arms a, b, …, each of one campaign that came to this."""

    def make(*became):
        listed = []
        for letter, changes in zip("abcdefgh", became, strict=False):
            name = f"c-{letter}"
            (tmp_path / name).mkdir()
            write(ChainRecord(campaign=name, **changes), tmp_path / name / "chain.json")
            listed.append(ListedCampaign(name, letter))
        return fleet_record(listed, tmp_path)

    return make


def test_arms_that_need_attention_come_first(fleet):
    found = fleet(
        GOOD,
        GOOD
        | {"verdict": "unexplained", "grade": "incomplete", "notes": ("unexplained: joint 2",)},
        GOOD | {"grade": "suspect_input", "line": "joint 3 is turned"},
        {"status": "refused", "stage": "ingest", "message": "no rows"},
        GOOD | {"verdict": "check_the_log", "notes": ("the log: P1",)},
        {"status": "fault", "stage": "discover", "message": "internal fault"},
    )
    assert [(each.arm, each.attention) for each in found.arms] == [
        ("d", "no_result"),
        ("f", "no_result"),
        ("c", "input"),
        ("e", "input"),
        ("b", "incomplete"),
        ("a", "none"),
    ]
    assert found.arms[0].why == "ingest: no rows"
    assert found.counts == {
        "fault": 1,
        "good": 2,
        "incomplete": 1,
        "refused": 1,
        "suspect_input": 1,
    }


def test_a_damaged_outcome_loses_no_other(fleet, tmp_path):
    fleet(GOOD, GOOD)
    (tmp_path / "c-a" / "chain.json").write_text('{"schema"')
    found = fleet_record([ListedCampaign("c-a", "a"), ListedCampaign("c-b", "b")], tmp_path)
    assert [(each.arm, each.attention) for each in found.arms] == [
        ("a", "no_result"),
        ("b", "none"),
    ]
    assert "chain.json" in found.arms[0].why


@pytest.fixture
def one_arm(tmp_path, monkeypatch):
    """Make an arm measured again and again; comparisons say which folders they compare."""

    def make(*became, compared=lambda previous, current: (True, f"{previous} {current}")):
        def comparison(one, other):
            return arm_status._Comparison(*compared(one.name, other.name))

        monkeypatch.setattr(arm_status, "_compared", comparison)
        listed = []
        for number, changes in enumerate(became):
            name = f"c-{number}"
            (tmp_path / name).mkdir()
            write(ChainRecord(campaign=name, **changes), tmp_path / name / "chain.json")
            listed.append(ListedCampaign(name, "a"))
        return fleet_record(listed, tmp_path)

    return make


@pytest.mark.parametrize(
    "faulty",
    [{"grade": "suspect_input"}, {"grade": "not_converged"}, {"verdict": "check_the_log"}],
)
def test_no_campaign_is_compared_with_a_faulty_one(one_arm, faulty):
    found = one_arm(GOOD, GOOD | faulty, GOOD)
    assert [each.moved for each in found.campaigns] == [None, "c-0 c-1", "c-0 c-2"]


def test_that_a_campaign_could_not_be_compared_is_told(one_arm):
    found = one_arm(GOOD, GOOD, compared=lambda *_: (None, "the covariance is missing"))
    (arm,) = found.arms
    assert arm.attention == "none"
    assert arm.why.endswith("not compared with the campaign before: the covariance is missing")


@pytest.mark.parametrize(
    ("moved", "agree", "told"),
    [
        ((), True, (True, "the models agree", False)),
        (("joint_zero of joint 3",), True, (True, "joint 3 moved; the models agree", True)),
        (("joint_zero of joint 3",), None, (None, "joint 3 moved; the models agree", True)),
    ],
)
def test_what_moved_is_told_whether_flanges_agree_or_not(monkeypatch, tmp_path, moved, agree, told):
    verdict = "joint_zero_moved" if moved else "unchanged"
    what = SimpleNamespace(moved=moved, line="joint 3 moved", verdict=verdict)
    record = SimpleNamespace(agree=agree, line="the models agree", what_moved=what)
    monkeypatch.setattr("pa10cal.evaluation.two_models.compare_models", lambda *_, **__: record)
    monkeypatch.setattr("pa10cal.fit.model_reading.load_model", lambda folder: folder)
    assert arm_status._compared(tmp_path / "one", tmp_path / "other") == told


def test_an_arm_that_moved_needs_attention_where_flanges_cannot_be_compared(one_arm):
    moved = (None, "joint 3 moved; whether the models agree cannot be judged", True)
    (arm,) = one_arm(GOOD, GOOD, compared=lambda *_: moved).arms
    assert (arm.attention, arm.why) == ("moved", moved[1])


@pytest.mark.parametrize("verdict", ["none", "not_sought", "named"])
def test_an_incomplete_model_needs_attention_unless_the_effect_is_named(fleet, verdict):
    (arm,) = fleet(GOOD | {"grade": "incomplete", "verdict": verdict}).arms
    assert arm.attention == ("none" if verdict == "named" else "incomplete")
    assert arm.why == "incomplete: as the noise explains"


def test_a_result_without_a_grade_is_none(fleet):
    (arm,) = fleet(GOOD | {"grade": None, "line": None}).arms
    assert (arm.attention, arm.why) == ("no_result", "done, without a grade")


def test_an_outcome_of_another_campaign_is_not_that_of_this_one(fleet, tmp_path):
    fleet(GOOD)
    (tmp_path / "c-b").mkdir()
    shutil.copy(tmp_path / "c-a" / "chain.json", tmp_path / "c-b")
    found = fleet_record([ListedCampaign("c-b", "b")], tmp_path)
    assert found.arms[0].attention == "no_result"
    assert "of another campaign" in found.arms[0].why


def test_only_outcomes_of_what_the_machine_ended_are_forgotten(fleet, tmp_path):
    fleet(GOOD, {"status": "ended"}, GOOD)
    (tmp_path / "c-c" / "chain.json").write_text("[" * 100_000)
    forget_ended([ListedCampaign(f"c-{letter}", letter) for letter in "abcd"], tmp_path)
    assert [(tmp_path / f"c-{letter}" / "chain.json").exists() for letter in "abc"] == [
        True,
        False,
        True,
    ]


def test_the_table_has_a_row_a_campaign_and_runs_nothing(fleet):
    found = fleet(
        GOOD | {"notes": ("=1+1",)}, {"status": "refused", "stage": "seed", "message": "-x"}
    )
    rows = list(csv.DictReader(io.StringIO(fleet_csv(found))))
    assert ", ".join(rows[0]) == (
        "arm, campaign, measured, status, grade, verdict, effects_and_faults, before_mm, after_mm, "
        "over, agrees_with_previous, moved, attention, why"
    )
    assert [row["campaign"] for row in rows] == ["c-a", "c-b"]
    assert rows[0]["effects_and_faults"] == "'=1+1"
    assert (rows[0]["after_mm"], rows[1]["after_mm"]) == ("0.1000", "")
    assert rows[1]["attention"] == "no_result"


def test_the_table_names_the_stage_that_refused_an_earlier_campaign(one_arm):
    found = one_arm({"status": "refused", "stage": "ingest", "message": "no rows"}, GOOD)
    rows = list(csv.DictReader(io.StringIO(fleet_csv(found))))
    assert [row["why"] for row in rows] == ["ingest: no rows", "good: as the noise explains"]


def test_a_table_of_no_campaign_has_its_columns():
    assert fleet_csv(fleet_record([], Path())).startswith("arm,campaign,measured,status")


def test_the_page_shows_what_is_there_and_says_that_it_is_synthetic(fleet):
    found = fleet(GOOD, {"status": "refused", "stage": "ingest", "message": "<b>no rows</b>"})
    text = fleet_page_text(found)
    assert "Synthetic data" in text
    assert "&lt;b&gt;no rows&lt;/b&gt;" in text
    assert "<b>no rows</b>" not in text
    assert "1.000 → 0.100 mm" in text


def test_a_fleet_without_any_result_has_a_page(fleet):
    text = fleet_page_text(fleet({"status": "refused", "stage": "ingest", "message": "no rows"}))
    assert "Errors before and after" not in text
    assert "Synthetic" not in text


# The order of the arms of a fleet: the most accurate first, by its last campaign.


def campaign(name, arm, after_mm, provenance="synthetic: a simulated cell"):
    status = "refused" if after_mm is None else "done"
    before_mm = None if after_mm is None else 1.0
    became = ChainRecord(
        campaign=name,
        status=status,
        provenance=provenance,
        before_mm=before_mm,
        after_mm=after_mm,
    )
    return FleetCampaign(arm=arm, campaign=name, became=became)


def fleet_of(*campaigns):
    arms = {each.arm: each for each in campaigns}  # the last of each
    return FleetRecord(
        counts={"good": len(campaigns)},
        arms=tuple(
            FleetArm(
                arm=arm,
                campaigns=1,
                last=last.campaign,
                attention="none" if last.became.after_mm else "no_result",
                why="as it is",
            )
            for arm, last in arms.items()
        ),
        campaigns=campaigns,
    )


RECORD = fleet_of(
    campaign("a-1", "a", 0.3),
    campaign("a-2", "a", 0.2),
    campaign("b-1", "b", 0.1),
    campaign("c-1", "c", None),
)


def test_the_last_campaigns_of_arms_stand_in_order_of_their_error():
    assert [each.campaign for each in RECORD.last_by_accuracy] == ["b-1", "a-2"]


def test_a_page_with_a_measured_campaign_is_not_called_synthetic():
    measured = campaign("b-1", "b", 0.1, provenance="measured in our hall")
    text = fleet_page_text(
        fleet_of(campaign("a-1", "a", 0.3), measured, campaign("c-1", "c", None, ""))
    )
    assert "no robot was measured" not in text
    assert "Synthetic data: a-1." in text
