"""Command `import_arm`."""

from __future__ import annotations

from pathlib import Path


def import_arm(urdf: Path, *, out: Path, base: str | None = None, tip: str | None = None) -> None:
    """Turn a URDF into an arm description, and compare their forward kinematics.

    A copy of the URDF is put beside the description, so that a calibrated model can be exported as
    the same URDF with calibrated origins.

    Args:
        urdf: the URDF, xacro macros expanded.
        out: description to write; its stem names the arm.
        base: link that is the arm's base; without it, the root.
        tip: link that is the end-effector; without it, the only tip.

    Examples:
        pa10cal import_arm robot.urdf --out my_arm.yaml
        pa10cal import_arm cell.urdf --base base_link --tip tool0 --out my_arm.yaml
    """
    import numpy as np

    from pa10cal.arm.description import neighbouring_axes
    from pa10cal.errors import ArmError
    from pa10cal.files.arm_text import arm_text, with_short_limits
    from pa10cal.files.arms import arm_from_urdf, parse_arm
    from pa10cal.files.output import whole_files
    from pa10cal.yaml_file import parse_yaml

    if out.suffix != ".yaml":
        raise ArmError(
            "the description is a YAML file",
            where="--out",
            value=str(out),
            allowed="a name that ends in .yaml",
            remedy="rename it",
        )
    imported = arm_from_urdf(urdf, base, tip, name=out.stem)
    arm = with_short_limits(imported.arm)
    parallel = [axes for axes in neighbouring_axes(arm) if axes.parallel]
    lines = [
        f"From {imported.base} to {imported.tip}, joints 1 to {arm.n}: "
        f"{', '.join(imported.joints)}.",
        *(
            f"Joints {axes.joints[0]} and {axes.joints[1]} are {np.degrees(axes.angle_rad):.2g} "
            f"degrees from parallel: row {axes.row} takes beta in place of d."
            for axes in parallel
        ),
        *(f"{note[0].upper()}{note[1:]}." for note in imported.notes),
    ]
    copy = out.with_suffix(".urdf")
    source = {"file": copy.name, "base": imported.base, "tip": imported.tip}
    text = arm_text(arm, [f"Imported from {urdf.name}.", *lines], source)
    parse_arm(parse_yaml(text), where=str(out))  # what would not be read is not written
    with whole_files(out, copy) as (description, beside):
        description.write_text(text, encoding="utf-8", newline="\n")
        beside.write_bytes(urdf.read_bytes())
    print(
        "\n".join(lines) + "\n"
        f"{out}: forward kinematics differs from that of the URDF by "
        f"{imported.forward_kinematics_difference_m:.1e} m and "
        f"{imported.forward_kinematics_difference_rad:.1e} rad at most"
    )
