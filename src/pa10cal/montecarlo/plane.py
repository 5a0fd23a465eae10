"""The Monte Carlo of one plane (paper, Section II.D): places, draws, closed form, map."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import elliprg

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import ArmError
from pa10cal.montecarlo.displacement import (
    DisplacementBlock,
    DisplacementPlan,
    joint_motion,
    plan_displacement,
)
from pa10cal.montecarlo.places import Places, draw_places, grid_places, reference_in_plane

# Drawing joint errors, and the length of the flange's displacement for each draw.
#
# Every position has a random stream of its own and is worked through in blocks small enough for
# the processor's cache; nothing is allocated between blocks. So the numbers do not depend on the
# order of the positions, nor on how they are shared among jobs or threads. The block's length
# belongs to the definition of the draws and is therefore a constant.

Counts = NDArray[np.int64]

#: Cycles a block: long enough to hide the cost of a call, short enough for the cache and for BLAS
#: to keep each product on one thread.
BLOCK_CYCLES = 6250

#: Called with positions done and positions in all.
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class ErrorSums:
    """Sums over the first cycles of P positions, at several counts of cycles."""

    cycles: Counts  # (C,) counts of cycles, increasing; the last is all of them
    error_m: Array  # (P, C) sum of the errors of the first cycles
    squared_m2: Array  # (P, C) sum of their squares


def stream(random_seed: int, plane_mm: int, position: int | None) -> np.random.Generator:
    """Return the generator of one position's draws, or, for None, of the positions themselves."""
    key = (plane_mm % 2**32, 0 if position is None else position + 1)
    seed = np.random.SeedSequence(random_seed % 2**64, spawn_key=key)
    return np.random.Generator(np.random.SFC64(seed))


def sample_errors(
    plan: DisplacementPlan,
    streams: Sequence[np.random.Generator],
    counts: Counts,
    progress: Progress = lambda _done, _all: None,
) -> ErrorSums:
    """Draw the joint errors of every cycle at every position and sum the position errors.

    Args:
        plan: the displacement at P positions.
        streams: P fresh generators, one a position.
        counts: (C,) increasing counts of cycles at which the sums are kept; the last is the
            number of cycles at each position.
        progress: called before the first and after every position.
    """
    cycles = int(counts[-1])
    starts = np.arange(0, cycles, BLOCK_CYCLES)
    cuts = np.unique(np.concatenate([starts, counts[:-1]]))
    sums = np.empty((2, len(streams), len(cuts)))
    blocks = {
        length: DisplacementBlock(plan, length)
        for length in {min(BLOCK_CYCLES, cycles - int(start)) for start in starts}
    }
    ones = np.ones(BLOCK_CYCLES)
    work = []
    for start in starts:
        block = blocks[min(BLOCK_CYCLES, cycles - int(start))]
        inside = cuts[(cuts >= start) & (cuts < start + BLOCK_CYCLES)]
        bounds = [*(inside - start), len(block.error_m)]
        parts = [
            (block.error_m[first:last], ones[: last - first])
            for first, last in itertools.pairwise(bounds)
        ]
        work.append((block, parts))
    progress(0, len(streams))
    for position, source in enumerate(streams):
        drawn = []
        for block, parts in work:
            source.standard_normal(out=block.normals)
            block.displace(position)
            drawn += [(error_m.dot(one), error_m.dot(error_m)) for error_m, one in parts]
        sums[:, position] = np.transpose(drawn)
        progress(position + 1, len(streams))
    ends = np.searchsorted(np.append(cuts[1:], cycles), counts)
    error_m, squared_m2 = np.cumsum(sums, axis=2)[:, :, ends]
    return ErrorSums(cycles=counts, error_m=error_m, squared_m2=squared_m2)


# Mean and spread of the position error: from the sums of the draws, and in closed form.
#
# The closed form is of first order in the joint errors. A small joint error δ ~ N(0, σ² I) moves
# the flange by J δ, a normal vector of covariance σ² J Jᵀ. The mean length of a normal vector is
# an elliptic integral of the eigenvalues λ of its covariance: its length and its direction after
# scaling to the unit sphere are independent, so
#
#     E|J δ| = E|χ₃| · mean over the sphere of √(λ₁n₁² + λ₂n₂² + λ₃n₃²) = √(8/π) R_G(λ₁, λ₂, λ₃),
#
# with Carlson's completely symmetric integral R_G (DLMF 19.16.3). Vanishing eigenvalues are
# allowed: one gives the planar case, two the half-normal one.

_NORMAL_95 = 1.959963984540054
_MEAN_OF_CHI_3 = np.sqrt(8.0 / np.pi)


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of the drawn errors at P places."""

    place_mean_m: Array  # (P,) mean at each place
    place_std_m: Array  # (P,) standard deviation at each place
    mean_m: float  # mean of all draws
    std_within_m: float  # spread within a place: root mean square of `place_std_m`
    std_between_m: float  # standard deviation of `place_mean_m`
    std_total_m: float  # standard deviation of all draws
    # half the 95 % interval of `mean_m` over these places: what more cycles would narrow
    half_width_m: float
    # half the 95 % interval of `mean_m` over all places of the plane: what more places would
    # narrow
    places_half_width_m: float


@dataclass(frozen=True)
class Convergence:
    """Mean of all places after the first cycles at each."""

    cycles: NDArray[np.int64]  # (C,) cycles at each place
    mean_m: Array  # (C,) running mean
    half_width_m: Array  # (C,) half its 95 % interval over these places


@dataclass(frozen=True)
class ExpectedError:
    """Expected length of the flange's displacement at P positions."""

    mean_m: Array  # (P,) mean
    std_m: Array  # (P,) standard deviation


def counts_of(cycles: int, most: int = 20, first: int = 10) -> NDArray[np.int64]:
    """Return at most `most` counts of cycles, evenly spread by ratio, that end with all of them."""
    return np.unique(np.round(np.geomspace(min(first, cycles), cycles, most)).astype(np.int64))


def summarise(sums: ErrorSums) -> ErrorStatistics:
    """Return the statistics of all cycles."""
    mean, variance = _moments(sums)
    mean, variance = mean[:, -1], variance[:, -1]
    places, cycles = len(mean), int(sums.cycles[-1])
    between = float(np.std(mean, ddof=1))
    total = np.mean(sums.squared_m2[:, -1]) / cycles - np.mean(mean) ** 2
    return ErrorStatistics(
        place_mean_m=mean,
        place_std_m=np.sqrt(variance),
        mean_m=float(np.mean(mean)),
        std_within_m=float(np.sqrt(np.mean(variance))),
        std_between_m=between,
        std_total_m=float(np.sqrt(total)),
        half_width_m=float(_half_width(variance[:, None], sums.cycles[-1:])[0]),
        places_half_width_m=_NORMAL_95 * between / float(np.sqrt(places)),
    )


def convergence(sums: ErrorSums) -> Convergence:
    """Return how the mean settled."""
    mean, variance = _moments(sums)
    return Convergence(sums.cycles, mean.mean(axis=0), _half_width(variance, sums.cycles))


def _moments(sums: ErrorSums) -> tuple[Array, Array]:
    """Return mean and unbiased variance (P, C) of the first cycles at each place."""
    mean = sums.error_m / sums.cycles
    return mean, np.maximum(sums.squared_m2 - sums.error_m * mean, 0.0) / (sums.cycles - 1)


def _half_width(variance: Array, cycles: NDArray[np.int64]) -> Array:
    """Return half the 95 % interval (C,) of the mean of all places."""
    variance_of_sum: Array = (variance / cycles).sum(axis=0)
    return _NORMAL_95 * np.sqrt(variance_of_sum) / len(variance)


def expected_error(jacobian: Array, sigma_rad: float) -> ExpectedError:
    """Return the expected position error of joints with independent errors of `sigma_rad`.

    Args:
        jacobian: (P, 3, n) velocity of the flange by each joint [m/rad].
        sigma_rad: standard deviation of every joint.
    """
    squares = sigma_rad**2 * (jacobian @ jacobian.transpose(0, 2, 1))
    # Rounding leaves an eigenvalue that should vanish a little below zero.
    eigenvalues = np.maximum(np.linalg.eigvalsh(squares), 0.0)
    mean_m = _MEAN_OF_CHI_3 * elliprg(*eigenvalues.T)
    variance = np.maximum(eigenvalues.sum(axis=1) - mean_m**2, 0.0)
    return ExpectedError(mean_m=mean_m, std_m=np.sqrt(variance))


@dataclass(frozen=True)
class PlaneTask:
    """What to compute."""

    plane_mm: int  # height of the flange above the base
    reach_m: tuple[float, float]  # least and greatest distance of the flange from the base z axis
    positions: int  # places drawn
    cycles: int  # draws at each place
    sigma_rad: float  # standard uncertainty of every joint
    random_seed: int  # of places and draws
    map_spacing_m: float  # grid of the map


@dataclass(frozen=True)
class PlaneErrors:
    """Errors in one plane."""

    places: Places  # P places that were drawn
    sums: ErrorSums  # of the drawn errors there
    expected: ExpectedError  # closed form there
    map_places: Places  # K places of the map
    map_expected: ExpectedError  # closed form there


def study_plane(
    arm: Arm, task: PlaneTask, progress: Progress = lambda _done, _all: None
) -> PlaneErrors:
    """Draw resolver errors at places of one plane and set the closed form beside them.

    Args:
        arm: the nominal arm.
        task: what to compute.
        progress: called before the first and after every position.

    Raises:
        SettingsError: when the plane cannot be reached or the map is too fine.
        ArmError: when a joint slides.
    """
    _refuse_sliding_joints(arm)
    chain = Chain.of(arm)
    reference = reference_in_plane(chain, 1e-3 * task.plane_mm, task.reach_m)
    map_places = grid_places(chain, reference, task.reach_m, task.map_spacing_m)
    map_motion = joint_motion(chain, map_places.q_rad)
    source = stream(task.random_seed, task.plane_mm, None)
    places = draw_places(chain, reference, task.reach_m, task.positions, source)
    motion = joint_motion(chain, places.q_rad)
    streams = [
        stream(task.random_seed, task.plane_mm, position) for position in range(task.positions)
    ]
    plan = plan_displacement(motion, task.sigma_rad)
    return PlaneErrors(
        places=places,
        sums=sample_errors(plan, streams, counts_of(task.cycles), progress),
        expected=expected_error(motion.jacobian, task.sigma_rad),
        map_places=map_places,
        map_expected=expected_error(map_motion.jacobian, task.sigma_rad),
    )


def _refuse_sliding_joints(arm: Arm) -> None:
    if arm.prismatic.any():
        raise ArmError(
            "resolver uncertainty is an angle, but a joint is prismatic",
            where=arm.name,
            value=f"joint {int(np.argmax(arm.prismatic)) + 1}",
            allowed="arms with revolute joints only",
            remedy="do not run the Monte Carlo for this robot",
        )
