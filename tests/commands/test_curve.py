"""The commands `curve` and `figures`, called in process."""

import json

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.curve.angles import chain_points

HELIX = {"shape": "helix", "radius_m": 0.2, "pitch_m": 0.3, "turns": 1.5}
FILES = {"curve.json", "angles.csv", "points.csv", "links.csv", "shape.csv"}


@pytest.fixture
def run(tmp_path):
    """Run the command with settings, and return its folder and record."""

    def run(words=(), **settings):
        out = tmp_path / "out"
        words = ["--settings", json.dumps(settings), "--out-dir", str(out), *words]
        assert run_command("curve", words) == 0
        assert {path.name for path in out.iterdir()} == FILES
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


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"curve": HELIX}, "allowed: link_m, links, or both"),
        ({"curve": {**HELIX, "radius": 1}, "link_m": 0.1}, "unknown key"),
        ({"curve": {"shape": "knot"}, "link_m": 0.1}, "curve does not fit"),
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
