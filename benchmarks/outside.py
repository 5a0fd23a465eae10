"""Effects that no name covers: what the readings hold of each, and what is told of it.

`python -m benchmarks.outside [--measured tracked] [--count 24] [--first 0] [--seed 1]` draws the
trials that `pa10cal blind_trials --kind outside` draws. In each of them it measures the same
campaign once more without the effect, noise included. The difference of the readings is the true
pattern of the effect. It joins the parameters of the calibrated model as one more column, with an
amplitude that is free. What it gains then, nobody who does not know the pattern can surpass:

- in the likelihood, in nats: below 5 it is no evidence of anything, whoever looks;
- in the squares of held-out blocks: below what any candidate must gain (three standard errors over
  blocks, and more than the best of all by chance) no search with that error rate finds it.

Of all others it is a fault of the search if their place is not told.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pa10cal.arrays import Array, Index, standard_error_of_sum
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.read import Campaign
from pa10cal.command_settings import ChainOptions
from pa10cal.commands.command_line import limit_threads
from pa10cal.discovery.blocked_cv.block_rows import BlockedRows, weighted_rows
from pa10cal.discovery.blocked_cv.effect_set import surely_helps
from pa10cal.discovery.blocked_cv.family import computable_shapes
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.preparation import Prepared, prepared, setup_of
from pa10cal.discovery.proof import needed_nats
from pa10cal.discovery.rules import BLOCKS, MAPS
from pa10cal.files.arms import load_arm
from pa10cal.interface import calibrate, read_campaign
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.options import DiscoveryOptions
from pa10cal_lab import trial_names
from pa10cal_lab.blind_trial import OUTSIDE, BlindTrial
from pa10cal_lab.blind_trials import try_trial
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.scenario import Trial
from pa10cal_lab.cell.trials import draw_trials
from pa10cal_lab.cell.write import write_campaign

#: Gain in nats below which data are no evidence of an effect, though its pattern be known.
NO_EVIDENCE = 5.0
_STUDIES = ("tracked", "points_one", "points_three", "distance")


@dataclass(frozen=True)
class Gain:
    """What the true pattern of an effect gains, beside the parameters of the calibrated model."""

    nats: float  # of the likelihood, by the best amplitude
    amplitude: float  # that amplitude; the true one is 1
    blocks: Array  # (B,) decrease of the squares of each block, held out
    least: float  # what any candidate must gain in these, of so many candidates

    @property
    def is_findable(self) -> bool:
        """Return whether a candidate that is this very pattern would pass the search."""
        return surely_helps(self.blocks, self.least)

    @property
    def kind(self) -> str:
        """Return whether anybody can know of the effect, or a search, in words."""
        if self.nats < NO_EVIDENCE:
            return f"no evidence (below {NO_EVIDENCE:g} nats)"
        return "findable" if self.is_findable else "some evidence, no certainty"


def gain_of(data: Array, own: Array, pattern: Array, block: Index, least: float) -> Gain:
    """Return what a pattern gains in linear rows of unit noise.

    Args:
        data: (R,) measured less predicted.
        own: (R, k) columns of the model's parameters, each in its expected size.
        pattern: (R,) what the effect does in these rows.
        block: (R,) number of the block of each row, from 0.
        least: what a candidate must gain in squares of held-out blocks.
    """
    _, beside = _solved(own, data, pattern[:, None])
    part, left = beside[:, 0], beside[:, 1]
    amplitude = float(part @ left / (part @ part))
    blocks = []
    for number in range(int(block.max()) + 1):
        here, others = block == number, block != number
        x, rest = _solved(own[others], data[others], pattern[others, None])
        size = rest[:, 0] @ rest[:, 1] / (rest[:, 0] @ rest[:, 0])
        with_pattern = pattern[here] - own[here] @ x[:, 0]
        without = data[here] - own[here] @ x[:, 1]
        blocks.append(np.sum(without**2) - np.sum((without - size * with_pattern) ** 2))
    return Gain(0.5 * amplitude**2 * float(part @ part), amplitude, np.array(blocks), least)


def _solved(own: Array, data: Array, pattern: Array) -> tuple[Array, Array]:
    """Return a pattern and data in terms of columns under a unit prior, (k, 2), and the rest.

    The rest (R + k, 2) has the rows of the prior below it, so that its products are those of what
    the columns leave, their own uncertainty counted.
    """
    both = np.column_stack([pattern, data])
    precision = Gaussian.of(own, data).gram + np.eye(own.shape[1])
    x = np.asarray(np.linalg.solve(precision, own.T @ both), dtype=np.float64)
    return x, np.concatenate([both - own @ x, -x])


def gain_in(trial: Trial) -> Gain:
    """Return what the effect of a trial gains, whose campaign repeats no pose."""
    with tempfile.TemporaryDirectory() as place:
        hiding = _read(trial.name, trial.settings, Path(place, "hiding"))
        without = trial.settings.model_copy(update={"hidden_effects": ()})
        twin = _read(trial.name, without, Path(place, "twin"))
    model = calibrate(hiding)
    options = CalibrationOptions(), DiscoveryOptions()
    setup = setup_of(hiding.description, hiding.arm, *options)
    campaign = prepared(hiding.observations, model, setup)
    survey = Survey.of(campaign)
    shaped, _ = computable_shapes(survey)
    rows = weighted_rows(survey, shaped, MAPS.spacings[-1][0])
    other = prepared(twin.observations, model, setup)
    moved = rows.operating_point.compared(_same_poses(other, survey)).residual
    moved -= rows.operating_point.compared(survey.poses).residual
    names = {each.name for each in shaped} | {("map", joint) for joint in rows.joints}
    least = 2.0 * needed_nats(len(names), setup.options.error_rate)
    data, own, pattern, block = _linear_rows(rows, moved)
    return gain_of(data, own, pattern, block, least)


def _read(name: str, settings: SimulateOptions, folder: Path) -> Campaign:
    """Return a campaign of the virtual cell as its files state it."""
    write_campaign(simulate_campaign(name, load_arm(settings.robot), settings), folder)
    return read_campaign(folder)


def _same_poses(twin: Prepared, survey: Survey) -> Observations:
    """Return the complete poses of a twin in the order of a survey."""
    poses = Survey.of(twin).poses
    place = {label: row for row, label in enumerate(poses.pose)}
    return poses.take(np.array([place[label] for label in survey.poses.pose]))


def _linear_rows(rows: BlockedRows, moved: Array) -> Sequence[Array]:
    """Return data (R,), own columns (R, k), whitened pattern (R,) and blocks (R,) of rows."""
    survey, count = rows.survey, len(rows.baseline_columns)
    parts = []
    for number in range(BLOCKS.blocks):
        design, here = rows.design(number), np.flatnonzero(survey.block == number)
        pattern = rows.weights.whiteners(here) @ moved[here][:, :, None]
        own = design.dense[:, :count] * rows.baseline_sizes
        parts.append((design.data, own, pattern.ravel(), np.full(len(own), number)))
    return [np.concatenate(each) for each in zip(*parts, strict=True)]


def told_of(trial: Trial) -> tuple[str, tuple[str, ...]]:
    """Return what a trial hides in words, and what of it is told."""
    judgement, truth = try_trial(trial, ChainOptions())
    judged = BlindTrial(truth, judgement)
    (hidden,) = judged.hidden
    told = {
        "place": trial_names.is_place_found(judged, hidden),
        "place, cause open": trial_names.has_right_place(judged),
        "formula": trial_names.proposes(judged, right=True),
    }
    what = f"{hidden.id} of {hidden.of} ({trial.bench}), {judged.ratio(hidden) or 1.0:.2f} floors"
    return what, tuple(name for name, holds in told.items() if holds)


def main() -> None:
    """Draw, judge, and print a line each and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--measured", choices=_STUDIES, default="tracked")
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    limit_threads()
    drawn = draw_trials(OUTSIDE, asked.count, asked.seed, asked.measured, first=asked.first)
    counts: dict[str, Counter[str]] = {}
    for trial in drawn:
        gain, (what, told) = gain_in(trial), told_of(trial)
        counts.setdefault(gain.kind, Counter()).update(("trials", *told))
        print(
            f"{trial.name}: {what}: {gain.nats:.1f} nats, {gain.blocks.sum():.0f} ± "
            f"{standard_error_of_sum(gain.blocks):.0f} of {gain.least:.0f} held out, {gain.kind}; "
            f"told: {', '.join(told) or 'nothing'}",
            flush=True,
        )
    for kind, count in counts.items():
        print(f"{kind}: " + ", ".join(f"{name} {number}" for name, number in count.items()))


if __name__ == "__main__":
    main()
