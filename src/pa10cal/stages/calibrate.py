"""Stage `calibrate`."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.options import DiscoveryOptions

if TYPE_CHECKING:
    from pa10cal.results.calibration import CalibrationRecord

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
    from pa10cal.calibration.load_case import COMBINED, LoadCase, load_cases
    from pa10cal.calibration.options import takes_general_model
    from pa10cal.discovery.given import calibrated_with, listed
    from pa10cal.errors import CalibrationError, DiscoveryError
    from pa10cal.fit.fitted_model import load_model
    from pa10cal.results.calibration import (
        BaseFrameRecord,
        CalibrationRecord,
        GeneralCalibrationRecord,
    )
    from pa10cal.results.codec import read, schema_of, write
    from pa10cal.results.discovery import ExtendedRecord
    from pa10cal.stages.inputs import read_extended, read_measured
    from pa10cal.terms.effects.effect import Effect

    campaign, arm, every = read_measured(campaign_dir, poses)
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
    effects: Any = ()
    if settings.effects == "named" and named is not None:
        terms = read_extended(named, campaign.name).model.model.terms
        effects = [term for term in terms if isinstance(term, Effect)]
    records: dict[str, CalibrationRecord] = {}
    for case in cases:
        began, before = time.perf_counter(), next(iter(records.values()), None)
        if isinstance(before, GeneralCalibrationRecord) and len(cases) == 2:
            records[case] = as_load(before, case)  # of one load: the same poses
            _say(f"{campaign.name} {case}", records[case], time.perf_counter() - began)
            continue
        try:
            whole = LoadCase(campaign, arm, every, case, settings, findings, known)
            record = calibration_record(whole, seed, general=general or case == GENERAL)
            if settings.effects != "named" or named is None:
                effects = listed(settings)
            elif not effects:
                word = read(ExtendedRecord, named, campaign.name).verdict
                print(
                    f"{campaign.name} {case}: the verdict {word} names no effects to calibrate with"
                )
            records[case] = calibrated_with(effects, record, whole, discovery)
        except (CalibrationError, DiscoveryError) as error:
            place = error.within(str(given)) if error.where == "prior" else error
            place = place if load else place.within(f"load case {case}")
            raise explained(place, findings) from None
        _say(f"{campaign.name} {case}", records[case], time.perf_counter() - began)
    if load:
        write(records[load], out)
        return
    # Those of loads that the campaign no longer has are removed; that of all loads is written last:
    # where it is, all are.
    for path in out.glob("*.json"):
        if path.stem not in records and schema_of(path) == CalibrationRecord.SCHEMA:
            path.unlink()
    for case in sorted(records, key=lambda case: case == COMBINED):
        write(records[case], out / f"{case}.json")


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
