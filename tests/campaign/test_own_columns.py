"""Files as instruments and controllers write them, read by `columns` of campaign.yaml."""

from __future__ import annotations

import io
import re

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

from made_up_sightings import sighted
from pa10cal.campaign.own_columns import RotationColumns
from pa10cal.campaign.raw_file import quaternion_uncertainty, quaternions
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import Pa10calError

Q = [f"q{j}_deg" for j in range(1, 7)]
OWN = [f"axis {j}" for j in range(1, 7)]
PLACE, QUATERNION = ["x_mm", "y_mm", "z_mm"], ["qw", "qx", "qy", "qz"]
JOINTS = {"names": OWN, "unit": "deg"}
POSITION = {"names": ["X", "Y", "Z"], "unit": "mm"}
WXYZ = {"names": QUATERNION, "convention": "quaternion_wxyz"}
KIND = {"names": "kind"}
COLUMNS = {"joints": JOINTS, "position": POSITION, "rotation": WXYZ, "kind": KIND}


@pytest.fixture
def tracked(tmp_path):
    """A campaign under the contract's names, its table, and what is read from it."""
    raw = sighted(tmp_path, "pose")
    folder = raw.write()
    return raw, pd.read_csv(io.StringIO("\n".join(raw.poses))), read_campaign(folder)


def written(raw, table, columns, **how):
    """Write the table under other names, with what says how to read it; return the folder."""
    how = {"index": False} | how
    table.to_csv(raw.folder / "export.txt", **how)
    content = raw.description | {"files": {"poses": "export.txt"}, "columns": {"poses": columns}}
    (raw.folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    return raw.folder


def own_table(table):
    """Return the table under names of one's own, without what a tracker does not write."""
    names = dict(zip([*Q, *PLACE], [*OWN, "X", "Y", "Z"], strict=True))
    return table.drop(columns=[*QUATERNION, "time_s", "load_N", "repeat"]).rename(columns=names)


def numbers_of(table, convention, degrees):
    """Return the orientations as a convention has them."""
    R = Rotation.from_quat(table[QUATERNION], scalar_first=True)
    kind, _, axes = convention.partition("_")
    return {
        "quaternion": lambda: R.as_quat(scalar_first=axes == "wxyz"),
        "euler": lambda: R.as_euler(axes, degrees=degrees),
        "fixed": lambda: R.as_euler(axes, degrees=degrees),
        "rpy": lambda: R.as_euler("xyz", degrees=degrees),
        "rotation": lambda: R.as_rotvec(degrees=degrees),
        "matrix": lambda: R.as_matrix().reshape(-1, 9),
    }[kind]()


def assert_same(found, expected):
    """Hold what was read of a mapped file against what was read of the contract's."""
    ours, theirs = found.observations, expected.observations
    assert found.quarantined == ()
    np.testing.assert_allclose(ours.states.q_rad, theirs.states.q_rad, atol=1e-9)
    T, T_expected = ours.measured.T_instr_target, theirs.measured.T_instr_target
    np.testing.assert_allclose(T[:, :3, 3], T_expected[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(T[:, :3, :3], T_expected[:, :3, :3], atol=1e-6)
    assert list(ours.kind) == list(theirs.kind)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("convention", "unit"),
    [
        *((f"quaternion_{order}", "deg") for order in ("wxyz", "xyzw")),
        *((word, "deg") for word in ("rpy", "euler_XYZ", "euler_ZYX", "fixed_zyx", "matrix")),
        *((word, "rad") for word in ("euler_ZYZ", "rotation_vector")),
    ],
)
def test_attitudes_of_every_convention_are_those_of_the_quaternion(tracked, convention, unit):
    raw, table, expected = tracked
    values = numbers_of(table, convention, unit == "deg")
    names = [f"r{k}" for k in range(values.shape[1])]
    own = own_table(table).join(pd.DataFrame(values, columns=names))
    rotation = {"names": names, "convention": convention, "unit": unit}
    assert_same(read_campaign(written(raw, own, COLUMNS | {"rotation": rotation})), expected)


def test_units_separator_and_decimal_sign_are_stated(tracked):
    raw, table, expected = tracked
    own = own_table(table).join(table[QUATERNION])
    own[OWN] = np.radians(own[OWN])
    own[["X", "Y", "Z"]] *= 1e-3
    own["kind"] = own["kind"].map({"grid": "train", "holdout": "test"})
    own["room"] = 294.65
    columns = {
        "separator": ";",
        "decimal": ",",
        "joints": {"names": OWN, "unit": "rad"},
        "position": {"names": ["X", "Y", "Z"], "unit": "m"},
        "rotation": WXYZ,
        "temperature": {"names": "room", "unit": "K"},
        "kind": {"names": "kind", "words": {"train": "grid", "test": "holdout"}},
    }
    found = read_campaign(written(raw, own, columns, sep=";", decimal=","))
    assert_same(found, expected)
    np.testing.assert_allclose(found.observations.states.temperature_C, 21.5)
    assert not any("not used" in note for note in found.notes)


def test_millimetres_stated_as_metres_are_refused_by_a_row_and_the_numbers_of_rows(tracked):
    raw, table, _ = tracked
    own = own_table(table).join(table[QUATERNION])
    own["X"] += 3000.0
    own.loc[2:8, ["X", "Y", "Z"]] = np.nan
    own.loc[0, "Y"] = 1e8
    columns = COLUMNS | {"position": {"names": ["X", "Y", "Z"], "unit": "m"}}
    said = "export.txt:3: .*33 of 33 rows are out of bounds in m, and 1 so in mm: X = "
    with pytest.raises(Pa10calError, match=said):
        read_campaign(written(raw, own, columns))


@pytest.mark.parametrize("blank", [0, 7])
def test_degrees_celsius_stated_as_kelvin_are_refused_with_the_remedy(tracked, blank):
    raw, table, _ = tracked
    own = own_table(table).join(table[QUATERNION])
    own["room"] = 21.5
    own.loc[: blank - 1, "room"] = np.nan
    columns = COLUMNS | {"temperature": {"names": "room", "unit": "K"}}
    with pytest.raises(Pa10calError, match=r"temperatures look like degrees Celsius.*unit: C"):
        read_campaign(written(raw, own, columns))


def test_a_comma_within_a_name_parts_no_columns(tracked):
    raw, table, expected = tracked
    named = {"X": "measured, x", "axis 2": "axis, 2"}
    joints = JOINTS | {"names": [named.get(name, name) for name in OWN]}
    position = POSITION | {"names": ["measured, x", "Y", "Z"]}
    columns = COLUMNS | {"separator": ";", "joints": joints, "position": position}
    own = own_table(table).assign(**table[QUATERNION]).rename(columns=named)
    assert_same(read_campaign(written(raw, own, columns, sep=";")), expected)


def test_a_preamble_a_file_without_header_and_blanks_between_fields(tracked):
    raw, table, expected = tracked
    own = own_table(table).drop(columns="pose").join(table[QUATERNION])
    folder = written(raw, own, COLUMNS | {"header": 4})
    path = folder / "export.txt"
    path.write_text("Tracker 3\nOperator, me\n\n" + path.read_text())
    assert_same(read_campaign(folder), expected)

    place = {name: k for k, name in enumerate(own.columns, start=1)}
    columns = {
        "header": 0,
        "separator": "blanks",
        "joints": {"names": [place[name] for name in OWN]},
        "position": {"names": [place[name] for name in "XYZ"]},
        "rotation": WXYZ | {"names": [place[name] for name in QUATERNION]},
        "kind": {"names": place["kind"]},
    }
    found = read_campaign(written(raw, own, columns, sep=" ", header=False))
    assert_same(found, expected)
    assert found.observations.pose[0] == "P00001"


@pytest.mark.parametrize(
    ("form", "written_as", "columns"),
    [
        ("iso", "%Y-%m-%dT%H:%M:%S.%f", "clock"),
        ("%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S", "clock"),
        ("%d.%m.%Y %H:%M:%S", "%d.%m.%Y|%H:%M:%S", ["date", "clock"]),
    ],
)
def test_times_of_day_become_seconds_from_the_first(tracked, form, written_as, columns):
    raw, table, _ = tracked
    own = own_table(table).join(table[QUATERNION])
    seconds = np.arange(len(own))[::-1] * 60.0
    moments = pd.Timestamp("2026-03-01 08:00") + pd.to_timedelta(seconds, unit="s")
    text = moments.strftime(written_as).str.split("|", expand=True)
    own[columns] = np.stack(text.to_numpy()) if len(columns) == 2 else moments.strftime(written_as)
    found = read_campaign(written(raw, own, COLUMNS | {"time": {"names": columns, "format": form}}))
    np.testing.assert_allclose(found.observations.states.time_s, np.sort(seconds))
    assert f"out of order: {len(own) - 1}" in found.notes[0]


def test_times_of_day_go_on_after_midnight(tracked):
    raw, table, _ = tracked
    own = own_table(table).join(table[QUATERNION])
    seconds = np.arange(len(own)) * 60.0
    moments = pd.Timestamp("2026-03-01 23:50") + pd.to_timedelta(seconds, unit="s")
    own["clock"] = moments.strftime("%H:%M:%S")
    time = {"names": "clock", "format": "%H:%M:%S"}
    found = read_campaign(written(raw, own, COLUMNS | {"time": time}))
    np.testing.assert_allclose(found.observations.states.time_s, seconds)
    np.testing.assert_allclose(found.observations.states.q_rad, raw.q, atol=1e-9)


def test_milliseconds_are_seconds_and_equal_joints_are_repeats(tmp_path):
    raw = sighted(tmp_path, "pose", repeats=2, poses=20)
    table = pd.read_csv(io.StringIO("\n".join(raw.poses)))
    expected = read_campaign(raw.write())
    own = own_table(table).drop(columns="pose").join(table[QUATERNION])
    own["ms"] = 1e3 * table["time_s"]
    columns = COLUMNS | {"time": {"names": "ms", "unit": "ms"}}
    found = read_campaign(written(raw, own, columns)).observations
    np.testing.assert_allclose(found.states.time_s, expected.observations.states.time_s)
    assert sorted(found.repeat) == [1] * 20 + [2] * 20
    assert len(set(found.pose)) == 20


def test_targets_have_columns_of_their_own_and_may_be_unseen(tmp_path):
    raw = sighted(tmp_path, "points")
    table = pd.read_csv(io.StringIO("\n".join(raw.poses)))
    expected = read_campaign(raw.write())
    names = {f"T{b}_{axis}_mm": f"SMR {b} {axis}" for b in (1, 2, 3) for axis in "xyz"}
    own = table.rename(columns=names | dict(zip(Q, OWN, strict=True)))
    columns = {
        "time": {"names": "time_s"},
        "pose": "pose",
        "kind": KIND,
        "joints": JOINTS,
        "targets": {f"T{b}": {"names": [f"SMR {b} {axis}" for axis in "xyz"]} for b in (1, 2, 3)},
    }
    found = read_campaign(written(raw, own, columns))
    np.testing.assert_allclose(
        found.observations.measured.p_instr_m, expected.observations.measured.p_instr_m
    )
    assert found.quarantined == ()


def test_uncertainties_have_the_unit_of_what_they_are_of(tracked):
    raw, table, _ = tracked
    own = own_table(table)
    own[["A", "B", "C"]] = numbers_of(table, "euler_ZYX", True)
    own[["sX", "sY", "sZ"]] = [2e-5, 3e-5, 0.0]
    own[["X", "Y", "Z"]] *= 1e-3
    own[["sA", "sB", "sC"]] = 0.01
    columns = {
        "joints": JOINTS,
        "position": {"names": ["X", "Y", "Z"], "unit": "m", "u": ["sX", "sY", "sZ"]},
        "rotation": {
            "names": ["A", "B", "C"],
            "convention": "euler_ZYX",
            "u": ["sA", "sB", "sC"],
        },
        "kind": KIND,
    }
    cov = read_campaign(written(raw, own, columns)).observations.measured.cov
    stated = 1e-3 * raw.description["instrument"]["uncertainty_mm"]
    np.testing.assert_allclose(cov[:, 0, 0], 2e-5**2)
    np.testing.assert_allclose(cov[:, 2, 2], stated**2)  # 0 states nothing
    assert (np.diagonal(cov[:, 3:, 3:], axis1=1, axis2=2) < 9 * np.radians(0.01) ** 2).all()


@pytest.mark.parametrize("convention", ["euler_ZYX", "rotation_vector", "matrix"])
def test_uncertainty_of_an_attitude_is_what_drawn_numbers_scatter_by(convention):
    rng = np.random.default_rng(4)
    R = Rotation.random(random_state=rng)
    values = {
        "euler_ZYX": lambda: R.as_euler("ZYX"),
        "rotation_vector": lambda: R.as_rotvec(),
        "matrix": lambda: R.as_matrix().ravel(),
    }[convention]()
    u = 1e-4 * (1 + np.arange(len(values)))
    names = [str(k) for k in range(len(values))]
    columns = RotationColumns(names=names, convention=convention, unit="rad", u=names)
    stated = quaternion_uncertainty(values[None], u[None], columns)[0]
    drawn = quaternions(rng.normal(values, u, (40_000, len(values))), columns)
    np.testing.assert_allclose(drawn.std(axis=0), stated, rtol=0.03)


def test_an_inverse_rotation_is_turned_back(tracked):
    raw, table, expected = tracked
    own = own_table(table)
    inverse = Rotation.from_quat(table[QUATERNION], scalar_first=True).inv()
    for names, values, convention in (
        (["a", "b", "c"], inverse.as_rotvec(), "rotation_vector"),
        (["a", "b", "c", "d"], inverse.as_quat(), "quaternion_xyzw"),
    ):
        rotation = {"names": names, "convention": convention, "unit": "rad", "inverse": True}
        mapped = own.join(pd.DataFrame(values, columns=names))
        assert_same(read_campaign(written(raw, mapped, COLUMNS | {"rotation": rotation})), expected)


def as_inverse_poses(own, table):
    """Return a table with the instrument in the target's frame, as a camera sees a board."""
    inverse = Rotation.from_quat(table[QUATERNION], scalar_first=True).inv()
    place = pd.DataFrame(-inverse.apply(table[PLACE]), columns=["X", "Y", "Z"])
    rotation = pd.DataFrame(inverse.as_quat(scalar_first=True), columns=QUATERNION)
    return own.drop(columns=["X", "Y", "Z"]).join(place).join(rotation)


def test_an_inverse_pose_is_turned_back_with_its_position(tracked):
    raw, table, expected = tracked
    mapped = as_inverse_poses(own_table(table), table)
    mapped["u"] = 0.02
    position = POSITION | {"u": ["u", "u", "u"]}
    columns = COLUMNS | {"rotation": WXYZ | {"inverse": "pose"}, "position": position}
    found = read_campaign(written(raw, mapped, columns))
    measured, wanted = found.observations.measured, expected.observations.measured
    np.testing.assert_allclose(measured.places_m, wanted.places_m, atol=1e-7)
    np.testing.assert_allclose(measured.attitudes, wanted.attitudes, atol=1e-7)
    to_axes = measured.along_noise_axes()  # those of the camera, in which u is stated
    along = (to_axes @ measured.stated_covariance @ to_axes.swapaxes(1, 2))[:, :3, :3]
    wanted_m2 = np.tile(4e-10 * np.eye(3), (len(along), 1, 1))
    np.testing.assert_allclose(along, wanted_m2, atol=1e-15)


@pytest.mark.parametrize(
    ("stated", "remedy"),
    [(False, "inverse: pose"), (True, "inverse: pose"), ("pose", "inverse: false")],
)
def test_poses_that_fit_only_as_inverse_ones_are_refused_by_name(tracked, stated, remedy):
    raw, table, _ = tracked
    own = own_table(table)
    mapped = own.join(table[QUATERNION]) if stated == "pose" else as_inverse_poses(own, table)
    columns = COLUMNS | {"rotation": WXYZ | {"inverse": stated}}
    with pytest.raises(Pa10calError, match=rf"set columns\.poses\.rotation\.{remedy}"):
        read_campaign(written(raw, mapped, columns))


def test_positions_that_fit_only_with_inverse_rotations_are_refused_by_name(tracked):
    raw, table, _ = tracked
    mapped = own_table(table).join(as_inverse_poses(own_table(table), table)[QUATERNION])
    columns = COLUMNS | {"rotation": WXYZ | {"inverse": "pose"}}
    with pytest.raises(Pa10calError, match=r"set columns\.poses\.rotation\.inverse: true"):
        read_campaign(written(raw, mapped, columns))


def test_bad_rows_are_listed_under_the_files_own_names(tracked):
    raw, table, _ = tracked
    own = own_table(table).join(table[QUATERNION])
    own[OWN] = np.radians(own[OWN])
    own = own.astype(object)
    own.loc[3, "axis 2"] = "n/a"
    own.loc[5, "axis 3"] = 8.5
    own.loc[7, "qx"] = "-"
    own.loc[9, "X"] = 9e6
    own.loc[11, "kind"] = "training"
    columns = COLUMNS | {"joints": {"names": OWN, "unit": "rad"}}
    found = read_campaign(written(raw, own, columns)).quarantined
    assert [(row.file, row.line, row.value) for row in found] == [
        ("export.txt", 5, "axis 2 = 'n/a'"),
        ("export.txt", 7, "axis 3 = 8.5 rad (q3_deg = 487.0141259)"),
        ("export.txt", 9, "qx = '-'"),
        ("export.txt", 11, "X = 9000000"),
        ("export.txt", 13, "kind = 'training'"),
    ]
    assert "beyond the limits of joint 3" in found[1].reason


@pytest.mark.slow
@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"kind": None}, r"mapped to kind .*set columns.poses.kind; or state holdout"),
        ({"position": {"names": ["X", "Y", "Zed"]}}, r"export.txt:1: missing column Zed"),
        (
            {"position": POSITION | {"unit": "cm"}},
            r"`X` \(`x_mm`\).*set columns.*position\.unit: mm",
        ),
        ({"rotation": {"names": ["X"], "convention": "euler_XXY"}}, r"convention does not fit"),
        ({"joins": JOINTS}, r"unknown key columns.poses.joins.*did you mean 'joints'"),
        ({"rotation": {"names": ["X", "Y"], "convention": "rpy"}}, r"2 columns .*3, as rpy has"),
    ],
)
def test_a_mapping_that_cannot_be_is_refused_with_the_key(tracked, columns, message):
    raw, table, _ = tracked
    own = own_table(table).join(table[QUATERNION])
    mapped = {key: value for key, value in (COLUMNS | columns).items() if value is not None}
    with pytest.raises(Pa10calError) as caught:
        read_campaign(written(raw, own, mapped))
    assert re.search(message, str(caught.value)), caught.value


def test_columns_are_of_the_files_that_the_instrument_has(tracked):
    raw, table, _ = tracked
    folder = written(raw, own_table(table), COLUMNS)
    content = yaml.safe_load((folder / "campaign.yaml").read_text())
    content["columns"] = {"cmm": {"pose": "pose"}}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(Pa10calError, match=r"columns\.cmm: .*allowed: columns\.poses"):
        read_campaign(folder)


def test_touches_and_resolver_log_under_other_names(raw_campaign):
    expected = read_campaign(raw_campaign.write()).observations
    names = {"time_s": "t", "x_mm": "X", "y_mm": "Y", "z_mm": "Z", "ball": "Sphere"}
    cmm = pd.read_csv(io.StringIO("\n".join(raw_campaign.cmm))).rename(columns=names)
    cmm["t"] = pd.Timestamp("2026-03-01") + pd.to_timedelta(cmm["t"], unit="s")
    cmm = cmm.drop(columns="touch")
    log = pd.read_csv(io.StringIO("\n".join(raw_campaign.resolver)))
    log["time_s"] = (pd.Timestamp("2026-03-01") - pd.Timestamp(0)).total_seconds() + log["time_s"]
    log["time_s"] *= 1e3
    tau = [f"tau{j}_Nm" for j in range(1, 7)]
    cmm.to_csv(raw_campaign.folder / "cmm.csv", index=False, sep="\t")
    log.to_csv(raw_campaign.folder / "resolver.csv", index=False, float_format="%.9f")
    content = raw_campaign.description | {
        "columns": {
            "cmm": {
                "separator": "tab",
                "time": {"names": "t", "format": "iso"},
                "kind": KIND,
                "pose": "pose",
                "load": {"names": "load_N"},
                "repeat": "repeat",
                "ball": "Sphere",
                "position": POSITION,
            },
            "resolver": {
                "time": {"names": "time_s", "unit": "ms"},
                "joints": {"names": Q},
                "torques": {"names": tau},
                "temperature": {"names": "temperature_C"},
            },
        }
    }
    (raw_campaign.folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    found = read_campaign(raw_campaign.folder)
    assert found.quarantined == ()
    np.testing.assert_allclose(found.observations.states.q_rad, expected.states.q_rad, atol=1e-9)
    np.testing.assert_allclose(
        found.observations.measured.T_instr_target, expected.measured.T_instr_target, atol=1e-9
    )
