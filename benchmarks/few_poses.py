"""A calibrated arm after a change, and a few poses of one target: what does its model do there?

`python -m benchmarks.few_poses [--count 60] [--seed 1]` builds arms of the shipped descriptions
with links bent in any way, gears that run out of round, and joints that give way along and across
their axes: the forward kinematics are written here and share no code with the program, and its
model lacks much of them. Each is calibrated with many poses. Then one or two things change: the
zero of a joint, the tool, the base. A few poses of one target follow, taken once

- as the program does with `--prior`,
- with base and tool of the earlier model fitted anew, and nothing else,
- with the changes that were made freed beside base and tool, as nobody knows them.

Each is judged by the true places of the target in poses that were never read.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from pa10cal.commands.command_line import limit_threads
from pa10cal.fit.fitted_model import FittedModel

ROBOTS = ("ur10", "irb120", "iiwa14", "pa10_6ce", "gx4_351s")
#: Poses after the change, and those that judge.
COUNTS = (6, 8, 10, 12)
_JUDGED = 300
#: A model that is by so much worse than another one is worse by more than noise.
NOISE = 1.02
#: What a change of a zero makes worse by so much, base and tool fitted anew, it matters for.
_MATTERS = 1.25


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm as it was built, and what is on it."""

    rows: list[dict[str, Any]]  # of its description
    zeros: np.ndarray  # (n,) of the joints [rad, m]
    bent: np.ndarray  # (n, 4, 4) what every link departs by, at its end
    waves: np.ndarray  # (n, 2, 2) of the gears: once and twice a turn, sine and cosine [rad]
    soft: np.ndarray  # (n, 3) turn of a joint about its x, y and z by a moment about these [rad/Nm]
    masses_kg: np.ndarray  # (n + 1,) of the links, halfway to the next joint, and of the tool
    target_m: np.ndarray  # (3,) on the flange
    T_tracker_base: np.ndarray  # (4, 4)

    def seen(self, q: np.ndarray) -> np.ndarray:
        """Return where a tracker sees the target, (N, 3) [m], for joint positions (N, n)."""
        sag = np.zeros((len(q), len(self.rows), 3))
        for _ in range(2):  # what hangs follows what gave way
            frames = self._frames(q, sag)
            sag = self._sag(frames)
        end = self._frames(q, sag)[-1]
        p = end[:, :3, :3] @ self.target_m + end[:, :3, 3]
        return p @ self.T_tracker_base[:3, :3].T + self.T_tracker_base[:3, 3]

    def _frames(self, q: np.ndarray, sag: np.ndarray) -> list[np.ndarray]:
        """Return the frames (N, 4, 4) before every joint, and that of the flange."""
        T = np.tile(np.eye(4), (len(q), 1, 1))
        found = [T]
        for j, row in enumerate(self.rows):
            moves = q[:, j] + self.zeros[j]
            turn, slide = (
                np.full(len(q), np.radians(row.get("theta_deg", 0.0))),
                row.get("d_m", 0.0),
            )
            if row.get("prismatic"):
                slide = slide + moves
            else:
                once = np.stack([np.sin(moves), np.cos(moves)])
                twice = np.stack([np.sin(2 * moves), np.cos(2 * moves)])
                turn = turn + moves + self.waves[j, 0] @ once + self.waves[j, 1] @ twice
            T = T @ _moved(Rotation.from_rotvec(sag[:, j]).as_matrix(), np.zeros(3))
            along = np.column_stack([np.zeros((len(q), 2)), np.broadcast_to(slide, len(q))])
            T = T @ _moved(Rotation.from_euler("z", turn[:, None]).as_matrix(), along)
            tilt = Rotation.from_euler("x", np.radians(row.get("alpha_deg", 0.0))).as_matrix()
            T = T @ _moved(tilt, np.array([row.get("a_m", 0.0), 0.0, 0.0])) @ self.bent[j]
            found.append(T)
        return found

    def _sag(self, frames: list[np.ndarray]) -> np.ndarray:
        """Return by how much every joint gives way about its axes, (N, n, 3) [rad]."""
        places = [0.5 * (a[:, :3, 3] + b[:, :3, 3]) for a, b in pairwise(frames)]
        places.append(frames[-1][:, :3, 3] + 0.5 * frames[-1][:, :3, :3] @ self.target_m)
        sag = np.zeros((len(frames[0]), len(self.rows), 3))
        for j in range(len(self.rows)):
            arm = sum(
                m * (p - frames[j][:, :3, 3])
                for m, p in zip(self.masses_kg[j:], places[j:], strict=True)
            )
            moment = np.cross(arm, [0.0, 0.0, -9.81])
            own = np.einsum("nji,nj->ni", frames[j][:, :3, :3], moment)
            sag[:, j] = self.soft[j] * own
        return sag


def _moved(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, p, 1.0
    return T


def drawn(robot: str, rng: np.random.Generator) -> Arm:
    """Return an arm as it was built, with a reflector before a tracker."""
    text = files("pa10cal.files").joinpath("arms", f"{robot}.yaml").read_text(encoding="utf-8")
    rows = yaml.safe_load(text)["rows"]
    n, slides = len(rows), np.array([bool(row.get("prismatic")) for row in rows])
    reach_m = sum(abs(row.get("a_m", 0.0)) + abs(row.get("d_m", 0.0)) for row in rows)
    masses = np.array([row.get("mass_kg", 5.0 * 0.7**j) for j, row in enumerate(rows)])
    bent = _moved(
        Rotation.from_rotvec(rng.normal(0.0, 5e-4, (n, 3))).as_matrix(),
        rng.normal(0.0, 3e-4, (n, 3)),
    )
    # What no model has: some hundredths to tenths of a millimetre at the end.
    lacks_rad = 1e-3 * np.exp(rng.uniform(np.log(0.01), np.log(0.12))) / reach_m
    waves = rng.normal(0.0, 1.0, (n, 2, 2)) * lacks_rad * np.array([1.0, 0.5])[:, None]
    waves[slides] = 0.0
    moment_Nm = 9.81 * masses.sum() * reach_m / 4.0
    soft = np.abs(rng.normal(0.0, 2.0 * lacks_rad / moment_Nm, (n, 3)))
    soft[:, 2] = rng.uniform(0.5, 2.0, n) * 4e-4 / moment_Nm
    soft[slides] = 0.0
    zeros = np.where(slides, rng.normal(0.0, 3e-4, n), rng.normal(0.0, 2e-3, n))
    return Arm(rows, zeros, bent, waves, soft, np.append(masses, 1.0), _tool(rng), _base(rng))


def _tool(rng: np.random.Generator) -> np.ndarray:
    return np.array([*rng.uniform(-0.08, 0.08, 2), rng.uniform(0.03, 0.15)])


def _base(rng: np.random.Generator) -> np.ndarray:
    yaw = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
    level = Rotation.from_rotvec([*rng.normal(0.0, 3e-3, 2), 0.0])
    return _moved((level * yaw).as_matrix(), rng.uniform(-2.0, 2.0, 3))


@dataclass(frozen=True)
class Changes:
    """What happened to an arm."""

    zeros: dict[int, float]  # of joints, from 1, by how much each moved [rad, m]
    tool: bool
    base: bool

    @classmethod
    def drawn(cls, arm: Arm, rng: np.random.Generator) -> Changes:
        """Draw one or two: zeros of joints, the tool, the base."""
        what = rng.choice(["zero", "zero", "zero", "tool", "base"], int(rng.integers(1, 3)))
        joints = rng.permutation(len(arm.rows))[: np.count_nonzero(what == "zero")] + 1
        sizes = rng.choice([-1.0, 1.0], len(joints)) * np.exp(
            rng.uniform(np.log(2e-4), np.log(2e-2), len(joints))
        )
        slides = [0.25 if arm.rows[j - 1].get("prismatic") else 1.0 for j in joints]
        zeros = {int(j): float(s * w) for j, s, w in zip(joints, sizes, slides, strict=True)}
        return cls(zeros, "tool" in what, "base" in what)

    def on(self, arm: Arm, rng: np.random.Generator) -> Arm:
        """Return the arm after them."""
        zeros = arm.zeros.copy()
        for joint, by in self.zeros.items():
            zeros[joint - 1] += by
        after = replace(arm, zeros=zeros)
        if self.tool:
            masses = np.append(arm.masses_kg[:-1], rng.uniform(0.5, 2.0))
            after = replace(after, target_m=_tool(rng), masses_kg=masses)
        return replace(after, T_tracker_base=_base(rng)) if self.base else after


def positions(arm: Arm, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw joint positions (count, n) above the floor."""
    limits = np.array([row.get("limits_m") or np.radians(row["limits_deg"]) for row in arm.rows])
    middle, half = limits.mean(axis=1), 0.45 * np.ptp(limits, axis=1)
    half = np.minimum(half, 2.6)
    q = middle + half * rng.uniform(-1.0, 1.0, (20 * count, len(half)))
    p = arm._frames(q, np.zeros((len(q), len(half), 3)))[-1][:, :3, 3]
    scara = any(row.get("prismatic") for row in arm.rows)
    return q[(p[:, 2] > 0.1) | scara][:count]


def written(folder: Path, robot: str, arm: Arm, q: np.ndarray, noise_mm: float, seed: int) -> Path:
    """Write a campaign of an arm; return its folder."""
    rng = np.random.default_rng(seed)
    p_mm = 1e3 * arm.seen(q) + rng.normal(0.0, noise_mm, (len(q), 3))
    slides = [bool(row.get("prismatic")) for row in arm.rows]
    names = [f"q{j + 1}_{'mm' if slide else 'deg'}" for j, slide in enumerate(slides)]
    values = np.where(slides, 1e3 * q, np.degrees(q))
    lines = [",".join(["time_s,pose,load_N,repeat,kind", *names, "T1_x_mm,T1_y_mm,T1_z_mm"])]
    for k in range(len(q)):
        numbers = ",".join(f"{each:.6f}" for each in (*values[k], *p_mm[k]))
        lines.append(f"{10 * k + 10}.0,P{k:03d},0,1,grid,{numbers}")
    folder.mkdir(parents=True)
    (folder / "poses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    about = {
        "schema": "pa10cal-campaign/1",
        "name": folder.name,
        "provenance": "SYNTHETIC: a few poses of one target",
        "robot": robot,
        "instrument": {"kind": "points", "uncertainty_mm": round(noise_mm, 4)},
        "tool": {
            "mass_kg": round(float(arm.masses_kg[-1]), 3),
            "com_mm": [round(float(each), 2) for each in 500.0 * arm.target_m],
            "load_point_mm": [0, 0, 0],
        },
        "gravity_m_s2": [0, 0, -9.81],
        "reference_temperature_C": 20,
        "files": {"poses": "poses.csv"},
    }
    (folder / "campaign.yaml").write_text(yaml.safe_dump(about), encoding="utf-8")
    return folder


def calibrated(folder: Path, prior: FittedModel | None) -> tuple[FittedModel, str, list[str], str]:
    """Return the model that the program makes, its words on the prior, what moved, its grade."""
    from pa10cal.calibration.campaign import calibrated_record
    from pa10cal.calibration.input_checks import check_input
    from pa10cal.calibration.load_case import LoadCase
    from pa10cal.calibration.options import CalibrationOptions
    from pa10cal.fit.model_reading import models_of
    from pa10cal.interface import read_campaign

    campaign, options = read_campaign(folder), CalibrationOptions()
    about = campaign.description, campaign.arm, campaign.observations
    case = LoadCase(*about, "combined", options, check_input(*about, options), prior)
    record = calibrated_record(case, None)
    *_, model = models_of(record, campaign.name).values()
    part = getattr(record, "prior", None)
    moved = [f"{each.kind} {each.of}" for each in part.moved] if part else []
    return model, part.line if part else "", moved, record.health.grade


def base_and_tool(folder: Path, prior: FittedModel) -> FittedModel:
    """Return the earlier model with base and tool fitted anew."""
    from pa10cal.calibration.options import CalibrationOptions
    from pa10cal.discovery.preparation import setup_of
    from pa10cal.evaluation.carried_model import with_frames_refitted
    from pa10cal.interface import read_campaign
    from pa10cal.options import DiscoveryOptions

    campaign = read_campaign(folder)
    setup = setup_of(campaign.description, campaign.arm, CalibrationOptions(), DiscoveryOptions())
    return with_frames_refitted(prior, campaign.observations, setup).model


def with_changes(folder: Path, prior: FittedModel, joints: list[int]) -> FittedModel:
    """Return the model with the zeros of some joints freed beside base and tool."""
    from pa10cal.calibration.general import calibrate
    from pa10cal.calibration.general.as_model import fitted
    from pa10cal.calibration.general.fit import fit
    from pa10cal.calibration.general.prior import prior_of
    from pa10cal.calibration.general.problem import with_unknown_frames
    from pa10cal.calibration.general.unknowns import choose_unknowns
    from pa10cal.fit.loads import with_torques
    from pa10cal.interface import read_campaign
    from pa10cal.observe.observations import average_repeats
    from pa10cal.options import Tolerances
    from pa10cal.terms.model import Model

    campaign = read_campaign(folder)
    arm, poses = campaign.arm, average_repeats(campaign.observations)
    payload = campaign.description.payload(arm)
    known, start = prior_of(prior, arm, payload), calibrate.find_start(arm, poses)
    model = Model(prior.model.chain, known.terms)
    expected = known.expected
    names = [each.name for each in model.parameters]
    for joint in joints:
        zero = f"delta_{'d' if arm.prismatic[joint - 1] else 'theta'}_{joint}"
        if zero in names:
            expected = expected.widened(0.03 * np.eye(len(names))[:, names.index(zero)][:, None])
    states, _ = with_torques(model, expected.mean, poses.states, payload)
    unknowns = choose_unknowns(arm, Tolerances(), poses.measured, start)
    problem, x = with_unknown_frames(
        model, expected.mean, unknowns, start, poses.with_states(states)
    )
    found = fit(problem, x, expected=expected)
    return fitted(
        calibrate.GeneralCalibration(problem, x, start, (), "masses", payload, {}, found, None)
    )


def error_mm(model: FittedModel, arm: Arm, q: np.ndarray) -> float:
    """Return the rms error of a model at the target, in the tracker's frame [mm]."""
    T = model.T_instr_base @ model.predict(q, frame="target_T1").T
    off = 1e3 * np.linalg.norm(T[:, :3, 3] - arm.seen(q), axis=1)
    return float(np.sqrt(np.mean(off**2)))


def judged(seed: int, k: int) -> list[dict[str, Any]]:
    """Return what comes out of a case, for every number of poses."""
    from pa10cal.errors import Pa10calError

    rng, robot = np.random.default_rng([seed, k]), ROBOTS[k % len(ROBOTS)]
    before = drawn(robot, rng)
    noise_mm, many = float(rng.uniform(0.02, 0.06)), int(rng.integers(70, 151))
    changes = Changes.drawn(before, rng)
    after = changes.on(before, rng)
    new, unseen = positions(after, max(COUNTS), rng), positions(after, _JUDGED, rng)
    first, found = positions(before, many, rng), []
    with tempfile.TemporaryDirectory() as place, redirect_stdout(None):
        folder = written(Path(place) / "before", robot, before, first, noise_mm, k)
        prior, _, _, grade = calibrated(folder, None)
        own_mm = error_mm(prior, before, unseen)
        for count in COUNTS:
            folder = written(Path(place) / f"of{count}", robot, after, new[:count], noise_mm, k + 1)
            case = {
                "case": k,
                "robot": robot,
                "poses": count,
                "zeros_mrad": {j: 1e3 * by for j, by in changes.zeros.items()},
                "tool": changes.tool,
                "base": changes.base,
                "noise_mm": noise_mm,
                "prior_grade": grade,
                "prior_mm": own_mm,
            }
            try:
                model, line, moved, after_grade = calibrated(folder, prior)
                case |= {
                    "program_mm": error_mm(model, after, unseen),
                    "line": line,
                    "moved": moved,
                    "grade": after_grade,
                }
            except Pa10calError as refused:
                case |= {"program_mm": float("nan"), "line": str(refused), "moved": []}
            case["frames_mm"] = error_mm(base_and_tool(folder, prior), after, unseen)
            freed = with_changes(folder, prior, list(changes.zeros))
            case["known_mm"] = error_mm(freed, after, unseen)
            found.append(case)
    return found


def summary(cases: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a table of errors and statements by number of poses."""
    yield "| poses | program | base and tool | changes known | worse than base and tool | most |"
    yield "| --- | --- | --- | --- | --- | --- |"
    for count in COUNTS:
        some = [each for each in cases if each["poses"] == count]
        of = {
            name: np.array([each[f"{name}_mm"] for each in some])
            for name in ("program", "frames", "known")
        }
        ratio = of["program"] / of["frames"]
        cells = [f"{np.median(v):.3f}, {np.quantile(v, 0.9):.3f}" for v in of.values()]
        worse = f"{np.count_nonzero(~(ratio <= NOISE))} of {len(some)}"
        yield f"| {count} | {' | '.join(cells)} | {worse} | {np.nanmax(ratio):.2f} |"
    yield "| poses | joints told that moved | cases in which that matters, one told | others told |"
    yield "| --- | --- | --- | --- |"
    for count in COUNTS:
        right = wrong = others = matters = found = 0
        for each in (each for each in cases if each["poses"] == count):
            moved = {f"joint_zero joint {j}" for j in each["zeros_mrad"]}
            told = {name for name in each["moved"] if name.startswith("joint_zero")}
            right, wrong = right + len(told & moved), wrong + len(told - moved)
            others += len(set(each["moved"]) - told)
            # Base and tool take up the zero of the first joint, and often that of the last.
            if moved and each["frames_mm"] > _MATTERS * each["known_mm"]:
                matters, found = matters + 1, found + bool(told & moved)
        yield f"| {count} | {right} of {right + wrong} | {found} of {matters} | {others} |"


def main() -> None:
    """Draw, judge, and print a line each and the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="file for a line of JSON a case")
    asked = parser.parse_args()
    limit_threads()
    cases: list[dict[str, Any]] = []
    for k in range(asked.count):
        for case in judged(asked.seed, k):
            cases.append(case)
            sizes = ", ".join(f"joint {j} {by:+.2f}" for j, by in case["zeros_mrad"].items())
            print(
                f"{k} {case['robot']}, {case['poses']} poses, {sizes or 'no zero'}"
                f"{', tool' * case['tool']}{', base' * case['base']}: "
                f"{case['program_mm']:.3f} mm, base and tool alone {case['frames_mm']:.3f}, "
                f"changes known {case['known_mm']:.3f}, before {case['prior_mm']:.3f}; "
                f"{case['line']}",
                flush=True,
            )
    print("\n".join(summary(cases)))
    if asked.out is not None:
        asked.out.write_text("\n".join(map(json.dumps, cases)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
