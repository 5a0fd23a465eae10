"""URDF and xacro files of arms, among them those that robot_descriptions knows by name.

Nothing is fetched: that package clones a repository when a description of it is imported; here its
files must be on the disk already.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import chdir, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any

from pa10cal.arm.urdf_ends import ends_of_arm
from pa10cal.arm.urdf_writing import UrdfSource
from pa10cal.errors import ArmError, MissingPackageError, how_to_install, one_line, remedy_for
from pa10cal.input_files import read_file, reason

if TYPE_CHECKING:
    from pa10cal.arm.urdf_import import ImportedArm

PACKAGE = "robot_descriptions"
XACRO = ".xacro"
#: Largest URDF that is read; that of a humanoid with all its inertias has a quarter of a megabyte.
_MOST_URDF_BYTES = 16 * 1024**2
#: Endings of the names of modules that describe a robot, and of those in another format.
_ENDING, _OTHER_FORMAT = "_description", "_mj"


@dataclass(frozen=True)
class KnownArm:
    """An arm of robot_descriptions."""

    imported: ImportedArm
    source: UrdfSource  # its URDF, xacro expanded


def known_arm_names() -> list[str]:
    """Return the names of the robots that robot_descriptions has; none if it is not installed."""
    package = find_spec(PACKAGE)
    if package is None or not package.submodule_search_locations:
        return []
    modules = [module.name for module in iter_modules(package.submodule_search_locations)]
    names = [name.removesuffix(_ENDING) for name in modules if name.endswith(_ENDING)]
    return sorted(name for name in names if name[:1] != "_" and not name.endswith(_OTHER_FORMAT))


@cache
def known_arm(name: str) -> KnownArm | None:
    """Return an arm of robot_descriptions; None where it has none of that name.

    Raises:
        ArmError: when its files are not on the disk, or cannot be used.
        MissingPackageError: when a package that is needed for it is not installed.
    """
    source = known_urdf(name)
    if source is None:
        return None
    from pa10cal.arm.urdf_import import arm_from_urdf_text  # late: it needs pinocchio

    base, tip = ends_of_arm(source.text, source.where)
    imported = arm_from_urdf_text(source.text, name, base=base, tip=tip, where=source.where)
    held = "".join(f"; {note}" for note in imported.notes if note.startswith("off the path"))
    remark = (
        f"{source.where}: from link {base} to link {tip}, joints 1 to {imported.arm.n}: "
        f"{', '.join(imported.joints)}{held}; other ends: pa10cal import_arm {name} --base LINK "
        f"--tip LINK --out my_arm.yaml"
    )
    arm = replace(imported.arm, title=f"{name} ({PACKAGE})", remarks=(one_line(remark),))
    return KnownArm(replace(imported, arm=arm), replace(source, base=base, tip=tip))


def known_urdf(name: str) -> UrdfSource | None:
    """Return the URDF of a robot of robot_descriptions, with no ends; None if it has no such robot.

    Raises:
        ArmError: when its files are not on the disk, or cannot be read.
        MissingPackageError: when xacro has to be expanded, and xacrodoc is not installed.
    """
    if name not in known_arm_names():
        return None
    module = _description(name)
    urdf = getattr(module, "URDF_PATH", None)
    path = urdf or getattr(module, "XACRO_PATH", None)
    if path is None:
        raise ArmError(
            "it is described in another form than URDF",
            where=PACKAGE,
            value=name,
            allowed="a robot with a URDF",
            remedy="give the file of a description",
        )
    file = Path(path)
    if not file.is_file():
        raise _not_on_disk(name, file)
    if urdf is not None:
        text = read_urdf(file)
    else:
        arguments = getattr(module, "XACRO_ARGS", {})
        text = expanded(file, arguments, getattr(module, "XACRO_PACKAGE_PATHS", {}))
    try:
        of_version = f" {version(PACKAGE)}"
    except PackageNotFoundError:
        of_version = ""
    return UrdfSource(text, f"{name} of {PACKAGE}{of_version}", "", "")


def refuse_unknown(name: str) -> ArmError:
    """Return the refusal of a name of no file, and of no robot of robot_descriptions."""
    known = known_arm_names()
    if known:
        remedy = remedy_for(name, known, "correct the name, or give the path of a file")
    else:
        remedy = (
            f"check the path; if it is the name of a robot, install {PACKAGE}, which knows many: "
            f"{how_to_install(PACKAGE)}"
        )
    return ArmError(
        "no such file is here, and no robot is known by this name",
        where="the URDF",
        value=name,
        allowed=f"a URDF file, or the name of a robot of {PACKAGE}",
        remedy=remedy,
    )


def read_urdf(path: Path, arguments: Mapping[str, str] | None = None) -> str:
    """Return the text of a URDF file; of one that ends in `.xacro`, as it is expanded.

    Raises:
        ArmError: when it cannot be read or expanded.
        MissingPackageError: when it has to be expanded, and xacrodoc is not installed.
    """
    try:
        text = read_urdf_text(path)
    except (OSError, ValueError) as error:
        raise ArmError(
            f"the URDF cannot be read: {reason(error)}",
            where=str(path),
            allowed="a URDF file, UTF-8",
            remedy="check the path",
        ) from None
    return expanded(path, arguments or {}) if path.suffix == XACRO else text


def read_urdf_text(path: Path, *within: Path) -> str:
    """Return the text of a URDF file, which must lie in one of some folders if any are given.

    Raises:
        OSError, ValueError: whose `reason` says why it cannot be read.
    """
    return utf8_text(read_file(path, _MOST_URDF_BYTES, *within))


def utf8_text(content: bytes) -> str:
    """Return UTF-8 text without its byte order mark; a ValueError says that it is none."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError("it is not UTF-8 text") from None


def expanded(
    path: Path, arguments: Mapping[str, str], packages: Mapping[str, str | Path] | None = None
) -> str:
    """Return the URDF that a xacro file expands to.

    Args:
        path: the file; expressions in it are evaluated, and files that it includes are read.
        arguments: values of its arguments.
        packages: folders of the packages that it refers to, by their names; those above the file
            are found without. What an earlier call found is forgotten.

    Raises:
        ArmError: when it cannot be expanded.
        MissingPackageError: when xacrodoc is not installed.
    """
    if find_spec("xacrodoc") is None:
        raise MissingPackageError("xacrodoc")
    xacrodoc: Any = import_module("xacrodoc")
    finder: Any = import_module("xacrodoc.packages")
    finder.reset()
    finder.update_package_cache(dict(packages or {}))
    file = path.absolute()
    try:
        with chdir(file.parent):  # what it includes is named from its own folder
            document = xacrodoc.XacroDoc.from_file(
                str(file), subargs=dict(arguments), resolve_packages=False
            )
            return str(document.to_urdf_string())
    except Exception as error:  # of xacro, of expressions, of files included: any kind
        raise ArmError(
            f"xacro cannot be expanded: {one_line(str(error)) or type(error).__name__}",
            where=str(path),
            value=" ".join(f"{key}:={value}" for key, value in arguments.items()) or None,
            allowed="a xacro file whose includes, packages and arguments are there",
            remedy="state its arguments with --xacro NAME:=VALUE, or expand it yourself: "
            "xacro robot.urdf.xacro > robot.urdf",
        ) from None


def _description(name: str) -> Any:
    """Import a module of robot_descriptions, its files being on the disk."""
    try:
        with _nothing_fetched(name):
            return import_module(f"{PACKAGE}.{name}{_ENDING}")
    except (ImportError, AttributeError, KeyError) as error:
        raise ArmError(
            f"the package {PACKAGE} cannot be used: {one_line(str(error))}",
            where="robot",
            value=name,
            allowed=f"{PACKAGE} as it is pinned in users.lock, with git",
            remedy="install that version, or give the file of a description",
        ) from None


@contextmanager
def _nothing_fetched(name: str) -> Iterator[None]:
    """Let descriptions look for their files in the package's cache, and clone nothing."""
    of_package: Any = import_module(f"{PACKAGE}._cache")
    fetch = of_package.clone_to_cache

    def on_disk(repository: str, commit: str | None = None) -> str:
        place = of_package.REPOSITORIES[repository].cache_path
        if commit is not None:
            place = f"{place}-{commit}/{place}"
        caches = os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions")
        folder = Path(caches).expanduser() / place
        if not folder.is_dir():
            raise _not_on_disk(name, folder)
        return str(folder)

    of_package.clone_to_cache = on_disk
    try:
        yield
    finally:
        of_package.clone_to_cache = fetch


def _not_on_disk(name: str, place: Path) -> ArmError:
    return ArmError(
        f"{PACKAGE} knows this arm, but its files are not on this machine, and none is fetched",
        where="robot",
        value=name,
        allowed=f"its files in {place}",
        remedy=f"fetch them where there is a network: {PACKAGE} pull {name}{_ENDING}; or copy "
        "them there; or give the file of a description",
    )
