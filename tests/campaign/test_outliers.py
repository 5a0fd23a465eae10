"""Single positions far from the nominal model: which of them go."""

from __future__ import annotations

import numpy as np
import pytest

from made_up_sightings import sighted
from pa10cal.campaign.screens import off_model
from pa10cal.observe.quantities import Misfit
from spoiling import ingest, replace


def spoiled(tmp_path, errors_mm):
    """Ingest positions of one target, with errors in some rows."""
    raw = sighted(tmp_path, "points", targets=1, noise_mm=0.05)
    for row, error_mm in errors_mm.items():
        word = raw.poses[row].split(",")[raw.column("T1_x_mm")]
        replace(raw.poses, row, "T1_x_mm", repr(float(word) + error_mm))
    return [row.line - 1 for row in ingest(raw).quarantined]


@pytest.mark.parametrize("sizes_mm", [(99.0, 101.0, 103.0), (60.0, 150.0, 260.0)])
def test_errors_of_one_kind_are_listed_together(tmp_path, sizes_mm):
    errors_mm = dict(zip([6, 17, 28], sizes_mm, strict=True))
    assert spoiled(tmp_path, errors_mm) == [6, 17, 28]


def test_errors_within_what_is_allowed_stay(tmp_path):
    assert spoiled(tmp_path, {6: 90.0, 17: 92.0}) == []


def test_beside_a_large_error_ten_times_the_usual_one_still_stays():
    length_m = np.full((40, 1), 9e-3)
    length_m[:3, 0] = [80e-3, 95e-3, 300e-3]
    off = off_model(Misfit(length_m, np.zeros(40)))
    assert np.flatnonzero(off[:, 0]).tolist() == [1, 2]
