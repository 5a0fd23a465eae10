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

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.candidate import Candidate, standard_error
from pa10cal.discovery.blocked_cv.finest import (
    FINER_KNOTS,
    Level,
    level_of,
    maps_among,
    products_by_kind,
)
from pa10cal.discovery.blocked_cv.marginal import Bands, Waves, most_likely
from pa10cal.discovery.blocked_cv.products import Products, in_terms_of
from pa10cal.discovery.blocked_cv.rows import Rows, ShapedEffect
from pa10cal.discovery.blocked_cv.selection import solve
from pa10cal.discovery.blocked_cv.survey import BLOCKS
from pa10cal.discovery.weights import Widening
from pa10cal.terms.effects.joint_error_map import (
    JointErrorMap,
    b_splines_by_knots,
    harmonic_orders,
    harmonics_at_knots,
)
from pa10cal.terms.effects.sensor_error import FINE, TYPICAL
from pa10cal.terms.effects.spectrum import Spectrum

#: Highest order that decides about a spectrum, in cycles a turn: beyond it there is the floor.
_HIGHEST = 107
#: Tenths of a joint's visited angles that are left out: both of few joints, one each of many.
_TENTHS = (2, 7)
_FEW = 3
#: Weights of attitudes that are tried, in their scatter.
_SHARES = (1.0, 0.5, 0.25)
#: Size of waves that a map has no knots for [rad].
_NONE_RAD = 1e-12


@dataclass(frozen=True, eq=False)
class InBands:
    """Maps whose waves have a band, and what was left out to compare them."""

    level: Level  # the members, maps with their bands, by linear least squares
    found: Bands  # the bands
    of_time: Array  # (B, 2) squared errors of stretches of time left out, before and with the bands
    of_angles: Array  # (S, 2) the same of stretches of angles
    widening: Widening  # how components scatter, and what attitudes weigh


def in_bands(rows: Rows, fine: Level) -> InBands | None:
    """Give maps the bands that the data have, where left-out poses are predicted better so.

    Args:
        rows: of the search.
        fine: what it found, maps as fine as helps.

    Returns:
        None where no map is that fine, or the bands predict no better.
    """
    maps = maps_among(fine.members)
    if not maps or max(each.knots for each in maps) < FINER_KNOTS[0]:
        return None
    shaped = tuple(member.shaped for member in fine.members if not member.is_map)
    rows = replace(rows, shaped=shaped)
    members = tuple(_with_form(member, FINE) for member in fine.members)
    waves = _Waves(rows, maps)
    splines, by_kind = _Weighed(), []
    for b in range(BLOCKS):
        kinds = products_by_kind(rows, maps_among(members), b)
        splines.add(kinds)
        by_kind.append(tuple(waves.of(each) for each in kinds))
    share = _attitudes(by_kind, waves, len(maps))
    blocks = [_weighed(kinds, share) for kinds in by_kind]
    total = _sum(blocks)
    measured = rows.survey.poses.measured
    seen = measured.components_seen.sum(axis=0)
    positions = int(seen[measured.position_columns].sum())
    # Rows that weigh less count as fewer rows.
    counted = positions + share**2 * (int(seen.sum()) - positions)
    found = most_likely(waves.in_all(total, round(counted)))
    spectra: list[list[Spectrum | None]] = [[each.spectrum for each in maps], [*found.bands]]
    sizes = [waves.sizes(each, maps, found.scatter) for each in spectra]
    of_time = np.array([[_left(total, out, out, each) for each in sizes] for out in blocks])
    of_angles = np.array(
        [
            [_left(total, out, out, each) for each in sizes]
            for out in _stretches(rows, members, waves, share)
        ]
    )
    if not _no_worse(of_time, of_angles):
        return None
    bands = iter(found.bands)
    members = tuple(
        _with_form(member, FINE, next(bands)) if member.is_map else member for member in members
    )
    return InBands(
        level_of(splines.total(share), rows, members, of_time[:, 1]),
        found,
        of_time,
        of_angles,
        Widening(found.scatter, share, tuple(measured.position_columns.tolist())),
    )


class _Weighed:
    """Products of all blocks, of positions and of other rows apart."""

    def __init__(self) -> None:
        self._kinds: tuple[Products, ...] | None = None

    def add(self, kinds: tuple[Products, ...]) -> None:
        """Add a block."""
        before = self._kinds
        self._kinds = kinds if before is None else tuple(map(_sum, zip(before, kinds, strict=True)))

    def total(self, share: float) -> Products:
        """Return all of them, with a weight of what is no position."""
        assert self._kinds is not None
        return _weighed(self._kinds, share)


def _attitudes(by_kind: Sequence[tuple[Products, ...]], waves: _Waves, maps: int) -> float:
    """Return what attitudes should weigh, in their scatter, for left-out poses.

    Their errors go with the pose where a target is tilted or bends: then they average out less than
    their scatter says. The weight is halved while positions and attitudes of left-out blocks, each
    with a scatter of its own, become more likely.
    """
    sizes = waves.sizes([TYPICAL] * maps, [], 1.0)
    best, least = 1.0, np.inf
    for share in _SHARES:
        blocks = [_weighed(kinds, share) for kinds in by_kind]
        total = _sum(blocks)
        left = np.array(
            [
                [_left(total, out, kind, sizes) for kind in kinds]
                for out, kinds in zip(blocks, by_kind, strict=True)
            ]
        ).sum(axis=0)
        if left[1] <= 0.0:
            return 1.0
        cost = float(np.log(left).sum())
        if cost >= least:
            break
        best, least = share, cost
    return best


def _weighed(kinds: Sequence[Products], share: float) -> Products:
    """Return the products of positions and of other rows, these with a weight."""
    positions, others = kinds
    square = share**2
    return Products(
        positions.gram + square * others.gram,
        positions.projection + square * others.projection,
        positions.squares + square * others.squares,
    )


def _no_worse(of_time: Array, of_angles: Array) -> bool:
    """Return whether bands predict no kind of left-out poses surely worse.

    That the data as a whole prefer them is what they were found by. Each stretch counts alike: of
    some joint all that is left out may be far from where the others are.
    """
    gains = [np.log(squares[:, 0] / squares[:, 1]) for squares in (of_time, of_angles)]
    return all(float(gain.sum()) >= -standard_error(gain) for gain in gains)


class _Waves:
    """Products in terms of waves, without the model's parameters that are held at their bounds."""

    def __init__(self, rows: Rows, maps: Sequence[JointErrorMap]) -> None:
        dense = len(rows.own) + sum(each.effect.linear for each in rows.shaped)
        self._free = np.ones(dense + 2 * _HIGHEST * len(maps), dtype=bool)
        self._free[: len(rows.own)] = ~rows.pressing
        self._dense = dense
        self._orders = harmonic_orders(2 * _HIGHEST + 1)[1:]
        waves = harmonics_at_knots(FINE)[:, 1 : 1 + 2 * _HIGHEST]
        self._bases = [b_splines_by_knots(FINE) @ waves] * len(maps)

    @property
    def _known(self) -> int:
        """Return how many columns stand before the waves."""
        return int(self._free[: self._dense].sum())

    def of(self, splines: Products) -> Products:
        """Return products of B-splines as products of waves."""
        found = in_terms_of(splines.gram, splines.projection, self._dense, self._bases)
        gram, projection = found
        free = self._free
        return Products(gram[np.ix_(free, free)], projection[free], splines.squares)

    def in_all(self, total: Products, rows: int) -> Waves:
        """Return the products of so many rows for their likelihood."""
        squares = float(total.squares)
        return Waves(total.gram, total.projection, squares, rows, self._known, self._orders)

    def sizes(
        self, spectra: Sequence[Spectrum | None], before: Sequence[JointErrorMap], scatter: float
    ) -> Array:
        """Return the sizes (N,) of all columns, in the scatter of the rows.

        Args:
            spectra: of each map.
            before: maps whose own spectrum goes no further than their knots.
            scatter: of the rows.
        """
        found = [np.ones(self._known)]
        for k, spectrum in enumerate(spectra):
            assert spectrum is not None
            sizes = spectrum.sizes_rad(self._orders) / scatter
            if before and spectrum == before[k].spectrum:
                sizes[2.0 * self._orders > before[k].knots] = _NONE_RAD
            found.append(sizes)
        return np.concatenate(found)


def _left(total: Products, out: Products, judged: Products, sizes: Array) -> float:
    """Return the squared error of rows that are judged, predicted from all but some.

    Args:
        total, out: products of all, and of those left out.
        judged: products of those judged.
        sizes: (N,) of the columns.
    """
    gram = (total.gram - out.gram) * (sizes[:, None] * sizes)
    projection = (total.projection - out.projection) * sizes
    x = sizes * solve(gram, projection, np.eye(len(sizes)))
    return float(judged.squares - 2.0 * judged.projection @ x + x @ judged.gram @ x)


def _stretches(
    rows: Rows, members: tuple[Candidate, ...], waves: _Waves, share: float
) -> Iterator[Products]:
    """Yield the products of poses with a joint in a tenth of its visited angles."""
    maps = maps_among(members)
    for k, each in enumerate(maps):
        angle = rows.survey.poses.states.q_rad[:, each.joint - 1]
        tenth = np.argsort(np.argsort(angle, kind="stable")) * 10 // len(angle)
        for chosen in _TENTHS if len(maps) <= _FEW else _TENTHS[k % 2 :][:1]:
            survey = replace(rows.survey, block=np.where(tenth == chosen, 0, -1))
            kinds = products_by_kind(replace(rows, survey=survey), maps, 0)
            yield waves.of(_weighed(kinds, share))


def _sum(parts: Sequence[Products]) -> Products:
    """Return products of the rows of several parts."""
    return Products(
        np.sum([each.gram for each in parts], axis=0),
        np.sum([each.projection for each in parts], axis=0),
        np.sum([each.squares for each in parts], axis=0),
    )


def _with_form(member: Candidate, knots: int, spectrum: Spectrum | None = None) -> Candidate:
    """Return a map with so many knots, and with a spectrum if one is given; others as they are."""
    effect = member.effect
    if not isinstance(effect, JointErrorMap):
        return member
    effect = replace(effect, knots=knots, spectrum=spectrum or effect.spectrum)
    return Candidate(ShapedEffect(effect), member.columns)
