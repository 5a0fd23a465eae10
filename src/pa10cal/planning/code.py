"""Which files of the package a module is made of: the `code` input of every rule."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pa10cal

_PACKAGE = Path(pa10cal.__file__).parent


@cache
def source_files(*modules: str) -> tuple[Path, ...]:
    """Return the package's files that the modules need, found by following their imports.

    Imports inside functions count too. A package brings its `__init__` and the data files in its
    folder (arm descriptions, say); what lies outside pa10cal is pinned by the lock and left out.

    Args:
        modules: full names, such as `pa10cal.commands.ingest`.

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


@cache
def _imports(path: Path) -> tuple[str, ...]:
    """Return every name a file imports, `from a import b` as both `a` and `a.b`."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_bytes(), filename=str(path))):
        if isinstance(node, ast.Import):
            names.extend(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.append(node.module)
            names.extend(f"{node.module}.{alias.name}" for alias in node.names)
    return tuple(names)


def _data_files(package: Path) -> Iterator[Path]:
    """Yield the files of a package's folder that are not code, packages below it left out."""
    for entry in package.iterdir():
        if entry.is_dir():
            if entry.name != "__pycache__" and not (entry / "__init__.py").exists():
                yield from _data_files(entry)
        elif entry.suffix != ".py" and not entry.name.startswith("."):
            yield entry
