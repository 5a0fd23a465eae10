"""Files of joint positions and of readings as controllers and instruments write them.

Written after public conventions: what makers document and what public parsers and samples of such
files take, not what our own readers take.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation


def _kuka(q_deg: np.ndarray) -> str:
    lines = ["&ACCESS RVP", "&REL 12", "DEFDAT CALPTS PUBLIC", ";FOLD EXTERNAL DECLARATIONS"]
    lines += ['DECL BASIS_SUGG_T LAST_BASIS={POINT1[] "P1",CP_PARAMS[] "CPDAT0"}', ";ENDFOLD"]
    lines += ["DECL FRAME FLANGE={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}"]
    lines += ["DECL E6POS XHOME={X 1200.0,Y 0.0,Z 900.0,A 0.0,B 90.0,C 0.0,S 2,T 35,E1 0.0,E2 0.0}"]
    for k, q in enumerate(q_deg, start=1):
        axes = ",".join(f"A{j} {value:.6f}" for j, value in enumerate(q, start=1))
        end = "E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}"
        lines.append(f"DECL {'GLOBAL ' if k % 2 else ''}E6AXIS XP{k}={{{axes},{end}")
        lines.append(f"DECL PDAT PPDAT{k}={{VEL 100.000,ACC 100.000,APO_DIST 100.000}}")
    return "\r\n".join([*lines, "ENDDAT", ""])


def _fanuc_ls(q_deg: np.ndarray) -> str:
    lines = ["/PROG  CALPTS", "/ATTR", "OWNER\t\t= MNEDITOR;", 'COMMENT\t\t= "";']
    lines += ["PROG_SIZE\t= 12044;", "TCD:  STACK_SIZE\t= 0,", "      TASK_PRIORITY\t= 50;"]
    lines += ["DEFAULT_GROUP\t= 1,*,*,*,*;", "/APPL", "/MN"]
    lines += [f"  {k}:J P[{k}] 20% FINE    ;" for k in range(1, len(q_deg) + 1)]
    lines += ["/POS"]
    for k, q in enumerate(q_deg, start=1):
        name = f'{k}:"near {k}"' if k == 3 else f"{k}"
        lines += [f"P[{name}]{{", "   GP1:", "\tUF : 0, UT : 1,\t"]
        for three in ((1, 2, 3), (4, 5, 6)):
            values = ",\t".join(f"J{j}=  {q[j - 1]:8.3f} deg" for j in three)
            lines.append(f"\t{values}{',' if three[0] == 1 else ''}")
        lines.append("};")
    number = len(q_deg) + 1
    lines += [f"P[{number}]{{", "   GP1:", "\tUF : 0, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',"]
    lines += ["\tX =   900.000  mm,\tY =     0.000  mm,\tZ =   700.000  mm,"]
    lines += ["\tW =  -180.000 deg,\tP =     0.000 deg,\tR =     0.000 deg", "};"]
    return "\r\n".join([*lines, "/END", ""])


def _fanuc_posreg(q_deg: np.ndarray) -> str:
    count = len(q_deg)
    lines = [
        f"[*POSREG*]$POSREG  Storage: CMOS  Access: RW  : ARRAY[1,{count + 2}] OF Position Reg"
    ]
    for k, q in enumerate(q_deg, start=1):
        lines.append(f"    [1,{k}] =   '{'Home' if k == 1 else ''}'   Group: 1")
        for three in (0, 3):
            values = (f"J{j} = {q[j - 1]:9.3f} deg " for j in range(three + 1, three + 4))
            lines.append("  " + "  ".join(values))
        lines.append("")
    lines += [
        f"    [1,{count + 1}] =   '' Uninitialized",
        f"    [1,{count + 2}] =   'Maintenance' ",
    ]
    lines += ["  Group: 1   Config: F U T, 0, 0, 0", "  X:  2066.881   Y: -1269.113   Z: -1122.291"]
    lines += ["  W:  -179.786   P:     -.649   R:   -58.819", "  EXT1:    40.492 mm  "]
    return "\n".join([*lines, ""])


_NOT_THERE = ",".join(["9E+09"] * 6)


def _abb(q_deg: np.ndarray) -> str:
    lines = ["%%%", "  VERSION:1", "  LANGUAGE:ENGLISH", "%%%", "", "MODULE CALPTS"]
    lines += ["  ! points of the calibration", "  CONST robtarget home:=[[600,0,800],[0,0,1,0],"]
    lines += [f"    [0,0,0,0],[{_NOT_THERE}]];"]
    for k, q in enumerate(q_deg, start=1):
        values = ",".join(f"{value:.6f}" for value in q)
        kind = ("CONST", "PERS", "LOCAL CONST", "VAR")[k % 4]
        between = "\n      " if k % 5 == 0 else ""
        lines.append(f"  {kind} jointtarget p{k}:=[[{values}],{between}[{_NOT_THERE}]];")
    lines += ["  PROC main()", "    MoveAbsJ p1,v100,fine,tool0;", "  ENDPROC", "ENDMODULE"]
    return "\n".join([*lines, ""])


#: Programs of joint positions by the name of their format: text of joints (P, 6) in degrees, and
#: what their users call the points.
PROGRAMS: dict[str, tuple[Callable[[np.ndarray], str], str]] = {
    "kuka": (_kuka, "P{}"),
    "fanuc_ls": (_fanuc_ls, "P[{}]"),
    "fanuc_posreg": (_fanuc_posreg, "PR[{}]"),
    "abb": (_abb, "P{}"),
}
YASKAWA = """/JOB
//NAME CALIB
//POS
///NPOS 2,0,0,0,0,0
///TOOL 0
///POSTYPE PULSE
///PULSE
C00000=-3626,25307,0,0,-64000,-407
C00001=1,2,3,4,5,6
//INST
///DATE 2026/04/22 17:20
///ATTR SC,RW
///GROUP1 RB1
NOP
MOVJ C00000 VJ=0.78
END
"""


def _motive(
    time_s: np.ndarray, T: np.ndarray, *, version: str = "1.23", unit: str = "Meters", lost=()
) -> str:
    """Return a take of a rigid body with its markers, and of a marker on the floor."""
    size = {"Meters": 1.0, "Millimeters": 1e3, "Centimeters": 1e2}[unit]
    about = ["Format Version", version, "Take Name", "Calib_A", "Take Notes", ""]
    about += ["Capture Frame Rate", "120.000000", "Export Frame Rate", "120.000000"]
    about += ["Capture Start Time", "2026-10-12 10.04.11.250 AM", "Capture Start Frame", "0"]
    about += ["Total Frames in Take", "9000", "Total Exported Frames", str(len(T))]
    about += ["Rotation Type", "Quaternion", "Length Units", unit, "Coordinate Space", "Global"]
    body = ["Rigid Body"] * 8
    solved, seen = ["Rigid Body Marker"] * 4, ["Marker"] * 3
    name = ["Flange"] * 8 + ["Flange:Marker1"] * 7 + ["Floor:Marker1"] * 3
    parts = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
    parts += ["Position"] * 3 + ["Marker Quality"] + ["Position"] * 6
    axes = [*"XYZW", *"XYZ", "", *"XYZ", "", *"XYZ", *"XYZ"]
    rows = [
        ["", "Type", *body, *solved, *seen, *seen],
        ["", "Name", *name],
        ["", "ID", *["A6B17F0C2B4E11EF"] * 18],
        *([["", "Parent", *[""] * 18]] if version >= "1.24" else []),
        ["", "", *parts],
        ["Frame", "Time (Seconds)", *axes],
    ]
    lines = [",".join(about), "", *map(",".join, rows)]
    quaternion = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    p, marker = size * T[:, :3, 3], size * (T @ [0.03, 0.01, 0.0, 1.0])[:, :3]
    for k in range(len(T)):
        values = [*quaternion[k], *p[k], 0.0002 * size, *marker[k], 1.0, *marker[k], 0.1, 0.0, 0.2]
        fields = [f"{value:.9f}" for value in values]
        fields = [""] * len(fields) if k in lost else fields
        lines.append(",".join([str(k), f"{time_s[k]:.6f}", *fields]))
    return "\r\n".join([*lines, ""])


def _vicon(time_s: np.ndarray, T: np.ndarray, rate_hz: float = 100.0) -> str:
    lines = ["Segments", f"{rate_hz:g}", ",,Robot:Flange,,,,,", "Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ"]
    lines += [",,deg,deg,deg,mm,mm,mm"]
    turned = Rotation.from_matrix(T[:, :3, :3]).as_rotvec(degrees=True)
    for k in range(len(T)):
        values = ",".join(f"{value:.6f}" for value in (*turned[k], *1e3 * T[k, :3, 3]))
        lines.append(f"{round(time_s[k] * rate_hz)},0,{values}")
    lines += [
        "",
        "Trajectories",
        f"{rate_hz:g}",
        ",,Robot:M1,,",
        "Frame,Sub Frame,X,Y,Z",
        ",,mm,mm,mm",
    ]
    lines += ["1,0,1.0,2.0,3.0"]
    return "\n".join([*lines, ""])


def _vicon_markers(time_s: np.ndarray, T: np.ndarray, rate_hz: float = 100.0) -> str:
    lines = [
        "Trajectories",
        f"{rate_hz:g}",
        ",,Robot:Flange,,",
        "Frame,Sub Frame,X,Y,Z",
        ",,mm,mm,mm",
    ]
    for k in range(len(T)):
        values = ",".join(f"{value:.6f}" for value in 1e3 * T[k, :3, 3])
        lines.append(f"{round(time_s[k] * rate_hz)},0,{values}")
    return "\n".join([*lines, ""])


def _qualisys_about(count: int, further: list[str], rate_hz: float = 100.0) -> list[str]:
    return [
        *(f"NO_OF_FRAMES\t{count}", "NO_OF_CAMERAS\t8", f"FREQUENCY\t{rate_hz:g}"),
        *("NO_OF_ANALOG\t0", "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--"),
        "TIME_STAMP\t2026-05-17, 12:14:49.312\t1234.56789",
        *further,
    ]


def qualisys_bodies(time_s: np.ndarray, bodies: dict[str, np.ndarray]) -> str:
    """Return a file of bodies that are at (N, 4, 4)."""
    each = ["X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{k}]" for k in range(9))]
    lines = _qualisys_about(len(time_s), [f"NO_OF_BODIES\t{len(bodies)}", "DATA_INCLUDED\t6D"])
    lines += ["\t".join(["BODY_NAMES", *bodies])]
    names = (f"{body} {word}" for body in bodies for word in each)
    lines.append("\t".join(["Frame", "Time", *names]))
    for k in range(len(time_s)):
        values = []
        for T in bodies.values():
            angles = Rotation.from_matrix(T[k, :3, :3]).as_euler("XYZ", degrees=True)
            values += [*1e3 * T[k, :3, 3], *angles, 0.2, *T[k, :3, :3].T.ravel()]
        lines.append("\t".join([f"{k + 1}", f"{time_s[k]:.5f}", *(f"{v:.6f}" for v in values)]))
    return "\r\n".join([*lines, ""])


def _qualisys(time_s: np.ndarray, T: np.ndarray) -> str:
    return qualisys_bodies(time_s, {"Flange": T})


def _qualisys_markers(time_s: np.ndarray, T: np.ndarray) -> str:
    further = ["NO_OF_MARKERS\t1", "DATA_INCLUDED\t3D", "MARKER_NAMES\tFlange"]
    lines = _qualisys_about(len(T), further, 1.0 / (time_s[1] - time_s[0]))
    for each in 1e3 * T[:, :3, 3]:
        lines.append("\t".join(f"{value:.6f}" for value in each))
    return "\r\n".join([*lines, ""])


#: Takes of motion capture: text of a target's poses (N, 4, 4) at times (N,), and whether it holds
#: orientations; by the name of the format and what is drawn.
TAKES: dict[str, tuple[Callable[..., str], bool]] = {
    "motive": (_motive, True),
    "motive in millimetres": (lambda t, T: _motive(t, T, unit="Millimeters", version="1.25"), True),
    "vicon": (_vicon, True),
    "vicon markers": (_vicon_markers, False),
    "qualisys": (_qualisys, True),
    "qualisys markers": (_qualisys_markers, False),
}
