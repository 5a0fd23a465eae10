"""Command `montecarlo`: position errors from resolver uncertainty, plane by plane."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from pa10cal.options import MonteCarloOptions

if TYPE_CHECKING:
    from pa10cal.results.montecarlo import PlaneRecord

#: Lines of progress that a plane prints.
_PROGRESS_LINES = 10
#: Fewest cycles of a plane, where only its closed form is wanted, and the key that differs by arm.
_FEWEST_CYCLES, _OF_ARM = 2, "closed_form_mean_mm"


def montecarlo(
    *,
    campaign: str,
    robot: str,
    out: Path,
    plane_mm: int | None = None,
    campaign_dir: Path | None = None,
    same_arm: Path | None = None,
    skip_out_of_reach: bool = False,
    settings: MonteCarloOptions = MonteCarloOptions(),
) -> None:
    """Study the position error from resolver uncertainty in horizontal planes.

    Args:
        campaign: name, written into the result.
        robot: name of an arm description, or the file of one (.yaml).
        out: folder for the results of all planes, or with --plane-mm the result to write (.json).
        plane_mm: one plane alone: height of the flange above the base [mm].
        campaign_dir: folder that may hold a description of the arm.
        same_arm: results of another campaign of this arm with these settings, taken over from here.
        skip_out_of_reach: whether a plane that is not for this arm is recorded as not studied,
            with the reason, and not refused.
        settings: section montecarlo.

    Examples:
        pa10cal montecarlo --campaign mine --robot pa10_6ce --out montecarlo
        pa10cal montecarlo --campaign mine --robot ur10 --plane-mm 500 --out z500.json \\
          --settings '{"cycles": 1000}'
    """
    from pa10cal.errors import ArmError
    from pa10cal.files.arms import arm_asked
    from pa10cal.montecarlo.places import OutOfReachError
    from pa10cal.montecarlo.plane import study_plane
    from pa10cal.results.codec import read, schema_of, write
    from pa10cal.results.montecarlo import PlaneNotStudied, PlaneRecord

    arm = arm_asked(robot, campaign_dir)
    for height_mm in settings.planes_mm if plane_mm is None else (plane_mm,):
        file = out / f"z{height_mm}.json" if plane_mm is None else out
        same = None if same_arm is None else same_arm / f"z{height_mm}.json"
        try:
            if same is None or schema_of(same) == PlaneNotStudied.SCHEMA:
                progress = _progress(f"montecarlo z = {height_mm} mm", settings.cycles)
                record = study_plane(arm, height_mm, settings, campaign, arm.name, progress)
            else:
                record = read(PlaneRecord, same)
                few = settings.model_copy(update={"cycles": _FEWEST_CYCLES})
                own = study_plane(arm, height_mm, few, campaign, arm.name)
                _refuse_other_study(record, same, own, settings.cycles)
                record = record.model_copy(update={"campaign": campaign})
        except (ArmError, OutOfReachError) as refusal:
            if not skip_out_of_reach:
                raise
            why = refusal.what
            write(
                PlaneNotStudied(campaign=campaign, robot=arm.name, plane_mm=height_mm, why=why),
                file,
            )
            print(f"{campaign} z = {height_mm} mm: not studied, {why}")
            continue
        write(record, file)
        print(
            f"{campaign} z = {height_mm} mm: {record.mean_mm:.4f} ± {record.std_mm:.4f} mm, "
            f"closed form {record.closed_form_mean_mm:.4f} ± {record.closed_form_std_mm:.4f} mm"
        )


def _refuse_other_study(record: PlaneRecord, path: Path, own: PlaneRecord, cycles: int) -> None:
    """Refuse the record of a plane, from a file, that is of another arm or has other settings.

    Arms of one name may differ in their rows: the closed form shows it.

    Args:
        own: the record of the plane that is wanted, by fewer than the cycles wanted.
    """
    from pa10cal.errors import RecordError

    names = ("robot", "plane_mm", "positions", "sigma_deg", "reach_m", "random_seed", _OF_ARM)
    found, wanted = (
        {name: getattr(each, name) for name in names}
        | {"cycles": drawn, "map_spacing_mm": each.map.spacing_mm}
        for each, drawn in ((record, record.cycles), (own, cycles))
    )
    other = [name for name in wanted if found[name] != wanted[name]]
    if other:
        told = [name for name in other if name != _OF_ARM] or other  # it follows the settings too
        raise RecordError(
            "planes of another arm or with other settings",
            where=str(path),
            value=", ".join(f"{name} {found[name]}" for name in told),
            allowed=", ".join(f"{name} {wanted[name]}" for name in told),
            remedy="leave --same-arm out",
        )


def _progress(title: str, cycles: int) -> Callable[[int, int], None]:
    """Return a function that prints how many places are drawn, how fast, and the time left."""
    began_s, lines_printed = time.monotonic(), 0

    def show(done: int, places: int) -> None:
        nonlocal began_s, lines_printed
        if done == 0:  # places are found, and drawing begins
            began_s = time.monotonic()
        lines = done * _PROGRESS_LINES // places
        if lines == lines_printed:
            return
        lines_printed = lines
        seconds = max(time.monotonic() - began_s, 1e-9)
        print(
            f"{title}: {100 * done // places} %, {done * cycles / seconds:.1e} "
            f"cycles/s, {seconds * (places - done) / done:.0f} s left",
            file=sys.stderr,
            flush=True,
        )

    return show
