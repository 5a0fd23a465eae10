"""Targets under each other's labels, and targets whose mutual distances are not those of a body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Mask, drawn
from pa10cal.campaign.nominal_fit import (
    LEAST_POSES,
    misfit_mm,
    off_computed_m,
    placed_by_points,
)
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.points import distances_between, scatter_of_computed_m

EXCHANGED = "the labels of these targets are exchanged"
NOT_RIGID = "its distances from the other targets are not those of the other poses"

#: Poses of which each may be the one whose distances most others have, at most.
_COMPARED = 100
#: All orders are tried of at most so many targets.
MOST_TARGETS = 5
#: Labels are exchanged where another order leaves at most this part of the misfit.
EXCHANGED_LEFT = 0.25
#: Poses are suspected of exchanged labels above both: this misfit, and this multiple of the median.
EXCHANGED_MM, EXCHANGED_TYPICAL = 5.0, 6.0
#: Stated places of targets are suspected of being exchanged above this difference.
EXCHANGED_LARGE_MM = 20.0
#: A distance between two targets may differ from its median by the larger of these.
RIGID_MM, RIGID_SIGMAS = 1.0, 10.0


@dataclass(frozen=True)
class ShapeOff:
    """How measured distances between targets differ from those of their stated places."""

    target: int  # the target that explains the largest difference best
    largest_mm: float  # largest difference of a distance
    u_mm: float  # standard uncertainty of that difference
    # the order of the stated places that would agree; None where none does
    order: tuple[int, ...] | None


def stated_shape(p_mm: Array, stated_mm: Array) -> ShapeOff | None:
    """Compare distances between measured targets (P, B, 3) with those of stated places (B, 3).

    Targets that were not seen are nan. None where no two targets are seen together.
    """
    measured, stated = _distances(p_mm), _distances(stated_mm[None])[0]
    seen = np.isfinite(measured).sum(axis=0)
    pairs = np.argwhere(np.triu(seen > 0, 1))
    if not len(pairs):
        return None
    first, second = pairs.T
    of_pairs = measured[:, first, second]
    middle = np.nanmedian(of_pairs, axis=0)
    scatter = MEDIAN_TO_SIGMA * np.nanmedian(np.abs(of_pairs - middle), axis=0)
    off = middle - stated[first, second]
    worst = int(np.abs(off).argmax())
    # A target that is off shows in all its distances, and in no other.
    of_target = [np.mean(off[(first == b) | (second == b)] ** 2) for b in pairs[worst]]
    target = int(pairs[worst][int(np.argmax(of_target))])
    u_mm = float(1.25 * scatter[worst] / np.sqrt(seen[first[worst], second[worst]]))

    def largest_mm(order: list[int]) -> float:
        reordered = stated[np.ix_(order, order)]
        return float(np.abs(middle - reordered[first, second]).max())

    return ShapeOff(target, float(abs(off[worst])), u_mm, _other_order(len(stated), largest_mm))


def stated_order(T_base_ee: Array, p_m: Array, stated_mm: Array) -> tuple[int, ...] | None:
    """Return the order of the stated places (B, 3) in which the nominal arm carries the targets.

    Targets (P, B, 3) were measured at p_m, nan where not seen. None where the stated order is right
    or no order fits much better.
    """
    located = placed_by_points(T_base_ee, p_m) if len(p_m) >= LEAST_POSES else None
    if located is None or len(stated_mm) < 2:
        return None
    places_mm = 1e3 * located.T_ee_targets[:, :3, 3]

    def largest_mm(order: list[int]) -> float:
        return float(np.abs(places_mm - stated_mm[order]).max())

    return _other_order(len(stated_mm), largest_mm, EXCHANGED_LARGE_MM)


def _other_order(
    count: int, misfit_of_order: Callable[[list[int]], float], least: float = 0.0
) -> tuple[int, ...] | None:
    """Return the order of places with a much smaller misfit than the stated one, if any.

    None, too, where the misfit of the stated order is not above `least`.
    """
    if count > MOST_TARGETS:
        return None
    orders = list(permutations(range(count)))
    misfits = [misfit_of_order(list(order)) for order in orders]
    best = int(np.argmin(misfits))
    clear = misfits[0] > least and misfits[best] < EXCHANGED_LEFT * misfits[0]
    return orders[best] if best and clear else None


def not_rigid(p_m: Array) -> Mask:
    """Return (P, B) targets whose distances from the others are not those of the other poses.

    Of a pose the target with most wrong distances is marked. Targets were measured at p_m
    (P, B, 3), nan where not seen.
    """
    off = np.zeros(p_m.shape[:2], dtype=bool)
    if p_m.shape[1] < 2 or len(p_m) < LEAST_POSES:
        return off
    distances_mm = 1e3 * _distances(p_m)

    def median(values: Array) -> Array:
        """Return the median over poses; 0 of pairs never seen together."""
        seen = np.isfinite(values).any(axis=0)
        return np.nanmedian(np.where(seen, values, 0.0), axis=0)

    away_mm = np.abs(distances_mm - median(distances_mm))
    wrong = away_mm > np.maximum(RIGID_MM, RIGID_SIGMAS * MEDIAN_TO_SIGMA * median(away_mm))
    for row in np.flatnonzero(wrong.any(axis=(1, 2))):
        off[row, int(wrong[row].sum(axis=1).argmax())] = True
    return off


def told_of_one_reading(measured: Instrument) -> tuple[str, ...]:
    """Return in words which targets are one reading: copies, or computed from one pose."""
    names, places_m = measured.target_names, measured.places_m
    told = []
    for (first, second), distance_m in distances_between(places_m).items():
        together = distance_m[np.isfinite(distance_m)]
        if len(together) >= LEAST_POSES and not together.any():
            told.append(
                f"{names[second]} has the place of {names[first]} in every row: one reading would "
                f"count twice; leave {names[second]} out"
            )
    if not told and (scatter_m := scatter_of_computed_m(measured)) is not None:
        told.append(
            f"{', '.join(names)} were computed from one pose, as of a rigid body: their distances "
            f"scatter by {1e3 * scatter_m:.1g} mm. They count as separate readings, so that stated "
            "uncertainties are too small, and they do not show whether one is wrong; read the pose "
            "(instrument.kind pose) where the file has it, else one of them"
        )
    return tuple(told)


def told_of_computed(measured: Instrument, T_base_ee: Array) -> tuple[str, ...]:
    """Return in words that readings are what a controller computes from its joints, if they are.

    The nominal end of each reading is T_base_ee (N, 4, 4). Distances alone show no place.
    """
    if measured.places_m.shape[2] < 3:
        return ()
    off_m = [off_computed_m(T_base_ee, place_m) for place_m in np.moveaxis(measured.places_m, 1, 0)]
    known_m = [each for each in off_m if each is not None]
    if not known_m or len(known_m) < len(off_m):
        return ()
    return (
        f"the readings are {1e3 * max(known_m):.2g} mm from the nominal arm in its own base, as "
        "what a controller computes from the joints is: they calibrate nothing; read what an "
        "instrument measured",
    )


def exchanged(p_m: Array, modelled: Array) -> NDArray[np.object_]:
    """Return (P,) the order of the targets that would fit much better; None where labels are right.

    Targets were measured at p_m (P, B, 3), nan where not seen, and `modelled` by `nominal_places`.
    """
    count, targets = p_m.shape[:2]
    orders: NDArray[np.object_] = np.full(count, None, dtype=object)
    if not 2 <= targets <= MOST_TARGETS or count < LEAST_POSES:
        return orders
    as_read_mm = misfit_mm(p_m, modelled)
    limit_mm = max(EXCHANGED_MM, EXCHANGED_TYPICAL * float(np.median(as_read_mm)))
    rows = np.flatnonzero(as_read_mm > limit_mm)
    others = list(permutations(range(targets)))[1:]
    off_mm = np.array([misfit_mm(p_m[rows][:, list(order)], modelled[rows]) for order in others])
    best = off_mm.argmin(axis=0)
    for row, number, best_mm in zip(rows, best, off_mm.min(axis=0), strict=True):
        if best_mm < min(EXCHANGED_LEFT * as_read_mm[row], limit_mm):
            orders[row] = others[number]
    return orders


def exchanged_by_distances(p_m: Array) -> NDArray[np.object_]:
    """Return (P,) the order in which targets have the distances of most poses; None where they do.

    Targets were measured at p_m (P, B, 3), nan where not seen; poses in which one was not seen are
    left as they are. No arm is needed, which labels exchanged in many poses throw off.
    """
    count, targets = p_m.shape[:2]
    orders: NDArray[np.object_] = np.full(count, None, dtype=object)
    whole = np.flatnonzero(np.isfinite(p_m).all(axis=(1, 2)))
    if not 3 <= targets <= MOST_TARGETS or len(whole) < LEAST_POSES:
        return orders
    distances_mm = 1e3 * _distances(p_m[whole])
    # The pose whose distances most others have.
    of_most = max(
        distances_mm[drawn(len(whole), _COMPARED)],
        key=lambda one: int((_differ_mm(distances_mm, one) < EXCHANGED_MM).sum()),
    )
    as_read_mm = _differ_mm(distances_mm, of_most)
    others = list(permutations(range(targets)))[1:]
    for k in np.flatnonzero(as_read_mm > EXCHANGED_MM):
        off_mm = [_differ_mm(distances_mm[k][np.ix_(o, o)][None], of_most)[0] for o in others]
        best = int(np.argmin(off_mm))
        if off_mm[best] < EXCHANGED_LEFT * as_read_mm[k]:
            orders[whole[k]] = others[best]
    return orders


def _differ_mm(distances_mm: Array, of_most: Array) -> Array:
    """Return the largest difference (P,) of distances (P, B, B) from others (B, B)."""
    return np.asarray(np.abs(distances_mm - of_most).max(axis=(1, 2)))


def exchange_text(order: tuple[int, ...], names: tuple[str, ...]) -> str:
    """Return the labels that an order exchanges, in words."""
    moved = [names[b] for b, other in enumerate(order) if other != b]
    return " and ".join((", ".join(moved[:-1]), moved[-1]))


def _distances(p: Array) -> Array:
    return np.asarray(np.linalg.norm(p[:, :, None] - p[:, None], axis=3))
