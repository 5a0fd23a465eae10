"""Records to file and back, and what is refused."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from pydantic import TypeAdapter

from pa10cal.errors import RecordError
from pa10cal.results.arrays import Shape
from pa10cal.results.calibration import BaseFrameRecord, Covariance
from pa10cal.results.codec import lines, read, read_lines, write
from pa10cal.results.comparison import ParameterRows
from pa10cal.results.evaluation import HeldOutModel, HeldOutRows, TransferRecord
from pa10cal.results.montecarlo import Convergence
from pa10cal_curve.records import CurveRecord
from pa10cal_lab.trial_records import FailedTrialRecord, JudgedTrialRecord, TrialVerdictRecord

finite = st.floats(allow_nan=False, allow_infinity=False)


def seed(**changes: Any) -> BaseFrameRecord:
    keys = {
        "campaign": "made-up",
        "provenance": "made up for a test, 5 °C",
        "method": "hand_eye_poses",
        "R_instr_base": np.eye(3),
        "origin_instr_m": np.zeros(3),
        "T_instr_base": np.eye(4),
        "held_as_stated": (),
        "origin_scatter_mm": 0.1,
        "origin_poses": np.int64(7),
        "origin_from": "poses",
    }
    return BaseFrameRecord(**(keys | changes))


def held_out(**changes: Any) -> HeldOutRows:
    columns = {
        "pose": np.array(["H1", "H2"]),
        "load_N": np.array([0.0, 22.0]),
        "position_mm": np.arange(6.0).reshape(2, 3),
        "error_mm": np.ones(2),
        "rotation_deg": None,
        "extrapolated": np.array([False, True]),
    }
    return HeldOutRows(**(columns | changes))


def transfer(rows: HeldOutRows) -> TransferRecord:
    model = HeldOutModel(
        mean_mm=1.0,
        peak_mm=2.0,
        rms_mm=1.5,
        orientation_deg=None,
        configurations=2,
        per_load={},
        per_point={},
        tool_twist=None,
        inside=None,
        outside=None,
        rows=rows,
    )
    return TransferRecord(
        campaign="b", provenance="p", from_="a", configurations=2, models={"linear": model}
    )


def test_a_record_comes_back_equal(tmp_path: Path) -> None:
    record = seed(x_direction_u_rad=1e-6, p_ee_targets_m={"A": np.array([0.1, 0.2, 5e-324])})
    write(record, tmp_path / "seed" / "base_frame.json")
    assert read(BaseFrameRecord, tmp_path / "seed" / "base_frame.json", "made-up") == record


@given(
    position_mm=arrays.arrays(float, (3, 3), elements=finite),
    error_mm=arrays.arrays(float, 3, elements=finite),
)
def test_numbers_keep_every_bit(position_mm: Any, error_mm: Any, tmp_path_factory: Any) -> None:
    path = tmp_path_factory.mktemp("record") / "transfer.json"
    record = transfer(
        held_out(
            pose=np.array(["a", "b", "é"]),
            load_N=np.zeros(3),
            position_mm=position_mm,
            error_mm=error_mm,
            extrapolated=None,
        )
    )
    write(record, path)
    assert read(TransferRecord, path) == record


def test_rows_are_objects_in_the_file(tmp_path: Path) -> None:
    write(transfer(held_out()), tmp_path / "transfer.json")
    content = json.loads((tmp_path / "transfer.json").read_text(encoding="utf-8"))
    assert content["from"] == "a"
    assert content["models"]["linear"]["rows"] == [
        {
            "pose": "H1",
            "load_N": 0.0,
            "position_mm": [0.0, 1.0, 2.0],
            "error_mm": 1.0,
            "rotation_deg": None,
            "extrapolated": False,
        },
        {
            "pose": "H2",
            "load_N": 22.0,
            "position_mm": [3.0, 4.0, 5.0],
            "error_mm": 1.0,
            "rotation_deg": None,
            "extrapolated": True,
        },
    ]


def test_no_rows_come_back_as_none(tmp_path: Path) -> None:
    rows = HeldOutRows(
        pose=[], load_N=[], position_mm=[], error_mm=[], rotation_deg=None, extrapolated=None
    )
    write(transfer(rows), tmp_path / "transfer.json")
    found = read(TransferRecord, tmp_path / "transfer.json").models["linear"].rows
    assert len(found) == 0
    assert found.position_mm.shape == (0, 3)


def test_schema_stands_first_and_absent_keys_are_absent(tmp_path: Path) -> None:
    write(seed(), tmp_path / "seed.json")
    content = json.loads((tmp_path / "seed.json").read_text(encoding="utf-8"))
    assert next(iter(content.items())) == ("schema", "pa10cal-base-frame/1")
    assert "line_x" not in content
    assert "5 °C" in (tmp_path / "seed.json").read_text(encoding="utf-8")


def test_arrays_of_a_record_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        seed().T_instr_base[0, 0] = 2.0


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"T_instr_base": np.eye(3)}, "T_instr_base"),
        ({"T_instr_base": np.full((4, 4), np.nan)}, "T_instr_base"),
        ({"origin_instr_m": []}, "origin_instr_m"),
        ({"origin_scatter_mm": float("inf")}, "origin_scatter_mm"),
        ({"lines": 2}, "lines"),
    ],
)
def test_a_record_is_not_made_wrong(changes: dict[str, Any], key: str) -> None:
    with pytest.raises(ValueError, match=key):
        seed(**changes)


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_plain_data_of_another_owner_is_finite_too(number: float) -> None:
    with pytest.raises(ValueError, match=r"settings\.gait.*seconds"):
        CurveRecord(
            link_m=0.1,
            links=2,
            order="zy",
            largest_angle_deg=1.0,
            largest_move_deg=0.0,
            feasible_rolls_deg=None,
            shapes=(),
            settings={"gait": {"seconds": [1.0, number]}},
        )


def test_columns_have_one_length() -> None:
    with pytest.raises(ValueError, match="one length"):
        held_out(load_N=np.zeros(3))


def spoiled(path: Path, **changes: Any) -> Path:
    write(seed(), path)
    content = json.loads(path.read_text(encoding="utf-8")) | changes
    gone = {key for key, value in content.items() if value == "gone"}
    path.write_text(json.dumps({k: v for k, v in content.items() if k not in gone}))
    return path


def test_added_keys_are_passed_over(tmp_path: Path) -> None:
    assert read(BaseFrameRecord, spoiled(tmp_path / "seed.json", added=[1])) == seed()


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"schema": "pa10cal-verdict/1"}, ("not a record of this kind", "pa10cal-base-frame/1")),
        ({"campaign": "other"}, ("another campaign", "'other'", "made-up")),
        ({"T_instr_base": "gone"}, ("lacks T_instr_base", "pa10cal seed again")),
        ({"origin_poses": "many"}, ("origin_poses is not", "'many'", "integer")),
        ({"T_instr_base": [[1.0]]}, ("T_instr_base is not", "finite numbers, shape (4, 4)")),
        ({"origin_instr_m": ["1", "2", "3"]}, ("origin_instr_m is not", "finite numbers")),
        ({"method": "guess"}, ("method is not", "'guess'", "straight_lines")),
    ],
)
def test_a_spoiled_file_is_refused_by_key(
    tmp_path: Path, changes: dict[str, Any], parts: tuple[str, ...]
) -> None:
    path = spoiled(tmp_path / "seed.json", **changes)
    with pytest.raises(RecordError) as caught:
        read(BaseFrameRecord, path, "made-up")
    assert all(part in str(caught.value) for part in (*parts, str(path)))


@pytest.mark.parametrize("text", ["", "[1, 2]", '{"schema": NaN}', "{"])
def test_what_is_no_record_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "seed.json"
    path.write_text(text)
    with pytest.raises(RecordError, match=r"seed\.json"):
        read(BaseFrameRecord, path)


def test_a_missing_file_names_the_command(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="run pa10cal seed first"):
        read(BaseFrameRecord, tmp_path / "seed.json")


def test_a_row_without_a_key_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "transfer.json"
    write(transfer(held_out()), path)
    content = json.loads(path.read_text(encoding="utf-8"))
    del content["models"]["linear"]["rows"][1]["error_mm"]
    path.write_text(json.dumps(content))
    with pytest.raises(RecordError, match="every row with error_mm"):
        read(TransferRecord, path)


def test_lines_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "verdicts.jsonl"
    failed = [FailedTrialRecord(campaign=name, failed="no poses") for name in ("t1", "t2")]
    path.write_text(lines(failed))
    assert read_lines(TrialVerdictRecord, path) == failed
    path.write_text(lines(failed) + '{"schema": "pa10cal-verdict/1", "campaign": "t3"}\n')
    with pytest.raises(RecordError, match=r"verdicts\.jsonl:3: the record lacks"):
        read_lines(TrialVerdictRecord, path)
    assert JudgedTrialRecord.kinds() == (JudgedTrialRecord,)


def test_whole_numbers_stay_whole() -> None:
    found = Convergence(cycles=[10, 20], mean_mm=[1, 2], half_width95_mm=[0.5, 0.25])
    assert found.cycles.dtype == np.int64
    assert found.mean_mm.dtype == np.float64
    with pytest.raises(ValueError, match="cycles"):
        Convergence(cycles=[0.5], mean_mm=[1.0], half_width95_mm=[0.5])


@pytest.mark.parametrize("kind", [np.float64, np.int64, np.bool_, np.str_])
def test_entries_have_the_type_stated_in_every_numpy(kind: Any) -> None:
    before = GenericAlias(np.ndarray, (tuple[Any, ...], np.dtype[kind]))
    since_2_5 = GenericAlias(np.ndarray, (kind,))
    for annotation in (before, since_2_5, NDArray[kind]):
        made = TypeAdapter(Annotated[annotation, Shape("k")]).validate_python([])
        assert made.dtype.type is kind


def test_records_know_nothing_of_the_domain() -> None:
    """They are read by everything, so they must cost little and depend on nothing above them."""
    code = (
        "import pkgutil, sys, pa10cal.results as records\n"
        "[__import__(f'pa10cal.results.{found.name}') "
        "for found in pkgutil.iter_modules(records.__path__)]\n"
        "print(*(name for name in sys.modules if name.startswith('pa10cal.') or name in "
        "('scipy', 'pandas', 'yaml', 'matplotlib')))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    parts = {name.split(".")[1] for name in run.stdout.split() if name.startswith("pa10cal.")}
    assert parts == {"results", "errors", "files", "input_files"}
    assert not {"scipy", "pandas", "yaml", "matplotlib"} & set(run.stdout.split())


def test_columns_that_are_no_lists_are_refused() -> None:
    rows = dict.fromkeys(ParameterRows.model_fields, 5)
    with pytest.raises(ValueError, match="finite numbers, shape"):
        ParameterRows.model_validate(rows)


def test_a_covariance_has_a_row_for_each_name() -> None:
    for shape in ((3, 3), (2, 3)):
        with pytest.raises(ValueError, match="2 rows and columns, as many as names"):
            Covariance(names=("delta_a_1", "delta_a_2"), matrix=np.zeros(shape))
