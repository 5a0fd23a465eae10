"""Errors of every model over fitted and held-out poses, as page and summaries give them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.calibration import UNRESERVED
from pa10cal.results.evaluation import BETWEEN, UNSEEN, Accuracy, PartAccuracy, flagged

FITTED, HELD_OUT, ALL = "fitted", "held out", "all"
#: Models in words; where there is one model with springs, it is called `calibrated`.
_TITLES = {
    "uncalibrated": "not calibrated",
    "geometry": "calibrated, geometry alone",
    "linear": "calibrated, linear springs",
    "cubic": "calibrated, cubic springs",
    "extended": "with the effects found",
    "with_rivals": "with rivals without a name too, not written",
}
#: Titles of the extended model where nothing that it adds has a name.
_WITHOUT_A_NAME = "with what has no name predicted"
_WITH_WEIGHTS = "with the weights that the poses show"
#: Parts of the configurations in words.
_PARTS = {
    "inside": "angles seen in the fit",
    "extrapolated": "extrapolated",
    "trusted": "without readings far from the model",
    "unseen": UNSEEN,
    "between": BETWEEN,
    "without_motion": "the motion of the base taken out",
}
#: Parts that are places on a path.
_PLACES = ("unseen", "between")
#: Factor between held-out errors of the paper's and the general model that a reader is told.
_FAR_BETTER = 2.0
#: Poses and part whose errors count as those of the campaign, the first of which there are any.
_BY_PRECEDENCE = ((HELD_OUT, "unseen"), (HELD_OUT, "between"), (HELD_OUT, ALL), (FITTED, ALL))


@dataclass(frozen=True)
class ModelErrors:
    """Errors of one model over some configurations."""

    poses: str  # `fitted` or `held out`
    load: str  # `all`, or a load such as `22N`
    name: str  # of the model in the records
    title: str  # the model, and the part, in words
    accuracy: Accuracy  # the errors
    part: str = ALL  # part of the configurations, a key of `_PARTS`; `all` for all of them
    # errors without configurations that have a reading far from the model; None if none is far
    trusted: Accuracy | None = None
    between: Accuracy | None = None  # of the part `unseen`: errors of the part `between`, if any

    @property
    def kind(self) -> str:
        """Return which poses they are of, as an adjective."""
        return self.poses.replace(" ", "-")

    @property
    def where(self) -> str:
        """Return in words where on a path the poses lie; empty where they are no path."""
        return _PARTS[self.part] if self.part in _PLACES else ""

    @property
    def over(self) -> str:
        """Return in words which poses they are of, with the mean error between measured places."""
        text = " ".join(filter(None, (f"{self.kind} poses", self.where)))
        return text if self.between is None else f"{text}; {self.between.mean_mm:.3f} mm {BETWEEN}"

    @property
    def counted(self) -> Accuracy:
        """Return the errors that a headline gives: without readings far from the model."""
        return self.trusted or self.accuracy

    def with_flagged(self, key: str) -> str:
        """Return in words the `rms_mm` or `mean_mm` with readings far from the model, if any."""
        if self.trusted is None:
            return ""
        count = self.accuracy.configurations - self.trusted.configurations
        return f"with {flagged(count)} {getattr(self.accuracy, key):.3f} mm"


def errors_of(results: ResultsBundle) -> list[ModelErrors]:
    """Return the errors of every model, over all loads first, then load by load."""
    every = [*_fitted(results), *_held_out(results)]
    return sorted(every, key=lambda errors: errors.load != ALL)


def headline(results: ResultsBundle) -> tuple[ModelErrors, ModelErrors] | None:
    """Return the errors before and after, over the poses that count; None without any errors.

    Held-out poses count where there are any; on a path those at stretches that were not fitted.
    """
    by_poses: dict[tuple[str, str], list[ModelErrors]] = {}
    for errors in errors_of(results):
        if errors.load == ALL and errors.name != "with_rivals":
            by_poses.setdefault((errors.poses, errors.part), []).append(errors)
    for poses_and_part in _BY_PRECEDENCE:
        if counted := by_poses.get(poses_and_part):
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
    """Return the title of each model to compare: the extended one only where it adds anything."""
    titles = {name: _TITLES[name] for name in names}
    verdict = results.verdict
    if verdict is not None and not verdict.adds_to_calibrated:
        titles.pop("extended", None)
    elif "extended" in titles and verdict is not None and not verdict.effects:
        titles["extended"] = _WITHOUT_A_NAME if verdict.predicts_nameless else _WITH_WEIGHTS
    if not {"geometry", "cubic"} & set(titles) and "linear" in titles:
        titles["linear"] = "calibrated"
    return titles


def _fitted(results: ResultsBundle) -> Iterator[ModelErrors]:
    """Yield the errors over fitted poses, of the calibration's models and the extended one."""
    if (record := results.calibration) is None:
        return
    keys = {"uncalibrated": "before", "geometry": "geometry"}
    keys["cubic" if record.model == "paper" else "linear"] = "after"
    if record.model == "paper" or not record.has_springs:
        del keys["geometry"]
    for name, title in model_titles(results, keys).items():
        by_load: dict[str, Accuracy] = {}
        trusted_by_load: dict[str, Accuracy | None] = {}
        for load, errors in record.errors.items():
            by_load[load] = getattr(errors, keys[name])
            trusted_by_load[load] = getattr(errors.trusted, keys[name], None)
        trusted = None
        if any(trusted_by_load.values()):
            trusted = _pooled([trusted_by_load[load] or by_load[load] for load in by_load])
        whole = _pooled(list(by_load.values()))
        yield from _of_model(FITTED, name, title, whole, by_load, {"trusted": trusted})
    if results.verdict is not None and results.verdict.adds_to_calibrated:
        gap = results.verdict.gap.train
        pairs = {
            "inside": gap.inside,
            "extrapolated": gap.outside,
            "without_motion": gap.without_motion,
        }
        parts = {part: pair.after for part, pair in pairs.items() if pair is not None}
        by_load = {load: pair.after for load, pair in gap.per_load.items()}
        title = model_titles(results, ["extended"])["extended"]
        yield from _of_model(FITTED, "extended", title, gap.after, by_load, parts)
        yield from _with_rivals(FITTED, gap.with_rivals)


def _held_out(results: ResultsBundle) -> Iterator[ModelErrors]:
    """Yield the errors over held-out poses, of every model that was evaluated."""
    models = {} if results.held_out is None else results.held_out.models
    gap = None if results.verdict is None else results.verdict.gap.holdout
    for name, title in model_titles(results, models).items():
        model = models[name]
        parts = {
            "inside": model.inside,
            "extrapolated": model.outside,
            "trusted": model.trusted,
            "unseen": model.unseen,
            "between": model.between,
        }
        if name == "extended" and gap is not None and gap.without_motion is not None:
            parts["without_motion"] = gap.without_motion.after
        yield from _of_model(HELD_OUT, name, title, model, model.per_load, parts)
    if models and gap is not None:
        yield from _with_rivals(HELD_OUT, gap.with_rivals)


def _with_rivals(poses: str, accuracy: Accuracy | None) -> Iterator[ModelErrors]:
    if accuracy is not None:
        yield ModelErrors(poses, ALL, "with_rivals", _TITLES["with_rivals"], accuracy)


def _of_model(
    poses: str,
    name: str,
    title: str,
    whole: Accuracy,
    by_load: Mapping[str, Accuracy],
    parts: Mapping[str, Accuracy | None],
) -> Iterator[ModelErrors]:
    """Yield the errors of a model over all configurations, over parts of them and at each load."""
    yield ModelErrors(poses, ALL, name, title, whole, trusted=parts.get("trusted"))
    for part, accuracy in parts.items():
        if accuracy is not None:
            yield ModelErrors(
                poses,
                ALL,
                name,
                f"{title}, {_PARTS[part]}",
                accuracy,
                part,
                trusted=accuracy.trusted if isinstance(accuracy, PartAccuracy) else None,
                between=parts.get("between") if part == "unseen" else None,
            )
    for load, accuracy in by_load.items():
        yield ModelErrors(poses, load, name, title, accuracy)


def _pooled(parts: list[Accuracy]) -> Accuracy:
    """Return the errors over the union of several sets of configurations."""
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
