"""Blind trials that nobody ran: verdicts and truths of a few words each."""

from __future__ import annotations

import csv
import json

from made_up_records import accuracy, effect, made_up_gap, set_gap, verdict_keys
from pa10cal.commands.command_line import run_command
from pa10cal.results.codec import lines
from pa10cal.results.discovery import AllUnexplained, Fault, ProposedFormula, Unexplained
from pa10cal.results.record import EffectName
from pa10cal_lab.blind_trial import BlindTrial
from pa10cal_lab.scores import scores_record
from pa10cal_lab.trial_records import (
    FailedTrialRecord,
    HiddenEffect,
    JudgedTrialRecord,
    TrialDisturbance,
    TrialHealth,
    TrialTruthRecord,
)


def named(name, *alternatives, **parameters):
    """A finding, of parameters (value, standard uncertainty) by name."""
    return effect(name.id, name.of, parameters, alternatives)


def hidden(name, size=1.0, moved_mm=0.05, apart_mm=None, outside=None, **parameters):
    """An effect that is hidden."""
    return HiddenEffect(
        id=name.id,
        of=name.of,
        parameters=parameters,
        size=size,
        moved_mm=moved_mm,
        apart_mm=apart_mm,
        outside=outside,
    )


def put_in(id, where, stressor, kinds, measured, moved_mm):
    """A stressor or a fault."""
    return TrialDisturbance(
        id=id, where=where, stressor=stressor, kinds=kinds, measured=measured, moved_mm=moved_mm
    )


def verdict(
    *effects,
    word=None,
    places=(),
    not_testable=(),
    indistinguishable=(),
    springs=(),
    noise_floor_mm=0.005,
    after_mm=0.01,
    before_mm=None,
    seconds=2.0,
    faults=(),
    motions=(),
    health=None,
    proposed=(),
):
    """A verdict: its word follows from the effects where none is given.

    Args:
        effects: of `named`.
        word: the verdict in a word.
        places: where something without a name sits.
        not_testable, indistinguishable: names, and groups of names.
        springs: joints of the judged model that have one.
        noise_floor_mm: mean error of noise alone.
        after_mm: held-out error with the effects; None without held-out poses.
        before_mm: the same without; None for as much.
        seconds: what judging took.
        faults: kinds and places.
        motions: what is said of something without a name.
        health: grade, poses left out, and departures that were found; None where not known.
        proposed: form, place and numbers of formulas.
    """
    alone = not any(each.alternatives for each in effects)
    gap = made_up_gap(noise_floor_mm=noise_floor_mm)
    held_out = None
    if after_mm is not None:
        held_out = set_gap(accuracy(before_mm or after_mm), accuracy(after_mm))
    word = word or (("named" if alone else "ambiguous") if effects else "none")
    keys = dict(verdict_keys(word, effects, places=places, not_testable=not_testable))
    if motions:
        said = [
            Unexplained(of=None, form=None, shared_error_mm=None, why=motion) for motion in motions
        ]
        keys["unexplained"] = AllUnexplained(**dict(said[0]), all=tuple(said))
    keys |= {
        "gap": gap.model_copy(update={"holdout": held_out}),
        "indistinguishable": tuple(
            tuple(EffectName(id=name.id, of=name.of) for name in group)
            for group in indistinguishable
        ),
        "faults": tuple(
            Fault(kind=kind, where=where, what="made up", remedy="none", gain=None)
            for kind, where in faults
        ),
        "proposed": tuple(
            ProposedFormula.model_construct(form=form, of=of, numbers=tuple(numbers))
            for form, of, *numbers in proposed
        ),
    }
    grade, left_out, departures = health or (None, (), ())
    return JudgedTrialRecord(
        **keys,
        campaign="trial",
        springs=springs,
        health=health
        and TrialHealth(
            grade=grade, findings=(), departures=tuple(departures), left_out=tuple(left_out)
        ),
        seconds=seconds,
        seconds_simulating=1.0,
    )


def trial(
    kind,
    what,
    said,
    *,
    campaign="trial",
    layout="grid",
    measured="touched",
    springs=(2, 3, 5),
    put_in=(),
    noise_mm=None,
    refused=False,
    failed="KeyError: x",
):
    """A trial.

    Args:
        kind: what it hides, in a word.
        what: what it hides, of `hidden`.
        said: of `verdict`; None where it failed.
        campaign: its name.
        layout: of its poses, or arm and instrument.
        measured: which study it is of.
        springs: joints of the arm that have one.
        put_in: of `put_in`.
        noise_mm: what noise alone leaves, where the truth says so.
        refused: whether it was refused.
        failed: the message where there is no verdict.
    """
    truth = TrialTruthRecord(
        campaign=campaign,
        kind=kind,
        measured=measured,
        layout=layout,
        path="same",
        temperature_drift_C=0.0,
        flexible_joints=springs,
        hidden_effects=tuple(what),
        put_in=tuple(put_in),
        stated_uncertainty_mm=None,
        mass_factor=(),
        seconds_twin=1.0,
        noise_mm=noise_mm,
    )
    failure = FailedTrialRecord(campaign=campaign, failed=failed, refused=refused)
    return BlindTrial(truth, said or failure)


def scored(trials):
    """The scores of trials, each under a name of its own."""
    named = []
    for number, each in enumerate(trials):
        name = {"campaign": f"trial-{number}"}
        truth, said = (record.model_copy(update=name) for record in (each.truth, each.judgement))
        named.append(BlindTrial(truth, said))
    return scores_record(named)


def scored_by_command(folder, *trials):
    """The scores that the command makes of trials in a folder, and the rows of its table."""
    paths = {name: folder / name for name in ("verdicts", "truths", "scores", "trials")}
    paths["verdicts"].write_text(lines([each.judgement for each in trials]), "utf-8")
    paths["truths"].write_text(lines([each.truth for each in trials]), "utf-8")
    words = [word for name, path in paths.items() for word in (f"--{name}", str(path))]
    assert run_command("score_trials", words) == 0
    with paths["trials"].open(encoding="utf-8", newline="") as table:
        return json.loads(paths["scores"].read_text("utf-8")), list(csv.DictReader(table))


def figures(trials):
    """The figures of trials by what they are, with the group behind a bar where there is one."""
    scores = scored(trials)
    rows = (*scores.bars, *scores.rates)
    return {f"{row.what}{' | ' if row.by else ''}{row.by}": row for row in rows}
