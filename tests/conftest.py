"""A small made-up campaign, written as raw files that a test may spoil."""

from __future__ import annotations

import os

# Before numpy is imported: its threads only get in each other's way in matrices of this size.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import gc
import inspect
import re
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache
from linecache import getlines
from pathlib import Path
from types import CodeType
from typing import Any

import numpy as np
import pytest
from hypothesis import settings as hypothesis_settings
from scipy.spatial.transform import Rotation

from attacks import Attack, Forking
from built_once import built_once
from drawn_examples import use_few
from made_up_mistakes import Own, own_campaign
from made_up_sightings import RawFolder, described
from pa10cal.arm.chain import Chain
from pa10cal.files.arms import load_arm
from snakemake_calls import Snakemake

# A change is judged by the same examples each time; at a desk every run looks at new ones.
hypothesis_settings.register_profile("same_examples", derandomize=True)
if os.environ.get("CI"):
    hypothesis_settings.load_profile("same_examples")

#: Files that come first: a long one at the end would keep one worker alone, and what is built once
#: a session is there when the others ask for it.
FIRST = (
    "tests/test_workflow.py",
    "tests/figures/test_discovery_pictures.py",
    "tests/discovery/evidence/test_discover.py",
    "tests/discovery/blocked_cv/test_discover.py",
    "tests/test_interface.py",
    "tests/test_examples.py",
    "tests/test_datasets_rules.py",
    "tests/running/",
)

BALLS_MM = {"A": [95.0, 0.0, 310.0], "B": [-50.0, 80.0, 310.0], "C": [-50.0, -80.0, 312.0]}
RADIUS_MM = 12.7
NORMALS = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], dtype=float)
PERIOD_S, STILL_S = 45.0, 4.0
APPROACH, DWELL = 6, 10
NOISE_MM = 0.004


#: Equal numbers or bytes, and tolerances of rounding: what another processor's kernels may change.
DIGITS = re.compile(r"array_equal|read_bytes\(\)|tobytes\(|1e-1[0-9]\b|finfo")


def pytest_configure(config: pytest.Config) -> None:
    """Try properties with fewer examples where slow tests are left out."""
    if config.getoption("markexpr") == "not slow":
        use_few()


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """Leave all that was collected out of garbage collection.

    Half a million objects of tests and libraries stay to the end: looking through them again and
    again takes a twelfth of the time of all tests.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files first that are named so; workers take files in the order of the items.

    Tests that compare digits get their marker here, so that none is forgotten; so do cases of a
    test that is `slow_but_one_in` some number.
    """
    for item in items:
        if (one := item.get_closest_marker("slow_but_one_in")) and not _is_one_in(item, *one.args):
            item.add_marker(pytest.mark.slow)
        function = getattr(item, "function", None)
        if function is not None:
            drawn = getattr(function, "hypothesis", None)
            written = inspect.unwrap(drawn.inner_test if drawn else function)
            if _compares_digits(written.__code__):
                item.add_marker(pytest.mark.digits)
    items.sort(key=lambda item: not item.nodeid.startswith(FIRST))


def _is_one_in(item: pytest.Item, number: int) -> bool:
    """Take the first of each so many cases of a test, whatever is selected."""
    return max(item.callspec.indices.values()) % number == 0


@cache
def _compares_digits(code: CodeType) -> bool:
    """Look at the lines of a function as they stand: asking `inspect` for them takes seconds."""
    return DIGITS.search("".join(getlines(code.co_filename)[slice(*_lines(code))])) is not None


def _lines(code: CodeType) -> tuple[int, int]:
    """Return where the lines of a function begin and end, those of functions inside it too."""
    inside = (_lines(each)[1] for each in code.co_consts if isinstance(each, CodeType))
    ends = (place[1] for place in code.co_positions() if place[1] is not None)
    return code.co_firstlineno - 1, max(*inside, *ends, code.co_firstlineno)


@pytest.fixture
def own(tmp_path_factory, tmp_path, monkeypatch) -> Own:
    """A right campaign with files of its own, in which no workflow is ever started."""

    def never(*_):
        raise AssertionError("the workflow was started")

    monkeypatch.setattr("pa10cal.running.workflow.run_workflow", never)
    right = built_once(tmp_path_factory, "right_campaign", own_campaign)
    return right.copy(tmp_path / "zelle")


@pytest.fixture(scope="session")
def ipa_data() -> Path:
    """The public UR10 data set ipa-robot-accuracy, where there is a copy of it."""
    named = os.environ.get("PA10CAL_IPA_DATA")
    folder = Path(named or Path(__file__).parents[2] / "shared/data/ipa-robot-accuracy")
    if not folder.is_dir():
        if named:
            pytest.fail(f"PA10CAL_IPA_DATA names no folder: {named}")
        pytest.skip("no copy of ipa-robot-accuracy here: PA10CAL_IPA_DATA names none")
    return folder


@pytest.fixture(scope="session")
def call_snakemake(tmp_path_factory) -> Iterator[Snakemake]:
    """Call Snakemake, which is started once."""
    snakemake = Snakemake(tmp_path_factory.mktemp("snakemake"))
    yield snakemake
    snakemake.close()


@pytest.fixture(scope="session")
def forking(tmp_path_factory) -> Iterator[Forking]:
    """A process that forks for each attack, started once."""
    process = Forking(tmp_path_factory.mktemp("attacks"))
    yield process
    process.close()


@pytest.fixture
def attack(forking, tmp_path, request) -> Attack:
    """A folder for what an attacker sends, and commands in limited processes; see `attacks`."""
    return Attack(forking, tmp_path / "sent", tmp_path / "not-sent", request.node.name)


@dataclass(kw_only=True)
class RawCampaign(RawFolder):
    """Raw files of touched balls, with the truth they were made from."""

    T_instr_base: np.ndarray
    q_rad: np.ndarray
    T_instr_ee: np.ndarray
    keys: list[tuple[str, str, int, int]]
    cmm: list[str]
    resolver: list[str]


@pytest.fixture
def raw_campaign(tmp_path: Path, made_up_campaign: RawCampaign) -> RawCampaign:
    """34 configurations: two lines of 4, 6 grid poses x 2 loads x 2 repeats, 2 held out."""
    return replace(deepcopy(made_up_campaign), folder=tmp_path / "made-up")


@pytest.fixture(scope="session")
def made_up_campaign() -> RawCampaign:
    """The raw campaign before a test spoils its copy."""
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
