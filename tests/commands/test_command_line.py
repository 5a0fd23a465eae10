"""What every command does with its arguments, refusals, faults and threads."""

import functools
import inspect
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Literal

import pytest

from pa10cal import __main__
from pa10cal.commands import command_line
from pa10cal.commands.command_line import (
    CLOSED,
    COMMANDS,
    FAULT,
    GROUPS,
    INTERRUPTED,
    REFUSED,
    command_named,
    main,
    run_command,
)
from pa10cal.errors import RawDataError
from pa10cal.options import IngestOptions
from pa10cal.running.display import RunDisplay

REFUSAL = RawDataError(
    "not a number",
    where="cmm.csv:7",
    value="1,5",
    allowed="a decimal point",
    remedy="export with points",
)


def failing(error):
    def command(*, load: str) -> None:
        raise error

    return command


def called(argv, seen):
    """Run a command that takes one argument of every kind, and return its exit code."""

    def command(
        name: str,
        *,
        out: Path,
        count: int = 50,
        size: float | None = None,
        tables: tuple[Path, ...] = (),
        reading: Literal["text", "table"] = "text",
        fast: bool = False,
        settings: IngestOptions = IngestOptions(),
    ) -> None:
        """Do a thing 100 % well.

        In two paragraphs.

        Args:
            name: what to do it to.
            out: where it goes,
                in two lines.
            count, size: how often and how large.
            settings: the ingest section.
        """
        seen.update(locals())

    return run_command("ingest", argv, command)


def test_arguments_come_as_the_signature_types_them():
    seen = {}
    argv = ["arm", "--out", "o.json", "--tables", "a.csv", "b.csv", "--size", "2", "--fast"]
    assert called([*argv, "--settings", '{"still_speed_deg_s": 1}'], seen) == 0
    assert (seen["name"], seen["out"], seen["count"], seen["size"]) == (
        "arm",
        Path("o.json"),
        50,
        2.0,
    )
    assert seen["tables"] == (Path("a.csv"), Path("b.csv"))
    assert (seen["reading"], seen["fast"]) == ("text", True)
    assert seen["settings"] == IngestOptions(still_speed_deg_s=1)


def test_what_is_not_given_keeps_its_default():
    seen = {}
    assert called(["arm", "--out", "o.json"], seen) == 0
    assert (seen["size"], seen["tables"], seen["fast"]) == (None, (), False)
    assert seen["settings"] == IngestOptions()


def test_help_is_the_docstring(capsys):
    with pytest.raises(SystemExit) as caught:
        called(["--help"], {})
    assert caught.value.code == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "usage: pa10cal ingest" in shown
    assert "Do a thing 100 % well. In two paragraphs. positional" in shown
    assert "--out OUT where it goes, in two lines --count" in shown
    assert "how often and how large (default: 50)" in shown
    assert "(default: ())" not in shown
    assert "--reading {text,table}" in shown
    assert "the ingest section: a JSON object, or the path of a YAML file" in shown
    assert "--debug" in shown


@pytest.mark.parametrize(
    "argv",
    [
        ["--out", "o.json"],
        ["arm"],
        ["arm", "--out", "o.json", "--count", "many"],
        ["arm", "--out", "o.json", "--reading", "other"],
        ["arm", "--out", "o.json", "--colour", "red"],
    ],
)
def test_wrong_use_is_refused_with_the_usage(argv, capsys):
    with pytest.raises(SystemExit) as caught:
        called(argv, {})
    assert caught.value.code == REFUSED
    assert "usage: pa10cal ingest" in capsys.readouterr().err


def test_a_wrong_setting_is_refused_by_name(capsys):
    argv = ["arm", "--out", "o.json", "--settings", '{"still_speed": 1}']
    assert called(argv, {}) == REFUSED
    message = capsys.readouterr().err
    assert "pa10cal ingest: --settings: unknown key still_speed" in message
    assert "did you mean 'still_speed_deg_s'?" in message


def test_refusal_is_one_message_with_all_the_reader_needs(capsys):
    assert run_command("ingest", ["--load", "0N"], failing(REFUSAL)) == REFUSED
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err == (
        "pa10cal ingest: cmm.csv:7: not a number (got '1,5'); allowed: a decimal point; "
        "export with points\n"
    )


def test_fault_is_told_from_a_refusal(capsys):
    assert run_command("seed", ["--load", "0N"], failing(KeyError("x"))) == FAULT
    message = capsys.readouterr().err
    assert "internal fault: KeyError" in message
    assert "--debug" in message
    assert "Traceback" not in message


def test_an_interrupted_command_says_so(capsys):
    assert run_command("seed", ["--load", "0N"], failing(KeyboardInterrupt())) == INTERRUPTED
    assert capsys.readouterr().err == "pa10cal seed: interrupted\n"


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    "command",
    [
        "main(['effects'])",
        "main(['--help'])",
        "run_command(*LONG)",
    ],
)
def test_output_that_nobody_reads_ends_a_command_quietly(command):
    script = (
        "import sys; from pa10cal.commands.command_line import main, run_command\n"
        "def long() -> None: print('line\\n' * 100_000)\n"
        "LONG = ('effects', [], long)\n"
        f"sys.exit({command})"
    )
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            [sys.executable, "-c", script], stdout=writing, stderr=subprocess.PIPE
        )
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (CLOSED, b"")


def test_a_pipe_that_breaks_elsewhere_is_a_fault(capsys):
    assert run_command("seed", ["--load", "0N"], failing(BrokenPipeError())) == FAULT
    assert "internal fault: BrokenPipeError" in capsys.readouterr().err


@pytest.mark.parametrize(("error", "code"), [(REFUSAL, REFUSED), (KeyError("x"), FAULT)])
def test_debug_shows_the_traceback_and_keeps_the_exit_code(error, code, capsys):
    assert run_command("seed", ["--load", "0N", "--debug"], failing(error)) == code
    message = capsys.readouterr().err
    assert "Traceback (most recent call last)" in message
    assert "in command" in message


def test_one_thread_a_process_whatever_the_environment_says():
    code = (
        "from pa10cal.commands.command_line import limit_threads; limit_threads()\n"
        "import os, numpy as np, scipy.linalg\n"
        "a = np.ones((500, 500)); scipy.linalg.lu_factor(a @ a + 9e9 * np.eye(500))\n"
        "print(len(os.listdir('/proc/self/task')))"
    )
    asked = {f"{name}_NUM_THREADS": "3" for name in ("OPENBLAS", "OMP", "MKL")}
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **asked}, capture_output=True, text=True
    )
    assert done.stdout == "1\n", done.stderr


def test_memory_of_large_arrays_is_kept_for_the_next_ones():
    code = (
        "from pa10cal.commands.command_line import keep_memory; keep_memory()\n"
        "import numpy as np, resource\n"
        "faults = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "np.ones(5_000_000); before = faults()\n"
        "for _ in range(20): np.ones(5_000_000)\n"
        "print(faults() - before)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert int(done.stdout) < 5_000_000 * 8 // 4096, (
        done.stderr
    )  # the pages of one array, not of 20


def test_lists_the_commands(capsys):
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(f"\n  {name} " in shown for name in COMMANDS)


def test_commands_are_listed_by_whom_they_serve(capsys):
    main(["--help"])
    shown = capsys.readouterr().out
    titles = [f"\n{title}:\n" for title in GROUPS]
    assert sorted(titles, key=shown.index) == titles
    assert shown.index("maintainers") < shown.index("\n  coverage ")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_gives_examples_that_it_understands(name):
    examples = examples_of(name)
    assert examples, f"the docstring of {name} has no section Examples"
    seen = []

    @functools.wraps(command_named(name))
    def parsed(*_, **given):
        seen.append(given)

    for words in examples:
        assert words[:2] == ["pa10cal", name]
        assert run_command(name, words[2:], parsed) == 0
    assert len(seen) == len(examples)


def examples_of(name):
    """Return the words of every example in a command's docstring."""
    _, _, text = inspect.getdoc(command_named(name)).partition("\nExamples:\n")
    lines = text.replace("\\\n", " ").splitlines()
    commands = [line.partition(" > ")[0] for line in lines]  # the rest is for the shell
    return [shlex.split(line, comments=True) for line in commands if line.strip()]


def test_a_negative_number_may_have_an_exponent():
    seen = {}
    assert called(["arm", "--out", "o.json", "--size", "-1e3"], seen) == 0
    assert seen["size"] == -1000.0


@pytest.mark.parametrize("words", [["--help", "effects"], ["-h", "effects"]])
def test_help_may_stand_before_the_command(words, capsys):
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 0
    assert "usage: pa10cal effects" in capsys.readouterr().out


def test_an_option_before_the_command_is_told_where_it_belongs(capsys):
    assert main(["--debug", "effects"]) == REFUSED
    assert "(got '--debug'); give options after the command" in capsys.readouterr().err


@pytest.mark.parametrize("error", [OSError(28, "No space left"), OSError(13, "Denied", "a.csv")])
def test_a_disk_that_fails_is_no_fault_of_the_program(error, capsys):
    assert run_command("seed", ["--load", "0N"], failing(error)) == REFUSED
    told = capsys.readouterr().err
    assert "internal fault" not in told
    assert told.endswith(f"a file cannot be read or written: {error.strerror}\n")
    assert error.filename is None or "a.csv: " in told


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
@pytest.mark.parametrize("words", ["--version", "effects"])
def test_an_output_that_cannot_be_written_is_refused(words):
    done = ended(f"{words} > /dev/full")
    assert done.returncode == REFUSED
    assert "standard output: what is printed cannot be written: No space left" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
@pytest.mark.parametrize("words", ["--version > /dev/full 2>&1", "nosuch 2> /dev/full"])
def test_a_message_that_cannot_be_written_is_lost_and_the_exit_code_stays(words):
    done = ended(words)
    assert (done.returncode, done.stdout, done.stderr) == (REFUSED, "", "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
def test_a_warning_that_cannot_be_written_fails_no_command(monkeypatch, capfd):
    def warns(words):
        print("warning", file=sys.stderr, flush=True)
        print("done")
        return 0

    monkeypatch.setattr(command_line, "_run", warns)
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stderr", full)
        assert main([]) == 0
    assert capfd.readouterr().out == "done\n"


def test_a_folder_that_was_removed_is_no_fault_of_the_program(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "removed"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    assert main(["columns", "x.csv"]) == REFUSED
    assert capsys.readouterr().err.startswith("pa10cal: the working folder: it has been removed")
    assert main(["--version"]) == 0


@pytest.mark.parametrize(
    ("words", "shown"),
    [("--version run", "pa10cal "), ("--help --version", "usage: "), ("-h -h", "usage: ")],
)
def test_what_stands_first_is_answered_whatever_follows(words, shown, capsys):
    assert main(words.split()) == 0
    assert capsys.readouterr().out.startswith(shown)


@pytest.mark.parametrize(
    ("words", "code"), [("--version >&-", 0), ("effects >&-", 0), ("nosuch 2>&-", REFUSED)]
)
def test_a_closed_output_is_silence(words, code):
    done = ended(words)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")


def test_parents_that_are_no_numbers_are_nobody():
    assert ended("--version", PA10CAL_PARENTS="mine 1.5").returncode == 0


def test_letters_that_the_output_lacks_are_written_by_their_numbers():
    done = ended("effects", PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert "\\xb0" in done.stdout or "\\u" in done.stdout


def ended(words, **environment):
    """Run the program in a shell, and return how it ended."""
    command = f"{shlex.quote(sys.executable)} -m pa10cal {words}"
    return subprocess.run(
        ["bash", "-c", command],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("argv", "hint"),
    [
        ("effects --robt ur10", "unrecognized arguments: --robt ur10; did you mean '--robot'?"),
        (
            "predict --modle m --joints j.csv --out o.csv",
            "arguments are required: --model; --modle is unknown: did you mean '--model'?",
        ),
        ("effects --robo=ur10", "; did you mean '--robot'?"),  # no abbreviations
    ],
)
def test_an_option_that_was_mistyped_is_named(capsys, argv, hint):
    with pytest.raises(SystemExit) as caught:
        main(argv.split())
    assert caught.value.code == REFUSED
    assert hint in capsys.readouterr().err


@pytest.mark.parametrize("words", [[], ["calibrat"], ["--colour"]])
def test_without_a_command_the_list_is_shown_and_the_use_refused(words, capsys):
    assert main(words) == REFUSED
    assert "usage: pa10cal COMMAND" in capsys.readouterr().err


def test_the_command_that_was_probably_meant_is_named(capsys):
    assert main(["calibrat"]) == REFUSED
    assert "did you mean 'calibrate'?" in capsys.readouterr().err


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself_and_each_of_its_arguments(name, capsys):
    with pytest.raises(SystemExit) as caught:
        main([name, "--help"])
    assert caught.value.code == 0
    assert f"usage: pa10cal {name}" in capsys.readouterr().out
    documented = command_named(name).__doc__
    arguments = [each for each in command_named(name).__annotations__ if each != "return"]
    assert all(f"{argument}: " in documented for argument in arguments)


def test_help_needs_no_heavy_library():
    script = (
        "import sys; from pa10cal.commands.command_line import COMMANDS, main\n"
        "for words in (['--help'], *([name, '--help'] for name in COMMANDS)):\n"
        "    try: main(words)\n"
        "    except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'pandas', 'pyarrow', 'matplotlib', 'pinocchio'}\n"
        "sys.exit(' '.join(heavy & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_an_interrupt_while_it_starts_is_one_line():
    code = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # ignored below some shells
        "class Interrupting:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'pa10cal.commands.command_line':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupting())\n"
        "from pa10cal.__main__ import start\n"
        "sys.exit(start())"
    )
    done = subprocess.run([sys.executable, "-c", code, "doctor"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (INTERRUPTED, "pa10cal: interrupted\n")


@pytest.mark.parametrize("handler", [None, signal.SIG_IGN, print])
def test_a_handler_of_interrupts_that_is_not_pythons_own_stays(monkeypatch, handler):
    """None is one that Python did not install, and cannot install again."""
    monkeypatch.setattr(signal, "getsignal", lambda number: handler)
    monkeypatch.setattr(__main__, "main", lambda: 0)
    installed = []
    monkeypatch.setattr(signal, "signal", lambda *words: installed.append(words))
    assert __main__.start() == 0
    assert installed == []


@pytest.mark.parametrize(
    ("package", "code", "message"),
    [
        ("matplotlib", REFUSED, "the package matplotlib is not installed"),
        ("pydantic", FAULT, "internal fault: ModuleNotFoundError: import of pydantic halted"),
    ],
)
def test_a_package_that_the_module_of_a_command_lacks_is_one_line(
    tmp_path, monkeypatch, capsys, package, code, message
):
    (tmp_path / "command_of_a_test.py").write_text(f"import {package}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setitem(COMMANDS, "plan", "command_of_a_test")
    assert main(["plan"]) == code
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
    assert main(["plan", "--debug"]) == code
    assert "Traceback" in capsys.readouterr().err


HOSTILE = "a\x1b[2Jb\x9bc\u202ed\u2066e\u200ff\u2028g\rh\x00\udc80"
SHOWN = r"a\x1b[2Jb\x9bc\u202ed\u2066e\u200ff\u2028g\rh\x00\udc80"


def test_nothing_that_a_terminal_obeys_is_printed(monkeypatch, capfd):
    """Whoever prints it, and wherever; lines of our own messages stay."""

    def prints(words):
        print(HOSTILE, "two\nlines\tand a tab")
        print(HOSTILE, file=sys.stderr)
        sys.stderr.writelines([HOSTILE, "\n"])
        RunDisplay(lines=True).started(1, "ingest", HOSTILE)
        return 0

    monkeypatch.setattr(command_line, "_run", prints)
    before = sys.stdout, sys.stderr
    assert command_line.main([]) == 0
    assert (sys.stdout, sys.stderr) == before
    out, err = capfd.readouterr()
    assert out == f"{SHOWN} two\nlines\tand a tab\n"
    assert err.startswith(f"{SHOWN}\n{SHOWN}\n")
    assert not set(out + err) & set(HOSTILE) - set(SHOWN)


def test_a_refusal_is_one_line_whatever_a_file_holds(capsys):
    def refuses(arm: str, *, out: Path) -> None:
        raise RawDataError(
            f"what {HOSTILE}",
            where=f"{HOSTILE}\npa10cal ingest: all is well",
            value=HOSTILE,
            allowed=f"this\r\n{HOSTILE}",
            remedy=HOSTILE,
        )

    assert run_command("ingest", ["a", "--out", "b"], refuses) == REFUSED
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert message.isprintable() or message[:-1].isprintable()
    assert message.count(r"\x1b[2Jb") == 5
