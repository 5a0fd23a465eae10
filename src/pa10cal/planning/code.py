"""Which files of the package a module is made of: the parameter `code` of every rule."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pa10cal

_PACKAGE = Path(pa10cal.__file__).parent


@cache
def code_digest(*modules: str) -> str:
    """Return a digest of the files that the modules need: it changes when one of them does.

    Args:
        modules: full names, such as `pa10cal.stages.readings`.

    Raises:
        ModuleNotFoundError: when a module named here is not in the package.
    """
    digest = hashlib.sha256()
    for path in source_files(*modules):
        digest.update(f"{path.relative_to(_PACKAGE).as_posix()} {_file_digest(path)}\n".encode())
    return digest.hexdigest()[:32]


@cache
def source_files(*modules: str) -> tuple[Path, ...]:
    """Return the package's files that the modules need, found by following their imports.

    Imports inside functions count too. A package brings its `__init__` and the data files in its
    folder (arm descriptions, say); what lies outside pa10cal is pinned by the lock and left out.

    Args:
        modules: full names, such as `pa10cal.stages.readings`.

    Raises:
        ModuleNotFoundError: when a module named here is not in the package.
    """
    waiting = list(modules)
    found: dict[str, Path] = {}
    while waiting:
        module = waiting.pop()
        if module in found:
            continue
        path = _path_of(module)
        if path is None:
            if module in modules:
                raise ModuleNotFoundError(f"no module {module} in {_PACKAGE}")
            continue  # the name of a function or class: `from pa10cal.errors import RawDataError`
        found[module] = path
        if module == _PACKAGE.name:
            continue  # the public interface, which commands do not use
        waiting.extend(_imports(path))
        if "pkgutil" in _imports(path):  # it looks through its own package
            waiting.extend(_modules_below(path.parent))
        if "." in module:
            waiting.append(module.rpartition(".")[0])
    packages = {path.parent for path in found.values() if path.name == "__init__.py"}
    data = {entry for package in packages for entry in _data_files(package)}
    return tuple(sorted(data | set(found.values())))


def _modules_below(folder: Path) -> Iterator[str]:
    """Yield the names of all modules in a folder of the package and in those below it."""
    for path in folder.rglob("*.py"):
        parts = path.relative_to(_PACKAGE.parent).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _path_of(module: str) -> Path | None:
    """Return the file of a module or package of pa10cal, None when there is no such module."""
    top, *rest = module.split(".")
    if top != _PACKAGE.name:
        return None
    place = _PACKAGE.joinpath(*rest)
    candidates = (place / "__init__.py", place.with_suffix(".py"))
    return next((path for path in candidates if path.is_file()), None)


#: `import a, b` and `from a import b, c`, the names in brackets over several lines or not. That a
#: docstring may show such a line does no harm: what it names counts as needed.
_IMPORT = re.compile(
    r"^[ \t]*(?:import (?P<names>[^#\n(]+)"
    r"|from (?P<module>[\w.]+) import (?:\((?P<block>[^)]*)\)|(?P<line>[^#\n(]+)))",
    re.MULTILINE,
)


@cache
def _imports(path: Path) -> tuple[str, ...]:
    """Return every name a file imports, `from a import b` as both `a` and `a.b`."""
    names: list[str] = []
    for found in _IMPORT.finditer(_text(path)):
        if found["module"]:
            inside = re.sub(r"#.*", "", found["block"] or found["line"])
            names.append(found["module"])
            names.extend(f"{found['module']}.{name}" for name in _first_words(inside))
        else:
            names.extend(_first_words(found["names"]))
    return tuple(names)


def _first_words(names: str) -> list[str]:
    """Return the names of `a, b as c`, without what they are called instead."""
    return [part.split()[0] for part in names.split(",") if part.strip()]


@cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def _file_digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _data_files(package: Path) -> Iterator[Path]:
    """Yield the files of a package's folder that are not code, packages below it omitted."""
    for entry in package.iterdir():
        if entry.is_dir():
            if entry.name != "__pycache__" and not (entry / "__init__.py").exists():
                yield from _data_files(entry)
        elif entry.suffix != ".py" and not entry.name.startswith("."):
            yield entry
