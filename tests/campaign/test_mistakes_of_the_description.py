"""Mistakes in campaign.yaml, and names of files and folders that are not there."""

from __future__ import annotations

import pytest

from made_up_mistakes import Mistake, Own, call, edited, put


def run_of(*words: str, into: str = ""):
    def command(own: Own):
        folder = own.write() / into
        return call("run", folder, "--out", own.folder.parent / "out", *words)

    return command


MISTAKES = [
    Mistake(
        "a key misspelt",
        edited("gravity_m_s2", "gravity_ms2"),
        "unknown key gravity_ms2",
        r"campaign\.yaml",
        "did you mean 'gravity_m_s2'",
        ("meant",),
    ),
    Mistake(
        "a key at the wrong level",
        edited("reference_temperature_C", "uncertainty_mm: 0.05\nreference_temperature_C"),
        "unknown key uncertainty_mm",
        r"campaign\.yaml",
        r"it belongs under instrument: instrument\.uncertainty_mm",
    ),
    Mistake(
        "no as a name",
        edited("name: zelle", "name: no"),
        "YAML reads no, off, false without quotes as false",
        r"campaign\.yaml.*key name",
        'write it in quotes, as "no"',
    ),
    Mistake(
        "nothing behind a key",
        lambda own: put("provenance", "x")(own) or edited("provenance: x", "provenance:")(own),
        "nothing is stated",
        r"campaign\.yaml.*key provenance",
        "a text",
    ),
    Mistake(
        "tabs",
        edited("  poses: messung.csv", "\tposes: messung.csv"),
        "tab",
        r"campaign\.yaml.*line \d+",
        "indent with spaces",
    ),
    Mistake(
        "a key twice",
        edited("name: zelle", "name: zelle\nname: zelle2"),
        "the key name stands there twice",
        r"campaign\.yaml.*line 3",
        "remove one",
    ),
    Mistake(
        "a number that YAML takes for a text",
        edited("uncertainty_mm: 0.05", "uncertainty_mm: 5e-2 mm"),
        "instrument.uncertainty_mm does not fit.*5e-2 mm",
        r"campaign\.yaml",
        r"a number; set instrument\.uncertainty_mm accordingly",
    ),
    Mistake(
        "a number as a label",
        put("exclude", [{"where": 12, "why": "bumped"}]),
        "YAML reads it as a number",
        r"campaign\.yaml.*exclude\.0\.where",
        'in quotes, as "12"',
    ),
    Mistake(
        "an instrument by its usual name",
        put("instrument.kind", "laser_tracker"),
        "instrument.kind does not fit.*laser_tracker",
        r"campaign\.yaml",
        r"one of distance, points, pose, touch_trigger_cmm; set instrument\.kind",
    ),
    Mistake(
        "a key that is missing",
        put("gravity_m_s2", None),
        "missing key gravity_m_s2",
        r"campaign\.yaml",
        r"\[0, 0, -9\.81\] for an upright arm; set gravity_m_s2",
    ),
    Mistake(
        "a path with backslashes",
        put("files.poses", "daten\\messung.csv"),
        r"files\.poses does not fit.*daten",
        r"campaign\.yaml",
        r"the name of a file in the campaign's folder alone, messung\.csv; set files\.poses",
    ),
    # Files and folders that are not there.
    Mistake(
        "a file of another name",
        put("files.poses", "Messung.CSV"),
        "the file is not there.*Messung.CSV",
        r"campaign\.yaml: files\.poses",
        r"did you mean 'messung\.csv'",
        ("meant",),
    ),
    Mistake(
        "an arm that is not described",
        put("robot", "kr10"),
        "unknown robot.*kr10",
        r"campaign\.yaml: robot|robot",
        r"kr10\.yaml|import_arm",
        command=run_of(),
    ),
    Mistake(
        "the folder above",
        lambda own: None,
        "there is no campaign.yaml",
        r"/campaign\.yaml",
        r"did you mean the folder 'zelle' in it\?",
        ("meant",),
        command=run_of(into=".."),
    ),
    Mistake(
        "a folder that is not there",
        lambda own: None,
        "the folder is not there",
        r"zellle",
        "did you mean 'zelle'",
        ("meant",),
        command=run_of(into="../zellle"),
    ),
    Mistake(
        "settings that are not there",
        lambda own: None,
        "the file is not there",
        r"robust\.yaml",
        "check the path",
        command=run_of("--settings", "robust.yaml"),
    ),
    Mistake(
        "a prior that is not there",
        lambda own: None,
        "the file is not there|no model.yaml",
        r"results/march",
        "correct the path",
        command=run_of("--prior", "results/march"),
    ),
]


@pytest.mark.parametrize("mistake", MISTAKES, ids=str)
def test_a_mistake_is_told_by_cause_place_and_remedy(own, mistake):
    mistake.judge(own)
