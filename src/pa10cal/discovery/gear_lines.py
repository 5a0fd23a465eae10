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

from pa10cal.arrays import Array, drawn
from pa10cal.discovery import linear
from pa10cal.discovery.rules import LINES, PROBABILITIES
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.joint import GearLine
from pa10cal.terms.effects.joint_error_map import is_error_map


def gear_lines(
    at: FittedModel,
    poses: Observations,
    left: Array,
    whiten: Array,
    error_rate: float,
    known: Collection[str] = (),
) -> tuple[GearLine, ...]:
    """Return the line of each joint that has one, in the residual of a model or in its maps.

    None for a joint where two orders do equally well, as if its angles are whole steps, nor at
    twice a stated gear ratio, which has an effect of its own.

    Args:
        at: the model, fitted to the poses.
        poses: P complete poses.
        left: (P, b) its residual, predicted less measured.
        whiten: (P, b, b) that makes their components white.
        error_rate: the probability allowed of finding a line where there is none.
        known: places of lines that the model has.
    """
    if len(poses) > LINES.most_poses:
        rows = drawn(len(poses), LINES.most_poses)
        poses, left, whiten = poses.take(rows), left[rows], whiten[rows]
    arm = at.model.chain.arm
    joints = [
        joint
        for joint in (np.flatnonzero(~arm.prismatic) + 1).tolist()
        if f"joint {joint}" not in known and _angles(poses, joint) >= LINES.least_angles
    ]
    if not joints:
        return ()
    terms, sizes = at.model.terms, possible_sizes(at.model)
    columns = dict(zip(terms, linear.by_own_terms(at, poses, terms, whiten), strict=True))
    data = -(whiten @ left[:, :, None])[:, :, 0]
    by_joint = whiten @ linear.by_joints(at, poses, joints)
    of_targets = whiten @ linear.by_targets(at, poses)
    found = _lines(at, poses, joints, [*columns.values(), of_targets], data, by_joint, error_rate)
    maps = [term for term in columns if is_error_map(term)]
    if found or not maps:
        return found
    for term in maps:  # a fine map may follow a line: seek it in the residual without maps
        sized = at.values_of(term) / sizes[at.model.columns_of(term)]
        data = data + columns.pop(term) @ sized
    return _lines(at, poses, joints, [*columns.values(), of_targets], data, by_joint, error_rate)


def _lines(
    at: FittedModel,
    poses: Observations,
    joints: Sequence[int],
    own: Sequence[Array],
    data: Array,
    by_joint: Array,
    error_rate: float,
) -> tuple[GearLine, ...]:
    """Return the lines of joints, by whitened columns and data as `_Spectrum.of` has them."""
    columns = np.concatenate(own, axis=2)
    equations = Gaussian.of(columns, data)
    spectra = [
        _Spectrum.of(equations, columns, data, by_joint[:, :, k], poses.states.q_rad[:, joint - 1])
        for k, joint in enumerate(joints)
    ]
    needed = float(np.log(sum(len(spectrum.orders) for spectrum in spectra) / error_rate))
    found = []
    for joint, spectrum in zip(joints, spectra, strict=True):
        order = spectrum.line(needed)
        stated = 2.0 * float(at.model.chain.arm.gear_ratio[joint - 1])
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
    follows: Array  # (P, n) products of own columns with the joint's column, pose by pose
    moves: Array  # (P,) squares of the joint's column
    left: Array  # (P,) products of the joint's column with the data
    rows: int  # number of components seen

    @classmethod
    def of(
        cls, equations: Gaussian, own: Array, data: Array, by_joint: Array, q_rad: Array
    ) -> _Spectrum:
        """Return that of whitened own columns (P, b, n), data (P, b), and joint's column (P, b)."""
        return cls(
            q_rad=q_rad,
            own=equations,
            follows=np.einsum("pbn,pb->pn", own, by_joint),
            moves=np.sum(by_joint**2, axis=1),
            left=np.sum(by_joint * data, axis=1),
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
        followed = (self.follows.T @ waves.reshape(len(phase), -1)).reshape(-1, count, 2)
        gram = np.einsum("pki,p,pkj->kij", waves, self.moves, waves)
        projection = np.tensordot(self.left, waves, axes=1)
        gains, _ = self.own.of_each_further(followed, gram, projection).gains(self.rows)
        return np.asarray(gains / PROBABILITIES.blocks)
