"""Calibrate the arm of a campaign, find what its model lacks, and take the model away.

python examples/calibrate_and_discover.py data/raw/cell-a model.yaml

The campaigns shipped with the package are synthetic.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import pa10cal


def main(folder: Path, out: Path) -> None:
    """Print what was found, and write the model."""
    campaign = pa10cal.read_campaign(folder)
    print(campaign.summary)

    model = pa10cal.calibrate(campaign)
    print(model.parameters.to_string(index=False))

    verdict = pa10cal.discover(campaign, model)
    print(f"verdict: {verdict.verdict}")
    for finding in verdict.effects:
        print(f"  {finding.effect.id} of {finding.effect.of}")
    if verdict.holdout is not None:
        before, after = verdict.holdout.before, verdict.holdout.after
        print(f"held out: {before.mean_mm:.4f} mm -> {after.mean_mm:.4f} mm in the mean")

    verdict.model.save(out)
    again = pa10cal.load_model(out)
    predicted = again.predict(np.zeros((1, again.arm.n)), frame="flange")
    print(f"at zero the flange is at {predicted.T[0, :3, 3]} m, +- {predicted.u_mm[0]:.4f} mm")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
