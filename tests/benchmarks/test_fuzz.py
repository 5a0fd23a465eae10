import re

import numpy as np
import pytest
from benchmarks.fuzz import __main__ as fuzz
from benchmarks.fuzz import readers
from benchmarks.fuzz.corpus import Original
from benchmarks.fuzz.judge import judged_campaign, judged_settings
from benchmarks.fuzz.mutations import mutated


@pytest.fixture(scope="module")
def points():
    return Original.simulated("points")


def test_a_campaign_as_it_was_is_good(points):
    assert judged_campaign(points.files, points).word == "good"


def test_a_right_model_of_another_robot_is_told(points):
    other = Original.simulated("pose")
    assert judged_campaign(other.files, points).word == "wrong"


def test_mutations_are_the_same_again_and_differ():
    files = {"campaign.yaml": b"name: a\n", "poses.csv": b"a,b\n1,2\n3,4\n"}
    first, again, other = (mutated(np.random.default_rng(seed), files) for seed in (1, 1, 2))
    assert first == again
    assert first != other
    assert files == {"campaign.yaml": b"name: a\n", "poses.csv": b"a,b\n1,2\n3,4\n"}


def test_settings_are_read_or_refused():
    assert judged_settings(b"campaigns: [a]\n").word == "read"
    assert judged_settings(b"campaigns: [a\n").word == "refused"
    assert judged_settings(b"campaigns: 3\n").word == "refused"


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=[pytest.mark.slow] * (kind in ("workbook", "model")))
        for kind in readers.READERS
    ],
)
def test_files_as_they_were_are_read_and_changed_ones_never_fail(kind, tmp_path):
    for name, content in readers.originals()[kind].items():
        (tmp_path / name).write_bytes(content)
    readers.READERS[kind](tmp_path)
    judged = [readers.judged_file(kind, np.random.default_rng([3, k])) for k in range(12)]
    assert not [done for done, outcome in judged if outcome.bad]
    assert {outcome.word for _, outcome in judged} <= {"read", "refused"}


@pytest.mark.slow
@pytest.mark.parametrize("kind", fuzz.EVERY_KIND)
def test_no_mutation_ends_in_a_fault(kind, capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["fuzz", "--count", "25", "--kinds", kind, "--seed", "7"])
    assert fuzz.main() == 0
    assert re.search(r"25 mutations, 0 that must not be", capsys.readouterr().out)
