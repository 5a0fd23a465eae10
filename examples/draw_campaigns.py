"""Draw the two campaigns beside this file, with the virtual cell: nobody measured them.

python examples/draw_campaigns.py examples

`irb120-points` is written as docs/raw-data.md has it. `ur10-pose` is written as the export of a
tracker's software may be: its campaign.yaml says under `columns` how to read that.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from scipy.spatial.transform import Rotation

from pa10cal.files.arms import load_arm
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.options import HiddenEffectOptions, SimulateOptions, TrackerOptions
from pa10cal_lab.cell.write import campaign_description, write_campaign

IRB120 = SimulateOptions(
    random_seed=120,
    robot="irb120",
    without_touches=TrackerOptions(instrument="points", poses=80, holdout_share=0.25),
)
#: Something for the program to find.
ECCENTRIC = HiddenEffectOptions(
    id="encoder_eccentricity", of="joint 2", parameters={"A": 4e-4, "phi": 0.8}
)
UR10 = SimulateOptions(
    random_seed=10,
    robot="ur10",
    hidden_effects=(ECCENTRIC,),
    without_touches=TrackerOptions(poses=300, holdout_share=0.0, tool_mass_kg=0.8),
)
FIRST_READING = pd.Timestamp("2026-03-02 08:00:00")
JOINTS = [f"J{joint} [rad]" for joint in range(1, 7)]
PLACE, TURN = ["X [m]", "Y [m]", "Z [m]"], ["Rx [deg]", "Ry [deg]", "Rz [deg]"]


def main(folder: Path) -> None:
    """Write both campaigns."""
    points = simulate_campaign("irb120-points", load_arm("irb120"), IRB120)
    write_campaign(points, folder / "irb120-points")

    pose = simulate_campaign("ur10-pose", load_arm("ur10"), UR10)
    table = pose.tables["poses"]
    own = pd.DataFrame({"Timestamp": FIRST_READING + pd.to_timedelta(table["time_s"], unit="s")})
    own["Timestamp"] = own["Timestamp"].dt.strftime("%d.%m.%Y %H:%M:%S")
    q_deg = table[[f"q{joint}_deg" for joint in range(1, 7)]]
    own[JOINTS] = np.radians(q_deg.to_numpy()).round(8)
    own[PLACE] = (1e-3 * table[["x_mm", "y_mm", "z_mm"]].to_numpy()).round(8)
    seen = Rotation.from_quat(table[["qw", "qx", "qy", "qz"]], scalar_first=True)
    own[TURN] = seen.as_euler("XYZ", degrees=True).round(6)
    text = own.to_csv(index=False, sep=";", decimal=",")
    content = campaign_description(pose) | {
        "files": {"poses": "tracker.txt"},
        "holdout": {"every": 5},
        "columns": {
            "poses": {
                "separator": ";",
                "decimal": ",",
                "time": {"names": "Timestamp", "format": "%d.%m.%Y %H:%M:%S"},
                "joints": {"names": JOINTS, "unit": "rad"},
                "position": {"names": PLACE, "unit": "m"},
                "rotation": {"names": TURN, "convention": "euler_XYZ", "unit": "deg"},
            }
        },
    }
    place = folder / "ur10-pose"
    place.mkdir(parents=True, exist_ok=True)
    (place / "tracker.txt").write_text(text, encoding="utf-8")
    described = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=90)
    (place / "campaign.yaml").write_text(described, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
