"""The command: what it writes, what it refuses, and that threads change nothing."""

import json
import os
import subprocess
import sys
from importlib.resources import files

import pytest

from pa10cal.commands.command_line import run_command
from pa10cal.montecarlo.plane import BLOCK_CYCLES

SMALL = {"cycles": 400, "positions": 20, "map_spacing_mm": 200}


def arguments(out, plane_mm=500, robot="pa10_6ce", **settings):
    words = ["--campaign", "cell-a", "--robot", robot, "--plane-mm", str(plane_mm)]
    return [*words, "--settings", json.dumps({**SMALL, **settings}), "--out", str(out)]


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    path = tmp_path_factory.mktemp("montecarlo") / "deep/z500.json"
    assert run_command("montecarlo", arguments(path)) == 0
    return path


def test_result_has_the_keys_of_the_contract(out):
    result = json.loads(out.read_text(encoding="utf-8"))
    assert result["schema"] == "pa10cal-montecarlo/1"
    assert (result["campaign"], result["robot"], result["plane_mm"]) == ("cell-a", "pa10_6ce", 500)
    assert (result["cycles"], result["positions"]) == (400, 20)
    assert result["reach_m"] == [0.5, 0.9]
    assert "down" in result["attitude"]
    assert "base z axis" in result["reach_is"]
    assert result["mean_mm"] == pytest.approx(result["closed_form_mean_mm"], rel=0.03)
    assert result["std_mm"] == pytest.approx(result["closed_form_std_mm"], rel=0.05)
    relative = result["mean_mm"] / result["closed_form_mean_mm"] - 1
    assert result["closed_form_relative_difference"] == pytest.approx(relative, abs=1e-5)
    within, between = result["std_mm"], result["std_between_mm"]
    assert result["std_total_mm"] == pytest.approx((within**2 + between**2) ** 0.5, rel=0.02)


def test_result_can_be_plotted(out):
    result = json.loads(out.read_text(encoding="utf-8"))
    trace = result["convergence"]
    assert trace["cycles"][-1] == 400
    assert trace["mean_mm"][-1] == result["mean_mm"]
    assert trace["half_width95_mm"][-1] == result["half_width95_cycles_mm"]
    assert len(trace["cycles"]) == len(trace["mean_mm"]) == len(trace["half_width95_mm"])
    for table, rows in (("per_position", 20), ("map", None)):
        columns = len(result[table]["columns"])
        assert all(len(row) == columns for row in result[table]["rows"])
        assert rows in (None, len(result[table]["rows"]))
    x_mm, _, value = result["map"]["rows"][0]
    assert x_mm % 200 == pytest.approx(0, abs=1e-6)
    assert 0.1 < value < 0.3


def test_progress_and_summary(tmp_path, capsys):
    assert run_command("montecarlo", arguments(tmp_path / "z.json")) == 0
    output = capsys.readouterr()
    lines = output.err.splitlines()
    assert 2 <= len(lines) <= 10
    assert lines[-1].startswith("montecarlo z = 500 mm: 100 %")
    assert "cycles/s" in lines[-1]
    assert output.out.startswith("cell-a z = 500 mm: 0.1")


@pytest.mark.slow
def test_threads_change_no_byte(tmp_path):
    """Blocks are full here, since that is where BLAS might share out the work."""
    files = []
    for threads in ("1", "2"):
        path = tmp_path / f"{threads}.json"
        words = arguments(path, cycles=BLOCK_CYCLES + 10, positions=3)
        variables = {**os.environ, "OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        command = [sys.executable, "-m", "pa10cal", "montecarlo", *words]
        subprocess.run(command, env=variables, check=True, capture_output=True)
        files.append(path.read_bytes())
    assert files[0] == files[1]


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cycles": 1}, "cycles does not fit (got 1)"),
        ({"positions": 0}, "positions does not fit (got 0)"),
        ({"reach_m": [0.9, 0.5]}, "the nearer first"),
        ({"reach_m": [0.5]}, "reach_m"),
        ({"sigma_deg": 0}, "sigma_deg does not fit (got 0)"),
        ({"sigma_degrees": 0.01}, "did you mean 'sigma_deg'?"),
        ({"plane_mm": 1500}, "cannot reach this plane with its flange pointing down (got 1500)"),
        ({"reach_m": [1.3, 1.5]}, "1.3 to 1.5 m"),
        ({"map_spacing_mm": 0.5}, "too fine"),
        ({"robot": "pa11"}, "unknown robot (got 'pa11'); allowed: "),
    ],
)
def test_refusals(tmp_path, capsys, changes, message):
    out = tmp_path / "z.json"
    assert run_command("montecarlo", arguments(out, **changes)) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_plane_that_is_not_for_the_arm_is_recorded_as_not_studied_where_that_is_asked_for(
    tmp_path, capsys
):
    words = [*arguments(tmp_path / "z1500.json", plane_mm=1500), "--skip-out-of-reach"]
    assert run_command("montecarlo", words) == 0
    why = "cannot reach this plane with its flange pointing down"
    assert why in capsys.readouterr().out
    found = json.loads((tmp_path / "z1500.json").read_text(encoding="utf-8"))
    assert found["schema"] == "pa10cal-montecarlo-not-studied/1"
    assert why in found["why"]
    # another campaign of the arm takes that over too, under its own name
    words = [word.replace("cell-a", "cell-b") for word in words]
    words[words.index("--out") + 1] = str(tmp_path / "b/z1500.json")
    assert run_command("montecarlo", [*words, "--same-arm", str(tmp_path)]) == 0
    second = json.loads((tmp_path / "b/z1500.json").read_text(encoding="utf-8"))
    assert second == found | {"campaign": "cell-b"}


def test_planes_of_the_same_arm_are_taken_over_under_the_own_name(out, tmp_path, capsys):
    words = [word.replace("cell-a", "cell-b") for word in arguments(tmp_path / "z500.json")]
    assert run_command("montecarlo", [*words, "--same-arm", str(out.parent)]) == 0
    first, second = (json.loads(path.read_text()) for path in (out, tmp_path / "z500.json"))
    assert second == first | {"campaign": "cell-b"}
    words = arguments(tmp_path / "other.json", robot="ur10")
    assert run_command("montecarlo", [*words, "--same-arm", str(out.parent)]) == 2
    assert "planes of another arm" in capsys.readouterr().err
    words = arguments(tmp_path / "other.json", sigma_deg=0.1)
    assert run_command("montecarlo", [*words, "--same-arm", str(out.parent)]) == 2
    assert "(got 'sigma_deg 0.011'); allowed: sigma_deg 0.1" in capsys.readouterr().err


def test_planes_of_another_height_or_of_an_arm_with_other_rows_are_not_taken_over(
    out, tmp_path, capsys
):
    renamed, own = tmp_path / "z300.json", tmp_path / "pa10_6ce.yaml"
    renamed.write_bytes(out.read_bytes())
    words = arguments(tmp_path / "other.json", plane_mm=300)
    assert run_command("montecarlo", [*words, "--same-arm", str(tmp_path)]) == 2
    assert "(got 'plane_mm 500'); allowed: plane_mm 300" in capsys.readouterr().err
    shipped = files("pa10cal.files").joinpath("arms", "pa10_6ce.yaml").read_text(encoding="utf-8")
    own.write_text(shipped.replace("a_m: 0.450", "a_m: 0.451"), encoding="utf-8")
    words = arguments(tmp_path / "other.json", robot=str(own))
    assert run_command("montecarlo", [*words, "--same-arm", str(out.parent)]) == 2
    assert "got 'closed_form_mean_mm" in capsys.readouterr().err
