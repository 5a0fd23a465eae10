"""The schemas and the key tables are those of the records."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import record_tables as docs
from pydantic import BaseModel

from pa10cal.results.calibration import BaseFrameRecord
from pa10cal.results.record import Record

ROOT = Path(__file__).parents[2]


@pytest.mark.slow_but_one_in(5)
@pytest.mark.parametrize("kind", docs.RECORDS, ids=docs.schema_name)
def test_the_json_schema_is_up_to_date(kind: type[Record]) -> None:
    path = ROOT / docs.SCHEMAS / f"{docs.schema_name(kind)}.schema.json"
    assert path.read_text(encoding="utf-8") == docs.schema_text(kind), "run make schema"


def test_there_is_no_other_schema() -> None:
    written = {path.name for path in (ROOT / docs.SCHEMAS).iterdir()}
    assert written == {f"{docs.schema_name(kind)}.schema.json" for kind in docs.RECORDS}


def test_the_key_tables_are_up_to_date() -> None:
    now = (ROOT / docs.DOCS).read_text(encoding="utf-8")
    assert now == docs.docs_text(now), "run make schema"


def _parts(kind: type[BaseModel]) -> set[type[BaseModel]]:
    found = {kind}
    for subclass in kind.__subclasses__():
        found |= _parts(subclass)
    return found


def test_every_key_is_described() -> None:
    blank = [
        f"{part.__name__}.{name}"
        for part in _parts(docs.Part)
        for name in part.model_fields
        if not docs.meaning(part, name)
    ]
    assert not blank


def test_a_schema_allows_added_keys_and_demands_its_own() -> None:
    schema = json.loads(docs.schema_text(BaseFrameRecord))
    assert schema["properties"]["schema"] == {"const": "pa10cal-base-frame/1"}
    assert "additionalProperties" not in schema
    assert {"schema", "campaign", "T_instr_base"} <= set(schema["required"])
    assert "line_x" not in schema["required"]
