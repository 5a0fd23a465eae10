"""Errors in the verdict are those of the models that are written, in trials of every kind."""

from __future__ import annotations

import pytest

from mended import write_simulated
from pa10cal.command_settings import ChainOptions
from pa10cal.results.codec import read
from pa10cal.results.evaluation import HoldoutRecord
from pa10cal_lab.blind_trials import calibrated_by_stages, judged_by_stages
from pa10cal_lab.cell.trials import draw_trials

#: Study, kind, layout or bench, seed of its first trial.
QUICK = [
    ("wild", "beyond", "", 5),
    ("wild", "effect", "", 2),
    ("wild", "fault", "", 3),
]
SLOW = [
    *(("touched", kind, "grid", 2) for kind in ("null", "single", "pair", "outside")),
    ("touched", "wrong_mass", "wide", 2),
    *(("tracked", kind, "", 1) for kind in ("null", "single", "pair", "outside")),
    ("points_one", "single", "", 1),
    ("points_three", "pair", "", 1),
    ("distance", "single", "", 1),
    *(("drives", kind, "", 1) for kind in ("sensor", "gear", "both", "neither")),
    *(
        ("wild", kind, "", seed)
        for kind in ("right", "stressed", "effect", "beyond", "fault")
        for seed in (1, 2, 3)
    ),
]


def cases():
    yield from QUICK
    yield from (pytest.param(*each, marks=pytest.mark.slow) for each in SLOW)


@pytest.mark.slow
@pytest.mark.parametrize(("measured", "kind", "layout", "seed"), list(cases()))
def test_verdict_and_evaluation_have_the_same_errors(measured, kind, layout, seed, tmp_path):
    (trial,) = draw_trials(kind, 1, seed, measured, filter(None, [layout]))
    raw, out, options = tmp_path / "raw" / trial.name, tmp_path / "out", ChainOptions()
    write_simulated(raw, trial.settings, trial.name)
    calibration = calibrated_by_stages((raw,), out, options)
    verdict, _ = judged_by_stages((raw,), out, calibration, options)
    models = read(HoldoutRecord, out / "evaluation/holdout.json").models
    gap = verdict.gap.holdout
    assert gap is not None
    calibrated = models.get("cubic", models["linear"])
    for said, judged in ((gap.before, calibrated), (gap.after, models["extended"])):
        for key in ("mean_mm", "rms_mm", "peak_mm"):
            assert getattr(said, key) == pytest.approx(getattr(judged, key), rel=0.01), key
    extended = models["extended"].trusted or models["extended"]
    before = calibrated.trusted or calibrated
    assert extended.rms_mm <= 1.021 * before.rms_mm
    assert extended.mean_mm <= 1.021 * before.mean_mm
    explained = verdict.explained
    if explained is not None:
        assert sum(each.share for each in explained.of) == pytest.approx(explained.share)
        assert explained.share + explained.without_a_name == pytest.approx(1.0)
    if explained is not None and explained.of:
        assert explained.after_mm == pytest.approx(extended.rms_mm, rel=0.01)
