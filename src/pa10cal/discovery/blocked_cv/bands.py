"""Prior variances of maps by bands of frequencies, where these predict held-out poses better.

A map of as many knots as held-out blocks support follows waves, not a smooth error. How large waves
of each order are expected to be then matters for how well stretches of time that are held out are
predicted, and for angles that no pose has visited. Both are tried: the blocks of the search, and
stretches of angles of each joint with all their poses held out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np

from pa10cal.arrays import Array, standard_error_of_sum
from pa10cal.discovery.blocked_cv.band_likelihood import BandEstimates, Waves, most_likely
from pa10cal.discovery.blocked_cv.block_rows import BlockedRows, ShapedEffect
from pa10cal.discovery.blocked_cv.linear_fit import (
    LinearFit,
    joints_and_knots,
    linear_fit_of,
    maps_among,
    with_form,
)
from pa10cal.discovery.blocked_cv.normal_equations import ByKind, in_map_bases, summed
from pa10cal.discovery.pose_scatter import Widening
from pa10cal.discovery.rules import BLOCKS, MAPS
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.periodic_spline import b_splines_by_knots, harmonic_orders, harmonics_at_knots
from pa10cal.observe.instrument import Instrument
from pa10cal.results import maps as results
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import FINE, TYPICAL, BandPrior, JointErrorMap, Spectrum


@dataclass(frozen=True, eq=False)
class InBands:
    """A fit whose maps have bands, and the held-out errors by which these were accepted."""

    # the members, maps with their bands; in splines of all orders and unit scatter, where the
    # held-out errors are of waves up to `MAPS.highest_band`. A refit has the widening
    fit: LinearFit
    estimates: BandEstimates  # of the bands
    of_time: Array  # (B, 2) squares of the search's held-out blocks, without and with bands
    of_angles: Array  # (S, 2) the same of held-out stretches of angles
    widening: Widening  # scatter of the components, and weight of orientations

    @property
    def record(self) -> results.Bands:
        """Return the bands, their uncertainties, and the held-out errors."""
        names = [field.name for field in fields(BandPrior)]
        maps = zip(maps_among(self.fit.members), self.estimates.log_std, strict=True)
        return results.Bands(
            shared=self.estimates.shared,
            scatter=self.estimates.scatter,
            maps=tuple(
                results.BandOfMap(of=each.of, log_std=dict(zip(names, std.tolist(), strict=True)))
                for each, std in maps
            ),
            of_time=_total_squares(self.of_time),
            of_angles=_total_squares(self.of_angles),
        )


def _total_squares(squares: Array) -> results.LeftOut:
    before, after = squares.sum(axis=0).tolist()
    return results.LeftOut(before=before, after=after)


def in_bands(rows: BlockedRows, fine: LinearFit) -> InBands | None:
    """Fit maps with bands as their prior.

    None if no map of the fit is as fine as `MAPS.finer_knots`, if the search for the bands has not
    settled, so that their uncertainties are not known, or if bands predict held-out poses worse.
    """
    maps = maps_among(fine.members)
    if not maps or max(each.knots for each in maps) < MAPS.finer_knots[0]:
        return None
    rows = rows.with_effects_of(fine.members)
    members = tuple(with_form(member, FINE) for member in fine.members)
    waves = _WaveColumns(rows, maps)
    by_kind, splines = _equations_by_block(rows, members, waves)
    measured = rows.survey.poses.measured
    of_kind = _components_by_kind(measured)
    root_weight = _orientation_root_weight(by_kind, of_kind, waves, len(maps))
    blocks = [kinds.weighted(root_weight) for kinds in by_kind]
    total, row_count = summed(blocks), round(float(of_kind @ (1.0, root_weight**2)))
    estimates = most_likely(Waves(total, row_count, waves.leading, waves.orders))
    if not estimates.settled:
        return None
    sizes = (
        waves.sizes_as_found(maps, estimates.scatter),
        waves.sizes(estimates.bands, estimates.scatter),
    )

    def held_out(parts: Iterable[Gaussian]) -> Array:
        """Return the squares of parts of the poses, each held out, without and with bands."""
        return np.array(
            [[_held_out_squares(total, part, [part], each)[0] for each in sizes] for part in parts]
        )

    of_time = held_out(blocks)
    of_angles = held_out(_stretches_of_angles(rows, members, waves, root_weight))
    if not _no_worse(of_time, of_angles):
        return None
    return InBands(
        linear_fit_of(splines.weighted(root_weight), rows, _with_bands(members, estimates.bands)),
        estimates,
        of_time,
        of_angles,
        Widening(estimates.scatter, root_weight, tuple(measured.position_columns.tolist())),
    )


def _components_by_kind(measured: Instrument) -> Array:
    """Return how many components were measured of positions, and of orientations, (2,)."""
    seen = measured.components_seen.sum(axis=0)
    positions = seen[measured.position_columns].sum()
    return np.array([positions, seen.sum() - positions], dtype=float)


def _equations_by_block(
    rows: BlockedRows, members: tuple[ShapedEffect, ...], waves: _WaveColumns
) -> tuple[list[ByKind], ByKind]:
    """Return the normal equations in waves of each block, and in B-splines of all blocks."""
    joints, knots = joints_and_knots(members)
    in_waves: list[ByKind] = []
    splines: ByKind | None = None  # added up at once: one block of them is large
    for block in range(BLOCKS.blocks):
        of_block = rows.equations_by_kind(block, joints, knots)
        in_waves.append(ByKind(*map(waves.of, of_block)))
        if splines is None:
            splines = of_block
        else:
            for whole, part in zip(splines, of_block, strict=True):
                np.add(whole.products, part.products, out=whole.products)
    assert splines is not None
    return in_waves, splines


def _with_bands(
    members: tuple[ShapedEffect, ...], bands: tuple[BandPrior, ...]
) -> tuple[ShapedEffect, ...]:
    """Return members with a band for each map, in their order."""
    band_of: dict[Effect, BandPrior] = dict(zip(maps_among(members), bands, strict=True))
    return tuple(
        with_form(member, FINE, band_of[member.effect]) if member.effect in band_of else member
        for member in members
    )


def _orientation_root_weight(
    by_kind: Sequence[ByKind], components: Array, waves: _WaveColumns, maps: int
) -> float:
    """Return the root weight of orientation rows, in units of that by their scatter.

    Where a target is tilted or bends, errors of orientations average out less than their scatter
    says. The root weight is halved while held-out blocks, each kind with its own scatter, become
    more likely.

    Args:
        components: (2,) how many were measured of positions, and of orientations.
    """
    sizes = waves.sizes([TYPICAL] * maps, 1.0)
    best, least = 1.0, np.inf
    for root_weight in MAPS.attitude_weights:
        blocks = [kinds.weighted(root_weight) for kinds in by_kind]
        total = summed(blocks)
        squares = np.array(
            [
                _held_out_squares(total, block, kinds, sizes)
                for block, kinds in zip(blocks, by_kind, strict=True)
            ]
        ).sum(axis=0)
        _, of_orientations = squares
        if of_orientations <= 0.0:  # none were measured
            return 1.0
        cost = float(components @ np.log(squares))  # of each kind, with its likeliest scatter
        if cost >= least:
            break
        best, least = root_weight, cost
    return best


def _no_worse(of_time: Array, of_angles: Array) -> bool:
    """Return whether bands predict neither kind of held-out stretches worse than by chance.

    That is by more than one standard error of the sum of the logarithms of their squares, in which
    each stretch counts alike: of one stretch that is much worse the standard error is as large. A
    kind with a single stretch, whose scatter is not known, must not be worse at all.
    """
    for squares in (of_time, of_angles):
        gain = np.log(squares[:, 0] / squares[:, 1])
        by_chance = standard_error_of_sum(gain) if len(gain) > 1 else 0.0
        if gain.sum() < -by_chance:
            return False
    return True


class _WaveColumns:
    """Columns of waves for the maps, without the model's parameters that are at their bounds.

    Before them stand the `dense_count` columns of the rows: those of the model, then of effects.
    """

    def __init__(self, rows: BlockedRows, maps: Sequence[JointErrorMap]) -> None:
        wave_count = 2 * MAPS.highest_band  # a sine and a cosine of every order
        self._dense_count = rows.dense_count
        self._free = np.ones(rows.dense_count + wave_count * len(maps), dtype=bool)
        self._free[: len(rows.baseline_columns)] = ~rows.at_bound
        self.orders = harmonic_orders(wave_count + 1)[1:]
        waves = harmonics_at_knots(FINE)[:, 1 : 1 + wave_count]
        basis, joints = b_splines_by_knots(FINE) @ waves, [each.joint for each in maps]
        self._bases = [basis[at] for at in rows.touched(joints, [FINE] * len(maps))]

    @property
    def leading(self) -> int:
        """Return how many columns stand before the waves."""
        return int(self._free[: self._dense_count].sum())

    def of(self, splines: Gaussian) -> Gaussian:
        """Return normal equations in waves from those in B-splines."""
        found = in_map_bases(splines, self._dense_count, self._bases)
        return found if self._free.all() else found.along(np.flatnonzero(self._free))

    def sizes(self, spectra: Sequence[Spectrum], scatter: float) -> Array:
        """Return the standard deviations (N,) of all columns, by the spectra of the maps.

        Those of waves in units of the scatter of the rows; those of the columns before them are 1.
        """
        of_maps = (spectrum.sizes_rad(self.orders) / scatter for spectrum in spectra)
        return np.concatenate([np.ones(self.leading), *of_maps])

    def sizes_as_found(self, maps: Sequence[JointErrorMap], scatter: float) -> Array:
        """Return `sizes` by the spectra that maps have, each with no finer waves than its knots.

        Raises ValueError for a map without a spectrum, whose waves have no size.
        """
        spectra = [each.spectrum for each in maps if each.spectrum is not None]
        if len(spectra) < len(maps):
            raise ValueError("a map has no spectrum")
        sizes = self.sizes(spectra, scatter)
        finest = np.repeat([each.knots / 2 for each in maps], len(self.orders))
        too_fine = np.tile(self.orders, len(maps)) > finest
        sizes[self.leading :][too_fine] = COMPUTING.no_waves_rad
        return sizes


def _held_out_squares(
    total: Gaussian, held_out: Gaussian, judged: Sequence[Gaussian], sizes: Array
) -> list[float]:
    """Return the sums of squares of judged rows, predicted from all but those held out.

    The unknowns have standard deviations `sizes` (N,) a priori.
    """
    x = sizes * (total - held_out).in_sizes(sizes).mean
    return [each.squares_at(x) for each in judged]


def _stretches_of_angles(
    rows: BlockedRows, members: tuple[ShapedEffect, ...], waves: _WaveColumns, root_weight: float
) -> Iterator[Gaussian]:
    """Yield the normal equations of poses with a joint in a stretch of its visited angles.

    Of each joint as many stretches, evenly spread, but at most the `MAPS.angle_parts` that it has.
    """
    maps = maps_among(members)
    joints, knots = joints_and_knots(members)
    of_each = -(-MAPS.angle_stretches // len(maps))
    for each in maps:
        stretch = _stretches_of_turn(rows.survey.poses.states.q_rad[:, each.joint - 1])
        visited = np.unique(stretch)
        spread = (np.arange(of_each) + 0.5) * len(visited) / of_each
        for number in visited[np.unique(spread.astype(int))]:
            of_stretch = rows.equations_of(np.flatnonzero(stretch == number), joints, knots)
            yield waves.of(of_stretch.weighted(root_weight))


def _stretches_of_turn(angle_rad: Array) -> Array:
    """Return in which stretch of the angles visited each of P > 0 poses is, (P,), from 0 on.

    Stretches have about as many poses each; one with a station of many poses has more, and the next
    ones may have none. They are of the turn, so that no pose left out stands at an angle which the
    joint visits in another turn as well, and poses that are nearer to a knot than to others are in
    the same one. The first one begins after the widest gap.
    """
    cell = np.round(np.mod(angle_rad, 2.0 * np.pi) * (FINE / (2.0 * np.pi))).astype(int) % FINE
    visited = np.unique(cell)
    gap = np.diff(visited, append=visited[0] + FINE)
    cell = (cell - visited[(int(np.argmax(gap)) + 1) % len(visited)]) % FINE
    count = np.bincount(cell, minlength=FINE)
    middle = np.cumsum(count) - 0.5 * count
    return np.asarray((MAPS.angle_parts * middle / len(cell)).astype(int)[cell])
