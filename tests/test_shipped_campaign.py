"""The campaign of the virtual cell that ships is what its settings write."""

import json
from pathlib import Path

import pandas as pd
import pytest
import yaml

from pa10cal.commands.command_line import run_command

ROOT = Path(__file__).parents[1]
SHIPPED = ROOT / "data" / "raw" / "lightcap2008"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Write it again from config.yaml; see `snakemake simulate` for the command."""
    folder = tmp_path_factory.mktemp("simulated")
    config = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
    settings = json.dumps(config["simulate"]["lightcap2008"])
    argv = ["--name", "lightcap2008", "--settings", settings]
    argv += ["--kcub-reading", config["kcub_reading"]]
    argv += ["--out", str(folder / "raw"), "--truth", str(folder / "truth.json")]
    assert run_command("simulate", argv) == 0
    return folder


@pytest.mark.parametrize("name", ["cmm.csv.gz", "resolver.csv.gz"])
def test_logs_are_what_the_settings_write(written, name):
    # Another processor may round the last digit elsewhere; the same one writes the same bytes.
    found, shipped = pd.read_csv(written / "raw" / name), pd.read_csv(SHIPPED / name)
    pd.testing.assert_frame_equal(found, shipped, rtol=0, atol=1.1e-3)
    assert (found != shipped).to_numpy().mean() < 1e-4


def test_description_and_hidden_effects_are_what_the_settings_write(written):
    assert (written / "raw" / "campaign.yaml").read_text() == (
        SHIPPED / "campaign.yaml"
    ).read_text()
    truth = json.loads((ROOT / "data" / "truth" / "lightcap2008.json").read_text())
    again = json.loads((written / "truth.json").read_text())
    assert again["hidden_effects"] == truth["hidden_effects"]
    assert len(truth["hidden_effects"]) == 5
    for name, parameter in truth["parameters"].items():
        assert again["parameters"][name]["value"] == pytest.approx(parameter["value"], rel=1e-9)


def test_truth_is_out_of_reach_of_the_estimating_stages():
    rules = [path.read_text() for path in (ROOT / "workflow" / "rules").glob("*.smk")]
    assert not any("data/truth" in text for text in rules)
    sources = [path.read_text() for path in (ROOT / "src").rglob("*.py")]
    assert not any("data/truth" in text for text in sources)
