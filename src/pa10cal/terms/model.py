"""A model: a chain plus terms; its poses, torques and reported parameters with derivatives."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from pa10cal.arm.chain import Chain, EndPose, end_pose, end_pose_and_screws
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask
from pa10cal.terms.term import (
    Report,
    Role,
    Term,
    TermParameter,
    Yielding,
    identity,
    shows_torque,
    yields,
)
from pa10cal.terms.weights import Weights, holds_weights


@dataclass(frozen=True, eq=False)
class PoseJacobian:
    """Predicted poses and their derivative by the parameters of a model."""

    T_base_ee: Array  # (P, 4, 4) predicted poses [m]
    derivative: Callable[[], Array]  # gives the derivative

    @cached_property
    def jacobian(self) -> Array:
        """(P, 6, k) velocity of the end over its angular velocity, along base axes.

        It is computed on first use: a step of a fit that is rejected needs none.
        """
        return self.derivative()


@dataclass(frozen=True)
class Model:
    """Predicts the pose of the end-effector from the state of the arm."""

    chain: Chain  # the nominal chain
    terms: tuple[Term, ...]  # what moves it off nominal
    # cache of derivatives for many fits of the same terms in the same poses; None for none
    derivative_cache: DerivativeCache | None = field(default=None, compare=False, repr=False)

    @cached_property
    def parameters(self) -> tuple[TermParameter, ...]:
        """Return the parameters of all terms, in order."""
        return tuple(parameter for term in self.terms for parameter in term.parameters)

    @cached_property
    def roles(self) -> tuple[Role, ...]:
        """Return what each parameter is an unknown of, in order."""
        return tuple(role for term in self.terms for role in term.roles)

    def having(self, *roles: Role) -> Mask:
        """Return which parameters (k,) have one of these roles."""
        return np.array([role in roles for role in self.roles], dtype=bool)

    @property
    def departures(self) -> dict[str, str]:
        """Return the chain coordinate that each constant parameter is added to, by its name."""
        return {
            parameter.name: coordinate
            for term in self.terms
            if term.constant and term.holds == "everywhere"
            for parameter, coordinate in zip(term.parameters, term.coordinates, strict=True)
        }

    @property
    def joint_zeros(self) -> dict[str, int]:
        """Return the joint, from 1, whose zero a departure is, by the name of the departure.

        A joint that turns has its zero in theta, one that slides in d. Other departures are left
        out.
        """
        driven_by = {
            column: joint for joint, column in enumerate(self.chain.joint_columns.tolist(), start=1)
        }
        column_of = {
            name: self.chain.columns((coordinate,))[0]
            for name, coordinate in self.departures.items()
        }
        return {
            name: driven_by[column] for name, column in column_of.items() if column in driven_by
        }

    def only(self, names: Collection[str]) -> Model:
        """Return the model with the parameters that are named, see `Term.only`."""
        return replace(self, terms=tuple(term.only(names) for term in self.terms))

    def without(self, *roles: Role) -> Model:
        """Return the model without the parameters that have one of these roles."""
        every = zip(self.parameters, self.roles, strict=True)
        return self.only({parameter.name for parameter, role in every if role not in roles})

    def terms_of(self, *roles: Role) -> tuple[Term, ...]:
        """Return the terms with a parameter that has one of these roles."""
        return tuple(term for term in self.terms if not set(roles).isdisjoint(term.roles))

    @property
    def scale(self) -> Array:
        """Return the typical size of each parameter, (k,)."""
        return np.array([parameter.scale for parameter in self.parameters])

    def predict(self, states: PoseStates, x: Array) -> Array:
        """Return T_base_ee (P, 4, 4) for parameters x (k,)."""
        return end_pose(self.chain, self.chain_coordinates(states, x))

    def distortion_m(self, states: PoseStates, x: Array) -> Array:
        """Return by what terms distort the pattern of the targets as it is read, (P, t) or (1,)."""
        distortion = np.zeros(1)
        for term, columns in self._slices:
            of_term = term.distortion_m(states, x[columns])
            if of_term is not None:
                distortion = distortion + of_term
        return distortion

    def distortions(self, states: PoseStates, x: Array) -> Iterator[tuple[slice, Array]]:
        """Yield the columns of each term that distorts that pattern, with the derivative by them.

        Each (P, t, k').
        """
        for term, columns in self._slices:
            derivative = term.targets_derivative(states, x[columns])
            if derivative is not None:
                yield columns, derivative

    def predict_with_jacobian(self, states: PoseStates, x: Array) -> PoseJacobian:
        """Return predicted poses and their exact derivative by x."""
        T, screws = end_pose_and_screws(self.chain, self.chain_coordinates(states, x))
        return PoseJacobian(
            T,
            lambda: self.jacobian_at(states, x, EndPose(T, screws(self._own_columns))),
        )

    def jacobian_at(self, states: PoseStates, x: Array, end: EndPose) -> Array:
        """Return the derivative of the pose by x, (P, 6, k), where the end and its screws are."""
        jacobian = np.empty((len(states), 6, len(x)))
        terms, slices = zip(*self._slices, strict=True) if self._slices else ((), ())
        by_terms = self._by_terms(terms, [x[columns] for columns in slices], end, states, x)
        for columns, by_term in zip(slices, by_terms, strict=True):
            jacobian[:, :, columns] = by_term
        return jacobian

    def parameter_indices(self, *terms: Term) -> Index:
        """Return the indices in x of the parameters of terms, term by term."""
        every = np.arange(len(self.parameters))
        return np.concatenate([every[:0], *(every[self.columns_of(term)] for term in terms)])

    def columns_of(self, term: Term) -> slice:
        """Return the slice of x of a term (ValueError where it is not of the model)."""
        return self._slices[self.terms.index(term)][1]

    def by_terms(
        self, states: PoseStates, x: Array, terms: Sequence[Term], points: Sequence[Array]
    ) -> tuple[Array, list[Array]]:
        """Return predicted poses and their derivatives by terms, which the model need not have.

        Returns:
            T_base_ee (P, 4, 4); for each term the derivative (P, 6, k') at its parameters (k',) in
            `points`: velocity of the end over its angular velocity, along base axes.
        """
        T, screws = end_pose_and_screws(self.chain, self.chain_coordinates(states, x))
        moved = self._moved_columns((*terms, *(t for t, _ in (*self._yielding, *self._bending))))
        return T, list(self._by_terms(terms, points, EndPose(T, screws(moved)), states, x))

    def _by_terms(
        self,
        terms: Sequence[Term],
        points: Sequence[Array],
        end: EndPose,
        states: PoseStates,
        x: Array,
    ) -> Iterator[Array]:
        """Yield the derivative of the pose by the parameters of terms, each (P, 6, k')."""
        carried = self.carried(states, x, terms)
        yielding = [term.joint - 1 for term, _ in self._yielding]
        by_torque: Array | None = None
        for term, point in zip(terms, points, strict=True):
            screws = self._screws(term, end)
            if self.derivative_cache is None:
                by_parameter = term.derivative(carried, point)
            else:
                by_parameter = self.derivative_cache.derivative(term, carried, point)
            plain = by_parameter.base is identity(by_parameter.shape[2])  # offsets, mostly
            by_term = screws if plain else screws @ by_parameter
            if yielding and shows_torque(term) and not term.acts_on_joint:
                if by_torque is None:  # derivative of the pose by torques of joints that yield
                    turned = [
                        self._screws(soft, end)[:, :, 0]
                        * soft.by_torque(carried, x[columns])[:, None]
                        for soft, columns in self._yielding
                    ]
                    by_torque = np.stack(turned, axis=2)
                by_term = by_term - by_torque @ term.torque_derivative(states, point)[:, yielding]
            if holds_weights(term) and self._bending:
                by_term = by_term + self._by_weights(term, end, carried, x)
            yield by_term

    def _by_weights(self, term: Weights, end: EndPose, carried: PoseStates, x: Array) -> Array:
        """Return the derivative of the pose by weights through the terms that bend, (P, 6, k)."""
        by_weights = np.zeros((len(carried), 6, len(term.parameters)))
        soft = [
            (
                each,
                x[columns],
                each.shift(carried, x[columns]),
                end.screws[:, :, self.chain.columns(each.coordinates)],
            )
            for each, columns in self._bending
        ]
        for k, unit in enumerate(np.eye(by_weights.shape[2])):
            heavier = term.carried(carried, unit)
            for each, amounts, shift, screws in soft:
                more = each.shift(heavier, amounts) - shift
                by_weights[:, :, k] += (screws @ more[:, :, None])[:, :, 0]
        return by_weights

    def carried(self, states: PoseStates, x: Array, others: Iterable[Term] = ()) -> PoseStates:
        """Return the states with the torques that joints carry, and the model's weights.

        Weights only where links or base bend, by a term of the model or one of `others`.
        """
        carried = self.with_joint_torques(states, x)
        if self._bending or any(term.bends for term in others):
            for term, columns in self._slices:
                carried = term.carried(carried, x[columns])
        return carried

    def with_joint_torques(self, states: PoseStates, x: Array) -> PoseStates:
        """Return the states with the torques that the joints carry, in place of those logged."""
        false_Nm = [
            term.torque_Nm(states, x[columns])
            for term, columns in self._slices
            if shows_torque(term)
            and not term.acts_on_joint  # the log has it, the joint does not carry it
        ]
        return replace(states, tau_Nm=states.tau_Nm - sum(false_Nm)) if false_Nm else states

    def torque_Nm(self, states: PoseStates, x: Array) -> Array:
        """Return what the terms add to the torques of the weights in the log, (P, n)."""
        total = np.zeros_like(states.tau_Nm)
        for term, columns in self._slices:
            if shows_torque(term):
                total += term.torque_Nm(states, x[columns])
        return total

    def torque_jacobian(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `torque_Nm` by x, (P, n, k)."""
        jacobian = np.zeros((*states.tau_Nm.shape, len(x)))
        for term, columns in self._slices:
            if shows_torque(term):
                jacobian[:, :, columns] = term.torque_derivative(states, x[columns])
        return jacobian

    def report(self, x: Array) -> Report:
        """Return all reported parameters."""
        reports = [term.report(x[columns]) for term, columns in self._slices]
        jacobian = np.zeros((sum(len(report.values) for report in reports), len(x)))
        row = 0
        for report, (_, columns) in zip(reports, self._slices, strict=True):
            jacobian[row : row + len(report.values), columns] = report.jacobian
            row += len(report.values)
        return Report(
            tuple(parameter for report in reports for parameter in report.parameters),
            np.concatenate([report.values for report in reports]),
            jacobian,
            np.concatenate(
                [
                    np.zeros(len(report.values)) if report.by_weights is None else report.by_weights
                    for report in reports
                ]
            ),
            frozenset().union(*(report.zero for report in reports)),
        )

    @property
    def u_scale(self) -> float:
        """Return the relative standard uncertainty of the weights as a whole.

        Of assumed weights, poses determine only ratios and stiffness over weight: a stiffness alone
        has this uncertainty besides. 0 where weights are stated.
        """
        return max((term.u_scale for term in self.terms if holds_weights(term)), default=0.0)

    def chain_coordinates(self, states: PoseStates, x: Array) -> Array:
        """Return the chain coordinates (P, m) that the terms lead to."""
        coordinates = self.chain.coordinates(states.q_rad)
        carried = self.carried(states, x)
        for term, columns in self._slices:
            if self.derivative_cache is None:
                shift = term.shift(carried, x[columns])
            else:
                shift = self.derivative_cache.shift(term, carried, x[columns])
            at, moved = self._driven(term)
            coordinates[:, at] += shift if moved is None else shift * moved
        return coordinates

    def _driven(self, term: Term) -> tuple[Index, Array | None]:
        """Return the chain columns that a term moves, and their motion (m',) by its one coordinate.

        None where the columns are its coordinates. A joint yields at its drive, which may move
        other joints too.
        """
        coupling = self.chain.arm.coupling
        if coupling.none or not yields(term) or term.joint - 1 not in coupling.own:
            return self.chain.columns(term.coordinates), None
        moved = coupling.by_drives[:, term.joint - 1]
        return self.chain.joint_columns[moved != 0.0], moved[moved != 0.0]

    def _screws(self, term: Term, end: EndPose) -> Array:
        """Return the derivative of the pose by the coordinates of a term, (P, 6, m)."""
        columns, moved = self._driven(term)
        screws = end.screws[:, :, columns]
        return screws if moved is None else screws @ moved[:, None]

    @cached_property
    def _own_columns(self) -> list[int]:
        return self._moved_columns(self.terms)

    def _moved_columns(self, terms: Sequence[Term]) -> list[int]:
        return sorted({int(column) for term in terms for column in self._driven(term)[0]})

    @cached_property
    def _yielding(self) -> list[tuple[Yielding, slice]]:
        return [(term, columns) for term, columns in self._slices if yields(term)]

    @cached_property
    def _bending(self) -> list[tuple[Term, slice]]:
        return [(term, columns) for term, columns in self._slices if term.bends]

    @cached_property
    def _slices(self) -> list[tuple[Term, slice]]:
        slices, start = [], 0
        for term in self.terms:
            stop = start + len(term.parameters)
            slices.append((term, slice(start, stop)))
            start = stop
        return slices


# A cache of derivatives of terms that are proportional to their parameters.
#
# A search fits hundreds of sets of the same effects in the same poses. The derivative of a
# proportional term depends on the states of the poses alone, and mostly not on the torques that a
# fit changes in these: it is computed anew only when a field that it read has changed.

_FIELDS = frozenset(field.name for field in fields(PoseStates))


class _Watched(PoseStates):
    """States that record which of their fields are read."""

    @classmethod
    def of(cls, states: PoseStates) -> _Watched:
        """Return the same states with an empty record."""
        watched = cls(**{name: getattr(states, name) for name in _FIELDS})
        vars(watched)["read"] = set()
        return watched

    def __getattribute__(self, name: str) -> Any:
        if name in _FIELDS:
            vars(self).get("read", set()).add(name)
        return super().__getattribute__(name)


class DerivativeCache:
    """The derivative of each proportional term at the states it was last computed for."""

    def __init__(self) -> None:
        """Start empty."""
        #: Derivatives, each with the fields of the states that were read for it, by name.
        self._cached: dict[Term, tuple[Array, dict[str, Any]]] = {}

    def derivative(self, term: Term, states: PoseStates, x: Array) -> Array:
        """Return `term.derivative(states, x)`, from the cache where that is valid."""
        if not term.proportional:
            return term.derivative(states, x)
        if not self._is_valid(term, states):
            watched = _Watched.of(states)
            derivative = term.derivative(watched, x)
            read = {name: getattr(states, name) for name in vars(watched)["read"]}
            self._cached[term] = derivative, read
        return self._cached[term][0]

    def shift(self, term: Term, states: PoseStates, x: Array) -> Array:
        """Return `term.shift(states, x)`, from the cached derivative where that is valid."""
        if not self._is_valid(term, states):
            return term.shift(states, x)
        return np.asarray(self._cached[term][0] @ x)

    def _is_valid(self, term: Term, states: PoseStates) -> bool:
        """Return whether a derivative is cached, of states with the very same arrays."""
        if not term.proportional or term not in self._cached:
            return False
        _, read = self._cached[term]
        return all(getattr(states, name) is value for name, value in read.items())
