"""The commands of studies, called in process, and their figures."""

import csv
import json

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from pa10cal.arm.chain import Chain
from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.files.arms import load_arm
from pa10cal_curve.angles import chain_points

HELIX = {"shape": "helix", "radius_m": 0.2, "pitch_m": 0.3, "turns": 1.5}
FILES = {"curve.json", "angles.csv", "points.csv", "links.csv", "shape.csv"}


@pytest.fixture
def run(tmp_path):
    """Run the command with settings, and return its folder and record."""

    def run(words=(), **settings):
        out = tmp_path / "out"
        words = ["--settings", json.dumps(settings), "--out-dir", str(out), *words]
        assert run_command("curve", words) == 0
        besides = {"joints.csv", "arms"} if "arm" in settings else set()
        assert {path.name for path in out.iterdir()} == FILES | besides
        return out, json.loads((out / "curve.json").read_text("utf-8"))

    return run


def test_angles_points_and_axes_say_the_same(run):
    out, record = run(curve=HELIX, link_m=0.06, roll="given", roll_deg=20.0)
    angles, points, links = (pd.read_csv(out / f"{n}.csv") for n in ("angles", "points", "links"))
    n = record["links"]
    assert (len(angles), len(points), len(links)) == (n - 1, n + 1, n)
    x, z = links[["x_x", "x_y", "x_z"]].to_numpy(), links[["z_x", "z_y", "z_z"]].to_numpy()
    axes = np.stack([x[0], np.cross(z[0], x[0]), z[0]], axis=1)
    p_m = points[["x_m", "y_m", "z_m"]].to_numpy()
    back = chain_points(angles["a_rad"], angles["b_rad"], record["order"], axes, p_m[0], 0.06)
    np.testing.assert_allclose(back, p_m, atol=1e-12)
    np.testing.assert_allclose(np.hypot(p_m[:, 0], p_m[:, 1]), 0.2, atol=1e-12)
    (shape,) = record["shapes"]
    assert shape["ending"] == "used_up"
    assert shape["roll_deg"] == pytest.approx(20.0)
    assert shape["chord_error"] <= 1e-12
    assert shape["forward_kinematics_error_m"] <= 1e-11 * n * 0.06
    turns = angles[["a_rad", "b_rad"]].to_numpy()
    assert record["largest_angle_deg"] == pytest.approx(np.degrees(np.abs(turns).max()))


@pytest.mark.parametrize("through", ["spline", "closed_spline", "straight"])
def test_points_from_a_file(run, tmp_path, through):
    path = tmp_path / "p.csv"
    path.write_text("x_mm,y_mm,z_mm\n0,0,0\n500,100,0\n900,600,200\n1000,1200,100\n", "utf-8")
    out, record = run(["--points", str(path)], through=through, link_m=0.05)
    shape = pd.read_csv(out / "shape.csv")[["x_m", "y_m", "z_m"]].to_numpy()
    end = [0, 0, 0] if through == "closed_spline" else [1.0, 1.2, 0.1]
    np.testing.assert_allclose(shape[-1], end, atol=1e-12)
    straight_m = np.linalg.norm([0.5, 0.1, 0]) + np.linalg.norm([0.4, 0.5, 0.2])
    assert record["links"] * 0.05 > straight_m


def test_the_choices_of_roll(run):
    limits = {"a_deg": [-60, 60], "b_deg": [-50, 60]}
    asked = {"curve": HELIX, "link_m": 0.1, "limits": limits}
    _, small = run(**asked)
    _, roomy = run(**asked, roll="most_room")
    _, given = run(**asked, roll="given", roll_deg=30.0)
    out, last = run(**asked, roll="of_last", z_of_last=[0, 1, 0])
    others = [record["largest_angle_deg"] for record in (roomy, given, last)]
    assert small["largest_angle_deg"] <= min(others) + 1e-9
    links = pd.read_csv(out / "links.csv")
    x, z = links[["x_x", "x_y", "x_z"]].to_numpy()[-1], links[["z_x", "z_y", "z_z"]].to_numpy()[-1]
    off = np.array([0, 1, 0]) - x[1] * x
    np.testing.assert_allclose(z, off / np.linalg.norm(off), atol=1e-9)
    for begin, end in small["feasible_rolls_deg"]:
        assert 0 <= begin < end


def test_equal_links_and_the_other_order(run):
    _, record = run(curve=HELIX, links=20, order="yz")
    assert record["links"] == 20
    assert record["order"] == "yz"
    assert record["shapes"][0]["ending"] == "exact"
    assert record["shapes"][0]["gap_m"] < 1e-12


GAITS = {
    "rolling helix": {"curve": HELIX, "gait": {"moves": "roll", "period_s": 1.0}},
    "travelling serpenoid": {
        "curve": {"shape": "serpenoid", "length_m": 1.6, "waves": 1.5, "amplitude_deg": 50},
        "gait": {"moves": "wave", "period_s": 1.0, "move_deg": 5.0},
    },
    "flat serpenoid": {
        "curve": {"shape": "serpenoid", "length_m": 1.6, "waves": 1.5, "amplitude_deg": 50},
        "gait": {"moves": "wave", "period_s": -1.0},
        "roll": "given",
    },
}


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("name", GAITS)
def test_gaits(run, name):
    asked = GAITS[name]
    gait = {**asked["gait"], "seconds": 1.0, "shapes": 13}
    out, record = run(**{**asked, "gait": gait}, link_m=0.12, links=10)
    angles = pd.read_csv(out / "angles.csv").pivot_table(index="time_s", columns="joint")
    moves = angles[["a_rad", "b_rad"]].diff().abs().max(axis=None)
    assert record["largest_move_deg"] == pytest.approx(np.degrees(moves))
    assert len(record["shapes"]) == len(angles) == 13
    assert all(shape["ending"] == "complete" for shape in record["shapes"])
    if name == "flat serpenoid":
        np.testing.assert_allclose(angles["b_rad"], 0.0, atol=1e-9)
    if name != "travelling serpenoid":
        first, last = angles[["a_rad", "b_rad"]].iloc[[0, -1]].to_numpy()
        np.testing.assert_allclose(last, first, atol=1e-9)


@pytest.mark.parametrize("order", ["zy", "yz"])
def test_the_chain_as_an_arm_reaches_where_its_last_link_ends(run, order):
    gait = {"moves": "wave", "period_s": 1.0, "seconds": 1.0, "shapes": 4}
    out, _ = run(curve=HELIX, link_m=0.1, links=6, order=order, gait=gait, arm="snake")
    arm = load_arm("snake", out, out / "arms")
    q_deg = pd.read_csv(out / "joints.csv", index_col="id").to_numpy()
    T_link_end = Chain.of(arm).forward(np.radians(q_deg))
    places, axes = (pd.read_csv(out / f"{name}.csv") for name in ("points", "links"))
    p_m = places[["x_m", "y_m", "z_m"]].to_numpy().reshape(4, 7, 3)
    x, z = (axes[[f"{axis}_{k}" for k in "xyz"]].to_numpy().reshape(4, 6, 3) for axis in "xz")
    first = np.stack([x[:, 0], np.cross(z[:, 0], x[:, 0]), z[:, 0]], axis=2)
    ends = p_m[:, 0] + (first @ T_link_end[:, :3, 3, None])[..., 0]
    np.testing.assert_allclose(ends, p_m[:, -1], atol=1e-12)
    np.testing.assert_allclose((first @ T_link_end[:, :3, :3])[..., 2], z[:, -1], atol=1e-12)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"curve": HELIX, "link_m": 0.01, "arm": "snake"}, "the arm has too many rows"),
        (
            {
                "curve": {"shape": "line", "length_m": 1.0},
                "link_m": 0.1,
                "arm": "stiff",
                "limits": {"a_deg": [0.0, 0.0]},
            },
            "arm stiff: row 1: limits_deg allows the joint no motion",
        ),
        ({"curve": HELIX, "link_m": 0.1, "links": 1, "arm": "snake"}, "two links or more"),
        ({"curve": HELIX, "link_m": 0.1, "arm": "a/b"}, "key arm does not fit"),
        ({"curve": HELIX}, "allowed: link_m, links, or both"),
        ({"curve": {**HELIX, "radius": 1}, "link_m": 0.1}, "unknown key"),
        (
            {"curve": {"shape": "knot"}, "link_m": 0.1},
            "key curve.shape does not fit (got 'knot'); allowed: 'line', 'circle'",
        ),
        ({"link_m": 0.1}, "--points, curve: the curve is given twice or not at all"),
        ({"curve": HELIX, "link_m": 9.0}, "link_m: the link is longer than the curve (got 9.0)"),
        ({"curve": HELIX, "link_m": 0.1, "roll": "most_room"}, "limits, where the roll"),
        (
            {"curve": HELIX, "link_m": 0.1, "limits": {"a_deg": [-5, 5], "b_deg": [-5, 5]}},
            "no roll keeps the joints within their limits",
        ),
        (
            {
                "curve": {"shape": "circle", "radius_m": 1.0},
                "link_m": 0.1,
                "links": 5,
                "gait": {"moves": "wave", "period_s": 1.0, "seconds": 1.0},
            },
            "a shape with a phase",
        ),
        (
            {
                "curve": HELIX,
                "link_m": 0.1,
                "links": 500,
                "gait": {"moves": "roll", "period_s": 1.0, "seconds": 1.0},
            },
            "time 0 s, links: the links do not fit on the curve (got 500)",
        ),
    ],
)
def test_a_refusal_is_one_message_and_writes_nothing(tmp_path, capsys, settings, message):
    out = tmp_path / "out"
    words = ["--settings", json.dumps(settings), "--out-dir", str(out)]
    assert run_command("curve", words) == REFUSED
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert message in said
    assert not out.exists() or not list(out.iterdir())


def test_a_shape_is_drawn(run, tmp_path):
    out, _ = run(curve=HELIX, link_m=0.1, limits={"a_deg": [-60, 60]})
    drawn = tmp_path / "drawn"
    assert run_command("figures", ["--results", str(out), "--out-dir", str(drawn)]) == 0
    assert {path.name for path in (drawn / "figures").iterdir()} == {
        f"curve_shape.{e}" for e in ("svg", "pdf", "png")
    }


def test_a_gait_is_drawn_and_filmed(run, capsys, monkeypatch):
    gait = {"moves": "roll", "period_s": 1.0, "seconds": 1.0, "shapes": 4}
    out, _ = run(curve=HELIX, link_m=0.12, links=8, gait=gait)
    words = ["--results", str(out), "--settings", '{"figures": {"png_dpi": 60}}']
    assert run_command("figures", words) == 0
    assert (out / "figures/curve_gait.svg").exists()
    with Image.open(out / "figures/curve_film.gif") as frames:
        assert frames.n_frames == 4
    assert not (out / "figures/curve_shape.svg").exists()
    monkeypatch.setattr("matplotlib.animation.FFMpegWriter.isAvailable", lambda: False)
    words = ["--results", str(out), "--settings", '{"figures": {"film": "mp4"}}']
    assert run_command("figures", [*words, "--figure", "curve_film"]) == REFUSED
    assert "no writer for this kind of film (got '.mp4')" in capsys.readouterr().err


def test_what_does_not_move_is_not_filmed(run, capsys):
    out, _ = run(curve=HELIX, link_m=0.4)
    for name in ("curve_film", "curve_gait"):
        assert run_command("figures", ["--results", str(out), "--figure", name]) == REFUSED
        assert f"{name}: nothing to show: one shape does not move" in capsys.readouterr().err
    assert not list((out / "figures").iterdir())


def test_a_folder_that_is_no_result_is_refused(run, tmp_path, capsys):
    out, _ = run(curve=HELIX, link_m=0.4)
    (out / "links.csv").unlink()
    words = ["--results", str(out), "--out-dir", str(tmp_path / "d")]
    assert run_command("figures", words) == REFUSED
    assert "links.csv: a table of the curve cannot be used" in capsys.readouterr().err
    (out / "curve.json").write_text('{"schema": "pa10cal-verdict/1"}', "utf-8")
    assert run_command("figures", words) == REFUSED
    assert "(got 'pa10cal-verdict/1')" in capsys.readouterr().err


# The commands `curve_calibration` and `figures`, called in process.


FEW = {"individuals": 1, "postures": 80, "random_seed": 3}
STARTS = {"starts": 2}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    out = tmp_path_factory.mktemp("chain") / "calibration.json"
    argv = ["--settings", json.dumps(FEW), "--calibration", json.dumps(STARTS)]
    assert run_command("curve_calibration", [*argv, "--out", str(out)]) == 0
    return out


@pytest.fixture
def found(path):
    record = json.loads(path.read_text("utf-8"))
    assert record["provenance"].startswith("synthetic")
    return {(each["departs"], each["model"]): each for each in record["summaries"]}, record


@pytest.mark.slow
def test_errors_come_down_to_the_noise(found):
    summaries, record = found
    assert record["noise_floor_mm"] == pytest.approx(np.sqrt(8 / np.pi) * 0.05)
    for departs in ("rows", "any_way"):
        general = summaries[departs, "general"]
        assert general["converged"] == 1
        assert general["fitted"]["largest"] < 1.1
        assert general["held_out"]["largest"] < 1.5
    for model in ("two_level", "two_level_all"):
        assert summaries["rows", model]["fitted"]["largest"] < 1.5
    for individual in record["individuals"]:
        assert individual["errors"]["nominal"]["fitted"]["mean_mm"] > 0.4
        assert sum(individual["poses"]["held_out"]) == 20
    assert 0.7 < summaries["rows", "two_level"]["rms_score"] < 1.4


@pytest.mark.slow
def test_rank_and_what_no_pose_tells(found):
    summaries, record = found
    general, paper = summaries["rows", "general"], summaries["rows", "two_level"]
    assert (general["rank"], general["unknowns"]) == (54, 54)
    assert general["null_directions"] == []
    assert (paper["rank"], paper["unknowns"]) == (52, 54)
    open_pairs = {frozenset(direction) for direction in paper["null_directions"]}
    assert open_pairs == {
        frozenset({"delta_d_1", "base_z"}),
        frozenset({"delta_theta_1", "base_rz"}),
    }
    redundant = record["individuals"][0]["models"]["general"]["redundant"]
    assert {"delta_d_1", "delta_theta_1", "delta_a_12", "delta_alpha_12"} <= set(redundant)


@pytest.mark.slow
def test_a_flange_that_departs_in_any_way_is_beyond_the_two_level_model(found):
    summaries, _ = found
    lacking = summaries["any_way", "two_level_all"]["held_out_true"]["mean"]
    assert lacking > 1.2 * summaries["any_way", "general"]["held_out_true"]["mean"]


@pytest.mark.slow
def test_figure_and_table_are_drawn(path, tmp_path):
    assert run_command("figures", ["--results", str(path.parent), "--out-dir", str(tmp_path)]) == 0
    drawn = {file.suffix for file in (tmp_path / "figures").iterdir()}
    assert drawn == {".svg", ".pdf", ".png"}
    folder = tmp_path / "tables"
    with (folder / "curve_calibration_summary.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["rank"] for row in rows] == ["52", "52", "54"] * 2
    said = (folder / "curve_calibration_summary.md").read_text("utf-8")
    assert "| two-level (paper) | δd₁ − base z |" in said
    assert "Synthetic data" in said


@pytest.mark.slow
def test_what_cannot_be_is_refused(tmp_path, path, capsys):
    out = tmp_path / "c.json"
    argv = ["--settings", '{"postures": 8}', "--out", str(out)]
    assert run_command("curve_calibration", argv) == REFUSED
    assert "fewer equations than unknowns" in capsys.readouterr().err
    argv = ["--settings", '{"holdout_share": 0.001}', "--out", str(out)]
    assert run_command("curve_calibration", argv) == REFUSED
    assert "a holdout_share that holds out one posture or more" in capsys.readouterr().err
    argv = ["--figure", "curve", "--results", str(path.parent), "--out-dir", str(tmp_path)]
    assert run_command("figures", argv) == REFUSED
    assert "no such figure or table" in capsys.readouterr().err
    (tmp_path / "calibration.json").write_text("{}")
    assert run_command("figures", ["--results", str(tmp_path)]) == REFUSED
    assert "give a file that pa10cal curve_calibration wrote" in capsys.readouterr().err


# Intervals that hold the truth: a few campaigns.


CASES = [
    {"robot": "gx4_351s", "instrument": "points"},
    {"robot": "ur10", "instrument": "pose", "flexible_joints": [2, 3, 4, 5]},
]


@pytest.mark.slow
def test_a_few_campaigns_are_covered(tmp_path):
    """Hundreds of every case are a target of the workflow; a few would show a gross fault."""
    settings = json.dumps({"campaigns": 5, "general_campaigns": 10, "cases": CASES})
    calibration = json.dumps({"starts": 1})
    out, table = tmp_path / "coverage.json", tmp_path / "coverage.csv"
    argv = ["--settings", settings, "--calibration", calibration]
    assert run_command("coverage", [*argv, "--out", str(out), "--table", str(table)]) == 0
    found = json.loads(out.read_text())
    paper = found["paper"]
    assert paper["campaigns"] == 5
    assert paper["converged"] == 1.0
    assert len(paper["parameters"]) == 28
    assert 0.85 < paper["inside"] < 1.0
    assert 0.75 < paper["rms"] < 1.3
    assert [case["case"] for case in found["cases"]] == [
        "gx4_351s, 1 target",
        "ur10, pose, springs",
    ]
    for case in found["cases"]:
        assert case["converged"] == case["departing_in_any_way"]["converged"] == 1.0
        for share in (
            case["parameters"],
            case["predictions"],
            case["departing_in_any_way"]["predictions"],
        ):
            assert 0.88 < share["inside"] < 0.995
            assert 0.75 < share["rms"] < 1.3
    scara, ur10 = found["cases"]
    assert scara["unknowns"] == len(scara["parameters"]["by_parameter"]) == 17
    assert scara["redundant"]["target_T1_z"] == {"base_z": pytest.approx(1.0)}
    assert set(ur10["parameters"]["by_class"]) == {"lengths", "angles", "base", "tool", "springs"}
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 1 + 2 * 3 + 4 + 5
    assert rows[0]["inside_percent"] == f"{100 * paper['inside']:.1f}"
    assert rows[1]["inside_percent"] == f"{100 * scara['parameters']['inside']:.1f}"


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ({"robot": "scara", "instrument": "pose"}, "unknown robot"),
        ({"robot": "ur10", "instrument": "pose", "flexible_joints": [9]}, "does not exist"),
        ({"robot": "gx4_351s", "instrument": "pose", "flexible_joints": [2]}, "mass"),
        ({"robot": "ur10", "instrument": "pose", "flexible_joints": [1]}, "unloaded"),
    ],
)
def test_a_case_that_cannot_be_is_refused_before_any_work(tmp_path, capsys, case, message):
    settings = json.dumps({"campaigns": 1, "general_campaigns": 1, "cases": [CASES[0], case]})
    calibration = json.dumps({"starts": 1})
    argv = ["--settings", settings, "--calibration", calibration]
    argv += ["--out", str(tmp_path / "c.json"), "--table", str(tmp_path / "c.csv")]
    assert run_command("coverage", argv) == 2
    said = capsys.readouterr()
    assert message in said.err
    assert "inside" not in said.out + said.err
    assert not list(tmp_path.iterdir())


def test_a_class_without_an_interval_in_some_campaign_is_covered_by_the_others(tmp_path):
    few = {"general_campaigns": 3, "campaigns": 1, "poses": 12}
    noisy = {"position_mm": 2.0, "attitude_rad": 0.01}
    case = {"robot": "ur10", "instrument": "pose", "flexible_joints": [5]}
    settings = json.dumps({**few, **noisy, "cases": [case]})
    out = tmp_path / "c.json"
    argv = ["--settings", settings, "--calibration", json.dumps({"starts": 1})]
    argv += ["--out", str(out), "--table", str(tmp_path / "c.csv")]
    assert run_command("coverage", argv) == 0
    found = json.loads(out.read_text())
    assert found["settings"]["calibration"]["starts"] == 1
    (case,) = found["cases"]
    springs = case["parameters"]["by_class"]["springs"]

    assert 0 < springs["counted"] < case["campaigns"] == 3
