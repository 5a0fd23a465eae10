"""Exports in the encodings, languages, units and layouts that people have, read as proposed."""

from __future__ import annotations

import io

import numpy as np
import pandas as pd
import pytest
import yaml

from made_up_exports import drawn_exports, written_export
from made_up_sightings import sighted
from pa10cal.__main__ import main
from pa10cal.campaign.read import read_campaign

SEED = 20261123
EXPORTS = drawn_exports(60, SEED)
#: One of every header is tried in the quick suite, all in the full one.
TRIED = [
    pytest.param(export, id=export.title, marks=[pytest.mark.slow] if k >= 12 else [])
    for k, export in enumerate(EXPORTS)
]


@pytest.mark.slow_but_one_in(8)
@pytest.mark.parametrize("export", TRIED)
def test_an_export_is_read_as_columns_proposes(tmp_path, capsys, export):
    """Joints, positions, orientations, times and loads come back, and no column goes unsaid."""
    raw = sighted(tmp_path, "pose")
    table = pd.read_csv(io.StringIO("\n".join(raw.poses)))
    path = written_export(export, table, tmp_path, np.random.default_rng(1))
    assert main(["columns", str(path), "--robot", "ur10"]) == 0
    text = capsys.readouterr().out
    (tmp_path / "campaign.yaml").write_text(text, encoding="utf-8")
    for name in yaml.safe_load(text)["columns"]["poses"]["joints"]["names"]:
        assert f"#   {name}" in text
    assert text.count("not read") >= 1  # the comments
    found = read_campaign(tmp_path)
    every = found.observations
    assert found.quarantined == ()
    assert len(every) == len(table)
    order = np.argsort(every.states.time_s, kind="stable")
    np.testing.assert_allclose(every.states.q_rad[order], raw.q, atol=2e-8)
    expected = raw.T_instr_target if export.has_attitude else raw.T_instr_target[:, :3, 3]
    measured = every.measured
    if export.has_attitude:
        np.testing.assert_allclose(measured.T_instr_target[order], expected, atol=2e-6)
    else:
        np.testing.assert_allclose(measured.places_m[order, 0], expected, atol=2e-6)
    if every.states.timed is None or np.any(every.states.timed):
        np.testing.assert_allclose(np.diff(every.states.time_s[order]), 10.0, atol=2e-3)
    if export.has_load:
        np.testing.assert_allclose(every.states.load_N[order], np.where(table.index % 2, 44.0, 0.0))
