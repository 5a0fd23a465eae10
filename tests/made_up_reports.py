"""Points in reports of measuring software, after what such files hold that are public."""

from __future__ import annotations

from collections.abc import Callable, Iterable

Points = Iterable[tuple[int, "tuple[float, float, float]"]]


def _spatialanalyzer(points: Points) -> str:
    """With the comments of version, frame, axes and fields, and commas between the fields."""
    lines = ["// SA Version 2021.2.0914.9", "// Working Frame: A::WORLD", "// Axes: X, Y, Z [mm]"]
    lines[2:] = ["// Cartesian, Millimeters", "// Collection,  Group,  Point,  X,  Y,  Z"]
    for k, place in points:
        values = ",  ".join(f"{value:.6f}" for value in place)
        lines.append(f"A,  Measured Points,  P{k},  {values}")
    return "\r\n".join([*lines, ""])


def _polywork(points: Points, units: str = "Millimeters", size: float = 1.0) -> str:
    """A control view: a row for each control of an object, what was not measured left blank."""
    about = [
        ["Control View"],
        ["Control View Name", "control view 1"],
        ["Units", units],
        ["Coordinate Systems", "world"],
        ["Data Alignments", "best-fit 1"],
        ["All Statistics", "Total: 120, Measured: 117 (97.5%), Pass: 100 (85.5%)"],
        [],
        ["Char No.", "Object Name", "Control", "Nom", "Meas", "Tol", "Dev", "Test", "Out Tol"],
    ]
    rows = [["", "plane 1", "Flatness", "", "0.022", "0.050", "", "Pass", ""]]
    for k, place in points:
        rows.append(["", f"P{k}", "3D Distance", "", "", "1.400", "", "", ""])
        for axis, value in zip("XYZ", place, strict=True):
            value = size * value
            nominal = round(value, 1)
            off = [f"{value - nominal:.6f}", "Pass", ""]
            rows.append(["", f"P{k}", axis, f"{nominal:.3f}", f"{value:.6f}", "±0.700", *off])
    rows += [["", "P999", axis, "100.000", "", "±0.700", "", "", ""] for axis in "XYZ"]
    padded = (row + [""] * (9 - len(row)) for row in [*about, *rows])
    return "\r\n".join(["\t".join(row) for row in padded] + [""])


def _faro(points: Points, of: str = "Center.", unit: str = "mm", size: float = 1.0) -> str:
    """A tabular report: blocks of features, their fields padded to the width of the column."""

    def line(*fields: str) -> str:
        return "\t".join(
            text.ljust(width) for text, width in zip(fields, (49, 18, 42, 25), strict=False)
        )

    lines = ["FARO Technologies Inc.", line("125 Technology Park", "", "", "http://www.faro.com")]
    lines += ["Session Information", line("Operator", "", "Nobody"), line("Date", "", "7/23/2026")]
    head = line("", "", "actual", "nominal") + "\tdev                 \t - tol  \t +tol  \toot"
    lines += [line("", "World", "", ""), head, " "]
    for k, place in points:
        lines += [line("", f"P{k}", "", "Readings:1."), head]
        for axis, value in zip("xyz", place, strict=True):
            lines.append(
                line(f"{of}{axis}", "", f"{size * value:.6f}{unit}", "") + "\t\t-0.050mm\t"
            )
        lines += [line("Readings", "", "x", "y") + "\tz\tdev\t\toot"]
        lines += [
            line("", "", f"{place[0]:.3f}mm", f"{place[1]:.3f}mm") + f"\t{place[2]:.3f}mm",
            " ",
        ]
    lines += [line("", "Projection Plane 1", "", "Readings:5."), head]
    return "\r\n".join([*lines, line("Flatness", "", "0.022mm", ""), ""])


#: Text of numbered points in mm, by the format and what is drawn.
REPORTS: dict[str, Callable[[Points], str]] = {
    "spatialanalyzer": _spatialanalyzer,
    "polyworks": _polywork,
    "polyworks in inches": lambda points: _polywork(points, "Inches", 1 / 25.4),
    "faro": _faro,
    "faro in metres": lambda points: _faro(points, "", "m", 1e-3),
}
