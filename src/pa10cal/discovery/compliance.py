"""Joints that give way under weights that nobody stated: named, sized and held against rivals.

The calibration of an arm whose weights are assumed has a spring in each joint that its poses show
to give way. Here each is judged in the model as the search left it: what is left without it, what
else explains the poses as well in its place, and how stiff the joint is, relative to the weights
assumed. All is linear about the model, the weights among the unknowns.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import weights_known
from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery.finding import Finding, GivesWay
from pa10cal.discovery.linear import (
    by_terms,
    cluster_covariance,
    error_mm,
    of_weights,
    possible_sizes,
    residual_and_jacobian,
    rms,
    unknowns,
)
from pa10cal.discovery.noise import pose_weights
from pa10cal.discovery.preparation import computable, sought
from pa10cal.discovery.verdict import Verdict, is_named
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint import JointCompliance
from pa10cal.terms.effects.structure import BaseCompliance, LinkEffect
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.weights import Weights

V = TypeVar("V", bound=Verdict[Any])

#: A spring counts as none at this windup [rad].
_RIGID_RAD = 1e-9
#: No joint is named that gives way by less at its largest torque [rad].
_LEAST_RAD = 1e-6
#: Stretches of time whose poses may err alike, and the least poses in each.
_STRETCHES, _LEAST_STRETCH = 40, 4
#: A rival may be as large as is plausible, and some times larger.
_SIZES = 3.0
#: With more alternatives a name says nothing.
_MOST_ALTERNATIVES = 6


def with_compliance(found: V) -> V:
    """Return a verdict with the joints that give way under weights that nobody stated.

    Springs are those of the extended model. Where the weights are stated, they are part of the
    calibrated model and no finding.
    """
    known = weights_known(found.baseline.arm)
    if known.origin == "stated" or found.prepared.setup.payload is None:
        return found
    at = found.extended.at
    springs = [
        term
        for term in at.model.terms
        if isinstance(term, JointSpring) and at.x[at.model.columns_of(term).start] > _LEAST_RAD
    ]
    if not springs:
        return found
    rows = _LinearProblem.of(found)
    needed = float(np.log(max(found.candidates, len(springs)) / found.error_rate))
    every = rows.error(())
    shown = []
    for spring in springs:
        without = rows.error((spring,))
        gain = (without.squares - every.squares) / rows.alike(spring)
        nats = 0.5 * (gain - np.log(rows.readings))
        if nats >= needed:
            shown.append((nats, spring, without))
    shown.sort(key=lambda entry: -entry[0])
    together = tuple(spring for _, spring, _ in shown)
    rigid, instead = rows.error(together), _best_first(rows.instead_of(together, needed))
    findings = []
    for nats, spring, without in shown:
        others = tuple(dict.fromkeys((*instead, *_best_first(rows.rivals(spring, needed)))))
        if len(others) > _MOST_ALTERNATIVES:
            continue
        stiffness, std, sag_rad, sag_std = rows.stiffness(spring)
        proof = GivesWay(
            lost_without_it_nats=nats,
            needed_nats=needed,
            sag_mrad=1e3 * sag_rad,
            sag_u_mrad=1e3 * sag_std,
            rigid_mm=rms(without.fitted_mm),
            gives_way_mm=rms(every.fitted_mm),
            held_out_rigid_mm=None if without.held_out_mm is None else rms(without.held_out_mm),
            held_out_gives_way_mm=None if every.held_out_mm is None else rms(every.held_out_mm),
            all_rigid_mm=rms(rigid.judging_mm),
            without_each_mm=without.judging_mm,
            all_rigid_each_mm=rigid.judging_mm,
            weights="logged" if found.prepared.torques == "logged" else known.origin,
        )
        effect = JointCompliance(spring.of, spring.tau_ref_Nm)
        findings.append(Finding(effect, np.array([stiffness]), np.array([[std**2]]), others, proof))
    return replace(found, gives_way=tuple(findings))


def _best_first(found: Iterable[tuple[Effect, float]]) -> list[Effect]:
    """Return effects, each by the least squares that any of its shapes leaves."""
    least: dict[Effect, float] = {}
    for effect, squares in found:
        least[effect] = min(squares, least.get(effect, np.inf))
    return sorted(least, key=lambda effect: least[effect])


@dataclass(frozen=True)
class _Left:
    """What is left of the poses with all else fitted anew."""

    squares: float
    fitted_mm: Array  # (P,) errors of the poses fitted
    held_out_mm: Array | None  # (H,) those of the poses held out; None without any

    @property
    def judging_mm(self) -> Array:
        """Return the errors of the poses held out, or else of those fitted."""
        return self.fitted_mm if self.held_out_mm is None else self.held_out_mm


@dataclass(frozen=True, eq=False)
class _LinearProblem:
    """A model and its poses, as a linear problem."""

    at: FittedModel  # the extended model, its base's own term last
    poses: Observations  # those fitted
    held_out: Observations | None  # those held out that are trusted; None without any
    whitener: Array  # (P, b, b) of the poses fitted
    candidates: tuple[Effect, ...]  # effects that might stand in a spring's place

    @classmethod
    def of(cls, found: Verdict[Any]) -> _LinearProblem:
        at, poses = found.extended.at, found.train.poses
        left, jacobian = residual_and_jacobian(at, poses)
        weights = pose_weights(left, float(jacobian.shape[2]), poses.measured)
        held_out = found.trusted_holdout
        terms, logged = at.model.terms, found.prepared.torques == "logged"
        named = [e for e in sought(found.context, terms) if is_named(e) and e not in terms]
        candidates, _ = computable(named, poses.states, logged=logged, weights=True)
        others = None if held_out is None else held_out.poses
        return cls(at, poses, others, weights.whiteners(), tuple(candidates))

    @property
    def readings(self) -> int:
        """Return how many components were seen."""
        return int(self.poses.measured.components_seen.sum())

    @cached_property
    def sizes(self) -> Array:
        """Return the standard deviation thought possible of every unknown."""
        return possible_sizes(self.at.model, self.poses.measured)

    @cached_property
    def of_weights(self) -> Mask:
        """Return which unknowns are weights: these are expected about what is assumed."""
        targets = np.zeros(len(self.at.targets_m), dtype=bool)
        return np.concatenate([of_weights(self.at.model), targets])

    def without(self, springs: tuple[JointSpring, ...]) -> FittedModel:
        """Return the model with some joints rigid."""
        x = self.at.x.copy()
        for spring in springs:
            x[self.at.model.columns_of(spring).start] = _RIGID_RAD
        return replace(self.at, x=x)

    def error(self, rigid: tuple[JointSpring, ...]) -> _Left:
        """Return what is left with some joints rigid, all else fitted anew, to first order.

        Where a spring goes others take over by bounds: no point of the model, but what is left.
        """
        at = self.without(rigid)
        step, squares = self._system(at, rigid).solved()

        def errors_mm(poses: Observations) -> Array:
            left, jacobian = residual_and_jacobian(at, poses)
            return error_mm(poses.measured, left + jacobian @ (step * self.sizes))

        held_out_mm = None if self.held_out is None else errors_mm(self.held_out)
        return _Left(squares, errors_mm(self.poses), held_out_mm)

    def rivals(self, spring: JointSpring, needed: float) -> Iterator[tuple[Effect, float]]:
        """Yield effects beside which a spring is not needed any more, and the squares left."""
        rigid, alike = self.without((spring,)), self.alike(spring)
        without = self._system(rigid, (spring,))
        both = zip(self._columns(rigid), self._columns(self.at), strict=True)
        for (effect, at_rigid), (_, columns) in both:
            squares = without.squares_with(at_rigid)
            gain = (squares - self._as_it_is.squares_with(columns)) / alike
            if 0.5 * (gain - np.log(self.readings)) < needed:
                yield effect, squares

    def instead_of(
        self, springs: tuple[JointSpring, ...], needed: float
    ) -> Iterator[tuple[Effect, float]]:
        """Yield effects that explain the poses, each alone, as well as some springs together."""
        if len(springs) < 2:
            return
        rigid = self.without(springs)
        without, (_, squares) = self._system(rigid, springs), self._as_it_is.solved()
        for effect, columns in self._columns(rigid):
            with_it = without.squares_with(columns)
            # The shape of moments costs what it costs the springs.
            fewer = (len(springs) - effect.linear) * np.log(self.readings)
            if 0.5 * (with_it - squares - fewer) < needed:
                yield effect, with_it

    def _by_moments(self, at: FittedModel, shape: tuple[int, ...]) -> Array:
        """Return what uncertain weights move, (P, b, k), through links and base found to bend."""
        added = np.zeros(shape)
        bending = [t for t in at.model.terms if isinstance(t, LinkEffect | BaseCompliance)]
        if not bending:
            return added
        found = [at.x[at.model.columns_of(term)] for term in bending]
        arm, known = at.arm, weights_known(at.arm)
        assert arm.mass_kg is not None
        sizes = arm.mass_kg[:, None] * np.column_stack([known.mass, *[known.com_m] * 3])
        of_weight = []
        for poses, size in zip(self._moments, sizes.ravel(), strict=True):
            parts = by_terms(at, poses, bending, found)
            moved = [part @ x for part, x in zip(parts, found, strict=True)]
            of_weight.append(np.sum(moved, axis=0) / max(float(size), 1e-12))
        for term in at.model.terms:
            if not isinstance(term, Weights):
                continue
            first = at.model.columns_of(term).start
            for k, column in enumerate(term.columns):
                if column < len(of_weight):
                    added[:, :, first + k] = of_weight[column]
                if term.held is not None and term.held < len(of_weight):
                    added[:, :, first + k] += term.by_held[k] * of_weight[term.held]
        return added

    def _columns(self, at: FittedModel) -> Iterator[tuple[Effect, Array]]:
        """Yield every candidate at each of its shapes, with its whitened columns (N, l).

        What bends under moments does so under those of the weights, which are not known either.
        """
        effects = [effect for effect in self.candidates for _ in effect.starts]
        starts = [start for effect in self.candidates for start in effect.starts]
        columns = by_terms(at, self.poses, effects, starts)
        for effect, start, own in zip(effects, starts, columns, strict=True):
            parts = [own[:, :, : effect.linear]]
            if isinstance(effect, LinkEffect | BaseCompliance):
                parts += [by_terms(at, poses, [effect], [start])[0] for poses in self._moments]
            linear = np.concatenate([part @ (_SIZES * effect.prior_factor) for part in parts], 2)
            yield effect, (self.whitener @ linear).reshape(-1, linear.shape[2])

    @cached_property
    def _moments(self) -> list[Observations]:
        """Return the poses under the moments alone that each uncertain weight adds, at its size."""
        arm, payload, states = self.at.arm, self.at.payload, self.poses.states
        if payload is None or arm.mass_kg is None or arm.com_m is None:
            return []
        known, mass_kg, com_m = weights_known(arm), arm.mass_kg, arm.com_m
        rigid, nothing = Model(Chain.of(arm), ()), np.zeros(0)
        before = statics_of(rigid, nothing, states, payload).static_loads
        poses = []
        for link in range(arm.n):
            heavier = mass_kg.copy()
            heavier[link] *= 1.0 + known.mass[link]
            others = [replace(arm, mass_kg=heavier)]
            for axis in range(3):
                moved = com_m.copy()
                moved[link, axis] += known.com_m[link]
                others.append(replace(arm, com_m=moved))
            for other in others:
                after = statics_of(Model(Chain.of(other), ()), nothing, states, payload)
                loads = after.static_loads
                added = replace(
                    loads,
                    link_Nm=loads.link_Nm - before.link_Nm,
                    base_Nm=loads.base_Nm - before.base_Nm,
                )
                poses.append(self.poses.with_states(replace(states, static_loads=added)))
        return poses

    def alike(self, spring: JointSpring) -> float:
        """Return how much larger the variance of a spring is for poses that err alike.

        Poses that follow each other often stand nearly in the same place, and what the model lacks
        is the same in all of them: they count as one (the variance by stretches of time over that
        of independent poses, at least 1).
        """
        at = self.at.model.columns_of(spring).start
        independent, by_stretches = (float(cov[at, at]) for cov in self._covariances)
        return max(1.0, by_stretches / independent) if independent > 0.0 else 1.0

    @cached_property
    def _covariances(self) -> tuple[Array, Array]:
        """Return that of all unknowns if poses are independent, and by stretches of time."""
        count = len(self.poses)
        order = np.argsort(np.argsort(self.poses.states.time_s, kind="stable"))
        stretches = min(_STRETCHES, max(count // _LEAST_STRETCH, 2))
        stretch = np.repeat(order * stretches // count, self.whitener.shape[1])
        scale = np.outer(self.sizes, self.sizes)
        return self._as_it_is.inverse * scale, self._as_it_is.by_clusters(stretch) * scale

    def stiffness(self, spring: JointSpring) -> tuple[float, float, float, float]:
        """Return stiffness [N m/rad], its uncertainty, the largest sag [rad], its uncertainty.

        Poses show how far a joint sags. Its stiffness is what the torque of the assumed weights
        varies by, over what the sag does.
        """
        model, x = self.at.model, self.at.x
        joint, states = spring.joint - 1, self.poses.states
        at = model.columns_of(spring).start
        by_x = -model.torque_jacobian(states, x)[:, joint]
        by_x[:, ~self.of_weights[: len(x)]] = 0.0
        carried_Nm = model.with_joint_torques(states, x).tau_Nm[:, joint]
        off_Nm = carried_Nm - carried_Nm.mean()
        spread_Nm = float(np.std(carried_Nm))
        stiffness = spring.tau_ref_Nm / float(x[at]) * float(np.std(states.tau_Nm[:, joint]))
        stiffness /= spread_Nm
        slope = -stiffness * (off_Nm @ by_x) / (len(off_Nm) * spread_Nm**2)
        slope[at] = -stiffness / float(x[at])
        row = int(np.argmax(np.abs(carried_Nm)))
        sag = float(x[at]) * float(np.abs(carried_Nm[row])) / spring.tau_ref_Nm
        of_sag = float(x[at]) / spring.tau_ref_Nm * by_x[row] * np.sign(carried_Nm[row])
        of_sag[at] = sag / float(x[at])
        std, sag_std = (
            float(np.sqrt(max(by @ cov[: len(x), : len(x)] @ by for cov in self._covariances)))
            for by in (slope, of_sag)
        )
        return stiffness, std, sag, sag_std

    @cached_property
    def _as_it_is(self) -> _System:
        """Return the problem with all springs, which every one of them is held against."""
        return self._system(self.at, ())

    def _system(self, at: FittedModel, rigid: tuple[JointSpring, ...]) -> _System:
        left, jacobian = residual_and_jacobian(at, self.poses)
        jacobian = jacobian + self._by_moments(at, jacobian.shape)
        for term in at.model.terms:
            if isinstance(term, JointSpring):
                column = at.model.columns_of(term).start
                # A joint that is all but rigid cannot give way the other way round: it is held.
                if term in rigid or at.x[column] <= _LEAST_RAD:
                    jacobian[:, :, column] = 0.0
        white = (self.whitener @ jacobian).reshape(-1, jacobian.shape[2])
        data = (self.whitener @ left[:, :, None]).ravel()
        off = np.where(self.of_weights, unknowns(at) / self.sizes, 0.0)
        return _System(white * self.sizes, data, off)


@dataclass(frozen=True, eq=False)
class _System:
    """Whitened rows of a linear problem, unknowns in what is thought possible of them."""

    columns: Array  # (N, k) of the unknowns, zero for those that are held
    data: Array  # (N,) what is left
    off: Array  # (k,) how far they are from what is expected of them

    @cached_property
    def inverse(self) -> Array:
        """Return the covariance (k, k) in sizes."""
        normal = self.columns.T @ self.columns + np.eye(self.columns.shape[1])
        return np.asarray(np.linalg.inv(normal))

    @cached_property
    def gradient(self) -> Array:
        """Return half the gradient of the squares (k,)."""
        return np.asarray(self.columns.T @ self.data + self.off)

    def by_clusters(self, cluster: Index) -> Array:
        """Return the covariance (k, k) in sizes from how clusters of rows (N,) differ."""
        left = self.data - self.columns @ (self.inverse @ self.gradient)
        return cluster_covariance(self.inverse, self.columns * left[:, None], cluster)

    def solved(self) -> tuple[Array, float]:
        """Return the step (k,) in sizes that leaves least, and the squares left."""
        step = -self.inverse @ self.gradient
        return step, float(self.data @ self.data + self.off @ self.off + self.gradient @ step)

    def squares_with(self, further: Array) -> float:
        """Return the squares left with further columns (N, l) among the unknowns."""
        across = self.columns.T @ further
        taken = self.inverse @ across
        schur = further.T @ further + np.eye(further.shape[1]) - across.T @ taken
        gradient = further.T @ self.data - taken.T @ self.gradient
        _, before = self.solved()
        return float(before - gradient @ np.linalg.solve(schur, gradient))
