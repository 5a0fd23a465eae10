"""Spectral lines of gears whose ratio nobody stated: periodic errors of joints by their angle.

No map follows a hundred cycles a turn, and a search cannot try every order. So the periodogram of
the residual is computed first, joint by joint, at the unevenly spaced angles of the poses, with the
model's own parameters integrated out (Scargle, Astrophysical Journal 263, 1982). A line must be
significant among all orders tried; the search decides whether the effect is there.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from pa10cal.arrays import Array
from pa10cal.discovery import linear
from pa10cal.discovery.linear import WhitenedPoses
from pa10cal.discovery.rules import LINES, PROBABILITIES
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.joint import GearLine
from pa10cal.terms.effects.joint_error_map import is_error_map


def gear_lines(
    rows: WhitenedPoses, error_rate: float, known: Collection[str] = ()
) -> tuple[GearLine, ...]:
    """Return the line of each joint that has one, in the residual of a model or in its maps.

    None for a joint of which two orders fit equally well, as where its angles are whole steps, nor
    at twice a stated gear ratio, which has an effect of its own.

    Args:
        rows: the poses about the model.
        error_rate: probability allowed of finding a line where there is none.
        known: places of lines that the model has.
    """
    rows = rows.at_most(LINES.most_poses)
    at, poses, arm = rows.at, rows.poses, rows.at.arm
    joints = [
        joint
        for joint in (arm.coupling.own[~arm.axes_slide] + 1).tolist()
        if f"joint {joint}" not in known and _angles(poses, joint) >= LINES.least_angles
    ]
    if not joints:
        return ()
    terms, sizes, data = at.model.terms, possible_sizes(at.model), rows.data
    of_terms = linear.by_own_terms(at, poses, terms, rows.whitener)
    own = dict(zip(terms, of_terms, strict=True))
    found = _lines(rows, joints, [*own.values(), rows.by_targets], data, error_rate)
    maps = [term for term in own if is_error_map(term)]
    if found or not maps:
        return found
    for term in maps:  # a fine map may follow a line, which is then in the residual without maps
        amounts = at.values_of(term) / sizes[at.model.columns_of(term)]
        data = data + own.pop(term) @ amounts
    return _lines(rows, joints, [*own.values(), rows.by_targets], data, error_rate)


def _lines(
    rows: WhitenedPoses,
    joints: Sequence[int],
    own: Sequence[Array],
    data: Array,
    error_rate: float,
) -> tuple[GearLine, ...]:
    """Return the lines of joints in whitened data (P, b), beside own columns (P, b, k)."""
    columns = np.concatenate(own, axis=2)
    equations = Gaussian.of(columns, data)
    by_joint = rows.whitener @ linear.by_joints(rows.at, rows.poses, joints)
    q_rad = rows.poses.states.q_rad
    spectra = [
        _Spectrum.of(equations, columns, data, by_joint[:, :, k], q_rad[:, joint - 1])
        for k, joint in enumerate(joints)
    ]
    needed = float(np.log(sum(len(spectrum.orders) for spectrum in spectra) / error_rate))
    found = []
    for joint, spectrum in zip(joints, spectra, strict=True):
        order = spectrum.line(needed)
        stated = 2.0 * float(rows.at.model.chain.arm.gear_ratio[joint - 1])
        if order is not None and not abs(order - stated) < spectrum.width:  # nan if not stated
            found.append(GearLine(f"joint {joint}", round(order, LINES.order_decimals)))
    return tuple(found)


def _angles(poses: Observations, joint: int) -> int:
    """Return the number of different angles of a joint, counted from 1."""
    return len(np.unique(np.round(poses.states.q_rad[:, joint - 1], LINES.angle_decimals)))


@dataclass(frozen=True, eq=False)
class _Spectrum:
    """Periodogram of the residual by one joint's angle."""

    q_rad: Array  # (P,) the joint's angles
    own: Gaussian  # normal equations of the model's own parameters
    own_by_joint: Array  # (P, n) products of own columns with the joint's column, pose by pose
    squares: Array  # (P,) squares of the joint's column
    data_by_joint: Array  # (P,) products of the joint's column with the data
    rows: int  # number of components seen

    @classmethod
    def of(
        cls, equations: Gaussian, own: Array, data: Array, by_joint: Array, q_rad: Array
    ) -> _Spectrum:
        """Return that of whitened own columns (P, b, n), data (P, b), and joint's column (P, b)."""
        return cls(
            q_rad=q_rad,
            own=equations,
            own_by_joint=np.einsum("pbn,pb->pn", own, by_joint),
            squares=np.sum(by_joint**2, axis=1),
            data_by_joint=np.sum(by_joint * data, axis=1),
            rows=int(np.count_nonzero(data)),
        )

    @property
    def width(self) -> float:
        """Return the width of a line: one cycle over the range of the joint's angles."""
        return float(2.0 * np.pi / np.ptp(self.q_rad))

    @property
    def orders(self) -> Array:
        """Return the orders that are tried [cycles a turn]."""
        return np.arange(*LINES.orders, LINES.step_widths * self.width)

    def line(self, needed: float) -> float | None:
        """Return the order of the line that gains what is needed [nat]; None if none does."""
        orders = self.orders
        firsts = range(0, len(orders), LINES.at_once)
        gains = np.concatenate([self.gains(orders[k : k + LINES.at_once]) for k in firsts])
        best = int(np.argmax(gains))
        if gains[best] < needed:
            return None
        apart = np.abs(orders - orders[best]) > LINES.widths_apart * self.width
        if np.max(gains[apart], initial=-np.inf) > gains[best] - LINES.better_nats:
            return None
        step = LINES.step_widths * self.width
        finest = minimize_scalar(
            lambda order: -float(self.gains(np.array([order]))[0]),
            bounds=(orders[best] - step, orders[best] + step),
            method="bounded",
        )
        return float(finest.x)

    def gains(self, orders: Array) -> Array:
        """Return the gain of log evidence by a line of each of K orders, scatter profiled, (K,)."""
        phase = self.q_rad[:, None] * orders
        waves = LINES.size_rad * np.stack([np.sin(phase), np.cos(phase)], axis=-1)  # (P, K, 2)
        count = len(orders)
        followed = (self.own_by_joint.T @ waves.reshape(len(phase), -1)).reshape(-1, count, 2)
        gram = np.einsum("pki,p,pkj->kij", waves, self.squares, waves)
        projection = np.tensordot(self.data_by_joint, waves, axes=1)
        gains, _ = self.own.of_each_further(followed, gram, projection).gains(self.rows)
        return np.asarray(gains / PROBABILITIES.blocks)
