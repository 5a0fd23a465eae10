"""Arms of robot_descriptions by name, and xacro, with small packages in place of both."""

import sys
from pathlib import Path

import numpy as np
import pytest

from pa10cal.arm.chain import Chain
from pa10cal.arm.urdf_writing import urdf_text
from pa10cal.commands.command_line import main
from pa10cal.errors import ArmError, MissingPackageError
from pa10cal.files import known_arms
from pa10cal.files.arms import joint_names, load_arm, urdf_of_arm

#: Such a description clones its repository when it is imported.
CACHE = """
from types import SimpleNamespace
REPOSITORIES = {"robots": SimpleNamespace(cache_path="robots")}
def clone_to_cache(name, commit=None):
    raise AssertionError("a download")
"""
DESCRIPTION = """
from os import getenv
from os.path import join
from ._cache import clone_to_cache
REPOSITORY_PATH = clone_to_cache("robots", commit=getenv("ROBOT_DESCRIPTION_COMMIT", None))
"""
#: Puts in the arguments, as a xacro of one does.
XACRODOC = """
from pathlib import Path
class XacroDoc:
    def __init__(self, text): self.text = text
    @classmethod
    def from_file(cls, path, subargs, resolve_packages):
        text = Path(path).read_text() + Path("tail.xml").read_text()
        for name, value in subargs.items(): text = text.replace(f"$(arg {name})", value)
        if "$(arg" in text: raise KeyError("an argument is missing")
        return cls(text)
    def to_urdf_string(self): return self.text
"""
PACKAGES = """
def reset(): pass
def update_package_cache(folders): assert not folders
"""


def forget():
    for module in [*sys.modules]:
        if module.partition(".")[0] in ("robot_descriptions", "xacrodoc"):
            del sys.modules[module]
    known_arms.known_arm.cache_clear()


@pytest.fixture
def stand_ins(tmp_path, monkeypatch):
    """Both packages, and what was cloned; the folder that holds them."""
    package = tmp_path / "site/robot_descriptions"
    package.mkdir(parents=True)
    files = {
        "__init__": "",
        "_cache": CACHE,
        "plain_description": DESCRIPTION + 'URDF_PATH = join(REPOSITORY_PATH, "plain.urdf")',
        "folded_description": DESCRIPTION
        + 'XACRO_PATH = join(REPOSITORY_PATH, "folded.xacro")\nXACRO_ARGS = {"name": "folded"}',
        "shapes_description": DESCRIPTION + 'MJCF_PATH = "scene.xml"',
        "plain_mj_description": "",
    }
    for name, text in files.items():
        (package / f"{name}.py").write_text(text)
    xacrodoc = tmp_path / "site/xacrodoc"
    xacrodoc.mkdir()
    (xacrodoc / "__init__.py").write_text(XACRODOC)
    (xacrodoc / "packages.py").write_text(PACKAGES)
    cloned = tmp_path / "cache/robots"
    cloned.mkdir(parents=True)
    chain = Chain.of(load_arm("irb120"))
    text = urdf_text(chain, chain.nominal, "plain", frames={"tool0": np.eye(4)})
    (cloned / "plain.urdf").write_text(text)
    head, mark, tail = text.replace('name="plain"', 'name="$(arg name)"').partition("</robot>")
    (cloned / "folded.xacro").write_text(head)
    (cloned / "tail.xml").write_text(mark + tail)
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("ROBOT_DESCRIPTION_COMMIT", raising=False)
    forget()
    yield tmp_path
    forget()


@pytest.fixture
def without_packages(monkeypatch):
    forget()
    for module in ("robot_descriptions", "xacrodoc"):
        monkeypatch.setitem(sys.modules, module, None)
    yield
    known_arms.known_arm.cache_clear()


@pytest.mark.parametrize("name", ["plain", "folded"])
def test_an_arm_is_loaded_by_its_name_and_says_which_chain_it_is(stand_ins, name, tmp_path):
    arm = load_arm(name, tmp_path)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 6))
    expected = Chain.of(load_arm("irb120")).forward(q)
    np.testing.assert_allclose(Chain.of(arm).forward(q), expected, atol=1e-12)
    (told,) = arm.remarks
    assert told.startswith(f"{name} of robot_descriptions")
    assert "from link base to link tool0, joints 1 to 6: joint_1, joint_2" in told
    source = urdf_of_arm(name, tmp_path)
    assert f'<robot name="{name}">' in source.text
    assert (source.base, source.tip) == ("base", "tool0")
    assert joint_names(name, tmp_path) == tuple(f"joint_{k}" for k in range(1, 7))


def test_a_description_of_ones_own_and_a_shipped_arm_go_first(stand_ins, tmp_path):
    package = tmp_path / "site/robot_descriptions"
    (package / "ur10_description.py").write_text("raise AssertionError('imported')")
    assert load_arm("ur10").remarks == ()
    (tmp_path / "plain.yaml").write_text("name: plain\nrows: [{a_m: 0.3}]")
    assert load_arm("plain", tmp_path).n == 1


@pytest.mark.parametrize("gone", ["cache/robots", "cache/robots/plain.urdf"])
def test_nothing_is_fetched(stand_ins, gone, tmp_path):
    (tmp_path / gone).rename(tmp_path / "elsewhere")
    with pytest.raises(ArmError, match=r"not on this machine.*'plain'.*pull plain_description"):
        load_arm("plain")
    assert not (tmp_path / gone).exists()
    (tmp_path / "elsewhere").rename(tmp_path / gone)
    assert load_arm("plain").n == 6


def test_a_version_that_was_asked_for_is_looked_for(stand_ins, monkeypatch):
    monkeypatch.setenv("ROBOT_DESCRIPTION_COMMIT", "1234")
    with pytest.raises(ArmError, match=r"allowed: its files in .*robots-1234/robots; fetch"):
        load_arm("plain")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("shapes", "another form than URDF"),
        ("plane", "did you mean 'plain'"),
        ("plain_mj", r"unknown robot.*ur10, one of the 3 robots of robot_descriptions"),
        ("_cache", "unknown robot"),
        ("os.path", "unknown robot"),
    ],
)
def test_other_names_are_refused(stand_ins, name, message):
    with pytest.raises(ArmError, match=message):
        load_arm(name)


def test_a_package_that_works_otherwise_is_refused_and_nothing_is_fetched(stand_ins, tmp_path):
    (tmp_path / "site/robot_descriptions/_cache.py").write_text("def clone(): ...")
    with pytest.raises(ArmError, match=r"cannot be used: .*clone_to_cache.*pinned in users\.lock"):
        load_arm("plain")


def test_without_the_packages_what_to_install_is_said(without_packages, tmp_path):
    with pytest.raises(ArmError, match=r"unknown robot.*irb120.*pip install '\.\[arms\]'"):
        load_arm("ur5e")
    (tmp_path / "a.urdf.xacro").write_text("<robot/>")
    with pytest.raises(MissingPackageError, match=r"xacrodoc is not installed.*\[arms\]"):
        known_arms.read_urdf(tmp_path / "a.urdf.xacro")


def test_a_description_is_written_of_a_known_arm(stand_ins, tmp_path, capsys):
    out = tmp_path / "mine.yaml"
    assert main(["import_arm", "folded", "--out", str(out)]) == 0
    assert "From base to tool0, joints 1 to 6" in capsys.readouterr().out
    assert urdf_of_arm("mine", tmp_path).tip == "tool0"
    words = ["import_arm", "plain", "--tip", "link_6", "--out", str(out)]
    assert main(words) == 0
    assert "From base to link_6, joints 1 to 6" in capsys.readouterr().out
    assert "# Imported from plain of robot_descriptions" in out.read_text("utf-8")
    assert load_arm("mine", tmp_path).n == 6
    assert main(["import_arm", "plain", "--xacro", "a:=b", "--out", str(out)]) == 2
    assert "--xacro" in capsys.readouterr().err


def test_another_urdf_of_the_name_is_not_replaced(stand_ins, tmp_path, capsys):
    out, other = tmp_path / "mine.yaml", tmp_path / "mine.urdf"
    other.write_text("<robot name='cell'/>")
    assert main(["import_arm", "plain", "--out", str(out)]) == 2
    assert "would replace another one" in capsys.readouterr().err
    assert other.read_text() == "<robot name='cell'/>"
    assert not out.exists()


def test_a_folder_does_not_hide_a_known_arm_of_its_name(stand_ins, tmp_path, monkeypatch):
    (tmp_path / "plain").mkdir()
    monkeypatch.chdir(tmp_path)
    assert main(["import_arm", "plain", "--out", "mine.yaml"]) == 0


def test_a_xacro_file_is_imported_with_its_arguments(stand_ins, tmp_path, capsys):
    file, out = tmp_path / "cache/robots/folded.xacro", tmp_path / "mine.yaml"
    words = ["import_arm", str(file), "--out", str(out), "--tip", "tool0"]
    assert main(words) == 2
    assert "xacro cannot be expanded: 'an argument is missing'" in capsys.readouterr().err
    assert main([*words, "--xacro", "name"]) == 2
    assert "allowed: NAME:=VALUE" in capsys.readouterr().err
    assert main([*words, "--xacro", "name:=a b"]) == 0
    assert '<robot name="a b">' in out.with_suffix(".urdf").read_text("utf-8")


def test_a_name_that_is_imported_and_not_known_is_refused_with_what_may_be_meant(
    stand_ins, tmp_path, capsys
):
    assert main(["import_arm", "plains", "--out", str(tmp_path / "mine.yaml")]) == 2
    told = capsys.readouterr().err
    assert "no robot is known by this name (got 'plains')" in told
    assert "did you mean 'plain'?" in told


def test_a_name_that_is_imported_without_the_packages_is_refused_with_what_to_install(
    without_packages, tmp_path, capsys
):
    assert main(["import_arm", "ur5e", "--out", str(tmp_path / "mine.yaml")]) == 2
    assert "robot_descriptions, which knows many: pip install '.[arms]'" in capsys.readouterr().err


def test_a_xacro_file_is_found_by_a_path_from_here(stand_ins, monkeypatch):
    monkeypatch.chdir(stand_ins)
    text = known_arms.read_urdf(Path("cache/robots/folded.xacro"), {"name": "a"})
    assert '<robot name="a">' in text


@pytest.fixture
def real_packages():
    pytest.importorskip("robot_descriptions")
    pytest.importorskip("xacrodoc")
    forget()
    yield
    forget()


def test_the_real_package_is_kept_from_fetching(real_packages, tmp_path, monkeypatch):
    """And an arm of it is loaded by way of the real xacrodoc."""
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path))
    assert {"ur5e", "panda", "iiwa14"} <= set(known_arms.known_arm_names())
    with pytest.raises(ArmError, match=r"not on this machine.*pull ur5e_description"):
        load_arm("ur5e")
    assert not list(tmp_path.iterdir())
    import robot_descriptions._cache as real

    place = tmp_path / real.REPOSITORIES["Universal_Robots_ROS2_Description"].cache_path / "urdf"
    place.mkdir(parents=True)
    chain = Chain.of(load_arm("ur10"))
    text = urdf_text(chain, chain.nominal, "$(arg name)", frames={"tool0": np.eye(4)})
    names = "".join(f'<xacro:arg name="{each}" default=""/>' for each in ("name", "ur_type"))
    text = text.replace('">', '" xmlns:xacro="http://www.ros.org/wiki/xacro">' + names, 1)
    (place / "ur.urdf.xacro").write_text(text)
    arm = load_arm("ur5e")
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 6))
    np.testing.assert_allclose(Chain.of(arm).forward(q), chain.forward(q), atol=1e-9)
    assert "from link base to link tool0" in arm.remarks[0]


def test_packages_are_those_above_each_file_or_as_given(real_packages, tmp_path):
    """Though an earlier file was of a package of the same name."""
    space = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
    for owner in ("a", "b", "c"):
        package = tmp_path / owner / "my_arm"
        package.mkdir(parents=True)
        (package / "package.xml").write_text("<package><name>my_arm</name></package>")
        (package / "part.xacro").write_text(f'<robot {space}><link name="of_{owner}"/></robot>')
        (package / "arm.urdf.xacro").write_text(
            f'<robot name="r" {space}><xacro:include filename="$(find my_arm)/part.xacro"/></robot>'
        )
    given = {"my_arm": tmp_path / "c/my_arm"}
    for owner, packages, part in (
        ("a", {}, "a"),
        ("b", {}, "b"),
        ("b", given, "c"),
        ("a", {}, "a"),
    ):
        file = tmp_path / owner / "my_arm/arm.urdf.xacro"
        assert f'<link name="of_{part}"/>' in known_arms.expanded(file, {}, packages)
