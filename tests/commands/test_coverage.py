import json

from pa10cal.commands.command_line import run_command


def test_a_few_campaigns_are_covered(tmp_path):
    """Fifty campaigns are a target of the workflow; a few would show a gross fault."""
    out = tmp_path / "coverage.json"
    settings = json.dumps({"starts": 1})
    argv = ["--campaigns", "5", "--settings", settings, "--out", str(out)]
    assert run_command("coverage", argv) == 0
    found = json.loads(out.read_text())
    assert len(found["parameters"]) == 28
    assert 0.85 < found["inside"] < 1.0
    assert 0.75 < found["rms"] < 1.3
