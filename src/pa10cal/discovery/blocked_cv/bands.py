"""Maps of a broad band of waves: their spectrum from the data, where it predicts better.

A map as fine as the search has them follows waves, not a smooth error. How large waves of each
order are expected to be then matters twice: for how well left-out stretches of time are predicted,
and for what is said of angles that no pose has visited. Both are tried: the blocks of the search,
and stretches of angles of each joint with all their poses left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.blocked_cv.candidate import Candidate, standard_error
from pa10cal.discovery.blocked_cv.finest import FINER_KNOTS, Level, level_of, products_of
from pa10cal.discovery.blocked_cv.marginal import Bands, Waves, most_likely
from pa10cal.discovery.blocked_cv.products import Products, in_terms_of
from pa10cal.discovery.blocked_cv.rows import Rows, ShapedEffect
from pa10cal.discovery.blocked_cv.selection import solve
from pa10cal.terms.effects.joint_error_map import (
    JointErrorMap,
    b_splines_by_knots,
    harmonic_orders,
    harmonics_at_knots,
)
from pa10cal.terms.effects.sensor_error import FINE
from pa10cal.terms.effects.spectrum import Spectrum

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Highest order that decides about a spectrum, in cycles a turn: beyond it there is the floor.
_HIGHEST = 107
#: Tenths of a joint's visited angles that are left out: both of few joints, one each of many.
_TENTHS = (2, 7)
_FEW = 3
#: Size of waves that a map has no knots for [rad].
_NONE_RAD = 1e-12


@dataclass(frozen=True, eq=False)
class InBands:
    """Maps whose waves have a band, and what was left out to compare them.

    Attributes:
        level: the members, maps with their bands, by linear least squares.
        found: the bands.
        of_time: (B, 2) squared errors of stretches of time left out, before and with the bands.
        of_angles: (S, 2) the same of stretches of angles.
    """

    level: Level
    found: Bands
    of_time: Array
    of_angles: Array


def in_bands(rows: Rows, fine: Level) -> InBands | None:
    """Give maps the bands that the data have, where left-out poses are predicted better so.

    Args:
        rows: of the search.
        fine: what it found, maps as fine as helps.

    Returns:
        None where no map is that fine, or the bands predict no better.
    """
    maps = _maps(fine.members)
    if not maps or max(each.knots for each in maps) < FINER_KNOTS[0]:
        return None
    rows = replace(
        rows, shaped=tuple(member.shaped for member in fine.members if not member.is_map)
    )
    members = tuple(_with_form(member, FINE) for member in fine.members)
    inside = products_of(rows, members)
    basis = _Waves(rows, maps)
    in_waves = [
        basis.of(inside.gram[b], inside.projection[b], inside.squares[b])
        for b in range(len(inside.squares))
    ]
    total = _sum(in_waves)
    counted = int(rows.survey.poses.measured.components_seen.sum())
    found = most_likely(
        Waves(
            total.gram,
            total.projection,
            float(total.squares),
            counted,
            basis.known,
            harmonic_orders(2 * _HIGHEST + 1)[1:],
        )
    )
    spectra: list[list[Spectrum | None]] = [[each.spectrum for each in maps], [*found.bands]]
    stretches = [basis.of(*_products_where(rows, members, left)) for left in _stretches(rows, maps)]
    sizes = [basis.sizes(each, maps, found.scatter) for each in spectra]
    of_time = np.array([[_left(total, out, each) for each in sizes] for out in in_waves])
    of_angles = np.array([[_left(total, out, each) for each in sizes] for out in stretches])
    if not _no_worse(of_time, of_angles):
        return None
    bands = iter(found.bands)
    members = tuple(
        _with_form(member, FINE, next(bands)) if member.is_map else member for member in members
    )
    return InBands(level_of(inside, rows, members, of_time[:, 1]), found, of_time, of_angles)


def _no_worse(of_time: Array, of_angles: Array) -> bool:
    """Return whether bands predict left-out poses better, and no kind of them surely worse.

    That the data as a whole prefer them is what they were found by.
    """
    gains = [squares[:, 0] - squares[:, 1] for squares in (of_time, of_angles)]
    worse = any(float(gain.sum()) < -standard_error(gain) for gain in gains)
    return not worse and sum(float(gain.sum()) for gain in gains) > 0.0


class _Waves:
    """Products in terms of waves, without the model's parameters that are held at their bounds."""

    def __init__(self, rows: Rows, maps: Sequence[JointErrorMap]) -> None:
        dense = len(rows.own) + sum(each.effect.linear for each in rows.shaped)
        self._free = np.ones(dense + 2 * _HIGHEST * len(maps), dtype=bool)
        self._free[: len(rows.own)] = ~rows.pressing
        self._dense = dense
        waves = harmonics_at_knots(FINE)[:, 1 : 1 + 2 * _HIGHEST]
        self._bases = [b_splines_by_knots(FINE) @ waves] * len(maps)

    @property
    def known(self) -> int:
        """Return how many columns stand before the waves."""
        return int(self._free[: self._dense].sum())

    def of(self, gram: Array, projection: Array, squares: float) -> Products:
        """Return products of B-splines as products of waves."""
        gram, projection = in_terms_of(gram, projection, self._dense, self._bases)
        free = self._free
        return Products(gram[np.ix_(free, free)], projection[free], np.asarray(squares))

    def sizes(
        self, spectra: Sequence[Spectrum | None], maps: Sequence[JointErrorMap], scatter: float
    ) -> Array:
        """Return the sizes (N,) of all columns, in the scatter of the rows."""
        orders = harmonic_orders(2 * _HIGHEST + 1)[1:]
        found = [np.ones(self.known)]
        for spectrum, each in zip(spectra, maps, strict=True):
            assert spectrum is not None
            has = 2.0 * orders <= (FINE if spectrum != each.spectrum else each.knots)
            found.append(np.where(has, spectrum.sizes_rad(orders) / scatter, _NONE_RAD))
        return np.concatenate(found)


def _left(total: Products, out: Products, sizes: Array) -> float:
    """Return the squared error of poses left out, predicted from the others."""
    gram = (total.gram - out.gram) * (sizes[:, None] * sizes)
    projection = (total.projection - out.projection) * sizes
    x = sizes * solve(gram, projection, np.eye(len(sizes)))
    return float(out.squares - 2.0 * out.projection @ x + x @ out.gram @ x)


def _stretches(rows: Rows, maps: Sequence[JointErrorMap]) -> Iterator[Mask]:
    """Yield which poses have a joint in a tenth of its visited angles, joint by joint."""
    for k, each in enumerate(maps):
        angle = rows.survey.poses.states.q_rad[:, each.joint - 1]
        tenth = np.argsort(np.argsort(angle, kind="stable")) * 10 // len(angle)
        for chosen in _TENTHS if len(maps) <= _FEW else _TENTHS[k % 2 :][:1]:
            yield np.asarray(tenth == chosen)


def _products_where(
    rows: Rows, members: tuple[Candidate, ...], left: Mask
) -> tuple[Array, Array, float]:
    """Return the products of some poses."""
    survey = replace(rows.survey, block=np.where(left, 0, -1))
    found = products_of(replace(rows, survey=survey), members, blocks=1)
    return found.gram[0], found.projection[0], float(found.squares[0])


def _sum(parts: Sequence[Products]) -> Products:
    return Products(
        np.sum([each.gram for each in parts], axis=0),
        np.sum([each.projection for each in parts], axis=0),
        np.sum([each.squares for each in parts], axis=0),
    )


def _maps(members: Sequence[Candidate]) -> list[JointErrorMap]:
    return [member.effect for member in members if isinstance(member.effect, JointErrorMap)]


def _with_form(member: Candidate, knots: int, spectrum: Spectrum | None = None) -> Candidate:
    """Return a map with so many knots, and with a spectrum if one is given; others as they are."""
    effect = member.effect
    if not isinstance(effect, JointErrorMap):
        return member
    effect = replace(effect, knots=knots, spectrum=spectrum or effect.spectrum)
    return Candidate(ShapedEffect(effect), member.columns)
