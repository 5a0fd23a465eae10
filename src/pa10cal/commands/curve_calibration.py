"""Command `curve_calibration`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.curve.options import CurveStudyOptions

if TYPE_CHECKING:
    from pa10cal.curve.postures import Postures


def curve_calibration(
    *,
    out: Path,
    settings: CurveStudyOptions = CurveStudyOptions(),
    calibration: CalibrationOptions = CalibrationOptions(),
) -> None:
    """Calibrate a chain of links posed along curves, in the virtual cell.

    Args:
        out: record to write (.json).
        settings: section curve.
        calibration: section calibration.
    """
    import numpy as np

    from pa10cal.cell.options import TrackerOptions
    from pa10cal.curve.chain_arm import chain_arm
    from pa10cal.curve.postures import draw_postures
    from pa10cal.files.output import write_json
    from pa10cal.files.schemas import CURVE_CALIBRATION
    from pa10cal.stages.curve_study import BAR, calibrated_record, draw_departing, summaries

    limit_rad = float(np.radians(settings.limit_deg))
    arm = chain_arm(f"chain_{settings.links}", settings.links, settings.link_m, limit_rad)
    plan = TrackerOptions(
        poses=settings.postures,
        holdout_share=settings.holdout_share,
        position_mm=settings.position_mm,
        attitude_rad=settings.attitude_rad,
    )
    # The mean length of a vector of three coordinates with this noise.
    floor_mm = float(settings.position_mm * np.sqrt(8.0 / np.pi))
    shapes: list[Postures] = []
    records: list[dict[str, Any]] = []
    streams = np.random.default_rng(settings.random_seed).spawn(settings.individuals)
    for number, stream in enumerate(streams):
        postures = draw_postures(
            settings.links, settings.link_m, limit_rad, settings.postures, stream
        )
        shapes.append(postures)
        noise_seed = int(stream.integers(2**32))
        records += [
            {"number": number + 1}
            | calibrated_record(each, plan, calibration, postures.q_rad, noise_seed)
            for each in draw_departing(arm, plan, calibration, stream)
        ]
    found = summaries(records, floor_mm)
    write_json(
        out,
        {
            "schema": CURVE_CALIBRATION,
            "provenance": "synthetic: virtual cell, no hidden effect",
            "settings": settings.model_dump(mode="json"),
            "joints": arm.n,
            "shapes_refused": sum(postures.refused for postures in shapes),
            "noise_floor_mm": floor_mm,
            "bar": BAR,
            "summaries": found,
            "individuals": records,
            "postures_of_first": {
                "shape": shapes[0].shape.tolist(),
                "p_m": shapes[0].p_m.tolist(),
            },
        },
    )
    for each in found:
        fitted, held_out = each["fitted"], each["held_out"]
        print(
            f"{each['departs']}, {each['model']}: rank {each['rank']} of {each['unknowns']}, "
            f"{each['converged']} of {each['individuals']} converged; mean error over the noise "
            f"floor {fitted['mean']:.2f} ({fitted['largest']:.2f} at most) fitted, "
            f"{held_out['mean']:.2f} ({held_out['largest']:.2f}) held out"
        )
