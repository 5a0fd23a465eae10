"""Promised uncertainty against the errors of held-out poses: what `u_mm` is worth.

`python -m benchmarks.promised RESULTS …` takes folders of results of campaigns with held-out poses
(`pa10cal chain`, `pa10cal run`): the extended model where there is one, else the calibrated one.
The promise of an extended model is at least what its held-out poses show beyond chance (decision
50): a ratio far above one would be a fault, one below it says nothing of further poses.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from pa10cal.commands.command_line import limit_threads

#: Of a standard uncertainty, the half width of an interval of 95 %.
_TWICE = 1.96


def promised(results: Path) -> dict[str, tuple[int, float, float, float, float]]:
    """Return configurations, rms error and rms `u_mm` [mm], parts of poses within 1.96, `inside`.

    Of all held-out poses, and where these are of a path, by where they lie.

    Raises:
        Pa10calError: when results lack a file, or no pose is held out.
    """
    from pa10cal.campaign.table import read_pose_table
    from pa10cal.fit.model_reading import load_model
    from pa10cal.observe.paths import HeldOutPlaces
    from pa10cal.results.codec import read
    from pa10cal.results.evaluation import BETWEEN, UNSEEN, HoldoutRecord

    record = read(HoldoutRecord, results / "evaluation" / "holdout.json")
    *_, judged = record.models.values()
    every = read_pose_table(results / "ingest" / "poses.parquet")
    every = every.drop_duplicates(["kind", "pose", "load_N"])
    fitted = every[every["kind"] == "grid"]
    model = load_model(results)
    arrived = [f"s{joint}" for joint in range(1, model.arm.n + 1)]
    joints = [
        name
        for name in map(str, every)
        if name[:1] == "q" and name.split("_")[0][1:].isdigit() and "_u_" not in name
    ]
    if not every[arrived].to_numpy().any():  # as errors are judged: the way from the pose before
        every = every.sort_values("time_s", kind="stable")
        moved = every[joints].diff()
        every[arrived] = np.sign(moved.mask(moved == 0.0).ffill().fillna(0.0).to_numpy())
    table = every[every["kind"] == "holdout"].set_index(["pose", "load_N"])
    rows = table.loc[list(zip(judged.rows.pose, judged.rows.load_N, strict=True))]
    q, arrival = rows[joints], rows[arrived].to_numpy(float)
    targets = [name for name in model.frames if name.startswith("target_")] or ["tool"]
    found = [
        model.predict(
            q.to_numpy(),
            frame=frame,
            load_N=rows.index.get_level_values("load_N").to_numpy(),
            arrival=arrival,
            extrapolate=True,
        )
        for frame in targets
    ]
    u_mm = np.sqrt(np.mean([each.u_mm**2 for each in found], axis=0))
    error_mm = judged.rows.error_mm
    places = HeldOutPlaces.of_positions(
        *(rows[list(q)].to_numpy(), rows["time_s"].to_numpy(float)),
        *(fitted[list(q)].to_numpy(), fitted["time_s"].to_numpy(float)),
    )
    parts = {"": np.ones(len(error_mm), dtype=bool), UNSEEN: places.unseen, BETWEEN: places.between}
    return {
        name: (
            int(at.sum()),
            float(np.sqrt(np.mean(error_mm[at] ** 2))),
            float(np.sqrt(np.mean(u_mm[at] ** 2))),
            float(np.mean(error_mm[at] <= _TWICE * u_mm[at])),
            float(np.mean(found[0].inside[at])),
        )
        for name, at in parts.items()
        if at is not None
    }


def main(folders: list[str]) -> None:
    """Print a line for each folder of results."""
    from pa10cal.errors import Pa10calError

    limit_threads()
    print("| results | poses | rms error [mm] | rms u [mm] | ratio | within 95 % | inside |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for folder in map(Path, folders):
        try:
            parts = promised(folder)
        except Pa10calError as refused:
            print(f"| {folder.name} | {str(refused).splitlines()[0]} |||||||")
            continue
        for where, (poses, error, u, within, inside) in parts.items():
            ratio = f"{error / u:.2f}" if u else "no u"
            print(
                f"| {folder.name}{', ' * bool(where)}{where} | {poses} | {error:.3f} | {u:.3f} "
                f"| {ratio} | {100 * within:.0f} % | {100 * inside:.0f} % |"
            )


if __name__ == "__main__":
    main(sys.argv[1:])
