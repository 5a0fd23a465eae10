"""The Monte Carlo of one plane (paper, Section II.D): draws, closed form, map.

The closed form is of first order in the joint errors. A small joint error δ ~ N(0, σ² I) moves the
flange by J δ, a normal vector of covariance σ² J Jᵀ. The mean length of a normal vector is an
elliptic integral of the eigenvalues λ of its covariance: its length and its direction after scaling
to the unit sphere are independent, so

    E|J δ| = E|χ₃| · mean over the sphere of √(λ₁n₁² + λ₂n₂² + λ₃n₃²) = √(8/π) R_G(λ₁, λ₂, λ₃),

with Carlson's completely symmetric integral R_G (DLMF 19.16.3). Vanishing eigenvalues are allowed:
one gives the planar case, two the half-normal one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

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
    joint_screws,
    plan_displacement,
)
from pa10cal.montecarlo.places import draw_places, grid_places, reference_in_plane
from pa10cal.options import MonteCarloOptions
from pa10cal.results.montecarlo import Convergence, PlaneMap, PlaneRecord
from pa10cal.results.montecarlo import Places as PlacesDrawn

Counts = NDArray[np.int64]

#: Number of cycles of a block: large against the cost of a call, small enough for the cache and for
#: BLAS to compute each product on one thread. It is part of the definition of the draws: every
#: position has a random stream of its own, drawn block by block, so that the numbers do not depend
#: on the order of positions or on their distribution among jobs.
BLOCK_CYCLES = 6250

#: Called with the numbers of positions done and of all.
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class ErrorSums:
    """Sums of errors over the first cycles of P positions, for several numbers of cycles."""

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
    """Draw the joint errors of every cycle at every position, and return sums of position errors.

    Args:
        plan: of P positions.
        streams: (P,) random streams.
        counts: (C,) increasing numbers of cycles at which sums are returned; the last is that of
            all.
        progress: called after every position.
    """
    cycles = int(counts[-1])
    starts = np.arange(0, cycles, BLOCK_CYCLES)
    cuts = np.unique(np.concatenate([starts, counts]))
    sums = np.empty((2, len(streams), len(cuts) - 1))
    lengths = [min(BLOCK_CYCLES, cycles - start) for start in starts.tolist()]
    blocks = {length: DisplacementBlock(plan, length) for length in set(lengths)}
    to_draw = []  # a block, and the parts of it that are summed, for each start
    for start, length in zip(starts, lengths, strict=True):
        inside = cuts[(cuts >= start) & (cuts <= start + length)] - start
        to_draw.append((blocks[length], list(itertools.pairwise(inside.tolist()))))
    progress(0, len(streams))
    for position, source in enumerate(streams):
        drawn = []
        for block, parts in to_draw:
            source.standard_normal(out=block.normals)
            block.displace(position)
            for first, last in parts:
                error_m = block.error_m[first:last]
                drawn.append((error_m.sum(), error_m @ error_m))
        sums[:, position] = np.transpose(drawn)
        progress(position + 1, len(streams))
    error_m, squared_m2 = np.cumsum(sums, axis=2)[:, :, np.searchsorted(cuts[1:], counts)]
    return ErrorSums(cycles=counts, error_m=error_m, squared_m2=squared_m2)


_NORMAL_95 = 1.959963984540054
_MEAN_OF_CHI_3 = np.sqrt(8.0 / np.pi)


def counts_of(cycles: int, most: int = 20, first: int = 10) -> NDArray[np.int64]:
    """Return at most `most` numbers of cycles in about equal ratios; the last is that of all."""
    return np.unique(np.round(np.geomspace(min(first, cycles), cycles, most)).astype(np.int64))


def drawn_keys(sums: ErrorSums) -> dict[str, Any]:
    """Return the keys of a plane's record that are computed from the draws, in millimetres.

    `std_mm` is the standard deviation within a position, as the paper's.
    """
    means, variances = moments(sums)
    mean, variance = means[:, -1], variances[:, -1]
    # Half the 95 % interval of the mean of all places.
    half_widths = _NORMAL_95 * np.sqrt((variances / sums.cycles).sum(axis=0)) / len(mean)
    total = np.mean(sums.squared_m2[:, -1]) / sums.cycles[-1] - np.mean(mean) ** 2
    between = float(np.std(mean, ddof=1))
    return {
        "mean_mm": _mm(np.mean(mean)),
        "std_mm": _mm(np.sqrt(np.mean(variance))),
        "std_between_mm": _mm(between),
        "std_total_mm": _mm(np.sqrt(total)),
        "half_width95_cycles_mm": _mm(half_widths[-1]),
        "half_width95_positions_mm": _mm(_NORMAL_95 * between / np.sqrt(len(mean))),
        "convergence": Convergence(
            cycles=sums.cycles,
            mean_mm=_mm_each(means.mean(axis=0)),
            half_width95_mm=_mm_each(half_widths),
        ),
    }


def moments(sums: ErrorSums) -> tuple[Array, Array]:
    """Return mean and unbiased variance (P, C) of the first cycles at each position."""
    mean = sums.error_m / sums.cycles
    return mean, np.maximum(sums.squared_m2 - sums.error_m * mean, 0.0) / (sums.cycles - 1)


def expected_error(jacobian: Array, sigma_rad: float) -> tuple[Array, Array]:
    """Return mean and standard deviation (P,) of the position error by independent joint errors.

    Args:
        jacobian: (P, 3, n) velocity of the flange by each joint [m/rad].
        sigma_rad: standard deviation of a joint error.
    """
    squares = sigma_rad**2 * (jacobian @ jacobian.transpose(0, 2, 1))
    # Rounding leaves an eigenvalue that should vanish a little below zero.
    eigenvalues = np.maximum(np.linalg.eigvalsh(squares), 0.0)
    mean_m = _MEAN_OF_CHI_3 * elliprg(*eigenvalues.T)
    return mean_m, np.sqrt(np.maximum(eigenvalues.sum(axis=1) - mean_m**2, 0.0))


_ATTITUDE = (
    "flange axis straight {}, turned about the base axis with the azimuth of its place; "
    "one posture throughout, the one nearest the middle of the joint ranges"
)
_REACH = "distance of the flange from the base z axis, in the plane"
_STD = "within a position: root mean square of the standard deviations of the positions"


def study_plane(
    arm: Arm,
    plane_mm: int,
    settings: MonteCarloOptions,
    campaign: str,
    robot: str,
    progress: Progress = lambda _done, _all: None,
) -> PlaneRecord:
    """Return errors of one plane by resolver uncertainty, drawn and in closed form.

    Raises:
        OutOfReachError: when the plane cannot be reached.
        SettingsError: when the map is too fine.
        ArmError: when a joint slides.
    """
    if arm.prismatic.any():
        raise ArmError(
            "resolver uncertainty is an angle, but a joint is prismatic",
            where=arm.name,
            value=f"joint {int(np.argmax(arm.prismatic)) + 1}",
            allowed="arms with revolute joints only",
            remedy="do not run the Monte Carlo for this robot",
        )
    chain, sigma_rad = Chain.of(arm), math.radians(settings.sigma_deg)
    reference = reference_in_plane(chain, 1e-3 * plane_mm, settings.reach_m)
    on_map = grid_places(chain, reference, settings.reach_m, 1e-3 * settings.map_spacing_mm)
    seed, count = settings.random_seed, settings.positions
    places = draw_places(chain, reference, settings.reach_m, count, stream(seed, plane_mm, None))
    screws = joint_screws(chain, places.q_rad)
    sums = sample_errors(
        plan_displacement(screws, sigma_rad),
        [stream(seed, plane_mm, position) for position in range(count)],
        counts_of(settings.cycles),
        progress,
    )
    expected_m, expected_std_m = expected_error(screws[:, :3], sigma_rad)
    on_map_m, _ = expected_error(joint_screws(chain, on_map.q_rad)[:, :3], sigma_rad)
    mean_m, variance = (of_counts[:, -1] for of_counts in moments(sums))
    per_place = [places.place_base_m, mean_m, np.sqrt(variance), expected_m]
    return PlaneRecord(
        campaign=campaign,
        robot=robot,
        plane_mm=plane_mm,
        reach_m=settings.reach_m,
        reach_is=_REACH,
        attitude=_ATTITUDE.format("down" if reference.R_base_ee[2, 2] < 0.0 else "up"),
        sigma_deg=settings.sigma_deg,
        random_seed=seed,
        cycles=settings.cycles,
        positions=count,
        rejected_positions=places.rejected,
        std_is=_STD,
        closed_form_mean_mm=_mm(np.mean(expected_m)),
        closed_form_std_mm=_mm(np.sqrt(np.mean(expected_std_m**2))),
        closed_form_relative_difference=float(f"{np.mean(mean_m) / np.mean(expected_m) - 1:.6g}"),
        per_position=PlacesDrawn(
            columns=("x_mm", "y_mm", "mean_mm", "std_mm", "closed_form_mean_mm"),
            rows=_mm_each(np.column_stack(per_place)),
        ),
        map=PlaneMap(
            spacing_mm=settings.map_spacing_mm,
            unreachable_points=on_map.rejected,
            columns=("x_mm", "y_mm", "closed_form_mean_mm"),
            rows=_mm_each(np.column_stack([on_map.place_base_m, on_map_m])),
        ),
        **drawn_keys(sums),
    )


def _mm(value_m: Any) -> float:
    return float(_mm_each(value_m))


def _mm_each(value_m: Any) -> Array:
    """Return metres as millimetres, rounded far below the resolution of the draws."""
    return np.round(1e3 * np.asarray(value_m), 9)
