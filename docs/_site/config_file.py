"""What is generated from the types of the settings: config.yaml and its JSON schema.

python docs/_site/config_file.py        (from the root of the repository)
"""

from __future__ import annotations

import json
import re
import sys
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from pa10cal.files.output import write_text
from pa10cal.settings import Settings
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions

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


# The text of config.yaml: every setting with its default and, as a comment, its description.

_WIDTH = 120
_HEAD = """\
# yaml-language-server: $schema=workflow/schemas/config.schema.json
# Every setting, with its default. Any of them can be given on the command line too:
# snakemake --cores 2 --config campaigns='["c1"]' raw_dir=… montecarlo='{"cycles": 1000}'
"""

#: What the shipped file chooses, as there is no default.
_CHOSEN: Mapping[str, Any] = {
    "campaigns": ["cell-a", "cell-null", "lightcap2008"],
    "simulate": {
        "lightcap2008": {
            "random_seed": 2008,
            "hidden_effects": [
                {
                    "id": "transmission_error",
                    "of": f"joint {joint}",
                    "parameters": {"A": 4.36e-4, "phi": phase},
                }
                for joint, phase in ((1, 0.4), (2, 1.9), (3, 4.1))
            ]
            + [
                {"id": "friction_torque", "of": f"joint {joint}", "parameters": {"tau_c": torque}}
                for joint, torque in ((2, 4.0), (3, 2.5))
            ],
        }
    },
}
_SAID_OF_CHOSEN = {
    "random_seed": "the same seed gives the same bytes",
    "hidden_effects": "transmission error of 1.5 arc minutes, and friction in the logged torques",
}
#: An entry of `simulate` that is shown but not taken.
_EXAMPLE = "any-arm"
_SAID_OF_EXAMPLE = "any described arm under an instrument that does not touch, every default shown"


def config_text() -> str:
    """Return the text of config.yaml."""
    lines: list[str] = []
    for name, field in Settings.model_fields.items():
        default = _CHOSEN.get(name, field.get_default(call_default_factory=True))
        if isinstance(default, BaseModel | dict):
            lines.append("")
        if name == "simulate":
            lines += [f"{name}: # {field.description}", *_simulated(default)]
        else:
            lines += _setting(name, default, field)
    return "\n".join((_HEAD, *(short for line in lines for short in _wrapped(line)), ""))


def _wrapped(line: str) -> list[str]:
    """Return a line, or where it is too long its comment above it."""
    if len(line) <= _WIDTH:
        return [line]
    setting, _, comment = line.rpartition(" # ")
    margin = re.match(r" *(?:# +)?", setting)
    start = f"{margin[0] if margin else ''}# "
    return [*textwrap.wrap(comment, _WIDTH, initial_indent=start, subsequent_indent=start), setting]


def _setting(name: str, value: Any, field: FieldInfo) -> Iterator[str]:
    """Yield the lines of one setting, those below it indented."""
    comment = _comment(field)
    if isinstance(value, BaseModel):
        yield f"{name}: # {comment}"
        yield from _indented(_section(value))
    elif isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
        yield f"{name}: # {comment}"
        yield from (f"  - {_flow(each.model_dump(mode='json'))}" for each in value)
    else:
        yield f"{_flow(name)}: {_flow(value)}" + (f" # {comment}" if comment else "")


def _section(section: BaseModel) -> Iterator[str]:
    for name, field in type(section).model_fields.items():
        yield from _setting(name, getattr(section, name), field)


def _simulated(campaigns: Mapping[str, Any]) -> Iterator[str]:
    """Yield the entries of `simulate`, then an example as a comment."""
    for name, content in campaigns.items():
        yield f"  {name}:"
        for key, value in content.items():
            comment = _SAID_OF_CHOSEN[key]
            if isinstance(value, list):
                yield f"    {key}: # {comment}"
                yield from (f"      - {_flow(each)}" for each in value)
            else:
                yield f"    {key}: {_flow(value)} # {comment}"
    fields = SimulateOptions.model_fields
    example = SimulateOptions(without_touches=TrackerOptions())
    yield f"  # {_EXAMPLE}: # {_SAID_OF_EXAMPLE}"
    for name in ("random_seed", "robot", "without_touches"):
        for line in _setting(name, getattr(example, name), fields[name]):
            yield f"  #   {line}"


def _comment(field: FieldInfo) -> str:
    """Return the description of a setting, and its choices where it does not name them."""
    text = field.description or ""
    kind = field.annotation
    choices = [str(each) for each in get_args(kind)] if get_origin(kind) is Literal else []
    if all(choice in text for choice in choices):
        return text
    return f"{text}: {', '.join(choices[:-1])} or {choices[-1]}"


def _indented(lines: Iterator[str]) -> Iterator[str]:
    yield from (f"  {line}" for line in lines)


def _flow(value: Any) -> str:
    """Return a value on one line, numbers as one writes them."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_flow(key)}: {_flow(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, float) and 0.0 < abs(value) < 2e-3:
        digits, exponent = f"{value:e}".split("e")
        digits = digits.rstrip("0")
        return f"{digits}{'0' * digits.endswith('.')}e{int(exponent)}"
    if isinstance(value, str) and value not in ("null", "true", "false"):
        return value
    return json.dumps(value)


if __name__ == "__main__":
    write_generated(Path(*sys.argv[1:]))
