"""Small simulated campaigns to be mutated; as they are they are graded good."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from importlib.resources import files as resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.fuzz.mutations import Files
from pa10cal.campaign.read import read_campaign
from pa10cal.files.arms import load_arm
from pa10cal.frame.point_fits import fit_rigid
from pa10cal.interface import calibrate
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.options import CellPosesOptions, SimulateOptions, TrackerOptions
from pa10cal_lab.cell.write import write_campaign

Array = NDArray[np.float64]

#: Where predictions are compared: so many postures of the campaign's own.
_POSTURES = 60

#: One campaign an instrument, small enough to be judged some thousand times.
CAMPAIGNS = {
    "pose": SimulateOptions(
        robot="ur10", random_seed=1, without_touches=TrackerOptions(instrument="pose", poses=130)
    ),
    "points": SimulateOptions(
        robot="irb120", random_seed=2, without_touches=TrackerOptions(instrument="points", poses=80)
    ),
    "distance": SimulateOptions(
        robot="irb120",
        random_seed=3,
        without_touches=TrackerOptions(instrument="distance", poses=450),
    ),
    "touched": SimulateOptions(
        random_seed=4,
        loads_N=(0.0, 44.0),
        repeats=1,
        holdout_points=3,
        holdout_repeats=1,
        poses=CellPosesOptions(layout="wide", wide_poses=24),
    ),
}


@dataclass(frozen=True, eq=False)
class Original:
    """A campaign as it was measured.

    Attributes:
        files: its files by name.
        q_rad: (N, n) postures at which its model is compared with others.
        p_m: (N, 3) where its model puts the target [m].
        u_mm: root mean square of the standard uncertainty of that.
    """

    files: Files
    q_rad: Array
    p_m: Array
    u_mm: float

    @classmethod
    def simulated(cls, name: str) -> Original:
        """Return one of `CAMPAIGNS`."""
        settings = CAMPAIGNS[name]
        with tempfile.TemporaryDirectory() as folder:
            raw = Path(folder) / "raw"
            write_campaign(simulate_campaign(name, load_arm(settings.robot), settings), raw)
            arm = resources("pa10cal.files").joinpath("arms", f"{settings.robot}.yaml")
            (raw / f"{settings.robot}.yaml").write_bytes(arm.read_bytes())
            campaign = read_campaign(raw)
            content = {path.name: path.read_bytes() for path in sorted(raw.iterdir())}
        model = calibrate(campaign)
        q_rad = campaign.observations.of_kind("grid").states.q_rad[:_POSTURES]
        predicted = model.predict(q_rad, frame="tool")
        u_mm = float(np.sqrt(np.mean(predicted.u_mm**2)))
        return cls(content, q_rad, predicted.T[:, :3, 3], u_mm)

    def off_mm(self, p_m: Array) -> float:
        """Return by how much other places (N, 3) are off, root mean square, wherever they stand."""
        carried = fit_rigid(p_m, self.p_m)
        away = p_m @ carried.T[:3, :3].T + carried.T[:3, 3] - self.p_m
        return float(1e3 * np.sqrt(np.mean(np.sum(away**2, axis=1))))
