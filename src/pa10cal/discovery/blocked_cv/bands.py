"""Maps of a broad band of waves: their spectrum from the data, where it predicts better.

A map as fine as the search has them follows waves, not a smooth error. How large waves of each
order are expected to be then matters twice: for how well left-out stretches of time are predicted,
and for what is said of angles that no pose has visited. Both are tried: the blocks of the search,
and stretches of angles of each joint with all their poses left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass, fields, replace
from functools import reduce
from operator import add

import numpy as np
from scipy.linalg import block_diag

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv import search
from pa10cal.discovery.blocked_cv.family import Candidate
from pa10cal.discovery.blocked_cv.survey import BlockedRows, in_terms_of
from pa10cal.discovery.linear import standard_error
from pa10cal.discovery.noise import Widening
from pa10cal.discovery.other_numbers import COMPUTING
from pa10cal.discovery.rules import BLOCKS, MAPS
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.results import maps as results
from pa10cal.terms.effects.joint_error_map import (
    FINE,
    TYPICAL,
    BandPrior,
    JointErrorMap,
    Spectrum,
    b_splines_by_knots,
    harmonic_orders,
    harmonics_at_knots,
)


@dataclass(frozen=True, eq=False)
class InBands:
    """Maps whose waves have a band, and what was left out to compare them."""

    level: search.Level  # the members, maps with their bands, by linear least squares
    found: BandEstimates  # the bands
    of_time: Array  # (B, 2) squared errors of stretches of time left out, before and with the bands
    of_angles: Array  # (S, 2) the same of stretches of angles
    widening: Widening  # how components scatter, and what orientations weigh

    @property
    def record(self) -> results.Bands:
        """Return the bands, how well they are known, and what was left out."""
        names = [field.name for field in fields(BandPrior)]
        return results.Bands(
            shared=self.found.shared,
            scatter=self.found.scatter,
            maps=tuple(
                results.BandOfMap(of=each.of, log_std=dict(zip(names, std.tolist(), strict=True)))
                for each, std in zip(
                    search.maps_among(self.level.members), self.found.log_std, strict=True
                )
            ),
            of_time=_cv_errors(self.of_time),
            of_angles=_cv_errors(self.of_angles),
        )


def _cv_errors(squares: Array) -> results.LeftOut:
    before, after = squares.sum(axis=0).tolist()
    return results.LeftOut(before=before, after=after)


def in_bands(rows: BlockedRows, fine: search.Level) -> InBands | None:
    """Give maps the bands that the data have, where left-out poses are predicted better so.

    None where no map of what the search found is as fine as helps, or the bands predict no better.
    """
    maps = search.maps_among(fine.members)
    if not maps or max(each.knots for each in maps) < MAPS.finer_knots[0]:
        return None
    shaped = tuple(member.shaped for member in fine.members if not member.is_map)
    rows = replace(rows, shaped=shaped)
    members = tuple(search.with_form(member, FINE) for member in fine.members)
    waves = _Waves(rows, maps)
    splines: list[Gaussian] = []  # of all blocks, of positions and of other rows
    by_kind = []
    for b in range(BLOCKS.blocks):
        kinds = rows.products_by_kind(b, *search.joints_and_knots(members))
        splines = [*map(add, splines, kinds)] if splines else [*kinds]
        by_kind.append([waves.of(each) for each in kinds])
    share = _attitudes(by_kind, waves, len(maps))
    blocks = [_weighed(kinds, share) for kinds in by_kind]
    total = reduce(add, blocks)
    measured = rows.survey.poses.measured
    seen = measured.components_seen.sum(axis=0)
    positions = int(seen[measured.position_columns].sum())
    # Rows that weigh less count as fewer rows.
    counted = positions + share**2 * (int(seen.sum()) - positions)
    found = most_likely(Waves(total, round(counted), waves.leading, waves.orders))
    spectra: list[list[Spectrum | None]] = [[each.spectrum for each in maps], [*found.bands]]
    sizes = [waves.sizes(each, maps, found.scatter) for each in spectra]

    def left_out(parts: Iterable[Gaussian]) -> Array:
        return np.array([[_left(total, out, (out,), each)[0] for each in sizes] for out in parts])

    of_time, of_angles = left_out(blocks), left_out(_stretches(rows, members, waves, share))
    if not _no_worse(of_time, of_angles):
        return None
    bands = iter(found.bands)
    members = tuple(
        search.with_form(member, FINE, next(bands)) if member.is_map else member
        for member in members
    )
    return InBands(
        search.level_of(_weighed(splines, share), rows, members),
        found,
        of_time,
        of_angles,
        Widening(found.scatter, share, tuple(measured.position_columns.tolist())),
    )


def _attitudes(by_kind: Sequence[Sequence[Gaussian]], waves: _Waves, maps: int) -> float:
    """Return what orientations should weigh, in their scatter, for left-out poses.

    Where a target is tilted or bends their errors average out less than their scatter says. The
    weight is halved while left-out blocks, each kind with its own scatter, become more likely.
    """
    sizes = waves.sizes([TYPICAL] * maps, [], 1.0)
    best, least = 1.0, np.inf
    for share in MAPS.attitude_weights:
        blocks = [_weighed(kinds, share) for kinds in by_kind]
        total = reduce(add, blocks)
        left = np.array(
            [_left(total, out, kinds, sizes) for out, kinds in zip(blocks, by_kind, strict=True)]
        ).sum(axis=0)
        if left[1] <= 0.0:
            return 1.0
        cost = float(np.log(left).sum())
        if cost >= least:
            break
        best, least = share, cost
    return best


def _weighed(kinds: Sequence[Gaussian], share: float) -> Gaussian:
    """Return what rows of positions and other rows say, these with a weight."""
    positions, others = kinds
    return positions + others.times(share**2)


def _no_worse(of_time: Array, of_angles: Array) -> bool:
    """Return whether bands predict no kind of left-out poses surely worse, each stretch alike."""
    gains = [np.log(squares[:, 0] / squares[:, 1]) for squares in (of_time, of_angles)]
    return all(float(gain.sum()) >= -standard_error(gain) for gain in gains)


class _Waves:
    """What is said of waves, without the model's parameters that are held at their bounds."""

    def __init__(self, rows: BlockedRows, maps: Sequence[JointErrorMap]) -> None:
        self._dense = rows.dense
        self._free = np.ones(rows.dense + 2 * MAPS.highest_band * len(maps), dtype=bool)
        self._free[: len(rows.baseline_columns)] = ~rows.at_bound
        self.orders = harmonic_orders(2 * MAPS.highest_band + 1)[1:]
        waves = harmonics_at_knots(FINE)[:, 1 : 1 + 2 * MAPS.highest_band]
        self._bases = [b_splines_by_knots(FINE) @ waves] * len(maps)

    @property
    def leading(self) -> int:
        """Return how many columns stand before the waves."""
        return int(self._free[: self._dense].sum())

    def of(self, splines: Gaussian) -> Gaussian:
        """Return what is said of waves where B-splines were."""
        free = np.flatnonzero(self._free)
        return in_terms_of(splines, self._dense, self._bases).along(free)

    def sizes(
        self, spectra: Sequence[Spectrum | None], before: Sequence[JointErrorMap], scatter: float
    ) -> Array:
        """Return the sizes (N,) of all columns by the spectra of maps, in the scatter of the rows.

        Of maps that had their spectrum before it goes no further than their knots.
        """
        found = [np.ones(self.leading)]
        for k, spectrum in enumerate(spectra):
            assert spectrum is not None
            sizes = spectrum.sizes_rad(self.orders) / scatter
            if before and spectrum == before[k].spectrum:
                sizes[self.orders > before[k].knots / 2] = COMPUTING.no_waves_rad
            found.append(sizes)
        return np.concatenate(found)


def _left(total: Gaussian, out: Gaussian, judged: Sequence[Gaussian], sizes: Array) -> list[float]:
    """Return the squared error of judged rows, predicted from all but those out; sizes are (N,)."""
    x = sizes * (total - out).in_sizes(sizes).mean
    return [each.squares_at(x) for each in judged]


def _stretches(
    rows: BlockedRows, members: tuple[Candidate, ...], waves: _Waves, share: float
) -> Iterator[Gaussian]:
    """Yield what is said by poses with a joint in a tenth of its visited angles."""
    maps = search.maps_among(members)
    for k, each in enumerate(maps):
        angle = rows.survey.poses.states.q_rad[:, each.joint - 1]
        tenth = np.argsort(np.argsort(angle, kind="stable")) * 10 // len(angle)
        for chosen in (
            MAPS.tenths_left_out
            if len(maps) <= MAPS.few_joints
            else MAPS.tenths_left_out[k % 2 :][:1]
        ):
            survey = replace(rows.survey, block=np.where(tenth == chosen, 0, -1))
            chosen_rows = replace(rows, survey=survey)
            kinds = chosen_rows.products_by_kind(0, *search.joints_and_knots(members))
            yield waves.of(_weighed(kinds, share))


# The band of a joint's error, found from the data by marginal likelihood.
#
# Sizes of waves are Gaussian a priori, with a standard deviation by a few numbers: levels below
# and in a band, its ends, its decay, a floor. With all waves and the model's own parameters
# integrated out, the data say which of these numbers are likely (type II maximum likelihood,
# empirical Bayes; MacKay 1992, Neural Computation 4, 415). Products of the rows are all it takes,
# once; a step costs one factorisation, and gives the gradient with it.

#: Standard deviation, in logarithms, by which the numbers of a band may differ from typical
#: ones, and by which those of a joint may differ from the arm's.
_ANYWHERE = np.array(MAPS.band_std)
_OF_A_JOINT = np.array(MAPS.band_std_of_joint)
#: Numbers of a band.
_NUMBERS = len(_ANYWHERE)


@dataclass(frozen=True, eq=False)
class Waves:
    """What weighed rows say of unknowns in known sizes, then of waves of one map a joint."""

    said: Gaussian  # of N unknowns
    rows: int  # how many rows there were
    leading: int  # columns before the waves; each in its size
    orders: Array  # (M,) cycles a turn of the waves, the same for every map

    @property
    def maps(self) -> int:
        """Return how many maps there are."""
        return (self.said.unknowns - self.leading) // len(self.orders)


@dataclass(frozen=True, eq=False)
class BandEstimates:
    """The most likely bands."""

    bands: tuple[BandPrior, ...]  # one a map; all the same where the data ask for no more
    log_std: Array  # (maps, k) standard uncertainty of the logarithms of the numbers of each
    scatter: float  # of the rows, in their stated unit
    shared: bool  # whether all maps have one band


def most_likely(waves: Waves) -> BandEstimates:
    """Return the bands under which the data are most likely, one for all maps or one for each."""
    together = _climb(_Cost(waves, own=False), np.append(_logs(TYPICAL), 0.0))
    if waves.maps == 1:
        return _bands(together)
    at = together.at
    start = np.concatenate([at[:_NUMBERS], np.zeros(_NUMBERS * waves.maps), at[_NUMBERS:]])
    apart = _climb(_Cost(waves, own=True), start)
    return _bands(min(together, apart, key=_minus_twice_log_evidence))


def minus_twice_log_likelihood(
    waves: Waves, log_sizes: Array, log_scatter: float
) -> tuple[float, Array, float, Array]:
    """Return minus twice the marginal log-likelihood, and its derivatives.

    By each of the logarithms of the standard deviations of all waves, (maps M,); by that of the
    scatter of the rows; and the second (maps M, maps M) by the former, as is to be expected.
    """
    sizes = np.concatenate([np.ones(waves.leading), np.exp(log_sizes)])
    said = waves.said.times(float(np.exp(-2.0 * log_scatter))).in_sizes(sizes)
    x, inverse = said.mean, said.covariance
    variance = np.diag(inverse)
    value = 2.0 * (waves.rows * log_scatter - said.log_evidence)
    left = said.squares_at(x)
    determined = len(x) - float(variance.sum())
    of_waves = slice(waves.leading, None)
    told = np.eye(len(log_sizes)) - inverse[of_waves, of_waves]
    by_sizes = 2.0 * (1.0 - variance - x**2)[of_waves]
    return value, by_sizes, 2.0 * (waves.rows - left - determined), 4.0 * told**2


@dataclass(frozen=True, eq=False)
class _Point:
    """A point of the climb: logarithms of the numbers, what joints have of their own, scatter."""

    at: Array  # (k + own k + 1,) the point; what joints have of their own in `_OF_A_JOINT`
    value: float  # minus twice the log-likelihood, with what is expected of the numbers
    gradient: Array  # its derivative
    curvature: Array  # its second derivative, as is to be expected
    # (maps 7, k + own k) how the logarithms of every map follow the point, but for the scatter
    by_point: Array


class _Cost:
    """The cost of points: data, and what is expected of the numbers as if it had been seen."""

    def __init__(self, waves: Waves, *, own: bool) -> None:
        self._waves, self._own = waves, waves.maps if own else 0
        self._typical = _logs(TYPICAL)
        shared = np.tile(np.eye(_NUMBERS), (waves.maps, 1))
        of_own = np.kron(np.eye(self._own), np.diag(_OF_A_JOINT))
        self._by_point = np.asarray(np.hstack([shared, of_own]) if own else shared)

    def __call__(self, at: Array) -> _Point:
        """Return the cost at a point."""
        waves = self._waves
        logs = (self._by_point @ at[:-1]).reshape(-1, _NUMBERS)
        value, by_sizes, by_scatter, curvature = minus_twice_log_likelihood(
            waves,
            np.concatenate([_log_sizes(each, waves.orders) for each in logs]),
            float(at[-1]),
        )
        slopes = block_diag(*(_slopes(each, waves.orders) for each in logs)) @ self._by_point
        off = np.append((at[:_NUMBERS] - self._typical) / _ANYWHERE, at[_NUMBERS:-1])
        expected = np.append(1.0 / _ANYWHERE, np.ones(len(at) - 1 - _NUMBERS))
        by_numbers = slopes.T @ curvature @ slopes + np.diag(2.0 * expected**2)
        return _Point(
            at,
            value + float(off @ off),
            np.append(slopes.T @ by_sizes + 2.0 * expected * off, by_scatter),
            block_diag(by_numbers, np.full((1, 1), 4.0 * waves.rows)),  # the scatter's is last
            self._by_point,
        )


def _climb(cost: _Cost, start: Array) -> _Point:
    """Return the most likely point from a start, by steps of the expected curvature (Fisher)."""
    here, damping = cost(start), 0.0
    for _ in range(COMPUTING.band_steps):
        damped = here.curvature + damping * np.diag(np.diag(here.curvature))
        step = -np.linalg.solve(damped, here.gradient)
        step *= min(1.0, COMPUTING.band_longest / float(np.abs(step).max()))
        ahead = cost(here.at + step)
        if ahead.value > here.value:
            damping = max(COMPUTING.damping_up * damping, COMPUTING.band_damping)
            continue
        gained, here = here.value - ahead.value, ahead
        damping *= COMPUTING.damping_down
        if gained < COMPUTING.band_settled:
            break
    return here


def _minus_twice_log_evidence(point: _Point) -> float:
    """Return minus twice the log evidence, the numbers integrated out (Laplace's approximation)."""
    _, volume = np.linalg.slogdet(0.5 * point.curvature[:-1, :-1])
    return point.value + float(volume)


def _bands(point: _Point) -> BandEstimates:
    """Return the bands at a point, as uncertain as the expected curvature says."""
    covariance = 2.0 * np.linalg.inv(point.curvature[:-1, :-1])
    variances = np.diag(point.by_point @ covariance @ point.by_point.T)
    return BandEstimates(
        bands=tuple(map(_band, (point.by_point @ point.at[:-1]).reshape(-1, _NUMBERS))),
        log_std=np.sqrt(variances).reshape(-1, _NUMBERS),
        scatter=float(np.exp(point.at[-1])),
        shared=len(point.at) == 1 + _NUMBERS,
    )


def _logs(band: BandPrior) -> Array:
    """Return the logarithms of the numbers of a band."""
    return np.asarray(np.log(np.array(astuple(band))))


def _band(logs: Array) -> BandPrior:
    """Return the band of logarithms."""
    return BandPrior(*(float(each) for each in np.exp(logs)))


def _log_sizes(logs: Array, orders: Array) -> Array:
    """Return the logarithms of the sizes (M,) of waves."""
    return np.asarray(np.log(_band(logs).sizes_rad(orders)))


def _slopes(logs: Array, orders: Array) -> Array:
    """Return how the logarithms of sizes follow those of the numbers, (M, k)."""
    steps = COMPUTING.band_difference * np.eye(_NUMBERS)
    ahead = [_log_sizes(logs + step, orders) - _log_sizes(logs - step, orders) for step in steps]
    return np.stack(ahead, axis=1) / (2.0 * COMPUTING.band_difference)
