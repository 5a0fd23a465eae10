"""Mistakes in campaign.yaml, and names of files and folders that are not there."""

from __future__ import annotations

import pytest

from made_up_mistakes import Own, call, edited, put, told


def run_of(*words: str, into: str = ""):
    def command(own: Own):
        folder = own.write() / into
        return call("run", folder, "--out", own.folder.parent / "out", *words)

    return command


MISTAKES = told(
    "description",
    {
        "a key misspelt": edited("gravity_m_s2", "gravity_ms2"),
        "a key at the wrong level": edited(
            "reference_temperature_C", "uncertainty_mm: 0.05\nreference_temperature_C"
        ),
        "no as a name": edited("name: zelle", "name: no"),
        "nothing behind a key": lambda own: (
            put("provenance", "x")(own) or edited("provenance: x", "provenance:")(own)
        ),
        "tabs": edited("  poses: messung.csv", "\tposes: messung.csv"),
        "a key twice": edited("name: zelle", "name: zelle\nname: zelle2"),
        "a number that YAML takes for a text": edited(
            "uncertainty_mm: 0.05", "uncertainty_mm: 5e-2 mm"
        ),
        "a number as a label": put("exclude", [{"where": 12, "why": "bumped"}]),
        "an instrument by its usual name": put("instrument.kind", "laser_tracker"),
        "a key that is missing": put("gravity_m_s2", None),
        "a path with backslashes": put("files.poses", "daten\\messung.csv"),
        # Files and folders that are not there.
        "a file of another name": put("files.poses", "Messung.CSV"),
        "an arm that is not described": (put("robot", "kr10"), run_of()),
        "the folder above": (lambda own: None, run_of(into="..")),
        "a folder that is not there": (lambda own: None, run_of(into="../zellle")),
        "settings that are not there": (lambda own: None, run_of("--settings", "robust.yaml")),
        "a prior that is not there": (lambda own: None, run_of("--prior", "results/march")),
    },
)


@pytest.mark.parametrize("mistake", MISTAKES, ids=str)
def test_a_mistake_is_told_by_cause_place_and_remedy(own, mistake):
    mistake.judge(own)
