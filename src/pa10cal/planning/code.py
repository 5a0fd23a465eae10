"""Which files of the project a module is made of: the parameter `code` of every rule."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pa10cal

#: The folder of this package and of those beside it, whose names begin like its own.
_FOLDER = Path(pa10cal.__file__).parents[1]


@cache
def code_digest(*modules: str) -> str:
    """Return a digest of the files that the modules need: it changes when one of them does.

    Args:
        modules: full names, such as `pa10cal.stages.readings`.

    Raises:
        ModuleNotFoundError: when a module named here is in none of the packages.
    """
    digest = hashlib.sha256()
    for path in source_files(*modules):
        digest.update(f"{path.relative_to(_FOLDER).as_posix()} {_file_digest(path)}\n".encode())
    return digest.hexdigest()[:32]


@cache
def source_files(*modules: str) -> tuple[Path, ...]:
    """Return the project's files that the modules need, found by following their imports.

    Imports inside functions count too. A package brings its `__init__` and the data files in its
    folder (arm descriptions, say); what others wrote is pinned by the lock and left out.

    Args:
        modules: full names, such as `pa10cal.stages.readings`.

    Raises:
        ModuleNotFoundError: when a module named here is in none of the packages.
    """
    waiting = list(modules)
    paths: dict[str, Path] = {}
    while waiting:
        module = waiting.pop()
        if module in paths:
            continue
        there = _file_of(_FOLDER, module) if module.startswith(pa10cal.__name__) else None
        if there is None:
            if module in modules:
                raise ModuleNotFoundError(f"no module {module} in {_FOLDER}")
            continue  # the name of a function or class: `from pa10cal.errors import RawDataError`
        paths[module] = there
        if module == pa10cal.__name__:
            continue  # the public interface, which commands do not use
        imported = _imports(there)
        waiting += [*imported, *([module.rpartition(".")[0]] if "." in module else [])]
        if "pkgutil" in imported:  # it looks through its own package
            for path in there.parent.rglob("*.py"):
                parts = path.relative_to(_FOLDER).with_suffix("").parts
                waiting.append(".".join(parts).removesuffix(".__init__"))
    packages = {path.parent for path in paths.values() if path.name == "__init__.py"}
    data = {entry for package in packages for entry in _data_files(package)}
    return tuple(sorted(data | set(paths.values())))


@cache
def _file_of(folder: Path, module: str) -> Path | None:
    """Return the file of a module or package; None where a name is of neither."""
    place = folder.joinpath(*module.split("."))
    for path in (place / "__init__.py", place.with_suffix(".py")):
        if path.is_file():
            return path
    return None


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
    for statement in _IMPORT.finditer(path.read_text(encoding="utf-8")):
        module = statement["module"]
        listed = re.sub(r"#.*", "", statement["names"] or statement["block"] or statement["line"])
        # Without what they are called instead: `a, b as c`.
        words = [part.split()[0] for part in listed.split(",") if part.strip()]
        names += [module, *(f"{module}.{word}" for word in words)] if module else words
    return tuple(names)


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
