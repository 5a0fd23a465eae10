"""The shortest form that predicts held-out blocks as well as the maps and rivals it may replace.

Under either scorer the residual is linear: whitened rows, with columns of the model's other
parameters, of the maps and rivals in question, and of every short form. Blocks of rows are held out
in turn and predicted from the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, standard_error_of_sum
from pa10cal.discovery.finding import effect_parameters, name_of
from pa10cal.discovery.tuning import FORMS
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.results.discovery import ProposedEvidence, ProposedFormula
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.forms.catalogue import further
from pa10cal.terms.forms.form import Form


@dataclass(frozen=True, eq=False)
class FormComparison:
    """R whitened rows in B blocks, on which short forms are compared with maps and rivals."""

    data: Array  # (R,) measured minus predicted
    own: Array  # (R, n) columns of the model's other parameters, each in its expected size
    block: Index  # (R,) number of the block of each row, from 0
    # (R, h) columns of the maps and rivals in question, in their expected sizes; None for none
    held: Array | None
    # returns the columns (R, k) of each of some forms, in their expected sizes
    columns_of: Callable[[Sequence[Form]], list[Array]]
    states: PoseStates  # of the poses of the rows
    # sum of squares that noise alone would leave; None where the rows have unit noise
    noise: float | None = None

    @cached_property
    def blocks(self) -> list[Index]:
        """Return the rows of each block."""
        return [np.flatnonzero(self.block == b) for b in range(int(self.block.max()) + 1)]

    @cached_property
    def _without_block(self) -> list[Gaussian]:
        """Return the normal equations of the own columns by all blocks but one, block by block."""
        each = [Gaussian.of(self.own[at], self.data[at]) for at in self.blocks]
        every = sum(each, Gaussian.none(self.own.shape[1]))
        return [every - part for part in each]

    def squares(self, candidates: Sequence[Array]) -> Array:
        """Return the sum of squares of every block, predicted from the others, (m, B).

        Columns (R, k) of m candidates are in their expected sizes.
        """
        found = np.empty((len(candidates), len(self.blocks)))
        widths = np.array([columns.shape[1] for columns in candidates])
        for width in np.unique(widths):
            same = np.flatnonzero(widths == width)
            found[same] = self._squares(np.stack([candidates[k] for k in same.tolist()], axis=1))
        return found

    def _squares(self, columns: Array) -> Array:
        """Return the sum of squares of every block with columns (R, m, k), (m, B)."""
        _, m, k = columns.shape
        n = self.own.shape[1]
        in_block = [columns[at] for at in self.blocks]
        # products, by block, of the columns with the own ones, with themselves and with the data
        across, grams, projections = [], [], []
        for at, here in zip(self.blocks, in_block, strict=True):
            flat = self.own[at].T @ here.reshape(len(at), m * k)
            across.append(flat.reshape(n, m, k))
            grams.append(here.transpose(1, 2, 0) @ here.transpose(1, 0, 2))
            projections.append(np.tensordot(self.data[at], here, axes=1))
        total_across, total_gram = np.sum(across, axis=0), np.sum(grams, axis=0)
        total_projection = np.sum(projections, axis=0)
        found = np.empty((m, len(self.blocks)))
        for b, (at, others) in enumerate(zip(self.blocks, self._without_block, strict=True)):
            across_others = total_across - across[b]
            amounts = others.of_each_further(
                across_others, total_gram - grams[b], total_projection - projections[b]
            ).mean
            taken = np.einsum("nmk,mk->nm", across_others, amounts)
            own = others.taken_of(others.projection[:, None] - taken)
            predicted = self.own[at] @ own + np.einsum("rmk,mk->rm", in_block[b], amounts)
            found[:, b] = np.sum((self.data[at, None] - predicted) ** 2, axis=0)
        return found

    def fitted(self, columns: Array) -> tuple[Array, Array]:
        """Return amounts (k,) of columns (R, k) by all blocks, and their covariance (k, k)."""
        both = Gaussian.of(np.concatenate([self.own, columns], axis=1), self.data)
        n = self.own.shape[1]
        return both.mean[n:], both.covariance[n:, n:]


@dataclass(frozen=True, eq=False)
class FormulaProposal:
    """A formula for an effect without a name; it changes no name of the verdict."""

    form: Form
    # maps and rivals that it does as well as; none where it leaves no more than noise
    instead: tuple[Effect, ...]
    record: ProposedFormula


@dataclass(frozen=True, eq=False)
class _Tried:
    """A form, and the sum of squares of every held-out block with it, (B,)."""

    form: Form
    squares: Array

    @property
    def total(self) -> float:
        return float(self.squares.sum())


@dataclass(frozen=True, eq=False)
class _Judge:
    """A comparison, with the squares that a form has to improve on or to reach."""

    comparison: FormComparison
    needed: float  # decrease of the sum of squares that a form needs
    without: Array  # (B,) squares of every block without a form
    # (B,) squares with the maps and rivals in question; None where these are no better than nothing
    held: Array | None

    @classmethod
    def of(cls, comparison: FormComparison, needed: float) -> _Judge:
        of_held = [] if comparison.held is None else [comparison.held]
        without, *held = comparison.squares([np.zeros((len(comparison.data), 0)), *of_held])
        better = bool(held) and float(held[0].sum()) < float(without.sum())
        return cls(comparison, needed, without, held[0] if better else None)

    def all_of(self, forms: Sequence[Form]) -> list[_Tried]:
        """Return the squares of held-out blocks with each of many forms."""
        found: list[_Tried] = []
        for first in range(0, len(forms), FORMS.at_once):
            some = forms[first : first + FORMS.at_once]
            found += map(_Tried, some, self.comparison.squares(self.comparison.columns_of(some)))
        return found

    def passes(self, tried: _Tried, errors: float = 1.0) -> bool:
        """Return whether a form helps enough, and does as well as what it may replace.

        To within a number of standard errors.
        """
        noise = self.comparison.noise
        reachable = noise = len(self.comparison.data) if noise is None else noise
        if self.comparison.noise is not None and self.held is not None:
            reachable = max(noise, float(self.held.sum()))
        gain = self.without - tried.squares
        share = FORMS.least_explained_share * (float(self.without.sum()) - reachable)
        enough = max(self.needed, share) / errors
        if self.held is not None:
            # Something is there: what blocks gain by it scatters with its own size.
            return float(gain.sum()) > enough and self._no_worse(tried, self.held, errors)
        by_chance = FORMS.standard_errors * standard_error_of_sum(gain) / errors
        enough = max(enough, by_chance)
        return float(gain.sum()) > enough and tried.total <= FORMS.over_noise * noise * errors

    def equally_good(self, tried: Sequence[_Tried]) -> list[_Tried]:
        """Return the forms that pass and are as good as the best of these, the best first."""
        good = [
            each
            for each in _ranked(tried)
            if self.passes(each) and not _one_is_enough(each, tried, self.needed)
        ]
        return [each for each in good if self._no_worse(each, good[0].squares)]

    def _no_worse(self, tried: _Tried, than: Array, errors: float = 1.0) -> bool:
        """Return whether a form does as well as what has squares (B,), to within some errors."""
        lost = tried.squares - than
        by_chance = np.hypot(standard_error_of_sum(lost), FORMS.chance_squares)
        gained = float(self.without.sum() - than.sum())
        most = max(self.needed, FORMS.most_lost_share * gained)
        return bool(lost.sum() <= min(max(FORMS.tie_errors, errors) * by_chance, errors * most))


def choose(
    comparison: FormComparison,
    forms: Sequence[Form],
    instead: Sequence[Effect],
    error_rate: float,
    whole: Callable[[], FormComparison] | None = None,
) -> FormulaProposal | None:
    """Return the shortest form that does as well as maps and rivals; None where none does.

    Args:
        comparison: of all poses, or of some of them.
        forms: what is tried first.
        instead: the maps and rivals.
        error_rate: probability allowed of proposing a form where nothing is missing.
        whole: returns the comparison of all poses, on which forms that some poses do not rule out
            are compared again; None where the given one is of all.
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
        tried = judge.all_of(_shortlist(tried))
    good = judge.equally_good(tried)
    if not good:
        return None
    best = min(good, key=lambda one: (one.form.length, one.total))
    record = _record(judge, best, good, instead)
    # Where no number of it is known, what helps is a slope that the formula does not tell.
    known = any(abs(each.value) > HALF_WIDTH_95 * each.std for each in record.parameters.values())
    return FormulaProposal(best.form, tuple(instead), record) if known else None


def _shortlist(tried: Sequence[_Tried]) -> list[Form]:
    """Return the best forms, and then the best form of every kind that is not among them."""
    ranked = [each.form for each in _ranked(tried)]
    best = ranked[: FORMS.kept]
    of_kind = {form.form: form for form in reversed(ranked)}
    return best + [form for form in of_kind.values() if form not in best]


def _record(
    judge: _Judge, best: _Tried, good: Sequence[_Tried], instead: Sequence[Effect]
) -> ProposedFormula:
    """Return a form, fitted to all blocks, with the other good forms, as it is written."""
    form = best.form
    same_kind = [one.form.order for one in good if one.form.form == form.form]
    orders = [order for order in same_kind if order is not None]
    other_kinds = {form.form: form}  # the best form of each
    for one in good:
        # Two harmonics are no alternative of one of them.
        if form.form != "harmonic" or one.form.form != "two_harmonics":
            other_kinds.setdefault(one.form.form, one.form)
    others = [other for other in other_kinds.values() if other is not form][: FORMS.most_others]
    (columns,) = judge.comparison.columns_of([form])
    amounts, covariance = judge.comparison.fitted(columns)
    factor = form.prior_factor
    report = form.report(factor @ amounts)
    by_amount = report.jacobian @ factor
    gain, total = judge.without - best.squares, float(judge.without.sum())
    return ProposedFormula(
        formula=form.formula,
        of=form.of,
        form=form.form,
        numbers=form.numbers,
        orders=(min(orders), max(orders)) if form.order is not None else None,
        parameters=effect_parameters(form, report.values, by_amount @ covariance @ by_amount.T),
        gain=float(gain.sum() / judge.without.sum()),
        does_as_well_as=tuple(map(name_of, instead)),
        others=tuple(other.formula for other in others),
        evidence=ProposedEvidence(
            blocks=len(judge.without),
            rows=len(judge.comparison.data),
            squared_error_without=total,
            squared_error_with=best.total,
            squared_error_held=None if judge.held is None else float(judge.held.sum()),
            gain_std=standard_error_of_sum(gain) / total,
        ),
    )


def _one_is_enough(two: _Tried, tried: Sequence[_Tried], needed: float) -> bool:
    """Return whether the second of two harmonics gains no more than the best of many by chance."""
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
    """Return what was tried, the smallest sum of squares first."""
    return sorted(tried, key=lambda each: each.total)


def _closer(tried: Sequence[_Tried]) -> list[Form]:
    """Return forms with thresholds, phases, … between those of the best forms and their neighbours.

    Neighbours are forms that differ from the best one in that number alone.
    """
    known = {each.form for each in tried}
    best = [each.form for each in _ranked(tried) if each.form.shape.real_index is not None]
    found: list[Form] = []
    for form in best[: FORMS.refined]:
        value = form.real_number
        same_kind = [other for other in known if other.form == form.form]
        values = {o.real_number for o in same_kind if o.with_real_number(value) == form}
        below = max((other for other in values if other < value), default=value)
        above = min((other for other in values if other > value), default=value)
        between = np.linspace(below, above, FORMS.refined_places).tolist()
        closer = [form.with_real_number(other) for other in between]
        found += [each for each in closer if each not in known]
        known.update(closer)
    return found
