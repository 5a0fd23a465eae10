"""Units, single positions far from the nominal model, and axes of the instrument."""

from __future__ import annotations

import numpy as np
import pytest

from made_up_sightings import sighted
from pa10cal.campaign import tracked_screens
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.screens import off_model, refuse_wrong_length_unit
from pa10cal.errors import Pa10calError, RawDataError
from pa10cal.observe.quantities import Misfit
from spoiling import ingest, replace


@pytest.mark.parametrize("scale", [None, 0.3, 1.0, 4.0])
def test_a_scale_near_one_passes(scale):
    refuse_wrong_length_unit(scale, "positions", "poses.csv: x_mm")


@pytest.mark.parametrize(
    ("scale", "message"),
    [
        (1020.0, r"poses.csv: d_mm: the distances look like metres .*one measured millimetre is"),
        (24.0, "look like inches"),
        (9.5, "look like centimetres"),
        (1.1e-3, "look like micrometres"),
        (100.0, "do not fit the joint motion.*check the unit"),
    ],
)
def test_another_unit_is_named(scale, message):
    with pytest.raises(RawDataError, match=message):
        refuse_wrong_length_unit(scale, "distances", "poses.csv: d_mm")


def spoiled(tmp_path, errors_mm):
    """Ingest positions of one target, with errors in some rows."""
    raw = sighted(tmp_path, "points", targets=1, noise_mm=0.05)
    for row, error_mm in errors_mm.items():
        word = raw.poses[row].split(",")[raw.column("T1_x_mm")]
        replace(raw.poses, row, "T1_x_mm", repr(float(word) + error_mm))
    return [row.line - 1 for row in ingest(raw).quarantined]


@pytest.mark.parametrize("exchanged", [False, True])
def test_the_nominal_arm_is_fitted_anew_only_where_rows_went(tmp_path, monkeypatch, exchanged):
    """Each check made a fit of its own, though rows had stayed the same."""
    fitted = {"nominal_places": [], "misfit_of": []}
    for name, rows in fitted.items():
        fit = getattr(tracked_screens, name)

        def counted(*given, fit=fit, rows=rows):
            rows.append(len(given[0]))
            return fit(*given)

        monkeypatch.setattr(tracked_screens, name, counted)
    raw = sighted(tmp_path, "points", targets=2, poses=40, repeats=2, noise_mm=0.05)
    if exchanged:  # two targets of one row
        words, first = raw.poses[8].split(","), raw.column("T1_x_mm")
        words[first : first + 6] = words[first + 3 : first + 6] + words[first : first + 3]
        raw.poses[8] = ",".join(words)
    rows = len(ingest(raw).observations)
    assert rows == 80 - exchanged
    assert fitted == {"nominal_places": [80, 79] if exchanged else [80], "misfit_of": [rows]}
    (tmp_path / "one").mkdir()
    fitted["nominal_places"].clear()
    ingest(sighted(tmp_path / "one", "points", targets=1))
    assert fitted["nominal_places"] == []  # there is nothing to compare by it


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


def changed(raw, columns, new) -> None:
    """Rewrite the columns of a target: `new` takes and returns three numbers."""
    at = [raw.column(name) for name in columns]
    for k, line in enumerate(raw.poses[1:], start=1):
        row = line.split(",")
        for j, value in zip(at, new([float(row[j]) for j in at]), strict=True):
            row[j] = f"{value:.9f}"
        raw.poses[k] = ",".join(row)


PLACE = ["x_mm", "y_mm", "z_mm"]


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(
    ("new", "told"),
    [
        (lambda p: [-p[0], p[1], p[2]], "-x, y, z"),
        (lambda p: [p[0], p[1], -p[2]], "x, y, -z"),
        (lambda p: [p[1], p[0], p[2]], "y, x, z"),
        (lambda p: [p[2], p[0], p[1]], "z, x, y"),
        (lambda p: [p[1], -p[2], p[0]], "y, -z, x"),
    ],
)
def test_attitudes_tell_which_axes_they_are(tmp_path, new, told):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    changed(raw, PLACE, new)
    with pytest.raises(Pa10calError, match=rf"axes are {told} in place of x, y, z"):
        read_campaign(raw.write())


def test_positions_alone_tell_that_a_frame_is_mirrored(tmp_path):
    raw = sighted(tmp_path, "points", targets=1, noise_mm=0.02)
    changed(raw, [f"T1_{axis}_mm" for axis in "xyz"], lambda p: [p[0], -p[1], p[2]])
    with pytest.raises(Pa10calError, match="mirrored: a left-handed frame"):
        read_campaign(raw.write())


@pytest.mark.parametrize("rows", [1, -1])
def test_readings_a_row_away_are_told_though_one_of_them_has_no_row(tmp_path, rows):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    at, lines = raw.column("x_mm"), [line.split(",") for line in raw.poses[1:]]
    moved = [lines[(k - rows) % len(lines)][at:] for k in range(len(lines))]
    raw.poses[1:] = [",".join((*a[:at], *b)) for a, b in zip(lines, moved, strict=True)]
    with pytest.raises(Pa10calError, match="from the first row on the readings fit the joints"):
        read_campaign(raw.write())


def test_zeros_are_among_the_causes_of_joints_beyond_their_limits(tmp_path):
    raw = sighted(tmp_path, "pose", robot="irb120")
    changed(raw, ["q3_deg"], lambda q: [q[0] + 120.0])
    with pytest.raises(Pa10calError, match=r"signs and zeros of the joints .*joint_offsets_deg"):
        read_campaign(raw.write())


@pytest.mark.parametrize("kind", ["pose", "points"])
def test_right_axes_are_not_doubted(tmp_path, kind):
    found = read_campaign(sighted(tmp_path, kind, noise_mm=0.02).write())
    assert not found.warnings
