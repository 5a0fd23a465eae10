"""How much of what geometry leaves could be predicted: learners against the extended model.

`python -m benchmarks.ceiling CAMPAIGN …` takes folders of campaigns. Configurations are put into
clusters by their joint positions, whole clusters are held out, a quarter of all poses. Geometry is
calibrated on the rest. Its residuals are what discovery judges, and what learners are given with
joint positions, directions of arrival and moves: a Gaussian process and trees of scikit-learn, in
an environment of its own under `build/ceiling`. The best of them on the poses held out counts.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.cluster.vq import kmeans2

from benchmarks.peers.environments import build
from pa10cal.commands.command_line import limit_threads

WORK = Path("build/ceiling")
#: Clusters of configurations, and part of all poses that is held out by whole ones.
_CLUSTERS, _HELD_OUT = 24, 0.25
#: Residuals farther than so many times the median are gross errors: no learner is given them.
_GROSS = 8.0


@dataclass(frozen=True)
class Ceiling:
    """Errors of held-out clusters of one campaign, root mean squares [mm]."""

    campaign: str
    poses: int  # held out
    geometry_mm: float
    extended_mm: float
    learners_mm: dict[str, float]

    @property
    def ratio(self) -> float:
        """Return the error of the extended model over that of the best learner, or geometry."""
        return self.extended_mm / min(self.geometry_mm, *self.learners_mm.values())


def held_out_clusters(q_rad: np.ndarray, random_seed: int) -> np.ndarray:
    """Return which poses (P,) are held out: whole clusters of joint positions (P, n)."""
    rng = np.random.default_rng(random_seed)
    places = np.concatenate([np.cos(q_rad), np.sin(q_rad)], axis=1)
    _, cluster = kmeans2(places, min(_CLUSTERS, len(places) // 4), minit="++", rng=rng)
    out = np.zeros(len(q_rad), dtype=bool)
    for each in rng.permutation(np.unique(cluster)):
        if out.mean() >= _HELD_OUT:
            break
        out |= cluster == each
    return out


def ceiling_of(folder: Path, python: Path, random_seed: int = 1) -> Ceiling:
    """Return what is left of held-out clusters of a campaign.

    Raises:
        Pa10calError: when the campaign cannot be read or calibrated.
    """
    import pa10cal

    campaign = pa10cal.read_campaign(folder)
    every = campaign.observations
    _, first, code = np.unique(every.pose, return_index=True, return_inverse=True)
    out = held_out_clusters(every.states.q_rad[first], random_seed)
    known = np.isin(every.kind, ("grid", "holdout"))
    kind = np.where(known, np.where(out[code], "holdout", "grid"), every.kind)
    campaign = replace(campaign, observations=replace(every, kind=kind.astype(every.kind.dtype)))
    model = pa10cal.calibrate(campaign)
    verdict = pa10cal.discover(campaign, model)
    held_out = verdict.trusted_holdout
    assert held_out is not None
    fitted, asked = verdict.train.poses, held_out.poses
    positions = fitted.measured.position_columns
    left, missed = (1e3 * model.compared(each).residual[:, positions] for each in (fitted, asked))
    size = np.linalg.norm(left, axis=1)
    usual = size <= _GROSS * np.median(size)

    def features(states):
        angles = [np.cos(states.q_rad), np.sin(states.q_rad), states.arrival]
        if states.move_share is not None and states.move_end_m is not None:
            angles += [states.move_share, states.move_share * states.move_end_m[:, None]]
        return np.concatenate(angles, axis=1)

    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "residuals.npz"
        given = {"seen": features(fitted.states)[usual], "asked": features(asked.states)}
        np.savez(path, left=left[usual], **given)
        script = Path(__file__).with_name("learners.py")
        subprocess.run([str(python), str(script), str(path)], check=True)
        with np.load(path) as file:
            found = {name: file[name] for name in file.files if name not in (*given, "left")}

    # Targets of one pose count each; a distance is one component.
    targets = max(len(positions) // 3, 1)

    def rms_mm(errors: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.sum(errors**2, axis=1)) / targets))

    geometry = rms_mm(missed)
    return Ceiling(
        folder.name,
        len(asked),
        geometry,
        held_out.after.rms_mm * geometry / held_out.before.rms_mm,
        {name: rms_mm(missed - each) for name, each in found.items()},
    )


def main(folders: list[str]) -> None:
    """Print a row for each campaign."""
    from pa10cal.errors import Pa10calError

    limit_threads()
    python, reason = build("scikit-learn", WORK, Path(__file__).parent)
    if python is None:
        sys.exit(f"ceiling: scikit-learn cannot be installed here ({reason})")
    head = "| campaign | poses held out | geometry | extended | Gaussian process | trees | boosted "
    print(f"{head}| over the best |\n| --- |{' --- |' * 7}")
    for folder in map(Path, folders):
        try:
            found = ceiling_of(folder, python)
        except Pa10calError as refused:
            print(f"| {folder.name} | {str(refused).splitlines()[0]} |")
            continue
        errors = (found.geometry_mm, found.extended_mm, *found.learners_mm.values())
        told = " | ".join(f"{each:.3f}" for each in errors)
        print(f"| {found.campaign} | {found.poses} | {told} | {found.ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
