"""The section of the page on parameters: what effects shifted."""

import json

from pa10cal.reports.blocks import Grid
from pa10cal.reports.parameters import parameters
from pa10cal.reports.results_bundle import results_bundle
from pa10cal.results.analysis import AnalysisRecord
from pa10cal.results.codec import read, write
from pa10cal.results.record import EffectName

#: Values of parameters without and with an effect, their standard uncertainty and unit; with which
#: digits they are shown, and by how many standard uncertainties they shifted, if they are.
SHIFTS = {
    "delta_a_2": (1e-4, 3e-4, 1e-5, "m", "δa₂ | 0.100 | 0.300 ± 0.020 | mm | +20.0"),
    "target_T1_z": (
        0.2001362,
        0.2001078,
        2.2e-6,
        "m",
        "T1 z | 200.1362 | 200.1078 ± 0.0043 | mm | -12.9",
    ),
    "gamma_z": (3.141, -3.1415, 1e-4, "rad", "γ_z | 3.14100 | -3.14150 ± 0.00020 | rad | +6.9"),
    "weight_6_moment_x": (None, -0.298, 0.05, "kg m", "x | 0.000 | -0.298 ± 0.098 | kg m | -6.0"),
    "K_lin_2": (1e5, 8e4, 4e3, "N m/rad", "K_lin_2 | 100.0 | 80.0 ± 7.8 | kN m/rad | -4.0"),
    "K_lin_3": (1e14, 8e4, 2e4, "N m/rad", "K_lin_3 | rigid | 80, 54 to 160 | kN m/rad | -4.0"),
    "K_lin_4": (1e14, 8e4, 9e4, "N m/rad", ""),  # it may as well be rigid
    "delta_d_2": (1e-4, 1.09e-4, 1e-5, "m", ""),
    "delta_d_3": (3e-4, 3e-4, 1e-5, "m", ""),
    "target_T1_y": (None, 0.2, 1e-5, "m", ""),  # as stated without the effect: it is not known
}


def shifted(folder):
    """Return the rows of the table of shifted parameters; None where there is no table."""
    results = results_bundle(folder)
    for block in parameters(results, results.calibration):
        for each in getattr(block, "blocks", (block,)):
            if isinstance(each, Grid) and "that the effects shifted" in each.caption:
                return [" | ".join(row) for row in each.rows]
    return None


def test_parameters_that_effects_shifted_are_listed(copied):
    assert not shifted(copied)
    path = copied / "discovery/analysis.json"
    record = read(AnalysisRecord, path)
    joined = record.naming[0].model_copy(
        update={"effects": (EffectName(id="backlash", of="joint 2"),)}
    )
    write(record.model_copy(update={"naming": (*record.naming, joined)}), path)
    name = {"id": "backlash", "of": "joint 2"}
    found = {**name, "parameters": {}, "probability": 1.0, "alternatives": [], "set95": [name]}
    for column, (file, more) in enumerate(
        (("calibration/combined.json", {}), ("discovery/extended.json", {"named": [found]}))
    ):
        of = json.loads((copied / file).read_text("utf-8"))
        of["parameters"] = {
            name: {"value": row[column], "std": row[2], "unit": row[3], "tolerance": None}
            | {"identifiable": True, "at_bound": row[column] == 1e14}
            for name, row in SHIFTS.items()
            if row[column] is not None
        }
        (copied / file).write_text(json.dumps(of | more))
    rows = shifted(copied)
    wanted = [row for *_, row in SHIFTS.values() if row]
    assert len(rows) == len(wanted)
    for row in wanted:
        assert any(found.endswith(row) for found in rows), (row, rows)
