"""Results folders that pictures are drawn of, distinguished by the records that they hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pa10cal.errors import SettingsError
from pa10cal.figures.curve_results import CurveResults, read_curve
from pa10cal.figures.options import PictureOptions
from pa10cal.figures.results import Results
from pa10cal.results.codec import read, schema_of
from pa10cal.results.studies import CurveCalibrationRecord
from pa10cal.results.trials import TrialScoresRecord, WildScoresRecord


def _nothing(need: str) -> None:
    del need


@dataclass(frozen=True)
class Source:
    """What the pictures of a results folder are drawn from."""

    folder: str  # which pictures, of `registry.FOLDERS`
    name: str  # what messages call it, and every title begins with
    footer: str  # stands below every picture: where its data come from
    content: Any  # what each module of that folder draws
    # says why a need of a picture is not met, None where it is; studies have no needs
    lacks: Callable[[str], str | None] = _nothing


def read_source(
    folder: Path, campaign_dir: Path | None, settings: PictureOptions, *, force: bool = False
) -> Source:
    """Return what the pictures of a results folder are drawn from.

    Args:
        folder: results of a campaign, of blind trials, of a curve, or of chains along curves.
        campaign_dir: raw files of the campaign; None where it is none.
        settings: what pictures read of the settings.
        force: whether a campaign's calibrations are drawn whatever their grade.

    Raises:
        SettingsError: when it is not known what the results are of.
        RecordError, RawDataError: when they cannot be used.
    """
    if campaign_dir is not None:
        return of_campaign(Results.of(campaign_dir, folder, settings, force=force))
    if (folder / "scores.json").exists():
        return _of_scores(folder.name, folder / "scores.json")
    if (folder / "curve.json").exists():
        return _of_curve(folder.name, read_curve(folder))
    if (folder / "calibration.json").exists():
        return _of_chain(folder.name, read(CurveCalibrationRecord, folder / "calibration.json"))
    raise SettingsError(
        "results of nothing that pictures are drawn of",
        where="--results",
        value=str(folder),
        allowed="a folder with scores.json, curve.json or calibration.json, or one of a campaign",
        remedy="correct the folder; for a campaign give --campaign-dir as well",
    )


def of_campaign(results: Results) -> Source:
    """Return the source of a campaign's pictures."""
    return Source("campaign", results.campaign, results.footer, results, results.lacks)


def _of_scores(name: str, path: Path) -> Source:
    if schema_of(path) == WildScoresRecord.SCHEMA:
        return _of_wild_trials(name, read(WildScoresRecord, path))
    return _of_trials(name, read(TrialScoresRecord, path))


def _of_wild_trials(name: str, scores: WildScoresRecord) -> Source:
    footer = f"{scores.trials} wild trials. Synthetic data. Provenance: {scores.provenance}."
    return Source("wild", name, footer, scores)


def _of_trials(name: str, scores: TrialScoresRecord) -> Source:
    footer = f"{scores.trials} blind trials. Synthetic data. Provenance: {scores.provenance}."
    return Source("trials", name, footer, scores)


def _of_curve(name: str, found: CurveResults) -> Source:
    record = found.record
    footer = (
        f"{record.links} links of {record.link_m:.4g} m on a continuous curve: "
        f"{record.shapes[0].ending_is}. Synthetic data."
    )
    return Source("curve", name, footer, found)


def _of_chain(name: str, study: CurveCalibrationRecord) -> Source:
    asked: Any = study.settings
    footer = (
        f"{study.summaries[0].individuals} arms of {asked['links']} links of "
        f"{asked['link_m']:g} m each way, {asked['postures']} postures each, noise "
        f"{asked['position_mm']:g} mm and {1e3 * asked['attitude_rad']:g} mrad. Synthetic data. "
        f"Provenance: {study.provenance}."
    )
    return Source("chain", name, footer, study)
