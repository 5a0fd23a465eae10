"""Joints that move together: small couplings named as effects, and large ones as slips of the log.

`python -m benchmarks.couplings [small|quills|large] [--count 40] [--first 0] [--seed 1]` draws
arms of the virtual cell that stand a little off their design. Of `small` a joint moves by a
thousandth as another one turns, which no log shows: is it named, of the right joint, with c, and
the true arm predicted? One arm of five has none, every other one of them a gear ratio that is off
in a joint of such a pair: no coupling is to be named. Of `quills` all are SCARAs whose quill rises
by 5 to 8 mm a turn. Of `large` a controller logs joints together and nothing states it: does
`pa10cal chain` name the cause, the joints, c, and the key to set? The cell shares no formula with
the program.
"""

from __future__ import annotations

import argparse
import re
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.low_cost import best_fit
from benchmarks.planned import true_frame
from benchmarks.statements import printed
from pa10cal.arm.description import Arm
from pa10cal.commands.command_line import limit_threads
from pa10cal.files.arms import arm_text, parse_arm
from pa10cal_lab.cell.campaign import SimulatedCampaign, simulate_campaign
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.poses import joint_bounds
from pa10cal_lab.cell.write import write_campaign

_NOISE_MM, _NOISE_RAD = 0.02, 5e-5
_POSES, _HELD_OUT = 150, 0.2  # 120 are calibrated with
_JUDGED = 200
#: Every so many-th arm of small couplings has none.
_NONE = 5
_RATIO, _RATIO_OFF = "gear_ratio_error", 3e-4
#: c that is named, off by so much of it; factor and pitch [mm] of a log by so much.
_OF_C, _OF_FACTOR, _OF_PITCH_MM = 0.05, 1e-9, 0.03
#: Error [mm, root mean square] to which the true arm is to be predicted.
_PREDICTED_MM = 0.016

Rows = list[dict[str, Any]]


def industrial(rng: np.random.Generator, along: int) -> Rows:
    """Return an arm with six joints, whose third axis goes along the second or against it."""
    a1, a2, a3, d1, d4, d6 = rng.uniform(
        [0.1, 0.5, 0.1, 0.3, 0.6, 0.1], [0.3, 1.0, 0.3, 0.6, 1.2, 0.2]
    )
    elbow_deg = 0.0 if along > 0 else 180.0
    return [
        {"d_m": d1, "a_m": a1, "alpha_deg": -90.0, "limits_deg": [-170, 170]},
        {"theta_deg": -90.0, "a_m": a2, "alpha_deg": elbow_deg, "limits_deg": [-80, 90]},
        {"a_m": a3, "alpha_deg": -90.0, "limits_deg": [-120, 150]},
        {"d_m": along * d4, "alpha_deg": 90.0, "limits_deg": [-190, 190]},
        {"alpha_deg": -90.0, "limits_deg": [-120, 120]},
        {"d_m": along * d6, "limits_deg": [-360, 360]},
    ]


def scara(rng: np.random.Generator) -> Rows:
    """Return an arm whose quill, joint 3, is turned by joint 4."""
    a1, a2, d1 = rng.uniform([0.2, 0.2, 0.1], [0.4, 0.35, 0.3])
    return [
        {"d_m": d1, "a_m": a1, "limits_deg": [-130, 130]},
        {"a_m": a2, "alpha_deg": 180.0, "limits_deg": [-140, 140]},
        {"prismatic": True, "limits_m": [0.0, 0.2]},
        {"d_m": 0.03, "limits_deg": [-350, 350]},
    ]


def telescope(rng: np.random.Generator) -> Rows:
    """Return an arm with two slides one in the other, joints 3 and 4, and a wrist of two."""
    d1, a2 = rng.uniform([0.3, 0.1], [0.6, 0.3])
    return [
        {"d_m": d1, "alpha_deg": 90.0, "limits_deg": [-170, 170]},
        {"a_m": a2, "alpha_deg": 90.0, "theta_deg": 90.0, "limits_deg": [-60, 60]},
        {"prismatic": True, "limits_m": [0.0, 0.5]},
        {"prismatic": True, "d_m": 0.4, "limits_m": [0.0, 0.5]},
        {"d_m": 0.1, "alpha_deg": 90.0, "limits_deg": [-170, 170]},
        {"d_m": 0.1, "limits_deg": [-170, 170]},
    ]


@dataclass(frozen=True)
class Drawn:
    """An arm, and how its joints move together."""

    rows: Rows
    # of a log as its file states it; of an arm the effect as the cell hides it, or none
    coupling: Mapping[str, Any]


def drawn_small(number: int, rng: np.random.Generator) -> Drawn:
    """Draw an arm with a small coupling in one joint, or with none."""
    along = int(rng.choice([-1, 1]))
    kinds: list[tuple[Rows, int, int]] = [
        (industrial(rng, along), 5, 4),
        (industrial(rng, along), 3, 2),
        (scara(rng), 3, 4),
        (industrial(rng, along), 6, 4),
        (industrial(rng, along), 6, 5),
        (scara(rng), 2, 1),
    ]
    if number % _NONE == _NONE - 1:
        rows, joint, by = kinds[int(rng.integers(len(kinds)))]
        at = by if "prismatic" in rows[joint - 1] else int(rng.choice([joint, by]))
        off = {"id": _RATIO, "of": f"joint {at}", "parameters": {"eps": _RATIO_OFF}}
        return Drawn(rows, off if number // _NONE % 2 else {})
    rows, joint, by = kinds[(number - number // _NONE) % len(kinds)]
    c = float(rng.choice([-1.0, 1.0])) * rng.uniform(0.8e-3, 1.25e-3)
    if "prismatic" in rows[joint - 1]:
        c *= 0.1  # of a turn 0.5 to 0.8 mm
    wrist = joint == len(rows) and by == joint - 1
    parameters = {"c": c} if wrist else {"c": c, "by": by}
    of = "wrist" if wrist else f"joint {joint}"
    kind = "wrist_coupling" if wrist else "joint_coupling"
    return Drawn(rows, {"id": kind, "of": of, "parameters": parameters})


def drawn_quill(number: int, rng: np.random.Generator) -> Drawn:
    """Draw an arm whose quill rises by millimetres a turn, which nothing states."""
    c = (-1.0) ** number * rng.uniform(0.8e-3, 1.25e-3)
    return Drawn(
        scara(rng), {"id": "joint_coupling", "of": "joint 3", "parameters": {"c": c, "by": 4}}
    )


def drawn_large(number: int, rng: np.random.Generator) -> Drawn:
    """Draw an arm that a controller logs with joints together."""
    pitch_mm = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(2.0), np.log(40.0))))
    kinds: list[tuple[Rows, dict[str, Any]]] = [
        (industrial(rng, -1), {"joint": 3, "by": 2, "factor": 1}),
        (industrial(rng, 1), {"joint": 3, "by": 2, "factor": -1}),
        (scara(rng), {"joint": 3, "by": 4, "mm_per_turn": round(pitch_mm, 2)}),
        (telescope(rng), {"joint": 4, "by": 3, "factor": -1}),
    ]
    return Drawn(*kinds[number % len(kinds)])


def described(rows: Rows, *couplings: Mapping[str, Any]) -> Arm:
    """Return an arm of these rows, with or without couplings."""
    plain = arm_text(parse_arm({"name": "mine", "rows": rows}, where="mine.yaml"))
    stated = {"coupling": list(couplings)} if couplings else {}
    return parse_arm(yaml.safe_load(plain) | stated, where="mine.yaml")


def written(
    folder: Path, drawn: Drawn, rng: np.random.Generator, *, poses: int = _POSES
) -> SimulatedCampaign:
    """Write a campaign of an arm, described without its coupling; return what is true."""
    hidden, coupling = drawn.coupling, []
    if hidden and "id" not in hidden:
        hidden, coupling = {}, [hidden]
    plan = {
        "instrument": str(rng.choice(["points", "pose"])),
        "poses": poses,
        "holdout_share": _HELD_OUT,
        "position_mm": _NOISE_MM,
        "attitude_rad": _NOISE_RAD,
        "tool_mass_kg": 0.0,
    }
    settings = SimulateOptions.model_validate(
        {
            "random_seed": int(rng.integers(2**31)),
            "hidden_effects": [hidden] if hidden else [],
            "without_touches": plan,
        }
    )
    made = simulate_campaign(folder.name, described(drawn.rows, *coupling), settings)
    write_campaign(made, folder)
    (folder / "mine.yaml").write_text(arm_text(described(drawn.rows)), encoding="utf-8")
    return made


def small(folder: Path, number: int, rng: np.random.Generator) -> tuple[tuple[str, ...], str]:
    """Judge an arm with a small coupling or none; return what holds of it, and a line."""
    return judged_by_search(folder, drawn_small(number, rng), rng)


def quills(folder: Path, number: int, rng: np.random.Generator) -> tuple[tuple[str, ...], str]:
    """Judge an arm whose quill rises as it turns; return what holds of it, and a line."""
    return judged_by_search(folder, drawn_quill(number, rng), rng)


def judged_by_search(
    folder: Path, drawn: Drawn, rng: np.random.Generator
) -> tuple[tuple[str, ...], str]:
    """Judge an arm by what is named of it; return what holds of it, and a line."""
    from pa10cal.interface import calibrate, discover, read_campaign

    made = written(folder, drawn, rng)
    begun = time.process_time()
    campaign = read_campaign(folder)
    verdict = discover(campaign, calibrate(campaign))
    took_s = time.process_time() - begun
    q = rng.uniform(*joint_bounds(campaign.arm), (_JUDGED, campaign.arm.n))
    predicted = verdict.model.predict(q, frame="tool").T
    error_mm = 1e3 * float(np.sqrt(np.mean(best_fit(predicted, true_frame(made, q)) ** 2)))
    names = ", ".join(f"{each.id} of {each.of}" for each in verdict.findings)
    line = f"{verdict.verdict}, {names or 'no effect'}, {error_mm:.4f} mm off"
    line += f", {took_s:.1f} s"
    found = {f"{each.id} of {each.of}": each for each in verdict.findings}
    hidden = drawn.coupling
    if not hidden or hidden["id"] == _RATIO:
        wrong = any("coupling" in name for name in found) or (found and not hidden)
        what = f"{hidden['id']} of {hidden['of']}" if hidden else "nothing hidden"
        return ("none", *(["a wrong name"] if wrong else [])), f"{what}: {line}"
    wanted, c = f"{hidden['id']} of {hidden['of']}", hidden["parameters"]["c"]
    holds = ["hidden"]
    if wanted in found:
        value = found[wanted].parameters["c"].value
        named = verdict.verdict == "named" and len(found) == 1
        holds += ["named"] if named and abs(value - c) <= _OF_C * abs(c) else []
        line += f", c {value:.3g}"
    holds += ["predicted"] if error_mm <= _PREDICTED_MM else []
    return tuple(holds), f"{wanted}, c {c:.3g}: {line}"


def large(folder: Path, number: int, rng: np.random.Generator) -> tuple[tuple[str, ...], str]:
    """Judge a log with joints together; return what holds of it, and a line."""
    drawn = drawn_large(number, rng)
    made = written(folder, drawn, rng, poses=75)
    text = re.sub(r"\s+", " ", printed(folder))
    holds, want = ["logged together"], drawn.coupling
    told = re.search(r"coupling: (\[\{.*?\}\])", text)
    stated = yaml.safe_load(told[1]) if told else []
    size, off = ("factor", _OF_FACTOR) if "factor" in want else ("mm_per_turn", _OF_PITCH_MM)
    told_of = [(each["joint"], each["by"], each.get(size, np.nan)) for each in stated]
    if len(told_of) == 1 and told_of[0][:2] == (want["joint"], want["by"]):
        holds += ["named"] if abs(told_of[0][2] - want[size]) <= off else []
    return tuple(holds), f"{dict(want)} under {made.instrument.kind}: {stated or text[:400]}"


JUDGES = {"small": small, "quills": quills, "large": large}


def main() -> None:
    """Draw, judge, and print a line each and the rates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("which", choices=JUDGES, nargs="?", default="small")
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    limit_threads()
    judge = JUDGES[asked.which]
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as place:
        for k in range(asked.first, asked.first + asked.count):
            rng = np.random.default_rng([asked.seed, k])
            holds, line = judge(Path(place) / f"arm{k}", k, rng)
            counts.update(holds)
            print(f"{k}: {'' if 'named' in holds or 'none' in holds else 'NOT '}{line}", flush=True)
    print(", ".join(f"{what}: {count}" for what, count in counts.items()))


if __name__ == "__main__":
    main()
