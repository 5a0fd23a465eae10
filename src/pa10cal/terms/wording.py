"""Records of a verdict in plain English: effects, what they explain, sag, parameters, faults.

The nouns and clauses of effects are those that their classes state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pa10cal.results.discovery import KNOT, EvidenceOfSag, Fault
from pa10cal.results.evaluation import EffectParameter
from pa10cal.results.explained import Explained, ExplainedEffect
from pa10cal.results.record import HALF_WIDTH_95, SURE, EffectName
from pa10cal.terms.effects.effect import Effect, every_effect
from pa10cal.terms.field import Field
from pa10cal.terms.weights import FAULTS

_JOINT = "joint "
#: Alternatives at other places that a sentence lists; of more it gives their number.
_MOST_OTHERS = 3
#: Joints listed for an unexplained error: with at least this part of the largest share.
_MOSTLY = 0.3
#: Decimals of an error below 0.01 mm; one less above that, and above 0.1 mm.
_DECIMALS = 4


def headline(explained: Explained) -> str:
    """Return how much is explained and by what, in one line without a full stop."""
    if not explained.of or explained.share <= 0.0:
        return "none of the error beyond noise is explained"
    every = _groups(explained)
    groups = "; ".join(_short(group) for group in _that_count(every, explained) or every)
    return f"{percent(explained.share)} of the error beyond noise is {done(explained)}: {groups}"


def done(explained: Explained) -> str:
    """Return `explained`, or `predicted` where some of the error has no name."""
    return "explained" if all(each.joints is None for each in explained.of) else "predicted"


def sentences(explained: Explained) -> tuple[str, ...]:
    """Return a sentence for each group of effects: what it does, and the error before and after.

    None for a group without which the error would be the same, as it is written.
    """
    groups = [group for group in _groups(explained) if any(each.share > 0.0 for each in group)]
    told = _that_count(groups, explained)
    return tuple(_sentence(group, explained.before_mm) for group in told)


def percent(share: float) -> str:
    """Return a share in per cent; it is never rounded to all or nothing."""
    if 0.0 < share < 0.01:
        return "less than 1 %"
    if 0.99 < share < 1.0:
        return "more than 99 %"
    return f"{100.0 * share:.0f} %"


def sag(evidence: EvidenceOfSag) -> str:
    """Return how far a joint sags, which poses show whatever the weights of the arm."""
    u_mrad = HALF_WIDTH_95 * evidence.sag_u_mrad
    return f"sags by up to {evidence.sag_mrad:.2f} ± {u_mrad:.2g} mrad"


def sized(parameters: Mapping[str, EffectParameter]) -> str:
    """Return parameters with their 95 % intervals in a line, those at knots of maps omitted."""
    return ", ".join(
        f"{key} = {entry.value:.4g} ± {HALF_WIDTH_95 * entry.std:.1g} {entry.unit}"
        for key, entry in parameters.items()
        if not key.startswith(KNOT)
    )


def wrong(fault: Fault) -> str:
    """Return a fault of a log in a line: where, what, and what to do about it."""
    return f"{fault.where}: {fault.what}; {fault.remedy}"


def noun_of(effect: str, *, many: bool = False) -> str:
    """Return what an effect is called, by its id, of one place or of several."""
    return _filled(_kind_of(effect).nouns, effect, "", many=many)


def clause_of(effect: str, at: str, *, many: bool = False) -> str:
    """Return what an effect does at one place, or at several, by its id."""
    return _filled(_kind_of(effect).clauses, effect, at, many=many)


def _filled(words: tuple[str, ...], effect: str, at: str, *, many: bool) -> str:
    return words[-1 if many else 0].format(id=effect.replace("_", " "), at=at)


def _kind_of(effect: str) -> type[Effect] | type[Field]:
    """Return the class of an effect; `Effect` for one that this version does not know."""
    kinds: tuple[type[Effect] | type[Field], ...] = (*every_effect(), *FAULTS, Field)
    return next((kind for kind in kinds if kind.id == effect), Effect)


def _groups(explained: Explained) -> list[list[ExplainedEffect]]:
    """Return effects of one kind with the same alternatives together, the largest first."""
    groups: dict[object, list[ExplainedEffect]] = {}
    for effect in explained.of:
        at_joints = effect.of.startswith(_JOINT) and not effect.elsewhere
        key = (effect.ids, effect.weights) if at_joints else (effect.ids, effect.of)
        if effect.weights is not None:  # the same weights bend all of them, whatever the others
            key = (effect.ids[:1], effect.weights)
        groups.setdefault(key, []).append(effect)
    return sorted(groups.values(), key=lambda group: -sum(effect.share for effect in group))


def _short(group: list[ExplainedEffect]) -> str:
    """Return a group in a few words: `sensor or gear of joints 1 and 2`."""
    if group[0].joints is not None:
        return f"{noun_of(group[0].ids[0])} (mostly by {_at(group)})"
    here, elsewhere = _candidates(group)
    alone = not elsewhere and len(here) == 1
    many = len(group) > 1 and alone
    nouns = " or ".join(noun_of(each.id, many=many) for each in here)
    others = [_placed(noun_of(each.id), each.at) for each in elsewhere]
    if len(others) > _MOST_OTHERS:
        others = [f"one of {len(others)} others"]
    names = " or ".join([_placed(nouns, here[0].at), *others])
    first = here[0]
    if first.least is None or first.least >= SURE:
        return names
    noun = "" if alone else f"{noun_of(first.id)} "
    least, most = f"{first.least:.2f}", f"{first.most:.2f}"
    return f"{names} ({noun}{least})" if least == most else f"{names} ({noun}{least} to {most})"


@dataclass(frozen=True)
class _Candidate:
    """An effect that may be there."""

    id: str
    at: str  # its place in words
    # least and most: lowest and highest probability in a group; None where it is not known
    least: float | None
    most: float | None


def _candidates(group: list[ExplainedEffect]) -> tuple[list[_Candidate], list[_Candidate]]:
    """Return the effects that a group may be, at the place of the first one and elsewhere.

    The effect that was found comes first, unless another is likelier.
    """
    ids, elsewhere = _shared(group)
    first, at = group[0], _at(group)
    probabilities = [each.probability for each in group if each.probability is not None]
    others = [(id_, at) for id_ in ids[1:]]
    others += [(name.id, _place(name.of)) for name in elsewhere]
    known = first.others_probability if len(first.others_probability) == len(others) else ()
    least, most = min(probabilities, default=None), max(probabilities, default=None)
    candidates = [_Candidate(ids[0], at, least, most)]
    for k, (effect, place) in enumerate(others):
        of_each = [each.others_probability[k] for each in group] if known else []
        candidates.append(
            _Candidate(effect, place, min(of_each, default=None), max(of_each, default=None))
        )
    likeliest = max(each.least or 0.0 for each in candidates)
    if probabilities and likeliest > min(probabilities):
        candidates.sort(key=lambda each: -(each.least or 0.0))
    here = [each for each in candidates if each.at == candidates[0].at]
    return here, [each for each in candidates if each not in here]


def _shared(group: list[ExplainedEffect]) -> tuple[tuple[str, ...], tuple[EffectName, ...]]:
    """Return the ids, and the alternatives elsewhere, that a group has in common."""
    first = group[0]
    if any((each.ids, each.elsewhere) != (first.ids, first.elsewhere) for each in group):
        return first.ids[:1], ()
    return first.ids, first.elsewhere


def _placed(nouns: str, at: str) -> str:
    """Return nouns with their place, unless they contain it: `tool sag`, `sensor of joint 1`."""
    return nouns if at.removeprefix("the ") in nouns.split() else f"{nouns} of {at}"


def _place(of: str) -> str:
    """Return a place within a sentence: `joint 2`, `the forearm`."""
    return of if of.startswith(_JOINT) else f"the {of.replace('_', ' ')}"


def _at(group: list[ExplainedEffect]) -> str:
    """Return where a group sits: `joints 2 and 3`, `joint 2`, `the forearm`."""
    if (joints := group[0].joints) is not None:
        least_share = _MOSTLY * max(joints.values(), default=0.0)
        largest = [joint for joint, share in joints.items() if share >= least_share]
        return _joints(largest) if largest else "the joints"
    if len(group) == 1:
        return _place(group[0].of)
    return _joints([each.of.removeprefix(_JOINT) for each in group])


def _joints(numbers: list[str]) -> str:
    """Return joints in words: `joint 2`, `joints 2 and 3`."""
    *first, last = sorted(numbers, key=int)
    return f"joints {', '.join(first)} and {last}" if first else f"{_JOINT}{last}"


def _sentence(group: list[ExplainedEffect], whole_mm: float) -> str:
    """Return what a group does, and the error before and after it."""
    here, elsewhere = _candidates(group)
    clauses = [clause_of(each.id, each.at, many=len(group) > 1) for each in here]
    if len(elsewhere) > _MOST_OTHERS:
        clauses.append(f"one of {len(elsewhere)} other effects is there")
    else:
        clauses += [clause_of(each.id, each.at) for each in elsewhere]
    sentence = ", or ".join(clauses)
    if group[0].weights is not None:
        more = "" if _shared(group)[0] == group[0].ids else "; alternatives are listed"
        sentence += f" (stiffness relative to assumed weights{more})"
    before, after = _errors(group, whole_mm)
    return f"{sentence[:1].upper()}{sentence[1:]}: {before} mm becomes {after} mm."


def _that_count(
    groups: list[list[ExplainedEffect]], explained: Explained
) -> list[list[ExplainedEffect]]:
    """Return the groups that change the error as it is written."""
    errors = [_errors(group, explained.before_mm) for group in groups]
    return [group for group, (before, after) in zip(groups, errors, strict=True) if before != after]


def _errors(group: list[ExplainedEffect], whole_mm: float) -> tuple[str, str]:
    """Return the error before and after a group [mm], with as many digits as it deserves.

    Effects of a group are judged one by one: its error before is the root of the error after the
    last one and all reductions in squares, at most the largest error before any of them.
    """
    after_mm = min(each.after_mm for each in group)
    reduction = sum(max(each.before_mm**2 - each.after_mm**2, 0.0) for each in group)
    most_mm = max(whole_mm, *(each.before_mm for each in group))
    before_mm = min((after_mm**2 + reduction) ** 0.5, most_mm)
    places = _DECIMALS - min(int(after_mm >= 0.01) + int(after_mm >= 0.1), _DECIMALS)
    return f"{before_mm:.{places}f}", f"{after_mm:.{places}f}"
