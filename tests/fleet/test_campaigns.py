import pytest

from pa10cal.errors import SettingsError
from pa10cal.fleet.campaigns import Listed, campaigns_of, in_order


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
    assert campaigns_of("a", raw) == (Listed("a", "a"),)


def test_a_table_says_arms_and_times_and_need_not_be_there(raw):
    text = "\ufeffarm, campaign ,measured\r\nleft,b,2026-02\r\n\r\n,a,\r\nleft,gone,2026-01\r\n"
    listed = campaigns_of(table(raw, text), raw)
    assert listed == (
        Listed("b", "left", "2026-02"),
        Listed("a", "a"),
        Listed("gone", "left", "2026-01"),
    )
    assert [each.campaign for each in in_order(listed)["left"]] == ["gone", "b"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no column campaign"),
        ("name\na\n", "no column campaign"),
        ("campaign,campaign\na,b\n", "a column twice"),
        ("campaign\n", "there are no campaigns"),
        ("campaign\n../a\n", r"row 2: no name of a campaign \(got '../a'\)"),
        ("campaign\na\nb\na\n", r"row 4: a campaign stands twice \(got 'a'\).*row 2"),
        ("arm\n,\n", "no column campaign"),
        ("campaign,arm\n,left\n", "no name of a campaign"),
        ('campaign\n"a\n', "cannot be read"),
    ],
)
def test_tables_that_cannot_be_meant_are_refused(raw, text, message):
    with pytest.raises(SettingsError, match=message):
        campaigns_of(table(raw, text), raw)


def test_what_is_not_there_is_refused(raw):
    with pytest.raises(SettingsError, match="there are no campaigns"):
        campaigns_of("2027-*", raw)
    with pytest.raises(SettingsError, match=r"cannot be read.*No such file"):
        campaigns_of("gone.csv", raw)
    with pytest.raises(SettingsError, match="no pattern of campaigns"):
        campaigns_of("../*", raw)
