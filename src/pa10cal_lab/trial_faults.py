"""What the verdict on a blind trial says of the log, compared with what was put into the raw files.

A stressor is what ordinary logs have; a fault has to be reported. A verdict `none` on a campaign
in which something large is wrong, without a report, is false comfort.
"""

from __future__ import annotations

import re

from pa10cal_lab.blind_trial import BlindTrial
from pa10cal_lab.cell.measured_trials import SUBJECTS
from pa10cal_lab.trial_records import TrialDisturbance

#: Change of the residual over the noise floor from which a fault has to be reported.
_FAULT_RATIO = 3.0
#: Grade of a calibration, and word of a verdict, by which the data are suspect.
_SUSPECT, CHECK = "suspect_input", "check_the_log"
#: Faults without a place that a verdict could name.
_PLACED_BY_KIND = ("step_in_time", "payload")
#: Words that offer another cause of a motion: rows that follow a joint, a rail or a load.
_RIVAL = re.compile(r"\bjoint \d|\brail\b|\bload\b|\border of (the )?rows\b", re.I)
#: The fault and the effect that are motions over time, and words for one without a name.
_IN_TIME, _DRIFT = "step_in_time", "base_drift"
_OF_MOTION = re.compile(r"\b(moved|wander|drift|crept|creep)", re.I)


def has_fault(trial: BlindTrial) -> bool:
    """Return whether the log has a fault that should be reported."""
    return any(map(_should_be_reported, trial.put_in))


def _should_be_reported(put_in: TrialDisturbance) -> bool:
    return not put_in.stressor or bool(put_in.kinds)


def matters(trial: BlindTrial, put_in: TrialDisturbance) -> bool:
    """Return whether a stressor or fault is at least `_FAULT_RATIO` noise floors.

    One that cannot be measured matters if it should be reported, as do all of a trial without a
    verdict.
    """
    if not put_in.measured:
        return _should_be_reported(put_in)
    return trial.verdict is None or (trial.moved_over_floor(put_in) or 0.0) >= _FAULT_RATIO


def is_reported(trial: BlindTrial, put_in: TrialDisturbance) -> bool:
    """Return whether a fault is reported: by kind and place, by a refusal or by a suspicion.

    A wrong description that calibration corrects is reported as a departure.
    """
    verdict, where = trial.verdict, set(put_in.where)
    if verdict is None:
        return trial.refused
    if verdict.grade == _SUSPECT:
        return True
    of_poses = not {"outlier", "label"}.isdisjoint(put_in.kinds)
    if where and of_poses and where <= set(verdict.left_out):
        return True
    if where and where <= set(verdict.departures):
        return True
    # Whole words: `joint 1` is not in `joint 10`, nor `1.5` in `21.5`.
    places = [re.compile(rf"(?<![\w.]){re.escape(place)}(?![\w.])") for place in where]
    return any(
        fault.kind in put_in.kinds
        and (fault.kind in _PLACED_BY_KIND or any(place.search(fault.where) for place in places))
        for fault in verdict.faults
    )


def hides_much(trial: BlindTrial) -> bool:
    """Return whether a hidden effect is at least `_FAULT_RATIO` noise floors."""
    return any((trial.moved_over_floor(each) or 0.0) >= _FAULT_RATIO for each in trial.hidden)


def has_false_comfort(trial: BlindTrial) -> bool:
    """Return whether the verdict is `none` though something large is wrong and not reported."""
    if trial.verdict is None or trial.verdict.word != "none":
        return False
    if trial.kind in SUBJECTS:
        return any(map(trial.is_detectable, trial.hidden))
    unreported = (each for each in trial.put_in if not is_reported(trial, each))
    return any(matters(trial, each) for each in unreported) or hides_much(trial)


def suspects_data(trial: BlindTrial) -> bool:
    """Return whether the campaign is refused, or its data are reported as suspect."""
    if trial.verdict is None:
        return trial.refused
    return trial.verdict.word == CHECK or trial.verdict.grade == _SUSPECT


def motions_as_facts(trial: BlindTrial) -> tuple[str, ...]:
    """Return statements about motions over time that mention no other possible cause."""
    if trial.verdict is None:
        return ()
    unexplained = () if trial.verdict.unexplained is None else trial.verdict.unexplained.all
    motions = (
        *(fault.what for fault in trial.verdict.faults if fault.kind == _IN_TIME),
        *(each.why for each in unexplained if _OF_MOTION.search(each.why)),
        *(found.either for found in trial.effects if found.id == _DRIFT),
    )
    return tuple(text for text in motions if not _RIVAL.search(text))
