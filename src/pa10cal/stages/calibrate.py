"""Stage `calibrate`: the load cases of a campaign, each with its record."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.options import DiscoveryOptions

if TYPE_CHECKING:
    from pa10cal.calibration.load_case import LoadCase
    from pa10cal.fit.fitted_model import FittedModel
    from pa10cal.results.calibration import BaseFrameRecord, CalibrationRecord
    from pa10cal.terms.effects.effect import Effect

#: Load case of the general model beside those of the paper's model: all loads together.
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

    A load with too few poses for a fit of its own is left out, and a note says so.

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
    import numpy as np

    from pa10cal.calibration.general.case import as_load
    from pa10cal.calibration.input_checks import check_input, explained
    from pa10cal.calibration.load_case import COMBINED, LoadCase, load_cases
    from pa10cal.calibration.options import takes_general_model
    from pa10cal.errors import CalibrationError, DiscoveryError, TooFewPosesError
    from pa10cal.results.calibration import BaseFrameRecord, GeneralCalibrationRecord
    from pa10cal.results.codec import read, write
    from pa10cal.stages.inputs import read_measured

    campaign, arm, observations = read_measured(campaign_dir, poses)
    seed = read(BaseFrameRecord, base_frame, campaign.name)
    general = takes_general_model(
        settings.model, robot=arm.name, from_touches=campaign.from_touches
    )
    states = observations.of_kind("grid").states
    names: tuple[str, ...] = (load,) if load else load_cases(states)
    of_one_load = len(np.unique(states.load_N)) == 1
    # single loads, whose poses are in the fit of all loads too
    may_be_left_out = set() if load or of_one_load else {*names} - {COMBINED}
    if not load and not general:
        names += (GENERAL,)
    findings = check_input(campaign, arm, observations, settings)
    prior_file = prior or (Path(settings.prior) if settings.prior else None)
    prior_model = None if prior_file is None else _read_prior(prior_file, general, force=force)
    verdict, of_verdict = "", None
    if settings.effects == "named" and named is not None:
        verdict, of_verdict = _effects_of_verdict(named, campaign.name)
    records: dict[str, CalibrationRecord] = {}
    left_out: dict[str, str] = {}
    for name in names:
        began_s = time.perf_counter()
        first = next(iter(records.values()), None)
        if isinstance(first, GeneralCalibrationRecord) and of_one_load:
            records[name] = as_load(first, name)  # the poses are the same
        else:
            case = LoadCase(campaign, arm, observations, name, settings, findings, prior_model)
            if of_verdict == []:
                about = f"{campaign.name} {name}: the verdict {verdict}"
                print(f"{about} names no effects to calibrate with")
            by_general = general or name == GENERAL
            is_left_out_for = TooFewPosesError if name in may_be_left_out else ()
            try:
                records[name] = _record(case, seed, of_verdict, discovery, by_general=by_general)
            except is_left_out_for as error:
                left_out[name] = f"{error.what} ({error.value}); needed: {error.allowed}"
                continue
            except (CalibrationError, DiscoveryError) as error:
                placed = error.within(str(prior_file)) if error.where == "prior" else error
                placed = placed if load else placed.within(f"load case {name}")
                raise explained(placed, findings) from None
        if name == COMBINED and left_out:
            records[name] = records[name].model_copy(update={"loads_left_out": left_out})
        seconds = time.perf_counter() - began_s
        _print_outcome(f"{campaign.name} {name}", records[name], seconds)
    if load:
        write(records[load], out)
    else:
        _write_all(records, out)


def _read_prior(path: Path, general: bool, *, force: bool) -> FittedModel:
    """Read the model to start from; refuse an unsound one, and any for the paper's model."""
    from pa10cal.calibration.campaign import refuse_prior
    from pa10cal.calibration.general.prior import refuse_unsound
    from pa10cal.fit.model_reading import load_model

    model = load_model(path)
    refuse_unsound(model, force=force)
    refuse_prior(None if general else model)
    return model


def _record(
    case: LoadCase,
    seed: BaseFrameRecord,
    of_verdict: Sequence[Effect] | None,
    discovery: DiscoveryOptions,
    *,
    by_general: bool,
) -> CalibrationRecord:
    """Calibrate a load case by the general or the paper's model; with effects if there are any.

    The effects are those of the verdict, or without one (None) those that the settings list.
    """
    from pa10cal.calibration.campaign import calibration_record
    from pa10cal.discovery.given_record import effects_listed, record_with_effects

    record = calibration_record(case, seed, general=by_general)
    effects = effects_listed(case.options) if of_verdict is None else of_verdict
    return record_with_effects(effects, record, case, discovery)


def _effects_of_verdict(path: Path, campaign: str) -> tuple[str, list[Effect]]:
    """Return the verdict with which an extended model was written, and its effects."""
    from pa10cal.results.codec import read
    from pa10cal.results.discovery import ExtendedRecord
    from pa10cal.stages.inputs import read_extended
    from pa10cal.terms.effects.effect import Effect

    terms = read_extended(path, campaign).model.model.terms
    effects = [term for term in terms if isinstance(term, Effect)]
    return read(ExtendedRecord, path, campaign).verdict, effects


def _write_all(records: Mapping[str, CalibrationRecord], out: Path) -> None:
    """Write the record of every load case, and remove those of loads that are no more.

    The record of all loads is written last: where it is, all are.
    """
    from pa10cal.calibration.load_case import COMBINED
    from pa10cal.results.calibration import CalibrationRecord
    from pa10cal.results.codec import schema_of, write

    for path in out.glob("*.json"):
        if path.stem not in records and schema_of(path) == CalibrationRecord.SCHEMA:
            path.unlink()
    for name in sorted(records, key=lambda name: name == COMBINED):
        write(records[name], out / f"{name}.json")


def _print_outcome(title: str, record: CalibrationRecord, seconds: float) -> None:
    """Print how the fit of a load case ended, its errors and its grade; warnings as notes."""
    from pa10cal.results.calibration import GeneralCalibrationRecord

    after = ", ".join(f"{load} {errors.text}" for load, errors in record.errors.items())
    print(
        f"{title}: {record.status}, rank {record.rank} of {record.unknowns}, "
        f"mean/peak after: {after}; {record.iterations} iterations, {seconds:.1f} s"
    )
    if isinstance(record, GeneralCalibrationRecord) and record.prior is not None:
        print(f"{title}: {record.prior.line}")
    print(f"{title}: {record.health.grade}: {record.health.line}")
    left_out = (record.loads_left_out or {}).items()
    notes = [f"no fit of {load} alone: {why}" for load, why in left_out]
    for note in (*notes, *record.warnings):
        if note != record.health.line:
            print(f"{title}: note: {note}", file=sys.stderr)
