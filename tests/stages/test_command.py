"""What every stage does with refusals, faults and threads."""

import os

import pytest

from pa10cal.errors import RawDataError
from pa10cal.stages.command import FAULT, REFUSED, limit_threads, run_stage

REFUSAL = RawDataError(
    "not a number",
    where="cmm.csv:7",
    value="1,5",
    allowed="a decimal point",
    remedy="export with points",
)


def describe(parser):
    parser.add_argument("--load", required=True)


def fail(error):
    def run(arguments):
        raise error

    return run


def test_success_returns_zero_and_passes_arguments():
    seen = []
    code = run_stage("ingest", describe, lambda a: seen.append(a.load), ["--load", "44N"])
    assert (code, seen) == (0, ["44N"])


def test_refusal_is_one_message_with_all_the_reader_needs(capsys):
    assert run_stage("ingest", describe, fail(REFUSAL), ["--load", "0N"]) == REFUSED
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err == (
        "pa10cal ingest: cmm.csv:7: not a number (got '1,5'); allowed: a decimal point; "
        "export with points\n"
    )


def test_fault_is_told_from_a_refusal(capsys):
    assert run_stage("seed", describe, fail(KeyError("x")), ["--load", "0N"]) == FAULT
    message = capsys.readouterr().err
    assert "internal fault: KeyError" in message
    assert "--debug" in message
    assert "Traceback" not in message


@pytest.mark.parametrize("error", [REFUSAL, KeyError("x")])
def test_debug_lets_the_error_through(error):
    with pytest.raises(type(error)):
        run_stage("seed", describe, fail(error), ["--load", "0N", "--debug"])


def test_a_missing_argument_is_refused_with_the_usage(capsys):
    with pytest.raises(SystemExit) as caught:
        run_stage("seed", describe, fail(REFUSAL), [])
    assert caught.value.code == REFUSED
    assert "usage: pa10cal seed" in capsys.readouterr().err


def test_one_thread_a_job_unless_the_user_says_otherwise(monkeypatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    limit_threads()
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    assert os.environ["OMP_NUM_THREADS"] == "2"
