"""Points of controllers' programs: which are read, where they stand, and which are told."""

from __future__ import annotations

import pytest

from pa10cal.campaign.controller_programs import (
    abb_points,
    fanuc_points,
    fanuc_registers,
    kuka_points,
    yaskawa_points,
)
from pa10cal.campaign.text_lines import TextLine
from pa10cal.errors import RawDataError

NO_AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"


def read(reader, text):
    """Return the points by label, their lines, and the notes."""
    lines = [TextLine(k, line, True) for k, line in enumerate(text.split("\n"), 1) if line.strip()]
    notes = []
    header, *rows = reader(lines, "the file", notes)
    assert header.text.startswith("Point\t")
    labels = [row.text.split("\t")[0] for row in rows]
    return labels, [row.number for row in rows], notes


def target(first, *more):
    return f"[[{first},2,3,4,5,6],{NO_AXES}]" + "".join(more)


@pytest.mark.parametrize("indent", ["", "  "])
def test_abb_statements_without_a_semicolon_between_are_read(indent):
    body = [
        "MODULE M",
        "PROC main()",
        f"MoveAbsJ {target(1)},v100,fine,tool0;",
        "IF a=1 THEN",
        f"MoveAbsJ {target(2)},v100,fine,tool0;",
        "ENDIF",
        f"MoveAbsJ {target(3)},v100,fine,tool0;",
        "ENDPROC",
        "ENDMODULE",
    ]
    labels, lines, notes = read(abb_points, "\n".join(indent + line for line in body))
    assert (labels, lines, notes) == (["line3", "line5", "line7"], [3, 5, 7], [])


def test_abb_points_have_the_lines_in_which_they_stand():
    text = (
        f"%%%\nVERSION:1\nLANGUAGE:ENGLISH\n%%%\nMODULE M\nCONST jointtarget p1:={target(1)};\n"
        f"CONST jointtarget p2:={target(2)}; CONST jointtarget p3:={target(3)};\n"
        f"CONST jointtarget c{{2}}:=[\n{target(4)},\n{target(5)}];\n"
        'PROC main()\nTPWrite "ready!";\nENDPROC\nENDMODULE'
    )
    labels, lines, notes = read(abb_points, text)
    assert labels == ["p1", "p2", "p3", "c{1}", "c{2}"]
    assert (lines, notes) == ([6, 7, 7, 9, 10], [])


def test_abb_points_that_are_not_read_are_told():
    pose = "[[600,0,800],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    text = (
        f"MODULE M\nCONST jointtarget p1:={target(1)};\nPERS jointtarget p2;\n"
        f"CONST jointtarget p3:={target('a')};\nCONST robtarget r{{2}}:=[{pose},{pose}];\n"
        "TASK PERS tooldata t:=[TRUE,[[0,0,1],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
        f"PROC main()\nMoveL {pose},v100,fine,tool0;\nMoveJ r1,v100,fine,tool0;\n"
        f"p2:={target(7)};\nENDPROC\nENDMODULE"
    )
    labels, _, notes = read(abb_points, text)
    assert labels == ["p1"]
    assert notes == [
        "3 points hold a pose of the tool and are not read",
        "2 points are not read, as they are written otherwise, the first in line 4",
    ]


def fanuc(*names, joints="J1= 1.0 deg, J2= 2.0 deg"):
    points = "".join(f"P[{name}]{{\n   GP1:\n  {joints}\n}};\n" for name in names)
    return f"/PROG A\n/POS\n{points}/END"


def test_any_comment_of_a_fanuc_point_is_read():
    labels, lines, notes = read(fanuc_points, fanuc("1", '2:"ref[2]"', '3:"{A}"', '4:"x"', "5:y"))
    assert (labels, lines) == ([f"P{k}" for k in range(1, 6)], [3, 7, 11, 15, 19])
    assert notes == []


def test_fanuc_points_that_are_not_read_are_told():
    masked = fanuc("7", joints="J1= ******** deg, J2= ******** deg").split("\n", 2)[2]
    text = fanuc("1", "2 ; 3", "4").replace("/END", masked)
    labels, _, notes = read(fanuc_points, text)
    assert labels == ["P1", "P4"]
    told = "2 points are not read, as they are written otherwise, the first in line 7"
    assert notes == [told]


def test_fanuc_registers_without_numbers_are_told_and_those_without_a_value_are_none():
    text = (
        "[*POSREG*]$POSREG  Storage: CMOS  Access: RW  : ARRAY[1,3] OF Position Reg\n"
        "    [1,1] =   ''   Group: 1\n  J1 =  1.0 deg   J2 =  2.0 deg\n"
        "    [1,2] =   ''   Group: 1\n  J1 = ******** deg   J2 = ******** deg\n"
        "    [1,3] =   '' Uninitialized"
    )
    labels, _, notes = read(fanuc_registers, text)
    assert labels == ["PR1"]
    assert notes == ["1 point is not read, as it is written otherwise, in line 4"]


def kuka(*lines):
    return "\n".join(["DEFDAT A", *lines, "ENDDAT"])


def test_kuka_names_that_are_declared_in_lists_or_by_themselves_are_read():
    text = kuka(
        "DECL E6AXIS A[1],B[1]",
        "A[1]={A1 1.0,A2 2.0}",
        "B[1]={A1 1.0,A2 2.0}",
        "DECL E6AXIS XP3={A1 1.0,A2 2.0}",
        "DECL E6AXIS P4",
        "P4={A1 1.0,A2 2.0}",
        "E6AXIS P[2,2]",
        "P[1,1]={A1 1.0,A2 2.0}",
        "P[2,1]={A1 1.0,A2 2.0}",
    )
    labels, lines, notes = read(kuka_points, text)
    assert labels == ["A[1]", "B[1]", "P3", "P4", "P[1,1]", "P[2,1]"]
    assert (lines, notes) == ([3, 4, 5, 7, 9, 10], [])


def test_kuka_points_that_are_not_read_are_told():
    text = kuka(
        "DECL E6AXIS XP1={A1 1.0,A2 2.0}",
        "XHOME={A1 1.0,A2 2.0}",  # of a type that another list declares
        "DECL E6AXIS XP2={A1 HIGH,A2 HIGH}",
        "DECL E6POS XP3={X 1.0,Y 0.0,Z 900.0,A 0.0,B 90.0,C 0.0,S 2,T 35}",
        "DECL FRAME BASE={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}",
        "TOOL_DATA[1]={X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}",
        "DECL PDAT PPDAT1={VEL 100.0,ACC 100.0}",
    )
    labels, _, notes = read(kuka_points, text)
    assert labels == ["P1"]
    assert notes == [
        "1 point holds a pose of the tool and is not read",
        "2 points are not read, as they are written otherwise, the first in line 3",
    ]


@pytest.mark.parametrize(
    ("lines", "value"),
    [
        (["DECL E7AXIS XP1={A1 1.0,A2 2.0}"], "1 point is not read, .* in line 2"),
        (["DECL E6POS XP1={X 1.0,Y 0.0}"], "1 point holds a pose of the tool"),
        ([], "no point"),
    ],
)
def test_a_program_without_joint_positions_is_refused_with_what_it_holds(lines, value):
    with pytest.raises(RawDataError, match=rf"no joint positions are in the program.*{value}"):
        read(kuka_points, kuka(*lines))


def test_a_job_of_yaskawa_that_lacks_its_type_is_no_program_to_export_again():
    with pytest.raises(RawDataError, match="pulses of the motors or poses of the tool") as refused:
        read(yaskawa_points, "/JOB\n//NAME A\nNOP\nEND")
    assert "export a table of the points" in str(refused.value)


@pytest.mark.parametrize(
    ("types", "holds"),
    [
        (["PULSE"], "holds pulses of the motors, and no joint positions"),
        (["ROBOT", "PULSE"], "holds poses of the tool and pulses of the motors, and no joint"),
        (["ANGLE"], "holds points of the type ANGLE ("),
    ],
)
def test_a_job_of_yaskawa_is_refused_for_all_its_types(types, holds):
    job = "\n".join(["/JOB", "//NAME A", *(f"///POSTYPE {kind}" for kind in types), "END"])
    with pytest.raises(RawDataError) as refused:
        read(yaskawa_points, job)
    assert holds in str(refused.value)
    assert ("pulses per degree" in str(refused.value)) == ("PULSE" in types)


@pytest.mark.parametrize("value", ["-90+5", "- 90.0", "HIGH", "-90.0.1"])
def test_a_kuka_point_with_a_number_that_is_none_wholly_is_told(value):
    text = kuka("DECL E6AXIS XP1={E6AXIS: A1 1.0,A2 2.0}", f"DECL E6AXIS XP2={{A1 1.0,A2 {value}}}")
    labels, _, notes = read(kuka_points, text)
    assert labels == ["P1"]
    assert notes == ["1 point is not read, as it is written otherwise, in line 3"]


def test_a_fanuc_point_of_another_group_alone_is_told_as_that():
    text = fanuc("1", "2").replace("GP1", "GP2", 1)
    labels, _, notes = read(fanuc_points, text)
    assert labels == ["P2"]
    assert notes == ["1 point is not read, as it is of another motion group than the first"]


def test_elements_of_abb_arrays_have_their_indices_whether_or_not_all_are_read():
    elements = ",".join(map(target, ["1", "2", "a", "4"]))
    text = (
        f"MODULE M\nCONST jointtarget p{{2,2}}:=[{elements}];\n"
        f"CONST jointtarget c{{4}}:=[{elements}];\nCONST jointtarget n{{k}}:=[{elements}];\n"
        "ENDMODULE"
    )
    labels, _, _ = read(abb_points, text)
    one = [f"{name}{{{k}}}" for name in "cn" for k in (1, 2, 4)]
    assert labels == ["p{1,1}", "p{1,2}", "p{2,2}", *one]


def test_joint_positions_that_are_assigned_and_not_declared_are_in_the_program():
    with pytest.raises(RawDataError, match=r"in a form that is read.*declare its points"):
        read(abb_points, f"MODULE M\np1:={target(1)};\nENDMODULE")
