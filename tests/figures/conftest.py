"""Results of a shipped campaign, and of simulated ones without touches, with little work each."""

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from built_once import built_once
from made_up_records import accuracy, effect, made_up_gap, set_gap, stretches_deg, verdict_keys
from made_up_results import elsewhere
from pa10cal.campaign.description import read_description
from pa10cal.commands.command_line import run_command
from pa10cal.evaluation.options import PictureOptions
from pa10cal.figures.style import looks
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.codec import write
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.maps import AnglesSeen

CAMPAIGN = Path(__file__).parents[2] / "data/raw/cell-null"
PLANES_MM = (300, 500, 700)
LITTLE_DRAWING = '{"cycles": 200, "positions": 20, "map_spacing_mm": 200}'
LITTLE_CALIBRATION = '{"starts": 1}'


#: Knots a turn of the maps in results made up.
KNOTS = 24
#: Kinematic error of joint 2 that the spoiled campaign hides.
AMPLITUDE_RAD, PHASE_RAD, ORDER = 4e-4, 0.7, 100.0


def _run(command, *words):
    assert run_command(command, [str(word) for word in words]) == 0


def _discover(place, raw=CAMPAIGN):
    given = ("--poses", place / "ingest/poses.parquet")
    given += ("--calibration", place / "calibration/combined.json")
    out = {name: place / f"discovery/{name}.json" for name in ("verdict", "analysis", "extended")}
    out["suggested"] = place / "discovery/suggested_poses.csv"
    words = [word for name, path in out.items() for word in (f"--{name}", path)]
    _run("discover", "--campaign-dir", raw, *given, *words)


def _results(folder, raw, settings=None) -> ResultsBundle:
    description = read_description(raw)
    return ResultsBundle(folder, description=description, settings=settings or PictureOptions())


@pytest.fixture(scope="session")
def folder(tmp_path_factory) -> Path:
    """The results folder of a campaign, as the workflow lays it out; to be read only."""
    return built_once(tmp_path_factory, "cell-null", _calibrated)


def _calibrated(within: Path) -> Path:
    place = within / "cell-null"
    poses, base_frame = place / "ingest/poses.parquet", place / "seed/base_frame.json"
    raw = ("--campaign-dir", CAMPAIGN)
    _run("ingest", *raw, "--out", poses, "--quarantine", place / "ingest/quarantine.csv")
    _run("seed", *raw, "--poses", poses, "--out", base_frame)
    for load in ("0N", "22N", "44N", "combined", "general"):
        out = place / f"calibration/{load}.json"
        given = ("--poses", poses, "--base-frame", base_frame, "--load", load)
        _run("calibrate", *raw, *given, "--settings", LITTLE_CALIBRATION, "--out", out)
    given = ("--poses", poses, "--calibration", place / "calibration/combined.json")
    _run("evaluate", *raw, *given, "--out", place / "evaluation/holdout.json")
    _discover(place)
    for plane in PLANES_MM:
        words = ("--campaign", "cell-null", "--robot", "pa10_6ce", "--plane-mm", plane)
        out = place / f"montecarlo/z{plane}.json"
        _run("montecarlo", *words, "--settings", LITTLE_DRAWING, "--out", out)
    return place


@pytest.fixture(scope="session")
def results(folder) -> ResultsBundle:
    settings = PictureOptions.model_validate({"montecarlo": {"planes_mm": PLANES_MM}})
    return _results(folder, CAMPAIGN, settings)


@pytest.fixture(scope="session")
def named(results, tmp_path_factory) -> ResultsBundle:
    """The same campaign with a kinematic error in joint 2, which discovery names."""
    place = built_once(tmp_path_factory, "named", lambda within: _named(within, results.folder))
    return elsewhere(results, place)


def _named(within: Path, calibrated: Path) -> Path:
    place = within / "cell-null"
    shutil.copytree(calibrated, place)
    path = place / "ingest/poses.parquet"
    table = pq.read_table(path)
    q_rad = table["q2_rad"].to_numpy()
    logged = q_rad - AMPLITUDE_RAD * np.sin(ORDER * q_rad + PHASE_RAD)
    column = table.schema.get_field_index("q2_rad")
    pq.write_table(table.set_column(column, "q2_rad", [logged]), path)
    given = ("--poses", path, "--base-frame", place / "seed/base_frame.json", "--load", "combined")
    out = place / "calibration/combined.json"
    words = ("--settings", LITTLE_CALIBRATION, "--out", out)
    _run("calibrate", "--campaign-dir", CAMPAIGN, *given, *words)
    _discover(place)
    return place


#: Instruments without touches, the arm that each measures in the tests, and at which loads.
SIGHTED = {
    "pose": ("ur10", [0.0]),
    "points": ("gx4_351s", [0.0, 20.0]),
    "distance": ("ur10", [0.0]),
}


@pytest.fixture(scope="session")
def sighted(tmp_path_factory) -> dict[str, ResultsBundle]:
    """Campaigns calibrated with the general model, by what the instrument sees.

    Their poses are too few for effects to be sought.
    """

    def build(within: Path) -> Path:
        for kind in SIGHTED:
            _sighted(kind, within / kind)
        return within

    place = built_once(tmp_path_factory, "sighted", build)
    return {
        kind: _results(place / kind / "results" / kind, place / kind / "raw" / kind)
        for kind in SIGHTED
    }


def _sighted(kind, place) -> None:
    raw, folder = place / "raw" / kind, place / "results" / kind
    robot, loads_N = SIGHTED[kind]
    plan = {"instrument": kind, "poses": 60, "loads_N": loads_N}
    settings = json.dumps({"robot": robot, "without_touches": plan})
    truth = ("--truth", place / "truth.json")
    _run("simulate", "--name", kind, "--settings", settings, "--out", raw, *truth)
    poses, base_frame = folder / "ingest/poses.parquet", folder / "seed/base_frame.json"
    given = ("--campaign-dir", raw, "--poses", poses)
    quarantine = ("--quarantine", folder / "ingest/quarantine.csv")
    _run("ingest", "--campaign-dir", raw, "--out", poses, *quarantine)
    _run("seed", *given, "--out", base_frame)
    combined = folder / "calibration/combined.json"
    begun = ("--base-frame", base_frame, "--load", "combined")
    _run("calibrate", *given, *begun, "--out", combined)
    _discover(folder, raw)
    extended = ("--extended", folder / "discovery/extended.json")
    out = folder / "evaluation/holdout.json"
    _run("evaluate", *given, "--calibration", combined, *extended, "--out", out)


@pytest.fixture(scope="session")
def learnt(sighted, tmp_path_factory) -> ResultsBundle:
    """The campaign of poses, its held-out poses judged with a model that learnt by joint angle.

    Joints 1 and 3 have maps of three waves a turn; of joint 3 the angles from 10.2 to 27.8 degrees
    were seen, of joint 1 none. The errors are made from those of the springs:
    three tenths of its errors where every joint is inside the
    angles learnt from, all of them in every fourth pose, which leaves those.
    """
    source = sighted["pose"]
    place = tmp_path_factory.mktemp("learnt") / "pose"
    shutil.copytree(source.folder, place)
    path = place / "evaluation/holdout.json"
    record = json.loads(path.read_text("utf-8"))
    model = json.loads(json.dumps(record["models"]["linear"]))
    for k, row in enumerate(model["rows"]):
        row["extrapolated"] = k % 4 == 0
        part = 1.0 if row["extrapolated"] else 0.3
        row["error_mm"] *= part
        row["position_mm"] = [part * value for value in row["position_mm"]]
    for name in ("inside", "outside"):
        chosen = [r for r in model["rows"] if r["extrapolated"] == (name == "outside")]
        errors = np.array([row["error_mm"] for row in chosen])
        model[name] = {
            "mean_mm": errors.mean(),
            "peak_mm": errors.max(),
            "rms_mm": np.sqrt(np.mean(errors**2)),
            "orientation_deg": model["orientation_deg"],
            "configurations": len(errors),
        }
    record["models"]["extended"] = model
    path.write_text(json.dumps(record), encoding="utf-8")
    knots_rad = 3e-4 * np.sin(3.0 * 2.0 * np.pi * np.arange(KNOTS) / KNOTS)
    knots = {f"knot_{k:02d}": (value, 1e-5 * (1 + k % 3)) for k, value in enumerate(knots_rad)}
    errors, worse = accuracy(0.02), accuracy(0.07, 0.14, 0.077)
    gap = made_up_gap(
        set_gap(errors, errors), set_gap(errors, errors, (worse, errors), (worse, worse))
    )
    seen = [
        AnglesSeen(turns=True, stretches=stretches_deg(*stretches))
        for stretches in ((), (), ((10.2, 27.8),), (), (), ())
    ]
    keys = verdict_keys(
        "named",
        tuple(effect("joint_error_map", of, knots) for of in ("joint 3", "joint 1")),
        gap=gap,
        angles_seen=tuple(seen),
    )
    verdict = VerdictRecord(
        **dict(keys), campaign="pose", provenance="made up", arrival_from_order=False, seconds=None
    )
    write(verdict, place / "discovery/verdict.json")
    return elsewhere(source, place)


@pytest.fixture
def project_looks():
    with looks():
        yield


@pytest.fixture
def changed_from(tmp_path_factory):
    """Copy results with changes to the JSON of one of them, or of all that a pattern fits."""

    def copy(results, pattern, change):
        folder = tmp_path_factory.mktemp("changed") / results.folder.name
        shutil.copytree(results.folder, folder)
        for path in folder.glob(pattern):
            record = json.loads(path.read_text("utf-8"))
            change(record)
            path.write_text(json.dumps(record), encoding="utf-8")
        return elsewhere(results, folder)

    return copy
