"""How to use the model: where it is, and what to type."""

from __future__ import annotations

from collections.abc import Iterator

from pa10cal.reports.blocks import Block, Callout, Code, Items, Paragraph, Section, grid
from pa10cal.reports.gathered import MODEL, Gathered
from pa10cal.results.health import UNRESERVED

_FILES = {
    MODEL: "the whole model, with effects and formulas; read by the commands below",
    "model/model.covariance.npz": "how uncertain its parameters are",
    "model/robot.urdf": "the rigid part, for simulators and planners",
    "model/dh.csv": "link parameters, nominal and calibrated",
    "model/ur_kinematics.yaml": "the rigid part for the UR driver for ROS 2",
    "discovery/suggested_poses.csv": "poses to measure next",
    "ingest/quarantine.csv": "raw rows that are not used, with the reason",
    "figures": "figures as SVG, PDF and PNG",
    "tables": "tables as CSV, Markdown and HTML",
}


def use(found: Gathered) -> Section:
    """Return what to type to predict and to compensate."""
    return Section("use", "How to use the model", tuple(_blocks(found)))


def _blocks(found: Gathered) -> Iterator[Block]:
    if found.model is None:
        yield Callout("missing", found.why_absent(MODEL))
    else:
        grade = None if found.calibration is None else found.calibration.health.grade
        doubtful = grade is not None and grade not in UNRESERVED
        if doubtful:
            yield Callout(
                "warning",
                f"The calibration is graded {grade}. The commands refuse its model without "
                "--force: mend the input first.",
            )
        yield Paragraph(
            f"Run the commands in the folder of these results, {found.folder.absolute().name}: the "
            "paths below begin there. Poses are in the robot's base frame. Angles are in degrees."
        )
        yield Code("Where is the tool at these joint positions?", _command("predict"))
        yield Code("Which joint positions bring the tool to these poses?", _command("compensate"))
        yield Code(
            "From Python",
            "import pa10cal\n\n"
            f'model = pa10cal.load_model("{MODEL}")\n'
            'found = model.predict(q_rad, frame="tool")  # found.T [m], found.u_mm, found.inside',
        )
        yield Items(
            (
                "joints.csv: id,q1_deg,…,load_N; a row for each pose to predict.",
                "targets.csv: id,x_mm,y_mm,z_mm,qw,qx,qy,qz; a row for each pose to reach.",
                "--frame flange gives the arm's last frame in place of the tool.",
            )
        )
    rows = [(file, what) for file, what in _FILES.items() if (found.folder / file).exists()]
    if rows:
        yield grid("Files of this campaign", ("file", "holds"), rows)


def _command(name: str) -> str:
    given, out = {"predict": ("joints", "poses"), "compensate": ("targets", "commands")}[name]
    return (
        f"pa10cal {name} --model {MODEL} \\\n  --{given} {given}.csv --out {out}.csv --frame tool"
    )
