"""Every function that draws says of itself what the report needs."""

import re
import textwrap
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest

from pa10cal.command_settings import PictureOptions
from pa10cal.figures.draw import draw_all, of_campaign, summary
from pa10cal.figures.registry import ELSEWHERE, FOLDERS, NEEDS, entries, picture
from pa10cal.reports.page import SECTIONS

PACKAGE = Path(__file__).parents[2] / "src/pa10cal/figures"
EVERY = [(folder, name) for folder in FOLDERS for name in entries(folder)]


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_function_that_draws_is_a_picture(folder):
    files = PACKAGE.glob(f"{folder}/*.py")
    if folder in ELSEWHERE:
        files = [Path(import_module(ELSEWHERE[folder]).__file__)]
    text = "\n".join(path.read_text() for path in files)
    drawn = set(re.findall(r"^def (?:draw|tabulate|film)_(\w+)\((?!axes)", text, re.M))
    assert set(entries(folder)) >= drawn > set()


@pytest.mark.parametrize("name", entries("campaign"))
def test_every_need_of_a_campaign_is_known_and_every_figure_has_its_section(name):
    entry = entries("campaign")[name]
    assert {*entry.needs} <= set(NEEDS)
    known = {each.id for each in SECTIONS}
    assert (entry.section in known) if entry.kind == "figure" else entry.section == ""


def test_names_differ_as_files_do():
    names = [name for _, name in EVERY]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(("folder", "name"), EVERY, ids=lambda each: each)
def test_captions_are_short_and_state_no_result(folder, name):
    text = entries(folder)[name].caption.replace("{name}", "some-name")
    assert 3 <= len(textwrap.wrap(text, 120)) <= 10
    assert not re.search(r"\d\.\d", text), "a number that a run could change"
    assert not re.search(r"[{`*]", text)


def test_a_picture_by_a_function_of_another_name_is_a_fault():
    with pytest.raises(TypeError, match=r"shown must begin with draw, ta"):

        @picture(title="a gait", needs=(), caption="")
        def shown(results):
            """Return nothing."""


#: Pictures of every campaign, of one whose effects are sought, and of the paper's model. What was
#: added to these is where its needs are met.
ALWAYS = {"suspected_outliers"}
SOUGHT = {"where_breakdown", "where_joints", "gap_by_step", "where_torque"}
PAPER = {"fig4_test_path", "fig5_before_after", "fig6_holdout", "montecarlo_planes"}
PAPER |= {"paper_against_ours", "table1_parameters"}


class TestAll:
    @pytest.fixture(autouse=True)
    def quick(self, monkeypatch):
        """Draw without writing; pictures themselves are on trial elsewhere."""
        for module in ("write_figure", "write_table"):
            monkeypatch.setattr(f"pa10cal.figures.draw.{module}", lambda *_: None)

    @pytest.mark.slow
    def test_what_is_drawn_follows_from_what_the_campaign_is(self, results, sighted, tmp_path):
        listed = ALWAYS | SOUGHT | PAPER
        for source, expected in (
            (results, listed),
            (sighted["points"], ALWAYS),
            (sighted["distance"], ALWAYS),
        ):
            drawn = draw_all(of_campaign(source), tmp_path, source.settings.figures)
            assert set(drawn.drawn) & listed == expected
            assert set(drawn.drawn) | set(drawn.omitted) == set(entries("campaign")) >= listed
            assert not set(drawn.drawn) & set(drawn.omitted)

    def test_older_files_of_what_is_omitted_are_removed_and_the_reason_is_kept(
        self, results, changed_from, tmp_path
    ):
        def without_torques(record):
            for fit in ("before", "after"):
                for joint in record[fit]["by_joint"]:
                    joint["torque_residual_Nm"] = None

        (tmp_path / "figures").mkdir()
        old = tmp_path / "figures/where_torque.svg"
        old.write_text("old")
        source = changed_from(results, "discovery/analysis.json", without_torques)
        drawn = draw_all(of_campaign(source), tmp_path, results.settings.figures)
        assert not old.exists()
        why = "residual torques need logged torques, known weights and repeated poses"
        assert drawn.omitted["where_torque"] == why
        assert f"where_torque: omitted, {why}" in summary(drawn)
        assert why in (tmp_path / "pictures.json").read_text("utf-8")

    def test_a_plane_that_is_not_there_takes_only_its_pictures_away(
        self, results, tmp_path, monkeypatch
    ):
        monkeypatch.setattr("pa10cal.figures.draw._write", lambda *_: None)
        settings = PictureOptions.model_validate({"montecarlo": {"planes_mm": [300, 900]}})
        source = of_campaign(replace(results, settings=settings))
        drawn = draw_all(source, tmp_path, settings.figures)
        assert drawn.omitted["montecarlo_planes"] == "there is no montecarlo/z900.json"
        assert "fig5_before_after" in drawn.drawn
