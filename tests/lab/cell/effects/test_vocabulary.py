"""From settings entries to effects."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest

from pa10cal.errors import SettingsError
from pa10cal_lab.cell.effects.vocabulary import all_effects, make_effects, vocabulary
from pa10cal_lab.cell.options import HiddenEffectOptions

#: A good entry of every effect of the contract.
GOOD = [
    ("transmission_error", "joint 1", {"A": 3e-4, "phi": 0.0}),
    ("encoder_eccentricity", "joint 6", {"A": 3e-4, "phi": 0.0}),
    ("encoder_ellipticity", "joint 2", {"A": 3e-4, "phi": 0.0}),
    ("joint_error_map", "joint 3", {"knots": [0.0, 1e-4, -1e-4, 2e-4]}),
    ("gear_ratio_error", "joint 2", {"eps": 1e-4}),
    ("backlash", "joint 2", {"b": 1e-4}),
    ("friction_torque", "joint 2", {"tau_c": 4.0}),
    ("torque_gain", "joint 2", {"g": 0.05}),
    ("joint_compliance", "joint 4", {"K": 1e4}),
    ("soft_windup", "joint 2", {"A": 1e-4, "tau0": 10.0}),
    ("joint_coupling", "joint 5", {"c": 1e-3, "by": 4}),
    ("wrist_coupling", "wrist", {"c": 1e-4}),
    ("link_bending", "upper_arm", {"c": 1e-6}),
    ("link_torsion", "forearm", {"c": 1e-6}),
    ("base_compliance", "base", {"cx": 1e-6, "cy": 1e-6}),
    ("base_drift", "base", {"rate": [1e-5, 0.0, 0.0]}),
    ("thermal_growth", "arm", {"alpha": 2e-5}),
    ("link_growth", "forearm", {"alpha": 5e-5}),
    ("tool_sag", "tool", {"c": 3e-5}),
    ("cmm_scale", "instrument", {"s": [1e-4, 0.0, 0.0]}),
    ("cmm_squareness", "instrument", {"xy": 1e-4}),
]


def entry(id_, of, parameters):
    return HiddenEffectOptions(id=id_, of=of, parameters=parameters)


def test_entries_become_effects_with_their_parameters(robot):
    effects = make_effects([entry(*good) for good in GOOD], robot)
    assert {effect.id for effect in effects} <= set(all_effects())
    for effect, (_, of, parameters) in zip(effects, GOOD, strict=True):
        assert effect.of == of
        found = effect.model_dump()
        assert set(found) == set(parameters)
        for name, value in parameters.items():
            assert np.array_equal(found[name], value)


def test_every_parameter_says_what_it_is_and_its_unit():
    for effect in all_effects().values():
        for name, field in effect.model_fields.items():
            assert field.description, f"{effect.id}.{name}"


def test_the_class_in_the_docs_is_the_one_that_there_is():
    page = Path(__file__).parents[4] / "docs/virtual-cell.md"
    (text,) = re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)
    assert text == inspect.getsource(vocabulary()["gear_ratio_error"])


BAD = [
    (("transmision_error", "joint 1", {"A": 1, "phi": 0}), ["unknown", "'transmission_error'"]),
    (("sag", "tool", {"c": 1e-5}), ["hidden_effects[1].id", "'tool_sag'"]),
    (("backlash", "joint 7", {"b": 1e-4}), ["hidden_effects[1].of", "joint 7", "joint 6"]),
    (("backlash", "joint 0", {"b": 1e-4}), ["cannot sit there"]),
    (("backlash", "base", {"b": 1e-4}), ["cannot sit there", "base"]),
    (("link_torsion", "upper_arm", {"c": 1e-6}), ["cannot sit there", "forearm"]),
    (("joint_compliance", "joint 2", {"K": 1e4}), ["joint 1, joint 4, joint 6"]),
    (("soft_windup", "joint 2", {"A": 1e-4}), ["missing key tau0", "N m"]),
    (("backlash", "joint 2", {"b": 1e-4, "c": 1}), ["unknown key c", "remove it"]),
    (("backlash", "joint 2", {"of": 1e-4}), ["unknown key of"]),
    (("backlash", "joint 2", {"b": float("nan")}), ["finite"]),
    (("backlash", "joint 2", {"b": float("inf")}), ["finite"]),
    (("backlash", "joint 2", {"b": "wide"}), ["wide", "number"]),
    (("joint_compliance", "joint 4", {"K": -1.0}), ["greater than 0"]),
    (("base_drift", "base", {"rate": [1e-5, 0.0]}), ["rate"]),
    (("joint_error_map", "joint 2", {"knots": [0.0]}), ["knots", "at least 3"]),
]


@pytest.mark.parametrize(
    ("bad", "words"), BAD, ids=[f"{bad[0]}-{i}" for i, (bad, _) in enumerate(BAD)]
)
def test_refuses_what_cannot_be_hidden(robot, bad, words):
    with pytest.raises(SettingsError) as refusal:
        make_effects([entry(*GOOD[0]), entry(*bad)], robot)
    for word in words:
        assert word in str(refusal.value)
