"""Axes of an instrument that are mirrored or exchanged are told by the nominal arm."""

from __future__ import annotations

import pytest

from made_up_sightings import sighted
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import Pa10calError


def changed(raw, columns, new) -> None:
    """Rewrite the columns of a target: `new` takes and returns three numbers."""
    at = [raw.column(name) for name in columns]
    for k, line in enumerate(raw.poses[1:], start=1):
        row = line.split(",")
        for j, value in zip(at, new([float(row[j]) for j in at]), strict=True):
            row[j] = f"{value:.9f}"
        raw.poses[k] = ",".join(row)


PLACE = ["x_mm", "y_mm", "z_mm"]


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


@pytest.mark.parametrize("kind", ["pose", "points"])
def test_right_axes_are_not_doubted(tmp_path, kind):
    found = read_campaign(sighted(tmp_path, kind, noise_mm=0.02).write())
    assert not found.warnings
