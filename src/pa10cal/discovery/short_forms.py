"""The shortest form that predicts blocks left out as well as what it may stand for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.discovery.finding import effect_parameters, name_of
from pa10cal.discovery.linear import standard_error
from pa10cal.discovery.rules import FORMS
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.results.explained import ProposedEvidence, ProposedFormula
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.forms.catalogue import further
from pa10cal.terms.forms.form import Form

# Rows by which short forms are compared with what they may stand for, on blocks left out.
#
# Whoever judged, what is left is linear: weighed rows of the data, columns of what the model has
# anyway, columns of the map or rival in question, and columns of every short form.


@dataclass(frozen=True, eq=False)
class FormComparison:
    """Where short forms are held against what they may stand for: R weighed rows, in B blocks."""

    data: Array  # (R,) measured minus predicted
    own: Array  # (R, n) columns of what the model has anyway, each in the size expected of it
    block: Index  # (R,) number of the block of each row, from 0
    # (R, h) columns of the maps and rivals in question, in the size expected of them; None where
    # there are none
    held: Array | None
    # gives the columns (R, k) of forms, in their size
    columns_of: Callable[[Sequence[Form]], list[Array]]
    states: PoseStates  # of the poses that its rows are of
    # squared error of all rows that noise alone would leave; None where rows are weighed by that
    # noise
    noise: float | None = None

    @cached_property
    def blocks(self) -> list[Index]:
        """Return the rows of each block."""
        return [np.flatnonzero(self.block == b) for b in range(int(self.block.max()) + 1)]

    @cached_property
    def _elsewhere(self) -> list[Gaussian]:
        """Return what the rows say of own columns with each block left out."""
        each = [Gaussian.of(self.own[at], self.data[at]) for at in self.blocks]
        every = sum(each, Gaussian.none(self.own.shape[1]))
        return [every - part for part in each]

    def squares(self, candidates: Sequence[Array]) -> Array:
        """Return the squared error of every block, predicted from the others, (m, B).

        Columns (R, k) of m candidates are in the size expected of them.
        """
        found = np.empty((len(candidates), len(self.blocks)))
        widths = np.array([columns.shape[1] for columns in candidates])
        for width in np.unique(widths):
            places = np.flatnonzero(widths == width)
            found[places] = self._squares(
                np.stack([candidates[k] for k in places.tolist()], axis=1)
            )
        return found

    def _squares(self, columns: Array) -> Array:
        """Return the squared error of every block with columns (R, m, k), (m, B)."""
        _, m, k = columns.shape
        n = self.own.shape[1]
        here = [columns[at] for at in self.blocks]
        across, grams, with_data = [], [], []
        for at, inside in zip(self.blocks, here, strict=True):
            flat = self.own[at].T @ inside.reshape(len(at), m * k)
            across.append(flat.reshape(n, m, k))
            grams.append(_each_with(inside, inside))
            with_data.append(np.tensordot(self.data[at], inside, axes=1))
        every_across = np.sum(across, axis=0)
        every_gram, every_with = np.sum(grams, axis=0), np.sum(with_data, axis=0)
        found = np.empty((m, len(self.blocks)))
        for b, (at, others) in enumerate(zip(self.blocks, self._elsewhere, strict=True)):
            beside = every_across - across[b]
            gram, projection = every_gram - grams[b], every_with - with_data[b]
            amounts = others.of_each_further(beside, gram, projection).mean
            taken = np.einsum("nmk,mk->nm", beside, amounts)
            own = others.taken_of(others.projection[:, None] - taken)
            predicted = self.own[at] @ own + np.einsum("rmk,mk->rm", here[b], amounts)
            found[:, b] = np.sum((self.data[at, None] - predicted) ** 2, axis=0)
        return found

    def fitted(self, columns: Array) -> tuple[Array, Array]:
        """Return amounts (k,) of columns (R, k) by all blocks, and their covariance (k, k)."""
        both = Gaussian.of(np.concatenate([self.own, columns], axis=1), self.data)
        n = self.own.shape[1]
        return both.mean[n:], both.covariance[n:, n:]


def _each_with(columns: Array, others: Array) -> Array:
    """Return the products (m, k, k) of columns (R, m, k) of each candidate with others of it."""
    return np.asarray(columns.transpose(1, 2, 0) @ others.transpose(1, 0, 2))


@dataclass(frozen=True, eq=False)
class FormulaProposal:
    """A formula for what has no name; it changes nothing of what is named."""

    form: Form  # which, and where
    # maps and rivals that it does as well as; none where it leaves noise alone
    instead: tuple[Effect, ...]
    record: ProposedFormula  # all of it, as it is written


@dataclass(frozen=True, eq=False)
class _Tried:
    """A form, and the squared error of every block with it, (B,)."""

    form: Form
    squares: Array

    @property
    def total(self) -> float:
        return float(self.squares.sum())


@dataclass(frozen=True, eq=False)
class _Judge:
    """What forms are measured by in a comparison."""

    comparison: FormComparison  # rows, blocks, and what is held against forms
    needed: float  # squared error by which a form must help at least
    nothing: Array  # squared error of every block with nothing, (B,)
    # the same with the maps and rivals in question; None where there are none, or where they are
    # no better than nothing
    held: Array | None

    @classmethod
    def of(cls, comparison: FormComparison, needed: float) -> _Judge:
        of_held = [] if comparison.held is None else [comparison.held]
        nothing, *held = comparison.squares([np.zeros((len(comparison.data), 0)), *of_held])
        better = bool(held) and float(held[0].sum()) < float(nothing.sum())
        return cls(comparison, needed, nothing, held[0] if better else None)

    def all_of(self, forms: Sequence[Form]) -> list[_Tried]:
        """Return what blocks left out come to with each of many forms."""
        found: list[_Tried] = []
        for first in range(0, len(forms), FORMS.at_once):
            some = forms[first : first + FORMS.at_once]
            found += map(_Tried, some, self.comparison.squares(self.comparison.columns_of(some)))
        return found

    def passes(self, tried: _Tried, errors: float = 1.0) -> bool:
        """Return whether a form helps enough, and does as well, within so many standard errors."""
        noise, held = self.comparison.noise, self.held
        least = noise = len(self.comparison.data) if noise is None else noise
        if self.comparison.noise is not None and held is not None:
            least = max(noise, float(held.sum()))
        gain = self.nothing - tried.squares
        over_noise = float(self.nothing.sum()) - least
        enough = max(
            self.needed,
            FORMS.standard_errors * standard_error(gain),
            FORMS.least_explained_share * over_noise,
        )
        if float(gain.sum()) <= enough / errors:
            return False
        if held is not None:
            return no_worse(tried.squares, held, errors)
        return tried.total <= FORMS.over_noise * noise * errors


def choose(
    comparison: FormComparison,
    forms: Sequence[Form],
    instead: Sequence[Effect],
    error_rate: float,
    whole: Callable[[], FormComparison] | None = None,
) -> FormulaProposal | None:
    """Return the shortest form that does as well as maps and rivals; None where none does.

    The error rate is the probability allowed of proposing anything where nothing is. Where the
    comparison is of some poses, by which forms are ruled out, `whole` gives that of all.
    """
    if not forms:
        return None
    judge = _Judge.of(comparison, 2.0 * float(np.log(len(forms) / error_rate)))
    tried = judge.all_of(forms)
    tried += judge.all_of(further([each.form for each in _ranked(tried)], comparison.states))
    for _ in range(FORMS.refined_rounds):
        tried += judge.all_of(_closer(tried))
    if whole is not None:
        if not any(judge.passes(each, FORMS.few_errors) for each in tried):
            return None
        judge = _Judge.of(whole(), judge.needed)
        ranked = _ranked(tried)  # the best, and the best of every kind
        kinds = {each.form.form: each for each in reversed(ranked)}
        best_of_kind = [each for each in kinds.values() if each not in ranked[: FORMS.kept]]
        tried = judge.all_of([each.form for each in (*ranked[: FORMS.kept], *best_of_kind)])
    good = [
        each
        for each in _ranked(tried)
        if judge.passes(each) and not _one_is_enough(each, tried, judge.needed)
    ]
    good = [each for each in good if no_worse(each.squares, good[0].squares, FORMS.tie_errors)]
    if not good:
        return None
    best = min(good, key=lambda one: (one.form.length, one.total))
    form, comparison, nothing, held = best.form, judge.comparison, judge.nothing, judge.held
    same = [one.form.order for one in good if one.form.form == form.form]
    orders = [order for order in same if order is not None]
    # The best of every other kind of form that does as well; not one order and another.
    other_kinds = {form.form: form}
    for one in good:
        if form.form != "harmonic" or one.form.form != "two_harmonics":
            other_kinds.setdefault(one.form.form, one.form)
    others = [other for other in other_kinds.values() if other is not form][: FORMS.most_others]
    # Fitted to all poses.
    (columns,) = comparison.columns_of([form])
    amounts, covariance = comparison.fitted(columns)
    factor = form.prior_factor
    report = form.report(factor @ amounts)
    by_amount = report.jacobian @ factor
    covariance = by_amount @ covariance @ by_amount.T
    gain, total = nothing - best.squares, float(nothing.sum())
    record = ProposedFormula(
        formula=form.formula,
        of=form.of,
        form=form.form,
        numbers=form.numbers,
        orders=(min(orders), max(orders)) if form.order is not None else None,
        parameters=effect_parameters(form, report.values, covariance),
        gain=float(gain.sum() / nothing.sum()),
        does_as_well_as=tuple(map(name_of, instead)),
        others=tuple(other.formula for other in others),
        evidence=ProposedEvidence(
            blocks=len(nothing),
            rows=len(comparison.data),
            squared_error_without=total,
            squared_error_with=best.total,
            squared_error_held=None if held is None else float(held.sum()),
            gain_std=standard_error(gain) / total,
        ),
    )
    return FormulaProposal(form, tuple(instead), record)


def no_worse(squares: Array, than: Array, errors: float = 1.0) -> bool:
    """Return whether squared errors of blocks are no larger, to so many standard errors."""
    lost = squares - than
    return bool(lost.sum() <= errors * np.hypot(standard_error(lost), FORMS.chance_squares))


def _one_is_enough(two: _Tried, tried: Sequence[_Tried], needed: float) -> bool:
    """Return whether the second of two orders gains no more than the best of many by chance."""
    if two.form.form != "two_harmonics":
        return False
    alone = [
        each.total
        for each in tried
        if each.form.form == "harmonic"
        and each.form.of == two.form.of
        and each.form.numbers[0] in two.form.numbers
    ]
    return bool(alone) and min(alone) - two.total <= needed


def _ranked(tried: Sequence[_Tried]) -> list[_Tried]:
    """Return what was tried, the best first."""
    return sorted(tried, key=lambda each: each.total)


def _closer(tried: Sequence[_Tried]) -> list[Form]:
    """Return forms between the best ones and their neighbours: where a tooth starts, thresholds."""
    known = {each.form for each in tried}
    found: list[Form] = []
    for form in [each.form for each in _ranked(tried) if each.form.shape.between is not None][
        : FORMS.refined
    ]:
        value = form.between
        same = [other for other in known if other.form == form.form]
        alike = {other.between for other in same if other.at(value) == form}
        below = max((other for other in alike if other < value), default=value)
        above = min((other for other in alike if other > value), default=value)
        closer = [
            form.at(other) for other in np.linspace(below, above, FORMS.refined_places).tolist()
        ]
        found += [each for each in closer if each not in known]
        known.update(closer)
    return found
