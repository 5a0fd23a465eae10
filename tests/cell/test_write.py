"""The campaign's folder, and the truth elsewhere."""

import gzip
import json
from io import BytesIO

import numpy as np
import pandas as pd
import pytest
import yaml

from pa10cal.cell.campaign import simulate_campaign
from pa10cal.cell.write import write_campaign
from pa10cal.errors import SimulationError
from pa10cal.settings import HiddenEffectSettings, SimulateSettings


@pytest.fixture(scope="module")
def campaign(arm, short):
    effect = HiddenEffectSettings(
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
    measured = 1e3 * campaign.truth.robot.apparatus.balls_measured_m
    assert np.array(list(content["tool"]["balls_mm"].values())) == pytest.approx(measured, abs=1e-4)
    assert not np.allclose(measured, 1e3 * campaign.truth.robot.apparatus.balls_m, atol=1e-4)


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
        table = getattr(campaign, name)
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
    assert {kind: len(q) for kind, q in truth["poses_rad"].items()} == {
        "line_x": 11,
        "line_y": 11,
        "grid": 27,
        "holdout": 10,
    }
    assert SimulateSettings.model_validate(truth["settings"]) == campaign.settings


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


def test_refuses_a_folder_that_holds_something_else(campaign, tmp_path):
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw/thesis.tex").write_text("dear")
    with pytest.raises(SimulationError, match=r"thesis\.tex"):
        write_campaign(campaign, tmp_path / "raw", tmp_path / "t.json")
    assert [path.name for path in tmp_path.rglob("*")] == ["raw", "thesis.tex"]


def test_replaces_a_former_campaign(written, campaign):
    folder = written / "raw/secret"
    before = (folder / "cmm.csv.gz").read_bytes()
    (folder / "cmm.csv.gz").write_bytes(b"former")
    write_campaign(campaign, folder, written / "truth/secret.json")
    assert (folder / "cmm.csv.gz").read_bytes() == before
