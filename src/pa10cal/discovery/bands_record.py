"""Bands of maps and the scatter of single poses as parts of a verdict's record."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pa10cal.results import bands as parts
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.spectrum import Band

if TYPE_CHECKING:
    from pa10cal.discovery.blocked_cv.discover import VerdictByBlocks


def bands_part(found: VerdictByBlocks | None) -> parts.Bands | None:
    """Return the bands of the maps; None where no map has one."""
    if found is None or found.bands is None:
        return None
    of_maps = [
        member.effect.of
        for member in found.bands.level.members
        if isinstance(member.effect, JointErrorMap)
    ]
    names = [field.name for field in fields(Band)]
    return parts.Bands(
        shared=found.bands.found.shared,
        scatter=found.bands.found.scatter,
        maps=tuple(
            parts.BandOfMap(of=of, log_std=dict(zip(names, std.tolist(), strict=True)))
            for of, std in zip(of_maps, found.bands.found.log_std, strict=True)
        ),
        of_time=_left_out(found.bands.of_time),
        of_angles=_left_out(found.bands.of_angles),
    )


def scatter_part(found: VerdictByBlocks | None) -> parts.PoseScatter | None:
    """Return what single poses scatter by; None where no map has a band."""
    if found is None or found.bands is None or found.scatter is None:
        return None
    train, holdout = found.inside95
    return parts.PoseScatter(
        joints=tuple(found.scatter.joints.tolist()),
        kinds=dict(found.scatter.kinds),
        inside95_train=train,
        inside95_holdout=holdout,
    )


def _left_out(squares: NDArray[np.float64]) -> parts.LeftOut:
    before, after = squares.sum(axis=0).tolist()
    return parts.LeftOut(before=before, after=after)
