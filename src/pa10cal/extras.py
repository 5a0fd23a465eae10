"""Packages that only some commands need, and the extra of pyproject.toml that brings each."""

from __future__ import annotations

import sys

from pa10cal.errors import Pa10calError

#: The extra that brings a package, by the name of its module.
EXTRAS = {
    "matplotlib": "figures",
    "jinja2": "report",
    "plotly": "report",
    "snakemake": "workflow",
    "snakemake_executor_plugin_slurm": "slurm",
    "pinocchio": "urdf",
    "python_calamine": "workbooks",
}


class MissingPackageError(Pa10calError):
    """A command needs a package that comes with an extra, and it is not installed."""

    def __init__(self, module: str) -> None:
        super().__init__(
            f"the package {module} is not installed",
            where="the Python environment",
            value=sys.prefix,
            allowed=f"pa10cal installed with its extra `{EXTRAS[module]}`",
            remedy=how_to_install(module),
        )


def how_to_install(module: str) -> str:
    """Return what to do where one of `EXTRAS` is missing."""
    return f"pip install '.[{EXTRAS[module]}]' in the folder that pa10cal was installed from"


def missing_package(error: Exception) -> MissingPackageError | None:
    """Return the refusal that an error stands for, where it is one of `EXTRAS` that is missing."""
    module = (getattr(error, "name", None) or "").partition(".")[0]
    if isinstance(error, ModuleNotFoundError) and module in EXTRAS:
        return MissingPackageError(module)
    return None
