import json

# Shapes that links are laid along, as the stage `curve` takes them.
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
STILL = [name for name, asked in CURVES.items() if "gait" not in asked]
MOVING = [name for name, asked in CURVES.items() if "gait" in asked]
# What is drawn of the chain calibrated, and what the report calls it.
CURVE_FIGURES = {"curve_calibration": "A chain of links, calibrated"}
CURVE_TABLES = {"curve_calibration_summary": "Rank, null directions and errors of the chain"}


rule curve:
    """Curves as links, still and moving, and the chain that results calibrated in the virtual cell."""
    input:
        expand(curve_result("{shape}/figures/curve_shape.svg"), shape=STILL),
        expand(
            curve_result("{shape}/figures/curve_gait.{ending}"),
            shape=MOVING,
            ending=["svg", "gif"],
        ),
        expand(curve_result("figures/{name}.svg"), name=CURVE_FIGURES),
        expand(curve_result("tables/{name}.csv"), name=CURVE_TABLES),


rule lay_curve:
    """A shape as links: where they join, their axes and joint angles."""
    input:
        code=code_of("commands.curve"),
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
        out=lambda wildcards, output: os.path.dirname(output.record),
        settings=lambda wildcards: json.dumps(CURVES[wildcards.shape]),
    shell:
        "python -m pa10cal curve --settings {params.settings:q} --out-dir {params.out:q}"
        " 2>&1 | tee {log:q} >&2"


rule draw_curve_shape:
    """The chain along a curve, and its joint angles."""
    input:
        rules.lay_curve.output,
        code=code_of("commands.draw_curve"),
    output:
        svg=reported_curve("{shape}/figures/curve_shape.svg", "curve_shape", "{shape}"),
        pdf=curve_result("{shape}/figures/curve_shape.pdf"),
        png=curve_result("{shape}/figures/curve_shape.png"),
    log:
        curve_result("logs/draw_{shape}.log"),
    wildcard_constraints:
        shape="|".join(STILL),
    params:
        folder=lambda wildcards, input: os.path.dirname(input[0]),
        out=lambda wildcards, output: os.path.dirname(output.svg),
        settings=settings_of("figures"),
    shell:
        "python -m pa10cal draw_curve --curve-dir {params.folder:q} --settings {params.settings:q}"
        " --out-dir {params.out:q} 2>&1 | tee {log:q} >&2"


rule draw_curve_gait:
    """A chain that moves: some shapes, joint angles over time, and a film."""
    input:
        rules.lay_curve.output,
        code=code_of("commands.draw_curve"),
    output:
        svg=reported_curve("{shape}/figures/curve_gait.svg", "curve_gait", "{shape}"),
        pdf=curve_result("{shape}/figures/curve_gait.pdf"),
        png=curve_result("{shape}/figures/curve_gait.png"),
        film=reported_curve("{shape}/figures/curve_gait.gif", "curve_gait", "{shape}, moving"),
    log:
        curve_result("logs/draw_{shape}.log"),
    wildcard_constraints:
        shape="|".join(MOVING),
    params:
        folder=lambda wildcards, input: os.path.dirname(input[0]),
        out=lambda wildcards, output: os.path.dirname(output.svg),
        settings=settings_of("figures"),
    shell:
        "python -m pa10cal draw_curve --curve-dir {params.folder:q} --settings {params.settings:q}"
        " --movie {output.film:q} --out-dir {params.out:q} 2>&1 | tee {log:q} >&2"


rule calibrate_chain:
    """The chain as an arm of the virtual cell, posed along curves and calibrated."""
    input:
        code=code_of("commands.curve_calibration"),
    output:
        curve_result("calibration.json"),
    log:
        curve_result("logs/calibration.log"),
    params:
        settings=settings_of("curve"),
        calibration=settings_of("calibration"),
    shell:
        "python -m pa10cal curve_calibration --settings {params.settings:q}"
        " --calibration {params.calibration:q} --out {output:q} 2>&1 | tee {log:q} >&2"


for name, title in {**CURVE_FIGURES, **CURVE_TABLES}.items():

    rule:
        name:
            name
        input:
            record=curve_result("calibration.json"),
            code=code_of("commands.draw_curve_calibration", f"figures.{name}"),
        output:
            **(
                {
                    "svg": reported_curve(f"figures/{name}.svg", name, title),
                    "pdf": curve_result(f"figures/{name}.pdf"),
                    "png": curve_result(f"figures/{name}.png"),
                }
                if name in CURVE_FIGURES
                else {
                    "html": reported_curve(f"tables/{name}.html", name, title),
                    "csv": curve_result(f"tables/{name}.csv"),
                    "markdown": curve_result(f"tables/{name}.md"),
                }
            ),
        log:
            curve_result(f"logs/{name}.log"),
        params:
            name=name,
            out=lambda wildcards, output: os.path.dirname(output[0]),
            settings=settings_of("figures"),
        shell:
            "python -m pa10cal draw_curve_calibration --figure {params.name} --record {input.record:q}"
            " --settings {params.settings:q} --out-dir {params.out:q} 2>&1 | tee {log:q} >&2"
