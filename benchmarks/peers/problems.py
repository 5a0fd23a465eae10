"""The problems that all peers get: simulated arms, and the real UR10 where its data are at hand."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from benchmarks.peers import simulate
from benchmarks.peers.problem import Array, Problem
from pa10cal.arm.chain import Chain
from pa10cal.arm.urdf_writing import urdf_text
from pa10cal.files.arms import load_arm

#: Numbers of poses: errors of the rows alone, and with parallel axes tilted too.
SIZES = {"rows": (27, 100, 300, 1000), "tilted": (27, 300)}
REAL = "ur10-c"
#: Where the real poses are in the data set's folder.
READINGS = Path("Series_C", "measurements_random_poses.csv")
#: Share of the real poses, in order of time, to calibrate with.
_TRAINING_SHARE = 0.7


def write_simulated(folder: Path, seed: int) -> list[Path]:
    """Write the problems of one simulated arm, the smallest first."""
    paths = []
    for kind, sizes in SIZES.items():
        for count in sizes:
            path = folder / f"{kind}-{count:04d}-{seed}.npz"
            _problem(*simulate.draw_readings(seed, count, kind == "tilted")).write(path)
            paths.append(path)
    return paths


def write_real(folder: Path, data: Path) -> Path:
    """Write the problem of the real UR10, split in order of time.

    Args:
        folder: where to write.
        data: the folder of the data set ipa-robot-accuracy.
    """
    table = pd.read_csv(data / READINGS, sep=";", decimal=",")
    joints = [name for name in table.columns if name.endswith("_joint")]
    q_rad = table[joints].to_numpy(dtype=float)
    p_m = 1e-3 * table[[f"measurement_{axis}" for axis in "xyz"]].to_numpy(dtype=float)
    split = int(_TRAINING_SHARE * len(q_rad))
    path = folder / f"{REAL}.npz"
    _problem(q_rad[:split], p_m[:split], q_rad[split:], p_m[split:]).write(path)
    return path


def uncalibrated_errors_mm(problem: Problem) -> Array:
    """Return the (M,) held-out errors of nominal rows with base and target of the first guess."""
    return problem.test_errors_mm(
        simulate.seen_m(
            simulate.flange_poses(problem.mdh, problem.q_test_rad),
            problem.T_world_base,
            problem.p_flange_target_m,
        )
    )


def nominal_urdf(p_flange_target_m: Array) -> str:
    """Return the nominal UR10 as the package writes it, with the target as its last link."""
    chain = Chain.of(load_arm("ur10"))
    robot = ElementTree.fromstring(urdf_text(chain, chain.nominal, "ur10"))
    ElementTree.SubElement(robot, "link", name="target")
    joint = ElementTree.SubElement(robot, "joint", name="to_target", type="fixed")
    place = " ".join(repr(float(value)) for value in p_flange_target_m)
    ElementTree.SubElement(joint, "origin", xyz=place, rpy="0 0 0")
    ElementTree.SubElement(joint, "parent", link="flange")
    ElementTree.SubElement(joint, "child", link="target")
    return ElementTree.tostring(robot, encoding="unicode")


def _problem(q_train_rad: Array, p_train_m: Array, q_test_rad: Array, p_test_m: Array) -> Problem:
    mdh = simulate.NOMINAL_MDH
    T_world_base, p_flange_m = simulate.first_guess(mdh, q_train_rad, p_train_m)
    return Problem(
        q_train_rad=np.asarray(q_train_rad),
        p_train_m=p_train_m,
        q_test_rad=q_test_rad,
        p_test_m=p_test_m,
        mdh=mdh,
        urdf=nominal_urdf(p_flange_m),
        T_world_base=T_world_base,
        p_flange_target_m=p_flange_m,
        noise_m=simulate.NOISE_M,
        tolerance_m=simulate.TOLERANCE_M,
        tolerance_rad=simulate.TOLERANCE_RAD,
    )
