"""Results of a shipped campaign, and of simulated ones without touches, with little work each."""

import json
import shutil
from itertools import combinations
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.text import Text

from built_once import built_once
from made_up_records import accuracy, effect, made_up_gap, set_gap, stretches_deg, verdict_keys
from made_up_results import elsewhere, small_results, taken_to_a_model
from pa10cal.campaign.description import read_description
from pa10cal.command_settings import ChainOptions, PictureOptions
from pa10cal.commands.command_line import run_command
from pa10cal.figures.style import WIDTH_MM, theme, write_figure
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.codec import write
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.maps import AnglesSeen
from pa10cal.stages.pipeline import stages

CAMPAIGN = Path(__file__).parents[2] / "data/raw/cell-null"
PLANES_MM = (300, 500, 700)
LITTLE_DRAWING = (
    '{"cycles": 200, "positions": 20, "map_spacing_mm": 200, "planes_mm": [300, 500, 700]}'
)
LITTLE = {"calibration": {"starts": 1}, "discovery": {"suggestions": 1}}


#: Knots a turn of the maps in results made up.
KNOTS = 24
#: Kinematic error of joint 2 that the spoiled campaign hides.
AMPLITUDE_RAD, PHASE_RAD, ORDER = 4e-4, 0.7, 100.0


@pytest.fixture(scope="session")
def results(tmp_path_factory) -> ResultsBundle:
    """The results of a shipped campaign, as the workflow lays them out; to be read only."""

    def build(within: Path) -> Path:
        place = taken_to_a_model(CAMPAIGN, within / "cell-null", **LITTLE)
        words = ("--campaign", "cell-null", "--robot", "pa10_6ce", "--settings", LITTLE_DRAWING)
        assert run_command("montecarlo", [*words, "--out", str(place / "montecarlo")]) == 0
        return place

    place = built_once(tmp_path_factory, "cell-null", build)
    settings = PictureOptions.model_validate({"montecarlo": {"planes_mm": PLANES_MM}})
    return ResultsBundle(place, description=read_description(CAMPAIGN), settings=settings)


@pytest.fixture(scope="session")
def named(results, tmp_path_factory) -> ResultsBundle:
    """The same campaign with a kinematic error in joint 2, which discovery names."""

    def build(within: Path) -> Path:
        place = Path(shutil.copytree(results.folder, within / "cell-null"))
        path = place / "ingest/poses.parquet"
        table = pq.read_table(path)
        q_rad = table["q2_rad"].to_numpy()
        logged = q_rad - AMPLITUDE_RAD * np.sin(ORDER * q_rad + PHASE_RAD)
        column = table.schema.get_field_index("q2_rad")
        pq.write_table(table.set_column(column, "q2_rad", [logged]), path)
        for stage in stages((CAMPAIGN,), place, ChainOptions.model_validate(LITTLE), "combined"):
            if stage.name in ("calibrate", "discover"):
                stage.run()
        return place

    return elsewhere(results, built_once(tmp_path_factory, "named", build))


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
        for kind, (robot, loads_N) in SIGHTED.items():
            plan = {"instrument": kind, "poses": 60, "loads_N": loads_N}
            small_results(within, kind, {"robot": robot, "without_touches": plan})
        return within

    place = built_once(tmp_path_factory, "sighted", build)
    return {
        kind: ResultsBundle(
            place / "results" / kind, description=read_description(place / "raw" / kind)
        )
        for kind in SIGHTED
    }


@pytest.fixture(scope="session")
def learnt(sighted, tmp_path_factory) -> ResultsBundle:
    """The campaign of poses, its held-out poses judged with a model that learnt by joint angle.

    Joints 1 and 3 have maps of three waves a turn; of joint 3 the angles from 10.2 to 27.8 degrees
    were seen, of joint 1 none. The errors are made from those of the springs:
    three tenths of its errors where every joint is inside the
    angles learnt from, all of them in every fourth pose, which leaves those.
    """
    source = sighted["pose"]
    place = Path(shutil.copytree(source.folder, tmp_path_factory.mktemp("learnt") / "pose"))
    path = place / "evaluation/holdout.json"
    record = json.loads(path.read_text("utf-8"))
    model = json.loads(json.dumps(record["models"]["linear"]))
    for k, row in enumerate(model["rows"]):
        row["extrapolated"] = k % 4 == 0
        part = 1.0 if row["extrapolated"] else 0.3
        row["error_mm"] *= part
        row["position_mm"] = [part * value for value in row["position_mm"]]
    for name, beyond in (("inside", False), ("outside", True)):
        errors = np.array([r["error_mm"] for r in model["rows"] if r["extrapolated"] == beyond])
        made = accuracy(errors.mean(), errors.max(), np.sqrt(np.mean(errors**2)), len(errors))
        model[name] = made.model_dump()
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
    with theme():
        yield


DPI, LEAST_POINTS = 100, 8.0


@pytest.fixture
def written_legibly(project_looks, monkeypatch, tmp_path):
    """Write a figure and return its texts: large enough, inside it and clear of each other."""
    draw_text, seen = Text.draw, {}

    def draw(text, renderer, *rest, **more):
        draw_text(text, renderer, *rest, **more)
        if isinstance(renderer, RendererAgg) and text.get_visible() and text.get_text():
            seen[text] = (text.get_window_extent(renderer), renderer)

    def write(figure, footer, folder=tmp_path, name="figure"):
        seen.clear()
        monkeypatch.setattr(Text, "draw", draw)
        write_figure(figure, footer, folder, name, DPI)
        assert len(seen) > 10
        for text, (box, renderer) in seen.items():
            assert text.get_fontsize() >= LEAST_POINTS, text
            assert renderer.width <= DPI * WIDTH_MM / 25.4 + 1
            assert min(box.x0, box.y0) >= -1, text
            assert box.x1 <= renderer.width + 1, text
            assert box.y1 <= renderer.height + 1, text
        # The box of a slanted text, on an axis in space, is larger than the text.
        straight = [text for text in seen if text.get_rotation() % 90 == 0]
        boxes = {text: seen[text][0].padded(-1) for text in straight}
        pairs = combinations(straight, 2)
        assert not [pair for pair in pairs if boxes[pair[0]].overlaps(boxes[pair[1]])]
        return [text.get_text() for text in seen]

    return write


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
