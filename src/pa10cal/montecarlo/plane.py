"""The Monte Carlo of one plane (paper, Section II.D): draws, closed form, map."""

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
from pa10cal.montecarlo.places import draw_places, grid_places, reference_in_plane
from pa10cal.options import MonteCarloOptions
from pa10cal.results.montecarlo import Convergence, PlaneMap, PlaneRecord
from pa10cal.results.montecarlo import Places as PlacesDrawn

# The displacement of the flange under finite joint errors, as products of rows and one matrix.
#
# Joint i turns all that lies beyond it about its axis ẑ by its error δ. If the joints further out
# have displaced the flange by u, and v runs from the axis to the flange, joint i adds
#
#     sin δ ẑ×(v + u) + (1 - cos δ) ẑ×(ẑ×(v + u)),
#
# which is exact: nothing is linearised. So the displacement is a constant matrix, in which stands
# all that belongs to the pose, times rows that change with every draw: sin δ and 1 - cos δ of the
# joints, and their products with the components of u across the axis. u is computed from the tip
# inwards; it is small, so no digits are lost. Three simplifications, all exact:
#
# - the length of a displacement does not depend on the link it is seen from. Seen from a link in
#   the middle, the tip moves by the joints beyond that link, and the point where the flange should
#   be moves by the joints before it, turned backwards: two short chains instead of a long one;
# - a component of u that vanishes in every pose takes no product (axes at right angles);
# - outermost joints whose axes pass through the point do not move it (their errors are drawn all
#   the same).

#: The series leaves out δ⁴/24 of 1 - cos δ and δ⁵/120 of sin δ; it serves while the former, of
#: an angle this many standard deviations long, stays below `_LEFT_OUT`: a longer angle comes once
#: in 1e15 draws.
_LONGEST_SIGMAS = 8.0
_LEFT_OUT = 1e-12
#: A joint that moves the flange by less than this per radian does not move it [m].
_STILL_M = 1e-13
#: A part of a displacement below this [m for one radian] vanishes.
_VANISHES_M = 1e-14


def series_is_exact(sigma_rad: float) -> bool:
    """Return whether `turns` may take the series for errors of this standard deviation."""
    return bool((_LONGEST_SIGMAS * sigma_rad) ** 4 / 24.0 <= _LEFT_OUT)


def turns(normals: Array, versine: Array, work: Array, sigma_rad: float, *, series: bool) -> None:
    """Replace normals z by sin σz, and write 1 - cos σz, in few passes over memory.

    By the series σz - (σz)³/6 and (σz)²/2, or by numpy's sine with 1 - cos δ = 2 sin²(δ/2).
    """
    if series:
        np.square(normals, work)
        np.multiply(work, sigma_rad**2 / 2.0, versine)
        np.multiply(work, -(sigma_rad**3) / 6.0, work)
        np.add(work, sigma_rad, work)
        np.multiply(normals, work, normals)
        return
    np.multiply(normals, 0.5 * sigma_rad, work)
    np.sin(work, work)
    np.square(work, versine)
    np.multiply(versine, 2.0, versine)
    np.multiply(normals, sigma_rad, normals)
    np.sin(normals, normals)


def joint_screws(chain: Chain, q_rad: Array) -> Array:
    """Return what each joint does to the flange at joint positions (P, n), (P, 6, n).

    Velocity of the flange by each joint [m/rad], then the unit vector of its axis, in the base
    frame.
    """
    return chain.forward_with_screws(q_rad).screws[:, :, chain.joint_columns]


@dataclass(frozen=True)
class Product:
    """What a displacement is across an axis, times sine and versine of the joint that turns it."""

    components: Array  # (P, c, rows) matrix of its c components, one or two
    rows: slice  # the rows they are made of
    joint: int  # the joint whose sine and versine multiply them
    into: slice  # the 2 c rows that hold the products, those with the sine first


@dataclass(frozen=True)
class DisplacementPlan:
    """Everything constant in the displacement of the flange at P positions.

    The rows are: sines of all n joints, versines of those up to the last that moves something,
    products.
    """

    sigma_rad: float  # standard deviation of the error of a joint
    joints: int  # n, all of which are drawn
    moving: int  # how many of them, from the base outwards, may move the flange
    products: tuple[Product, ...]  # in the order they are computed
    matrix: Array  # (P, 3, rows) from rows to displacements [m]


def plan_displacement(screws: Array, sigma_rad: float) -> DisplacementPlan:
    """Lay out the displacement for joint errors of `sigma_rad` at positions of screws (P, 6, n).

    It is seen from the link from which it takes the fewest rows.
    """
    n = screws.shape[2]
    moves = np.linalg.norm(screws[:, :3], axis=1).max(axis=0) > _STILL_M
    plans = []
    for link in range(n + 1):  # so many joints lie before it
        chains = []  # of joints from the link outwards, to the tip and to the base
        for chain in (list(range(link, n)), list(range(link))[::-1]):
            while chain and not moves[chain[-1]]:
                chain.pop()
            chains.append(chain)
        moving = 1 + max((*chains[0], *chains[1]), default=-1)
        products: list[Product] = []
        # Seen from the link, the joints before it turn the other way.
        tip = _displacement(screws, chains[0], 1.0, moving, products)
        base = _displacement(screws, chains[1], -1.0, moving, products)
        used = products[-1].into.stop if products else n + moving
        matrix = np.ascontiguousarray((tip - base)[:, :, :used])
        plans.append(DisplacementPlan(sigma_rad, n, moving, tuple(products), matrix))
    return min(plans, key=lambda plan: plan.matrix.shape[2])


def _displacement(
    screws: Array, chain: list[int], sign: float, moving: int, products: list[Product]
) -> Array:
    """Return (P, 3, rows): the point moved by the joints of a chain, in the base frame.

    Products that this takes are appended to those there are.
    """
    positions, _, n = screws.shape
    u = np.zeros((positions, 3, n + moving + 4 * n * n))
    for joint in reversed(chain):
        velocity, axis = sign * screws[:, :3, joint], sign * screws[:, 3:, joint]
        turned = np.cross(axis[:, :, None], u, axis=1)
        made_of = np.flatnonzero(np.abs(turned).max(axis=(0, 1)) > _VANISHES_M)
        if len(made_of):
            rows = slice(int(made_of[0]), int(made_of[-1]) + 1)
            directions, sizes, parts = np.linalg.svd(turned[:, :, rows], full_matrices=False)
            count = int((sizes > _VANISHES_M).sum(axis=1).max())
            components = np.ascontiguousarray((sizes[:, :, None] * parts)[:, :count])
            first = products[-1].into.stop if products else n + moving
            into = slice(first, first + 2 * count)
            products.append(Product(components, rows, joint, into))
            turned = directions[:, :, :count]
            u[:, :, into] = np.dstack([turned, np.cross(axis[:, :, None], turned, axis=1)])
        u[:, :, joint] += velocity
        u[:, :, n + joint] += np.cross(axis, velocity)
    return u


class DisplacementBlock:
    """One block of cycles: from drawn normals to lengths of displacements, without allocating.

    `normals` (n, cycles) are filled before every `displace`, which uses them up and leaves the
    lengths `error_m` (cycles,).
    """

    def __init__(self, plan: DisplacementPlan, cycles: int) -> None:
        n, moving, used = plan.joints, plan.moving, plan.matrix.shape[2]
        # A block fills the processor's cache: products and displacement are written over work.
        rows = np.zeros((max(used + 5, n + 2 * moving), cycles))
        self._plan, self._rows = plan, rows
        self.normals, self._work = rows[:n], rows[-5:-3]
        self._turned = rows[:moving], rows[n : n + moving], rows[len(rows) - moving :]
        self._used, self._displacement, self.error_m = rows[:used], rows[-3:], rows[-3]
        self._series = series_is_exact(plan.sigma_rad)

    def displace(self, position: int) -> None:
        """Turn the drawn normals into displacements at one position of the plan."""
        plan, rows = self._plan, self._rows
        turns(*self._turned, plan.sigma_rad, series=self._series)
        for product in plan.products:
            components = product.components[position]
            count = len(components)
            factors, into = self._work[:count], rows[product.into]
            np.matmul(components, rows[product.rows], factors)
            np.multiply(rows[product.joint], factors, into[:count])
            np.multiply(rows[plan.joints + product.joint], factors, into[count:])
        squares = self._displacement
        np.matmul(plan.matrix[position], self._used, squares)
        np.square(squares, squares)
        np.add(squares[0], squares[1], self.error_m)
        np.add(self.error_m, squares[2], self.error_m)
        np.sqrt(self.error_m, self.error_m)


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

    Sums are kept at increasing counts of cycles (C,), the last of which is all of them.
    """
    cycles = int(counts[-1])
    starts = np.arange(0, cycles, BLOCK_CYCLES)
    cuts = np.unique(np.concatenate([starts, counts]))
    sums = np.empty((2, len(streams), len(cuts) - 1))
    lengths = [min(BLOCK_CYCLES, cycles - start) for start in starts.tolist()]
    blocks = {length: DisplacementBlock(plan, length) for length in set(lengths)}
    work = []
    for start, length in zip(starts, lengths, strict=True):
        inside = cuts[(cuts >= start) & (cuts <= start + length)] - start
        work.append((blocks[length], list(itertools.pairwise(inside.tolist()))))
    progress(0, len(streams))
    for position, source in enumerate(streams):
        drawn = []
        for block, parts in work:
            source.standard_normal(out=block.normals)
            block.displace(position)
            for first, last in parts:
                error_m = block.error_m[first:last]
                drawn.append((error_m.sum(), error_m @ error_m))
        sums[:, position] = np.transpose(drawn)
        progress(position + 1, len(streams))
    error_m, squared_m2 = np.cumsum(sums, axis=2)[:, :, np.searchsorted(cuts[1:], counts)]
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


def counts_of(cycles: int, most: int = 20, first: int = 10) -> NDArray[np.int64]:
    """Return at most `most` counts of cycles, evenly spread by ratio, that end with all of them."""
    return np.unique(np.round(np.geomspace(min(first, cycles), cycles, most)).astype(np.int64))


def drawn_keys(sums: ErrorSums) -> dict[str, Any]:
    """Return what the record of a plane holds of the draws alone, in millimetres.

    The spread `std_mm` is that within a place, as the paper's.
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
    """Return mean and unbiased variance (P, C) of the first cycles at each place."""
    mean = sums.error_m / sums.cycles
    return mean, np.maximum(sums.squared_m2 - sums.error_m * mean, 0.0) / (sums.cycles - 1)


def expected_error(jacobian: Array, sigma_rad: float) -> tuple[Array, Array]:
    """Return mean and standard deviation (P,) of the position error under independent joint errors.

    By the velocity of the flange by each joint (P, 3, n) [m/rad].
    """
    squares = sigma_rad**2 * (jacobian @ jacobian.transpose(0, 2, 1))
    # Rounding leaves an eigenvalue that should vanish a little below zero.
    eigenvalues = np.maximum(np.linalg.eigvalsh(squares), 0.0)
    mean_m = _MEAN_OF_CHI_3 * elliprg(*eigenvalues.T)
    return mean_m, np.sqrt(np.maximum(eigenvalues.sum(axis=1) - mean_m**2, 0.0))


_ATTITUDE = (
    "flange axis straight down, turned about the base axis with the azimuth of its place; "
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
    """Draw resolver errors at places of one plane and set the closed form beside them.

    Raises:
        SettingsError: when the plane cannot be reached or the map is too fine.
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
    mean_m, variance = (each[:, -1] for each in moments(sums))
    per_place = [places.p_base_m, mean_m, np.sqrt(variance), expected_m]
    return PlaneRecord(
        campaign=campaign,
        robot=robot,
        plane_mm=plane_mm,
        reach_m=settings.reach_m,
        reach_is=_REACH,
        attitude=_ATTITUDE,
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
            rows=_mm_each(np.column_stack([on_map.p_base_m, on_map_m])),
        ),
        **drawn_keys(sums),
    )


def _mm(value_m: Any) -> float:
    return float(_mm_each(value_m))


def _mm_each(value_m: Any) -> Array:
    """Return metres as millimetres, rounded far below the resolution of the draws."""
    return np.round(1e3 * np.asarray(value_m), 9)
