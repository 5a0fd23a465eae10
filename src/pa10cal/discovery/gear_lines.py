"""Lines of gears whose ratio nobody stated: how many cycles a turn an error of a joint has.

No map follows a hundred cycles a turn, and a search cannot try every number. So the spectrum of
what a model leaves is looked at first, joint by joint: at angles as poses have them, what the
model's own parameters take up aside (Scargle, Astrophysical Journal 263, 1982, with parameters
integrated out). A line has to stand out of all numbers that were tried; what is made of it is the
search's affair.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
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
    """Return a line of each joint of which what a model leaves has one, or what its maps stand for.

    None of a joint of which two numbers of cycles do equally well, as where its angles are whole
    steps, nor at what a stated gear ratio gives.

    Args:
        at: the model, fitted to the poses.
        poses: P complete poses.
        left: (P, b) what it leaves of them, predicted less measured.
        whiten: (P, b, b) by which their components are white.
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
    for _ in range(2):
        own = np.concatenate([*columns.values(), of_targets], axis=2)
        said = Gaussian.of(own, data)
        spectra = [
            _Spectrum.of(said, own, data, by_joint[:, :, k], poses.states.q_rad[:, joint - 1])
            for k, joint in enumerate(joints)
        ]
        needed = float(np.log(sum(len(each.orders) for each in spectra) / error_rate))
        found = []
        for joint, spectrum in zip(joints, spectra, strict=True):
            order = spectrum.line(needed)
            stated = 2.0 * float(arm.gear_ratio[joint - 1])
            if order is not None and not abs(order - stated) < spectrum.width:
                found.append(GearLine(f"joint {joint}", round(order, 3)))
        maps = [term for term in columns if is_error_map(term)]
        if found or not maps:
            break
        for term in maps:  # a fine one follows a line, too
            data = data + columns.pop(term) @ (
                at.values_of(term) / sizes[at.model.columns_of(term)]
            )
    return tuple(found)


def _angles(poses: Observations, joint: int) -> int:
    """Return at how many different angles of a joint, from 1, poses are."""
    return len(np.unique(np.round(poses.states.q_rad[:, joint - 1], 4)))


@dataclass(frozen=True, eq=False)
class _Spectrum:
    """What is left of a model, by waves of one joint's angle."""

    q_rad: Array  # (P,) the joint's angles
    own: Gaussian  # what the rows say of the model's own parameters
    follows: Array  # (P, n) products of each pose's own columns with what the joint moves
    moves: Array  # (P,) squares of what the joint moves
    left: Array  # (P,) products of that with what is left
    rows: int  # rows that were seen

    @classmethod
    def of(
        cls, said: Gaussian, own: Array, data: Array, by_joint: Array, q_rad: Array
    ) -> _Spectrum:
        """Return that of columns (P, b, n), data (P, b) and what a joint moves (P, b)."""
        return cls(
            q_rad=q_rad,
            own=said,
            follows=np.einsum("pbn,pb->pn", own, by_joint),
            moves=np.sum(by_joint**2, axis=1),
            left=np.sum(by_joint * data, axis=1),
            rows=int(np.count_nonzero(data)),
        )

    @property
    def width(self) -> float:
        """Return the width of a line: two of them are told apart at one cycle in all angles."""
        return float(2.0 * np.pi / np.ptp(self.q_rad))

    @property
    def orders(self) -> Array:
        """Return the cycles a turn that are tried."""
        return np.arange(*LINES.orders, 0.5 * self.width)

    def line(self, needed: float) -> float | None:
        """Return the cycles of the line that stands out by so many nats; None where none does."""
        orders = self.orders
        gains = np.concatenate([self.gains(some) for some in _parts(orders)])
        best = int(np.argmax(gains))
        if gains[best] < needed:
            return None
        apart = np.abs(orders - orders[best]) > LINES.widths_apart * self.width
        if np.max(gains[apart], initial=-np.inf) > gains[best] - LINES.better_nats:
            return None
        finest = minimize_scalar(
            lambda order: -float(self.gains(np.array([order]))[0]),
            bounds=(orders[best] - 0.5 * self.width, orders[best] + 0.5 * self.width),
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


def _parts(orders: Array) -> Iterator[Array]:
    """Yield orders, as many at once as are computed together."""
    for first in range(0, len(orders), LINES.at_once):
        yield orders[first : first + LINES.at_once]
