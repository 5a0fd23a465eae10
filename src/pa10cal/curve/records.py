"""`curve.json` and the tables beside it: joint angles, points, links and the curve."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pa10cal.curve.angles import JointAngles, chain_points
from pa10cal.curve.gait import Gait, limits_of
from pa10cal.curve.options import CurveOptions
from pa10cal.curve.points import Points
from pa10cal.curve.roll import RollMap, feasible_rolls
from pa10cal.results.studies import CurveRecord, CurveShape

#: Columns of a table by name.
Columns = dict[str, NDArray[np.float64] | NDArray[np.int_]]

#: Places of the curve that are written for drawing, and of each of several.
_PLACES, _PLACES_OF_MANY = 1000, 150


def curve_record(gait: Gait, settings: CurveOptions) -> CurveRecord:
    """Return statuses and largest angles of a chain.

    Args:
        gait: one shape or several.
        settings: what was requested.
    """
    points = gait.points[0]
    limits = limits_of(settings, points.n - 1)
    free = None
    if limits is not None:
        chain = RollMap.of(points.directions, settings.order)
        free = tuple(map(tuple, np.degrees(feasible_rolls(chain, limits)).tolist()))
    shapes = tuple(
        _of_shape(*each)
        for each in zip(gait.time_s, gait.points, gait.joints, gait.roll_rad, strict=True)
    )
    return CurveRecord(
        link_m=points.link_m,
        links=points.n,
        order=settings.order,
        largest_angle_deg=max(shape.largest_angle_deg for shape in shapes),
        largest_move_deg=float(np.degrees(gait.move_rad.max(initial=0.0))),
        feasible_rolls_deg=free,
        shapes=shapes,
        settings=settings.model_dump(mode="json"),
    )


def curve_tables(gait: Gait) -> dict[str, Columns]:
    """Return the tables `angles`, `points`, `links` and `shape`, each by its columns."""
    return {
        "angles": _angles(gait),
        "points": _points(gait),
        "links": _links(gait),
        "shape": _shape(gait),
    }


def summary(record: CurveRecord) -> str:
    """Return in one line what was laid."""
    text = (
        f"{record.links} links of {record.link_m:.6g} m, {record.shapes[0].ending_is}; largest "
        f"joint angle {record.largest_angle_deg:.4g} degrees"
    )
    moves = record.settings["gait"] is not None
    return f"{text}, largest move {record.largest_move_deg:.3g}" if moves else text


def _of_shape(time_s: float, points: Points, joints: JointAngles, roll_rad: float) -> CurveShape:
    chords_m = np.linalg.norm(np.diff(points.p_m, axis=0), axis=1)
    back_m = chain_points(
        joints.a_rad, joints.b_rad, joints.order, joints.axes[0], points.p_m[0], points.link_m
    )
    largest = np.abs([joints.a_rad, joints.b_rad]).max(initial=0.0)
    return CurveShape(
        time_s=float(time_s),
        ending=points.ending.name.lower(),
        ending_is=points.ending.value,
        left_m=points.left_m,
        gap_m=points.gap_m,
        touches=tuple((np.flatnonzero(points.touches) + 1).tolist()),
        open_joints=tuple((np.flatnonzero(joints.open) + 1).tolist()),
        roll_deg=float(np.degrees(roll_rad)),
        largest_angle_deg=float(np.degrees(largest)),
        chord_error=float(np.abs(chords_m / points.link_m - 1.0).max()),
        forward_kinematics_error_m=float(np.linalg.norm(back_m - points.p_m, axis=1).max()),
    )


def _angles(gait: Gait) -> Columns:
    """One row a joint and shape."""
    joints = gait.a_rad.shape[1]
    return {
        "time_s": np.repeat(gait.time_s, joints),
        "joint": np.tile(np.arange(1, joints + 1), len(gait.time_s)),
        "a_rad": gait.a_rad.ravel(),
        "b_rad": gait.b_rad.ravel(),
        "first_turn_open": np.concatenate([each.open for each in gait.joints]).astype(int),
    }


def _points(gait: Gait) -> Columns:
    """One row a point and shape, from the curve's beginning on."""
    count = gait.p_m.shape[1]
    touches = [np.append(False, points.touches) for points in gait.points]
    p_m = gait.p_m.reshape(-1, 3)
    return {
        "time_s": np.repeat(gait.time_s, count),
        "point": np.tile(np.arange(count), len(gait.time_s)),
        "t": np.concatenate([points.t for points in gait.points]),
        **{f"{axis}_m": p_m[:, k] for k, axis in enumerate("xyz")},
        "touches": np.concatenate(touches).astype(int),
    }


def _links(gait: Gait) -> Columns:
    """One row a link and shape: the axes x, along it, and z of its frame."""
    axes = np.concatenate([each.axes for each in gait.joints])
    links = len(gait.joints[0].axes)
    return {
        "time_s": np.repeat(gait.time_s, links),
        "link": np.tile(np.arange(1, links + 1), len(gait.time_s)),
        **{
            f"{name}_{part}": axes[:, k, axis]
            for name, axis in (("x", 0), ("z", 2))
            for k, part in enumerate("xyz")
        },
    }


def _shape(gait: Gait) -> Columns:
    """Places along the curve of each shape, for drawing."""
    count = _PLACES if len(gait.curves) == 1 else _PLACES_OF_MANY
    t = [np.linspace(curve.bounds.start, curve.bounds.end, count) for curve in gait.curves]
    p_m = np.concatenate([curve.at(each) for curve, each in zip(gait.curves, t, strict=True)])
    return {
        "time_s": np.repeat(gait.time_s, count),
        "t": np.concatenate(t),
        **{f"{axis}_m": p_m[:, k] for k, axis in enumerate("xyz")},
    }
