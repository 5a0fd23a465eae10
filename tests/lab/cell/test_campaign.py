"""Whole campaigns: the paper's figures, noise, determinism, and what each effect leaves in them."""

import numpy as np
import pytest

from made_up_robot import rebuilt
from pa10cal.arm.description import Arm
from pa10cal.errors import SettingsError
from pa10cal_lab.cell.campaign import measure_campaign, simulate_campaign
from pa10cal_lab.cell.effects.joint import (
    SimulatedBacklash,
    SimulatedFrictionTorque,
    SimulatedTransmissionError,
)
from pa10cal_lab.cell.effects.outside import DressPack
from pa10cal_lab.cell.effects.structure import (
    SimulatedBaseDrift,
    SimulatedCmmScale,
    SimulatedThermalGrowth,
    SimulatedToolSag,
)
from pa10cal_lab.cell.mechanism import Departures
from pa10cal_lab.cell.options import CellNoiseOptions, SimulateOptions

QUIET = CellNoiseOptions(**dict.fromkeys(CellNoiseOptions.model_fields, 0.0))
TOUCHES = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
#: The paper, unloaded, at 22 N and at 44 N: mean position error before calibration [mm].
PAPER_BEFORE_MM = (0.58, 1.02, 1.80)
PAPER_BEFORE_DEG = 1.2


def rigid_fit(source, target):
    """Kabsch: R, p with target = R source + p."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    U, _, Vt = np.linalg.svd((source - a).T @ (target - b))
    R = Vt.T @ np.diag([1, 1, np.linalg.det(Vt.T @ U.T)]) @ U.T
    return R, b - R @ a


def centres(campaign):
    """Ball centres [mm], (C, 3, 3), from the touches alone."""
    points = campaign.tables["cmm"][["x_mm", "y_mm", "z_mm"]].to_numpy().reshape(-1, 3, 5, 3)
    return (points - 12.7 * TOUCHES).mean(axis=2)


def flanges(campaign):
    """Measured flanges in the machine, (C, 3, 3) and (C, 3) [mm]."""
    balls = 1e3 * campaign.truth.robot.targets.p_ee_stated_m
    fits = [rigid_fit(balls, found) for found in centres(campaign)]
    return np.array([R for R, _ in fits]), np.array([p for _, p in fits])


def moving(campaign, name):
    """A logged column as (C, samples)."""
    return campaign.tables["resolver"][name].to_numpy().reshape(len(campaign.truth.schedule), -1)


@pytest.fixture(scope="module")
def paper(arm):
    """The paper's experiment, nothing hidden."""
    return simulate_campaign("paper", arm, SimulateOptions())


def test_before_calibration_it_errs_as_the_papers_robot(paper, robot, plain):
    nominal = plain(rebuilt(robot, departures=Departures.none(6)))
    schedule = paper.truth.schedule
    T = np.array([nominal.frames(q)[-1] for q in schedule.q])
    R_cmm, p_instr = flanges(paper)
    grid = schedule.kind == "grid"
    unloaded = grid & (schedule.load_N == 0.0)
    R, p = rigid_fit(p_instr[unloaded], 1e3 * T[unloaded, :3, 3])
    for load_N, wanted_mm in zip((0.0, 22.0, 44.0), PAPER_BEFORE_MM, strict=True):
        at_load = grid & (schedule.load_N == load_N)
        error_mm = np.linalg.norm(p_instr[at_load] @ R.T + p - 1e3 * T[at_load, :3, 3], axis=1)
        assert error_mm.mean() == pytest.approx(wanted_mm, rel=0.25)
        turn = T[at_load, :3, :3].transpose(0, 2, 1) @ R @ R_cmm[at_load]
        angle = np.arccos((np.trace(turn, axis1=1, axis2=2) - 1) / 2)
        assert np.degrees(angle).mean() == pytest.approx(PAPER_BEFORE_DEG, rel=0.25)


def test_repeats_scatter_as_the_papers(paper):
    _, p_instr = flanges(paper)
    schedule = paper.truth.schedule
    for load_N in (0.0, 22.0, 44.0):
        scatter = []
        for label in np.unique(schedule.pose[schedule.kind == "grid"]):
            rows = (schedule.pose == label) & (schedule.load_N == load_N)
            scatter.append(np.sqrt(p_instr[rows].var(axis=0, ddof=1).sum()))
        assert 0.014 <= np.mean(scatter) <= 0.024
        assert max(scatter) < 0.035


def test_torques_are_of_the_size_of_the_papers_arm(paper):
    """Means of the torques of joints 2, 3 at 0, 22, 44 N: 60/75/89 and 37/48/59 N m."""
    truth = paper.truth
    for load_N, wanted in ((0.0, (60, 37)), (22.0, (75, 48)), (44.0, (89, 59))):
        rows = (truth.schedule.kind == "grid") & (truth.schedule.load_N == load_N)
        found = np.abs(truth.rest.tau_Nm[rows]).mean(axis=0)
        assert found[[1, 2]] == pytest.approx(wanted, rel=0.1)
        assert found[[0, 5]].max() < 0.5


def test_tables_have_the_columns_and_rows_of_the_contract(paper):
    named = ["kind", "pose", "load_N", "repeat", "ball", "touch"]
    assert list(paper.tables["cmm"].columns) == ["time_s", *named, "x_mm", "y_mm", "z_mm"]
    joints = range(1, 7)
    assert list(paper.tables["resolver"].columns) == [
        "time_s",
        *(f"q{j}_deg" for j in joints),
        *(f"tau{j}_Nm" for j in joints),
        "temperature_C",
    ]
    configurations = 22 + 27 * 10 * 3 + 10 * 4 * 3
    assert len(paper.tables["cmm"]) == configurations * 15
    assert len(paper.tables["resolver"]) == configurations * 20
    for table in (paper.tables["cmm"], paper.tables["resolver"]):
        assert not table.isna().any().any()
        assert table["time_s"].is_monotonic_increasing
    assert set(paper.tables["cmm"]["ball"]) == {"A", "B", "C"}


def test_touches_lie_on_their_balls_and_inside_the_dwell(paper):
    points = paper.tables["cmm"][["x_mm", "y_mm", "z_mm"]].to_numpy().reshape(-1, 5, 3)
    off = points - centres(paper).reshape(-1, 1, 3) - 12.7 * TOUCHES
    assert off.std() == pytest.approx(0.004 * np.sqrt(0.8), rel=0.05)
    start_s = paper.truth.schedule.start_s
    touched = paper.tables["cmm"]["time_s"].to_numpy().reshape(len(start_s), -1) - start_s[:, None]
    logged = moving(paper, "time_s") - start_s[:, None]
    assert logged.shape[1] == 20
    assert np.all(touched.min(axis=1) > logged[:, 10])
    assert np.all(touched.max(axis=1) < logged[:, -1])


def test_joints_approach_from_where_they_come_and_then_stand(paper):
    schedule = paper.truth.schedule
    for j in range(6):
        q = np.radians(moving(paper, f"q{j + 1}_deg"))
        way = schedule.q[:, j] - schedule.q_from[:, j]
        wanted = schedule.q_from[:, j] + way / 11
        assert q[:, 0] == pytest.approx(wanted, abs=1e-4)
        assert q[:, 10:] == pytest.approx(np.repeat(schedule.q[:, [j]], 10, axis=1), abs=1e-4)
        assert q[:, 10:].std(axis=1).mean() < 1e-5
        last = np.sign(q[:, 10] - q[:, 9])
        moves = schedule.arrival[:, j] != 0
        assert np.mean(last[moves] == schedule.arrival[moves, j]) > 0.98


def test_logs_are_in_whole_counts_and_steps(paper, arm):
    counts = np.radians(moving(paper, "q2_deg")) / 7.67e-6
    assert np.abs(counts - counts.round()).max() < 0.02
    steps = moving(paper, "tau3_Nm") / (arm.torque_limit_Nm[2] / 4096)
    assert np.abs(steps - steps.round()).max() < 0.03


def test_torque_noise_at_rest_and_in_motion(paper):
    dwell = moving(paper, "tau2_Nm")[:, 10:]
    assert dwell.std(axis=1).mean() == pytest.approx(0.39, rel=0.1)
    true = paper.truth.rest.tau_Nm[:, 1]
    assert np.mean(dwell.mean(axis=1) - true) == pytest.approx(0.0, abs=0.02)
    assert moving(paper, "tau2_Nm")[:, :10].std(axis=1).mean() > 2.0


def test_the_same_seed_gives_the_same_campaign_and_another_does_not(arm, short):
    one, two = (simulate_campaign("x", arm, short) for _ in range(2))
    assert one.tables["cmm"].equals(two.tables["cmm"])
    assert one.tables["resolver"].equals(two.tables["resolver"])
    other = simulate_campaign("x", arm, short.model_copy(update={"random_seed": 1}))
    assert not np.allclose(other.tables["cmm"]["x_mm"], one.tables["cmm"]["x_mm"], atol=1.0)
    assert not other.tables["resolver"].equals(one.tables["resolver"])


def test_without_noise_repeats_agree_and_truth_is_measured(arm):
    settings = SimulateOptions(repeats=2, loads_N=(0.0,), holdout_points=0, noise=QUIET)
    campaign = simulate_campaign("x", arm, settings)
    truth = campaign.truth
    attitude, place_mm = flanges(campaign)
    T = truth.robot.T_instr_base @ truth.rest.T_base_ee
    assert place_mm == pytest.approx(1e3 * T[:, :3, 3], abs=5e-4)  # written to 1e-4 mm
    assert attitude == pytest.approx(T[:, :3, :3], abs=2e-6)
    logged = moving(campaign, "tau2_Nm")[:, 10:]
    assert logged == pytest.approx(np.repeat(truth.rest.tau_Nm[:, [1]], 10, axis=1), abs=0.03)
    assert np.ptp(moving(campaign, "q2_deg")[:, 10:], axis=1).max() == 0.0


def test_touches_are_on_the_balls_as_they_are_not_as_they_were_measured(arm):
    badly_measured = QUIET.model_copy(update={"apparatus_mm": 1.0})
    settings = SimulateOptions(repeats=1, loads_N=(0.0,), holdout_points=0, noise=badly_measured)
    campaign = simulate_campaign("x", arm, settings)
    truth = campaign.truth
    T = truth.robot.T_instr_base @ truth.rest.T_base_ee
    balls = truth.robot.targets.p_ee_m
    wanted = np.einsum("cij,bj->cbi", T[:, :3, :3], balls) + T[:, None, :3, 3]
    assert centres(campaign) == pytest.approx(1e3 * wanted, abs=2e-4)


def test_an_arm_of_seven_joints_is_measured_too():
    quarter = np.pi / 2
    arm = Arm(
        name="seven",
        title="Seven joints",
        convention="standard",
        theta_rad=np.zeros(7),
        d_m=np.array([0.34, 0.0, 0.4, 0.0, 0.4, 0.0, 0.126]),
        a_m=np.zeros(7),
        alpha_rad=quarter * np.array([-1, 1, 1, -1, -1, 1, 0]),
        hayati=np.zeros(7, dtype=bool),
        prismatic=np.zeros(7, dtype=bool),
        limits_rad=np.tile([-3.0, 3.0], (7, 1)),
        gear_ratio=np.full(7, 100.0),
        torque_limit_Nm=np.array([320.0, 320, 176, 176, 110, 40, 40]),
        mass_kg=np.full(7, 3.0),
        com_m=np.zeros((7, 3)),
    )
    settings = SimulateOptions(
        built="drawn",
        flexible_joints=(2, 4, 6),
        repeats=1,
        loads_N=(0.0,),
        poses={"centre_deg": (0, 30, 0, -90, 0, 60, 0), "spacing_m": (0.08, 0.08, 0.08)},
        hidden_effects=(
            {"id": "wrist_coupling", "of": "wrist", "parameters": {"c": 1e-4}},
            {"id": "link_bending", "of": "forearm", "parameters": {"c": 1e-6}},
        ),
    )
    campaign = simulate_campaign("x", arm, settings)
    assert list(campaign.tables["resolver"].columns[[1, 7, 8, 14]]) == [
        "q1_deg",
        "q7_deg",
        "tau1_Nm",
        "tau7_Nm",
    ]
    still = np.abs(campaign.truth.q_motor - campaign.truth.rest.q).max(axis=0)
    assert np.all(still[[1, 3, 5]] > 1e-4)
    assert np.all(still[[0, 2, 4]] < 1e-4)


def test_drawn_robots_are_other_robots_and_still_find_rest(arm, short):
    drawn = short.model_copy(update={"built": "drawn", "noise": QUIET})
    robots = [
        simulate_campaign("x", arm, drawn.model_copy(update={"random_seed": seed})).truth
        for seed in range(3)
    ]
    lengths = [truth.robot.departures.a_m for truth in robots]
    assert len(np.unique(lengths, axis=0)) == 3
    for truth in robots:
        deflection = np.abs(truth.q_motor - truth.rest.q).max(axis=0)
        assert np.all(deflection[[1, 2, 4]] > 1e-4)
        assert np.all(deflection[[0, 3, 5]] < 1e-12)


# What an effect leaves in the files, against the same campaign without it.


@pytest.fixture(scope="module")
def hidden(arm, robot, short):
    """Measure the short campaign without noise, with some effects or none."""

    def measure(*effects, **settings):
        quiet = short.model_copy(update={"noise": QUIET, **settings})
        return measure_campaign("x", quiet, robot, effects)

    return measure


def test_friction_shows_in_its_own_torque_by_arrival_and_nowhere_else(hidden):
    plain, rubbing = hidden(), hidden(SimulatedFrictionTorque(tau_c=4.0).at("joint 2"))
    assert rubbing.tables["cmm"].equals(plain.tables["cmm"])
    more = moving(rubbing, "tau2_Nm") - moving(plain, "tau2_Nm")
    s = plain.truth.schedule.arrival[:, [1]]
    assert set(s.ravel()) >= {-1.0, 1.0}
    assert more == pytest.approx(np.repeat(4.0 * s, 20, axis=1), abs=0.06)
    same = [name for name in plain.tables["resolver"].columns if name != "tau2_Nm"]
    assert rubbing.tables["resolver"][same].equals(plain.tables["resolver"][same])


def test_dress_pack_shows_in_the_log_on_the_way_and_at_rest(hidden):
    plain, pulled = hidden(), hidden(DressPack(k=4.0, q0=0.1).at("joint 1"))
    assert pulled.tables["cmm"].equals(plain.tables["cmm"])
    more = moving(pulled, "tau1_Nm") - moving(plain, "tau1_Nm")
    q = np.radians(moving(plain, "q1_deg"))
    assert more == pytest.approx(4.0 * (q - 0.1), abs=0.06)


def test_transmission_error_turns_the_link_and_the_motor_does_not_know(hidden):
    effect = SimulatedTransmissionError(A=3e-4, phi=0.5).at("joint 1")
    plain, erring = hidden(), hidden(effect)
    assert (
        erring.tables["resolver"]
        .filter(like="_deg")
        .equals(plain.tables["resolver"].filter(like="_deg"))
    )
    q = plain.truth.q_motor[:, 0]
    turned = erring.truth.rest.q[:, 0] - plain.truth.rest.q[:, 0]
    assert turned == pytest.approx(3e-4 * np.sin(100 * q + 0.5), abs=1e-12)
    assert np.abs(centres(erring) - centres(plain)).max() > 0.1


def test_several_joint_effects_add_up(hidden):
    first, second = SimulatedTransmissionError(A=3e-4, phi=0.5), SimulatedBacklash(b=1e-4)
    both = hidden(first.at("joint 1"), second.at("joint 1"))
    apart = [hidden(effect.at("joint 1")).truth.rest.q for effect in (first, second)]
    plain = hidden().truth.rest.q
    assert both.truth.rest.q == pytest.approx(sum(apart) - plain, abs=1e-12)


def test_scale_and_sag_show_in_the_touches_alone(hidden):
    plain = hidden()
    scaled = hidden(SimulatedCmmScale(s=(1e-3, 0.0, -2e-3)).at("instrument"))
    xyz = ["x_mm", "y_mm", "z_mm"]
    wanted = plain.tables["cmm"][xyz].to_numpy() * [1.001, 1.0, 0.998]
    assert scaled.tables["cmm"][xyz].to_numpy() == pytest.approx(wanted, abs=2e-4)
    assert scaled.tables["resolver"].equals(plain.tables["resolver"])
    sagging = hidden(SimulatedToolSag(c=1e-3).at("tool"))
    shift = (centres(sagging) - centres(plain)).mean(axis=1)
    R = plain.truth.robot.T_instr_base[:3, :3] @ plain.truth.rest.T_base_ee[:, :3, :3]
    down = -plain.truth.robot.T_instr_base[:3, 2]
    wanted = down - R[:, :, 2] * (R[:, :, 2] @ down)[:, None]
    assert shift == pytest.approx(wanted, abs=3e-4)


def test_base_drift_grows_with_time(hidden):
    plain, drifting = hidden(), hidden(SimulatedBaseDrift(rate=(1e-3, 0.0, 0.0)).at("base"))
    moved = (centres(drifting) - centres(plain))[:, 0] @ plain.truth.robot.T_instr_base[:3, 0]
    hours = (plain.truth.schedule.start_s + 15.0) / 3600.0
    assert moved == pytest.approx(hours, abs=2e-3)


def test_temperature_stays_at_the_reference_unless_it_is_asked_to_drift(hidden):
    steady = hidden()
    assert np.abs(steady.tables["resolver"]["temperature_C"] - 21.0).max() < 0.1
    drifting = hidden(temperature_drift_C=5.0)
    log = moving(drifting, "temperature_C")[:, 10:].mean(axis=1)
    assert log == pytest.approx(drifting.truth.temperature_C, abs=0.03)
    assert np.ptp(log) > 0.5
    assert np.abs(log - 21.0).max() < 5.1
    assert drifting.tables["cmm"].equals(steady.tables["cmm"])


def test_growth_needs_a_drift_of_temperature(hidden):
    growth = SimulatedThermalGrowth(alpha=2e-5).at("arm")
    with pytest.raises(SettingsError, match="temperature_drift_C"):
        hidden(growth)
    cold, warm = hidden(temperature_drift_C=5.0), hidden(growth, temperature_drift_C=5.0)
    assert np.abs(centres(warm) - centres(cold)).max() > 1e-2
