"""Arm descriptions: what files may say, what is found in them, and what is refused."""

from dataclasses import fields, replace

import numpy as np
import pytest
import yaml
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from pa10cal.arm.chain import Chain
from pa10cal.arm.description import with_hayati_rows
from pa10cal.errors import ArmError, SettingsError
from pa10cal.files import own_description
from pa10cal.files.arms import (
    arm_names,
    arm_text,
    copy_description,
    load_arm,
    parse_arm,
    read_arm,
    urdf_of_arm,
)
from pa10cal.planning.campaign import arm_files

SCARA = """
name: small
rows:
  - {a_m: 0.3, limits_deg: [-130, 130]}
  - {a_m: 0.25, alpha_deg: 180}
  - {prismatic: true, d_m: 0.1, limits_m: [0, 0.2]}
  - {gear_ratio: 80}
"""


def parsed(text):
    return parse_arm(yaml.safe_load(text), where="small.yaml")


def test_what_has_a_sensible_default_may_be_left_out():
    arm = parsed(SCARA)
    assert (arm.title, arm.convention) == ("small", "standard")
    assert arm.prismatic.tolist() == [False, False, True, False]
    assert np.degrees(arm.limits_rad[[0, 1, 3]]).tolist() == [[-130, 130], [-360, 360], [-360, 360]]
    assert arm.limits_rad[2].tolist() == [0.0, 0.2]
    assert arm.hayati.tolist() == [True, True, True, False]
    assert arm.gear_ratio.tolist() == pytest.approx([np.nan, np.nan, np.nan, 80], nan_ok=True)
    assert np.isnan(arm.torque_limit_Nm).all()
    assert arm.mass_kg is None
    assert arm.com_m is None


def test_base_and_tool_stand_where_the_file_says():
    arm = parsed(
        SCARA + "base: {xyz_m: [0, 0, 0.5], rpy_deg: [0, 0, 90]}\n"
        "tool: {xyz_m: [0.1, 0, 0], rpy_deg: [90, 0, 90]}\n"
    )
    bare = Chain.of(parsed(SCARA)).forward(np.zeros((1, 4)))[0]
    base, tool = np.eye(4), np.eye(4)
    base[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    base[2, 3] = 0.5
    tool[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]  # about x, then about z of the row
    tool[0, 3] = 0.1
    found = Chain.of(arm).forward(np.zeros((1, 4)))[0]
    np.testing.assert_allclose(found, base @ bare @ tool, atol=1e-15)


def test_the_paper_s_arm_has_the_rows_of_its_table():
    arm = load_arm("pa10_6ce")
    assert np.degrees(arm.theta_rad).tolist() == pytest.approx([0, -90, 90, 0, 0, 0])
    assert arm.d_m.tolist() == [0.317, 0, 0, 0.48, 0, 0.07]
    assert arm.a_m.tolist() == [0, 0.45, 0, 0, 0, 0]
    assert np.degrees(arm.alpha_rad).tolist() == pytest.approx([-90, 0, 90, -90, 90, 0])
    assert arm.hayati.tolist() == [False, True, False, False, False, False]
    assert arm.mass_kg.sum() == pytest.approx(32.78)
    assert arm.reach_m == pytest.approx(1.317)


def modified_ur10():
    """The UR10 as its public data set has it: modified rows, alpha [deg], a [mm], d [mm]."""
    rows = [
        (0, 0, 127.3),
        (90, 0, 0),
        (0, -612, 0),
        (0, -572.3, 163.941),
        (90, 0, 115.7),
        (-90, 0, 92.2),
    ]
    content = {
        "name": "ur10",
        "convention": "modified",
        "rows": [{"alpha_deg": al, "a_m": a / 1e3, "d_m": d / 1e3} for al, a, d in rows],
    }
    return parse_arm(content, where="ur10.yaml")


def test_the_ur10_is_that_of_its_public_data_set():
    q = np.random.default_rng(1).uniform(-3, 3, (50, 6))
    found, wanted = (Chain.of(arm).forward(q) for arm in (load_arm("ur10"), modified_ur10()))
    np.testing.assert_allclose(found, wanted, atol=1e-14)
    assert modified_ur10().hayati.tolist() == [False, False, True, True, False, False]


@pytest.mark.parametrize(
    ("name", "p_base_ee_m", "approach"),
    [
        ("irb120", [0.374, 0, 0.630], [1, 0, 0]),  # calibration position in the specification
        ("iiwa14", [0, 0, 1.306], [0, 0, 1]),
        ("gx4_351s", [0.350, 0, 0], [0, 0, 1]),
        ("ur10", [-1.1843, -0.256141, 0.0116], [0, -1, 0]),
    ],
)
def test_shipped_arms_stand_at_zero_as_their_makers_say(name, p_base_ee_m, approach):
    arm = load_arm(name)
    T = Chain.of(arm).forward(np.zeros((1, arm.n)))[0]
    np.testing.assert_allclose(T[:3, 3], p_base_ee_m, atol=1e-12)
    np.testing.assert_allclose(T[:3, 2], approach, atol=1e-12)


def test_an_arm_whose_axes_and_end_meet_needs_a_place_of_its_plate():
    turned = {"name": "table", "rows": [{"alpha_deg": 90}, {}]}
    with pytest.raises(ArmError, match=r"no length.*state where its flange is, roughly"):
        parse_arm(turned, where="table.yaml")
    stated = parse_arm(turned | {"tool": {"xyz_m": [0.6, 0, 0]}}, where="table.yaml")
    assert stated.reach_m == pytest.approx(0.6)


def test_the_seven_joint_arm_has_the_weight_of_its_specification():
    # 29.9 kg with the base, which does not move
    assert 25.0 < load_arm("iiwa14").mass_kg.sum() < 29.9


def anywhere(rng):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", rng.choice([0.1, np.pi / 2, -2.0], 3)).as_matrix()
    T[:3, 3] = rng.uniform(-0.5, 0.5, 3)
    return T


@examples(40)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 8))
def test_a_written_arm_is_read_back_to_the_last_digit(tmp_path_factory, seed, n):
    rng = np.random.default_rng(seed)
    slides = rng.random(n) < 0.3
    masses = rng.uniform(0, 20, n) if seed % 2 else None
    theta_rad = rng.uniform(-3, 3, n)
    # Degrees that look like a quarter turn in radians are refused on purpose.
    quarters = np.degrees(theta_rad) / (np.pi / 2.0)
    assume(not np.any((np.abs(quarters) < 5) & (np.abs(quarters - quarters.round()) < 5e-3)))
    arm = with_hayati_rows(
        replace(
            load_arm("pa10_6ce"),
            name="made_up",
            title="Made up: é, # and all",
            convention=("standard", "modified")[seed % 2],
            theta_rad=theta_rad,
            d_m=rng.uniform(-0.6, 0.6, n),
            a_m=rng.choice([0.0, 1e-5, 0.3, 1 / 3], n),
            alpha_rad=rng.choice([0.0, np.pi / 2, 1e-7, 0.3], n),
            beta_rad=rng.choice([0.0, 1e-6], n),
            hayati=np.zeros(n, bool),
            prismatic=slides,
            limits_rad=np.sort(rng.uniform(-4, 4, (n, 2)), axis=1) + np.array([-2.5, 2.5]),
            gear_ratio=np.where(slides | (rng.random(n) < 0.3), np.nan, 101.0),
            torque_limit_Nm=rng.choice([np.nan, 14.5], n),
            mass_kg=masses,
            com_m=None if masses is None else rng.uniform(-0.2, 0.2, (n, 3)),
            T_base_row1=anywhere(rng) if seed % 3 else np.eye(4),
            T_row_n_ee=anywhere(rng),
        )
    )
    path = tmp_path_factory.mktemp("arm") / "made_up.yaml"
    path.write_text(arm_text(arm, ["a comment: {"]), encoding="utf-8")
    back = read_arm(path)
    for field in fields(arm):
        given, found = getattr(arm, field.name), getattr(back, field.name)
        if isinstance(given, np.ndarray):
            np.testing.assert_allclose(found, given, rtol=0, atol=2e-15, err_msg=field.name)
        else:
            assert found == given, field.name


@pytest.mark.parametrize("name", arm_names())
def test_a_shipped_arm_survives_writing(name):
    arm = load_arm(name)
    back = parse_arm(yaml.safe_load(arm_text(arm)), where="x")
    for field in fields(arm):
        np.testing.assert_array_equal(getattr(back, field.name), getattr(arm, field.name))


def test_the_campaign_s_own_arm_comes_first(tmp_path):
    (tmp_path / "ur10.yaml").write_text(SCARA.replace("small", "ur10"), encoding="utf-8")
    (tmp_path / "small.yaml").write_text("\ufeff" + SCARA, encoding="utf-8")
    assert load_arm("ur10", tmp_path).n == 4
    assert load_arm("small", tmp_path).n == 4
    assert load_arm("irb120", tmp_path).n == 6
    assert load_arm("ur10").n == 6


def test_an_arm_is_kept_once_for_all_campaigns(tmp_path):
    for name in ("arms", "one", "elsewhere/two", "links"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "arms/small.yaml").write_text(SCARA, encoding="utf-8")
    (tmp_path / "elsewhere/small.yaml").write_text(SCARA, encoding="utf-8")
    (tmp_path / "links/one").symlink_to(tmp_path / "one", target_is_directory=True)
    for folder in (tmp_path / "one", tmp_path / "links/one"):
        assert load_arm("small", folder).n == 4
        (tmp_path / "one/campaign.yaml").write_text("robot: small", encoding="utf-8")
        (found,) = arm_files(folder)
        assert found.resolve() == tmp_path / "arms/small.yaml"
    two = tmp_path / "elsewhere/two"
    with pytest.raises(ArmError, match=r"unknown robot.*small\.yaml in .*two or .*elsewhere/arms"):
        load_arm("small", two)
    assert load_arm("small", two, tmp_path / "arms").n == 4
    assert own_description("small", two, two.parent) == two.parent / "small.yaml"
    copy_description("small", tmp_path / "one", two)
    assert load_arm("small", two).n == 4


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    "file", ["a.urdf", "./a.urdf", "b/a.urdf", "../one/a.urdf", "../one/b/a.urdf"]
)
@pytest.mark.parametrize("place", ["one", "arms"])
def test_a_urdf_that_lies_in_a_folder_of_its_own_is_copied_too(tmp_path, place, file):
    for folder in ("arms/b", "one/b", "two"):
        (tmp_path / folder).mkdir(parents=True)
    described = tmp_path / place
    (described / file).write_text("<robot/>")
    text = SCARA + f"urdf: {{file: {file}, base: a, tip: b}}\n"
    (described / "small.yaml").write_text(text, encoding="utf-8")
    one, two = tmp_path / "one", tmp_path / "two"
    copy_description("small", one, two)
    assert urdf_of_arm("small", one) == replace(
        urdf_of_arm("small", two), where=str(described / file)
    )
    for field in fields(load_arm("small", one)):
        was, now = (getattr(load_arm("small", folder), field.name) for folder in (one, two))
        np.testing.assert_array_equal(was, now)


@pytest.mark.parametrize("name", ["../small", "", ".small", "-small", "a b", "a" * 5000])
def test_a_name_that_leads_elsewhere_is_refused(tmp_path, name):
    folder = tmp_path / "campaign"
    folder.mkdir()
    (tmp_path / "small.yaml").write_text(SCARA, encoding="utf-8")
    with pytest.raises(ArmError, match=r"no name of a robot.*letters, digits") as found:
        load_arm(name, folder)
    assert len(str(found.value)) < 3000


def test_an_arm_that_is_nowhere_is_refused(tmp_path):
    with pytest.raises(ArmError, match=r"unknown robot.*'ur5'.*iiwa14.*or ur5\.yaml in "):
        load_arm("ur5", tmp_path)
    with pytest.raises(ArmError, match=r"unknown robot.*'ur5'.*irb120"):
        load_arm("ur5")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rows: [", r"small\.yaml: the arm description cannot be read.*line 2, column 1"),
        (SCARA.replace("small", "large"), r"not named after its file.*'large'.*small"),
        ("- 1", r"small\.yaml: .*whole.*does not fit"),
    ],
)
def test_files_that_are_no_descriptions_are_refused(tmp_path, text, message):
    (tmp_path / "small.yaml").write_text(text, encoding="utf-8")
    with pytest.raises((ArmError, SettingsError), match=message):
        load_arm("small", tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("a_m: 0.3", "a_mm: 300", r"row 1: unknown key a_mm.*did you mean 'a_m'"),
        ("a_m: 0.3", "a_m: 0,3", r"row 1: a row is made of keys.*decimal points"),
        ("a_m: 0.3", "a_m: '0,3'", r"row 1: key a_m does not fit.*'0,3'.*valid number"),
        ("a_m: 0.3", "a_m: .nan", r"row 1: key a_m does not fit.*finite"),
        ("a_m: 0.25", "a_m: 250", r"row 2: a_m is out of proportion.*250.*divide by 1000"),
        ("a_m: 0.25", "a_m: 8", r"row 2: a_m is out of proportion.*8.*median is 0\.2"),
        ("alpha_deg: 180", "alpha_deg: 3.1416", r"row 2: alpha_deg looks like radians.*write 180"),
        ("alpha_deg: 180", "theta_deg: -1.57", r"row 2: theta_deg looks like radians.*write -90"),
        ("[-130, 130]", "[-2.27, 2.27]", r"row 1: limits_deg looks like radians.*-2\.27"),
        (
            "[-130, 130]",
            "[130, -130]",
            r"row 1: limits_deg allows the joint no motion.*130\.0, -130",
        ),
        ("[-130, 130]", "[-130]", r"row 1: key limits_deg does not fit.*allowed: 2 values"),
        (
            "limits_m: [0, 0.2]",
            "limits_m: [0, 200]",
            r"row 3: limits_m exceeds 30 m.*divide by 1000",
        ),
        (", limits_m: [0, 0.2]", "", r"row 3: a prismatic joint needs limits"),
        ("limits_m", "limits_deg", r"row 3: limits_deg is for a joint that turns.*limits_m"),
        ("limits_deg", "limits_m", r"row 1: limits_m is for a joint that slides.*prismatic: true"),
        ("d_m: 0.1", "gear_ratio: 50", r"row 3: gear_ratio is for a joint that turns"),
        ("d_m: 0.1", "hayati: false", r"row 3: hayati: false.*joints 3 and 4 are 0 deg.*leave"),
        ("gear_ratio: 80", "hayati: true", r"row 4: hayati: true.*no two joint axes meet"),
        ("alpha_deg: 180", "alpha_deg: 60, hayati: true", r"row 2: hayati.*2 and 3 are 60 deg"),
        ("gear_ratio: 80", "gear_ratio: 0", r"row 4: key gear_ratio does not fit.*greater than 0"),
        ("gear_ratio: 80", "mass_kg: 2", r"row 1: mass_kg and com_m is missing"),
        ("gear_ratio: 80", "com_m: [0, 0, 0]", r"row 4: mass_kg is missing"),
        ("gear_ratio: 80", "mass_kg: -1", r"row 4: key mass_kg does not fit"),
        ("gear_ratio: 80", "mass_kg: 12000", r"row 4: mass_kg exceeds 2000 kg.*12000"),
        ("{gear_ratio: 80}", "7", r"row 4: a row is made of keys and values.*7"),
        ("name: small", "name: small\nconvention: craig", r"key convention does not fit.*modified"),
        ("name: small", "", r"missing key name"),
        (
            "name: small",
            "name: small\nbase: {xyz_m: [0, 0, 500]}",
            r"base: xyz_m exceeds 30 m.*1000",
        ),
        ("name: small", "name: small\ntool: {z: 1}", r"unknown key tool\.z.*xyz_m"),
        ("name: small", "name: small\nlimits_deg: [1]", r"unknown key limits_deg.*rows"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_row_and_key(old, new, message):
    text = SCARA.replace(old, new, 1)
    assert text != SCARA
    with pytest.raises((ArmError, SettingsError), match=rf"small(\.yaml)?: {message}"):
        parsed(text)


#: A factory table of a UR5: joints 2 to 4 are nearly parallel, and lengths along them cancel.
FACTORY = """
name: small
rows:
  - {theta_deg: -0.000551, d_m: 0.08887, a_m: 0.00027, alpha_deg: 89.973773}
  - {theta_deg: -82.338068, d_m: 574.24138, a_m: -0.05668, alpha_deg: -0.042048}
  - {theta_deg: 116.048659, d_m: -507.36340, a_m: -0.32646, alpha_deg: 0.186559}
  - {theta_deg: -33.704510, d_m: -66.76768, a_m: 0.00001, alpha_deg: 89.977295}
  - {theta_deg: 0.002370, d_m: 0.09497, a_m: 0.00000, alpha_deg: -90.012242}
  - {theta_deg: 0.000468, d_m: 0.08256}
"""


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_a_table_whose_lengths_cancel_is_laid_anew_through_the_same_axes(convention):
    content = yaml.safe_load(FACTORY)
    rows = content["rows"]
    if convention == "modified":  # the same axes: a and alpha stand a row later
        for key in ("a_m", "alpha_deg"):
            moved = [row.pop(key, 0.0) for row in rows]
            for row, value in zip(rows, [0.0, *moved[:-1]], strict=True):
                row[key] = value
    arm = parse_arm({**content, "convention": convention}, where="small.yaml")
    assert "laid anew" in arm.remarks[0]
    assert max(np.abs(arm.d_m).max(), np.abs(arm.a_m).max()) < 0.5
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (20, 6))
    end, expected = Chain.of(arm).forward(q), []
    for of_pose in q:
        T = np.eye(4)
        for row, turn in zip(rows, of_pose, strict=True):
            about_z, about_x = np.eye(4), np.eye(4)
            theta = np.radians(row["theta_deg"]) + turn
            about_z[:3, :3] = Rotation.from_euler("z", theta).as_matrix()
            about_z[2, 3] = row["d_m"]
            about_x[:3, :3] = Rotation.from_euler(
                "x", row.get("alpha_deg", 0.0), degrees=True
            ).as_matrix()
            about_x[0, 3] = row.get("a_m", 0.0)
            T = T @ (about_x @ about_z if convention == "modified" else about_z @ about_x)
        expected.append(T)
    np.testing.assert_allclose(end, expected, atol=1e-9)
    for row in rows:
        row |= {"mass_kg": 1.0, "com_m": [0.0, 0.0, 0.1]}
    with pytest.raises(ArmError, match="row 1: a centre of mass stands in a frame"):
        parse_arm({**content, "convention": convention}, where="small.yaml")
    again = parsed(arm_text(arm))
    assert not again.remarks
    np.testing.assert_allclose(Chain.of(again).forward(q), end, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("d_m: -507.36340", "d_m: -500.0", "row 2: d_m is out of proportion"),  # no sum
        ("alpha_deg: -0.042048", "alpha_deg: 90", "row 2: d_m is out of proportion"),
        ("alpha_deg: 89.977295", "alpha_deg: 1.5708", "row 4: alpha_deg looks like radians"),
        ("d_m: 0.08887", "d_m: 1.0e+300", "row 1: d_m is out of proportion"),
    ],
)
def test_long_lengths_that_do_not_cancel_are_refused(old, new, message):
    assert old in FACTORY
    with pytest.raises(ArmError, match=message):
        parsed(FACTORY.replace(old, new))


def test_an_arm_in_millimetres_is_refused():
    text = SCARA.replace("0.3", "300").replace("0.25", "250").replace("d_m: 0.1", "d_m: 100")
    with pytest.raises(ArmError, match=r"small.yaml: row 1: a_m exceeds 100 m .got 300.*by 1000"):
        parsed(text)


CRANE = """
name: small
base: {xyz_m: [0, 0, 25]}
rows:
  - {prismatic: true, alpha_deg: 90, limits_m: [0, 80], mass_kg: 40000, com_m: [0, 12, 0]}
  - {d_m: 12.0, a_m: 15.0, alpha_deg: 90, mass_kg: 15000, com_m: [-7, 0, 0]}
  - {a_m: 14.0, mass_kg: 8000, com_m: [-7, 0, 0]}
"""


def test_a_crane_on_a_long_rail_is_described_in_metres_and_kilograms():
    arm = parsed(CRANE)
    assert arm.reach_m > 120.0
    assert arm.mass_kg.sum() == 63000.0


def test_an_arm_without_rows_is_refused():
    with pytest.raises(SettingsError, match=r"key rows does not fit"):
        parsed("{name: small, rows: []}")


@pytest.mark.parametrize(("name", "meant"), [("UR-10", "'ur10'"), ("kr10", None), ("ur11", None)])
def test_a_robot_of_other_digits_or_letters_is_another_robot(name, meant):
    with pytest.raises(ArmError) as refused:
        load_arm(name)
    remedy = refused.value.remedy
    assert (f"did you mean {meant}" in remedy) if meant else ("did you mean" not in remedy)
    assert f"{name}.yaml" in remedy
