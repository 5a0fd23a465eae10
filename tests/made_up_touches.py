"""A small made-up campaign of touched balls, written as raw files that a test may spoil."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from made_up_sightings import RawFolder, described
from pa10cal.arm.chain import Chain
from pa10cal.files.arms import load_arm

BALLS_MM = {"A": [95.0, 0.0, 310.0], "B": [-50.0, 80.0, 310.0], "C": [-50.0, -80.0, 312.0]}
RADIUS_MM = 12.7
NORMALS = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], dtype=float)
PERIOD_S, STILL_S = 45.0, 4.0
APPROACH, DWELL = 6, 10
NOISE_MM = 0.004


@dataclass(kw_only=True)
class RawCampaign(RawFolder):
    """Raw files of touched balls, with the truth they were made from."""

    T_instr_base: np.ndarray
    q_rad: np.ndarray
    T_instr_ee: np.ndarray
    keys: list[tuple[str, str, int, int]]
    cmm: list[str]
    resolver: list[str]


def touched_campaign() -> RawCampaign:
    """34 configurations: two lines of 4, 6 grid poses x 2 loads x 2 repeats, 2 held out."""
    rng = np.random.default_rng(20080427)
    chain = Chain.of(load_arm("pa10_6ce"))
    centre = np.radians([0.0, 10.0, 100.0, 5.0, 50.0, -80.0])
    line = np.linspace(0.0, 0.15, 4)
    moves = [_along(chain, centre, line, axis) for axis in (0, 1)]
    spread = centre + rng.uniform(-0.3, 0.3, (8, 6))
    keys = [("line_x", f"LX{k:02d}", 0, 1) for k in range(1, 5)]
    keys += [("line_y", f"LY{k:02d}", 0, 1) for k in range(1, 5)]
    commands = [*moves[0], *moves[1]]
    for repeat in (1, 2):
        for load in (0, 22):
            keys += [("grid", f"P{k:02d}", load, repeat) for k in range(1, 7)]
            commands += list(spread[:6])
    keys += [("holdout", "H01", 22, 1), ("holdout", "H02", 44, 1)]
    commands += list(spread[6:])
    q_rad = np.array(commands)
    T_instr_base = np.eye(4)
    T_instr_base[:3, :3] = Rotation.from_rotvec([0.01, -0.02, 1.6]).as_matrix()
    T_instr_base[:3, 3] = [0.3, 0.2, -0.15]
    T_instr_ee = T_instr_base @ chain.forward(q_rad)
    return RawCampaign(
        folder=Path("made-up"),
        T_instr_base=T_instr_base,
        q_rad=q_rad,
        T_instr_ee=T_instr_ee,
        keys=keys,
        description=_description(),
        cmm=_cmm_lines(keys, T_instr_ee, rng),
        resolver=_resolver_lines(q_rad, rng),
        poses=_pose_lines(keys, q_rad, T_instr_ee),
    )


def _along(chain: Chain, q0_rad: np.ndarray, travel_m: np.ndarray, axis: int) -> np.ndarray:
    """Joint positions that carry the end straight along a base axis, by Newton steps."""
    target = np.repeat(chain.forward(q0_rad[None]), len(travel_m), axis=0)
    target[:, axis, 3] += travel_m
    q = np.tile(q0_rad, (len(travel_m), 1))
    for _ in range(20):
        pose = chain.forward_with_screws(q)
        turn = Rotation.from_matrix(target[:, :3, :3] @ np.swapaxes(pose.T[:, :3, :3], 1, 2))
        gap = np.hstack([target[:, :3, 3] - pose.T[:, :3, 3], turn.as_rotvec()])
        q += np.linalg.solve(pose.screws[:, :, chain.joint_columns], gap[..., None])[..., 0]
    return q


def _description() -> dict[str, Any]:
    said = described(
        mass_kg=2.4,
        com_mm=(0, 0, 190),
        load_point_mm=(0, 0, 30),
        robot="pa10_6ce",
        instrument={"kind": "touch_trigger_cmm", "uncertainty_mm": 0.005},
        ball_diameter_mm=2 * RADIUS_MM,
        files={"cmm": "cmm.csv", "resolver": "resolver.csv"},
    )
    said["tool"]["balls_mm"] = {name: list(place) for name, place in BALLS_MM.items()}
    return said


def _cmm_lines(keys, T_instr_ee, rng) -> list[str]:
    lines = ["time_s,kind,pose,load_N,repeat,ball,touch,x_mm,y_mm,z_mm"]
    for c, (key, T) in enumerate(zip(keys, T_instr_ee, strict=True)):
        for b, (name, ball) in enumerate(BALLS_MM.items()):
            centre = T[:3, :3] @ ball + 1e3 * T[:3, 3]
            for k, normal in enumerate(NORMALS):
                touch = centre + RADIUS_MM * normal + rng.normal(0.0, NOISE_MM, 3)
                time_s = c * PERIOD_S + STILL_S + 1.0 + 6.0 * b + k
                words = [f"{time_s:.2f}", *map(str, key), name, str(k + 1)]
                lines.append(",".join(words + [f"{x:.4f}" for x in touch]))
    return lines


def _resolver_lines(q_rad, rng) -> list[str]:
    header = [*(f"q{j}_deg" for j in range(1, 7)), *(f"tau{j}_Nm" for j in range(1, 7))]
    lines = [",".join(["time_s", *header, "temperature_C"])]
    for c, q in enumerate(np.degrees(q_rad)):
        way = np.where(np.arange(6) % 2 == c % 2, 0.5, -0.5)
        for k in range(APPROACH + DWELL):
            left = max(APPROACH - k, 0)
            time_s = c * PERIOD_S + (STILL_S - 0.4 * left if left else STILL_S + 2 * (k - APPROACH))
            joints = q - way * left + rng.normal(0.0, 1e-4, 6)
            torques = np.array([0.0, -40.0, -30.0, 1.0, -5.0, 0.0]) + rng.normal(0.0, 0.3, 6)
            words = [f"{time_s:.2f}", *(f"{x:.5f}" for x in joints)]
            lines.append(",".join([*words, *(f"{x:.3f}" for x in torques), "21.00"]))
    return lines


def _pose_lines(keys, q_rad, T_instr_ee) -> list[str]:
    joints = ",".join(f"q{j}_deg" for j in range(1, 7))
    lines = [f"time_s,kind,pose,load_N,repeat,{joints},x_mm,y_mm,z_mm,qw,qx,qy,qz"]
    quaternions = Rotation.from_matrix(T_instr_ee[:, :3, :3]).as_quat(scalar_first=True)
    for c, key in enumerate(keys):
        numbers = [*np.degrees(q_rad[c]), *1e3 * T_instr_ee[c, :3, 3], *quaternions[c]]
        words = [f"{c * PERIOD_S:.1f}", *map(str, key), *(f"{x:.6f}" for x in numbers)]
        lines.append(",".join(words))
    return lines
