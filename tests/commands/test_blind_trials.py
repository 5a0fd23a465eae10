"""Blind trials as commands: hidden, judged without the truth, scored apart."""

import csv
import json

import pytest

from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.files.output import whole_files as _whole
from pa10cal.results.discovery import VerdictRecord
from pa10cal_lab import blind_trials
from pa10cal_lab.cell.effects.vocabulary import vocabulary
from pa10cal_lab.trial_records import FailedTrialRecord, TrialScoresRecord, TrialTruthRecord

SEED = 20081
#: Modules of effects that the trials below hide; with others, the same numbers hide other effects.
DRAWN_FROM = ("joint", "structure")


@pytest.fixture(scope="module", autouse=True)
def same_trials():
    """Draw the same trials however far the vocabulary has grown; all of it is sought."""
    known = {
        name: each
        for name, each in vocabulary().items()
        if each.__module__.rsplit(".", 1)[1] in DRAWN_FROM
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pa10cal_lab.cell.trials.vocabulary", lambda: known)
        yield


def lines(path):
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run trials; return the exit code and the paths of verdicts and truths."""

    def stage(kind, count=1, *words):
        folder = tmp_path_factory.mktemp(kind)
        out = folder / "verdicts.jsonl", folder / "truths.jsonl"
        given = ["--kind", kind, "--count", str(count), "--random-seed", str(SEED), *words]
        code = run_command(
            "blind_trials", [*given, "--verdicts", str(out[0]), "--truths", str(out[1])]
        )
        return code, *out

    return stage


@pytest.fixture(scope="module")
def reduced(run):
    """Nulls of both layouts, strong singles of three families, and a pair; as judged."""
    runs = [
        run("null", 2),
        run("single", 1, "--first", "5", "--size", "2", "--layouts", "grid"),
        run("single", 1, "--first", "13", "--size", "2", "--layouts", "wide"),
        run("single", 1, "--first", "19", "--size", "2"),
        run("pair", 1, "--first", "3", "--size", "1.5"),
    ]
    assert [code for code, _, _ in runs] == [0] * len(runs)
    return [verdicts for _, verdicts, _ in runs], [truths for _, _, truths in runs]


def score(tmp_path, verdicts, truths):
    """Score; return the exit code, the record and the rows of the table."""
    out = tmp_path / "scores.json", tmp_path / "trials.csv"
    words = ["--verdicts", *map(str, verdicts), "--truths", *map(str, truths)]
    code = run_command("score_trials", [*words, "--scores", str(out[0]), "--trials", str(out[1])])
    if code:
        return code, None, None
    with out[1].open(encoding="utf-8", newline="") as table:
        return code, json.loads(out[0].read_text("utf-8")), list(csv.DictReader(table))


def figures(scores):
    """Figures by what they are; of groups that of the last."""
    return {row["what"]: row for row in (*scores["bars"], *scores["rates"])}


FOUND = "one effect, anything found: among the effect or its alternatives"
LARGE = "one effect, separable, residual 3 times the floor or more: right id and place"


@pytest.mark.slow
def test_a_reduced_set_is_named_right(reduced, tmp_path):
    code, scores, rows = score(tmp_path, *reduced)
    assert code == 0
    assert scores["schema"] == TrialScoresRecord.SCHEMA
    assert scores["provenance"].startswith("synthetic")
    assert scores["trials"] == 6
    found = figures(scores)
    for what, count, of in (
        ("nothing hidden: a name", 0, 2),
        ("nothing hidden: something without a name", 0, 2),
        (FOUND, 3, 3),
        ("one effect: a finding that matches no hidden effect", 0, 3),
        ("several effects: all named or in the alternatives", 1, 1),
        ("several effects: nothing extra", 1, 1),
        ("names of a probability of 0.95 or more: not hidden", 0, 5),
    ):
        assert (found[what]["count"], found[what]["trials"]) == (count, of), what
    alone = found["one effect, separable and large: named alone"]
    assert alone["trials"] >= 2
    assert alone["reached"] == 1.0
    gap = "held-out mean after naming, over that of campaigns without missing effect"
    assert found[gap]["reached"] < 1.3
    assert found["parameters of named effects: inside the 95 % interval"]["trials"] >= 5
    rms = found["parameters of named effects: score, root mean square"]["reached"]
    assert 0.2 < rms < 2.5
    single = [each for each in scores["subjects"] if each["kind"] == "single"]
    assert sum(each["counts"] == {each["id"]: 1} for each in single) == 3
    assert len({row["campaign"] for row in rows}) == 6
    assert [row["verdict"] for row in rows][:2] == ["none", "none"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "figure"),
    [
        (lambda said: {**said, "verdict": "none", "effects": []}, FOUND),
        (
            lambda said: {
                **said,
                "effects": [{**effect, "of": "joint 9"} for effect in said["effects"]],
            },
            LARGE,
        ),
        (
            lambda said: {
                "schema": VerdictRecord.SCHEMA,
                "campaign": said["campaign"],
                "failed": "x",
            },
            None,
        ),
    ],
    ids=["empty", "wrong place", "failed"],
)
def test_empty_wrong_and_failed_verdicts_are_scored_as_such(reduced, tmp_path, change, figure):
    verdicts, truths = reduced
    changed = tmp_path / "changed.jsonl"
    records = [change(said) for path in verdicts for said in lines(path)]
    changed.write_text("".join(json.dumps(record) + "\n" for record in records), "utf-8")
    _, scores, rows = score(tmp_path, [changed], truths)
    found = figures(scores)
    if figure is None:
        assert [row["said"] for row in rows] == ["crashed: x"] * 6
        assert found["nothing hidden: a name"]["count"] == 2
        assert {row["verdict"] for row in rows} == {"failed"}
        assert found[LARGE]["count"] == 0 < found[LARGE]["trials"]
    else:
        assert found[figure]["count"] == 0
    assert not all(bar["met"] for bar in scores["bars"] if bar["trials"] and bar["share"])


@pytest.mark.slow
def test_a_verdict_is_that_of_the_contract_and_says_nothing_of_what_was_drawn(reduced):
    for verdicts, truths in zip(*reduced, strict=True):
        for said, hidden in zip(lines(verdicts), lines(truths), strict=True):
            assert said["schema"] == VerdictRecord.SCHEMA
            assert hidden["schema"] == TrialTruthRecord.SCHEMA
            assert said["campaign"] == hidden["campaign"]
            assert said["verdict"] in ("none", "named", "ambiguous", "unexplained")
            assert {"effects", "unexplained", "not_testable", "gap", "suggested_poses"} <= set(said)
            assert 0.0 < said["seconds"] < 60.0
            assert not {"kind", "layout", "hidden_effects", "moved_mm"} & set(said)


@pytest.mark.slow
def test_what_moves_the_residual_is_measured_against_a_twin(reduced):
    hidden = [record for path in reduced[1] for record in lines(path)]
    moved = {
        record["kind"]: [effect["moved_mm"] for effect in record["hidden_effects"]]
        for record in hidden
    }
    assert moved["null"] == []
    assert len(moved["pair"]) == 2
    assert 0.01 < max(moved["pair"]) < 1.0
    assert moved["pair"][0] != moved["pair"][1]


@pytest.mark.slow
def test_the_same_trials_come_out_of_any_division_into_jobs(run, reduced):
    whole = lines(reduced[0][0])
    second = lines(run("null", 1, "--first", "1")[1])
    for record in (*whole, *second):
        for name in ("seconds", "seconds_simulating"):
            del record[name]
    assert second == whole[1:]


@pytest.mark.slow
def test_a_trial_that_fails_is_recorded_and_the_others_go_on(run, monkeypatch):
    judge, seen = blind_trials.judged_by_stages, []

    def fail_first(*about):
        seen.append(about)
        if len(seen) == 1:
            raise KeyError("a fault of the program")
        return judge(*about)

    monkeypatch.setattr(blind_trials, "judged_by_stages", fail_first)
    code, verdicts, truths = run("null", 2)
    assert code == 0
    failed, judged = lines(verdicts)
    assert failed["failed"].startswith("KeyError: 'a fault of the program'")
    assert judged["verdict"] == "none"
    assert len(lines(truths)) == 2


@pytest.mark.slow
def test_when_all_trials_fail_the_command_does(run, monkeypatch, capsys):
    def fail(*about):
        raise KeyError("a fault of the program")

    monkeypatch.setattr(blind_trials, "judged_by_stages", fail)
    code, verdicts, _ = run("null", 1)
    assert code == REFUSED
    assert "every trial failed" in capsys.readouterr().err
    assert "failed" in lines(verdicts)[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("null", 0), "no trial to run"),
        (("nul", 1), "unknown kind of trial"),
        (("null", 1, "--layouts", "grid,small"), "no such layout"),
        (("null", 1, "--first", "-1"), "--first: it is negative"),
        (("null", 1, "--random-seed", "-1"), "--random-seed: it is negative"),
        (("null", 1, "--measured", "tracked", "--layouts", "grid"), "ur10-pose"),
        (("null", 1, "--settings", '{"calibraton": {}}'), "did you mean 'calibration'"),
    ],
)
def test_refuses_what_makes_no_sense(run, capsys, words, message):
    code, verdicts, truths = run(*words)
    assert code == REFUSED
    assert message in capsys.readouterr().err
    assert not verdicts.exists()
    assert not truths.exists()


@pytest.fixture
def tried(monkeypatch):
    """Stand in for trials: every word is what the next of them does."""

    def stand_in(*words):
        left = list(words)

        def try_trial(trial, _settings):
            word = left.pop(0)
            if word == "interrupt":
                raise KeyboardInterrupt
            verdict = FailedTrialRecord(campaign=trial.name, failed=word, refused=word == "refused")
            truth = TrialTruthRecord.model_construct(campaign=trial.name)
            return verdict, truth

        monkeypatch.setattr(blind_trials, "try_trial", try_trial)
        monkeypatch.setattr(
            "pa10cal.results.codec.lines",
            lambda records: "".join(f"{r.campaign}\n" for r in records),
        )
        return left

    return stand_in


def test_trials_that_were_finished_when_it_was_interrupted_are_kept(run, tried):
    tried("refused", "crash", "interrupt", "crash")
    seen = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "pa10cal.files.output.whole_files", lambda *paths: seen.append(paths) or _whole(*paths)
        )
        assert run("null", 4, "--layouts", "grid, wide")[0] not in (0, REFUSED)
    ((verdicts, truths),) = seen
    assert len(verdicts.read_text("utf-8").splitlines()) == 2
    assert verdicts.read_text("utf-8") == truths.read_text("utf-8")


def test_places_that_cannot_be_written_are_refused_before_the_first_trial(tried, tmp_path, capsys):
    left = tried("crash")
    words = ["--kind", "null", "--count", "1", "--random-seed", "1", "--verdicts", str(tmp_path)]
    assert run_command("blind_trials", [*words, "--truths", str(tmp_path / "t")]) == REFUSED
    assert "cannot be written" in capsys.readouterr().err
    assert left == ["crash"]


def test_campaigns_that_are_all_refused_are_no_failure(run, tried):
    tried("refused", "refused")
    assert run("null", 2)[0] == 0


@pytest.fixture(scope="module")
def tracked(run):
    """A null, and a single that shows well, of trackers."""
    words = ("--measured", "tracked", "--layouts", "ur10-pose")
    runs = [run("null", 1, *words), run("single", 1, "--first", "1", *words)]
    assert [code for code, _, _ in runs] == [0, 0]
    return [verdicts for _, verdicts, _ in runs], [truths for _, _, truths in runs]


@pytest.mark.slow
def test_trackers_without_repeats_are_judged_by_blocks_and_scored_alike(tracked, tmp_path):
    code, scores, _ = score(tmp_path, *tracked)
    assert code == 0
    assert not any(trial["verdict"] == "failed" for trial in scores["per_trial"])
    found = figures(scores)
    assert found["nothing hidden: a name"]["count"] == 0
    testable = "one effect of plausible size, testable: among the effect or its alternatives"
    for what in (testable, FOUND):
        assert (found[what]["count"], found[what]["trials"]) == (1, 1)
    assert found["one effect: a confident wrong name"]["count"] == 0
    words = [bar["what"] for bar in scores["bars"]]
    assert any("plausible size" in word for word in words)
    (said,), (hidden,) = lines(tracked[0][1]), lines(tracked[1][1])
    assert said["method"]
    assert hidden["measured"] == "tracked"
    assert hidden["layout"] == "ur10-pose"
    assert hidden["hidden_effects"][0]["moved_mm"] > 0.01


@pytest.mark.slow
def test_a_verdict_without_a_truth_is_refused(reduced, tmp_path, capsys):
    verdicts, truths = reduced
    assert score(tmp_path, verdicts, truths[1:])[0] == REFUSED
    assert "but not both" in capsys.readouterr().err
    assert score(tmp_path, [*verdicts, verdicts[0]], truths)[0] == REFUSED
    assert "occurs twice" in capsys.readouterr().err
    assert score(tmp_path, truths, truths)[0] == REFUSED
    assert "not a record of this kind" in capsys.readouterr().err
    assert score(tmp_path, [tmp_path / "gone"], truths)[0] == REFUSED
    assert "the records are missing" in capsys.readouterr().err
