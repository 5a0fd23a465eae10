"""Command `curve`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.curve.options import CurveOptions

if TYPE_CHECKING:
    from pa10cal.curve.curve import Curve
    from pa10cal.curve.gait import Gait
    from pa10cal.curve.roll_map import RollMap
    from pa10cal.results.curve import CurveRecord


def curve(*, settings: CurveOptions, out_dir: Path, points: Path | None = None) -> None:
    """Lay a chain of links along a curve, and work out its joint angles and how it moves.

    Args:
        settings: curve, link_m, links, roll, limits, gait.
        out_dir: folder for curve.json, angles.csv, points.csv, links.csv and shape.csv.
        points: points of the curve (.csv): x_m,y_m,z_m or x_mm,y_mm,z_mm.
    """
    from pa10cal.curve.from_options import shape_of
    from pa10cal.curve.records import curve_record, summary
    from pa10cal.errors import SettingsError

    if points is not None and settings.curve is None:
        shape = _through(points, settings.through)
    elif points is None and settings.curve is not None:
        shape = shape_of(settings.curve)
    else:
        raise SettingsError(
            "the curve is given twice or not at all",
            where="--points, curve",
            allowed="points, or a shape by name",
            remedy="give one of them",
        )
    gait = _still(shape, settings) if settings.gait is None else _moving(shape, settings)
    record = curve_record(gait, settings)
    _write(out_dir, gait, record)
    print(f"{out_dir}: {summary(record)}")


def _write(folder: Path, gait: Gait, record: CurveRecord) -> None:
    """Write `angles.csv`, `points.csv`, `links.csv`, `shape.csv` and `curve.json`, all or none."""
    import pandas as pd

    from pa10cal.curve.records import curve_tables
    from pa10cal.files.output import whole_files
    from pa10cal.results.codec import write

    tables = curve_tables(gait)
    paths = [*(folder / f"{name}.csv" for name in tables), folder / "curve.json"]
    with whole_files(*paths) as (*besides, record_beside):
        for beside, columns in zip(besides, tables.values(), strict=True):
            pd.DataFrame(columns).to_csv(beside, index=False, lineterminator="\n")
        write(record, record_beside)


def _through(path: Path, through: str) -> Curve:
    """Return the curve through the points of a file."""
    from pa10cal.curve.polynomial import polyline, spline_through
    from pa10cal.files.curve_points import read_curve_points

    points_m = read_curve_points(path)
    if through == "straight":
        return polyline(points_m)
    return spline_through(points_m, closed=through == "closed_spline")


def _still(curve: Curve, settings: CurveOptions) -> Gait:
    """Lay links along a curve: one shape, at time zero."""
    import numpy as np

    from pa10cal.curve.angles import first_axes, joint_angles
    from pa10cal.curve.gait import Gait
    from pa10cal.curve.points import equal_links, lay_points
    from pa10cal.curve.roll_map import RollMap

    if settings.link_m is not None:
        points = lay_points(curve, settings.link_m, settings.links)
    else:
        points = equal_links(curve, settings.links or 1)
    chain = RollMap.of(points.directions, settings.order)
    roll_rad = _roll(chain, settings)
    axes_first = first_axes(points.directions, roll_rad)
    joints = joint_angles(points.directions, axes_first, settings.order)
    return Gait(np.zeros(1), (curve,), (points,), (joints,), np.array([roll_rad]), np.zeros(0))


def _roll(chain: RollMap, settings: CurveOptions) -> float:
    """Choose the roll of a shape."""
    import numpy as np

    from pa10cal.curve.from_options import limits_of
    from pa10cal.curve.roll import most_room, roll_for_last, room_at, smallest_angle

    limits = limits_of(settings, chain.n - 1)
    if settings.roll == "smallest_angle":
        return smallest_angle(chain, limits).roll_rad
    if settings.roll == "most_room" and limits is not None:
        return most_room(chain, limits).roll_rad
    roll_rad = float(np.radians(settings.roll_deg))
    if settings.roll == "of_last":
        roll_rad = roll_for_last(chain, np.array(settings.z_of_last)).roll_rad
    return roll_rad if limits is None else room_at(chain, roll_rad, limits).roll_rad


def _moving(curve: Curve, settings: CurveOptions) -> Gait:
    """Follow a shape that moves."""
    import numpy as np

    from pa10cal.curve.from_options import limits_of, shape_of
    from pa10cal.curve.gait import follow, given_rolls, small_angles, travelling

    asked, shape = settings.gait, settings.curve
    assert asked is not None
    assert settings.link_m is not None
    assert settings.links is not None
    time_s = np.linspace(0.0, asked.seconds, asked.shapes)
    limits = limits_of(settings, settings.links - 1)
    rolls_rad = np.full(len(time_s), np.radians(settings.roll_deg))
    curves = [curve] * len(time_s)
    if asked.moves == "roll":
        rolls_rad += 2.0 * np.pi * time_s / asked.period_s
        choose = given_rolls(rolls_rad, limits)
    else:
        assert shape is not None
        curves = travelling(lambda phase: shape_of(shape, phase), time_s, asked.period_s)
        small = settings.roll == "smallest_angle"
        given = given_rolls(rolls_rad, limits)
        choose = small_angles(np.radians(asked.move_deg), limits) if small else given
    return follow(curves, time_s, settings.link_m, settings.links, choose, settings.order)
