"""How much of the error beyond noise the effects found explain, and that in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from pa10cal.results.evaluation import EffectParameter
from pa10cal.results.record import EffectName, Key, Part, optional

# Formulas proposed for what has no name.


class ProposedEvidence(Part):
    """How blocks of poses are predicted that were left out of the fit.

    Squared errors are weighed: where repeats are the judge, a row of noise alone leaves 1.
    """

    blocks: int  # blocks of poses, each left out in turn
    rows: int  # weighed components of all of them
    squared_error_without: float  # their squared error with nothing instead
    squared_error_with: float  # their squared error with the formula
    # their squared error with what it does as well as; null where that is noise
    squared_error_held: float | None
    gain_std: float  # standard error of `gain`


class ProposedFormula(Part):
    """A short formula that does as well as something without a name; no effect is named by it."""

    formula: str  # the form, in words a reader can type
    of: str  # where it sits
    form: str  # which of the forms tried, as `harmonic` or `torque_cubed`
    # what fixes the form besides its parameters: orders, thresholds, axes from 0
    numbers: tuple[float, ...]
    # lowest and highest order, in cycles a turn, that does as well
    orders: tuple[int, int] | None = optional()
    parameters: Mapping[Annotated[str, Key("parameter")], EffectParameter]  # its parameters
    gain: float  # part of the squared error of blocks of poses left out that it takes away
    # maps and smooth unknown functions in whose place it was tried; none where it leaves no more
    # than noise
    does_as_well_as: tuple[EffectName, ...]
    others: tuple[str, ...]  # other formulas, none of them shorter, that do as well
    evidence: ProposedEvidence  # what decided


#: Short nouns of effects whose id is none, in the plural where they have one.
_NOUNS: Mapping[str, tuple[str, str]] = {
    "gear_error": ("gear", "gears"),
    "gear_ratio_error": ("gear ratio", "gear ratios"),
    "joint_compliance": ("spring", "springs"),
    "joint_error_map": ("error by the angle", "errors by the angle"),
    "load_stated": ("load as stated", "loads as stated"),
    "sensor_error": ("sensor", "sensors"),
    "tool_stated": ("tool as stated", "tools as stated"),
}
#: What effects do at a place or, with `_WORDS`, at several joints.
_CLAUSES: Mapping[str, str] = {
    "arrival_error": "{at} stop{v} in {another} place{s} for each direction that {it} come{v} from",
    "backlash": "{at} {has} lost motion",
    "encoder_eccentricity": "the position sensor{s} of {at} {is_} off centre",
    "encoder_ellipticity": "the position sensor{s} of {at} err{v} twice a turn",
    "friction_torque": "the logged torque{s} of {at} hold{v} friction",
    "gear_error": "the gear{s} of {at} {is_} uneven",
    "gear_ratio_error": "the gear ratio{s} of {at} {is_} off",
    "joint_compliance": "{at} give{v} way under the arm's weight",
    "joint_error_map": "{at} turn{v} wrongly by {an}amount{s} that depend{v} on {its} angle{s}",
    "periodic_error": "{at} turn{v} wrongly in even waves of {its} angle{s}",
    "sensor_error": "the position sensor{s} of {at} err{v} with {its} angle{s}",
    "scale": "the instrument's scale is off",
    "soft_windup": "{at} {is_} softer near zero torque",
    "torque_gain": "the logged torque{s} of {at} {is_} off by {a}factor{s}",
    "transmission_error": "the gear{s} of {at} err{v} twice a turn of {its} motor{s}",
    # of effects that sit at one place
    "along_move": "the log of joints and the readings are not of one instant",
    "base_compliance": "the base tilts under the arm's weight",
    "base_drift": "the base moved while the campaign lasted",
    "cmm_scale": "the scales of the instrument's axes are off",
    "cmm_squareness": "the instrument's axes are not square",
    "link_bending": "{at} bends under load",
    "link_torsion": "{at} twists under load",
    "load_stated": "a load is not what is stated",
    "thermal_growth": "the links grow with temperature",
    "tool_sag": "the tool sags under its weight",
    "tool_stated": "the tool is not what is stated",
    "wrist_coupling": "the last joint is turned along by the one before it",
}
#: Words of those clauses, of one place and of several.
_WORDS: Mapping[str, tuple[str, str]] = {
    "s": ("", "s"),
    "v": ("s", ""),
    "is_": ("is", "are"),
    "has": ("has", "have"),
    "it": ("it", "they"),
    "its": ("its", "their"),
    "a": ("a ", ""),
    "an": ("an ", ""),
    "another": ("another", "other"),
}
_JOINT = "joint "
#: With more alternatives at other places a sentence says how many.
_MOST_OTHERS = 3
#: Decimals of an error below 0.01 mm; of larger ones fewer.
_DECIMALS = 4


class ExplainedEffect(Part):
    """What one effect takes away of the error."""

    ids: tuple[str, ...]  # id of the effect, then of its alternatives at the same place
    of: str  # where it sits: `joint 2`, `forearm`, `base`, ...
    # alternatives at other places; not given where there is none
    elsewhere: tuple[EffectName, ...] = Field(default=(), exclude_if=lambda value: not value)
    # `assumed` where its size is known relative to weights that nobody stated
    weights: Literal["assumed"] | None = optional()
    share: float  # part of the variance of the error beyond noise that it takes away, 0 to 1
    before_mm: float  # root mean square error without it alone, all else fitted again [mm]
    after_mm: float  # root mean square error with all effects [mm]


class Explained(Part):
    """How much of the error beyond noise is explained, and by what."""

    # part of the variance of the position error beyond noise that the model loses by the effects, 0
    # to 1
    share: float
    # what each effect takes away, the largest share first; shares sum to `share`
    of: tuple[ExplainedEffect, ...]
    without_a_name: float  # part that remains, 1 less `share`
    # poses that it is counted over: held out, where any were
    over: Literal["held-out poses", "fitted poses"]
    before_mm: float  # root mean square error of the model without them [mm]
    after_mm: float  # root mean square error of the model with all of them [mm]
    noise_mm: float  # root mean square error that noise alone would leave [mm]

    @property
    def percent(self) -> str:
        """Return the share in per cent; all and nothing are never claimed by rounding."""
        return percent(self.share)

    @property
    def headline(self) -> str:
        """Return how much is explained and by what, in one line without a full stop."""
        if not self.of or self.share <= 0.0:
            return "none of the error beyond noise is explained"
        told = "; ".join(_short(group) for group in self._groups())
        return f"{self.percent} of the error beyond noise is explained: {told}"

    @property
    def sentences(self) -> tuple[str, ...]:
        """Return what each group of effects does, in plain words, and what it takes away."""
        groups = [group for group in self._groups() if any(each.share > 0.0 for each in group)]
        return tuple(_sentence(group, self.before_mm) for group in groups)

    def _groups(self) -> list[list[ExplainedEffect]]:
        """Return effects of one kind with the same alternatives together, the largest first."""
        groups: dict[object, list[ExplainedEffect]] = {}
        for each in self.of:
            joined = each.of.startswith(_JOINT) and not each.elsewhere
            key = (each.ids, each.weights) if joined else (each.ids, each.of)
            if each.weights is not None:  # one weight bends all of them, whatever else is possible
                key = (each.ids[:1], each.weights)
            groups.setdefault(key, []).append(each)
        return sorted(groups.values(), key=lambda group: -sum(each.share for each in group))


def percent(share: float) -> str:
    """Return a share in per cent; all and nothing are never claimed by rounding."""
    if 0.0 < share < 0.01:
        return "less than 1 %"
    if 0.99 < share < 1.0:
        return "more than 99 %"
    return f"{100.0 * share:.0f} %"


def _short(group: list[ExplainedEffect]) -> str:
    """Return a group in a few words: `sensor or gear of joints 1 and 2`."""
    ids, elsewhere = _shared(group)
    many = len(group) > 1 and len(ids) == 1
    nouns = " or ".join(_noun(each, many=many) for each in ids)
    others = [_placed(_noun(each.id), _place(each.of)) for each in elsewhere]
    if len(others) > _MOST_OTHERS:
        others = [f"one of {len(others)} others"]
    return " or ".join([_placed(nouns, _at(group)), *others])


def _shared(group: list[ExplainedEffect]) -> tuple[tuple[str, ...], tuple[EffectName, ...]]:
    """Return the ids, and the alternatives elsewhere, that a group has in common."""
    first = group[0]
    if any((each.ids, each.elsewhere) != (first.ids, first.elsewhere) for each in group):
        return first.ids[:1], ()
    return first.ids, first.elsewhere


def _placed(nouns: str, at: str) -> str:
    """Return nouns with their place, where they do not say it: `tool sag`, `sensor of joint 1`."""
    return nouns if at.removeprefix("the ") in nouns.split() else f"{nouns} of {at}"


def _place(of: str) -> str:
    """Return a place within a sentence: `joint 2`, `the forearm`."""
    return of if of.startswith(_JOINT) else f"the {of.replace('_', ' ')}"


def _noun(effect: str, *, many: bool = False) -> str:
    words = effect.replace("_", " ")
    return _NOUNS.get(effect, (words, words))[many]


def _sentence(group: list[ExplainedEffect], whole_mm: float) -> str:
    ids, elsewhere = _shared(group)
    clauses = [_clause(effect, _at(group), many=len(group) > 1) for effect in ids]
    if len(elsewhere) > _MOST_OTHERS:
        clauses.append(f"one of {len(elsewhere)} other effects is there")
    else:
        clauses += [_clause(other.id, _place(other.of)) for other in elsewhere]
    told = ", or ".join(clauses)
    if group[0].weights is not None:
        more = "" if ids == group[0].ids else "; alternatives are listed"
        told += f" (stiffness relative to assumed weights{more})"
    after_mm = min(each.after_mm for each in group)
    taken = sum(max(each.before_mm**2 - each.after_mm**2, 0.0) for each in group)
    most_mm = max(whole_mm, *(each.before_mm for each in group))
    before_mm = min((after_mm**2 + taken) ** 0.5, most_mm)
    places = _DECIMALS - min(int(after_mm >= 0.01) + int(after_mm >= 0.1), _DECIMALS)
    fall = f"{before_mm:.{places}f} mm becomes {after_mm:.{places}f} mm"
    return f"{told[:1].upper()}{told[1:]}: {fall}."


def _clause(effect: str, at: str, *, many: bool = False) -> str:
    clause = _CLAUSES.get(effect, f"there is {effect.replace('_', ' ')} of {{at}}")
    return clause.format(at=at, **{key: of[many] for key, of in _WORDS.items()})


def _at(group: list[ExplainedEffect]) -> str:
    """Return where a group sits: `joints 2 and 3`, `joint 2`, `the forearm`."""
    if len(group) == 1:
        return _place(group[0].of)
    *first, last = sorted((each.of.removeprefix(_JOINT) for each in group), key=int)
    return f"joints {', '.join(first)} and {last}"
