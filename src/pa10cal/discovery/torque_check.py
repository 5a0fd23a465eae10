"""Loads and tool that the log states wrongly, by logged torques alone.

Where effects are judged by blocks, torques are no rows of the search: the springs take them from
the log, and a wrong load leaves no pose off. It stands in the torques, all the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.discovery.finding import DiagnosedFault, fault_of
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of
from pa10cal.fit.uncertain_weights import weight_sizes
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import CandidateContext
from pa10cal.terms.weights import WeightStated, fault_candidates

#: Gain in evidence that a fault needs: odds of 1000 to 1 ...
_LEAST_NATS = 6.9
#: ... and sum of squares, in those of the noise, that it must take away of either half alone.
_OF_A_HALF = 4.0
#: Part of its plausible size that it must have.
_LEAST_SIZE = 0.3
#: Scale of a joint's torque, and what friction holds of its rated torque, that may be.
_GAIN, _FRICTION, _ZERO = 0.05, 0.03, 0.01
_REWEIGHTED = 5
_MEDIAN_TO_SIGMA = 1.4826
_EDGE = 4.0


def stated_wrongly(
    poses: Observations, baseline: FittedModel, setup: MeasurementSetup, context: CandidateContext
) -> tuple[DiagnosedFault, ...]:
    """Return loads and tool that are stated wrongly, by logged torques."""
    faults = [each for each in fault_candidates(context) if isinstance(each, WeightStated)]
    if not faults or setup.payload is None or context.torques != "logged":
        return ()
    rows = _rows(poses, baseline, setup, faults)
    chosen: list[int] = []
    while left := [k for k in range(len(faults)) if k not in chosen]:
        best = max(left, key=lambda k: rows.gain(chosen, k))
        if not rows.needs(chosen, best):
            break
        chosen.append(best)
    found = []
    for k in chosen:
        x, covariance, gain = rows.amounts(chosen, k)
        sizes = np.diag(faults[k].prior_factor)
        if np.abs(x).max() > _LEAST_SIZE:
            found.append(fault_of(faults[k], x * sizes, covariance * np.outer(sizes, sizes), gain))
    return tuple(found)


#: Of the products below: those of both halves of the readings together.
_BOTH = 2


@dataclass(frozen=True)
class _TorqueProducts:
    """Products of weighed rows of the torques: of two halves of the readings, and of both."""

    normal: Array  # (3, k, k) of the columns
    with_data: Array  # (3, k) of the columns with the data
    squares: Array  # (3,) of the data
    known: int  # how many columns any log may need; those of the faults follow
    of_faults: tuple[Index, ...]  # columns of each fault

    def gain(self, chosen: Sequence[int], fault: int, part: int = _BOTH) -> float:
        """Return the squares that a further fault takes away."""
        return self._left(chosen, part) - self._left([*chosen, fault], part)

    def needs(self, chosen: Sequence[int], fault: int) -> bool:
        """Return whether a further fault is there."""
        lesser = min(self.gain(chosen, fault, half) for half in range(_BOTH))
        _, covariance, _ = self.amounts([*chosen, fault], fault)
        nats = 0.5 * (self.gain(chosen, fault) + np.linalg.slogdet(covariance)[1])
        return bool(nats > _LEAST_NATS and lesser > _OF_A_HALF)

    def amounts(self, chosen: Sequence[int], fault: int) -> tuple[Array, Array, float]:
        """Return amounts of one of the chosen, in its sizes, their covariance, and its gain."""
        at, covariance, x = self._solved(chosen, _BOTH)
        own = np.flatnonzero(np.isin(at, self.of_faults[fault]))
        without = self._left([other for other in chosen if other != fault], _BOTH)
        gain = (without - self._left(chosen, _BOTH)) / without
        return x[own], covariance[np.ix_(own, own)], gain

    def _solved(self, chosen: Sequence[int], part: int) -> tuple[Index, Array, Array]:
        at = np.concatenate([np.arange(self.known), *(self.of_faults[k] for k in chosen)])
        covariance = np.linalg.inv(self.normal[part][np.ix_(at, at)] + np.eye(len(at)))
        return at, covariance, covariance @ self.with_data[part][at]

    def _left(self, chosen: Sequence[int], part: int) -> float:
        at, _, x = self._solved(chosen, part)
        return float(self.squares[part] - self.with_data[part][at] @ x)


def _rows(
    poses: Observations,
    baseline: FittedModel,
    setup: MeasurementSetup,
    faults: Sequence[WeightStated],
) -> _TorqueProducts:
    """Weigh the rows: logged torques less those of the weights, by the scatter that is left."""
    assert setup.payload is not None
    states, arm = poses.states, baseline.arm
    weights = statics_of(baseline.model, baseline.x, states, setup.payload)
    left_Nm = states.tau_Nm - weights.torque_Nm
    rated_Nm, each = arm.rated_Nm(np.abs(weights.torque_Nm).max(axis=0)), np.eye(arm.n)
    known = np.concatenate(
        [
            weights.static_loads.by_weights * weight_sizes(arm, setup.payload).columns(arm),
            _GAIN * weights.torque_Nm[:, :, None] * each,
            _FRICTION * (rated_Nm * states.arrival)[:, :, None] * each,
            np.broadcast_to(_ZERO * rated_Nm[:, None] * each, (len(poses), arm.n, arm.n)),
        ],
        axis=2,
    )
    of_faults = [fault.per_unit(states) @ fault.prior_factor for fault in faults]
    columns = np.concatenate([known, *of_faults], axis=2)
    count = columns.shape[2]
    noise_Nm = _spread(left_Nm - np.median(left_Nm, axis=0))
    for _ in range(_REWEIGHTED):
        white = (columns / noise_Nm[:, None]).reshape(-1, count)
        normal = white.T @ white + np.eye(count)
        x = np.linalg.solve(normal, white.T @ (left_Nm / noise_Nm).ravel())
        noise_Nm = _spread(left_Nm - columns @ x)
    # A reading with a gross error weighs no more than one at the edge of the noise.
    data = np.clip(left_Nm - columns @ x, -_EDGE * noise_Nm, _EDGE * noise_Nm) + columns @ x
    white, data = columns / noise_Nm[:, None], data / noise_Nm
    # Loads and poses come in turn: a half by lot has its part of each.
    drawn = np.random.default_rng(0).permutation(len(poses))
    halves = [drawn[::2], drawn[1::2]]
    rows = [(white[half].reshape(-1, count), data[half].ravel()) for half in halves]
    products = ([own.T @ own, own.T @ off, off @ off] for own, off in rows)
    normal, with_data, squares = (np.stack([a, b, a + b]) for a, b in zip(*products, strict=True))
    first = known.shape[2]
    stops = first + np.cumsum([0, *(own.shape[2] for own in of_faults)])
    columns_of = tuple(np.arange(*ends) for ends in pairwise(stops.tolist()))
    return _TorqueProducts(normal, with_data, squares, first, columns_of)


def _spread(left_Nm: Array) -> Array:
    """Return the scatter (n,) of each joint, from its median."""
    spread = _MEDIAN_TO_SIGMA * np.median(np.abs(left_Nm), axis=0)
    return np.asarray(np.maximum(spread, 1e-3 * spread.max() + 1e-9))
