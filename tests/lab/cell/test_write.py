"""The campaign's folder, and the truth elsewhere."""

import gzip
import json
from dataclasses import replace
from io import BytesIO

import numpy as np
import pandas as pd
import pytest
import yaml

from made_up_robot import logged_q, seen_m, seen_p, seen_T, track
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import OutputError, SimulationError
from pa10cal.files.arms import arm_names, load_arm
from pa10cal_curve.angles import chain_arm
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.options import HiddenEffectOptions, SimulateOptions, TrackerOptions
from pa10cal_lab.cell.write import write_campaign, write_table


@pytest.fixture(scope="module")
def campaign(arm, short):
    effect = HiddenEffectOptions(
        id="transmission_error", of="joint 2", parameters={"A": 3e-4, "phi": 1.25}
    )
    return simulate_campaign("secret", arm, short.model_copy(update={"hidden_effects": (effect,)}))


@pytest.fixture
def written(campaign, tmp_path):
    write_campaign(campaign, tmp_path / "raw/secret", tmp_path / "truth/secret.json")
    return tmp_path


def test_folder_holds_the_contracts_files_and_no_more(written):
    names = sorted(path.name for path in (written / "raw/secret").iterdir())
    assert names == ["campaign.yaml", "cmm.csv.gz", "resolver.csv.gz"]
    assert sorted(path.name for path in (written / "truth").iterdir()) == ["secret.json"]


def test_description_says_what_the_contract_asks(written, campaign):
    text = (written / "raw/secret/campaign.yaml").read_text()
    content = yaml.safe_load(text)
    assert content["schema"] == "pa10cal-campaign/1"
    assert content["robot"] == "pa10_6ce"
    assert content["instrument"] == {"kind": "touch_trigger_cmm", "uncertainty_mm": 0.0121}
    assert content["ball_diameter_mm"] == 25.4
    assert content["gravity_m_s2"] == [0.0, 0.0, -9.80665]
    assert content["files"] == {"cmm": "cmm.csv.gz", "resolver": "resolver.csv.gz"}
    assert set(content["tool"]) == {"mass_kg", "com_mm", "load_point_mm", "balls_mm"}
    measured = 1e3 * campaign.truth.robot.targets.p_ee_stated_m
    assert np.array(list(content["tool"]["balls_mm"].values())) == pytest.approx(measured, abs=1e-4)
    assert not np.allclose(measured, 1e3 * campaign.truth.robot.targets.p_ee_m, atol=1e-4)


def test_a_wrong_statement_of_the_instrument_changes_that_statement_alone(campaign, tmp_path, arm):
    lying = campaign.settings.model_copy(update={"stated_uncertainty_mm": 0.03})
    for name, settings in (("true", campaign.settings), ("lying", lying)):
        made = simulate_campaign("secret", arm, settings)
        write_campaign(made, tmp_path / name, tmp_path / f"{name}.json")
    for file in ("cmm.csv.gz", "resolver.csv.gz"):
        assert (tmp_path / "lying" / file).read_bytes() == (tmp_path / "true" / file).read_bytes()
    texts = [(tmp_path / name / "campaign.yaml").read_text() for name in ("true", "lying")]
    assert yaml.safe_load(texts[1])["instrument"]["uncertainty_mm"] == 0.03
    assert texts[1] == texts[0].replace("0.0121", "0.03")


def test_provenance_says_synthetic_and_gives_nothing_away(written):
    text = (written / "raw/secret/campaign.yaml").read_text()
    provenance = yaml.safe_load(text)["provenance"]
    assert "synthetic" in provenance
    assert "virtual cell" in provenance
    assert "not told here" in provenance
    for secret in ("transmission", "joint 2", "2008", "seed"):
        assert secret not in text


def test_tables_read_back_as_they_were(written, campaign):
    for name in ("cmm", "resolver"):
        table = campaign.tables[name]
        read = pd.read_csv(written / f"raw/secret/{name}.csv.gz")
        pd.testing.assert_frame_equal(read, table, check_dtype=False, rtol=0, atol=1e-9)
    first = gzip.decompress((written / "raw/secret/resolver.csv.gz").read_bytes()).decode()
    assert "-0.00000" not in first
    assert first.endswith("\n")


def test_the_same_seed_gives_the_same_bytes(campaign, arm, written, tmp_path):
    again = simulate_campaign("secret", arm, campaign.settings)
    write_campaign(again, tmp_path / "again", tmp_path / "again.json")
    for path in (written / "raw/secret").iterdir():
        assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes()
    assert (tmp_path / "again.json").read_bytes() == (written / "truth/secret.json").read_bytes()
    with gzip.GzipFile(fileobj=BytesIO((tmp_path / "again/cmm.csv.gz").read_bytes())) as file:
        file.read(1)
        assert file.mtime == 0


def test_truth_tells_everything_with_units(written, campaign):
    truth = json.loads((written / "truth/secret.json").read_text())
    assert truth["schema"] == "pa10cal-truth/1"
    assert truth["campaign"] == "secret"
    assert truth["random_seed"] == 2008
    assert truth["kcub_reading"] == "text_e7"
    parameters = truth["parameters"]
    assert len(parameters) == 24 + 6
    assert parameters["delta_a_6"] == {"value": -0.00344, "unit": "m"}
    assert parameters["delta_beta_2"] == {"value": -1e-3, "unit": "rad"}
    assert parameters["K_lin_5"] == {"value": 2560.0, "unit": "N m/rad"}
    assert parameters["K_cub_5"] == {"value": 3.83e7, "unit": "N m/rad^3"}
    assert "delta_d_2" not in parameters
    assert truth["hidden_effects"] == [
        {"id": "transmission_error", "of": "joint 2", "parameters": {"A": 3e-4, "phi": 1.25}}
    ]
    assert np.array(truth["T_instr_base_m"]) == pytest.approx(campaign.truth.robot.T_instr_base)
    assert truth["settings"]["noise"]["touch_mm"] == 0.004
    assert {kind: len(q) for kind, q in truth["poses_rad_or_m"].items()} == {
        "line_x": 11,
        "line_y": 11,
        "grid": 27,
        "holdout": 10,
    }
    assert SimulateOptions.model_validate(truth["settings"]) == campaign.settings


@pytest.mark.parametrize(
    "where", ["raw/c/truth.json", "raw/c/deep/truth.json", "raw/x/../c/t.json"]
)
def test_refuses_to_put_the_truth_beside_the_data(campaign, tmp_path, where):
    with pytest.raises(SimulationError, match="must not lie"):
        write_campaign(campaign, tmp_path / "raw/c", tmp_path / where)
    assert list(tmp_path.rglob("*.json")) == []
    assert list(tmp_path.rglob("*.gz")) == []


def test_refuses_the_truth_through_a_link_into_the_folder(campaign, tmp_path):
    (tmp_path / "raw").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "raw")
    with pytest.raises(SimulationError, match="must not lie"):
        write_campaign(campaign, tmp_path / "raw", tmp_path / "link/truth.json")


def test_a_truth_that_is_a_folder_leaves_a_former_campaign_whole(campaign, written):
    folder = written / "raw/secret"
    with pytest.raises(OutputError):
        write_campaign(campaign, folder, written)
    assert (folder / "campaign.yaml").exists()


def test_numbers_are_written_in_full_and_unknown_ones_empty(tmp_path):
    columns = {
        "load_N": [1234.5678, 1234567.8, 44.0, np.nan],
        "x_mm": [-0.00001, 1.0, np.nan, -0.25],
        "pose": ["P1", "P2", np.nan, "nan"],
    }
    write_table(pd.DataFrame(columns), tmp_path / "t.csv", {"_mm": 3})
    assert (tmp_path / "t.csv").read_text().splitlines() == [
        "load_N,x_mm,pose",
        "1234.5678,0.000,P1",
        "1234567.8,1.000,P2",
        "44,,",
        ",-0.250,nan",
    ]


def test_refuses_a_folder_that_holds_something_else(campaign, tmp_path):
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw/thesis.tex").write_text("dear")
    with pytest.raises(SimulationError, match=r"thesis\.tex"):
        write_campaign(campaign, tmp_path / "raw", tmp_path / "t.json")
    assert [path.name for path in tmp_path.rglob("*")] == ["raw", "thesis.tex"]


@pytest.mark.parametrize("where", ["file/sub", "file", "raw"])
def test_refuses_what_is_no_folder_before_the_truth_is_written(campaign, tmp_path, where):
    (tmp_path / "file").write_text("x")
    (tmp_path / "raw/campaign.yaml").mkdir(parents=True)
    with pytest.raises(SimulationError):
        write_campaign(campaign, tmp_path / where, tmp_path / "truth.json")
    assert not (tmp_path / "truth.json").exists()


def test_what_a_killed_run_left_does_not_count(campaign, written):
    folder = written / "raw/secret"
    (folder / ".99999.partial.cmm.csv.gz").write_text("x")
    write_campaign(campaign, folder, written / "truth/secret.json")
    assert not list(folder.glob(".*"))


def test_the_description_of_a_former_arm_is_not_of_this_campaign(arm, tmp_path):
    write_campaign(track(replace(arm, name="mine"), TrackerOptions(poses=4)), tmp_path / "raw")
    with pytest.raises(SimulationError, match=r"not of this campaign.*mine\.yaml"):
        write_campaign(track(arm, TrackerOptions(poses=4)), tmp_path / "raw")


def test_refuses_an_arm_whose_description_would_lie_elsewhere(arm, tmp_path):
    made = track(replace(arm, name="../evil"), TrackerOptions(poses=4))
    with pytest.raises(SimulationError, match="none of a file"):
        write_campaign(made, tmp_path / "raw")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("values", "decimals", "text"),
    [([None, 1.0], {"_mm": 3}, ["P,", "P,1.000"]), ([None, "x"], {}, ["P,", "P,x"])],
)
def test_a_cell_without_a_value_is_empty(tmp_path, values, decimals, text):
    table = pd.DataFrame({"pose": ["P", "P"], "a_mm": np.array(values, dtype=object)})
    write_table(table, tmp_path / "t.csv", decimals)
    assert (tmp_path / "t.csv").read_text().splitlines()[1:] == text


@pytest.mark.parametrize("name", ["campaign", "Campaign"])
def test_refuses_an_arm_whose_description_would_be_the_campaigns(tmp_path, name):
    plan = SimulateOptions.model_validate({"robot": name, "without_touches": {"poses": 4}})
    made = simulate_campaign("mine", chain_arm(name, 3, 0.2, 1.0), plan)
    with pytest.raises(SimulationError, match="name of the arm"):
        write_campaign(made, tmp_path / "raw")
    assert list(tmp_path.iterdir()) == []


def test_replaces_a_former_campaign(written, campaign):
    folder = written / "raw/secret"
    before = (folder / "cmm.csv.gz").read_bytes()
    (folder / "cmm.csv.gz").write_bytes(b"former")
    write_campaign(campaign, folder, written / "truth/secret.json")
    assert (folder / "cmm.csv.gz").read_bytes() == before


# Trackers: one table, of any arm.

INSTRUMENTS = ("pose", "points", "distance")


def tracked(arm, instrument="pose", seed=3, poses=12, **plan):
    return track(arm, TrackerOptions(instrument=instrument, poses=poses, **plan), seed)


@pytest.fixture(params=INSTRUMENTS)
def any_tracked(any_arm, request):
    plan = {"repeat_every": 3, "resolver_rad": 1e-5, "loads_N": (0.0, 22.0)}
    return tracked(any_arm, request.param, **plan)


def test_folder_of_a_tracker_holds_the_contracts_files_and_no_truth(any_tracked, tmp_path):
    write_campaign(any_tracked, tmp_path / "raw/s", tmp_path / "s.truth.json")
    described = {f"{any_tracked.truth.robot.arm.name}.yaml"} - {
        f"{name}.yaml" for name in arm_names()
    }
    found = {path.name for path in (tmp_path / "raw/s").iterdir()}
    assert found == {"campaign.yaml", "poses.csv"} | described
    write_campaign(any_tracked, tmp_path / "raw/t")
    assert sorted(path.name for path in tmp_path.rglob("*.json")) == ["s.truth.json"]


def test_table_of_a_tracker_reads_back_as_it_was(any_tracked, tmp_path):
    write_campaign(any_tracked, tmp_path)
    read = pd.read_csv(tmp_path / "poses.csv")
    table = any_tracked.tables["poses"]
    pd.testing.assert_frame_equal(read, table, check_dtype=False, rtol=0, atol=1e-6)
    text = (tmp_path / "poses.csv").read_text()
    assert "nan" not in text
    assert "-0.00000," not in text
    slides = any_tracked.truth.robot.arm.prismatic
    names = [f"q{k}_mm" if slide else f"q{k}_deg" for k, slide in enumerate(slides, start=1)]
    assert [name for name in read if name[0] == "q" and name[1].isdigit()] == names


def test_what_was_read_stands_beside_its_uncertainty(arm):
    poses, points, distances = (tracked(arm, kind).tables["poses"] for kind in INSTRUMENTS)
    assert (poses["u_x_mm"] == 0.05).all()
    assert (poses["u_qw"] == 1e-4).all()
    assert np.linalg.norm(poses[["qw", "qx", "qy", "qz"]], axis=1) == pytest.approx(1.0)
    assert {f"{u}T{b}_{axis}_mm" for u in ("", "u_") for b in (1, 2, 3) for axis in "xyz"} <= set(
        points.columns
    )
    assert (distances["u_d_mm"] == 0.05).all()
    assert not {"x_mm", "qw"} & set(distances.columns)


def test_cells_of_targets_not_seen_are_empty(arm, tmp_path):
    campaign = tracked(arm, "points", unseen_share=0.5)
    write_campaign(campaign, tmp_path)
    lines = (tmp_path / "poses.csv").read_text().splitlines()
    at = lines[0].split(",").index("T2_y_mm")
    empty = [line.split(",")[at] == "" for line in lines[1:]]
    assert empty == np.isnan(seen_p(campaign)[:, 1, 1]).tolist()
    assert any(empty)


def test_description_of_a_tracker_says_what_the_contract_asks(any_tracked, tmp_path):
    write_campaign(any_tracked, tmp_path)
    content = yaml.safe_load((tmp_path / "campaign.yaml").read_text())
    robot, kind = any_tracked.truth.robot, any_tracked.instrument.kind
    assert content["schema"] == "pa10cal-campaign/1"
    assert content["robot"] == robot.arm.name
    assert content["instrument"] == {"kind": kind, "uncertainty_mm": 0.05}
    assert content["files"] == {"poses": "poses.csv"}
    assert content["gravity_m_s2"] == [0.0, 0.0, -9.80665]
    assert content["tool"]["mass_kg"] == 1.0
    assert "synthetic" in content["provenance"]
    stated = content["tool"].get("balls_mm", {})
    names = {"pose": set(), "points": {"T1", "T2", "T3"}, "distance": {"T1"}}
    assert set(stated) == names[kind]
    for name, point in stated.items():
        b = robot.targets.names.index(name)
        assert point == pytest.approx(1e3 * robot.targets.p_ee_stated_m[b], abs=1e-4)
        assert np.abs(np.array(point) - 1e3 * robot.targets.p_ee_m[b]).max() > 1e-3


def test_places_of_targets_need_not_be_stated(arm, tmp_path):
    write_campaign(tracked(arm, "points", states_targets=False), tmp_path)
    assert "balls_mm" not in yaml.safe_load((tmp_path / "campaign.yaml").read_text())["tool"]


def test_truth_is_enough_to_know_what_was_seen(any_arm, tmp_path):
    campaign = tracked(any_arm, "points", unseen_share=0.0, position_mm=1e-5)
    write_campaign(campaign, tmp_path / "raw", tmp_path / "s.json")
    truth = json.loads((tmp_path / "s.json").read_text())
    assert truth["schema"] == "pa10cal-truth/1"
    assert SimulateOptions.model_validate(truth["settings"]) == campaign.settings
    for q, seen in zip(truth["q_motor_rad_or_m"], seen_p(campaign), strict=True):
        T = np.array(truth["T_instr_base_m"])
        for k, placement in enumerate(truth["joint_placements_m"]):
            moved, (cos, sin) = np.eye(4), (np.cos(q[k]), np.sin(q[k]))
            if any_arm.prismatic[k]:
                moved[2, 3] = q[k]
            else:
                moved[:2, :2] = [[cos, -sin], [sin, cos]]
            T = T @ placement @ moved
        T = T @ truth["T_last_joint_ee_m"]
        points = [(T @ [*point, 1.0])[:3] for point in truth["tool"]["targets_m"].values()]
        assert seen == pytest.approx(np.array(points), abs=1e-6)


def test_truth_of_a_tracker_names_springs_and_no_departures_of_rows(arm, tmp_path):
    campaign = tracked(arm, flexible_joints=(2, 5))
    write_campaign(campaign, tmp_path / "raw", tmp_path / "s.json")
    parameters = json.loads((tmp_path / "s.json").read_text())["parameters"]
    k_lin = campaign.truth.robot.springs.k_lin
    assert parameters["K_lin_5"] == {"value": k_lin[4], "unit": "N m/rad"}
    assert set(parameters) == {f"K_{kind}_{joint}" for kind in ("lin", "cub") for joint in (2, 5)}


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("name", ["ur10", "gx4_351s", "iiwa14"])
@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_the_reader_of_campaigns_takes_it_as_it_was_seen(tmp_path, name, instrument):
    arm = load_arm(name)
    campaign = tracked(arm, instrument, poses=20, repeat_every=4, loads_N=(0.0, 22.0))
    write_campaign(campaign, tmp_path)
    ingested = read_campaign(tmp_path)
    assert ingested.quarantined == ()
    poses, made = ingested.observations, campaign.truth.schedule
    assert poses.kind.tolist() == made.kind.tolist()
    assert poses.pose.tolist() == made.pose.tolist()
    assert poses.states.load_N.tolist() == made.load_N.tolist()
    assert np.abs(poses.states.q_rad - logged_q(campaign)).max() < 1e-12
    if instrument == "pose":
        T = seen_T(campaign)
        off = np.abs(poses.measured.T_instr_target - T)
        assert off[:, :3, 3].max() < 1e-9
        assert off[:, :3, :3].max() < 1e-6
        variances = np.diagonal(poses.measured.cov, axis1=1, axis2=2)
        expected = np.tile([5e-5**2] * 3 + [2e-4**2] * 3, (len(T), 1))
        assert variances == pytest.approx(expected)
    elif instrument == "points":
        seen_mm = 1e3 * seen_p(campaign)
        assert poses.measured.names == ("T1", "T2", "T3")
        assert np.array_equal(np.isnan(1e3 * poses.measured.p_instr_m), np.isnan(seen_mm))
        assert np.nanmax(np.abs(1e3 * poses.measured.p_instr_m - seen_mm)) < 1e-6
    else:
        assert np.abs(1e3 * poses.measured.d_m - 1e3 * seen_m(campaign, "d_mm")[:, 0]).max() < 1e-6
        assert 1e3 * poses.measured.u_m == pytest.approx(0.05)


def test_an_arm_that_is_not_shipped_is_described_beside_its_campaign(tmp_path):
    arm = chain_arm("chain_3", 3, 0.2, 1.0)
    made = track(arm, TrackerOptions(commanded=((30.0,) * 6, (57.0,) * 6), holdout_share=0.5))
    for _ in range(2):  # once more into the same folder
        write_campaign(made, tmp_path / "raw")
    names = sorted(path.name for path in (tmp_path / "raw").iterdir())
    assert names == ["campaign.yaml", "chain_3.yaml", "poses.csv"]
    read = read_campaign(tmp_path / "raw")
    assert read.arm.a_m == pytest.approx(arm.a_m, abs=0.0)
    assert np.degrees(read.observations.states.q_rad) == pytest.approx(
        np.array([[30.0] * 6, [57.0] * 6])
    )


def test_an_arm_of_a_file_is_described_though_it_is_named_as_a_shipped_one(tmp_path):
    shipped = load_arm("ur10")
    own = replace(shipped, d_m=shipped.d_m + 0.01)
    plan = SimulateOptions(without_touches=TrackerOptions(poses=8), robot="ur10")
    for name, arm in (("own", own), ("shipped", shipped)):
        write_campaign(simulate_campaign(name, arm, plan), tmp_path / name)
        assert (tmp_path / name / "ur10.yaml").exists() == (name == "own")
    found = read_campaign(tmp_path / "own").arm
    np.testing.assert_allclose(found.d_m, own.d_m, atol=1e-9)


@pytest.mark.parametrize("instrument", ["pose", "points", "distance"])
def test_without_a_time_all_else_is_read(arm, tmp_path, instrument):
    plan = {"instrument": instrument, "poses": 12, "logs_torques": True, "loads_N": [0.0, 22.0]}
    plan |= {"base_targets": 0 if instrument == "distance" else 3, "repeat_every": 2}
    settings = {"robot": arm.name, "temperature_drift_C": 5.0, "without_touches": plan}
    for clock in ("row", "none"):
        plan["clock"] = clock
        made = simulate_campaign("raw", arm, SimulateOptions.model_validate(settings))
        write_campaign(made, tmp_path / clock)
    timed, untimed = (read_campaign(tmp_path / clock).observations for clock in ("row", "none"))
    assert list(untimed.kind) == list(timed.kind)
    assert list(untimed.pose) == list(timed.pose)
    assert list(untimed.repeat) == list(timed.repeat)
    for name in ("tau_Nm", "load_N", "temperature_C"):
        np.testing.assert_array_equal(getattr(untimed.states, name), getattr(timed.states, name))
    assert np.isfinite(untimed.states.tau_Nm).all()
    assert (untimed.base is None) == (timed.base is None)
