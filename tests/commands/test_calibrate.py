"""The commands from a table of poses on, called in process on a campaign without missing effect."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from by_commands import calibrate, calibrated, evaluate, export, located, table_of
from made_up_records import effect
from pa10cal.fit.fitted import FittedTo
from pa10cal.fit.model_reading import load_model
from pa10cal.results.codec import write
from pa10cal.results.discovery import ExtendedRecord

RAW = Path(__file__).parents[2] / "data" / "raw"


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """Ingest and seed `cell-null` once."""
    folder = tmp_path_factory.mktemp("results")
    (folder / "raw").symlink_to(RAW / "cell-null")
    return located(folder)


def run_calibrate(work, load, out, settings=None, base="base.json"):
    """Calibrate one load case, or all of them where none is named."""
    return calibrate(work, out, load=load, settings=settings or {}, base_frame=work / base)


@pytest.fixture(scope="module")
def combined(work):
    out = work / "combined.json"
    assert run_calibrate(work, "combined", out, {}) == 0
    return json.loads(out.read_text())


def test_campaign_without_missing_effect_is_calibrated_to_its_noise(combined):
    # bar: mean <= 0.012 mm at every load
    assert combined["status"] == "converged"
    for errors in combined["errors"].values():
        assert errors["after"]["mean_mm"] <= 0.012
        assert errors["before"]["mean_mm"] > 1.0
    assert combined["warnings"] == []


def test_record_holds_what_other_tools_read(combined):
    assert combined["schema"] == "pa10cal-calibration/1"
    assert combined["campaign"] == "cell-null"
    assert (combined["rank"], combined["unknowns"]) == (34, 36)
    assert {"K_lin_2", "K_cub_5", "delta_beta_2", "gamma_z", "base_p_cmm_x"} <= set(
        combined["parameters"]
    )
    assert len(combined["parameters"]) == 36
    for parameter in combined["parameters"].values():
        assert parameter["std"] > 0
        assert {"value", "std", "unit", "tolerance"} <= set(parameter)
    assert not combined["parameters"]["delta_theta_1"]["identifiable"]
    assert combined["starts"] == 8
    assert len(combined["inner_poses"]) == 8
    assert set(combined["errors"]) == {"0N", "22N", "44N"}


def test_held_out_points_and_loads(work, combined):
    # bar: held-out mean <= 0.04 mm
    out = work / "holdout.json"
    assert evaluate(work, out, extended=None) == 0
    models = json.loads(out.read_text())["models"]
    assert models["cubic"]["mean_mm"] <= 0.04
    assert models["cubic"]["mean_mm"] < models["linear"]["mean_mm"]
    assert models["uncalibrated"]["mean_mm"] > 1.0
    assert set(models["cubic"]["per_load"]) == {"22N", "44N", "66N", "90N"}
    assert len(models["cubic"]["per_point"]) == 10
    rows = models["cubic"]["rows"]
    distances = [np.linalg.norm(row["position_mm"]) for row in rows]
    assert np.mean(distances) == pytest.approx(models["cubic"]["mean_mm"])


def test_one_load_alone(work):
    out = work / "22N.json"
    settings = {"starts": 2, "inner_poses": "all"}
    assert run_calibrate(work, "22N", out, settings) == 0
    record = json.loads(out.read_text())
    assert record["loads_fitted"] == [22.0]
    assert record["errors"]["22N"]["after"]["mean_mm"] <= 0.012


@pytest.mark.slow
def test_all_load_cases_in_one_go(work, combined):
    out = work / "calibration"
    assert run_calibrate(work, None, out, {"starts": 1}) == 0
    records = {path.stem: json.loads(path.read_text()) for path in out.iterdir()}
    assert sorted(records) == ["0N", "22N", "44N", "combined", "general"]
    assert all(record["load"] == name for name, record in records.items())
    assert records["general"]["model"] == "general"
    values = records["combined"]["parameters"]
    for name, parameter in combined["parameters"].items():
        if parameter["identifiable"]:
            assert values[name]["value"] == pytest.approx(parameter["value"], rel=1e-4)


def test_a_load_case_that_is_refused_is_named_and_nothing_is_written(work, capsys):
    out = work / "refused"
    assert run_calibrate(work, None, out, {"inner_poses": 40}) == 2
    told = capsys.readouterr().err
    assert "load case combined: calibration.inner_poses: more inner poses" in told
    assert not out.exists()


@pytest.mark.slow_but_one_in(5)
@pytest.mark.parametrize(
    ("load", "settings", "says"),
    [
        ("33N", {}, "0N, 22N, 44N, combined"),
        ("combined", {"epsilom": 1}, "did you mean 'epsilon'"),
        ("combined", {"epsilon_acts_on": "both"}, "epsilon_acts_on"),
        ("combined", {"inner_poses": 40}, "1 to 27"),
        ("combined", {"flexible_joints": [9]}, "1 to 6"),
        ("combined", {"starts": 0}, "starts"),
    ],
)
def test_refuses_what_it_cannot_use(work, capsys, load, settings, says):
    out = work / "refused.json"
    assert run_calibrate(work, load, out, settings) == 2
    message = capsys.readouterr().err
    assert says in message
    assert message.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(
    "content",
    [
        "{",
        "[]",
        "{}",
        '{"schema": "pa10cal-base-frame/1"}',
        '{"schema": "pa10cal-base-frame/1", "campaign": "cell-null", "T_instr_base": [[1, 2]]}',
    ],
)
def test_refuses_a_damaged_seed(work, capsys, content):
    (work / "damaged.json").write_text(content)
    out = work / "refused.json"
    assert run_calibrate(work, "combined", out, base="damaged.json") == 2
    assert "damaged.json" in capsys.readouterr().err
    assert not out.exists()


def test_a_parameter_at_its_bound_by_noise_is_no_alarm(work):
    out = work / "0N.json"
    assert run_calibrate(work, "0N", out, {"starts": 2}) == 0
    record = json.loads(out.read_text())
    assert record["parameters"]["K_cub_3"]["at_bound"]
    assert not record["parameters"]["K_lin_3"]["at_bound"]
    assert len(record["warnings"]) == 1
    assert "indistinguishable from the bound" in record["warnings"][0]


@pytest.mark.slow
def test_an_incomplete_model_is_said_to_be_one(tmp_path, capsys):
    (tmp_path / "raw").symlink_to(RAW / "lightcap2008")
    record = json.loads((calibrated(tmp_path, starts=2) / "combined.json").read_text())
    assert any("the model is incomplete" in warning for warning in record["warnings"])
    assert "the model is incomplete" in capsys.readouterr().err


def test_records_of_another_campaign_are_refused(work, combined, tmp_path, capsys):
    other = tmp_path / "base_frame.json"
    seed_record = json.loads((work / "base.json").read_text())
    other.write_text(json.dumps({**seed_record, "campaign": "cell-a"}))
    assert calibrate(work, tmp_path / "x.json", base_frame=other) == 2
    assert "another campaign" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["not json", '{"schema": "other/1"}'])
def test_evaluation_refuses_what_is_not_a_calibration(work, capsys, content):
    (work / "other.json").write_text(content)
    given = {"calibration": work / "other.json", "extended": None}
    assert evaluate(work, work / "none.json", **given) == 2
    assert "other.json" in capsys.readouterr().err


def test_calibrated_model_is_exported(work, combined, tmp_path):
    assert export(work, tmp_path, extended=None) == 0
    model = yaml.safe_load((tmp_path / "model.yaml").read_text())
    exported = {name: p for term in model["terms"] for name, p in term["parameters"].items()}
    assert len(exported) == 30
    for name, parameter in exported.items():
        assert parameter["value"] == combined["parameters"][name]["value"]
        if combined["parameters"][name]["identifiable"]:
            std = combined["parameters"][name]["std"]
            assert parameter["std"] == pytest.approx(std, rel=1e-6)
    provenance = model["fitted_to"]["provenance"]
    assert "synthetic" in provenance or "virtual" in provenance
    assert "joint_6" in (tmp_path / "robot.urdf").read_text()


def test_what_is_exported_says_its_grade(work, combined, tmp_path):
    assert export(work, tmp_path, extended=None) == 0
    health = combined["health"]
    model = yaml.safe_load((tmp_path / "model.yaml").read_text())
    assert (model["fitted_to"]["grade"], model["forced"]) == (health["grade"], None)
    assert load_model(tmp_path / "model.yaml").grade == health["grade"]
    urdf = (tmp_path / "robot.urdf").read_text()
    assert f"<!-- {health['grade']}: {health['line']} -->" in urdf


def test_what_is_exported_says_what_a_urdf_lacks_and_has_all_links(work, tmp_path):
    given = table_of(work) | {"dh": tmp_path / "dh.csv", "extended": None}
    assert export(work, tmp_path, **given) == 0
    urdf = (tmp_path / "robot.urdf").read_text()
    assert "a URDF cannot hold joint_spring of joint" in urdf
    assert re.search(r"measured poses these move the flange by \d\.\d{3} mm rms", urdf)
    assert re.search("cell-null, .*virtual|cell-null, .*synthetic", urdf)
    assert '<link name="flange" />' in urdf
    assert '<link name="tool" />' in urdf
    assert (tmp_path / "dh.csv").read_text().startswith("joint,theta_nominal_deg,")
    assert not (tmp_path / "ur_kinematics.yaml").exists()
    content = yaml.safe_load((tmp_path / "model.yaml").read_text())
    assert np.array(content["T_flange"]["tool"]).shape == (4, 4)
    assert content["fitted_to"]["loads_N"] == [0.0, 22.0, 44.0]


@pytest.mark.parametrize("grade", ["suspect_input", "not_converged"])
def test_a_grade_that_is_withheld_takes_force_and_is_marked(
    work, combined, tmp_path, capsys, grade
):
    bad = tmp_path / "bad.json"
    health = {**combined["health"], "grade": grade, "line": "joint 6: its sign -- reverse it"}
    bad.write_text(json.dumps({**combined, "health": health}))
    given = {"calibration": bad, "extended": None}
    assert export(work, tmp_path, **given) == 2
    refusal = capsys.readouterr().err
    assert f"a calibration of grade {grade} is not exported" in refusal
    assert "joint 6: its sign" in refusal
    assert "--force" in refusal
    assert not list(tmp_path.glob("robot*"))
    assert export(work, tmp_path, **given, force=True) == 0
    model = yaml.safe_load((tmp_path / "model.yaml").read_text())
    assert model["forced"] == f"exported with --force; {grade}: joint 6: its sign -- reverse it"
    comment = f"<!-- exported with - -force; {grade}: joint 6: its sign - - reverse it -->"
    assert comment in (tmp_path / "robot.urdf").read_text()


@pytest.mark.parametrize("confirmed", [True, False])
def test_departures_that_the_effects_confirm_withhold_no_export(
    work, combined, tmp_path, confirmed
):
    wrong = {"what": "1 deg off", "where": "delta_theta_3", "remedy": "mend", "kind": "departure"}
    health = {**combined["health"], "grade": "suspect_input", "findings": [wrong]}
    plain = combined["fitted_model"]
    suspected = FittedTo.model_validate(
        {**plain["fitted_to"], "grade": "suspect_input", "suspicions": [wrong]}
    )
    bad, with_effects = tmp_path / "bad.json", tmp_path / "extended.json"
    content = {**plain, "fitted_to": suspected.model_dump(mode="json")}
    bad.write_text(json.dumps({**combined, "health": health, "fitted_model": content}))
    about = suspected.confirmed() if confirmed else suspected
    found = ExtendedRecord(
        campaign="cell-null", provenance=combined["provenance"], parameters={},
        T_instr_base=np.eye(4), robot="pa10_6ce", calibration="combined", verdict="named",
        fitted_model={**plain, "fitted_to": about.model_dump(mode="json")},
        arrival_from_order=False, named=(effect("backlash", "joint 1", {}),), warnings=(),
    )  # fmt: skip
    write(found, with_effects)
    given = {"calibration": bad, "extended": with_effects}
    assert export(work, tmp_path, **given) == (0 if confirmed else 2)
    if confirmed:
        model = yaml.safe_load((tmp_path / "model.yaml").read_text())
        assert (model["grade"], model["forced"]) == ("incomplete", None)


def test_a_fit_that_did_not_converge_is_not_exported(work, combined, tmp_path, capsys):
    bad = tmp_path / "bad.json"
    bad.write_text(json.dumps({**combined, "status": "not converged"}))
    given = {"calibration": bad, "extended": None}
    assert export(work, tmp_path, **given) == 2
    assert "not converged" in capsys.readouterr().err
    assert not list(tmp_path.glob("robot*"))
    model = combined["fitted_model"]
    springs = [{**term, "x": []} for term in model["terms"] if term["id"] == "joint_spring"]
    bad.write_text(json.dumps({**combined, "fitted_model": {**model, "terms": springs}}))
    assert export(work, tmp_path, **given) == 2
    assert "fitted_model of cubic: terms[0]: x: values that do not fit" in capsys.readouterr().err
