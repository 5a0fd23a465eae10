"""Discovery as a command, on a small simulated campaign, and what is done with its model."""

import csv
import json
import shutil

import numpy as np
import pytest
import yaml

from by_commands import calibrate, called, discover, evaluate, export, simulated, table_of
from by_commands import calibrated as calibrated_baseline
from by_commands import read_json as read
from made_up_arm import Missing, at_joint, harmonic, measure
from pa10cal.commands.command_line import REFUSED
from pa10cal.files.arms import load_arm
from pa10cal.fit.model_reading import model_from_plain
from pa10cal.fit.model_writing import model_to_plain
from pa10cal.fit.validity import nothing_seen
from pa10cal.terms.field import Field
from pa10cal.terms.plain import term_to_plain

NAME = "small"
SETTINGS = {
    "random_seed": 7,
    "built": "drawn",
    "repeats": 4,
    "holdout_points": 6,
    "poses": {"tilt_seed": 3},
    "hidden_effects": [
        {"id": "transmission_error", "of": "joint 2", "parameters": {"A": 2e-4, "phi": 1.0}}
    ],
}


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A raw campaign, its table of poses and its calibrated baseline."""
    return calibrated_baseline(simulated(tmp_path_factory.mktemp("work"), NAME, SETTINGS), starts=1)


def run_discover(work, out, settings=None, **given):
    """Run the command into a folder; `given` replaces paths."""
    return discover(work, out, settings=settings or {"suggestions": 2}, **given)


@pytest.fixture(scope="module")
def found(work):
    out = work / "discovery"
    assert run_discover(work, out) == 0
    return out


@pytest.fixture(scope="module")
def verdict(found):
    return read(found / "verdict.json")


class TestVerdict:
    def test_names_what_was_hidden(self, verdict):
        assert (verdict["schema"], verdict["campaign"]) == ("pa10cal-verdict/1", NAME)
        assert verdict["provenance"].startswith("synthetic")
        assert verdict["verdict"] == "named"
        (effect,) = verdict["effects"]
        assert (effect["id"], effect["of"]) == ("transmission_error", "joint 2")
        assert effect["alternatives"] == []
        hidden = SETTINGS["hidden_effects"][0]["parameters"]
        assert set(effect["parameters"]) == set(hidden)
        for key, entry in effect["parameters"].items():
            assert set(entry) == {"value", "std", "unit"}
            assert entry["unit"] == "rad"
            assert abs(entry["value"] - hidden[key]) < 4.0 * entry["std"]

    def test_says_what_decided(self, verdict):
        evidence = verdict["effects"][0]["evidence"]
        assert evidence["lost_without_it_nats"] > 10.0 * evidence["needed_nats"]
        assert evidence["p_sign_flips_max_t"] <= evidence["p_needed"]
        for key in ("cross_validation_over_poses", "cross_validation_over_loads"):
            assert set(evidence[key]) == {"explained", "z"}
            assert evidence[key]["explained"] > 0.8
        assert verdict["search"]["needed_nats"] == pytest.approx(
            np.log(verdict["search"]["candidates"] / verdict["search"]["error_rate"])
        )

    def test_has_the_gap_before_and_after_by_load(self, verdict):
        gap = verdict["gap"]
        assert gap["noise_floor_mm"] > 0.0
        for kind in ("train", "holdout"):
            before, after = gap[kind]["before"], gap[kind]["after"]
            for accuracy in (before, after):
                assert {"mean_mm", "peak_mm", "rms_mm"} <= set(accuracy)
            assert before["mean_mm"] > 5.0 * after["mean_mm"]
            low, high = gap[kind]["reduction"]["interval95_mm"]
            assert 0.0 < low < gap[kind]["reduction"]["mean_mm"] < high
        assert set(gap["train"]["per_load"]) == {"0N", "22N", "44N"}
        assert gap["holdout"]["after"]["mean_mm"] < 2.0 * gap["noise_floor_mm"]

    def test_lists_what_cannot_be_told_and_where_it_could(self, verdict, found):
        assert verdict["unexplained"] is None
        assert verdict["not_testable"]
        for entry in verdict["not_testable"]:
            assert {"id", "of", "why"} <= set(entry)
        assert 1 <= len(verdict["suggested_poses"]) <= 2
        with (found / "suggested.csv").open(encoding="utf-8", newline="") as table:
            rows = list(csv.DictReader(table))
        assert len(rows) == len(verdict["suggested_poses"])

    def test_the_analysis_ends_where_the_verdict_does(self, verdict, found):
        analysis = read(found / "analysis.json")
        assert (analysis["campaign"], analysis["schema"]) == (NAME, "pa10cal-analysis/1")
        assert analysis["naming"][-1]["effects"] == [{"id": "transmission_error", "of": "joint 2"}]
        rows = analysis["gap"]["holdout"]
        after = np.linalg.norm([row["after_mm"] for row in rows], axis=1)
        assert after.mean() == pytest.approx(verdict["gap"]["holdout"]["after"]["mean_mm"])
        assert {"before", "after"} <= set(analysis)

    @pytest.mark.slow
    def test_is_the_same_again(self, work, verdict, tmp_path):
        assert run_discover(work, tmp_path, {"suggestions": 0}) == 0
        again = read(tmp_path / "verdict.json")
        assert again["suggested_poses"] == []
        for key in ("effects", "gap", "search", "not_testable"):
            assert again[key] == verdict[key]


def rows_of(path):
    with path.open(encoding="utf-8", newline="") as table:
        return list(csv.DictReader(table))


class TestExtendedModel:
    def test_held_out_errors_are_those_of_the_verdict(self, work, found, verdict, tmp_path):
        out = tmp_path / "holdout.json"
        assert evaluate(work, out, extended=found / "extended.json") == 0
        models = read(out)["models"]
        after = verdict["gap"]["holdout"]["after"]
        for key in ("mean_mm", "peak_mm", "rms_mm"):
            assert models["extended"][key] == pytest.approx(after[key], rel=1e-9)
            assert models["cubic"][key] > 5.0 * models["extended"][key]

    def test_it_is_exported_with_its_effects(self, work, found, verdict, tmp_path):
        assert export(work, tmp_path, extended=found / "extended.json") == 0
        model = yaml.safe_load((tmp_path / "model.yaml").read_text("utf-8"))
        effect = model["terms"][-1]
        assert (effect["id"], effect["of"]) == ("transmission_error", "joint 2")
        for name, stated in verdict["effects"][0]["parameters"].items():
            assert effect["parameters"][name]["unit"] == stated["unit"]
            for key in ("value", "std"):
                assert effect["parameters"][name][key] == pytest.approx(stated[key], rel=1e-9)
        extended, baseline = read(found / "extended.json"), read(work / "combined.json")
        named = {key for term in model["terms"][:-1] for key in term["parameters"]}
        assert named < set(extended["parameters"]) == set(baseline["parameters"])
        assert (tmp_path / "robot.urdf").read_text("utf-8").startswith("<?xml")

    @pytest.mark.parametrize("fits_weights", [False, True])
    def test_with_nothing_named_the_extended_model_is_exported_if_it_has_weights_alone(
        self, work, found, tmp_path, fits_weights
    ):
        record = read(found / "extended.json")
        record |= {"named": []} | ({"fits_weights": True} if fits_weights else {})
        path = tmp_path / "extended.json"
        path.write_text(json.dumps(record), "utf-8")
        assert export(work, tmp_path, extended=path) == 0
        model = yaml.safe_load((tmp_path / "model.yaml").read_text("utf-8"))
        expected = record if fits_weights else read(work / "combined.json")
        fitted = expected["fitted_model"]["terms"]
        assert [term["x"] for term in model["terms"]] == [term["x"] for term in fitted]

    def test_what_is_predicted_without_a_name_is_exported_if_effects_hold_nowhere(
        self, work, found, tmp_path
    ):
        calibrated, record = read(work / "combined.json"), read(found / "extended.json")
        n = load_arm(record["robot"]).n
        field = Field(((0.0,) * n,), (1.0,) * n, (True,) * n, length_m=0.5, size_m=1e-4)
        plain = term_to_plain(field) | {"x": [1e-4, 0.0, 0.0]}
        away = calibrated["fitted_model"] | {"field": plain}
        nowhere = {"within": nothing_seen(n).to_plain(), "model": away}
        record["fitted_model"]["falls_back"] = nowhere
        path = tmp_path / "extended.json"
        path.write_text(json.dumps(record | {"named": []}), "utf-8")
        assert export(work, tmp_path, extended=path, dh=tmp_path / "dh.csv") == 0
        model = yaml.safe_load((tmp_path / "model.yaml").read_text("utf-8"))
        assert model["falls_back"]["model"]["field"]["x"] == plain["x"]
        # The rows are those of the model that predicts.
        assert export(work, tmp_path, extended=None, dh=tmp_path / "calibrated.csv") == 0
        rows, expected = (rows_of(tmp_path / name) for name in ("dh.csv", "calibrated.csv"))
        for name in ("theta_calibrated_deg", "d_calibrated_mm"):
            assert [row[name] for row in rows] == [row[name] for row in expected]


@pytest.mark.slow
def test_the_extended_model_is_restored_as_it_was_fitted(tmp_path):
    def log(states):
        return at_joint(3, 3.0 * states.arrival[:, 2])

    made = measure(Missing(turn=harmonic(2, 100.0, 2e-4), log=log))
    found = made.discovery
    extended = found.extended
    assert {effect.id for effect in extended.effects} == {"transmission_error", "friction_torque"}
    restored = model_from_plain(model_to_plain(found.model), where="extended.json")
    assert restored.model.terms[-2:] == extended.effects
    poses = found.scorer.problem.cells
    T = restored.T_instr_base @ restored.model.predict(poses.states, restored.x)
    expected = extended.at.T_instr_base @ extended.model.predict(poses.states, extended.at.x)
    np.testing.assert_allclose(T, expected, atol=1e-12)
    off = restored.T_instr_base @ restored.as_read(poses) - T
    assert 0.0 < np.abs(off).max() < 1e-4


def spoilt(record, **changes):
    """Change the last term of the fitted model."""
    model = record["fitted_model"]
    terms = [*model["terms"][:-1], {**model["terms"][-1], **changes}]
    return {"fitted_model": {**model, "terms": terms}}


class TestRefused:
    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"calibration": "gone.json"}, "the record is missing"),
            ({"poses": "gone.parquet"}, "the table of poses cannot be read"),
            ({"campaign_dir": "gone"}, "campaign.yaml"),
            ({"calibration": "truth.json"}, "not a record of this kind"),
        ],
    )
    def test_inputs_that_are_not_there(self, work, tmp_path, capsys, given, message):
        given = {key: work / name for key, name in given.items()}
        assert run_discover(work, tmp_path, **given) == REFUSED
        assert message in capsys.readouterr().err
        assert not list(tmp_path.iterdir())

    def test_results_of_another_campaign(self, work, tmp_path, capsys):
        other, out = tmp_path / "other.json", tmp_path / "out"
        other.write_text(json.dumps(read(work / "combined.json") | {"campaign": "other"}), "utf-8")
        described = shutil.copytree(work / "raw", tmp_path / "raw") / "campaign.yaml"
        text = described.read_text("utf-8")
        described.write_text(yaml.safe_dump(yaml.safe_load(text) | {"name": "other"}), "utf-8")
        for given in ({"calibration": other}, {"campaign_dir": tmp_path / "raw"}):
            assert run_discover(work, out, **given) == REFUSED
            assert "another campaign" in capsys.readouterr().err
        assert not out.exists()

    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"error_rate": 0.0}, "error_rate"),
            ({"error_rate": 1.0}, "error_rate"),
            ({"load_uncertainty": -0.1}, "load_uncertainty"),
            ({"suggestions": -1}, "suggestions"),
            ({"suggestion": 1}, "did you mean 'suggestions'"),
        ],
    )
    def test_settings_out_of_range(self, work, tmp_path, capsys, settings, message):
        assert run_discover(work, tmp_path, settings) == REFUSED
        assert message in capsys.readouterr().err
        assert not list(tmp_path.iterdir())

    @pytest.mark.slow
    def test_an_output_that_cannot_be_written(self, work, tmp_path, capsys):
        taken = tmp_path / "verdict.json"
        taken.mkdir()
        assert run_discover(work, tmp_path, {"suggestions": 0}) == REFUSED
        assert "cannot be written" in capsys.readouterr().err
        assert list(tmp_path.iterdir()) == [taken]  # not one of the others without it

    @pytest.mark.slow_but_one_in(5)
    @pytest.mark.parametrize(
        "change",
        [
            lambda record: spoilt(record, id="nonsense"),
            lambda record: spoilt(record, form={}),
            lambda record: spoilt(record, form={"order": "many"}),
            lambda record: spoilt(record, x=[1e-4]),
            lambda record: spoilt(record, x=["a", "b"]),
            lambda record: {"fitted_model": {}},
            lambda record: {"fitted_model": {**record["fitted_model"], "terms": [{}]}},
            lambda record: spoilt(record, x=[float("nan"), 0.0]),
            lambda record: {"fitted_model": {**record["fitted_model"], "schema": "other/1"}},
            lambda record: {"fitted_model": {**record["fitted_model"], "targets_off_m": "none"}},
            lambda record: {"fitted_model": {**record["fitted_model"], "T_instr_base": [[1.0]]}},
            lambda record: {"T_instr_base": [[1.0]]},
            lambda record: {"campaign": "other"},
            lambda record: {"schema": "pa10cal-verdict/1"},
        ],
    )
    def test_a_spoilt_extended_model_is_not_evaluated(self, work, found, tmp_path, capsys, change):
        record, path = read(found / "extended.json"), tmp_path / "extended.json"
        path.write_text(json.dumps(record | change(record)), "utf-8")
        out = tmp_path / "out" / "holdout.json"
        assert evaluate(work, out, extended=path) == REFUSED
        assert str(path) in capsys.readouterr().err
        assert not out.exists()

    @pytest.mark.parametrize("key", ["parameters", "fitted_model", "named", "T_instr_base"])
    def test_an_incomplete_extended_model_is_not_exported(self, work, found, tmp_path, capsys, key):
        record, path = read(found / "extended.json"), tmp_path / "extended.json"
        del record[key]
        path.write_text(json.dumps(record), "utf-8")
        out = tmp_path / "out"
        assert export(work, out, extended=path) == REFUSED
        assert str(path) in capsys.readouterr().err
        assert not out.exists()


#: What `work` hides.
KNOWN = ({"id": "transmission_error", "of": "joint 2"},)


def calibrate_with(work, out, effects, **more):
    """Calibrate with effects that are given."""
    return calibrate(work, out, settings={"starts": 1, "effects": effects}, **more)


@pytest.fixture(scope="module")
def calibrated(work):
    out = work / "with_effects.json"
    assert calibrate_with(work, out, KNOWN) == 0
    return out


class TestCalibrationWithEffects:
    """Key `calibration.effects`: effects that are known belong to the calibrated model."""

    def test_closes_the_gap_as_discovery_does(self, work, found, calibrated, tmp_path):
        assert evaluate(work, tmp_path / "after.json", extended=found / "extended.json") == 0
        after = read(tmp_path / "after.json")["models"]["extended"]["mean_mm"]
        given = {"calibration": calibrated, "out": tmp_path / "given.json"}
        assert called("evaluate", **table_of(work), **given) == 0
        models = read(tmp_path / "given.json")["models"]
        given = models[next(name for name in models if name not in ("uncalibrated", "linear"))]
        assert given["mean_mm"] == pytest.approx(after, rel=0.02)

    def test_values_are_those_of_discovery(self, verdict, calibrated):
        parameters = read(calibrated)["parameters"]
        for effect in verdict["effects"]:
            for name, found in effect["parameters"].items():
                given = parameters[f"{effect['id']}_2_{name}"]
                assert abs(given["value"] - found["value"]) <= 0.1 * found["std"]
                assert given["std"] == pytest.approx(found["std"], rel=0.05)

    def test_the_base_is_as_uncertain_as_its_motions_along_its_own_axes(self, calibrated):
        record = read(calibrated)
        T, x = np.array(record["T_instr_base"]), record["parameters"]
        covariance = np.array(record["covariance"]["matrix"])[-6:, -6:]
        origin = -T[:3, :3].T @ T[:3, 3]  # of the instrument, in the frame of the base
        moved = np.hstack([-np.eye(3), np.cross(origin, np.eye(3)).T])
        expected = np.sqrt(np.diag(moved @ covariance @ moved.T))
        found = [x[f"base_p_cmm_{axis}"]["std"] for axis in "xyz"]
        np.testing.assert_allclose(found, expected, rtol=1e-6)

    def test_what_poses_do_not_identify_is_as_uncertain_as_its_tolerance(self, calibrated):
        every = read(calibrated)["parameters"].values()
        held = [each for each in every if not each["identifiable"]]
        assert held
        assert all(each["std"] == each["tolerance"] for each in held)

    def test_the_model_has_the_grade_of_the_calibration(self, found, calibrated, tmp_path):
        places = {"model": tmp_path / "model.yaml", "urdf": tmp_path / "robot.urdf"}
        given = {"calibration": calibrated, "extended": found / "extended.json", "force": True}
        assert called("export", **given, **places) == 0
        model = yaml.safe_load(places["model"].read_text("utf-8"))
        health = read(calibrated)["health"]
        assert (model["grade"], model["fitted_to"]["health"]) == (health["grade"], health["line"])

    def test_promises_what_this_model_lacks_and_not_what_the_one_without_effects_does(
        self, work, found, calibrated
    ):
        lacks = read(calibrated)["fitted_model"]["discrepancy"]["error_mm"]
        of_verdict = read(found / "extended.json")["fitted_model"]["discrepancy"]["error_mm"]
        without = read(work / "combined.json")["fitted_model"]["discrepancy"]["error_mm"]
        np.testing.assert_allclose(lacks, of_verdict, atol=0.1 * max(without))
        assert max(lacks) < 0.7 * max(without)

    def test_named_are_those_of_a_search(self, work, found, calibrated, tmp_path):
        out = tmp_path / "named.json"
        assert calibrate_with(work, out, "named", named=found / "extended.json") == 0
        named, listed = read(out)["parameters"], read(calibrated)["parameters"]
        assert set(named) == set(listed)

    def test_what_may_as_well_be_zero_is_not_in_the_model(self, work, calibrated, tmp_path):
        """Three scales of an instrument that reads rightly: lengths of the arm would follow."""
        effects = (*KNOWN, {"id": "cmm_scale", "of": "instrument"})
        assert calibrate_with(work, tmp_path / "more.json", effects) == 0
        more, without = read(tmp_path / "more.json"), read(calibrated)
        assert more["parameters"] == without["parameters"]
        (note,) = (text for text in more["warnings"] if text not in without["warnings"])
        assert note.startswith("cmm_scale of instrument is not in the model: ")
        assert "s_z = " in note

    @pytest.mark.slow
    def test_what_a_model_has_is_not_sought_in_it(self, work, calibrated, tmp_path):
        assert run_discover(work, tmp_path, calibration=calibrated) == 0
        verdict = read(tmp_path / "verdict.json")
        assert verdict["verdict"] == "none"

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("effects", "says"),
        [
            ("named", "--named"),
            ([{"id": "transmission_error", "of": "joint 9"}], "no transmission_error of joint 9"),
            ([{"id": "transmision_error", "of": "joint 2"}], "did you mean 'transmission_error'"),
        ],
    )
    def test_refuses_what_it_does_not_know(self, work, tmp_path, capsys, effects, says):
        assert calibrate_with(work, tmp_path / "none.json", effects) == 2
        message = capsys.readouterr().err
        assert says in message
        assert message.count("\n") == 1
        assert not list(tmp_path.iterdir())
