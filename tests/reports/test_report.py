"""The page of a campaign: what it says, of every verdict and with every result missing."""

from __future__ import annotations

import csv
import json
import re
import shlex
import shutil
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

import pa10cal
from made_up_records import effect
from made_up_results import with_verdict
from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.reports.outcome import grade_sentence, verdict_glance
from pa10cal.reports.page import SECTIONS
from pa10cal.reports.pictures import motion_drawing, shares_drawing
from pa10cal.reports.results_bundle import ResultsBundle, results_bundle
from pa10cal.reports.summary import summarise
from pa10cal.results.codec import read, write
from pa10cal.results.discovery import (
    Explained,
    ExplainedEffect,
    Separation,
    SuggestedPose,
    VerdictRecord,
)
from pa10cal.results.evaluation import AccuracyRows, Iso9283Record, PoseAccuracy, RepeatabilityRows
from pa10cal.results.outcomes import Caption, PicturesRecord

VOID = {"meta", "link", "br", "img", "input", "hr", "col"}


class Page(HTMLParser):
    """What a page holds: its text, tags and whether they are closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.headings: list[tuple[str, str]] = []
        self._open: list[str] = []
        self.feed(text)
        assert not self._open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        if self._open and self._open[-1] not in ("script", "style"):
            self.words.append(data)
        if self._open and re.fullmatch(r"h\d", self._open[-1]):
            self.headings.append((self._open[-1], data))

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def attributes(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


def change(results, pattern, **changes):
    """Change keys of all records that a pattern fits."""
    for path in results.rglob(pattern):
        record = json.loads(path.read_text("utf-8"))
        path.write_text(json.dumps({**record, **changes}), encoding="utf-8")


@pytest.fixture
def page(tmp_path):
    """Write the report of some results and read it."""

    def write(results, *words):
        out = tmp_path / "report.html"
        assert run_command("report", [str(results), "--out", str(out), *map(str, words)]) == 0
        return Page(out.read_text(encoding="utf-8"))

    return write


def test_says_what_it_is_of_and_that_the_data_are_synthetic_and_has_every_section(
    small, page, capsys, tmp_path
):
    found = page(small)
    assert capsys.readouterr().out.startswith("small: report ")
    title = found.text.split(" Skip to")[0]
    assert title == "small: calibration report (synthetic data)"
    said = found.text.removeprefix(title)
    assert said.startswith(" Skip to the report Synthetic data: simulated, no robot was measured.")
    assert "for its numbers. Synthetic data." in found.text  # a caption
    headings = [text for level, text in found.headings if level == "h2"]
    # No map was found in this campaign.
    assert headings == [each.title for each in SECTIONS if each.id != "angles"]
    pa10cal.report(small, tmp_path / "again.html")  # Python writes the same page
    assert (tmp_path / "again.html").read_bytes() == (tmp_path / "report.html").read_bytes()


def test_the_documentation_lists_the_sections_in_this_order():
    text = (Path(__file__).parents[2] / "docs/report.md").read_text("utf-8")
    _, *listed = re.findall(r"^\| ([A-Z][^|]+|top) \|", text, re.MULTILINE)
    assert len(listed) == len(SECTIONS)
    for name, section in zip(listed, SECTIONS, strict=True):
        assert section.title.startswith(name)


LEADS = {
    "none": "Nothing is missing: model and measurement agree within the repeatability.",
    "named": "The calibrated model lacks encoder eccentricity at joint 2.",
    "ambiguous": "The calibrated model lacks encoder eccentricity at joint 2 (0.49) or gear ratio "
    "error at joint 2 (0.49).",
    "unexplained": "An error remains at joint 3 that no effect of the vocabulary explains.",
    "check_the_log": "Check the log first: joint sign (q3_deg). Independent of that, the "
    "calibrated model lacks encoder eccentricity at joint 2.",
    "not_sought": "Effects were not sought: 36 poses are too few.",
}


@pytest.mark.slow_but_one_in(4)
def test_says_every_verdict_in_a_plain_sentence(judged, page):
    results, word = judged
    found = page(results)
    assert found.text.count(LEADS[word]) == 2  # at the top, and in its section
    if word == "check_the_log":
        assert "negate q3_deg" in found.text
    assert ("theta_3 += h s_3 |tau_3|" in found.text) is (word == "unexplained")
    if word in ("named", "ambiguous"):
        assert "A = (0.400 ± 0.039) mrad; phi = (0.770 ± 0.078) rad" in found.text
    if word == "not_sought":
        assert "Measure 100." in found.text


LACKS_TWO = "encoder eccentricity at joint 2 and backlash at joint 3."


@pytest.mark.parametrize(
    ("held", "grade_says", "verdict_says"),
    [
        (0, "This is before the effects found are added.", "The calibrated model lacks"),
        (1, "It has some of the effects found.", "The model calibrated without effects lacks"),
        (2, "The effects found are in it.", "The model calibrated without effects lacks"),
    ],
)
def test_a_calibration_with_the_effects_found_is_not_said_to_lack_them(
    copied, held, grade_says, verdict_says
):
    path = with_verdict(copied, "named") / VerdictRecord.FILE
    record = read(VerdictRecord, path)
    backlash = effect("backlash", "joint 3", {"b": (2e-4, 1e-5)})
    write(record.model_copy(update={"effects": (*record.effects, backlash)}), path)
    terms = [
        {"id": "encoder_eccentricity", "of": "joint 2"},
        {"id": "backlash", "of": "joint 3"},
        {"id": "backlash", "of": "joint 4"},  # listed in the settings; none that was found
    ]
    file = copied / "calibration/combined.json"
    fitted = json.loads(file.read_text("utf-8"))["fitted_model"]
    change(copied, file.name, fitted_model={**fitted, "terms": [*terms[:held], terms[2]]})
    results = ResultsBundle(copied)
    assert grade_sentence(results, results.calibration).endswith(grade_says)
    assert verdict_glance(results, results.verdict) == ("named", f"{verdict_says} {LACKS_TWO}")


@pytest.mark.parametrize(
    ("word", "grade", "says"),
    [
        ("unexplained", "good", "hardly more than noise, what the verdict does not explain"),
        ("unexplained", "incomplete", "larger than the noise explains."),
        ("none", "good", "The calibration is good."),
    ],
)
def test_a_good_grade_beside_something_unexplained_says_how_little_is_left(
    copied, word, grade, says
):
    with_verdict(copied, word)
    file = copied / "calibration/combined.json"
    health = json.loads(file.read_text("utf-8"))["health"]
    change(copied, file.name, health={**health, "grade": grade})
    results = ResultsBundle(copied)
    text = grade_sentence(results, results.calibration)
    assert says in text
    assert ("what the verdict does not" in text) == ((word, grade) == ("unexplained", "good"))


@pytest.mark.parametrize(
    ("of", "place"),
    [
        ("upper_arm", "at the upper arm"),
        ("joint 3", "at joint 3"),
        ("target B or C", "at target B or C"),
        ("the rows from pose P00040 on", "in the rows from pose P00040 on"),
    ],
)
def test_a_place_without_a_name_is_written_as_words(copied, of, place):
    with_verdict(copied, "unexplained")
    results = ResultsBundle(copied)
    made = results.verdict
    part = made.unexplained.model_copy(update={"of": of})
    _, said = verdict_glance(results, made.model_copy(update={"unexplained": part}))
    assert said == f"An error remains {place} that no effect of the vocabulary explains."


def taken(of, share, before_mm, after_mm, *ids):
    return ExplainedEffect(ids=ids, of=of, share=share, before_mm=before_mm, after_mm=after_mm)


EXPLAINED = Explained(
    share=0.97,
    of=(
        taken("joint 3", 0.9, 0.36, 0.17, "joint_compliance"),
        taken("joint 2", 0.07, 0.17, 0.15, "encoder_eccentricity", "gear_ratio_error"),
    ),
    without_a_name=0.03,
    over="held-out poses",
    before_mm=0.36,
    after_mm=0.15,
    noise_mm=0.14,
)
PARTS = (
    "97 % of the error beyond noise is explained: spring of joint 3; encoder eccentricity or gear "
    "ratio of joint 2."
)
FALL = "Joint 3 gives way under the arm's weight: 0.36 mm becomes 0.17 mm."


@pytest.mark.parametrize(
    ("word", "answer"), [("ambiguous", "97 % explained"), ("check_the_log", "check the log")]
)
def test_leads_with_what_is_explained_and_by_what(copied, page, word, answer):
    with_verdict(copied, word)
    path = copied / VerdictRecord.FILE
    record = read(VerdictRecord, path)
    spring = effect("joint_compliance", "joint 3", {"K": (2e5, 1e3)})
    write(
        record.model_copy(update={"explained": EXPLAINED, "effects": (*record.effects, spring)}),
        path,
    )
    text = page(copied).text
    top, rest = text.split("What was measured", 1)
    assert f"Verdict {answer} " in top
    assert PARTS in top
    assert PARTS in rest
    assert FALL in rest
    if word == "ambiguous":
        assert FALL in top
        assert "Verdict: ambiguous." in top
    # The one that takes most away comes first, though it was found last.
    table = rest[rest.index("Effects, those that remove most error first") :]
    assert table.index("joint compliance") < table.index("encoder eccentricity")
    assert "0.360 → 0.170 90 %" in " ".join(table.split())


def test_says_by_how_much_suggested_poses_would_tell_rivals_apart(copied, page):
    path = with_verdict(copied, "ambiguous") / VerdictRecord.FILE
    aims = (
        "angle of joint 2 not seen",
        "few poses near the angle of joint 1",
        "few poses near the angle of joint 3",
    )
    pose = SuggestedPose(q_deg=np.zeros(6), q_rad=np.zeros(6), load_N=0.0, for_=aims)
    pair = Separation(
        pair="tool_sag of tool or link_torsion of forearm",
        before_nats=0.2,
        after_nats=6.0,
        possible_nats=8.0,
        can_be_split=True,
        probability=0.58,
        expected_probability=0.93,
    )
    settled = pair.model_copy(update={"can_be_split": False})
    told = {"suggested_poses": (pose, pose), "separations": (pair, settled)}
    write(read(VerdictRecord, path).model_copy(update=told), path)
    said = (
        "2 poses would tell tool sag of tool (0.58 between the two now) from link torsion of "
        "forearm: the likelier of both would come to an expected 0.93."
    )
    text = page(copied).text
    assert text.count(said) == 1
    assert (
        "Shows an angle of joint 2 where the fit has seen no pose; "
        "shows an angle of joints 1 and 3 near which the fit has seen few poses." in text
    )


def test_positions_of_a_joint_that_slides_are_lengths(copied, page):
    path = copied / "calibration/combined.json"
    record = json.loads(path.read_text("utf-8"))
    record["fitted_model"]["arm"]["rows"][2] |= {"prismatic": True, "limits_rad": [-0.15, 0.0]}
    record["fitted_model"]["seen"][2]["intervals"] = [[-0.12, -0.02]]
    path.write_text(json.dumps(record), encoding="utf-8")
    shutil.rmtree(copied / "discovery")
    q = np.array([0.0, 0.0, -0.1, 0.0, 0.0, 0.0])
    pose = SuggestedPose(q_deg=np.degrees(q), q_rad=q, load_N=0.0, for_=())
    path = with_verdict(copied, "ambiguous") / VerdictRecord.FILE
    write(read(VerdictRecord, path).model_copy(update={"suggested_poses": (pose,)}), path)
    said = page(copied).text
    assert "3 -120.0 to -20.0 mm -150.0 to 0.0 mm" in said
    assert "q2 [deg] q3 [mm] q4 [deg]" in said
    assert " -100.0 " in said


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    "file",
    [
        "ingest/poses.parquet: pa10cal ingest",
        "seed/base_frame.json: pa10cal seed",
        "calibration/combined.json: pa10cal calibrate",
        "discovery/verdict.json: pa10cal discover",
        "evaluation/holdout.json: pa10cal evaluate",
        "model/model.yaml: pa10cal export",
    ],
)
def test_a_stage_that_is_missing_is_named_with_the_reason(copied, page, file):
    shutil.rmtree(copied / file.partition("/")[0])
    assert f"There is no {file} was not run" in page(copied).text


def test_the_message_of_a_stage_that_refused_is_the_reason(copied, page):
    shutil.rmtree(copied / "calibration")
    (copied / "logs").mkdir()
    message = "small: warning: x\npa10cal calibrate: P3: 2 poses; allowed: 30; measure more\n"
    (copied / "logs/calibrate.log").write_text(message)
    said = page(copied).text
    assert said.count("pa10cal calibrate refused: P3: 2 poses; allowed: 30; measure more.") == 1


def test_only_raw_rows_read_is_enough_for_a_page(copied, page):
    for folder in ("seed", "calibration", "discovery", "evaluation", "model"):
        shutil.rmtree(copied / folder)
    found = page(copied)
    assert "There is no calibration" in found.text
    assert "to fit" in found.text


def test_repeats_give_accuracy_and_repeatability_before_and_after(copied, page):
    assert "Not known: no configuration has 5 repeats." in page(copied).text
    rows = {"pose": ["P1"], "load_N": [0.0]}
    accuracy = {
        name: PoseAccuracy(
            AP_mean_mm=mm,
            AP_largest_mm=2 * mm,
            AP_mean_deg=None,
            AP_largest_deg=None,
            rows=AccuracyRows(**rows, AP_mm=[mm], AP_xyz_mm=[[mm, 0, 0]], AP_deg=None),
        )
        for name, mm in (("uncalibrated", 1.25), ("linear", 0.0625))
    }
    repeated = {"kind": ["grid"], "repeats": [30], "one_direction": [False], "RP_mm": [0.021]}
    made = Iso9283Record(
        campaign="small",
        provenance="synthetic",
        calibration="combined",
        accuracy=accuracy,
        repeatability=RepeatabilityRows(**rows, **repeated, RP_deg=None),
    )
    write(made, copied / "evaluation/iso9283.json")
    found = page(copied).text
    assert "Over 1 configuration used for the fit with 30 readings each" in found
    assert "AP, not calibrated 1.250 2.500 – –" in found
    assert "AP, calibrated 0.062 0.125 – –" in found
    assert "RP 0.021 0.021 – –" in found
    assert "joints arrived from either side in 1 configuration" in found
    assert "30 repeats" not in found
    unknown = made.repeatability.model_copy(update={"one_direction": None})
    write(made.model_copy(update={"repeatability": unknown}), copied / "evaluation/iso9283.json")
    assert "it is not known from which side joints arrived" in page(copied).text


def test_a_group_lasts_as_long_as_its_campaigns_and_its_frame_is_of_the_first(copied, page):
    path = copied / "ingest/poses.parquet"
    table = parquet.read_table(path)
    poses = table.to_pandas()
    count = len(poses) // 2
    poses["campaign"] = ["june"] * count + ["aug"] * (len(poses) - count)
    poses["time_s"] = np.where(poses["campaign"] == "june", 0.0, 4e6) + np.arange(len(poses)) * 60.0
    changed = pyarrow.Table.from_pandas(poses, preserve_index=False)
    parquet.write_table(changed.replace_schema_metadata(table.schema.metadata), path)
    said = page(copied).text
    assert f"{len(poses) - 2} min in 2 campaigns, each from its first reading to its last" in said
    assert "at once (hand-eye) of the first campaign, june; positions scatter" in said


def test_a_frame_found_from_distances_leaves_distances(copied, page):
    change(copied, "base_frame.json", method="ranging")
    assert "all measured distances at once; distances scatter by" in page(copied).text


def test_files_without_content_are_not_listed(copied, page):
    (copied / "figures").mkdir()
    (copied / "figures/.timestamp").touch()
    (copied / "discovery/suggested_poses.csv").write_text("q1_deg\n")
    said = page(copied).text
    assert "figures as SVG" not in said
    assert "poses to measure next" not in said


def test_weights_that_nobody_stated_are_not_said_to_be_described(copied, page):
    path = copied / "calibration/combined.json"
    record = json.loads(path.read_text("utf-8"))
    names = [f"weight_{joint}_mass" for joint in range(1, 7)]
    known = {"value": 0.0, "std": 1.0, "unit": "kg", "tolerance": 1.0, "at_bound": False}
    record["parameters"] |= {name: {**known, "identifiable": False} for name in names}
    health = record["health"] | {"not_identifiable": names, "rank": 20, "unknowns": 26}
    arm = record["fitted_model"]["arm"]
    unknown = {"mass_u": [1.0] * 6, "com_u_m": [0.1] * 6, "why": "", "by_log": None}
    for origin, words in (
        ("stated", "stay near the described values"),
        ("assumed", "stay near those assumed from the lengths of the links, as nobody stated"),
    ):
        fitted = record["fitted_model"] | {"arm": {**arm, "weights": {"from": origin, **unknown}}}
        path.write_text(json.dumps({**record, "health": health, "fitted_model": fitted}))
        said = page(copied).text
        assert words in said
        assert "Not identifiable from these poses: 6 departures of weights." in said


def test_nothing_held_out_is_said(copied, page):
    change(copied, "holdout.json", models={}, note="no held-out rows measured")
    assert "Nothing was held out (no held-out rows measured)" in page(copied).text


def test_held_out_errors_are_drawn_as_shares_of_the_poses(copied):
    path = copied / "evaluation/holdout.json"
    models = json.loads(path.read_text("utf-8"))["models"]
    for k, row in enumerate(models["linear"]["rows"]):
        row["extrapolated"] = k % 2 == 0
    change(copied, "holdout.json", models=models)
    found = results_bundle(copied)
    rows = found.held_out.models["linear"].rows
    drawing = shares_drawing(found.held_out, {"linear": "calibrated"}, "mm")
    inside, beyond = drawing.figure.data
    for trace, of in ((inside, ~rows.extrapolated), (beyond, rows.extrapolated)):
        np.testing.assert_allclose(trace.x, np.sort(rows.error_mm[of]), rtol=1e-3)
        np.testing.assert_allclose(
            trace.y, 100.0 * np.arange(1, of.sum() + 1) / of.sum(), atol=0.01
        )
    assert beyond.line.dash == "dot"
    assert beyond.name == f"calibrated, extrapolated ({rows.extrapolated.sum()})"
    assert drawing.figure.layout.xaxis.title.text == "position error [mm]"
    assert "Dotted" in drawing.caption
    for beyond in (True, False):
        rows = rows.model_copy(update={"extrapolated": np.full(len(rows), beyond)})
        model = found.held_out.models["linear"].model_copy(update={"rows": rows})
        of_one_kind = found.held_out.model_copy(update={"models": {"linear": model}})
        drawing = shares_drawing(of_one_kind, {"linear": "calibrated"}, "mm")
        assert drawing.figure.data[0].line.dash == ("dot" if beyond else "dashdot")
        assert ("Dotted" in drawing.caption) == beyond


def test_motion_of_the_base_is_drawn_with_its_bands(watched_poses):
    found = ResultsBundle(watched_poses)
    drawing = motion_drawing(found.poses, "turn", [found.poses["time_s"].iloc[1]])
    band, line = drawing.figure.data[2:4]
    np.testing.assert_allclose(line.y, 1e3 * found.poses["motion_ry_rad"], rtol=1e-3)
    assert len(band.x) == 2 * len(line.x)
    assert drawing.figure.layout.yaxis.title.text == "turn [mrad]"
    assert len(drawing.figure.layout.shapes) == 1


def test_a_model_that_is_not_to_be_used_is_marked(copied, page):
    path = copied / "calibration/combined.json"
    health = json.loads(path.read_text("utf-8"))["health"] | {"grade": "suspect_input"}
    change(copied, "combined.json", health=health)
    found = page(copied).text
    assert "Something in the input is probably wrong." in found
    assert "The commands refuse its model without --force: mend the input first." in found


def test_what_moved_since_the_prior_is_said(copied, page):
    said = "started from the model of June: the zero of joint 2 moved by +1.500 mrad"
    prior = {"campaign": "June", "moved": [], "factor": 1.0, "line": said}
    change(copied, "combined.json", prior=prior)
    assert said[1:] in page(copied).text
    assert any(said in note for note in summarise(copied).notes)


def test_its_commands_do_what_it_says(copied, page, monkeypatch):
    found = page(copied)
    commands = [text.replace("\\\n", " ") for text in found.words if text.startswith("pa10cal ")]
    assert str(copied) not in found.text  # equal results have equal pages, wherever they are
    assert f"Run the commands in the folder of these results, {copied.name}:" in found.text
    monkeypatch.chdir(copied)
    header = ",".join(["id", *(f"q{joint}_deg" for joint in range(1, 7))])
    (copied / "joints.csv").write_text(f"{header}\nA,1,-60,70,5,40,6\n")
    assert [shlex.split(command)[1] for command in commands] == ["predict", "compensate"]
    for command in commands:
        _, name, *words = shlex.split(command)
        assert run_command(name, words) == 0
        if name == "predict":
            (x,) = csv.DictReader((copied / "poses.csv").read_text().splitlines())
            columns = ("id", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
            target = ",".join(columns) + "\n" + ",".join(x[name] for name in columns) + "\n"
            (copied / "targets.csv").write_text(target)
    (row,) = csv.DictReader((copied / "commands.csv").read_text().splitlines())
    assert row["status"] == "ok"


def test_where_data_come_from_is_one_line_and_the_rest_folded_away(copied, page):
    change(copied, "*.json", provenance="measured with a tracker <script>alert(1)</script>&")
    found = page(copied).text
    assert "Synthetic" not in found
    words = "measured with a tracker <script>alert(1)</script>&."
    assert f"In the campaign's own words: {words}" in found
    assert "campaign's own words Measured" not in found
    told = "Measured by A. Owner with a laser tracker in the year 2022. Fetched at a commit. "
    told += "Angles of the controller, not read back, and so on for several lines of text."
    change(copied, "*.json", provenance=told)
    found = page(copied)
    assert "in the year 2022. Fetched at a commit. Arm" in found.text
    assert found.text.count(told) == 1
    assert any(name == "details" for name, _ in found.tags)


def test_needs_no_network_and_can_be_read_by_keyboard(small, page):
    found = page(small)
    for attributes in (attributes for _, attributes in found.tags):
        for name in ("src", "href", "srcset", "action"):
            assert (attributes.get(name) or "#").startswith("#")
    policy = next(each for each in found.attributes("meta") if "http-equiv" in each)
    assert policy["content"].startswith("default-src 'none'")
    ids = [each["id"] for _, each in found.tags if "id" in each]
    assert len(ids) == len(set(ids))
    for link in found.attributes("a"):
        assert link["href"][1:] in ids
    scrolled = [each for each in found.attributes("div") if each.get("class") == "scroll"]
    assert len(scrolled) == len(found.attributes("table"))
    assert all(each["tabindex"] == "0" and each["aria-label"] for each in scrolled)
    levels = [int(tag[1]) for tag, _ in found.tags if re.fullmatch(r"h\d", tag)]
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("nowhere", "no results of a campaign"),
        ("empty", "no results of a campaign"),
        ("a_file", "no results of a campaign"),
        ("broken", "discovery/verdict.json: the record cannot be read"),
        ("mixed", "results of several campaigns"),
    ],
)
def test_what_is_no_campaign_is_refused_in_one_message_and_nothing_written(
    copied, tmp_path, capsys, place, said
):
    (tmp_path / "empty").mkdir()
    (tmp_path / "a_file").write_text("x")
    out, path = tmp_path / "report.html", copied / "discovery/verdict.json"
    if place in ("broken", "mixed"):
        text = path.read_text("utf-8").replace('"small"', '"other"', 1)
        path.write_text("{" if place == "broken" else text)
    folder = copied if place in ("broken", "mixed") else tmp_path / place
    assert run_command("report", [str(folder), "--out", str(out)]) == REFUSED
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert said in told
    assert not out.exists()


def test_a_study_shows_its_tables_and_none_without_rows(copied, page):
    (copied / "report.html").write_text("a page")
    said = {"text": "What it is.", "section": ""}
    captions = {name: Caption(title=name, **said) for name in ("full", "bare")}
    study = copied.with_name("study")
    (study / "tables").mkdir(parents=True)
    record = PicturesRecord(campaign=None, drawn=("full", "bare"), omitted={}, captions=captions)
    write(record, study / PicturesRecord.FILE)
    (study / "tables/full.csv").write_text("kind,trials\nfault,3\n")
    (study / "tables/bare.csv").write_text("kind,trials\n")
    found = page(copied.parent)
    assert "fault 3" in found.text
    assert len(found.attributes("table")) == 1
    (study / "tables/full.csv").write_text("kind,trials\nfault\n")
    out = str(copied / "other.html")
    assert run_command("report", [str(copied.parent), "--out", out]) == REFUSED


def test_a_report_replaces_no_result(copied, capsys):
    result = copied / "calibration/combined.json"
    before = result.read_bytes()
    assert run_command("report", [str(copied), "--out", str(result)]) == REFUSED
    assert result.read_bytes() == before
    assert "give " + str(result.with_suffix(".html")) in capsys.readouterr().err
