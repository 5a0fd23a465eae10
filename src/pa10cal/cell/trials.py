"""Trials: campaigns drawn at random, each with what it hides, to put a verdict to the test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from pa10cal.cell.campaign import INSTRUMENT_UNCERTAINTY_MM
from pa10cal.cell.references import (
    DRIFT_C,
    OUTSIDE_REFERENCES,
    REFERENCES,
    ROBOT,
    Layout,
    Reference,
    Site,
)
from pa10cal.errors import SettingsError
from pa10cal.settings import SimulateSettings, parse_section

TrialKind = Literal["null", "single", "pair", "triple", "outside", "wrong_noise", "wrong_mass"]
KINDS: tuple[TrialKind, ...] = get_args(TrialKind)

#: Factors of the reference size, drawn evenly in their logarithm.
SINGLE_SIZES = (0.1, 3.0)
OTHER_SIZES = (0.7, 3.0)
#: Repeats, so that the 60 poses of the wide layout take no longer than the 27 of the grid.
REPEATS: dict[Layout, int] = {"grid": 10, "wide": 4}
#: Attitudes are drawn with seeds from 1 to these. Of the grid's, about one in ten beyond asks for a
#: pose out of reach.
TILT_SEEDS: dict[Layout, int] = {"grid": 20, "wide": 2**31 - 1}
#: Part of the trials without thermal growth in which the temperature drifts all the same.
DRIFTING = 1.0 / 3.0
#: By what factor, up or down, a wrong statement of the instrument is wrong.
NOISE_FACTORS = (1.5, 4.0)
#: By what part, more or less, the mass of one link is wrong. The first link loads no joint.
MASS_EXCESS = (0.1, 0.3)
LINKS = 6

#: Kinds that go through their effects one after the other.
_IN_TURN: dict[TrialKind, dict[str, Reference]] = {
    "single": REFERENCES,
    "outside": OUTSIDE_REFERENCES,
}
_MEMBERS: dict[TrialKind, int] = {"single": 1, "outside": 1, "pair": 2, "triple": 3}


@dataclass(frozen=True)
class Trial:
    """One campaign to be judged without its truth.

    Attributes:
        name: of the campaign; gives nothing away.
        kind: `null`: nothing hidden; `single`, `pair`, `triple`: so many effects of the
            vocabulary; `outside`: one that has no name in it; `wrong_noise`, `wrong_mass`: nothing
            hidden, but the campaign states a wrong uncertainty, or a link has another mass than
            the arm's description says.
        settings: what the virtual cell is to do, with the hidden effects.
        sizes: one a hidden effect: factor of its reference size.
    """

    name: str
    kind: TrialKind
    settings: SimulateSettings
    sizes: tuple[float, ...]

    @property
    def size(self) -> float:
        """The smallest of `sizes`, 0 where nothing is hidden."""
        return min(self.sizes, default=0.0)


def draw_trials(
    kind: TrialKind,
    count: int,
    random_seed: int,
    layouts: Sequence[Layout] = ("grid", "wide"),
    size: float | None = None,
) -> tuple[Trial, ...]:
    """Draw trials of one kind; the same arguments give the same trials.

    Every trial has a robot, a layout's attitudes and noise of its own. Singles go through the
    vocabulary in turn, trials outside of it through what it lacks; the layouts take turns as well,
    and from one round of the effects to the next, so that each effect meets every layout.
    Trials of a smaller count are the first of a larger one.

    Args:
        kind: what they hide.
        count: how many.
        random_seed: draws them.
        layouts: layouts of the poses.
        size: factor of the reference size of all effects; None draws it. It changes nothing else.

    Raises:
        SettingsError: for a kind that does not exist.
    """
    if kind not in KINDS:
        raise SettingsError(
            "unknown kind of trial",
            where="kind",
            value=kind,
            allowed=", ".join(KINDS),
            remedy="name one of these",
        )
    return tuple(
        _draw(kind, number, random_seed, _layout(kind, number, layouts), size)
        for number in range(count)
    )


def _layout(kind: TrialKind, number: int, layouts: Sequence[Layout]) -> Layout:
    turn, place = 0, number
    if kind in _IN_TURN:
        turn, place = divmod(number, len(_IN_TURN[kind]))
    return layouts[(turn + place) % len(layouts)]


def _draw(
    kind: TrialKind, number: int, random_seed: int, layout: Layout, size: float | None
) -> Trial:
    rng = np.random.default_rng([random_seed, KINDS.index(kind), number])
    seed = int(rng.integers(2**31))
    tilt_seed = int(rng.integers(1, TILT_SEEDS[layout], endpoint=True))
    path = str(rng.choice(["same", "alternating"]))
    drifts = bool(rng.random() < DRIFTING)
    hidden, sizes = _hidden(kind, number, layout, size, rng)
    grows = any(effect["id"] == "thermal_growth" for effect in hidden)
    raw = {
        "random_seed": seed,
        "robot": ROBOT,
        "built": "drawn",
        "hidden_effects": hidden,
        "path": path,
        "repeats": REPEATS[layout],
        "temperature_drift_C": DRIFT_C if drifts or grows else 0.0,
        "poses": {"layout": layout, "tilt_seed": tilt_seed},
        **_misstated(kind, rng),
    }
    settings = parse_section(SimulateSettings, raw, where=f"trial {number}")
    return Trial(f"blind-{seed:08x}", kind, settings, sizes)


def _hidden(
    kind: TrialKind, number: int, layout: Layout, size: float | None, rng: np.random.Generator
) -> tuple[list[dict[str, Any]], tuple[float, ...]]:
    """Draw the hidden effects, none twice at one place, and their sizes."""
    references = _IN_TURN.get(kind, REFERENCES)
    ids = list(references)
    bounds = SINGLE_SIZES if kind == "single" else OTHER_SIZES
    hidden: list[dict[str, Any]] = []
    sizes: list[float] = []
    while len(hidden) < _MEMBERS.get(kind, 0):
        name = ids[number % len(ids)] if kind in _IN_TURN else str(rng.choice(ids))
        drawn = float(np.exp(rng.uniform(*np.log(bounds))))
        factor = drawn if size is None else size
        effect = _effect(name, references[name], layout, factor, rng)
        if all((effect["id"], effect["of"]) != (other["id"], other["of"]) for other in hidden):
            hidden.append(effect)
            sizes.append(factor)
    return hidden, tuple(sizes)


def _effect(
    name: str, reference: Reference, layout: Layout, size: float, rng: np.random.Generator
) -> dict[str, Any]:
    site = Site(str(rng.choice(reference.places)), layout)
    return {"id": name, "of": site.of, "parameters": reference.draw(site, size, rng)}


def _misstated(kind: TrialKind, rng: np.random.Generator) -> dict[str, Any]:
    """Draw what a campaign of this kind states wrongly."""
    up = float(rng.choice([-1.0, 1.0]))
    if kind == "wrong_noise":
        factor = float(np.exp(up * rng.uniform(*np.log(NOISE_FACTORS))))
        return {"stated_uncertainty_mm": INSTRUMENT_UNCERTAINTY_MM * factor}
    if kind == "wrong_mass":
        factors = np.ones(LINKS)
        factors[rng.integers(1, LINKS)] += up * rng.uniform(*MASS_EXCESS)
        return {"mass_factor": factors.tolist()}
    return {}
