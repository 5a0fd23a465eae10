"""Settings: defaults in config.yaml, refusals with the nearest right name."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import get_args

import pytest
import yaml
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from pydantic import Field

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.command_settings import ChainOptions, PictureOptions
from pa10cal.errors import SettingsError
from pa10cal.options import MonteCarloOptions, Section
from pa10cal.settings import Settings, parse_settings
from pa10cal.settings_reading import parse_section, read_settings_argument
from pa10cal_curve.options import CurveOptions
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.options import OUTSIDE_STUDIES, TRIAL_STUDIES

ROOT = Path(__file__).parents[1]
CHOSEN = {"campaigns", "simulate"}


@pytest.fixture(scope="module")
def config():
    return yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))


def test_config_writes_out_every_default(config):
    defaults = Settings(campaigns=("c1",)).model_dump(mode="json", exclude=CHOSEN)
    written = {key: value for key, value in config.items() if key not in CHOSEN}
    assert written == defaults


def test_config_explains_every_setting():
    lines = (ROOT / "config.yaml").read_text(encoding="utf-8").splitlines()
    settings = [line for line in lines if line.strip() and not line.startswith("#")]
    bare = [
        line
        for line in settings
        if " # " not in line
        and not line.startswith(("  lightcap2008", "      - {id:", "    - {robot:"))
    ]
    assert not bare


def test_config_shows_how_to_ask_for_any_arm_with_every_default():
    lines = (ROOT / "config.yaml").read_text(encoding="utf-8").splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("  # any-arm:"))
    shown = yaml.safe_load("\n".join(line.removeprefix("  # ") for line in lines[first:]))
    written = shown["any-arm"]
    assert parse_settings({"campaigns": ["c1"], "simulate": shown}, where="config.yaml")
    defaults = SimulateOptions(without_touches=TrackerOptions()).model_dump(mode="json")
    assert written == {key: defaults[key] for key in ("random_seed", "robot", "without_touches")}


def test_config_is_accepted_and_names_the_shipped_campaigns(config):
    settings = parse_settings(config, where="config.yaml")
    assert settings.campaigns == ("cell-a", "cell-null", "lightcap2008")
    assert set(settings.simulate) == {"lightcap2008"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"montecarl": {}}, ["unknown key montecarl", "'montecarlo'"]),
        ({'campaigns=["a"] raw_dir=b': 1}, ["unknown key campaigns=[", "remove it"]),
        ({"calibration": {"start": 3}}, ["unknown key calibration.start;", "'starts'"]),
        ({"calibration": {"tolerances": {"a_mm": 1}}}, ["calibration.tolerances.a_mm", "'a_m'"]),
        ({"simulate": {"x": {"seed": 1}}}, ["unknown key simulate.x.seed"]),
        (
            {"simulate": {"x": {"without_touches": {"pose": 9}}}},
            ["simulate.x.without_touches.pose;", "'poses'"],
        ),
        ({"simulate": {"x": {"without_touches": {}, "repeats": 3}}}, ["repeats is for touches"]),
        ({"ingest": {"still_speed_deg_s": -1}}, ["ingest.still_speed_deg_s", "-1", "than 0"]),
        ({"campaigns": []}, ["key campaigns does not fit", "at least 1"]),
        ({"campaigns": ["cell-a", "../b"]}, ["key campaigns.1", "'../b'", "letters, digits"]),
        ({"simulate": {".x": {}}}, ["key simulate..x", "not beginning with '.' or '-'"]),
        (
            {"calibration": {"effects": [{"id": "transmision_error", "of": "joint 2"}]}},
            ["key calibration.effects.0.id", "did you mean 'transmission_error'?"],
        ),
        (
            {"calibration": {"effects": [{"id": "backlash", "off": "joint 2"}]}},
            ["unknown key calibration.effects.0.off", "allowed: id, of;", "'of'"],
        ),
        ({"calibration": {"effects": "name"}}, ["key calibration.effects", "named"]),
        ({"calibration": {"epsilon_acts_on": "both"}}, ["'both'", "'residual' or 'cost'"]),
        # What would wreck results.
        ({"calibration": {"flexible_joints": [2, 2]}}, ["each joint once"]),
        ({"calibration": {"random_seed": -1}}, ["random_seed"]),
        ({"montecarlo": {"planes_mm": []}}, ["planes_mm"]),
        ({"montecarlo": {"planes_mm": [-100]}}, ["planes_mm"]),
        ({"ingest": {"stray_touch_sigma": float("inf")}}, ["stray_touch_sigma"]),
        ({"raw_dir": "data/raw", "results_dir": "data/raw/results"}, ["only read"]),
        # Names that are not fit for a folder.
        *(
            ({"campaigns": [name]}, ["key campaigns.0 does not fit"])
            for name in ("", "a b", "a/b", "..", ".hidden", "-r", "curve", "ä:1")
        ),
    ],
)
def test_refusal_names_key_value_and_remedy(config, change, words):
    with pytest.raises(SettingsError) as caught:
        parse_settings({**config, **change}, where="my.yaml")
    message = str(caught.value)
    assert message.startswith("my.yaml: ")
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("raw", [None, 3, ["campaigns"], {}])
def test_refuses_what_is_no_configuration(raw):
    with pytest.raises(SettingsError):
        parse_settings(raw, where="config.yaml")


@given(
    cycles=st.integers(2, 10**9),
    sigma_deg=st.floats(1e-9, 10),
    planes_mm=st.lists(st.integers(0, 2000), min_size=1),
)
@hypothesis_settings(max_examples=30, deadline=None)
def test_what_a_rule_passes_is_what_the_stage_reads(cycles, sigma_deg, planes_mm):
    section = MonteCarloOptions(cycles=cycles, sigma_deg=sigma_deg, planes_mm=tuple(planes_mm))
    assert read_settings_argument(MonteCarloOptions, section.model_dump_json()) == section


def test_reads_a_section_from_a_file(tmp_path):
    path = tmp_path / "calibration.yaml"
    path.write_text("starts: 3\ninner_poses: all\n", encoding="utf-8")
    section = read_settings_argument(CalibrationOptions, str(path))
    assert (section.starts, section.inner_poses) == (3, "all")


def test_refuses_a_file_or_json_that_cannot_be_read(tmp_path):
    path = tmp_path / "calibration.yaml"
    for _ in range(2):  # not there, then broken
        with pytest.raises(SettingsError, match=r"calibration\.yaml: settings cannot be read"):
            read_settings_argument(CalibrationOptions, str(path))
        path.write_text("starts: [", encoding="utf-8")
    with pytest.raises(SettingsError, match="--settings"):
        read_settings_argument(CalibrationOptions, '{"starts": 3')


def test_settings_cannot_be_changed_once_read():
    settings = CalibrationOptions()
    with pytest.raises(ValueError, match="frozen"):
        settings.starts = 3


def test_an_unknown_key_is_refused_in_every_section():
    for name, field in Settings.model_fields.items():
        if hasattr(field.annotation, "model_fields"):
            with pytest.raises(SettingsError, match=f"unknown key {name}.nonsense"):
                parse_settings(
                    json.loads(json.dumps({"campaigns": ["c1"], name: {"nonsense": 1}})), where="x"
                )


@pytest.mark.parametrize(
    ("springs", "place"),
    [([0], ".0"), ([1, 1.5], ".1"), (2, ""), (0, ""), ("all", ""), (-1, "")],
)
def test_a_value_of_several_types_is_refused_by_its_meaning(springs, place):
    with pytest.raises(SettingsError) as refusal:
        parse_settings(
            {"campaigns": ["c1"], "calibration": {"general": {"springs": springs}}}, where="here"
        )
    message = str(refusal.value)
    key = f"key calibration.general.springs{place}"
    assert f"{key} does not fit (got" in message
    assert "allowed: a list of joints from 1, those with a linear spring; or auto" in message
    assert message.endswith(f"set {key.removeprefix('key ')} accordingly")


@pytest.mark.parametrize("name", ["c1", "cell-a", "2024_10.b", "prüfstand", "_"])
def test_letters_digits_and_three_signs_make_a_name(name):
    assert parse_settings({"campaigns": [name]}, where="config.yaml").campaigns == (name,)


@pytest.mark.parametrize("effects", [[], "named", [{"id": "transmission_error", "of": "joint 2"}]])
def test_effects_to_calibrate_with(effects):
    raw = {"campaigns": ["c1"], "calibration": {"effects": effects}}
    assert (
        parse_settings(raw, where="x").model_dump(mode="json")["calibration"]["effects"] == effects
    )


def sections_below(section):
    """Yield a section and every one it holds."""
    yield section
    for field in section.model_fields.values():
        kinds = [field.annotation]
        while kinds:
            kind = kinds.pop()
            kinds.extend(get_args(kind))
            if isinstance(kind, type) and issubclass(kind, Section):
                yield from sections_below(kind)


@pytest.mark.parametrize("section", [Settings, CurveOptions, PictureOptions, ChainOptions])
def test_every_field_says_what_it_means(section):
    silent = [
        f"{each.__name__}.{name}"
        for each in sections_below(section)
        for name, field in each.model_fields.items()
        if not field.description
    ]
    assert not silent


@pytest.mark.parametrize(
    "study",
    [*TRIAL_STUDIES, *OUTSIDE_STUDIES, "blind_trials_distance", "wild_trials_outside", "curve"],
)
def test_a_campaign_cannot_have_the_name_of_a_folder_of_results(study):
    with pytest.raises(SettingsError, match=f"campaigns.0.*none of.* {study}"):
        parse_settings({"campaigns": [study]}, where="config.yaml")


class Part(Section):
    """A section within others."""

    size_mm: float = 1.0
    name: str = ""


class Whole(Section):
    """A section with parts of every kind."""

    part: Part = Part()
    listed: tuple[Part, ...] = ()
    named: Mapping[str, Part] = Field(default_factory=dict)
    numbers: tuple[float, ...] = ()
    pairs: tuple[tuple[int, float], ...] = ()
    by_name: Mapping[str, float] = Field(default_factory=dict)
    either: Part | int | None = None
    truth_or_number: bool | float = False


def refusal(raw, section=Whole):
    with pytest.raises(SettingsError) as caught:
        parse_section(section, raw, where="x")
    return str(caught.value)


@pytest.mark.parametrize(
    ("raw", "key"),
    [
        ({"part": {"size_mm": True}}, "part.size_mm"),
        ({"listed": [{}, {"size_mm": True}]}, "listed.1.size_mm"),
        ({"named": {"a": {"size_mm": False}}}, "named.a.size_mm"),
        ({"numbers": [1, True]}, "numbers.1"),
        ({"pairs": [[1, 2], [1, True]]}, "pairs.1.1"),
        ({"by_name": {"a": True}}, "by_name.a"),
        ({"either": True}, "either"),
        ({"either": {"size_mm": True}}, "either.size_mm"),
    ],
)
def test_yes_and_no_are_no_numbers_anywhere(raw, key):
    said = refusal(raw)
    assert f"key {key} does not fit: YAML reads" in said
    assert "write a number" in said


def test_true_and_false_are_taken_where_they_are_meant():
    assert parse_section(Whole, {"truth_or_number": True}, where="x").truth_or_number is True


def test_a_key_that_stands_twice_in_json_is_refused():
    with pytest.raises(SettingsError, match="the key starts stands there twice: remove one"):
        read_settings_argument(CalibrationOptions, '{"starts": 3, "starts": 4}')


def test_another_key_of_the_same_value_says_nothing_of_a_text():
    # No text is wanted of a number, also where a text is of a key beside it.
    said = refusal({"part": {"size_mm": None, "name": None}})
    assert "key part.size_mm does not fit; allowed: a valid number" in said
    assert "a text" not in said


@pytest.mark.parametrize(
    ("raw", "key"),
    [
        ({"calibration": {"inner_poses": 0}}, "calibration.inner_poses"),
        ({"calibration": {"general": {"springs": [0]}}}, "calibration.general.springs.0"),
        ({"simulate": {"int": {"random_seed": "x"}}}, "simulate.int.random_seed"),
    ],
)
def test_a_key_is_named_without_the_types_that_were_tried(raw, key):
    assert f"key {key} does not fit (got" in refusal({"campaigns": ["a"], **raw}, Settings)


@pytest.mark.parametrize(
    ("raw", "remedy"),
    [
        # A near word of the same section comes before one of that name elsewhere.
        ({"part": {"sizemm": 1}}, "did you mean 'size_mm'?"),
        ({"size_mm": 1}, "it belongs under part: part.size_mm"),
        ({"part": {"numbers": []}}, "it belongs under the top level: numbers"),
        ({"part": {"part": {}}}, "remove it"),  # what it stands in
    ],
)
def test_an_unknown_key_is_told_where_it_may_belong(raw, remedy):
    assert refusal(raw).endswith(remedy)


def test_a_near_word_beside_an_unknown_key_is_told_first():
    class Near(Section):
        names: str = ""
        part: Part = Part()

    assert refusal({"name": "a"}, Near).endswith("did you mean 'names'?")


def test_an_empty_section_is_told_as_one():
    said = refusal({"part": None})
    assert "key part does not fit: nothing is stated under it; allowed: name, size_mm" in said
    assert said.endswith("write its keys below it, indented, or remove it")
    assert refusal(None).endswith("write its keys")
