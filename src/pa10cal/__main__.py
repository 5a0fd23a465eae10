"""Command line: `pa10cal <stage> …` runs one stage of the workflow."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from pa10cal.stages.command import REFUSED, limit_threads

#: Stage name and what it does, in the order of the workflow.
STAGES = {
    "fetch": "fetch a public data set and check it",
    "import": "a data set of another layout to campaigns",
    "import_arm": "an arm's description from a URDF",
    "simulate": "write a campaign with the virtual cell",
    "ingest": "raw logs to a table of poses",
    "seed": "base frame, and targets, from straight-line moves or the nominal arm",
    "calibrate": "calibration of one load case, by the paper's model or the general one",
    "montecarlo": "position error from resolver uncertainty in one plane",
    "discover": "which effect is missing from the model, and the gap with it closed",
    "evaluate": "held-out points and loads",
    "transfer": "a model of one campaign judged in another, only base and tool fitted there",
    "export": "the calibrated model as model.yaml and robot.urdf",
    "figures": "draw one figure or table",
    "blind_trials": "hide effects in campaigns of the virtual cell and judge them blindly",
    "score_trials": "hold verdicts on blind trials against what was hidden",
    "trial_figures": "draw one figure or table of blind trials",
    "curve": "a curve as links, their joint angles, and how they move",
    "draw_curve": "draw what the stage curve found, or show it moving",
    "curve_calibration": "calibrate a chain of links posed along curves, in the virtual cell",
    "draw_curve_calibration": "draw one figure or table of it",
    "coverage": "count how often intervals hold the truth of simulated campaigns",
    "coverage_general": "the same with the general model, arm by arm, instrument by instrument",
}

#: Stages whose module cannot have their name, as it is a word of Python.
_MODULES = {"import": "import_data"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one stage and return its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] in ("-h", "--help") or words[0] not in STAGES:
        lines = [f"  {name:<13} {what}" for name, what in STAGES.items()]
        print("usage: pa10cal STAGE [options]   (pa10cal STAGE --help)\n" + "\n".join(lines))
        return 0 if words and words[0] in ("-h", "--help") else REFUSED
    limit_threads()
    module = import_module(f"pa10cal.stages.{_MODULES.get(words[0], words[0])}")
    return int(module.main(words[1:]))


if __name__ == "__main__":
    sys.exit(main())
