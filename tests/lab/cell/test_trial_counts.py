"""Numbers of blind trials."""

from pa10cal.evaluation.options import BlindTrialsOptions, TrialCounts, WildCounts
from pa10cal.lab.cell.effects.vocabulary import outside, vocabulary
from pa10cal.lab.cell.trials import subjects_of, trial_counts


def test_singles_and_effects_outside_count_their_rounds():
    full = trial_counts(TrialCounts(null=7, single=2, outside=3, pair=1))
    assert full["null"] == 7
    assert full["pair"] == 1
    assert full["single"] == 2 * len(vocabulary())
    assert full["outside"] == 3 * len(outside())


def test_rounds_of_wild_trials_go_through_what_the_cell_puts_in():
    wild = trial_counts(WildCounts(right=3, stressed=1, effect=1, beyond=1, fault=1))
    found = {kind: len(subjects_of(kind)) for kind in ("stressed", "beyond", "fault")}
    assert {kind: wild[kind] for kind in found} == found
    assert wild["right"] == 3
    assert wild["effect"] == len(vocabulary())


def test_the_studies_are_as_large_as_their_bars_need():
    options = BlindTrialsOptions()
    tracked = trial_counts(options.tracked)
    assert tracked["null"] >= 150
    assert tracked["single"] >= 150
    assert trial_counts(options.full)["single"] >= 380
    assert trial_counts(options.reduced)["single"] == len(vocabulary())
    assert sum(trial_counts(options.wild).values()) >= 300
    assert trial_counts(options.unstated) == {"unstated_masses": 210}
    assert trial_counts(options.sorted_by_joint)["sorted_rows"] >= 100  # none may go wrong
