"""Results folders that pictures are drawn of, told apart by the record that each of them holds."""

from __future__ import annotations

from pathlib import Path

from pa10cal.errors import SettingsError
from pa10cal.figures.chain_results import read_curve_study
from pa10cal.figures.curve_results import read_curve
from pa10cal.figures.draw import Source
from pa10cal.figures.options import PictureOptions
from pa10cal.figures.results import Results
from pa10cal.figures.trial_scores import read_scores


def read_source(
    folder: Path, campaign_dir: Path | None, settings: PictureOptions
) -> tuple[str, Source]:
    """Return what the results in a folder are of, as `registry.FOLDERS` names it, and them.

    Args:
        folder: results of a campaign, of blind trials, of a curve, or of chains along curves.
        campaign_dir: raw files of the campaign; None where it is none.
        settings: what pictures read of the settings.

    Raises:
        SettingsError: when it is not known what the results are of.
        RecordError, RawDataError: when they cannot be used.
    """
    if campaign_dir is not None:
        return "campaign", Results.of(campaign_dir, folder, settings)
    if (folder / "scores.json").exists():
        return "trials", read_scores(folder / "scores.json")
    if (folder / "curve.json").exists():
        return "curve", read_curve(folder)
    if (folder / "calibration.json").exists():
        return "chain", read_curve_study(folder / "calibration.json")
    raise SettingsError(
        "results of nothing that pictures are drawn of",
        where="--results",
        value=str(folder),
        allowed="a folder with scores.json, curve.json or calibration.json, or one of a campaign",
        remedy="correct the folder; for a campaign give --campaign-dir as well",
    )
