"""Targets on the base: read, their motion taken out, kept in the table; and bad input of them."""

import numpy as np
import pandas as pd
import pytest
import yaml

from mended import write_simulated
from pa10cal.calibration.general.calibrate import find_start
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.table import read_base_motion, read_observations, write_pose_table
from pa10cal.commands.command_line import main
from pa10cal.errors import RawDataError
from pa10cal.frame.point_fits import cross_matrix
from pa10cal.observe.joined import GroupCampaign, join

WALK = ({"id": "random_walk", "parameters": {"size_mm": 0.05, "turn_mrad": 0.01}},)


def written(folder, instrument="points", base=3, seed=3, disturbances=WALK, **plan):
    """Write the raw folder of an IRB 120 under an instrument that moves."""
    asked = {
        "random_seed": seed,
        "robot": "irb120",
        "without_touches": {
            "instrument": instrument,
            "poses": 200,
            "base_targets": base,
            "position_mm": 0.01,
            "attitude_rad": 5e-5,
            "unseen_share": 0.0,
            **plan,
        },
        "disturbances": list(disturbances),
    }
    return write_simulated(folder, asked)


def spoil(folder, change):
    """Change the table of readings."""
    path = folder / "poses.csv"
    table = pd.read_csv(path)
    table = change(table)
    table.to_csv(path, index=False)


def still(folder, **plan):
    """Write and read the same campaign of an instrument that stands still."""
    return read_campaign(written(folder, disturbances=(), **plan))


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    """The campaign as `written` has it without being asked, read once; nobody spoils it."""
    return read_campaign(written(tmp_path_factory.mktemp("usual") / "c"))


@pytest.mark.slow
@pytest.mark.parametrize("instrument", ["points", "pose"])
def test_readings_are_as_of_an_instrument_that_stands_still(tmp_path, instrument):
    turn = {"parameters": {"size_mm": 0.05}} if instrument == "pose" else {}
    moving = ({**WALK[0], **turn},)
    raw = written(tmp_path / "moving", instrument, disturbances=moving)
    found = read_campaign(raw)
    ideal = still(tmp_path / "still", instrument=instrument)
    assert found.observations.base.found.form == "walk"
    assert ideal.observations.base.found.form == "still"
    apart = found.observations.measured.places_m - ideal.observations.measured.places_m
    apart -= apart.mean(axis=(0, 1))
    spoil(raw, lambda table: table.drop(columns=[c for c in table if "base" in c]))
    without = read_campaign(raw).observations.measured.places_m
    moved = without - ideal.observations.measured.places_m
    moved -= moved.mean(axis=(0, 1))
    assert np.std(apart) < 0.3 * np.std(moved)
    assert any("move together by up to" in note for note in found.notes)


def test_the_noise_of_the_motion_is_shared_by_the_targets_of_a_pose(usual):
    found = usual.observations
    base, measured = found.base, found.measured
    cov = measured.stated_covariance
    p_m = measured.p_instr_m[7]
    along = [np.hstack([np.eye(3), -cross_matrix(p - base.about_m)]) for p in p_m]
    across = along[0] @ base.motion_cov[7] @ along[2].T
    np.testing.assert_allclose(cov[7, :3, 6:9], across, rtol=1e-6, atol=1e-18)
    own = along[1] @ base.motion_cov[7] @ along[1].T + measured.cov_m2[7, 1]
    np.testing.assert_allclose(cov[7, 3:6, 3:6], own, rtol=1e-6, atol=1e-18)
    T = np.eye(4)
    T[:3, :3] = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    T[:3, 3] = [0.5, -0.2, 1.0]
    R = np.kron(np.eye(3), T[:3, :3])
    np.testing.assert_allclose(
        measured.in_frame(T).stated_covariance[7], R @ cov[7] @ R.T, rtol=1e-6, atol=1e-18
    )


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("instrument", ["points", "pose"])
def test_the_table_keeps_targets_motion_and_noise(tmp_path, usual, instrument):
    campaign = usual
    if instrument != "points":
        campaign = read_campaign(written(tmp_path / "c", instrument))
    path = tmp_path / "poses.parquet"
    write_pose_table(path, campaign.observations, campaign.arm.prismatic, "c")
    back = read_observations(path, campaign.description)
    assert read_base_motion(path) == campaign.observations.base.found
    for name in ("p_instr_m", "u_m", "motion", "motion_cov"):
        there, here = getattr(campaign.observations.base, name), getattr(back.base, name)
        np.testing.assert_allclose(here, there, rtol=1e-9, atol=1e-20)
    np.testing.assert_allclose(
        back.measured.stated_covariance,
        campaign.observations.measured.stated_covariance,
        rtol=1e-9,
        atol=1e-18,
    )
    some = back.take(np.array([3, 5, 8]))
    assert some.measured.stated_covariance.shape[0] == len(some.base.motion) == 3


def test_a_campaign_without_them_has_none(tmp_path):
    found = read_campaign(written(tmp_path / "c", base=0)).observations
    assert found.base is None
    assert found.measured.motion_cov is None


def test_a_knocked_target_is_warned_of(tmp_path):
    raw = written(tmp_path / "c")

    def knocked(table):
        table.loc[table.index >= 120, ["base2_x_mm", "base2_y_mm", "base2_z_mm"]] += 0.2
        return table

    spoil(raw, knocked)
    campaign = read_campaign(raw)
    (warning,) = campaign.warnings
    assert "base2 moved by 0." in warning
    assert "before pose P121" in warning
    assert campaign.observations.base.found.knocked[0].targets == ("base2",)


BASE = ["base1", "base2", "base3"]


def place(name):
    """Return the columns of a target."""
    return [f"{name}_{axis}_mm" for axis in "xyz"]


def measured_of(raw):
    """Return the positions read from a folder, and their covariance."""
    measured = read_campaign(raw).observations.measured
    return measured.places_m, measured.stated_covariance


def test_another_target_read_by_mistake_is_warned_of_and_changes_nothing_else(tmp_path, usual):
    raw = written(tmp_path / "c")
    clean = usual.observations.measured
    places_m, cov = clean.places_m, clean.stated_covariance
    rows = [17, 60, 133]

    def exchanged(table):
        for axis in "xyz":
            table.loc[rows, f"base3_{axis}_mm"] = table.loc[rows, f"base1_{axis}_mm"] + 40.0
        return table

    spoil(raw, exchanged)
    campaign = read_campaign(raw)
    (warning,) = campaign.warnings
    assert "read wrongly: 3 readings of base3, the furthest" in warning
    (misread,) = campaign.observations.base.found.misread
    assert misread.target == "base3"
    assert misread.pose in {"P018", "P061", "P134"}
    others = np.setdiff1d(np.arange(200), rows)
    measured = campaign.observations.measured
    np.testing.assert_allclose(measured.places_m[others], places_m[others], atol=3e-6)
    np.testing.assert_allclose(measured.stated_covariance, cov, atol=(5e-6) ** 2)


def test_a_wrong_reading_is_off_by_its_error_and_not_by_the_drift_too(tmp_path):
    drift = ({"id": "random_walk", "parameters": {"size_mm": 2.0, "turn_mrad": 0.01}},)
    raw = written(tmp_path / "c", base=4, disturbances=drift)

    def wrong(table):
        table.loc[60, "base3_x_mm"] += 0.15  # less than 20 stated uncertainties: no warning
        return table

    spoil(raw, wrong)
    campaign = read_campaign(raw)
    base = campaign.observations.base
    assert 1e3 * np.abs(base.motion[60, :3]).max() > 0.5
    (misread,) = base.found.misread
    assert (misread.target, misread.pose) == ("base3", "P061")
    assert misread.off_mm == pytest.approx(0.15, abs=0.05)
    assert campaign.warnings == ()


def test_of_two_targets_a_turn_is_uncertain_and_the_note_says_so(tmp_path):
    raw = written(tmp_path / "c", base=2)
    campaign = read_campaign(raw)
    assert any("a turn does not show, uncertain by 0.0" in note for note in campaign.notes)
    base = campaign.observations.base
    assert not base.found.turns
    turn_rad = np.sqrt(base.motion_cov[:, 3, 3])
    assert 2e-6 < turn_rad.max() < 3e-5


@pytest.mark.slow
@pytest.mark.parametrize("base", [1, 2, 3])
@pytest.mark.parametrize("noise_mm", [0.01, 1.0])
def test_targets_of_noise_alone_leave_the_readings_as_they_are(tmp_path, base, noise_mm):
    raw = written(tmp_path / "c", base=base)
    rng = np.random.default_rng(base)

    def noisy(table):
        for name in BASE[:base]:
            values = table[place(name)].mean().to_numpy()
            table[place(name)] = values + noise_mm * rng.standard_normal((len(table), 3))
        return table

    spoil(raw, noisy)
    places_m, cov = measured_of(raw)
    spoil(raw, lambda table: table.drop(columns=[c for c in table if "base" in c]))
    without_m, without_cov = measured_of(raw)
    np.testing.assert_array_equal(places_m, without_m)
    np.testing.assert_array_equal(cov, without_cov)


def test_targets_that_move_by_themselves_are_not_used(tmp_path):
    raw = written(tmp_path / "c", disturbances=())
    rng = np.random.default_rng(5)

    def shaken(table):
        by_mm = 0.8 * rng.standard_normal((len(table), 3))
        for name in BASE:
            table[place(name)] += by_mm
        return table

    without_m, without_cov = measured_of(raw)
    spoil(raw, shaken)
    campaign = read_campaign(raw)
    (warning,) = campaign.warnings
    assert "the readings of the arm do not move with them" in warning
    assert campaign.observations.base is None
    np.testing.assert_array_equal(campaign.observations.measured.places_m, without_m)
    np.testing.assert_array_equal(campaign.observations.measured.stated_covariance, without_cov)


@pytest.mark.parametrize("since", [90, pytest.param(190, marks=pytest.mark.slow)])
@pytest.mark.parametrize("base", [1, 3])
def test_targets_that_are_pushed_far_are_not_used(tmp_path, base, since):
    raw = written(tmp_path / "c", base=base)

    def pushed(table):
        table.loc[table.index >= since, [f"{name}_x_mm" for name in BASE[:base]]] += 30.0
        return table

    spoil(raw, pushed)
    campaign = read_campaign(raw)
    (warning,) = campaign.warnings
    assert "the readings of the arm do not move with them" in warning
    assert campaign.observations.base is None


def test_targets_that_scatter_more_than_stated_are_warned_of(tmp_path):
    raw = written(tmp_path / "c", disturbances=())
    rng = np.random.default_rng(1)

    def noisy(table):
        for name in BASE:
            table[place(name)] += rng.standard_normal((len(table), 3))
        return table

    spoil(raw, noisy)
    campaign = read_campaign(raw)
    (warning,) = campaign.warnings
    assert "times as much as stated" in warning
    assert any("show no motion beyond their scatter of 1.0" in note for note in campaign.notes)


def test_blank_fields_are_targets_not_seen(tmp_path):
    raw = written(tmp_path / "c")

    def blank(table):
        table.loc[10:14, [f"base{k}_{axis}_mm" for k in (1, 2, 3) for axis in "xyz"]] = np.nan
        table.loc[20, "base1_y_mm"] = np.nan
        return table

    spoil(raw, blank)
    found = read_campaign(raw).observations
    assert len(found) == 200
    assert found.base.found.without == 5
    assert np.isnan(found.base.p_instr_m[20, 0]).all()


def _twice(table):
    for axis in "xyz":
        table[f"base3_{axis}_mm"] = table[f"base1_{axis}_mm"]
    return table


def _anew(table):
    columns = [name for name in table if name.endswith("_x_mm") and not name.startswith("u_")]
    table.loc[table.index >= 90, columns] += 30.0
    return table


def _twice_but_once(table):
    table = _twice(table)
    table.loc[17, "base3_x_mm"] += 40.0
    return table


def _drifting(table):
    columns = [name for name in table if name.endswith("_x_mm") and not name.startswith("u_")]
    table[columns] += np.linspace(0.0, 30.0, len(table))[:, None]
    return table


def _turned(table):
    """Turn the instrument about z by 8 mrad at row 120, after a shift of 3 mm at row 40."""
    targets = [name.removesuffix("_x_mm") for name in table if name.endswith("_x_mm")]
    targets = [name for name in targets if not name.startswith("u_")]
    table.loc[table.index >= 40, [f"{name}_z_mm" for name in targets]] += 3.0
    centre = [table[[f"{name}_{axis}_mm" for name in BASE]].to_numpy().mean() for axis in "xy"]
    after = table.index >= 120
    for name in targets:
        x, y = f"{name}_x_mm", f"{name}_y_mm"
        arm_x, arm_y = table.loc[after, x] - centre[0], table.loc[after, y] - centre[1]
        table.loc[after, x] -= 8e-3 * arm_y
        table.loc[after, y] += 8e-3 * arm_x
    return table


BAD = [
    (lambda t: t.drop(columns="base2_y_mm"), "points", "base2_y_mm"),
    (_twice, "points", "base1 and base3 are the same target"),
    (_twice_but_once, "points", "base1 and base3 are the same target"),
    (_anew, "points", r"set up anew .*largest step \(30\..* between poses P090 and P091"),
    (_turned, "points", r"set up anew .*8\.\d\d mrad.* between poses P120 and P121"),
    (_drifting, "points", r"moved too far .*moved by 30\..*gradually.*warm up"),
    (lambda t: t, "distance", "distance does not see targets on the base"),
]


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(("change", "instrument", "message"), BAD)
def test_what_cannot_be_used_is_refused(tmp_path, change, instrument, message):
    raw = written(tmp_path / "c", instrument)
    spoil(raw, change)
    with pytest.raises(RawDataError, match=message) as refused:
        read_campaign(raw)
    assert "poses.csv" in str(refused.value)


def test_a_name_on_the_tool_and_on_the_base_is_refused(tmp_path):
    raw = written(tmp_path / "c")
    path = raw / "campaign.yaml"
    path.write_text(path.read_text().replace("T1:", "base1:"))
    with pytest.raises(RawDataError, match="base1 is both on the tool and on the base"):
        read_campaign(raw)


def test_a_file_with_names_of_its_own_maps_them_as_targets(tmp_path, usual):
    raw = written(tmp_path / "c")
    known = usual.observations
    path = raw / "campaign.yaml"
    spoil(raw, lambda table: table.rename(columns=lambda name: name.replace("base", "SMR")))
    said = yaml.safe_load(path.read_text())

    def place(name):
        return {"names": [f"{name}_{axis}_mm" for axis in "xyz"]}

    said["columns"] = {
        "poses": {
            "time": {"names": "time_s"},
            "kind": {"names": "kind"},
            "pose": "pose",
            "repeat": "repeat",
            "joints": {"names": [f"q{j}_deg" for j in range(1, 7)]},
            "targets": {
                **{f"T{k}": place(f"T{k}") for k in (1, 2, 3)},
                **{f"base{k}": place(f"SMR{k}") for k in (1, 2, 3)},
            },
        }
    }
    path.write_text(yaml.safe_dump(said))
    found = read_campaign(raw).observations
    np.testing.assert_allclose(found.base.motion, known.base.motion, atol=1e-9)
    said["columns"]["poses"]["targets"]["base3"] = place("SMR1")
    path.write_text(yaml.safe_dump(said))
    with pytest.raises(RawDataError, match=r"a column is mapped twice .*base1_x_mm and base3_x_mm"):
        read_campaign(raw)


def test_a_group_keeps_what_the_motion_is_uncertain_by(tmp_path, usual):
    first, second = usual, read_campaign(written(tmp_path / "b", seed=4))
    members = [
        GroupCampaign(name, each.observations, find_start(each.arm, each.observations))
        for name, each in (("a", first), ("b", second))
    ]
    together = join(members)
    here = together.states.campaign == 1
    cov = together.measured.take(np.flatnonzero(here)).stated_covariance
    own = second.observations.measured.stated_covariance
    traces = (np.trace(each[:, -9:, -9:], axis1=1, axis2=2) for each in (cov, own))
    np.testing.assert_allclose(*traces, rtol=1e-6)


def test_targets_that_stand_still_are_proposed_as_those_on_the_base(tmp_path, capsys):
    raw = written(tmp_path / "c")
    spoil(
        raw,
        lambda table: table.rename(
            columns=lambda name: name.replace("base", "SMR").replace("_deg", " [deg]")
        ),
    )
    assert main(["columns", str(raw / "poses.csv"), "--robot", "irb120"]) == 0
    text = capsys.readouterr().out
    assert "stand still, so on the base" in text
    targets = yaml.safe_load(text)["columns"]["poses"]["targets"]
    assert list(targets) == ["T1", "T2", "T3", "base1", "base2", "base3"]
    assert targets["base2"]["names"] == ["SMR2_x_mm", "SMR2_y_mm", "SMR2_z_mm"]
    assert targets["base2"]["unit"] == "mm"
