"""Controllers that correct an arm themselves: what is stated, and what targets are relative to."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

import pa10cal
from made_up_model import postures
from made_up_sightings import sighted
from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Controller
from pa10cal.campaign.description import nominal_arm, read_description
from pa10cal.errors import ArmError, ModelError, RawDataError, SettingsError
from pa10cal.files.arms import arm_text, load_arm
from pa10cal.files.controller import controller_notes, controller_warnings
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_reading import load_model
from pa10cal.planning.campaign import arm_files
from pa10cal.terms.model import Model


def measured(name="factory"):
    """The UR10 as a maker may have measured it: links some tenths of a millimetre off."""
    arm, rng = load_arm("ur10"), np.random.default_rng(6)
    d_m, a_m = (each + rng.normal(0, 5e-4, 6) for each in (arm.d_m, arm.a_m))
    d_m = np.where(arm.hayati, arm.d_m, d_m)
    theta = arm.theta_rad + rng.normal(0, 5e-4, 6)
    unweighed = {"mass_kg": None, "com_m": None}
    return replace(arm, name=name, d_m=d_m, a_m=a_m, theta_rad=theta, **unweighed)


@pytest.fixture
def raw(tmp_path):
    """A campaign beside which the controller's own model lies, and one that says so of itself."""
    made = sighted(tmp_path, "pose", noise_mm=0.01)
    made.extra["factory.yaml"] = arm_text(measured()).encode()
    own = arm_text(measured("own"), maker_calibration={"of": "ur10"})
    made.extra["own.yaml"] = own.encode()
    made.extra["alone.yaml"] = arm_text(measured("alone"), maker_calibration={}).encode()
    return made


def arm_of(raw, robot, **stated):
    raw.description |= {"robot": robot, **({"controller": stated} if stated else {})}
    folder = raw.write()
    return nominal_arm(read_description(folder), folder)


@pytest.mark.parametrize(
    ("robot", "stated", "computes"),
    [
        ("ur10", {}, "ur10"),
        ("ur10", {"compensation": False}, "ur10"),  # what YAML makes of off
        ("ur10", {"compensation": "off"}, "ur10"),
        ("ur10", {"compensation": True}, None),
        ("ur10", {"compensation": True, "model": "factory"}, "factory"),
        ("ur10", {"compensation": True, "model": "ur10"}, "ur10"),
        ("own", {}, "own"),
        ("own", {"compensation": True}, "own"),
        ("own", {"compensation": False}, "ur10"),
        ("alone", {"compensation": True}, "alone"),
        ("alone", {"compensation": False}, None),
    ],
)
def test_what_a_controller_computes_with_follows_from_what_is_stated(raw, robot, stated, computes):
    arm = arm_of(raw, robot, **stated)
    found = arm.controller_arm
    assert (None if found is None else found.name) == computes
    assert (arm.controller is None) == (not stated)


def test_yaml_words_are_read_as_they_are_written(raw):
    folder = raw.write()
    text = (folder / "campaign.yaml").read_text()
    for word in ("on", "off", "'on'"):
        (folder / "campaign.yaml").write_text(f"{text}\ncontroller: {{compensation: {word}}}\n")
        assert read_description(folder).controller.compensation == word.strip("'")


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"compensation": "maybe"}, r"controller\.compensation.*'on' or 'off'"),
        ({}, "controller.*compensation"),
        ({"compensation": "on", "modell": "factory"}, "did you mean 'model'"),
    ],
)
def test_what_cannot_be_meant_is_refused(raw, stated, message):
    raw.description["controller"] = stated
    with pytest.raises(SettingsError, match=message):
        read_description(raw.write())


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ("irb120", r"controller: .*irb120, is of another robot.*mm in the mean of all"),
        ("gx4_351s", r"another robot.*4 joints, and 6 of ur10"),
        ("factor", "unknown robot"),
    ],
)
def test_a_model_of_another_robot_is_refused(raw, model, message):
    with pytest.raises(ArmError, match=message):
        arm_of(raw, "ur10", compensation=True, model=model)


def test_a_campaign_carries_its_controller_into_the_model(raw, tmp_path):
    raw.description["controller"] = {"compensation": True, "model": "factory"}
    folder = raw.write()
    assert {path.name for path in arm_files(folder)} == {"factory.yaml"}
    campaign = pa10cal.read_campaign(folder)
    assert any("(factory): Cartesian targets are relative" in note for note in campaign.notes)
    path = tmp_path / "model.yaml"
    pa10cal.calibrate(campaign).save(path)
    assert yaml.safe_load(path.read_text("utf-8"))["arm"]["controller"]["compensation"] == "on"
    model = load_model(path)
    q = np.random.default_rng(2).uniform(-1, 1, (5, 6))
    wanted = model.predict(q).T
    found = model.compensate(wanted, seed=q)
    # The controller goes its own way back, and the robot, which is the UR10 here, comes there.
    controller = FittedModel(Model(Chain.of(measured()), ()), np.zeros(0), np.eye(4))
    went = controller.compensate(found.T_send, seed=q).q
    np.testing.assert_allclose(went, found.q, atol=1e-9)
    reached = Chain.of(load_arm("ur10")).forward(went)
    np.testing.assert_allclose(reached[:, :3, 3], wanted[:, :3, 3], atol=5e-5)
    # Targets for the nominal arm correct it twice.
    twice = model.compensate(wanted, seed=q, controller=load_arm("ur10")).T_send
    astray = Chain.of(load_arm("ur10")).forward(controller.compensate(twice, seed=q).q)
    assert np.linalg.norm(astray[:, :3, 3] - wanted[:, :3, 3], axis=1).mean() > 5e-4


def test_without_the_controllers_model_there_are_no_cartesian_targets():
    arm = replace(load_arm("ur10"), controller=Controller(compensation=True, known=False))
    model = FittedModel(Model(Chain.of(arm), ()), np.zeros(0), np.eye(4))
    q = postures(arm, 4, 3)
    found = model.compensate(model.predict(q).T, seed=q)
    assert np.isnan(found.T_send).all()
    assert np.isfinite(found.q).all()
    with pytest.raises(ModelError, match=r"correct the robot twice.*controller\.model"):
        found.cartesian("rotation_vector")
    named = model.compensate(model.predict(q).T, seed=q, controller=measured())
    assert np.isfinite(named.cartesian("rotation_vector")["send_x_mm"]).all()


def test_reader_and_run_say_what_follows():
    arm = load_arm("ur10")
    on = Controller(compensation=True, known=False)
    assert "corrected Cartesian targets cannot be computed" in controller_notes(on, arm)[0]
    assert controller_notes(replace(on, known=True), arm) == ()
    assert controller_notes(Controller(compensation=False, known=True), arm) == ()
    assert controller_warnings(on, commanded=False) == ()
    assert "log what the encoders read" in controller_warnings(on, commanded=True)[0]
    assert controller_warnings(None, commanded=True) == ()


def test_campaigns_of_a_group_have_one_controller(tmp_path):
    folders = []
    for k, compensation in enumerate(("on", "off")):
        made = sighted(tmp_path, "pose", poses=20, seed=k)
        made.folder = tmp_path / f"c{k}"
        made.description |= {"name": f"c{k}", "controller": {"compensation": compensation}}
        folders.append(made.write())
    with pytest.raises(RawDataError, match=r"different controllers.*'on'.*'off'"):
        pa10cal.read_group(folders)
