"""The folder of a campaign without touches, and the truth elsewhere."""

import json

import numpy as np
import pandas as pd
import pytest
import yaml

from pa10cal.campaign.description import read_campaign
from pa10cal.campaign.ingest import ingest_campaign
from pa10cal.cell.sighted import measure_sighted
from pa10cal.cell.sighted_write import sighted_table, write_sighted
from pa10cal.errors import SimulationError
from pa10cal.files.arms import load_arm
from pa10cal.settings import IngestSettings, SightedPlan

INSTRUMENTS = ("pose", "points", "distance")


def measure(arm, instrument, **more):
    return measure_sighted(arm, SightedPlan(instrument=instrument, poses=12, **more), 3)


@pytest.fixture(params=INSTRUMENTS)
def campaign(any_arm, request):
    return measure(any_arm, request.param, repeat_every=3, resolver_rad=1e-5, loads_N=(0.0, 22.0))


def test_folder_holds_the_contracts_files_and_no_truth(campaign, tmp_path):
    write_sighted(campaign, tmp_path / "raw/s", "s", tmp_path / "s.truth.json")
    assert sorted(path.name for path in (tmp_path / "raw/s").iterdir()) == [
        "campaign.yaml",
        "poses.csv",
    ]
    write_sighted(campaign, tmp_path / "raw/t", "t")
    assert sorted(path.name for path in tmp_path.rglob("*.json")) == ["s.truth.json"]


def test_table_reads_back_as_it_was(campaign, tmp_path):
    write_sighted(campaign, tmp_path, "s")
    read = pd.read_csv(tmp_path / "poses.csv")
    table = sighted_table(campaign)
    pd.testing.assert_frame_equal(read, table, check_dtype=False, rtol=0, atol=1e-6)
    text = (tmp_path / "poses.csv").read_text()
    assert "nan" not in text
    assert "-0.00000," not in text
    q = read[[name for name in read.columns if name.startswith("q") and name[1].isdigit()]]
    slides = campaign.truth.individual.arm.prismatic
    names = [f"q{k}_mm" if slide else f"q{k}_deg" for k, slide in enumerate(slides, start=1)]
    assert list(q.columns) == names
    found = np.where(slides, 1e-3 * q, np.radians(q))
    assert np.abs(found - campaign.q).max() < 1e-12


def test_what_was_seen_stands_beside_its_uncertainty(arm, tmp_path):
    poses, points, distances = (sighted_table(measure(arm, kind)) for kind in INSTRUMENTS)
    assert (poses["u_x_mm"] == 0.05).all()
    assert (poses["u_qw"] == 1e-4).all()
    assert np.linalg.norm(poses[["qw", "qx", "qy", "qz"]], axis=1) == pytest.approx(1.0)
    assert {f"{u}T{b}_{axis}_mm" for u in ("", "u_") for b in (1, 2, 3) for axis in "xyz"} <= set(
        points.columns
    )
    assert (distances["u_d_mm"] == 0.05).all()
    assert not {"x_mm", "qw"} & set(distances.columns)


def test_cells_of_targets_not_seen_are_empty(arm, tmp_path):
    campaign = measure(arm, "points", unseen_share=0.5)
    write_sighted(campaign, tmp_path, "s")
    lines = (tmp_path / "poses.csv").read_text().splitlines()
    at = lines[0].split(",").index("T2_y_mm")
    empty = [line.split(",")[at] == "" for line in lines[1:]]
    assert empty == np.isnan(campaign.seen.p_instr_m[:, 1, 1]).tolist()
    assert any(empty)


def test_description_says_what_the_contract_asks(campaign, tmp_path):
    write_sighted(campaign, tmp_path, "s")
    text = (tmp_path / "campaign.yaml").read_text()
    content = yaml.safe_load(text)
    individual = campaign.truth.individual
    assert content["schema"] == "pa10cal-campaign/1"
    assert content["robot"] == individual.arm.name
    kind = campaign.plan.instrument
    assert content["instrument"] == {"kind": kind, "uncertainty_mm": 0.05}
    assert content["files"] == {"poses": "poses.csv"}
    assert content["gravity_m_s2"] == [0.0, 0.0, -9.80665]
    assert content["tool"]["mass_kg"] == 1.0
    assert "synthetic" in content["provenance"]
    stated = content["tool"].get("balls_mm", {})
    names = {"pose": set(), "points": {"T1", "T2", "T3"}, "distance": {"T1"}}
    assert set(stated) == names[kind]
    for name, place in stated.items():
        b = individual.targets.names.index(name)
        assert place == pytest.approx(1e3 * individual.targets.p_ee_stated_m[b], abs=1e-4)
        assert np.abs(np.array(place) - 1e3 * individual.targets.p_ee_m[b]).max() > 1e-3


def test_places_of_targets_need_not_be_stated(arm, tmp_path):
    write_sighted(measure(arm, "points", states_targets=False), tmp_path, "s")
    assert "balls_mm" not in yaml.safe_load((tmp_path / "campaign.yaml").read_text())["tool"]


def test_truth_is_enough_to_know_what_was_seen(any_arm, tmp_path):
    campaign = measure(any_arm, "points", unseen_share=0.0, position_mm=1e-5)
    write_sighted(campaign, tmp_path / "raw", "s", tmp_path / "s.json")
    truth = json.loads((tmp_path / "s.json").read_text())
    assert truth["schema"] == "pa10cal-truth/1"
    assert SightedPlan.model_validate(truth["settings"]) == campaign.plan
    for q, seen in zip(truth["q_motor_rad_or_m"], campaign.seen.p_instr_m, strict=True):
        T = np.array(truth["T_instr_base_m"])
        for k, placement in enumerate(truth["joint_placements_m"]):
            moved, (cos, sin) = np.eye(4), (np.cos(q[k]), np.sin(q[k]))
            if any_arm.prismatic[k]:
                moved[2, 3] = q[k]
            else:
                moved[:2, :2] = [[cos, -sin], [sin, cos]]
            T = T @ placement @ moved
        T = T @ truth["T_last_joint_ee_m"]
        places = [(T @ [*place, 1.0])[:3] for place in truth["targets_m"].values()]
        assert seen == pytest.approx(np.array(places), abs=1e-6)


def test_truth_names_the_springs(arm, tmp_path):
    campaign = measure(arm, "pose", flexible_joints=(2, 5))
    write_sighted(campaign, tmp_path / "raw", "s", tmp_path / "s.json")
    springs = json.loads((tmp_path / "s.json").read_text())["springs"]
    k_lin = campaign.truth.individual.linkage.springs.k_lin
    assert springs["joint 5"]["K_lin_Nm_rad"] == k_lin[4]
    assert set(springs) == {"joint 2", "joint 5"}


def test_torques_are_written_where_they_are_logged(arm, tmp_path):
    campaign = measure(arm, "pose", logs_torques=True)
    write_sighted(campaign, tmp_path, "s")
    read = pd.read_csv(tmp_path / "poses.csv")
    tau = read[[f"tau{k}_Nm" for k in range(1, 7)]].to_numpy()
    assert tau == pytest.approx(campaign.tau_Nm, abs=1e-9)


def test_the_same_campaign_gives_the_same_bytes(campaign, tmp_path):
    for name in ("one", "two"):
        write_sighted(campaign, tmp_path / name, "s", tmp_path / f"{name}.json")
    for file in ("poses.csv", "campaign.yaml"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()


def test_refuses_the_truth_beside_the_data_and_a_folder_of_something_else(campaign, tmp_path):
    with pytest.raises(SimulationError, match="must not lie"):
        write_sighted(campaign, tmp_path / "raw", "s", tmp_path / "raw/truth.json")
    (tmp_path / "raw").mkdir(exist_ok=True)
    (tmp_path / "raw/cmm.csv.gz").write_bytes(b"other")
    with pytest.raises(SimulationError, match=r"cmm\.csv\.gz"):
        write_sighted(campaign, tmp_path / "raw", "s")


@pytest.mark.parametrize("name", ["ur10", "gx4_351s", "iiwa14"])
@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_the_reader_of_campaigns_takes_it_as_it_was_seen(tmp_path, name, instrument):
    arm = load_arm(name)
    plan = SightedPlan(instrument=instrument, poses=20, repeat_every=4, loads_N=(0.0, 22.0))
    campaign = measure_sighted(arm, plan, 3)
    write_sighted(campaign, tmp_path, "s")
    ingested = ingest_campaign(read_campaign(tmp_path), arm, tmp_path, IngestSettings())
    assert ingested.left_out == ()
    poses = ingested.poses
    assert poses.kind.tolist() == campaign.kind.tolist()
    assert poses.pose.tolist() == campaign.pose.tolist()
    assert poses.load_N.tolist() == campaign.load_N.tolist()
    assert np.abs(poses.q_rad - campaign.q).max() < 1e-12
    if instrument == "pose":
        T = campaign.seen.T_instr_target.copy()
        T[:, :3, 3] *= 1e3
        assert np.abs(poses.T_instr_ee_mm - T).max() < 1e-6
        variances = np.diagonal(poses.cov_ee_mm, axis1=1, axis2=2)
        assert variances == pytest.approx(np.tile([0.05**2] * 3 + [2e-4**2] * 3, (len(T), 1)))
    elif instrument == "points":
        seen_mm = 1e3 * campaign.seen.p_instr_m
        assert poses.ball_names == ("T1", "T2", "T3")
        assert np.array_equal(np.isnan(poses.p_instr_balls_mm), np.isnan(seen_mm))
        assert np.nanmax(np.abs(poses.p_instr_balls_mm - seen_mm)) < 1e-6
    else:
        assert np.abs(poses.d_mm - 1e3 * campaign.seen.d_m).max() < 1e-6
        assert poses.d_u_mm == pytest.approx(0.05)
