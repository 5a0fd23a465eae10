"""Points of a curve from a CSV file."""

import numpy as np
import pytest

from pa10cal.errors import RawDataError
from pa10cal_curve.tables import read_curve_points


def test_metres_and_millimetres_in_any_order_of_columns(tmp_path):
    metres, millimetres = tmp_path / "m.csv", tmp_path / "mm.csv"
    metres.write_text("x_m,y_m,z_m\n0,0,0\n0.1,0.2,-0.3\n", "utf-8")
    millimetres.write_bytes(
        "\ufeffname, z_mm,x_mm ,y_mm\r\na,0,0,0\r\n\r\nb,-300,1e2,200\r\n".encode()
    )
    np.testing.assert_allclose(read_curve_points(metres), [[0, 0, 0], [0.1, 0.2, -0.3]])
    np.testing.assert_allclose(read_curve_points(millimetres), read_curve_points(metres))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"x_m,y_m\n1,2\n", r"p.csv:1: a coordinate has no column \(got 'x_m, y_m'\)"),
        (b"", "p.csv:1: a coordinate has no column"),
        (b"x_m,y_m,z_m,x_mm,y_mm,z_mm\n", "p.csv:1: the points stand there twice"),
        (b"x_m,y_m,z_m\n0,0,0\n\n1,nan,2\n", r"p.csv:4: y_m is not a finite number \(got 'nan'\)"),
        (b"x_m,y_m,z_m\n0,0,0\n1,2\n", r"p.csv:3: z_m is not a finite number \(got ''\)"),
        (b"x_m,y_m,z_m\n0;0;0\n", "p.csv:2: x_m is not a finite number"),
        (b"\xff\xfex", "p.csv:1: the points cannot be read"),
    ],
)
def test_what_is_no_points_is_refused_with_its_line(tmp_path, text, message):
    path = tmp_path / "p.csv"
    path.write_bytes(text)
    with pytest.raises(RawDataError, match=message):
        read_curve_points(path)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(RawDataError, match="the points cannot be read"):
        read_curve_points(tmp_path / "gone.csv")
