"""config.yaml and its JSON schema are those generated from the settings, and they fit."""

import json
from pathlib import Path

import yaml
from config_file import CONFIG, SCHEMA, config_text, schema_text, write_generated
from jsonschema import Draft202012Validator

ROOT = Path(__file__).parents[2]


def test_schema_is_up_to_date():
    assert (ROOT / SCHEMA).read_text(encoding="utf-8") == schema_text(), "run: make schema"


def test_config_is_up_to_date_and_no_line_is_long():
    assert (ROOT / CONFIG).read_text(encoding="utf-8") == config_text(), "run: make schema"
    assert not [line for line in config_text().splitlines() if len(line) > 120]


def test_both_files_are_written_anew(tmp_path):
    (tmp_path / SCHEMA).parent.mkdir(parents=True)
    write_generated(tmp_path)
    assert (tmp_path / CONFIG).read_text(encoding="utf-8") == config_text()
    assert (tmp_path / SCHEMA).read_text(encoding="utf-8") == schema_text()


def test_schema_accepts_the_configuration_and_refuses_unknown_keys():
    validator = Draft202012Validator(json.loads(schema_text()))
    config = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
    assert list(validator.iter_errors(config)) == []
    assert list(validator.iter_errors({**config, "calibraton": {}}))
