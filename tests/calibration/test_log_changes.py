"""Changes of a log: what the remedy says makes the positions that the changes make."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from benchmarks.couplings import industrial, scara, telescope

from pa10cal.calibration.log_changes import (
    ChangedLog,
    CoupledAxes,
    LogChange,
    ReorderedColumns,
    ReversedSigns,
)
from pa10cal.campaign.column_map import ColumnMap
from pa10cal.files.arms import parse_arm

FANUC = {"joint": 3, "by": 2, "factor": 1}
WRIST = {"joint": 6, "by": 5, "factor": 1}
MOTOR = {"joint": 4, "by": 3, "factor": 1, "follows": True}
ARMS = {
    "plain": (lambda rng: industrial(rng, 1), []),
    "coupled": (lambda rng: industrial(rng, 1), [FANUC, WRIST]),
    "quill": (scara, [{"joint": 3, "by": 4, "mm_per_turn": 20.0}]),
    "one motor": (telescope, [MOTOR]),
}


def reversal(*axes):
    return ReversedSigns(axes)


def in_columns(*columns):
    return ReorderedColumns(columns)


def exchange(one, other):
    return ReorderedColumns.exchanged(6, one, other)


def coupling(axis, by, factor):
    return CoupledAxes(axis, by, factor)


def log_of(name, *changes):
    """Return a log of eight poses with changes, and what is in its columns [rad, m]."""
    rng = np.random.default_rng(3)
    rows, coupled = ARMS[name]
    arm = parse_arm({"name": "mine", "rows": rows(rng), "coupling": coupled}, where="mine.yaml")
    m = len(arm.axes_slide)
    columns = rng.normal(size=(8, m))
    signs = rng.choice([1, -1], m)
    offsets = np.where(arm.axes_slide, 0.0, rng.choice([0.0, 90.0], m))
    axes = signs * columns + np.radians(offsets)
    stated = {"signs": signs.tolist(), "offsets_deg": offsets.tolist(), "words": ColumnMap()}
    return ChangedLog(SimpleNamespace(arm=arm, axes=axes, **stated), changes), columns


def positions_as_stated(log, columns):
    """Return the joint positions (P, n) of columns if all that the remedy says is done."""
    remedy, checked = log.remedy, log.checked

    def stated(key, otherwise):
        found = re.search(rf"{key}: (\[.*?\])", remedy)
        return np.array(yaml.safe_load(found[1]) if found else otherwise)

    order = np.arange(columns.shape[1])
    if found := re.search(r"exchange the columns q(\d), q(\d)", remedy):
        both = [int(number) - 1 for number in found.groups()]
        order[both] = both[::-1]
    if found := re.search(r"in the order (q[q0-9, ]*\d)", remedy):
        order = np.array([int(number) - 1 for number in re.findall(r"\d", found[1])])
    signs = stated("joint_signs", checked.signs)
    offsets = np.radians(stated("joint_offsets_deg", checked.offsets_deg))
    coupled = log.coupled if "coupling: [" in remedy else checked.arm.coupled
    return replace(checked.arm, coupled=coupled).coupling.to_joints(
        signs * columns[:, order] + offsets
    )


CHANGES: dict[str, tuple[str, list[LogChange]]] = {
    "a sign of a coupled axis": ("coupled", [reversal(3)]),
    "all signs": ("quill", [reversal(1, 2, 3, 4)]),
    "a shift": ("coupled", [in_columns(2, 3, 4, 5, 6, 1), reversal(4)]),
    "three exchanges that are one": (
        "plain",
        [exchange(1, 2), exchange(2, 3), exchange(1, 2)],
    ),
    "a coupling, then a sign": ("plain", [coupling(3, 2, 1.0), reversal(3)]),
    "a sign, then a coupling": ("plain", [reversal(2), coupling(3, 2, 1.0)]),
    "couplings of couplings": ("plain", [coupling(5, 4, 1.0), coupling(6, 5, -1.0)]),
    "a coupling less": ("coupled", [coupling(3, 2, -1.0), exchange(4, 6)]),
    "a screw and a sign": ("quill", [coupling(3, 4, 0.003), reversal(4)]),
    "a motor of two slides": ("one motor", [coupling(4, 2, 1.0), reversal(3)]),
}


@pytest.mark.parametrize("title", CHANGES)
def test_the_remedy_makes_the_changes(title):
    name, changes = CHANGES[title]
    log, columns = log_of(name, *changes)
    assert log.can_be_stated
    np.testing.assert_allclose(positions_as_stated(log, columns), log.q, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("plain", [coupling(1, 2, 1.0), coupling(2, 1, -1.0)]),
        ("coupled", [coupling(5, 6, 1.0)]),
    ],
)
def test_axes_that_each_move_the_other_cannot_be_stated_one_after_the_other(name, changes):
    log, columns = log_of(name, *changes)
    assert not log.can_be_stated
    assert not np.allclose(positions_as_stated(log, columns), log.q)


def test_signs_may_be_set_in_the_description_where_nothing_else_is_wrong():
    assert "in the arm's description" in log_of("plain", reversal(2))[0].remedy
    changes = reversal(2), coupling(3, 1, 1.0)
    assert "reverse the axis" not in log_of("plain", *changes)[0].remedy


def test_signs_of_some_joints_are_told_as_those():
    arm = log_of("plain")[0].checked.arm
    assert reversal(2).text(arm) == "the sign of joint 2 is reversed"
    assert reversal(2, 5).text(arm) == "the signs of joints 2, 5 are reversed"
    assert reversal(1, 2, 3, 4, 5, 6).text(arm) == "the signs of all joints are reversed"
