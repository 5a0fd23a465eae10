"""Terms as plain data: what a file holds of a term, and the term made of it again.

A term is its `id`, its place `of`, and the constants of its form (orders, spans, knots). The values
of its parameters belong to the fitted model, not to the term.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from functools import cache
from typing import Any

from pydantic import TypeAdapter, ValidationError

from pa10cal.arm.chain import Chain
from pa10cal.errors import TermError, remedy_for
from pa10cal.terms.effects.vocabulary import every_effect
from pa10cal.terms.field import Field, Nameless, is_nameless
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.offsets import Offsets
from pa10cal.terms.statement_faults import FAULTS
from pa10cal.terms.term import OPTIONAL, Term
from pa10cal.terms.weights import Weights, holds_weights
from pa10cal.terms.wrapped import OfCampaign, of_one_campaign


def term_to_plain(term: Term) -> dict[str, Any]:
    """Return a term as numbers, texts, lists and mappings.

    Returns:
        `id`, `of`, and as `form` the fields of its class that shape it; `term_from_plain` gives it
        back.
    """
    if of_one_campaign(term):
        own = {"campaign": term.campaign, "name": term.name, "term": term_to_plain(term.term)}
        return {"id": term.id, "of": term.of, "form": own}
    if is_nameless(term):
        parts = [term_to_plain(each) for each in term.terms]
        return {"id": term.id, "of": term.of, "form": {"terms": parts, "sizes": list(term.sizes)}}
    form: dict[str, Any] = _adapter(type(term)).dump_python(term, mode="json")
    form.pop("of", None)
    kind: Any = type(term)
    for each in fields(kind):
        if each.metadata.get(OPTIONAL) and getattr(term, each.name) == each.default:
            del form[each.name]
    return {"id": term.id, "of": term.of, "form": form}


def term_from_plain(content: Mapping[str, Any], *, where: str) -> Term:
    """Return the term that `term_to_plain` described; other keys may stand beside.

    Raises:
        TermError: when there is no such term, or what shapes it is missing or of the wrong kind.
    """
    kinds = term_kinds()
    name = content.get("id")
    if name == OfCampaign.id:
        return _term_of_campaign(content.get("form") or {}, where)
    if name == Nameless.id:
        return _nameless(content.get("form") or {}, where)
    if name not in kinds:
        remedy = remedy_for(str(name), kinds, "use a version of the package that knows it")
        raise TermError(
            "unknown term",
            where=f"{where}: id",
            value=name,
            allowed=", ".join(kinds),
            remedy=remedy,
        )
    kind = kinds[name]
    known = [field.name for field in fields(kind)]
    given = {"of": content.get("of"), **(content.get("form") or {})}
    shape = {name: given[name] for name in known if name in given}
    try:
        term: Term = _adapter(kind).validate_python(shape)
    except ValidationError as error:
        first = error.errors()[0]
        missing = first["type"] == "missing"
        wrong = "is missing" if missing else first["msg"]
        raise TermError(
            f"key {'.'.join(map(str, first['loc']))} {wrong}",
            where=f"{where}: {name} of {content.get('of')}",
            value=None if missing else first["input"],
            allowed=f"the keys {', '.join(known)}",
            remedy="write the model again",
        ) from None
    return term


def refuse_of_another_arm(terms: Iterable[Term], chain: Chain, where: str) -> None:
    """Refuse terms of joints, coordinates or weights that an arm does not have.

    Raises:
        TermError: naming the term, and what of it the arm has not.
    """
    n = chain.arm.n
    for term in terms:
        wrong = [name for name in term.coordinates if not chain.has_coordinate(name)]
        parts: tuple[Any, ...] = (term,)
        if of_one_campaign(term):
            parts = (term.term,)
        elif is_nameless(term):
            parts = term.terms
        for part in parts:
            wrong += _beyond_joints(part, n)
        if wrong:
            raise TermError(
                "a term of what the arm does not have",
                where=f"{where}: {term.id} of {term.of}",
                value=wrong[0],
                allowed=f"joints 1 to {n} of {chain.arm.name}, and what belongs to them",
                remedy="write the model again",
            )


#: Fields of terms that hold the number of a joint.
_JOINT_NUMBERS = ("joint", "by", "last")


def _beyond_joints(term: Any, n: int) -> list[str]:
    """Return the joints and weights of a term that an arm of n joints does not have, in words."""
    names = [each.name for each in fields(term) if each.name in _JOINT_NUMBERS]
    joints = [*(getattr(term, name) for name in names), *getattr(term, "joints", ())]
    wrong = [f"joint {joint}" for joint in joints if not 1 <= joint <= n]
    if holds_weights(term):
        columns = (*term.columns, *(() if term.held is None else (term.held,)))
        wrong += [f"column {column}" for column in columns if not 0 <= column < 4 * n + 3]
        wrong += [f"{term.n} joints"] * (term.n != n)
    return wrong


def _term_of_campaign(form: Mapping[str, Any], where: str) -> OfCampaign:
    """Return the term of one campaign of a group that `term_to_plain` described."""
    campaign, name, inner = (form.get(key) for key in ("campaign", "name", "term"))
    fits = isinstance(campaign, int) and isinstance(name, str) and isinstance(inner, Mapping)
    if not fits:
        raise TermError(
            "the form of a term of one campaign is incomplete",
            where=f"{where}: {OfCampaign.id}: form",
            value=dict(form),
            allowed="the keys campaign (a number from 0), name, term",
            remedy="write the model again",
        )
    return OfCampaign(term_from_plain(form["term"], where=where), form["campaign"], form["name"])


def _nameless(form: Mapping[str, Any], where: str) -> Nameless:
    """Return the sum of terms without a name that `term_to_plain` described."""
    parts, sizes = form.get("terms"), form.get("sizes")
    where = f"{where}: {Nameless.id}: form"
    if (
        isinstance(parts, list)
        and isinstance(sizes, list)
        and all(isinstance(part, Mapping) for part in parts)
    ):
        terms = tuple(term_from_plain(part, where=where) for part in parts)
        known = all(isinstance(size, float) and size > 0.0 for size in sizes)
        if known and len(sizes) == sum(len(term.parameters) for term in terms):
            return Nameless(terms, tuple(sizes))
    raise TermError(
        "the form of a sum of terms is incomplete",
        where=where,
        value=sorted(map(str, form)),
        allowed="the keys terms (terms) and sizes (a number above 0 for each of their parameters)",
        remedy="write the model again",
    )


@cache
def term_kinds() -> dict[str, Any]:
    """Return every class of term by its id: departures, springs, weights, effects, faults."""
    kinds: tuple[Any, ...] = (Offsets, JointSpring, Weights, Field, *every_effect(), *FAULTS)
    return {kind.id: kind for kind in kinds}


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)
