"""Errors of every model over fitted and held-out poses, as page and summaries give them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.calibration import UNRESERVED
from pa10cal.results.evaluation import BETWEEN, UNSEEN, Accuracy, PartAccuracy, flagged

FITTED, HELD_OUT, ALL = "fitted", "held out", "all"
#: Models in words; one alone of those with springs is called `calibrated`.
_MODELS = {
    "uncalibrated": "not calibrated",
    "geometry": "calibrated, geometry alone",
    "linear": "calibrated, linear springs",
    "cubic": "calibrated, cubic springs",
    "extended": "with the effects found",
    "with_rivals": "with rivals without a name too, not written",
}
_PARTS = {
    "inside": "angles seen in the fit",
    "extrapolated": "extrapolated",
    "trusted": "without readings far from the model",
    "unseen": UNSEEN,
    "between": BETWEEN,
    "without_motion": "the motion of the base taken out",
}

_PLACES = ("unseen", "between")
#: Factor between held-out errors of the paper's and the general model that a reader is told.
_FAR_BETTER = 2.0


@dataclass(frozen=True)
class Errors:
    """Errors of one model over some configurations."""

    poses: str  # `fitted` or `held out`
    load: str  # `all`, or a load such as `22N`
    name: str  # of the model in the records
    model: str  # as readers see it, with the part
    of: Accuracy  # the errors
    part: str = ALL  # or a part of the configurations, of `_PARTS`
    # those without readings far from the model, of all or of a place; None where none is far
    trusted: Accuracy | None = None
    beside: Accuracy | None = None  # of `unseen`, those of `between`; None where none is

    @property
    def kind(self) -> str:
        """Return which poses they are of, as it stands before a noun."""
        return self.poses.replace(" ", "-")

    @property
    def where(self) -> str:
        """Return in words where the poses lie; empty where they are well apart."""
        return _PARTS[self.part] if self.part in _PLACES else ""

    @property
    def over(self) -> str:
        """Return in words over which poses they are, and what is stated beside them."""
        beside = self.beside and f"; {self.beside.mean_mm:.3f} mm {BETWEEN}"
        return f"{self.kind} poses{' ' * bool(self.where)}{self.where}{beside or ''}"

    @property
    def counted(self) -> Accuracy:
        """Return the errors that a headline gives: without readings far from the model."""
        return self.trusted or self.of

    def with_flagged(self, key: str) -> str:
        """Return what a headline adds: `rms_mm` or `mean_mm` with flagged readings, if any."""
        if self.trusted is None:
            return ""
        count = self.of.configurations - self.trusted.configurations
        return f"with {flagged(count)} {getattr(self.of, key):.3f} mm"


def errors_of(results: ResultsBundle) -> list[Errors]:
    """Return the errors of every model, over all loads first, then load by load."""
    every = [*_fitted(results), *_held_out(results)]
    return sorted(every, key=lambda errors: errors.load != ALL)


def headline(results: ResultsBundle) -> tuple[Errors, Errors] | None:
    """Return the errors before and after that count: held out where there are such poses.

    Of poses along a path those at unseen stretches.
    """
    every = [
        errors
        for errors in errors_of(results)
        if errors.load == ALL and errors.name != "with_rivals"
    ]
    for poses, part in (
        (HELD_OUT, "unseen"),
        (HELD_OUT, "between"),
        (HELD_OUT, ALL),
        (FITTED, ALL),
    ):
        if counted := [each for each in every if (each.poses, each.part) == (poses, part)]:
            return counted[0], counted[-1]
    return None


def better_general(results: ResultsBundle) -> str | None:
    """Return in words that the general model beside the paper's predicts far better.

    The paper's model takes the tool as stated. None where nothing was held out, where the general
    model is not there, or where with the effects found the paper's model comes near it.
    """
    paper, general, ends = results.calibration, results.general_beside, headline(results)
    if paper is None or general is None or ends is None or ends[1].poses != HELD_OUT:
        return None
    general_mm, after_mm = general.health.held_out_rms_mm, ends[1].counted.rms_mm
    sound = general.health.grade in UNRESERVED
    if not sound or general_mm is None or _FAR_BETTER * general_mm > after_mm:
        return None
    return (
        f"the general model of this run, which calibrates the tool too, leaves {general_mm:.3f} mm "
        f"rms over held-out poses, the paper's with what was found {after_mm:.3f} mm: set "
        "calibration.model to general to have it evaluated and exported"
    )


def model_titles(results: ResultsBundle, names: Iterable[str]) -> dict[str, str]:
    """Return what readers call models that are compared, without the same one once more."""
    titles = {name: _MODELS[name] for name in names}
    if results.verdict is not None and not results.verdict.effects:
        titles.pop("extended", None)
    if not {"geometry", "cubic"} & set(titles) and "linear" in titles:
        titles["linear"] = "calibrated"
    return titles


def _fitted(results: ResultsBundle) -> Iterator[Errors]:
    if (record := results.calibration) is None:
        return
    keys = {"uncalibrated": "before", "geometry": "geometry"}
    keys["cubic" if record.model == "paper" else "linear"] = "after"
    if record.model == "paper" or not record.has_springs:
        del keys["geometry"]
    for name, title in model_titles(results, keys).items():
        by_load = {load: getattr(of, keys[name]) for load, of in record.errors.items()}
        less = {load: getattr(of.trusted, keys[name], None) for load, of in record.errors.items()}
        trusted = _together([less[load] or of for load, of in by_load.items()])
        some = {"trusted": trusted if any(less.values()) else None}
        yield from _model(FITTED, name, title, _together([*by_load.values()]), by_load, some)
    if results.verdict is not None and results.verdict.effects:
        gap = results.verdict.gap.train
        pairs = {"inside": gap.inside, "extrapolated": gap.outside}
        pairs |= {"without_motion": gap.without_motion}
        per_load = {load: part.after for load, part in gap.per_load.items()}
        parts = {part: pair.after for part, pair in pairs.items() if pair is not None}
        yield from _model(FITTED, "extended", _MODELS["extended"], gap.after, per_load, parts)
        yield from _with_rivals(FITTED, gap.with_rivals)


def _held_out(results: ResultsBundle) -> Iterator[Errors]:
    models = {} if results.held_out is None else results.held_out.models
    gap = None if results.verdict is None else results.verdict.gap.holdout
    for name, title in model_titles(results, models).items():
        model = models[name]
        parts = {"inside": model.inside, "extrapolated": model.outside, "trusted": model.trusted}
        parts |= {"unseen": model.unseen, "between": model.between}
        if name == "extended" and gap is not None and gap.without_motion is not None:
            parts["without_motion"] = gap.without_motion.after
        yield from _model(HELD_OUT, name, title, model, model.per_load, parts)
    if models and gap is not None:
        yield from _with_rivals(HELD_OUT, gap.with_rivals)


def _with_rivals(poses: str, of: Accuracy | None) -> Iterator[Errors]:
    if of is not None:
        yield Errors(poses, ALL, "with_rivals", _MODELS["with_rivals"], of)


def _model(
    poses: str,
    name: str,
    title: str,
    of: Accuracy,
    per_load: Mapping[str, Accuracy],
    parts: Mapping[str, Accuracy | None],
) -> Iterator[Errors]:
    """Yield errors over all configurations, over parts of them and at each load."""
    yield Errors(poses, ALL, name, title, of, trusted=parts.get("trusted"))
    for part, within in parts.items():
        if within is not None:
            trusted = within.trusted if isinstance(within, PartAccuracy) else None
            beside = parts.get("between") if part == "unseen" else None
            yield Errors(
                poses, ALL, name, f"{title}, {_PARTS[part]}", within, part, trusted, beside
            )
    for load, at_load in per_load.items():
        yield Errors(poses, load, name, title, at_load)


def _together(parts: list[Accuracy]) -> Accuracy:
    """Return errors over several sets of configurations as over all of them."""
    count = np.array([part.configurations for part in parts])
    share = count / count.sum()
    angles = [part.orientation_deg for part in parts if part.orientation_deg is not None]
    return Accuracy(
        mean_mm=float(share @ [part.mean_mm for part in parts]),
        rms_mm=float(np.sqrt(share @ [part.rms_mm**2 for part in parts])),
        peak_mm=max(part.peak_mm for part in parts),
        orientation_deg=float(share @ angles) if len(angles) == len(parts) else None,
        configurations=int(count.sum()),
    )
