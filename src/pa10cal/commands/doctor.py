"""Command `doctor`, which imports nothing that may be missing."""

from __future__ import annotations


def doctor() -> None:
    """Check this machine: what pa10cal needs, what is missing, and what to do about it.

    Exit code 2 where something that is needed is missing.

    Examples:
        pa10cal doctor
    """
    from pa10cal.errors import SettingsError
    from pa10cal.running.machine import examine

    checks = examine()
    width = max(len(check.name) for check in checks)
    for check in checks:
        print(f"{check.mark:<7} {check.name:<{width}}  {check.found}")
        if check.remedy:
            print(f"{'':<7} {'':<{width}}  → {check.remedy}")
    missing = [check.name for check in checks if check.state == "missing"]
    if missing:
        raise SettingsError(
            f"{len(missing)} of {len(checks)} checks failed",
            where="this machine",
            value=", ".join(missing),
            allowed="all of them passed",
            remedy="see the arrows above",
        )
