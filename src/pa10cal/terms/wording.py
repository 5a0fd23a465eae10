"""Records of a verdict in plain English: effects, what they explain, sag, parameters, faults.

The nouns and clauses of effects are those that their classes state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pa10cal.results.discovery import KNOT, EvidenceOfSag, Explained, ExplainedEffect, Fault
from pa10cal.results.evaluation import EffectParameter
from pa10cal.results.number_text import HALF_WIDTH_95, SURE, shown_probability
from pa10cal.results.record import EffectName
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.vocabulary import every_effect
from pa10cal.terms.field import Field
from pa10cal.terms.statement_faults import FAULTS
from pa10cal.terms.wrapped import OF

_JOINT = "joint "
#: Alternatives at other places that a sentence lists; of more it gives their number.
_MOST_OTHERS = 3
#: Joints that an error without a name mostly goes with: those with at least this part of the
#: largest share. More than two of them are only named where they are fewer than half of all.
_MAIN_SHARE = 0.3
#: Decimals of an error below 0.01 mm; one less above that, and above 0.1 mm.
_DECIMALS = 4


def headline(explained: Explained) -> str:
    """Return how much is explained and by what, in one line without a full stop."""
    if not explained.of or explained.share <= 0.0:
        return "none of the error beyond noise is explained"
    every = _groups(explained)
    groups = "; ".join(
        _noun_phrase(group) for group in _with_visible_gain(every, explained) or every
    )
    share = f"{percent(explained.share)} of the error beyond noise"
    return f"{share} is {explained_or_predicted(explained)}: {groups}"


def explained_or_predicted(explained: Explained) -> str:
    """Return the word `explained`, or `predicted` where some of the error has no name."""
    named = not any(each.has_no_name or _is_nameless(each) for each in explained.of)
    return "explained" if named else "predicted"


def sentences(explained: Explained) -> tuple[str, ...]:
    """Return a sentence for each group of effects: what it does, and the error before and after.

    None for a group without which the error would be the same, as it is written.
    """
    groups = [group for group in _groups(explained) if any(each.share > 0.0 for each in group)]
    shown = _with_visible_gain(groups, explained)
    return tuple(_sentence(group, explained.before_mm) for group in shown)


def interval_text(explained: Explained) -> str:
    """Return over how many such poses the share is known, in a sentence; empty if not known."""
    if explained.interval95 is None:
        return ""
    low, high = map(percent, explained.interval95)
    return f"Over other poses like the {explained.over} the share is from {low} to {high} (95 %)."


def percent(share: float) -> str:
    """Return a share in per cent; it is never rounded to all or nothing."""
    if 0.0 < share < 0.01:
        return "less than 1 %"
    if 0.99 < share < 1.0:
        return "more than 99 %"
    return f"{100.0 * share:.0f} %"


def sag_text(evidence: EvidenceOfSag) -> str:
    """Return how far a joint sags, which poses show whatever the weights of the arm."""
    u_mrad = HALF_WIDTH_95 * evidence.sag_u_mrad
    return f"sags by up to {evidence.sag_mrad:.2f} ± {u_mrad:.2g} mrad"


def parameters_text(parameters: Mapping[str, EffectParameter]) -> str:
    """Return parameters with their 95 % intervals in a line, those at knots of maps omitted."""
    return ", ".join(
        f"{key} = {entry.value:.4g} ± {HALF_WIDTH_95 * entry.std:.1g}{_behind(entry.unit)}"
        for key, entry in parameters.items()
        if not key.startswith(KNOT)
    )


def _behind(unit: str) -> str:
    """Return a unit as it stands behind a number; that of a plain number is nothing."""
    return "" if unit == "1" else f" {unit}"


def fault_text(fault: Fault) -> str:
    """Return a fault of a log in a line: where, what, and what to do about it."""
    return f"{fault.where}: {fault.what}; {fault.remedy}"


def noun_of(effect: str, *, many: bool = False) -> str:
    """Return what an effect is called, by its id, of one place or of several."""
    return _filled_in(_kind_of(effect).nouns, effect, "", many=many)


def clause_of(effect: str, at: str, *, many: bool = False) -> str:
    """Return what an effect does at one place, or at several, by its id."""
    return _filled_in(_kind_of(effect).clauses, effect, at, many=many)


def driver_of(effect: str, *, many: bool = False) -> str:
    """Return what an effect depends on, at one place or at several, by its id."""
    words = _kind_of(effect).varies_with
    return words.replace("its ", "their ") if many else words


def _filled_in(words: tuple[str, ...], effect: str, at: str, *, many: bool) -> str:
    return words[-1 if many else 0].format(id=effect.replace("_", " "), at=at)


def _kind_of(effect: str) -> type[Effect] | type[Field]:
    """Return the class of an effect; `Effect` for one that this version does not know."""
    kinds: tuple[type[Effect] | type[Field], ...] = (*every_effect(), *FAULTS, Field)
    return next((kind for kind in kinds if kind.id == effect), Effect)


def _is_sure(effect: ExplainedEffect) -> bool:
    """Return whether an effect is all but certain, or its probability is not known."""
    return effect.probability is None or effect.probability >= SURE


def _is_nameless(effect: ExplainedEffect) -> bool:
    """Return whether none of the names that an effect may have is as likely as none of them."""
    others = len(effect.ids[1:]) + len(effect.elsewhere)
    if effect.probability is None or len(effect.others_probability) != others:
        return False
    named = (effect.probability, *effect.others_probability)
    return 1.0 - sum(named) > max(named)


def _groups(explained: Explained) -> list[list[ExplainedEffect]]:
    """Return effects of one kind, as sure, with the same alternatives, the largest first."""
    groups: dict[object, list[ExplainedEffect]] = {}
    for effect in explained.of:
        at_joints = effect.of.startswith(_JOINT) and not effect.elsewhere
        key = (effect.ids, effect.weights) if at_joints else (effect.ids, effect.of)
        if effect.weights is not None:  # the same weights bend all of them, whatever the others
            key = (effect.ids[:1], effect.weights)
        how_sure = _is_sure(effect), _is_nameless(effect)
        groups.setdefault((*key, *how_sure), []).append(effect)
    return sorted(groups.values(), key=lambda group: -sum(effect.share for effect in group))


def _noun_phrase(group: list[ExplainedEffect]) -> str:
    """Return a group in a few words: `sensor or gear of joints 1 and 2`."""
    if group[0].joints is not None:
        mostly = _main_joints(group[0].joints)
        return noun_of(group[0].ids[0]) + (f" (mostly by {mostly})" if mostly else "")
    here, elsewhere = _candidates(group)
    if _is_nameless(group[0]):
        driver = driver_of(here[0].id, many=len(group) > 1)
        tried = _likeliest_names(here, elsewhere)
        return f"something without a name of {here[0].at}, by {driver} ({tried})"
    alone = not elsewhere and len(here) == 1
    many = len(group) > 1 and alone
    nouns = " or ".join(noun_of(each.id, many=many) for each in here)
    others = [_placed(noun_of(each.id), each.at) for each in elsewhere]
    if len(others) > _MOST_OTHERS:
        others = [f"one of {len(others)} others"]
    names = " or ".join([_placed(nouns, here[0].at), *others])
    if _is_sure(group[0]):
        return names
    noun = "" if alone else f"{noun_of(here[0].id)} "
    return f"{names} ({noun}{here[0].probability})"


@dataclass(frozen=True)
class _Candidate:
    """An effect that may be there."""

    id: str
    at: str  # its place in words
    # least and most: lowest and highest probability in a group; None where it is not known
    least: float | None
    most: float | None

    @property
    def probability(self) -> str:
        """Return its probability in words: `0.83`, or `0.28 to 0.42`; empty if not known."""
        if self.least is None or self.most is None:
            return ""
        least, most = shown_probability(self.least), shown_probability(self.most)
        return least if least == most else f"{least} to {most}"


def _candidates(group: list[ExplainedEffect]) -> tuple[list[_Candidate], list[_Candidate]]:
    """Return the effects that a group may be, at the place of the first one and elsewhere.

    The effect that was found comes first, unless another is likelier.
    """
    ids, elsewhere = _shared(group)
    first, at = group[0], _place_of_group(group)
    probabilities = [each.probability for each in group if each.probability is not None]
    others = [(id_, at) for id_ in ids[1:]]
    others += [(name.id, place_in_words(name.of)) for name in elsewhere]
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


def _likeliest_names(here: list[_Candidate], elsewhere: list[_Candidate]) -> str:
    """Return the likeliest names of something that is likelier none of them."""
    names = [f"{noun_of(each.id)} {each.probability}" for each in here]
    names += [f"{_placed(noun_of(each.id), each.at)} {each.probability}" for each in elsewhere]
    return ", ".join(names[:_MOST_OTHERS])


def place_in_words(of: str) -> str:
    """Return a place within a sentence: `joint 2`, `target A`, `the forearm`."""
    known = of.startswith((_JOINT, "target ", "the "))
    place, _, campaign = of.partition(OF)
    if known or not campaign:
        return of if known else f"the {of.replace('_', ' ')}"
    return f"the {place} of {campaign}"


def _place_of_group(group: list[ExplainedEffect]) -> str:
    """Return where a group sits: `joints 2 and 3`, `joint 2`, `the forearm`."""
    if len(group) == 1:
        return place_in_words(group[0].of)
    return _joints_text([each.of.removeprefix(_JOINT) for each in group])


def _main_joints(joints: Mapping[str, float]) -> str:
    """Return the joints that an error mostly goes with; empty where they are half of them."""
    least_share = _MAIN_SHARE * max(joints.values(), default=0.0)
    largest = [joint for joint, share in joints.items() if share >= least_share]
    some = len(largest) <= 2 or 2 * len(largest) < max(map(int, joints))
    return _joints_text(largest) if largest and some else ""


def _joints_text(numbers: list[str]) -> str:
    """Return joints in words: `joint 2`, `joints 2 and 3`."""
    *first, last = sorted(numbers, key=int)
    return f"joints {', '.join(first)} and {last}" if first else f"{_JOINT}{last}"


def _sentence(group: list[ExplainedEffect], whole_mm: float) -> str:
    """Return what a group does, and the error before and after it."""
    sentence = _statement(group)
    if group[0].weights is not None:
        more = "" if _shared(group)[0] == group[0].ids else "; alternatives are listed"
        sentence += f" (stiffness relative to assumed weights{more})"
    before, after = _errors(group, whole_mm)
    return f"{sentence[:1].upper()}{sentence[1:]}: {before} mm becomes {after} mm."


def _with_visible_gain(
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


def _statement(group: list[ExplainedEffect]) -> str:
    """Return what a group does, as sure as that is, without a full stop."""
    here, elsewhere = _candidates(group)
    many = len(group) > 1
    if _is_nameless(group[0]):
        driver = driver_of(here[0].id, many=many)
        at, tried = here[0].at, _likeliest_names(here, elsewhere)
        return f"at {at} something without a name depends on {driver} ({tried})"
    clauses = [(clause_of(each.id, each.at, many=many), each.probability) for each in here]
    clauses += [(clause_of(each.id, each.at), each.probability) for each in elsewhere]
    if len(elsewhere) > _MOST_OTHERS:
        clauses[len(here) :] = [(f"one of {len(elsewhere)} other effects is there", "")]
    if (joints := group[0].joints) is not None:
        mostly = _main_joints(joints)
        return clauses[0][0] + (f", mostly by {mostly}" if mostly else "")
    if _is_sure(group[0]):
        return ", or ".join(clause for clause, _ in clauses)
    shown = [f"that {clause}" + (f" ({p})" if p else "") for clause, p in clauses]
    return f"it may be {', or '.join(shown)}"
