"""Readers of measured robots: made-up files of their layouts against values worked out by hand."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from made_up_datasets import MADE_UP, MOTOMAN, edit
from pa10cal.arm.chain import Chain
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.screens import refuse_too_many
from pa10cal.datasets.importing import import_campaigns, write_campaigns
from pa10cal.datasets.known_campaigns import CAMPAIGNS
from pa10cal.datasets.readers import (
    ARMS,
    dataset_named,
    dataset_names,
    read_bare_table,
    read_tables,
)
from pa10cal.errors import RawDataError
from pa10cal.files.arms import load_arm

MEASURED = [name for name in MADE_UP if name != "ipa-robot-accuracy"]
#: Configurations of the campaigns that are published.
PUBLISHED = {
    "titan-fixed": 199,
    "titan-rail": 291,
    "iiwa7-free": 304,
    "iiwa7-0kg": 198,
    "iiwa7-1250g": 198,
    "iiwa7-2500g": 198,
    "ma2010-0516": 1500,
    "ma2010-0801": 1500,
    "justin-left": 500,
    "justin-right": 500,
    "irb120": 1000,
}


@pytest.fixture
def read(tmp_path):
    """Read the made-up folder of a data set, by campaign."""

    def read(dataset):
        folder = MADE_UP[dataset](tmp_path / dataset)
        return {each.name: each for each in dataset_named(dataset).read(folder, 0.2)}

    return read


def joints(campaign, row=0):
    return campaign.readings.iloc[row][
        [c for c in campaign.readings if c.startswith("q")]
    ].to_numpy()


def test_the_titans_axes_turn_as_its_description_has_them(read):
    found = read("titan-robot-accuracy")
    assert list(found) == ["titan-fixed", "titan-rail"]
    fixed, rail = found.values()
    np.testing.assert_array_equal(joints(fixed), [-10, -20, 30, -40, 50, 60])
    np.testing.assert_array_equal(joints(rail, 1), [1500, -11, -20, 30, -40, 50, 60])
    assert list(rail.readings)[:2] == ["q1_mm", "q2_deg"]
    assert fixed.readings.loc[1, "T2_y_mm"] == 401.0
    assert "misses these points by 0.300 mm rms" in fixed.provenance
    assert (fixed.joints, fixed.instrument, dict(fixed.holdout)) == (
        "commanded",
        "points",
        {"every": 5},
    )


def test_the_iiwa_logs_the_load_on_a_joint_and_its_motor_holds_against_it(read):
    found = read("iiwa7-robot-calibration")
    first = found["iiwa7-free"]
    np.testing.assert_allclose(joints(first)[:2], [5.729577951, 11.459155903])
    torques = first.readings[[f"tau{k}_Nm" for k in range(1, 8)]]
    np.testing.assert_array_equal(torques.to_numpy()[2], [-1, -2, -3, -4, -5, -6, -7])
    np.testing.assert_array_equal(first.readings.iloc[2][["x_mm", "y_mm", "z_mm"]], [502, 600, 700])
    quaternion = first.readings.iloc[0][["qw", "qx", "qy", "qz"]]
    np.testing.assert_allclose(quaternion, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-12)
    assert {name: each.tool_mass_kg for name, each in found.items()} == {
        "iiwa7-free": 0.0,
        "iiwa7-0kg": 0.0,
        "iiwa7-1250g": 1.25,
        "iiwa7-2500g": 2.5,
    }


def test_a_row_of_the_iiwa_whose_axes_are_of_no_frame_is_left_out(tmp_path):
    folder = MADE_UP["iiwa7-robot-calibration"](tmp_path)
    for file in folder.rglob("*.csv"):
        for column in range(15, 31):
            edit(file, 2, column, "0", ", ")
    campaigns = dataset_named("iiwa7-robot-calibration").read(folder, 0.5)
    assert [len(campaign.readings) for campaign in campaigns] == [2, 2, 2, 2]
    assert "no right-handed frame" in campaigns[0].left_out[0].reason


def test_the_motomans_quaternions_have_length_one_and_w_first(read):
    found = read("welding-motoman")["ma2010-0801"]
    np.testing.assert_allclose(joints(found, 1)[:2], [11.459155903, 11.459155903])
    assert found.readings.loc[0, "x_mm"] == 1000.0
    rotation = found.readings[["qw", "qx", "qy", "qz"]].to_numpy()
    np.testing.assert_allclose(rotation, [[0.8, -0.6, 0, 0], [1, 0, 0, 0]], atol=1e-12)
    assert found.joints == "logged"


def test_a_line_of_one_of_two_tables_takes_the_other_along(tmp_path):
    folder = MADE_UP["welding-motoman"](tmp_path)
    edit(folder / MOTOMAN / "test0516_R1/mocap_T_align.csv", 1, 3, "?", separator=",")
    first, second = dataset_named("welding-motoman").read(folder, 0.6)
    assert [(row.line, row.value) for row in first.left_out] == [(1, "qw = '?'")]
    assert first.readings["x_mm"].tolist() == [1001.0]
    assert len(second.readings) == 2


def test_justins_chest_stays_upright_and_each_hand_has_its_marker(read):
    found = read("dlr-elastic-calibration")
    right, left = found["justin-right"], found["justin-left"]
    degrees = np.degrees([0.5, -0.25, 1.0, -0.75, 0.0, 0.1, 0.2])
    np.testing.assert_allclose(joints(right)[:7], degrees)
    np.testing.assert_allclose(joints(left)[4:7], np.degrees([0.0, 0.2, 0.4]))
    places = ["T1_x_mm", "T1_y_mm", "T1_z_mm"]
    np.testing.assert_allclose(right.readings[places].to_numpy()[1], [-1500, 1250, 1500])
    np.testing.assert_allclose(left.readings[places].to_numpy()[1], [-3000, 2500, 100])
    assert len(joints(left)) == load_arm("justin_left", ARMS).n == 11


def test_justins_rows_that_are_cut_are_counted_and_a_broken_zip_is_refused(tmp_path):
    folder = MADE_UP["dlr-elastic-calibration"](tmp_path)
    path = folder / "dataset/measurements.csv.zip"
    with zipfile.ZipFile(path) as archive:
        text = archive.read("measurements.csv").decode().replace("-1.5 ", "")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("measurements.csv", text)
    with pytest.raises(RawDataError, match="rows would be quarantined"):
        dataset_named("dlr-elastic-calibration").read(folder, 0.2)
    path.write_bytes(b"no zip")
    with pytest.raises(RawDataError, match=r"zip: the zipped table cannot be read"):
        dataset_named("dlr-elastic-calibration").read(folder, 0.2)


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("dataset", MEASURED)
def test_the_contracts_reader_takes_every_campaign_and_no_time_is_made_up(dataset, tmp_path):
    folder = MADE_UP[dataset](tmp_path / "source")
    campaigns = dataset_named(dataset).read(folder, 0.2)
    for place, campaign in zip(
        write_campaigns(campaigns, tmp_path / "raw"), campaigns, strict=True
    ):
        found = read_campaign(place)
        assert found.quarantined == ()
        assert len(found.observations) == len(campaign.readings)
        q = found.observations.states.q_rad
        np.testing.assert_allclose(
            np.degrees(q[:, -1]), campaign.readings.filter(regex="^q").iloc[:, found.arm.n - 1]
        )
        assert found.description.columns.poses.time is None
        assert "No time was recorded" in found.description.provenance
        assert np.isfinite(found.observations.states.tau_Nm).all() == (dataset.startswith("iiwa7"))
        assert campaign.name in CAMPAIGNS
        assert CAMPAIGNS[campaign.name].dataset == dataset


@pytest.mark.parametrize("dataset", MEASURED)
def test_another_version_is_refused_by_checksum_with_what_to_do(dataset, tmp_path):
    folder = MADE_UP[dataset](tmp_path)
    with pytest.raises(RawDataError) as caught:
        import_campaigns(dataset_named(dataset), folder, max_left_out=0.2, any_version=False)
    published = dataset_named(dataset).published
    assert "the checksum differs from that of the published file" in str(caught.value)
    assert published.version in str(caught.value)
    assert "fetch the data set again" in str(caught.value)


def test_every_data_set_says_its_licence_or_that_none_is_stated():
    terms = {name: dataset_named(name).published.terms for name in dataset_names()}
    assert terms.pop("ipa-robot-accuracy").endswith("MIT licence.")
    assert sorted(terms) == sorted(MEASURED)
    assert all("no licence is stated by the owner" in told for told in terms.values())


@pytest.mark.parametrize(
    ("robot", "q", "place_m"),
    [
        # Lengths added up by hand: straight up, stretched forward.
        ("iiwa7", [0] * 7, [0, 0, 0.340 + 0.400 + 0.400 + 0.126]),
        ("ma2010", [0] * 6, [0.15 + 1.082 + 0.1, 0, 0.76 + 0.2]),
        ("titan", [0] * 6, [0.6 + 1.4 + 1.6 + 0.372, 0, 1.1 + 0.065]),
    ],
)
def test_arms_reach_where_their_lengths_say(robot, q, place_m):
    T = Chain.of(load_arm(robot, ARMS)).forward(np.array([q], dtype=float))
    np.testing.assert_allclose(T[0, :3, 3], place_m, atol=1e-12)


def test_the_titan_on_its_rail_is_the_fixed_one_moved_along():
    q = np.array([[0.3, -1.2, 0.8, 0.1, -0.4, 0.6]])
    fixed = Chain.of(load_arm("titan", ARMS)).forward(q)
    rail = Chain.of(load_arm("titan_rail", ARMS))
    one, two = (rail.forward(np.column_stack([[stroke_m], q])) for stroke_m in (0.0, 2.0))
    np.testing.assert_allclose(two[0, :3, :3], one[0, :3, :3], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(two[0, :3, 3] - one[0, :3, 3]), 2.0)
    turn = Rotation.from_matrix(one[0, :3, :3] @ fixed[0, :3, :3].T)
    np.testing.assert_allclose(turn.apply(fixed[0, :3, 3]), one[0, :3, 3], atol=1e-12)


@pytest.mark.parametrize("dataset", MEASURED)
def test_the_published_files_give_the_campaigns_that_are_known(dataset, tmp_path):
    named = os.environ.get("PA10CAL_MEASURED", "")
    folder = Path(named or Path(__file__).parents[3] / "data/measured") / dataset
    if not folder.is_dir():
        pytest.skip(f"{dataset} was not fetched into data/measured or PA10CAL_MEASURED")
    campaigns = import_campaigns(
        dataset_named(dataset), folder, max_left_out=0.0, any_version=False
    )
    for place in write_campaigns(campaigns, tmp_path):
        assert len(read_campaign(place).observations) == PUBLISHED[place.name]


# Text tables: numbers by column, bad rows listed, what is wrong throughout refused.


def test_bare_rows_keep_their_lines(tmp_path):
    (tmp_path / "t.txt").write_text("1 2\n\n3  nan\n4\t-\n5 6,5\n7 8\n\n")
    table = read_bare_table(tmp_path, "t.txt", ("x", "y"))
    np.testing.assert_array_equal(table.columns["y"], [2, 8])
    assert list(table.line) == [1, 6]
    assert {(row.line, row.reason, row.value) for row in table.quarantined} == {
        (2, "the number of fields is not 2", "0"),
        (3, "not a finite number", "y = 'nan'"),
        (4, "not a finite number", "y = '-'"),
        (5, "not a finite number", "y = '6,5' (a decimal comma)"),
    }


def test_a_separator_and_a_header(tmp_path):
    (tmp_path / "t.csv").write_text("a,b\n1, 2\n3,\n5,6\n")
    table = read_bare_table(tmp_path, "t.csv", ("x", "y"), separator=",", header=True)
    np.testing.assert_array_equal(table.numbers_of(("x", "y")), [[1, 2], [5, 6]])
    assert (list(table.line), table.totals) == ([2, 4], {"t.csv": 3})
    assert [row.line for row in table.quarantined] == [3]


def test_tables_that_belong_together_line_by_line(tmp_path):
    (tmp_path / "one.txt").write_text("1\n2\n3\n")
    (tmp_path / "two.txt").write_text("4\nx\n6\n")
    both = read_tables(tmp_path, 0.5, {"one.txt": "v", "two.txt": "w"})
    assert (both["v"].tolist(), both["w"].tolist()) == ([1, 3], [4, 6])


def test_decimal_commas_where_points_are_expected(tmp_path):
    (tmp_path / "t.txt").write_text("1,5 2\n3,5 4\n")
    with pytest.raises(RawDataError, match="decimal commas where decimal points are expected"):
        read_bare_table(tmp_path, "t.txt", ("x", "y"))


@examples(30)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=9))
def test_what_is_written_comes_back(tmp_path_factory, values):
    folder = tmp_path_factory.mktemp("round")
    rows = [f"{value!r} {k}" for k, value in enumerate(values)]
    (folder / "t.txt").write_text("\n".join(rows))
    table = read_bare_table(folder, "t.txt", ("a", "b"))
    np.testing.assert_array_equal(table.columns["a"], values)


def test_bad_rows_are_listed_and_too_many_refused(tmp_path):
    (tmp_path / "t.txt").write_text("1 2\n3 x\n4 5 6\ninf 1\n7 8\n")
    table = read_bare_table(tmp_path, "t.txt", ("a", "b"))
    assert len(table) + len(table.quarantined) == table.totals["t.txt"] == 5
    with pytest.raises(
        RawDataError, match=r"t\.txt:2: b: 3 of 5 rows would be quarantined, 2 of them"
    ):
        refuse_too_many(table.quarantined, table.totals, 0.5)
    refuse_too_many(table.quarantined, table.totals, 0.6)


@pytest.mark.parametrize("text", ["", " \n\n"])
def test_an_empty_file_is_refused(tmp_path, text):
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(RawDataError, match=r"t\.txt:1: the file is empty"):
        read_bare_table(tmp_path, "t.txt", ("a", "b"))
