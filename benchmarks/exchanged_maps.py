"""Which joint's map decides what a model carried to another campaign of its robot is off.

`python -m benchmarks.exchanged_maps SOURCE TARGET CAMPAIGN` takes the results of two campaigns and
the raw folder of the second. The extended model of the first is judged on held-out poses of the
second, base and tool fitted there: as it is, and with the maps of single joints exchanged for those
that the second has found. What its own map takes away is what the first could not know of a joint.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.commands.command_line import limit_threads

if TYPE_CHECKING:
    from pa10cal.fit.fitted_model import FittedModel
    from pa10cal.terms.effects.joint_error_map import JointErrorMap


def maps_of(model: FittedModel) -> dict[int, JointErrorMap]:
    """Return the maps of a model by their joints."""
    from pa10cal.terms.effects.joint_error_map import is_error_map

    return {term.joint: term for term in model.model.terms if is_error_map(term)}


def with_maps_of(model: FittedModel, other: FittedModel, joints: Sequence[int]) -> FittedModel:
    """Return a model with the maps of some joints as another model has them, at its own knots."""
    from pa10cal.numerics.periodic_spline import knots_rad, unit_splines

    own, theirs, x = maps_of(model), maps_of(other), model.x.copy()
    for joint in joints:
        at_knots = other.x[other.model.columns_of(theirs[joint])]
        angles_rad = knots_rad(own[joint].knots)
        x[model.model.columns_of(own[joint])] = unit_splines(len(at_knots))(angles_rad) @ at_knots
    return replace(model, x=x, covariance=None)


def exchanged(source: Path, target: Path, campaign_dir: Path) -> Iterator[tuple[str, float]]:
    """Yield in words which maps were exchanged, and the rms error over held-out poses [mm].

    Raises:
        Pa10calError: when results lack a file, or base and tool are not determined.
    """
    from pa10cal.calibration.accuracy import summarise
    from pa10cal.discovery.preparation import setup_of
    from pa10cal.evaluation.carried_model import with_frames_refitted
    from pa10cal.evaluation.model_errors import poses_for_model
    from pa10cal.options import DiscoveryOptions
    from pa10cal.stages.inputs import read_calibrated, read_extended, read_measured

    carried, own = (
        read_extended(each / "discovery" / "extended.json", each.name).model
        for each in (source, target)
    )
    carried = carried.only(*(term for term in carried.model.terms if term.stays_with_arm))
    campaign, arm, every = read_measured(campaign_dir, target / "ingest" / "poses.parquet")
    _, _, options = read_calibrated(target / "calibration" / "combined.json", campaign.name)
    setup = setup_of(campaign, arm, options, DiscoveryOptions())
    both = sorted(maps_of(carried).keys() & maps_of(own).keys())
    for joints in ([], *([joint] for joint in both), both[:2], both):
        fitted = with_frames_refitted(with_maps_of(carried, own, joints), every, setup)
        poses = poses_for_model(every, "holdout", fitted.model, fitted.setup)
        words = f"maps of joints {', '.join(map(str, joints))} exchanged" if joints else "as it is"
        yield words, summarise(fitted.model.deviations(poses)).rms_mm


def main(arguments: Sequence[str]) -> None:
    """Print a line for every exchange."""
    limit_threads()
    for words, rms_mm in exchanged(*map(Path, arguments)):
        print(f"{words:40} {rms_mm:.3f} mm rms")


if __name__ == "__main__":
    main(sys.argv[1:])
