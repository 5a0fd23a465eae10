"""Faults of single poses or readings: labels and loads exchanged, a reading far off, a log cut."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from pa10cal.cell.disturbances.disturbance import Disturbance
from pa10cal.cell.disturbances.stressors import displaced
from pa10cal.cell.effects.effect import FinitePositive
from pa10cal.cell.raw_log import RawLog


class LabelsExchanged(Disturbance):
    """Two balls or targets are exchanged in one configuration."""

    id = "labels_exchanged"
    kinds = ("label",)
    needs = ("targets",)

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Exchange the labels of two that were seen."""
        number = int(rng.choice(log.of_kind("grid")))
        if log.touched:
            names = sorted(set(log.readings["ball"]))
            first, second = rng.choice(names, 2, replace=False).tolist()
            there = log.configuration == number
            balls = log.readings.loc[there, "ball"]
            log.readings.loc[there, "ball"] = balls.replace({first: second, second: first})
            return [log.label(number)]
        points = log.points
        chosen = rng.choice(len(points), 2, replace=False).tolist()
        one, other = (points[k] for k in chosen)
        seen = log.readings[[*one, *other]].notna().all(axis=1).to_numpy()
        number = int(rng.choice(np.intersect1d(log.of_kind("grid"), np.flatnonzero(seen))))
        values = log.readings.loc[number, [*one, *other]].to_numpy(copy=True)
        log.readings.loc[number, [*other, *one]] = values
        return [log.label(number)]


class PosesExchanged(Disturbance):
    """The labels of two poses are exchanged in one repeat."""

    id = "poses_exchanged"
    kinds = ("label", "outlier")
    needs = ("repeats", "tracker")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Exchange what the instrument read in two configurations."""
        one, other = rng.choice(log.of_kind("grid"), 2, replace=False).tolist()
        columns = [name for point in log.points for name in point]
        columns += [name for name in ("qw", "qx", "qy", "qz") if name in log.readings]
        values = log.readings.loc[[other, one], columns].to_numpy()
        log.readings.loc[[one, other], columns] = values
        return sorted({log.label(one), log.label(other)})


class LoadsExchanged(Disturbance):
    """Two loads are exchanged at one pose, in all repeats."""

    id = "loads_exchanged"
    measured = True
    kinds = ("load",)
    needs = ("loads", "touches")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Write the largest load for none, and none for the largest."""
        rows, grid = log.readings, log.readings["kind"] == "grid"
        label = str(rng.choice(sorted(set(rows.loc[grid, "pose"]))))
        least, most = rows.loc[grid, "load_N"].min(), rows.loc[grid, "load_N"].max()
        there = grid & (rows["pose"] == label)
        log.readings.loc[there, "load_N"] = rows.loc[there, "load_N"].replace(
            {least: most, most: least}
        )
        return [label]


class LoadMisstated(Disturbance):
    """One load is not what the log says: 40 N for 44."""

    id = "load_misstated"
    measured = True
    kinds = ("load",)
    needs = ("loads", "springs")

    part: FinitePositive = Field(0.909, description="stated over true")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """State another load in every row of the largest of the calibration poses."""
        del rng
        rows = log.readings
        most = float(rows.loc[rows["kind"] == "grid", "load_N"].max())
        stated = float(np.round(self.part * most))
        log.readings.loc[rows["load_N"] == most, "load_N"] = stated
        return [f"{stated:g} N"]


class _ReadingOff(Disturbance):
    """One reading of a pose is far off."""

    #: Kind of the pose.
    of_kind: ClassVar[str]
    kinds = ("outlier",)

    size_mm: FinitePositive = Field(description="by how much")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Move one reading in any direction."""
        number = int(rng.choice(log.of_kind(self.of_kind)))
        shift_mm = np.zeros((len(log.configurations), 3))
        shift_mm[number] = displaced(log.kind, self.size_mm, rng)
        log.move(shift_mm)
        return [log.label(number)]


class HeldOutReadingOff(_ReadingOff):
    """One reading of a held-out pose is far off."""

    id = "held_out_reading_off"
    of_kind = "holdout"

    size_mm: FinitePositive = Field(40.0, description="by how much")


class OneReadingOff(_ReadingOff):
    """One reading of a calibration pose is off."""

    id = "one_reading_off"
    of_kind = "grid"

    size_mm: FinitePositive = Field(5.0, description="by how much")

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return 2 to 30 mm."""
        del joints
        return {"size_mm": round(float(np.exp(rng.uniform(*np.log([2.0, 30.0])))), 2)}


class LogCut(Disturbance):
    """The joint log ends early."""

    id = "log_cut"
    needs = ("touches",)

    part: FinitePositive = Field(0.04, description="what is left of it")

    def put_into(self, log: RawLog, rng: np.random.Generator) -> Iterable[str]:
        """Keep the first rows."""
        del rng
        log.tables["resolver"] = log.joints.iloc[: max(1, round(self.part * len(log.joints)))]
        return ["resolver"]
