"""The shortest form that predicts blocks left out as well as what it may stand for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.formulas.rows import Arena
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.forms.form import Form
from pa10cal.terms.forms.library import second_orders

Array = NDArray[np.float64]

#: Standard errors over blocks by which a form must help, and the part of what is over the noise.
_SURELY, _MOST_OF_IT = 3.0, 0.8
#: Standard errors within which forms do equally well: the best of many is so by chance, too.
_ALIKE = 2.0
#: What a squared error is expected to differ by between two forms that are both right, in squares
#: of the noise.
_CHANCE = 2.0
#: How much more than noise alone may be left where there is no map to do as well as.
_OVER_NOISE = 1.1
#: Forms that are looked at between their neighbours, times, and at how many places.
_REFINED, _ROUNDS, _BETWEEN = 12, 2, 9
#: Forms whose columns are made at once, and those that few poses do not rule out.
_AT_ONCE, _KEPT = 256, 48
#: Other forms that are listed as doing as well.
_MOST_OTHERS = 6


@dataclass(frozen=True, eq=False)
class Proposal:
    """A formula for what has no name; it changes nothing of what is named.

    Attributes:
        form: which, and where.
        x, covariance: its reported parameters, and their covariance.
        instead: maps and rivals that it does as well as; none where it leaves noise alone.
        gain: part of the squared error of blocks left out that it takes away.
        gain_std: its standard error.
        squares: squared error of blocks left out without it, with what it may stand for (None where
            there is none), and with it; a whitened row of noise alone leaves 1.
        rows: how many rows that is of.
        blocks: how many blocks.
        orders: lowest and highest order that does as well; None where it has no order.
        others: other forms that do as well and are no shorter.
    """

    form: Form
    x: Array
    covariance: Array
    instead: tuple[Effect, ...]
    gain: float
    gain_std: float
    squares: tuple[float, float | None, float]
    rows: int
    blocks: int
    orders: tuple[int, int] | None
    others: tuple[Form, ...]

    @property
    def of(self) -> str:
        """Return where it sits."""
        return self.form.of


@dataclass(frozen=True, eq=False)
class _Tried:
    """A form, and the squared error of every block with it, (B,)."""

    form: Form
    squares: Array

    @property
    def total(self) -> float:
        return float(self.squares.sum())


def choose(
    arena: Arena,
    forms: Sequence[Form],
    instead: Sequence[Effect],
    error_rate: float,
    coarse: Arena | None = None,
) -> Proposal | None:
    """Return the shortest form that does as well as maps and rivals; None where none does.

    Args:
        arena: what the forms are held against.
        forms: what is tried.
        instead: maps and rivals that a form may stand for.
        error_rate: probability allowed of proposing anything where nothing is.
        coarse: the same with fewer poses, by which most forms are ruled out.
    """
    if not forms:
        return None
    contest = arena.contest
    bare = np.zeros((len(contest.data), 0))
    nothing, *with_held = contest.squares([bare] if arena.held is None else [bare, arena.held])
    held = with_held[0] if with_held else None
    needed = 2.0 * float(np.log(len(forms) / error_rate))
    tried = _tried(coarse or arena, forms)
    tried += _tried(coarse or arena, second_orders([each.form for each in _ranked(tried)]))
    for _ in range(_ROUNDS):
        tried += _tried(coarse or arena, _closer(tried))
    if coarse is not None:
        tried = _tried(arena, [each.form for each in _ranked(tried)[:_KEPT]])

    noise = len(contest.data) if arena.noise is None else arena.noise
    least = noise if held is None or arena.noise is None else max(noise, float(held.sum()))
    over_noise = max(float(nothing.sum()) - least, 0.0)

    def helps(each: _Tried) -> bool:
        gain = nothing - each.squares
        enough = max(needed, _SURELY * standard_error(gain), _MOST_OF_IT * over_noise)
        return float(gain.sum()) > enough

    def as_well(each: _Tried) -> bool:
        if held is not None and held.sum() < nothing.sum():
            return no_worse(each.squares, held)
        return each.total <= _OVER_NOISE * noise

    good = [each for each in _ranked(tried) if helps(each) and as_well(each)]
    good = [each for each in good if no_worse(each.squares, good[0].squares, _ALIKE)]
    if not good:
        return None
    best = min(good, key=lambda each: (each.form.length, each.total))
    (columns,) = arena.columns_of([best.form])
    amounts, covariance = contest.fitted(columns)
    factor = best.form.prior_factor
    report = best.form.report(factor @ amounts)
    by_amount = report.jacobian @ factor
    gain = nothing - best.squares
    return Proposal(
        form=best.form,
        x=report.values,
        covariance=by_amount @ covariance @ by_amount.T,
        instead=tuple(instead),
        gain=float(gain.sum() / nothing.sum()),
        gain_std=standard_error(gain) / float(nothing.sum()),
        squares=(
            float(nothing.sum()),
            None if held is None else float(held.sum()),
            best.total,
        ),
        rows=len(contest.data),
        blocks=len(nothing),
        orders=_orders(best, good),
        others=_others(best, good),
    )


def no_worse(squares: Array, than: Array, errors: float = 1.0) -> bool:
    """Return whether squared errors of blocks are no larger, to so many standard errors."""
    lost = squares - than
    return bool(lost.sum() <= errors * np.hypot(standard_error(lost), _CHANCE))


def standard_error(gain: Array) -> float:
    """Return the standard error of a sum over blocks, from how it scatters between them."""
    return float(np.sqrt(len(gain)) * gain.std(ddof=1))


def _tried(arena: Arena, forms: Sequence[Form]) -> list[_Tried]:
    """Return what blocks left out come to with each of many forms."""
    found: list[_Tried] = []
    for first in range(0, len(forms), _AT_ONCE):
        some = forms[first : first + _AT_ONCE]
        squares = arena.contest.squares(arena.columns_of(some))
        found += [_Tried(form, each) for form, each in zip(some, squares, strict=True)]
    return found


def _ranked(tried: Sequence[_Tried]) -> list[_Tried]:
    """Return what was tried, the best first."""
    return sorted(tried, key=lambda each: each.total)


def _closer(tried: Sequence[_Tried]) -> list[Form]:
    """Return forms between the best ones and their neighbours: where a tooth starts, thresholds."""
    known = {each.form for each in tried}
    found: list[Form] = []
    for form in [each.form for each in _ranked(tried) if each.form.shape.between is not None][
        :_REFINED
    ]:
        value = form.between
        same = [other for other in known if other.form == form.form]
        alike = {other.between for other in same if other.at(value) == form}
        below = max((other for other in alike if other < value), default=value)
        above = min((other for other in alike if other > value), default=value)
        closer = [form.at(other) for other in np.linspace(below, above, _BETWEEN).tolist()]
        found += [each for each in closer if each not in known]
        known.update(closer)
    return found


def _orders(best: _Tried, good: Sequence[_Tried]) -> tuple[int, int] | None:
    """Return the lowest and the highest order with which the form does as well."""
    order = best.form.order
    if order is None:
        return None
    orders = [each.form.order for each in good if each.form.form == best.form.form]
    known = [each for each in orders if each is not None]
    return min(known), max(known)


def _others(best: _Tried, good: Sequence[_Tried]) -> tuple[Form, ...]:
    """Return the best of every other kind of form that does as well."""
    kinds = {best.form.form: best.form}
    for each in good:
        kinds.setdefault(each.form.form, each.form)
    return tuple(form for form in kinds.values() if form is not best.form)[:_MOST_OTHERS]
