"""Files with one mistake of their owner: is it told, or mended, whatever its size?

`python -m benchmarks.files_as_they_are [lengths|joints] [--count 20] [--first 0] [--seed 1]` draws
shipped arms under trackers of poses or points (SYNTHETIC, of the virtual cell), spoils the file and
runs `pa10cal chain`. Of `lengths` all positions are longer or shorter by a factor of 0.2 to 5, as
of a tag that is held for another size, or are in another unit than is stated, of millimetres,
metres and inches: is the factor told to 1 %, or the unit? Of `joints` two joints are exchanged, or
the angles of some are logged within one turn or whole turns away: is it told of the joints that it
is, or are true poses predicted as if the log were right? A cause without its remedy does not count.
"""

from __future__ import annotations

import argparse
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from benchmarks.low_cost import best_fit
from benchmarks.planned import true_frame
from benchmarks.statements import printed
from pa10cal.arm.description import Arm
from pa10cal.commands.command_line import limit_threads
from pa10cal.errors import Pa10calError
from pa10cal.files.arms import load_arm
from pa10cal.fit.model_reading import load_model
from pa10cal_lab.cell.campaign import SimulatedCampaign, simulate_campaign
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.write import write_campaign

ARMS = ("pa10_6ce", "ur10", "irb120", "iiwa14", "gx4_351s")
_POSES, _NOISE_MM, _NOISE_RAD = 60, 0.03, 5e-5
#: A factor is told within this part of it.
_WITHIN = 0.01
#: Millimetres a unit of a file.
_UNITS = {"mm": 1.0, "m": 1e3, "in": 25.4}
_JUDGED = 200
#: Error [mm, root mean square] at which the arm is predicted as from a right log.
_PREDICTED_MM = 0.1
#: Every so many-th file of `lengths` has a wrong unit; of `joints` exchanged joints.
_OF_UNIT, _OF_ORDER = 3, 2


Change = Callable[[np.ndarray], np.ndarray]


def rewrite(
    folder: Path, names: list[str], change: Change, called: dict[str, str] | None = None
) -> None:
    """Change the numbers (N, k) of some columns of a file of poses, all else as it is written.

    Columns are then called otherwise, where that is given.
    """
    path = folder / "poses.csv"
    table = pd.read_csv(path, dtype=str, keep_default_na=False)
    numbers = change(table[names].replace("", "nan").to_numpy(dtype=float))
    table[names] = np.where(np.isnan(numbers), "", np.char.mod("%.9g", numbers))
    table.rename(columns=called or {}).to_csv(path, index=False)


def columns(folder: Path) -> tuple[list[str], list[str]]:
    """Return the columns of a file of poses, and which of them are positions."""
    names = list(pd.read_csv(folder / "poses.csv", nrows=0).columns)
    return names, [name for name in names if re.fullmatch(r"(T\d+_)?[xyz]_mm", name)]


def written(folder: Path, rng: np.random.Generator) -> tuple[SimulatedCampaign, Arm]:
    """Write a right campaign of a drawn arm and instrument; return what is true, and the arm."""
    name = str(rng.choice(ARMS))
    plan = {
        "instrument": str(rng.choice(["points", "pose"])),
        "poses": _POSES,
        "holdout_share": 0.2,
        "position_mm": _NOISE_MM,
        "attitude_rad": _NOISE_RAD,
    }
    seed = int(rng.integers(2**31))
    settings = {"random_seed": seed, "robot": name, "without_touches": plan}
    arm = load_arm(name)
    made = simulate_campaign(folder.name, arm, SimulateOptions.model_validate(settings))
    write_campaign(made, folder)
    return made, arm


def lengths(folder: Path, number: int, rng: np.random.Generator) -> tuple[bool, str]:
    """Judge a file with other lengths; return whether they are told, and a line."""
    made, arm = written(folder, rng)
    _, places = columns(folder)
    if number % _OF_UNIT == _OF_UNIT - 1:
        of_file, stated = (str(each) for each in rng.permutation(list(_UNITS))[:2])
        what, right = f"in {of_file}, stated in {stated}", rf"unit: {of_file}\b"
        state_unit(folder, stated)
        bare = {name: name.removesuffix("_mm") for name in places}
        rewrite(folder, places, lambda numbers: numbers / _UNITS[of_file], bare)
        factor = _UNITS[stated] / _UNITS[of_file]
    else:
        factor, right = float(np.exp(rng.uniform(np.log(0.2), np.log(5.0)))), "$."
        what = f"{factor:.4g} times as long"
        rewrite(folder, places, lambda numbers: factor * numbers)
    text = re.sub(r"\s+", " ", printed(folder))
    found = re.search(r"divide the positions by ([\d.e+-]+\d)", text)
    said = abs(float(found[1]) / factor - 1.0) <= _WITHIN if found else False
    by_unit = re.search(right, text)
    shown = (by_unit or found or [text[-900:]])[0]
    return said or bool(by_unit), f"{arm.name}, {made.instrument.kind}, {what}: {shown}"


def state_unit(folder: Path, unit: str) -> None:
    """State the columns of a file in campaign.yaml, its places in a unit."""
    path = folder / "campaign.yaml"
    about = yaml.safe_load(path.read_text(encoding="utf-8"))
    every, in_mm = columns(folder)
    joint_names = [name for name in every if re.fullmatch(r"q\d+_(deg|mm)", name)]
    own: dict[str, object] = {"time": {"names": "time_s"}, "kind": {"names": "kind"}}
    own |= {"pose": "pose", "repeat": "repeat", "joints": {"names": joint_names}}
    places = [name.removesuffix("_mm") for name in in_mm]
    if "qw" in every:
        own["position"] = {"names": places, "unit": unit}
        turn = ["qw", "qx", "qy", "qz"]
        own["rotation"] = {"names": turn, "convention": "quaternion_wxyz"}
    else:
        of_target = {name[:-2]: [f"{name[:-2]}_{axis}" for axis in "xyz"] for name in places}
        own["targets"] = {key: {"names": names, "unit": unit} for key, names in of_target.items()}
    path.write_text(yaml.safe_dump(about | {"columns": {"poses": own}}), encoding="utf-8")


def joints(folder: Path, number: int, rng: np.random.Generator) -> tuple[bool, str]:
    """Judge a file with exchanged joints or other turns; return whether it is right, and a line."""
    made, arm = written(folder, rng)
    slides = arm.axes_slide
    units = np.where(slides, "mm", "deg")
    names = [f"q{k}_{unit}" for k, unit in enumerate(units, start=1)]
    about = f"{arm.name}, {made.instrument.kind}"
    if number % _OF_ORDER:
        pairs = [(a, b) for b in range(arm.n) for a in range(b) if slides[a] == slides[b]]
        one, other = pairs[int(rng.integers(len(pairs)))]
        rewrite(folder, [names[one], names[other]], lambda numbers: numbers[:, ::-1])
        right = rf"joints {one + 1} and {other + 1} are exchanged"
        what = f"{about}, joints {one + 1} and {other + 1} exchanged"
    else:
        turning = np.flatnonzero(~slides)
        some = np.sort(rng.choice(turning, int(rng.integers(1, len(turning) + 1)), replace=False))
        way = str(rng.choice(["0 to 360", "-180 to 180", "turns away", "turns a row"]))
        rewrite(folder, [names[k] for k in some], lambda q_deg: wrapped(q_deg, way, rng))
        right = ""
        what = f"{about}, joints {', '.join(str(k + 1) for k in some)} {way}"
    results = folder.parent / f"{folder.name}-results"
    text = re.sub(r"\s+", " ", printed(folder, results=results))
    if right and re.search(right, text):
        return True, f"{what}: told"
    model = next(results.rglob("model.yaml"), None)
    if model is None:
        return False, f"{what}: {text[:700]}"
    error_mm = off_mm(made, model, rng)
    return error_mm <= _PREDICTED_MM, f"{what}: {error_mm:.3f} mm off; {text[:700]}"


def wrapped(q_deg: np.ndarray, way: str, rng: np.random.Generator) -> np.ndarray:
    """Return angles (N, k) as a controller may count them: the same places of the arm."""
    if way == "0 to 360":
        return np.mod(q_deg, 360.0)
    if way == "-180 to 180":
        return np.mod(q_deg + 180.0, 360.0) - 180.0
    count = 1 if way == "turns away" else len(q_deg)
    return q_deg + 360.0 * rng.choice([-2, -1, 1, 2], (count, q_deg.shape[1]))


def off_mm(made: SimulatedCampaign, path: Path, rng: np.random.Generator) -> float:
    """Return how far a model is from the true arm [mm, root mean square]."""
    try:
        model = load_model(path)
        low, high = model.arm.limits_rad.T
        q_rad = rng.uniform(np.maximum(low, -1.5), np.minimum(high, 1.5), (_JUDGED, model.arm.n))
        predicted = model.predict(q_rad, frame="tool").T
    except Pa10calError:
        return np.inf
    return 1e3 * float(np.sqrt(np.mean(best_fit(predicted, true_frame(made, q_rad)) ** 2)))


JUDGES = {"lengths": lengths, "joints": joints}


def main() -> None:
    """Draw, judge, and print a line each and the count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("which", choices=JUDGES, nargs="?", default="lengths")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    limit_threads()
    counts: Counter[bool] = Counter()
    with tempfile.TemporaryDirectory() as place:
        for k in range(asked.first, asked.first + asked.count):
            begun = time.monotonic()
            rng = np.random.default_rng([asked.seed, k])
            right, line = JUDGES[asked.which](Path(place) / f"file{k}", k, rng)
            counts[right] += 1
            took_s = time.monotonic() - begun
            print(f"{k}: {'' if right else 'NOT '}{line} ({took_s:.0f} s)", flush=True)
    print(f"{counts[True]} of {counts.total()} told or mended")


if __name__ == "__main__":
    main()
