"""What changed at a row is called by what it is: a target, the beam, the log; a base is a base."""

import re
from dataclasses import replace

import numpy as np
import pytest

import pa10cal
from made_up_sightings import sighted
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload, statics
from pa10cal.files.arms import load_arm
from spoiling import with_columns

POSES, EARLIER, FIRST, NOISE_MM = 130, 40, 70, 0.02
ARM = load_arm("ur10")


def other_arm():
    """Return an arm whose zeros and lengths are off by usual sizes."""
    rng = np.random.default_rng(3)
    off = {name: rng.normal(0.0, 6e-4, ARM.n) for name in ("theta_rad", "d_m", "a_m", "alpha_rad")}
    return replace(ARM, **{name: getattr(ARM, name) + by for name, by in off.items()})


#: How much longer all distances from the instrument are read [m].
RANGE_M = 4e-4
#: What encoders of few counts round to [deg].
COUNT_DEG = 0.02
#: Of joints 2 and 3 that yield, and a load that hangs at the flange.
STIFFNESS_NM_PER_RAD, LOAD_N = 5e4, 40.0
#: Where the arm stands, seen from the instrument [m].
NEAR_M, FAR_M = np.array([3.0, 0.5, 0.2]), np.array([300.0, 50.0, 20.0])


def seen(tmp_path, targets, change, place_m=NEAR_M, seed=4):
    """Return a campaign of an arm that errs, its readings changed from one row on."""
    again = 2 if change.endswith("repeats") else 1
    raw = sighted(
        tmp_path, "points", poses=POSES // again, repeats=again, targets=targets, seed=seed
    )
    after = np.arange(POSES) >= FIRST
    places_m = np.tile(raw.p_ee_m, (POSES, 1, 1))
    if change == "target":
        places_m[after, 0] += np.array([3e-4, -4e-4, 3e-4])
    if change == "nest":  # a small step, of a few times the noise
        places_m[after, 0] += np.array([2e-5, -3e-5, -1.2e-4])
    if change == "small":  # half of the squared error is noise
        places_m[after, 0] += np.array([4e-5, -5e-5, -5e-5])
    q_rad = raw.q.copy()
    if change == "zeros":  # joint 1 loses 0.5 mrad, joint 3 gains 0.8 mrad
        q_rad[EARLIER:, 0] -= 5e-4
        q_rad[after, 2] += 8e-4
    if change == "zero, repeats":
        q_rad[after, 2] += 3e-4
    if change in ("load", "small load, repeats", "springs"):
        load_N = {"load": LOAD_N, "springs": 0.0}.get(change, 0.1 * LOAD_N)
        hangs_N = np.where(after, load_N, 0.0)
        payload = Payload(0.0, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -9.80665]))
        chain = Chain.of(ARM)
        torque_Nm = statics(chain, chain.coordinates(q_rad), hangs_N, payload).joint_Nm
        q_rad[:, 1:3] -= torque_Nm[:, 1:3] / STIFFNESS_NM_PER_RAD
    if change == "settling":
        q_rad[:, 2] += 8e-4 * np.exp(-np.arange(POSES) / 12.0)
    T_real, T_nominal = (Chain.of(arm).forward(q_rad) for arm in (other_arm(), ARM))
    T = np.where(after[:, None, None], T_nominal, T_real) if change == "model" else T_real
    p_m = np.einsum("pij,pbj->pbi", T[:, :3, :3], places_m) + T[:, None, :3, 3]
    if change == "growth":  # of lengths, towards the end of a warm-up
        far = other_arm()
        part = 1.0 - np.exp(-np.arange(POSES) / 40.0)
        more = 5e-4 * part
        grown = [replace(far, d_m=far.d_m * (1.0 + by), a_m=far.a_m * (1.0 + by)) for by in more]
        T = np.concatenate(
            [Chain.of(arm).forward(q[None]) for arm, q in zip(grown, raw.q, strict=False)]
        )
        p_m = np.einsum("pij,pbj->pbi", T[:, :3, :3], places_m) + T[:, None, :3, 3]
    if change == "base":
        p_m[after] += np.array([3e-4, -4e-4, 3e-4])
    p_m = p_m @ raw.T_instr_base[:3, :3].T + raw.T_instr_base[:3, 3] + place_m
    if change == "beam":
        p_m[after] *= 1.0 + 6.35e-3 / np.linalg.norm(p_m[after], axis=2, keepdims=True)
    if change == "range":  # of all rows
        p_m *= 1.0 + RANGE_M / np.linalg.norm(p_m, axis=2, keepdims=True)
    p_m += 1e-3 * np.random.default_rng(5).normal(0.0, NOISE_MM, p_m.shape)
    first = raw.column("T1_x_mm")
    for k, line in enumerate(raw.poses[1:]):
        values = [f"{value:.5f}" for value in 1e3 * p_m[k].ravel()]
        fields = line.split(",")[:first]
        if change.startswith("rounded"):
            joints = slice(first - ARM.n, first)
            fields[joints] = [
                f"{COUNT_DEG * round(float(q) / COUNT_DEG):.5f}" for q in fields[joints]
            ]
        raw.poses[k + 1] = ",".join([*fields, *values])
    if change == "rounded, as stated":
        stated_deg = COUNT_DEG / np.sqrt(12.0)
        with_columns(raw.poses, {f"u_q{joint}_deg": stated_deg for joint in range(1, ARM.n + 1)})
    found = pa10cal.read_campaign(raw.write())
    return pa10cal.discover(found, pa10cal.calibrate(found))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("targets", "change", "says", "size_mm"),
    [
        (1, "target", r"target T1 moved on the flange by (\S+) mm", 0.583),
        (3, "target", r"target T1 moved on the flange by (\S+) mm", 0.583),
        (1, "nest", r"target T1 moved on the flange by (\S+) mm", 0.125),
        (1, "small", r"target T1 moved on the flange by (\S+) mm", 0.081),
        (1, "beam", r"readings are longer by (\S+) mm along the beam", 6.35),
        (3, "model", r"the log follows another model of the arm, (\S+) mm", None),
        (1, "load", r"carries (\S+) kg more than is stated", 4.08),
        (1, "zero, repeats", r"the zero of joint 3 moved by \+(\S+) mrad", 0.3),
        (1, "small load, repeats", r"carries (\S+) kg more than is stated", 0.408),
        (3, "base", r"the instrument or the base moved by (\S+) mm", 0.583),
    ],
)
def test_what_changed_at_a_row_is_called_by_what_it_is(tmp_path, targets, change, says, size_mm):
    found = seen(tmp_path, targets, change)
    (fault,) = found.faults
    assert found.verdict == "check_the_log"
    assert fault.kind == "step_in_time"
    size = re.search(says, fault.what)
    assert size is not None, fault.what
    if size_mm is not None:
        assert float(size[1]) == pytest.approx(
            size_mm, rel=0.2 if "load" in change else 0.05, abs=0.02
        )
    last, next_ = map(int, re.findall(r"P(\d+)", fault.where))
    assert last < (FIRST % (POSES // 2) if "repeats" in change else FIRST) <= next_
    # One row of the two is held out; of a small step several are as likely.
    assert next_ - last <= {"small": 4}.get(change, 8 if "repeats" in change else 2)
    assert not found.unexplained


@pytest.mark.slow
def test_zeros_of_joints_have_steps_of_their_own(tmp_path):
    found = seen(tmp_path, 3, "zeros")
    assert found.verdict == "check_the_log"
    expected = {1: (-0.5, EARLIER), 3: (0.8, FIRST)}
    for fault, (joint, (size_mrad, row)) in zip(found.faults, expected.items(), strict=True):
        told = re.match(rf"the zero of joint {joint} moved by (\S+) mrad", fault.what)
        assert told is not None, fault.what
        assert float(told[1]) == pytest.approx(size_mrad, abs=0.02)
        assert "the model is of the arm since then" in fault.remedy
        assert f"if joint {joint} is homed again" in fault.remedy
        last, next_ = map(int, re.findall(r"P(\d+)", fault.where))
        assert last < row <= next_
        # A turn of the base about the axis of joint 1 looks the same.
        assert ("motion of the instrument or the base" in fault.what) is (joint == 1)
    assert not found.unexplained


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("change", ["nothing", "growth", "settling", "springs"])
def test_no_step_is_told_where_none_was(tmp_path, change):
    found = seen(tmp_path, 3, change)
    assert found.faults == ()


@pytest.mark.slow
def test_joints_that_are_rounded_are_no_motion(tmp_path):
    # An error of a joint moves all targets together: it is one error of a pose, not nine.
    found = seen(tmp_path, 3, "rounded", seed=9)
    assert found.faults == ()
    assert not any("wandered" in place.why for place in found.unexplained)


@pytest.mark.slow
def test_joints_that_are_as_uncertain_as_is_stated_leave_nothing(tmp_path):
    found = seen(tmp_path, 3, "rounded, as stated", seed=9)
    assert found.verdict == "none"
    assert found.unexplained == ()


@pytest.mark.slow
def test_what_cannot_be_told_apart_stands_beside_each_other(tmp_path):
    # A beam that has one direction only: a base that moves along it looks like a reflector.
    found = seen(tmp_path, 1, "beam", FAR_M)
    (fault,) = found.faults
    assert "along the beam" in fault.what or "another size of the reflector" in fault.what
    assert "motion of the instrument or the base" in fault.what or "base moved" in fault.what
    assert fault.at_s is None


@pytest.mark.slow
def test_a_length_that_all_distances_are_too_long_by_is_a_range_constant(tmp_path):
    found = seen(tmp_path, 3, "range")
    (finding,) = found.effects
    assert (found.faults, finding.id, finding.of) == ((), "range_constant", "instrument")
    std_m = float(np.sqrt(finding.covariance[0, 0]))
    assert abs(finding.x[0] - RANGE_M) < 4.0 * std_m < RANGE_M
