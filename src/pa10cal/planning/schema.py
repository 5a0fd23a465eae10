"""What is generated from the types of the settings: config.yaml and its JSON schema."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from pa10cal.files.output import write_text
from pa10cal.planning.config_file import config_text
from pa10cal.settings import Settings

#: Files by what they hold, from the root of the project.
CONFIG = Path("config.yaml")
SCHEMA = Path("workflow/schemas/config.schema.json")


def schema_text() -> str:
    """Return the JSON schema of `Settings` as the text of its file."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(schema | Settings.model_json_schema(), indent=2, ensure_ascii=False) + "\n"


def write_generated(root: Path) -> None:
    """Write both files of a project anew."""
    write_text(root / CONFIG, config_text())
    write_text(root / SCHEMA, schema_text())


if __name__ == "__main__":
    write_generated(Path(*sys.argv[1:]))
