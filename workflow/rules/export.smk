rule export:
    """The calibrated model for other programs: all parameters, and the geometry as URDF."""
    input:
        calibration=result("calibration"),
        extended=extended_model,
    output:
        model=result("model/model.yaml"),
        covariance=result("model/model.covariance.npz"),
        urdf=result("model/robot.urdf"),
    log:
        result("logs/export.log"),
    params:
        calibration=evaluated_calibration,
        code=code_of("commands.export"),
        extended=extended_option,
    shell:
        "python -m pa10cal export --calibration {params.calibration:q} {params.extended}"
        " --model {output.model:q} --urdf {output.urdf:q} 2>&1 | tee {log:q} >&2"
