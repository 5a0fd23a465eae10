"""Results that promise more than they hold, or than is read: refused before it is allocated."""

from __future__ import annotations

import io
import shutil
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from built_once import built_once
from made_up_results import NAME, small_results


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """Results of a campaign that is too small for a search; to be read only."""
    return built_once(tmp_path_factory, "small", small_results)


@pytest.fixture
def sent(attack, small):
    shutil.copytree(small, attack.inside / "results")
    return attack.inside / "results"


MILLION = 1_000_000


def many_rows():
    """A megabyte that says 8 GB."""
    zeros = pa.array(np.zeros(10 * MILLION))
    return pa.table({f"c{k}": zeros for k in range(20)})


def many_columns():
    return pa.table({f"c{k}": [0.0] for k in range(3_000)})


def one_label_often():
    label = pa.DictionaryArray.from_arrays(np.zeros(MILLION, dtype="i4"), ["x" * MILLION])
    return pa.table({"pose": label})


TABLES = {
    "columns": (many_columns, r"larger than is read \(got '1 rows, 3000 columns"),
    "rows": (many_rows, r"larger than is read \(got '10000000 rows, 20 columns"),
    "one label": (one_label_often, "a label under pose has 1000000 letters"),
}


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("kind", TABLES)
def test_a_table_of_poses_that_promises_all_memory_is_refused(attack, sent, kind):
    make, message = TABLES[kind]
    path = sent / "ingest/poses.parquet"
    metadata = {"schema": "pa10cal-poses/1", "campaign": NAME}
    pq.write_table(make().replace_schema_metadata(metadata), path, store_schema=False)
    found = attack("report", sent, out=attack.inside / "report.html")
    found.refused(message, "poses.parquet")


def header(shape, dtype="<f8"):
    content = io.BytesIO()
    text = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(content, text)
    return content.getvalue()


def archive(content, name="covariance.npy"):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(name, content)
    return packed.getvalue()


COVARIANCES = {
    "7 TB": lambda: archive(header((MILLION, MILLION)) + bytes(800)),
    "7 GB": lambda: archive(header((30_000, 30_000)) + bytes(800)),
    "negative": lambda: archive(header((-1, 1)) + bytes(800)),
    "objects": lambda: archive(header((100, 100), "|O") + bytes(800)),
    "long texts": lambda: archive(header((2, 2), "<U100000000") + bytes(800)),
    "packed": lambda: archive(header((11_000, 11_000)) + bytes(968 * MILLION)),
    "no archive": lambda: header((MILLION, MILLION)) + bytes(800),
    "another name": lambda: archive(header((2, 2)) + bytes(32), "names.npy"),
    "long header": lambda: archive(b"\x93NUMPY\x02\x00" + b"\xff\xff\xff\x7f" + b"(" * MILLION),
    "nothing": lambda: b"",
}


@pytest.mark.slow_but_one_in(9)
@pytest.mark.parametrize("kind", COVARIANCES)
def test_a_covariance_that_promises_all_memory_is_refused(attack, sent, kind):
    (sent / "model/model.covariance.npz").write_bytes(COVARIANCES[kind]())
    joints = attack.inside / "joints.csv"
    names = ",".join(f"q{k}_deg" for k in range(1, 7))
    joints.write_text(f"id,{names}\na,0,-90,90,0,10,0\n")
    found = attack(
        "predict", model=sent / "model/model.yaml", joints=joints, out=attack.inside / "p.csv"
    )
    found.refused("the covariance of the model cannot be read", "model.covariance.npz")
