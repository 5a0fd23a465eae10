"""Stage `calibrate`."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.calibration.options import CalibrationOptions, EffectOfPlace
from pa10cal.options import DiscoveryOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pa10cal.arm.description import Arm
    from pa10cal.campaign.description import CampaignDescription
    from pa10cal.observe.observations import Observations
    from pa10cal.results.calibration import CalibrationRecord
    from pa10cal.terms.effects.effect import Effect


#: Load case of the general model beside the paper's: all loads together.
GENERAL = "general"


def calibrate(
    *,
    campaign_dir: Path,
    poses: Path,
    base_frame: Path,
    out: Path,
    load: str | None = None,
    named: Path | None = None,
    prior: Path | None = None,
    force: bool = False,
    settings: CalibrationOptions = CalibrationOptions(),
    discovery: DiscoveryOptions = DiscoveryOptions(),
) -> None:
    """Calibrate the arm, at every load and at all together, by the paper's model or the general.

    Args:
        campaign_dir: folder of raw files.
        poses: table of poses (.parquet).
        base_frame: base frame that the command seed wrote (.json).
        out: folder for the calibrations, or with --load the calibration to write (.json).
        load: one load case alone: a load such as 44N; combined; or general.
        named: extended model that discovery wrote, for `effects: named` (.json).
        prior: model.yaml of the same arm to start from, in place of calibration.prior.
        force: take a prior whatever its grade.
        settings: section calibration.
        discovery: section discovery, for effects to calibrate with.

    Examples:
        pa10cal calibrate --campaign-dir data/raw/mine --poses poses.parquet --base-frame \\
          base_frame.json --out calibration
        pa10cal calibrate --campaign-dir data/raw/mine --poses poses.parquet --base-frame \\
          base_frame.json --load 44N --out 44N.json
    """
    from pa10cal.calibration.campaign import calibration_record, refuse_prior
    from pa10cal.calibration.general.case import as_load
    from pa10cal.calibration.general.other_campaign import refuse_unsound
    from pa10cal.calibration.input_checks import check_input, explained
    from pa10cal.calibration.load_case import LoadCase, load_cases
    from pa10cal.calibration.options import takes_general_model
    from pa10cal.campaign.description import read_description
    from pa10cal.campaign.table import arm_of, read_observations
    from pa10cal.errors import CalibrationError, DiscoveryError
    from pa10cal.fit.fitted_model import load_model
    from pa10cal.results.calibration import BaseFrameRecord, GeneralCalibrationRecord
    from pa10cal.results.codec import read, write

    campaign = read_description(campaign_dir)
    every = read_observations(poses, campaign)
    arm = arm_of(campaign, campaign_dir, every)
    seed = read(BaseFrameRecord, base_frame, campaign.name)
    general = takes_general_model(settings.model, from_touches=campaign.from_touches)
    beside = () if general else (GENERAL,)
    cases = (load,) if load else load_cases(every.of_kind("grid").states.load_N) + beside
    findings = check_input(campaign, arm, every, settings)
    known = None
    if given := prior or (Path(settings.prior) if settings.prior else None):
        known = load_model(given)
        refuse_unsound(known, force=force)
        refuse_prior(None if general else known)
    records: dict[str, CalibrationRecord] = {}
    for case in cases:
        by_general, began = general or case == GENERAL, time.perf_counter()
        before = next(iter(records.values()), None)
        if isinstance(before, GeneralCalibrationRecord) and len(cases) == 2:
            records[case] = as_load(before, case)  # of one load: the same poses
            _say(f"{campaign.name} {case}", records[case], time.perf_counter() - began)
            continue
        try:
            whole = LoadCase(campaign, arm, every, case, settings, findings, known)
            record = calibration_record(whole, seed, general=by_general)
            records[case] = _with_effects(
                record, campaign, arm, every, case, settings, discovery, named
            )
        except (CalibrationError, DiscoveryError) as error:
            place = error.within(str(given)) if error.where == "prior" else error
            place = place if load else place.within(f"load case {case}")
            raise explained(place, findings) from None
        _say(f"{campaign.name} {case}", records[case], time.perf_counter() - began)
    if load:
        write(records[load], out)
    else:
        _write_all(records, out)


def _write_all(records: dict[str, CalibrationRecord], folder: Path) -> None:
    """Write every load case, that of all loads last: where it is, all are.

    Those of loads that the campaign no longer has are removed.
    """
    from pa10cal.calibration.load_case import COMBINED
    from pa10cal.results.calibration import CalibrationRecord
    from pa10cal.results.codec import schema_of, write

    for path in folder.glob("*.json"):
        if path.stem not in records and schema_of(path) == CalibrationRecord.SCHEMA:
            path.unlink()
    for case in sorted(records, key=lambda case: case == COMBINED):
        write(records[case], folder / f"{case}.json")


def _with_effects(
    record: CalibrationRecord,
    campaign: CampaignDescription,
    arm: Arm,
    every: Observations,
    load: str,
    options: CalibrationOptions,
    discovery: DiscoveryOptions,
    named: Path | None,
) -> CalibrationRecord:
    """Calibrate a load case once more with the effects that the options list."""
    if not options.effects:
        return record

    from pa10cal.discovery.given import calibrated_with, listed
    from pa10cal.results.codec import read
    from pa10cal.results.discovery import ExtendedRecord
    from pa10cal.stages.extended import effects_of, read_extended

    if options.effects == "named" and named is not None:
        known = read_extended(named, campaign.name).model
        effects: Sequence[EffectOfPlace | Effect] = effects_of(known)
    else:
        effects = listed(options)
    if named is not None and not effects:
        word = read(ExtendedRecord, named, campaign.name).verdict
        print(f"{campaign.name} {load}: the verdict {word} names no effects to calibrate with")
    return calibrated_with(effects, record, campaign, arm, every, load, options, discovery)


def _say(title: str, record: CalibrationRecord, seconds: float) -> None:
    from pa10cal.results.calibration import GeneralCalibrationRecord

    after = ", ".join(f"{load} {errors.text}" for load, errors in record.errors.items())
    print(
        f"{title}: {record.status}, rank {record.rank} of {record.unknowns}, "
        f"mean/peak after: {after}; {record.iterations} iterations, {seconds:.1f} s"
    )
    if isinstance(record, GeneralCalibrationRecord) and record.prior is not None:
        print(f"{title}: {record.prior.line}")
    print(f"{title}: {record.health.grade}: {record.health.line}")
    for warning in (text for text in record.warnings if text != record.health.line):
        print(f"{title}: note: {warning}", file=sys.stderr)
