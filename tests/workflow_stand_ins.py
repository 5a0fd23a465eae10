"""Commands that take the options of the real ones and write little files."""

from textwrap import dedent

from pa10cal.commands.command_line import COMMANDS

#: Command, the options it is called with, and what the stand-in writes. Several values follow a +;
#: one with a ? may be left out; one without -- stands first, by its place.
STAND_INS = {
    "ingest": (
        ["--campaign-dir", "--settings", "--out", "--quarantine"],
        """
        import pyarrow, pyarrow.parquet
        if "refuse" in (Path(a.campaign_dir) / "campaign.yaml").read_text():
            raise RawDataError("broken", where="cmm.csv:7", allowed="sense", remedy="mend it")
        again = "P1" if "touch" in (Path(a.campaign_dir) / "campaign.yaml").read_text() else "P2"
        rows = {"kind": ["grid", "grid", "grid", "holdout"], "pose": ["P1", "P1", again, "H1"]}
        rows["load_N"] = [22.5, 0.0, 0.0, 90.0]
        pyarrow.parquet.write_table(pyarrow.table(rows), a.out)
        write_text(Path(a.quarantine), "file,line,reason")
        """,
    ),
    "seed": (["--campaign-dir", "--poses", "--settings", "--out"], ""),
    "calibrate": (
        ["--campaign-dir", "--poses", "--base-frame", "--load?", "--settings", "--out"],
        """
        import pa10cal.calibration.probe
        for case in () if a.load else ("0N", "22.5N", "combined"):
            write_text(Path(a.out) / f"{case}.json", json.dumps(vars(a)))
        """,
    ),
    "montecarlo": (
        ["--campaign", "--robot", "--campaign-dir", "--settings", "--out", "--skip-out-of-reach!"],
        """
        for plane in json.loads(a.settings)["planes_mm"]:
            write_text(Path(a.out) / f"z{plane}.json", json.dumps(vars(a)))
        """,
    ),
    "discover": (
        [
            "--campaign-dir",
            "--poses",
            "--calibration",
            "--settings",
            "--verdict",
            "--analysis",
            "--extended",
            "--suggested",
        ],
        """
        covariance = Path(a.extended).with_suffix(".covariance.npz")
        for path in (a.verdict, a.analysis, a.extended, covariance, a.suggested):
            write_text(Path(path), a.calibration)
        """,
    ),
    "evaluate": (
        ["--campaign-dir", "--poses", "--calibration", "--extended?", "--out", "--iso9283"],
        "write_text(Path(a.iso9283), a.calibration)",
    ),
    "export": (
        [
            "--calibration",
            "--extended?",
            "--campaign-dir",
            "--poses",
            "--model",
            "--urdf",
            "--dh",
            "--force!",
        ],
        """
        for path in (a.model, a.urdf, a.dh, Path(a.model).with_suffix(".covariance.npz")):
            write_text(Path(path), a.calibration)
        """,
    ),
    "coverage": (["--settings", "--calibration", "--out", "--table"], ""),
    "report": (["results", "--campaign-dir", "--calibration", "--out"], ""),
    "figures": (
        ["--figure?", "--campaign-dir?", "--results", "--settings", "--force!"],
        """
        out = Path(a.results)
        record = out / "curve.json"
        said = record.read_text() if record.exists() else a.settings
        if a.figure:
            for ending in ("svg", "pdf", "png", "csv", "md"):
                place = "figures" if ending in ("svg", "pdf", "png") else "tables"
                write_text(out / place / f"{a.figure}.{ending}", said)
        else:
            for name in ("figures/drawn.svg", "tables/drawn.md", "pictures.json"):
                write_text(out / name, said)
        """,
    ),
    "blind_trials": (
        [
            "--measured",
            "--kind",
            "--first",
            "--count",
            "--random-seed",
            "--settings",
            "--verdicts",
            "--truths",
        ],
        """
        for path in (a.verdicts, a.truths):
            write_text(Path(path), f"{a.kind} {a.first} {a.count}")
        """,
    ),
    "score_trials": (
        ["--verdicts+", "--truths+", "--scores", "--trials"],
        """
        for path in (a.scores, a.trials):
            write_text(Path(path), "; ".join(Path(name).read_text() for name in a.verdicts))
        """,
    ),
    "curve": (
        ["--settings", "--out-dir"],
        """
        for name in ("curve.json", "angles.csv", "points.csv", "links.csv", "shape.csv"):
            write_text(Path(a.out_dir) / name, a.settings)
        """,
    ),
    "curve_calibration": (["--settings", "--calibration", "--out"], ""),
    "simulate": (
        ["--name", "--settings", "--kcub-reading", "--out", "--truth"],
        """
        for name in ("campaign.yaml", "cmm.csv.gz", "resolver.csv.gz"):
            write_text(Path(a.out) / name, a.name)
        write_text(Path(a.truth), a.kcub_reading)
        """,
    ),
}
STAND_IN = """
import json, sys
from pathlib import Path
from types import SimpleNamespace
from pa10cal.errors import RawDataError
from pa10cal.files.output import write_text

def {command}({parameters}) -> None:
    a = SimpleNamespace(**locals())
    print("{command} at work", file=sys.stderr)
    json.loads(getattr(a, "settings", "{{}}"))
    if Path(getattr(a, "out", "folder")).suffix:
        write_text(Path(a.out), json.dumps(vars(a)))
{body}
"""


def stand_ins():
    """Return the text of each module of commands, with stand-ins in place of its commands."""
    modules = {}
    for command in STAND_INS:
        modules.setdefault(COMMANDS[command], []).append(stand_in(command))
    return {module: "\n".join(texts) for module, texts in modules.items()}


def stand_in(command):
    """Return the text of a function in place of a command's."""
    options, body = STAND_INS[command]
    kinds = {"?": "str | None = None", "+": "tuple[str, ...]", "!": "bool = False"}
    given = [option for option in options if not option.startswith("--")]
    given += ["*", *(option[2:] for option in options if option.startswith("--"))]
    parameters = ", ".join(
        f"{option.rstrip('+?!').replace('-', '_')}: {kinds.get(option[-1], 'str')}"
        if option != "*"
        else "*"
        for option in given
    )
    lines = "".join(f"    {line}\n" for line in dedent(body).splitlines())
    return STAND_IN.format(command=command, parameters=parameters, body=lines)
