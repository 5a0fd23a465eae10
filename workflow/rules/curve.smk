import json

# Shapes that links are laid along, as the command `curve` takes them.
CURVES = {
    "helix": {
        "curve": {"shape": "helix", "radius_m": 0.2, "pitch_m": 0.4, "turns": 1.5},
        "link_m": 0.1,
        "roll": "smallest_angle",
    },
    "serpenoid": {
        "curve": {"shape": "serpenoid", "length_m": 2.0, "waves": 2.0, "amplitude_deg": 50.0},
        "links": 20,
        "roll": "smallest_angle",
    },
    "rolling_helix": {
        "curve": {"shape": "helix", "radius_m": 0.2, "pitch_m": 0.4, "turns": 1.5},
        "link_m": 0.1,
        "links": 16,
        "gait": {"moves": "roll", "period_s": 2.0, "seconds": 2.0, "shapes": 25},
    },
}


rule curve:
    """Curves as links, still and moving, and the chain that results calibrated in the virtual cell."""
    input:
        expand(curve_result("{shape}/pictures.json"), shape=CURVES),
        curve_result("pictures.json"),


rule lay_curve:
    """A shape as links: where they join, their axes and joint angles."""
    output:
        record=curve_result("{shape}/curve.json"),
        tables=expand(
            curve_result("{{shape}}/{table}.csv"), table=["angles", "points", "links", "shape"]
        ),
    log:
        curve_result("logs/{shape}.log"),
    wildcard_constraints:
        shape="|".join(CURVES),
    params:
        code=code_of("pa10cal_curve.commands"),
        out=lambda wildcards, output: os.path.dirname(output.record),
        settings=lambda wildcards: json.dumps(CURVES[wildcards.shape]),
    shell:
        "python -m pa10cal curve --settings {params.settings:q} --out-dir {params.out:q}"
        " 2>&1 | tee {log:q} >&2"


rule draw_curve:
    """The chain along a curve and its joint angles; of one that moves some shapes and a film."""
    input:
        rules.lay_curve.output,
    output:
        index=curve_result("{shape}/pictures.json"),
        figures=directory(curve_result("{shape}/figures")),
    log:
        curve_result("logs/draw_{shape}.log"),
    wildcard_constraints:
        shape="|".join(CURVES),
    params:
        code=code_of(
            "pa10cal.commands.figures", "pa10cal.figures.registry", "pa10cal_curve.pictures"
        ),
        folder=lambda wildcards, input: os.path.dirname(input[0]),
        settings=sections_of("figures"),
    shell:
        "python -m pa10cal figures --results {params.folder:q} --settings {params.settings:q}"
        " 2>&1 | tee {log:q} >&2"


rule calibrate_chain:
    """The chain as an arm of the virtual cell, posed along curves and calibrated."""
    output:
        curve_result("calibration.json"),
    log:
        curve_result("logs/calibration.log"),
    params:
        code=code_of("pa10cal_curve.commands"),
        settings=settings_of("curve"),
        calibration=settings_of("calibration"),
    shell:
        "python -m pa10cal curve_calibration --settings {params.settings:q}"
        " --calibration {params.calibration:q} --out {output:q} 2>&1 | tee {log:q} >&2"


rule draw_chain:
    """The study of the chain."""
    input:
        record=curve_result("calibration.json"),
    output:
        index=curve_result("pictures.json"),
        figures=directory(curve_result("figures")),
        tables=directory(curve_result("tables")),
    log:
        curve_result("logs/pictures.log"),
    params:
        code=code_of(
            "pa10cal.commands.figures", "pa10cal.figures.registry", "pa10cal_curve.study_pictures"
        ),
        folder=lambda wildcards, input: os.path.dirname(input.record),
        settings=sections_of("figures"),
    shell:
        "python -m pa10cal figures --results {params.folder:q} --settings {params.settings:q}"
        " 2>&1 | tee {log:q} >&2"
