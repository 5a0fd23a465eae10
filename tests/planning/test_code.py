"""Which files a module is made of."""

from pathlib import Path

import pytest

import pa10cal
from pa10cal.planning import code
from pa10cal.planning.code import code_digest, source_files

PACKAGE = Path(pa10cal.__file__).parent


def files_of(*modules):
    return {path.relative_to(PACKAGE).as_posix() for path in source_files(*modules)}


def test_a_leaf_is_itself_and_its_packages():
    assert files_of("pa10cal.errors") == {"__init__.py", "errors.py", "py.typed"}


def test_follows_imports_and_brings_the_data_of_a_package():
    files = files_of("pa10cal.files.arms")
    assert {"files/arms.py", "files/arms/pa10_6ce.yaml", "arm/description.py", "errors.py"} <= files
    assert not [path for path in files if path.startswith(("calibration/", "commands/"))]


def test_follows_imports_inside_functions():
    files = files_of("pa10cal.stages.calibrate")
    assert {"calibration/load_case.py", "arm/chain.py", "calibration/options.py"} <= files
    assert not [path for path in files if path.startswith(("figures/", "montecarlo/"))]


def test_follows_imports_through_the_packages_beside():
    paths = source_files("pa10cal_lab.command_simulate")
    files = {path.relative_to(PACKAGE.parent).as_posix() for path in paths}
    assert {"pa10cal_lab/cell/robot.py", "pa10cal/arm/description.py"} <= files
    assert not [
        each for each in files if each.startswith(("pa10cal_curve/", "pa10cal/calibration/"))
    ]


def test_several_modules_give_the_union():
    both = files_of("pa10cal.errors", "pa10cal.arm.statics")
    assert both == files_of("pa10cal.errors") | files_of("pa10cal.arm.statics")


def test_the_order_does_not_depend_on_the_run():
    files = source_files("pa10cal.settings")
    assert list(files) == sorted(files)


def test_refuses_a_module_that_is_not_there():
    with pytest.raises(ModuleNotFoundError, match=r"pa10cal\.commands\.nothing"):
        source_files("pa10cal.commands.nothing")


def test_a_digest_is_that_of_the_files_alone():
    assert code_digest("pa10cal.errors") == code_digest("pa10cal.errors")
    assert code_digest("pa10cal.errors") != code_digest("pa10cal.arrays")


@pytest.mark.parametrize(
    "text",
    [
        "import pa10cal.settings",
        "from pa10cal import settings",
        "    from pa10cal.settings import (\n    Settings,  # all of it\n    Section as S,\n)",
        "from pa10cal.settings import Settings as S, Section",
        "import os, pa10cal.settings as s",
    ],
)
def test_every_way_to_import_is_followed(tmp_path, monkeypatch, text):
    package = tmp_path / "pa10cal"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "settings.py").write_text("")
    (package / "new.py").write_text(f"{text}\n")
    monkeypatch.setattr(code, "_FOLDER", tmp_path)
    assert package / "settings.py" in source_files("pa10cal.new")
    source_files.cache_clear()
