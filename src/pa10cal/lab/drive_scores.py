"""What trials of drives come to: sensors and gears named, or not, and false names."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from pa10cal.lab.blind_trial import MAP, BlindTrial
from pa10cal.lab.trial_rates import Outcomes, at_least, at_most, bars_of, of_trials
from pa10cal.results.trials import DriveJoint, DriveScoresRecord, DriveTrial, Outcome

SENSOR, GEAR = "sensor_error", "gear_error"
NEITHER = "neither"
_BY_ANGLE = (SENSOR, GEAR, MAP)
_RIGHT, _FALSE = 0.95, 0.02
_PROVENANCE = "synthetic: virtual cell; robots, poses, noise, errors of drives and ripple drawn"


def scores_record(trials: Sequence[BlindTrial]) -> DriveScoresRecord:
    """Return what trials of drives come to."""
    return DriveScoresRecord(
        provenance=_PROVENANCE,
        trials=len(trials),
        bars=bars_of(_TABLE, trials),
        joints=tuple(joint for trial in trials for joint in _joints(trial)),
        per_trial=tuple(map(_trial, trials)),
    )


def outcome(trial: BlindTrial, of: str) -> tuple[Outcome, tuple[str, ...]]:
    """Return what became of a joint that errs, and what its error was called."""
    if trial.verdict is None:
        return "failed", ()
    hidden = {each.id for each in trial.hidden if each.of == of}
    found = [named for named in trial.verdict.effects if named.of == of]
    called = [
        [name.id for name in named.all_names if name.of == of and name.id in _BY_ANGLE]
        for named in found
        if named.id in _BY_ANGLE
    ]
    if not called:
        return "missed", ()
    names = tuple(called[0])
    causes = set(names) & {SENSOR, GEAR}
    if not causes:
        return "no_cause", names
    if causes == hidden:
        return "right", names
    return ("ambiguous" if hidden & causes else "wrong"), names


def false_names(trial: BlindTrial) -> tuple[str, ...]:
    """Return the names of a verdict where nothing of that name is hidden; maps are none."""
    if trial.verdict is None:
        return ()
    hidden = {each.name for each in trial.hidden}
    return tuple(
        f"{named.id} of {named.of}"
        for named in trial.verdict.effects
        if named.id != MAP and not hidden & set(named.all_names)
    )


def _joints(trial: BlindTrial) -> Iterable[DriveJoint]:
    """Yield what became of each joint that errs."""
    hidden = () if trial.kind == NEITHER else trial.hidden
    for of, ratio in {each.of: each.parameters["ratio"] for each in hidden}.items():
        became, called = outcome(trial, of)
        yield DriveJoint(
            campaign=trial.truth.campaign,
            bench=trial.truth.layout,
            of=of,
            errs=trial.kind,
            ratio=float(str(ratio)),
            called=called,
            outcome=became,
        )


def _trial(trial: BlindTrial) -> DriveTrial:
    verdict = trial.verdict
    return DriveTrial(
        campaign=trial.truth.campaign,
        bench=trial.truth.layout,
        errs=trial.kind,
        verdict=f"failed: {trial.failed}" if verdict is None else verdict.word,
        false_names=false_names(trial),
        seconds=None if verdict is None else verdict.seconds,
    )


def _joints_that_are(became: Outcome, *errs: str) -> Outcomes:
    """Return whether the joints of a trial have come to that, where one of these errs."""
    return lambda trial: (joint.outcome == became for joint in _joints(trial) if joint.errs in errs)


def _is_named(trial: BlindTrial) -> bool:
    """Return whether something is named where nothing is; a trial that failed counts as one."""
    return bool(false_names(trial)) or trial.verdict is None


_ERRING = ("sensor", "gear", "both")
_TABLE = {
    "joints whose sensor or gear errs: named right": at_least(
        _RIGHT, _joints_that_are("right", *_ERRING)
    ),
    "joints whose sensor errs: named right": at_least(_RIGHT, _joints_that_are("right", "sensor")),
    "joints whose gear errs: named right": at_least(_RIGHT, _joints_that_are("right", "gear")),
    "joints whose sensor and gear err: named right": at_least(
        _RIGHT, _joints_that_are("right", "both")
    ),
    "joints whose sensor or gear errs: a wrong name alone": at_most(
        _FALSE, _joints_that_are("wrong", *_ERRING)
    ),
    "trials in which nothing errs: a name": at_most(
        _FALSE, of_trials(lambda trial: trial.kind == NEITHER, _is_named)
    ),
}
