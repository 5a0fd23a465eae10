"""Whether base or instrument moved in the course of rows without times, as between two sessions.

Rows give an order also where times were not recorded, in which nothing is sought in time. Two
sessions that were put one after the other differ by a motion of the base between two rows. To the
search this may look like an error of a joint that moved over another range in either. So where an
error is left that has no name, a step of the base between two rows is compared with the same steps
in the order of each joint's angles, which errors of that joint would make as likely. A base that
moves slowly shows as one step beside another. Readings of the same poses at other rows tell more:
their differences hold nothing of the pose, so that the zero of a joint that moved is told, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.discovery import jacobians
from pa10cal.discovery.changed import load_change
from pa10cal.discovery.rules import CHANGE
from pa10cal.discovery.tuning import SESSIONS
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.rows_about_fit import less_far_off
from pa10cal.observe.observations import Observations, reading_groups
from pa10cal.observe.time_order import like_a_scan, measured_again, sorted_rows
from pa10cal.results.discovery import Unexplained
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.joint_spring import is_spring

#: The place of what is left unexplained: begins with it for two sessions, is it for more motion.
_FROM, _ORDER = "the rows from pose", "the order of the rows"


@dataclass(frozen=True)
class _Step:
    """A motion of the base between two poses of an order."""

    first: int  # number in the order of the first pose after it
    gain: float  # of log evidence [nat]


def moved_in_order(at: FittedModel, poses: Observations) -> Unexplained | None:
    """Return that rows disagree with those before a pose, as if the base had moved; None if not.

    Where a second motion shows beside the first one, the base moved slowly, or several times. None
    where times were recorded, in a group, or where most joints move slowly from row to row.

    Args:
        at: the model with the effects found.
        poses: P averaged and complete poses, to which it was fitted.
    """
    states = poses.states
    if states.tells_time or states.campaign is not None or like_a_scan(poses):
        return None
    in_order = np.argsort(states.time_s, kind="stable")
    joints = [np.argsort(angles, kind="stable") for angles in states.q_rad.T]

    def shown(steps: StepsOfBase) -> _Step | None:
        """Return the best step in the order of the rows, if it gains more than any of a joint's."""
        best, by_joints = steps.best(in_order), max(steps.best(order).gain for order in joints)
        return best if best.gain >= SESSIONS.least_nats + max(by_joints, 0.0) else None

    def pair(steps: StepsOfBase) -> tuple[_Step | None, _Step | None]:
        """Return the best step, and the best one beside it."""
        step = shown(steps)
        return step, None if step is None else shown(steps.beside(in_order[step.first :]))

    step, again = pair(StepsOfBase.of(at, poses))
    by_base = sum(each.gain for each in (step, again) if each)
    if (by_load := _by_load(at, poses)) is not None:
        on, off = pair(StepsOfBase.of(at, poses, by_load))
        if on and on.gain + (off.gain if off else 0.0) > by_base:
            return _unexplained(
                _ORDER,
                f"the arm carries another load than is stated, {_from(poses, in_order, on, off)}, "
                "which explains more than a base or an instrument that moved; state it as load_N "
                "in its rows",
            )
    if step is None:
        return None
    if again is None:
        return _unexplained(
            f"{_FROM} {poses.pose[in_order[step.first]]} on",
            "these disagree with the rows before, as if the base or the instrument had stood "
            "elsewhere; two sessions? join them as a group, each a campaign of its own",
        )
    return _unexplained(
        _ORDER,
        "the base or the instrument moved in the course of the rows, "
        f"{_from(poses, in_order, step, again)}; give the time of each reading, in an order that "
        "no joint and no load follows, and its motion is sought; of several sessions make a group",
    )


def _from(poses: Observations, in_order: Index, *steps: _Step | None) -> str:
    """Return from which poses on something changed, in words."""
    at = [f"from pose {poses.pose[in_order[each.first]]} on" for each in steps if each]
    return f"among others {' and '.join(at)}"


def _by_load(at: FittedModel, poses: Observations) -> Array | None:
    """Return the derivative (P, b, 4) by a load that is not stated; None where none would show."""
    if poses.states.static_loads is None or not any(is_spring(each) for each in at.model.terms):
        return None
    load = load_change(at)
    return jacobians.by_scaled_effects(at, poses, [load], [np.zeros(load.linear)])[0]


def changed_between_repeats(at: FittedModel, readings: Observations) -> Unexplained | None:
    """Return that readings of the same poses differ by how late they come in the rows, or None.

    As if the zero of a joint, or the base, had moved: at once, steadily, or settling. Differences
    of repeats hold nothing that goes with the pose; lost motion is taken out of them.

    Args:
        at: the model with the effects found.
        readings: P complete single readings; their times, or the order of their rows, count.
    """
    states = readings.states
    span_s = float(np.ptp(states.time_s)) if len(readings) else 0.0
    if not span_s or states.campaign is not None or not measured_again(readings):
        return None
    if not states.tells_time and sorted_rows(states) is not None:
        return None  # a table, whose order is not that of the measurement
    repeats = _Repeats.of(at, readings)
    places: dict[str, Array] = {
        f"the zero of joint {joint}": jacobians.by_joints(at, readings, (joint,))
        for joint in range(1, at.arm.n + 1)
    }
    places["the base or the instrument"] = jacobians.by_base(at, readings)
    part: Array = (states.time_s - states.time_s.min()) / span_s
    courses: list[Array] = [part, *(np.exp(-part / of_span) for of_span in CHANGE.settling)]
    courses += [np.where(part > at_part, 1.0, 0.0) for at_part in SESSIONS.parts]
    gains = {
        place: max(repeats.gain(columns * course[:, None, None]) for course in courses)
        for place, columns in places.items()
    }
    most = max(gains.values())
    if most < float(np.log(len(places) * len(courses) / CHANGE.false_rate)):
        return None
    likely = [place for place, gain in gains.items() if gain > most - CHANGE.as_good_nats]
    what_to_do = "measure more poses" if states.tells_time else "give the time of each reading"
    return _unexplained(
        _ORDER,
        "readings of the same poses differ by how late they come in the rows, as if "
        f"{' or '.join(likely)} had moved meanwhile, as of an arm that warms up or a motor that "
        f"loses steps; {what_to_do}, and such motion is sought",
    )


@dataclass(frozen=True, eq=False)
class _Repeats:
    """Differences of successive readings of the same pose and load, less lost motion."""

    first: Index  # (D,) numbers of the earlier readings
    second: Index  # (D,) and of the later ones
    weight: Array  # (D, b) one over the stated uncertainty of their differences; 0 where not seen
    by_arrival: Array  # (D b, m) orthonormal columns of what goes with the directions of arrival
    difference: Array  # (D b,) of the residuals, weighted, without that

    @classmethod
    def of(cls, at: FittedModel, readings: Observations) -> _Repeats:
        group = reading_groups(readings)
        order = np.lexsort((readings.states.time_s, group))
        again = np.flatnonzero(np.diff(group[order]) == 0)
        first, second = order[again], order[again + 1]
        measured = readings.measured
        variance = np.diagonal(measured.stated_covariance, axis1=1, axis2=2)
        both = measured.components_seen[first] & measured.components_seen[second]
        weight = np.where(both, 1.0 / np.sqrt(variance[first] + variance[second]), 0.0)
        joints = range(1, at.arm.n + 1)
        lost = jacobians.by_joints(at, readings, joints) * readings.states.arrival[:, None, :]
        flat = ((lost[second] - lost[first]) * weight[:, :, None]).reshape(weight.size, -1)
        left, sizes, _ = np.linalg.svd(flat, full_matrices=False)
        span = left[:, sizes > SESSIONS.least_singular * max(float(sizes.max()), 1.0)]
        residual = at.compared(readings).residual
        difference = ((residual[second] - residual[first]) * weight).ravel()
        return cls(first, second, weight, span, difference - span @ (span.T @ difference))

    def gain(self, columns: Array) -> float:
        """Return the gain of log evidence by columns (P, b, k), by Schwarz's criterion."""
        of_pairs = (columns[self.second] - columns[self.first]) * self.weight[:, :, None]
        flat = of_pairs.reshape(self.weight.size, -1)
        flat = flat - self.by_arrival @ (self.by_arrival.T @ flat)
        amounts = np.linalg.lstsq(flat, self.difference)[0]
        rest = self.difference - flat @ amounts
        tiny, readings = np.finfo(float).tiny, int(np.count_nonzero(self.weight))
        ratio = max(float(self.difference @ self.difference), tiny) / max(float(rest @ rest), tiny)
        unknowns = flat.shape[1] + 1  # one more is the course
        return 0.5 * (readings * float(np.log(ratio)) - unknowns * float(np.log(max(readings, 1))))


def _unexplained(of: str, why: str) -> Unexplained:
    return Unexplained(of=of, form=None, shared_error_mm=None, why=why)


def is_moved_in_order(part: Unexplained) -> bool:
    """Return whether an unexplained part is that the base moved in the order of the rows."""
    return part.of is not None and part.of.startswith((_FROM, _ORDER))


@dataclass(frozen=True, eq=False)
class StepsOfBase:
    """Steps of the base, or of a load, beside what a model fits, about what it leaves.

    Maps stay as they are. The base has m = 6 motions; a load at the flange mass and moments, 4.

    Sums over poses, so that those over the poses after each row come one from the other.
    """

    gram: Array  # (P, m, m) products of the whitened columns of what may step
    across: Array  # (P, k, m) their products with orthonormal columns of the model's own unknowns
    projection: Array  # (P, m) their products with the residual that these leave
    squares: float  # of that residual
    readings: int  # components in it

    @classmethod
    def of(cls, at: FittedModel, poses: Observations, by_step: Array | None = None) -> StepsOfBase:
        """Return them at poses, each component over its stated uncertainty.

        Args:
            by_step: (P, b, m) derivative by what may step; by default by motions of the base.
        """
        compared = at.compared(poses)
        root = np.sqrt(np.diagonal(poses.measured.stated_covariance, axis1=1, axis2=2))
        weight = less_far_off(poses.measured, compared.residual / root)[:, None] / root
        by_step = jacobians.by_base(at, poses) if by_step is None else by_step
        by_step = by_step * weight[:, :, None]
        fitted = [term for term in at.model.terms if not is_error_map(term)]
        own = jacobians.by_scaled_terms(at, poses, fitted)
        columns = np.concatenate([*own, compared.by_targets], axis=2) * weight[:, :, None]
        flat = np.concatenate([columns, by_step], axis=2).reshape(weight.size, -1)
        size = np.linalg.norm(flat, axis=0)
        left, sizes, _ = np.linalg.svd(flat / np.where(size > 0.0, size, 1.0), full_matrices=False)
        span = left[:, sizes > SESSIONS.least_singular * sizes[0]]
        data = (compared.residual * weight).ravel()
        rest = data - span @ (span.T @ data)
        return cls(
            gram=np.einsum("pbi,pbj->pij", by_step, by_step),
            across=np.einsum("pbk,pbi->pki", span.reshape(*weight.shape, -1), by_step),
            projection=np.einsum("pbi,pb->pi", by_step, rest.reshape(weight.shape)),
            squares=float(rest @ rest),
            readings=int(np.count_nonzero(rest)),
        )

    def best(self, order: Index) -> _Step:
        """Return the step that gains most between two poses of an order (P,)."""
        least = SESSIONS.least_poses
        gains = self._gains(order)[least : len(order) - least + 1]
        if not len(gains):
            return _Step(0, -np.inf)
        return _Step(least + int(np.argmax(gains)), float(np.max(gains)))

    def beside(self, moved: Index) -> StepsOfBase:
        """Return the steps beside one from which on some poses stand, as part of the model."""
        by_moved = self.across[moved].sum(axis=0)  # (k, 6)
        columns = -np.swapaxes(self.across, 1, 2) @ by_moved  # (P, 6, 6) by base and moved base
        columns[moved] += self.gram[moved]
        size = np.sqrt(np.diagonal(self.gram[moved].sum(axis=0)))
        values, vectors = np.linalg.eigh(columns[moved].sum(axis=0) / (size[:, None] * size))
        kept = values > SESSIONS.least_share
        unit = vectors[:, kept] / (size[:, None] * np.sqrt(values[kept]))  # of moved base
        amounts = unit.T @ self.projection[moved].sum(axis=0)
        along = columns @ unit  # (P, 6, m)
        return replace(
            self,
            across=np.concatenate([self.across, np.swapaxes(along, 1, 2)], axis=1),
            projection=self.projection - along @ amounts,
            squares=self.squares - float(amounts @ amounts),
        )

    def _gains(self, order: Index) -> Array:
        """Return the gains of log evidence (P,) by another base from each pose of an order on.

        By Schwarz's criterion.
        """
        gram, across, projection = (
            np.cumsum(each[order[::-1]], axis=0)[::-1]
            for each in (self.gram, self.across, self.projection)
        )
        tiny = np.finfo(float).tiny
        size = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), tiny))
        unit = across / size[:, None, :]
        beside = gram / (size[:, :, None] * size[:, None, :]) - np.swapaxes(unit, 1, 2) @ unit
        values, vectors = np.linalg.eigh(beside)
        shown = values > SESSIONS.least_share
        along = np.einsum("pij,pi->pj", vectors, projection / size)
        explained = np.sum(along**2 / np.where(shown, values, np.inf), axis=1)
        then = np.maximum(self.squares - explained, tiny)
        # One more unknown is the place of the step.
        unknowns = 0.5 * (projection.shape[1] + 1) * np.log(max(self.readings, 1))
        return np.asarray(0.5 * self.readings * np.log(max(self.squares, tiny) / then) - unknowns)
