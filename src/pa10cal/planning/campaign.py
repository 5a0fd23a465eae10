"""What planning has to know of a campaign, read leniently.

Content that cannot be read gives empty answers, so that the command is planned all the same and
refuses it, by file, line and remedy. `missing_campaign`, `check_prior`, `group_like_campaign` and
the functions that begin with `refuse` are the refusals of planning itself.

Results of another campaign, as a prior is, are no input of a rule: Snakemake would make them anew,
with the settings of this run. They are read as they are, and what they contain is a parameter.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from pa10cal.errors import OutputError, RawDataError, SettingsError, fits_a_folder
from pa10cal.files import own_description
from pa10cal.files.output import is_partial
from pa10cal.input_files import is_file, names_beside, open_file
from pa10cal.running.run_lock import refuse_at_work
from pa10cal.yaml_file import read_yaml

_BLOCK_BYTES = 1 << 20
#: A record states its schema within so many bytes.
_SCHEMA_BYTES = 100
_OF_CALIBRATION = ("*.json",)
_OF_READINGS = ("poses.parquet", "quarantine.csv")
#: Folders that a run makes, and removes, among the results of a campaign, and patterns of the files
#: in them; `members` is that of a group, with logs of its members, whose `ingest` holds its
#: description and that of its arm.
RESULT_FILES = {
    "members": (*_OF_READINGS, "base_frame.json", "*.log"),
    "ingest": (*_OF_READINGS, "*.yaml", "*.urdf", "*.xacro", "*.xml"),
    "seed": ("base_frame.json",),
    "baseline": _OF_CALIBRATION,
    "calibration": _OF_CALIBRATION,
    "discovery": ("*.json", "extended.covariance.npz", "suggested_poses.csv"),
    "evaluation": ("*.json",),
    "model": (
        *("model.yaml", "model.covariance.npz", "robot*.urdf", "dh*.csv"),
        *("ur_kinematics.yaml", "ur_calibration.conf"),
    ),
}
#: Folders of pictures and tables, which are drawn anew.
DRAWN_FOLDERS = ("figures", "tables")


def raw_files(folder: Path) -> list[Path]:
    """Return the files that `campaign.yaml` names under `files` and that are there.

    With them comes the file beside them that may state the names of their columns.
    """
    named = _description(folder).get("files")
    if not isinstance(named, dict):
        return []
    files = _there(folder, [name for name in named.values() if isinstance(name, str)])
    stated = names_beside(files[0]) if files else None
    return files if stated is None or not is_file(stated, folder) else [*files, stated]


def missing_campaign(raw_dir: str, campaign: str) -> SettingsError:
    """Return the refusal of a campaign that has no folder with a description."""
    there = sorted(path.parent.name for path in Path(raw_dir).glob("*/campaign.yaml"))
    wanted = str(Path(raw_dir) / campaign / "campaign.yaml")
    allowed = ", ".join(there) or f"a folder of {raw_dir} with a campaign.yaml; there is none"
    return SettingsError(
        "there is no such campaign",
        where="campaigns and raw_dir",
        value=wanted,
        allowed=allowed,
        remedy="correct the name or raw_dir",
    )


def check_prior(prior: str | Path, results: Iterable[Path]) -> None:
    """Refuse a prior that is not there, or that is among the results to be made.

    Args:
        prior: `model.yaml`, or the results that hold it.
        results: folders of the campaigns and groups that start from it, and of their members.

    Raises:
        SettingsError: when it cannot be a prior of these.
        OutputError: when a run makes it at this moment.
    """
    from pa10cal.fit.model_reading import model_file  # late: with numpy

    file = model_file(Path(prior)).resolve()
    if not file.is_file():
        raise SettingsError(
            "the file is not there",
            where="calibration.prior",
            value=str(file),
            allowed="model.yaml of the same arm, or the results that hold it",
            remedy="run the campaign of the prior first, or correct the path; one that is not "
            "absolute is taken from the working folder",
        )
    for folder in results:
        if folder.resolve() in file.parents:
            raise SettingsError(
                "a campaign is not its own prior",
                where="calibration.prior",
                value=str(file),
                allowed="the model of another campaign of the same arm",
                remedy=f"omit the prior, or do not run {folder.name} with it",
            )
    refuse_at_work(file.parents[1])


def refuse_among_raw_files(results: Path, folder: Path, option: str, given: Path) -> None:
    """Refuse results that would be written into a folder of raw files, or be that folder.

    Raises:
        OutputError: naming the option that states them, and what it was given; also where a run
            would remove the raw files.
    """
    refuse_removed(results, folder, option, given)
    if folder in (results, *results.parents):
        raise OutputError(
            "the results would be written among the raw files",
            where=option,
            value=str(given),
            allowed="a folder that neither is nor lies in the folder of raw files",
            remedy="give another one",
        )


def refuse_removed(results: Path, folder: Path, option: str, given: Path) -> None:
    """Refuse results of which a run removes a folder that is, or holds, a folder of raw files.

    Raises:
        OutputError: naming the option that states them, and what it was given.
    """
    for name in (*RESULT_FILES, *DRAWN_FOLDERS):
        made = {results / name, results.resolve() / name}
        if made.intersection(
            (folder, *folder.parents, folder.resolve(), *folder.resolve().parents)
        ):
            raise OutputError(
                f"the raw files lie in the folder {name} of the results, which a run makes anew",
                where=option,
                value=str(given),
                allowed=f"a folder in which {folder} does not lie",
                remedy="give another one",
            )


def refuse_files_of_others(results: Path) -> None:
    """Refuse results whose folders, which a run removes, hold files that no run made.

    Files of a run are known by their names, and by a record or table of readings among them.

    Raises:
        OutputError: naming one of the files.
    """
    places = {"chain.json": _OF_CALIBRATION, **RESULT_FILES}
    files = [
        (path, any(map(path.match, patterns)) and (path.suffix != ".json" or _shows_a_run(path)))
        for name, patterns in places.items()
        for path in (results / name, *sorted((results / name).rglob("*")))
        if os.path.lexists(path) and not path.is_dir() and not is_partial(path)
    ]
    made = any(known and _shows_a_run(path) for path, known in files)
    other = next((path for path, known in files if not (known and made)), None)
    if other is not None:
        raise OutputError(
            "a file that no run made lies where results are written, and would be removed",
            where=str(other),
            allowed="results of runs alone in the folders that runs make",
            remedy="give another folder of results, or move the file elsewhere",
        )


def _shows_a_run(path: Path) -> bool:
    """Return whether a file is one that only a run makes: a record or the table of readings."""
    if path.name == "poses.parquet" or not is_file(path):
        return path.name == "poses.parquet"
    with open_file(path) as file:
        return b'"schema": "pa10cal-' in file.read(_SCHEMA_BYTES)


def prior_digest(prior: str | None) -> str:
    """Return a digest of a prior and of its covariance: it changes when one of them does."""
    if not prior:
        return ""
    # late: with numpy
    from pa10cal.fit.covariance_file import covariance_path
    from pa10cal.fit.model_reading import model_file

    file = model_file(Path(prior))
    digest = hashlib.sha256()
    for path in (file, covariance_path(file)):
        with suppress(OSError), open_file(path) as content:
            while block := content.read(_BLOCK_BYTES):
                digest.update(block)
    return digest.hexdigest()[:32]


def group_like_campaign(raw_dir: str, group: str) -> SettingsError:
    """Return the refusal of a group that is called like a campaign."""
    return SettingsError(
        "a group is called like a campaign",
        where="groups",
        value=str(Path(raw_dir) / group / "campaign.yaml"),
        allowed="a name that no folder of raw_dir has",
        remedy="rename the group",
    )


def robot_name(folder: Path) -> str:
    """Return the robot that `campaign.yaml` names, or an empty text."""
    return str(_description(folder).get("robot") or "")


def arm_files(folder: Path) -> list[Path]:
    """Return the campaign's own descriptions and their URDF, where they are there.

    They are those of its robot, and of what its controller computes with.
    """
    stated, found = _description(folder).get("controller"), []
    model = stated.get("model") if isinstance(stated, dict) else None
    for name in dict.fromkeys((robot_name(folder), str(model or ""))):
        own = own_description(name, folder) if fits_a_folder(name) else None
        found += [] if own is None else _there(own.parent, [own.name, f"{name}.urdf"])
    return found


def instrument_kind(folder: Path) -> str:
    """Return the kind of instrument that `campaign.yaml` names, or an empty text."""
    instrument = _description(folder).get("instrument")
    return str(instrument.get("kind") or "") if isinstance(instrument, dict) else ""


def by_general_model(model: str, robot: str, instrument: str) -> bool:
    """Return whether a campaign's load cases are computed with the general model.

    Args:
        model: `calibration.model` of the settings.
        robot: name of the arm.
        instrument: kind of the instrument.
    """
    from pa10cal.calibration.options import takes_general_model  # late: with numpy and scipy
    from pa10cal.observe.kinds import instruments

    found = instruments().get(instrument)
    from_touches = found is not None and found.from_touches
    return takes_general_model(model, robot=robot, from_touches=from_touches)


def campaign_name(folder: Path) -> str:
    """Return the name that `campaign.yaml` gives, or else that of the folder."""
    return str(_description(folder).get("name") or folder.name)


def _there(folder: Path, names: list[str]) -> list[Path]:
    """Return the files of these names that are in a folder; none whose name leads out of it."""
    try:
        inside = [folder / name for name in names if Path(name).name == name]
    except ValueError:  # a name that no file can have
        return []
    return [path for path in inside if is_file(path, folder)]


def _description(folder: Path) -> dict[str, Any]:
    """Return the content of `campaign.yaml`, empty where it cannot be read."""
    path = folder / "campaign.yaml"
    try:
        return _content(path, path.stat().st_mtime_ns)
    except OSError:
        return {}


@lru_cache
def _content(path: Path, changed_ns: int) -> dict[str, Any]:
    """Read a description once for as long as it is not changed: plans need it often."""
    del changed_ns
    try:
        what = "the campaign's description cannot be read"
        content = read_yaml(path, RawDataError, what=what, within=path.parent)
    except RawDataError:
        return {}
    return content if isinstance(content, dict) else {}
