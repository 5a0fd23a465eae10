"""What effects together predict at held-out poses, their sizes found by marginal likelihood.

`python -m benchmarks.all_at_once FOLDER … [--waves 12]` fits, beside a campaign's calibrated model,
every effect of the vocabulary, tilts of all joints and waves of all joints' angles at once, linear
about the model. Each effect x_e ~ N(0, v_e Q_e) has the size v_e that makes the fitted poses most
likely (MacKay, Bayesian Interpolation, Neural Computation 4, 1992), so what is not there goes to
nothing; none is larger than so many plausible sizes. Of rows that err alike, as along a path, so
many count as one (design effect). No effect is named by it: it says how much of what a model lacks
can be predicted, held against the search, which adds one effect after the other. Campaigns whose
poses are read once.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from pa10cal.commands.command_line import limit_threads

limit_threads()

import numpy as np  # noqa: E402 - after the threads are limited

import pa10cal  # noqa: E402
from pa10cal.arrays import Array, Index  # noqa: E402
from pa10cal.calibration.options import CalibrationOptions  # noqa: E402
from pa10cal.discovery.blocked_cv.family import computable_shapes  # noqa: E402
from pa10cal.discovery.blocked_cv.refit import weighted_rows  # noqa: E402
from pa10cal.discovery.blocked_cv.survey import (  # noqa: E402
    BlockedRows,
    BlockRows,
    ShapedEffect,
    survey,
)
from pa10cal.discovery.discover import discover, judged_by_blocks  # noqa: E402
from pa10cal.discovery.noise import unweighted  # noqa: E402
from pa10cal.discovery.preparation import Prepared, complete, prepared, setup_of  # noqa: E402
from pa10cal.options import DiscoveryOptions  # noqa: E402
from pa10cal.terms.effects.structure import LateralTilt  # noqa: E402

KNOTS = 72
#: Size of the slowest wave of a joint's angle [rad]; of others a part, as of a random walk.
WAVE_RAD = 1e-4
STEPS, SETTLED = 300, 1e-3
#: Variance of an effect that is none, in plausible ones.
NONE = 1e-10


@dataclass(frozen=True)
class Rows:
    """White rows of fitted poses, those of held-out ones, and which columns are of what."""

    columns: Array  # (r, N) in prior sizes: those of the model first, then effect by effect
    data: Array  # (r,)
    own: int  # how many are of the model
    groups: tuple[Index, ...]  # those of each effect
    names: tuple[str, ...]  # and what it is
    held: Array  # (P, b, N) components of held-out poses [m, rad]
    held_data: Array  # (P, b)
    seen: Array  # (P, b) which were measured, positions alone

    @classmethod
    def of(cls, campaign: Prepared, waves: int) -> Rows:
        """Return the rows of a campaign that holds some poses out."""
        assert campaign.held_out is not None
        every = tuple(range(1, campaign.baseline.arm.n))
        campaign = replace(campaign, baseline=campaign.baseline.with_bends(every))
        logged = campaign.torques == "logged"
        judged = survey(campaign.trusted, campaign.baseline, campaign.setup, torques_logged=logged)
        shaped, _ = computable_shapes(judged)
        if judged.poses.states.static_loads is not None:
            shaped += tuple(map(ShapedEffect, LateralTilt.everywhere(judged.context)))
        rows = weighted_rows(judged, shaped, KNOTS)
        parts = [rows.block(b) for b in np.unique(judged.block).tolist()]
        poses = complete(campaign.held_out, campaign.baseline, campaign.setup)
        there = replace(judged, poses=poses, block=np.zeros(len(poses), dtype=np.intp), lag=None)
        held = BlockedRows(there, unweighted(poses.measured), shaped, KNOTS)
        of_held, white = held.block(0), held.weights.whiteners(np.arange(len(poses)))
        shape = white.shape[:2]
        columns = np.concatenate([_with_waves(rows, part, waves) for part in parts])
        of_waves = [
            np.arange(first, first + waves)
            for first in range(parts[0].dense.shape[1], columns.shape[1], max(waves, 1))
        ]
        positions = np.isin(np.arange(shape[1]), poses.measured.position_columns)
        return cls(
            columns=columns,
            data=np.concatenate([part.data for part in parts]),
            own=len(rows.baseline_columns),
            groups=(*rows.of_shaped(), *of_waves),
            names=(
                *(f"{each.effect.id} of {each.effect.of}" for each in shaped),
                *(
                    f"waves of joint {joint}"
                    for joint, _ in zip(rows.joints, of_waves, strict=False)
                ),
            ),
            held=np.linalg.solve(white, _with_waves(held, of_held, waves).reshape(*shape, -1)),
            held_data=np.linalg.solve(white, of_held.data.reshape(*shape, 1))[:, :, 0],
            seen=poses.measured.components_seen & positions,
        )

    def held_out_rms_mm(self, x: Array) -> float:
        """Return the error of held-out positions, root mean square over poses and targets."""
        left = np.where(self.seen, self.held_data - self.held @ x, 0.0)
        targets = np.maximum(self.seen.sum(axis=1) / 3.0, 1.0)
        return 1e3 * float(np.sqrt(np.mean(np.sum(left**2, axis=1) / targets)))


def _with_waves(rows: BlockedRows, part: BlockRows, waves: int) -> Array:
    """Return the columns of model and effects, and those of the first waves of every joint."""
    if not waves:
        return part.dense
    order = np.arange(waves) // 2 + 1
    basis = rows.basis[:, :waves] * (WAVE_RAD / order)
    splines = part.maps([KNOTS] * len(rows.joints)).toarray()
    of_joints = splines.reshape(len(splines), len(rows.joints), KNOTS) @ basis
    return np.concatenate([part.dense, of_joints.reshape(len(splines), -1)], axis=1)


def most_likely(
    rows: Rows, largest: float = 10.0, design_effect: float = 1.0
) -> tuple[Array, Array, Array]:
    """Return the amounts (N,), their standard uncertainties, and the size of each effect.

    By fixed-point steps on the sizes and on the scatter of the rows.

    Args:
        largest: size of an effect at most, in plausible ones.
        design_effect: how many rows count as one.
    """
    gram = rows.columns.T @ rows.columns / design_effect
    projection = rows.columns.T @ rows.data / design_effect
    squares = float(rows.data @ rows.data) / design_effect
    seen = np.count_nonzero(rows.data) / design_effect
    variance = np.ones(len(projection))
    sizes, scatter = np.full(len(rows.groups), 0.1), squares / seen
    for step in range(STEPS):
        before = sizes.copy()
        for at, size in zip(rows.groups, sizes, strict=True):
            variance[at] = size
        covariance = np.linalg.inv(gram / scatter + np.diag(1.0 / variance))
        x, known = covariance @ projection / scatter, np.diag(covariance)
        taken = np.zeros(len(sizes))
        for k, at in enumerate(rows.groups):
            taken[k] = max(len(at) - known[at].sum() / sizes[k], NONE)
            amount = float(x[at] @ x[at])
            # Steps of expectation first: those of MacKay run away from a bad start.
            found = (amount + known[at].sum()) / len(at) if step < 20 else amount / taken[k]
            sizes[k] = min(max(found, NONE), largest**2)
        left = squares - 2.0 * projection @ x + x @ gram @ x
        scatter = left / max(seen - rows.own - taken.sum(), 1.0)
        there = sizes > 1e3 * NONE
        if step > 30 and np.abs(np.log(sizes / before))[there].max(initial=0.0) < SETTLED:
            break
    return x, np.sqrt(known), np.sqrt(sizes)


def judged(folder: Path, given: argparse.Namespace) -> str:
    """Return a campaign's row of the table, and its largest effects."""
    campaign = pa10cal.read_campaign(folder)
    model = pa10cal.calibrate(campaign)
    setup = setup_of(campaign.description, campaign.arm, CalibrationOptions(), DiscoveryOptions())
    ready = prepared(campaign.observations, model, setup)
    if not judged_by_blocks(ready.trusted) or ready.held_out is None:
        return f"| {folder.name} | too few poses, or poses are repeated | | | |"
    rows = Rows.of(ready, given.waves)
    x, std, sizes = most_likely(rows, given.largest, given.design_effect)
    verdict = discover(campaign.observations, model, setup)
    searched = "" if verdict.holdout is None else f"{verdict.holdout.after.rms_mm:.4f}"
    before_mm, after_mm = rows.held_out_rms_mm(np.zeros(len(x))), rows.held_out_rms_mm(x)
    worth = [float(np.sum((rows.columns[:, at] @ x[at]) ** 2)) for at in rows.groups]
    lines = [
        f"| {folder.name} | {len(ready.trusted)} ({len(ready.held_out)}) | {before_mm:.4f} | "
        f"{searched} | {after_mm:.4f} |"
    ]
    for k in np.argsort(worth)[::-1][: given.shown].tolist():
        at = rows.groups[k][:3]
        amounts = ", ".join(f"{x[i]:.2f} ± {std[i]:.2f}" for i in at)
        lines.append(f"    {rows.names[k]}, size {sizes[k]:.2g}: {amounts}")
    return "\n".join(lines)


def main() -> int:
    """Print the table."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("folders", nargs="+", type=Path)
    asked.add_argument("--waves", type=int, default=12, help="sines and cosines a joint")
    asked.add_argument("--largest", type=float, default=10.0, help="size, in plausible ones")
    asked.add_argument("--design-effect", type=float, default=1.0, help="rows that count as one")
    asked.add_argument("--shown", type=int, default=0, help="effects listed under each row")
    given = asked.parse_args()
    print("| campaign | poses (held out) | calibrated | searched | all at once: rms [mm] |")
    print("| --- | --- | --- | --- | --- |")
    for folder in given.folders:
        print(judged(folder, given), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
