"""The JSON schema of config.yaml, generated from the settings types."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from pa10cal.files.output import write_text
from pa10cal.settings import Settings


def schema_text() -> str:
    """Return the JSON schema of `Settings` as the text of its file."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(schema | Settings.model_json_schema(), indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    write_text(Path(sys.argv[1]), schema_text())
