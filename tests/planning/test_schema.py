"""The committed JSON schema is that of the settings, and it accepts config.yaml."""

import json
from pathlib import Path

import yaml
from jsonschema import Draft202012Validator

from pa10cal.planning.schema import schema_text

ROOT = Path(__file__).parents[2]
SCHEMA = ROOT / "workflow/schemas/config.schema.json"


def test_schema_is_up_to_date():
    assert SCHEMA.read_text(encoding="utf-8") == schema_text(), "run: make schema"


def test_schema_accepts_the_configuration_and_refuses_unknown_keys():
    validator = Draft202012Validator(json.loads(schema_text()))
    config = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
    assert list(validator.iter_errors(config)) == []
    assert list(validator.iter_errors({**config, "calibraton": {}}))
