rule export:
    """The calibrated model for other programs: all parameters, and the geometry as URDF."""
    input:
        calibration=result(f"calibration/{SETTINGS.evaluation.calibration}.json"),
        extended=extended_model,
        code=code_of("commands.export"),
    output:
        model=result("model/model.yaml"),
        covariance=result("model/model.covariance.npz"),
        urdf=result("model/robot.urdf"),
    log:
        result("logs/export.log"),
    params:
        extended=extended_option,
    shell:
        "python -m pa10cal export --calibration {input.calibration:q} {params.extended}"
        " --model {output.model:q} --urdf {output.urdf:q} 2>&1 | tee {log:q} >&2"
